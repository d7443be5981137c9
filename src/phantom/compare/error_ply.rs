//! The mesh coloured by its error, for a look at where it is wrong.

use std::io::{self, Write};

use ply_rs_bw::ply::{
    Addable, DefaultElement, ElementDef, Encoding, Ply, Property, PropertyDef, PropertyType, ScalarType,
};
use ply_rs_bw::writer::Writer;

use super::Comparison;
use crate::mesh::InterfaceMesh;

/// Errors of this many voxels get the full colour.
const FULL: f64 = 0.5;

impl Comparison {
    /// Writes `mesh`, the mesh that was compared, as a binary PLY file: vertices with their signed `error` in
    /// mm (0 where there is none) and a colour (white: none, red: in front of the truth, blue: behind, grey: no
    /// true interface to compare with), triangles with their materials.
    ///
    /// # Errors
    /// Whatever the writer says.
    pub fn write_error_ply(&self, mesh: &InterfaceMesh, out: &mut impl Write) -> io::Result<()> {
        let mut ply = Ply::<DefaultElement>::new();
        ply.header.encoding = Encoding::BinaryLittleEndian;
        ply.header.comments.push("unit mm".to_owned());
        ply.header.comments.push(format!("full red and blue at {FULL} voxels = {} mm", FULL * self.voxel_mm));
        let scalar = |kind| PropertyType::Scalar(kind);
        let mut vertex = ElementDef::new("vertex".to_owned());
        for (name, kind) in [
            ("x", ScalarType::Double),
            ("y", ScalarType::Double),
            ("z", ScalarType::Double),
            ("error", ScalarType::Float),
            ("red", ScalarType::UChar),
            ("green", ScalarType::UChar),
            ("blue", ScalarType::UChar),
        ] {
            vertex.properties.add(PropertyDef::new(name.to_owned(), scalar(kind)));
        }
        let mut face = ElementDef::new("face".to_owned());
        for (name, kind) in [
            ("vertex_indices", PropertyType::List(ScalarType::UChar, ScalarType::Int)),
            ("material_back", scalar(ScalarType::UChar)),
            ("material_front", scalar(ScalarType::UChar)),
        ] {
            face.properties.add(PropertyDef::new(name.to_owned(), kind));
        }
        ply.header.elements.add(vertex);
        ply.header.elements.add(face);
        let vertices = mesh.positions().iter().zip(&self.vertex_errors).map(|(p, error)| {
            let [red, green, blue] = colour(error / self.voxel_mm);
            let error = if error.is_nan() { 0.0 } else { *error as f32 };
            let mut element = DefaultElement::new();
            for (name, value) in [("x", p.x), ("y", p.y), ("z", p.z)] {
                element.insert(name.to_owned(), Property::Double(value));
            }
            element.insert("error".to_owned(), Property::Float(error));
            for (name, value) in [("red", red), ("green", green), ("blue", blue)] {
                element.insert(name.to_owned(), Property::UChar(value));
            }
            element
        });
        ply.payload.insert("vertex".to_owned(), vertices.collect());
        let faces = mesh.triangles().iter().zip(mesh.pairs()).map(|(triangle, pair)| {
            let mut element = DefaultElement::new();
            let corners = triangle.map(|v| v as i32).to_vec();
            element.insert("vertex_indices".to_owned(), Property::ListInt(corners));
            element.insert("material_back".to_owned(), Property::UChar(pair.back().0));
            element.insert("material_front".to_owned(), Property::UChar(pair.front().0));
            element
        });
        ply.payload.insert("face".to_owned(), faces.collect());
        Writer::new().write_ply(out, &mut ply).map_err(io::Error::other)?;
        Ok(())
    }
}

/// Red, green, blue of an error in voxels.
fn colour(error: f64) -> [u8; 3] {
    if error.is_nan() {
        return [128; 3];
    }
    let rest = (255.0 * (1.0 - (error.abs() / FULL).min(1.0))).round() as u8;
    if error > 0.0 { [255, rest, rest] } else { [rest, rest, 255] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_run_from_blue_over_white_to_red() {
        assert_eq!(colour(-1.0), [0, 0, 255]);
        assert_eq!(colour(0.0), [255; 3]);
        assert_eq!(colour(0.25), [255, 128, 128]);
        assert_eq!(colour(f64::NAN), [128; 3]);
    }
}
