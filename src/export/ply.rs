//! PLY writer: the exchange format with everything in it.
//!
//! `vertex { x y z; uchar kind }`, `face { list uchar int vertex_indices; uchar material_back;
//! uchar material_front }`, and comments for the unit, the tool and every material (`material ID
//! NAME MEAN`). Coordinates are `float`, or `double` where `float` would cost more than a
//! thousandth of a voxel.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use ply_rs_bw::ply::{
    Addable, ElementDef, Encoding, Header, PropertyAccess, PropertyDef, PropertyType, ScalarType,
};
use ply_rs_bw::writer::Writer;

use super::{ExportError, write_atomically};
use crate::mesh::InterfaceMesh;

/// How numbers are laid down in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PlyEncoding {
    /// Binary, least significant byte first.
    #[default]
    BinaryLittleEndian,
    /// Binary, most significant byte first.
    BinaryBigEndian,
    /// Text; numbers are written so that they read back exactly.
    Ascii,
}

/// Options of [`write_ply`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlyOptions {
    /// How fine the coordinates have to be: the smallest voxel side, mm. `float` is used while its
    /// step at the largest coordinate stays under a thousandth of this; 0 forces `double`.
    pub resolution: f64,
    /// How numbers are laid down.
    pub encoding: PlyEncoding,
}

impl PlyOptions {
    /// Binary little endian, for voxels of side `resolution` mm.
    #[must_use]
    pub fn new(resolution: f64) -> Self {
        Self { resolution, encoding: PlyEncoding::default() }
    }
}

/// Writes `mesh` to the PLY file `path`, whole or not at all.
///
/// # Errors
/// [`ExportError`] naming `path`; [`ExportError::TooLarge`] if there are more vertices than `int` counts.
pub fn write_ply(path: &Path, mesh: &InterfaceMesh, options: &PlyOptions) -> Result<(), ExportError> {
    if i32::try_from(mesh.positions().len()).is_err() {
        return Err(ExportError::TooLarge {
            path: path.to_owned(),
            what: format!("{} vertices; PLY's int indices reach {}", mesh.positions().len(), i32::MAX),
        });
    }
    write_atomically(path, |out| write(out, mesh, options))
}

/// The step of f32 at the largest coordinate against a thousandth of the resolution.
fn needs_double(mesh: &InterfaceMesh, resolution: f64) -> bool {
    let largest = mesh.positions().iter().fold(0.0, |m: f64, p| m.max(p.abs().max_element()));
    // One f32 step is at most 2^-23 of the number.
    let step = largest * f64::from(f32::EPSILON);
    let fits = step <= resolution / 1000.0; // false too where the resolution is not a number
    !fits
}

fn write(out: &mut BufWriter<File>, mesh: &InterfaceMesh, options: &PlyOptions) -> io::Result<()> {
    let header = header(mesh, options);
    let (vertex, face) = (&header.elements["vertex"], &header.elements["face"]);
    let (vertices, faces) = (Writer::<Vertex>::new(), Writer::<Face>::new());
    vertices.write_header(out, &header)?;
    // Element by element, so that no copy of the mesh is made.
    for (position, kind) in mesh.positions().iter().zip(mesh.kinds()) {
        let element = Vertex { position: position.to_array(), kind: kind.code() };
        match options.encoding {
            PlyEncoding::BinaryLittleEndian => vertices.write_little_endian_element(out, &element, vertex),
            PlyEncoding::BinaryBigEndian => vertices.write_big_endian_element(out, &element, vertex),
            PlyEncoding::Ascii => vertices.write_ascii_element(out, &element, vertex),
        }?;
    }
    for (triangle, pair) in mesh.triangles().iter().zip(mesh.pairs()) {
        let element =
            Face { indices: triangle.map(|v| v as i32), back: pair.back().0, front: pair.front().0 };
        match options.encoding {
            PlyEncoding::BinaryLittleEndian => faces.write_little_endian_element(out, &element, face),
            PlyEncoding::BinaryBigEndian => faces.write_big_endian_element(out, &element, face),
            PlyEncoding::Ascii => faces.write_ascii_element(out, &element, face),
        }?;
    }
    out.flush()
}

fn header(mesh: &InterfaceMesh, options: &PlyOptions) -> Header {
    let scalar = PropertyType::Scalar;
    let coordinate =
        if needs_double(mesh, options.resolution) { ScalarType::Double } else { ScalarType::Float };
    let mut vertex = ElementDef::new("vertex".to_owned());
    vertex.count = mesh.positions().len();
    for axis in ["x", "y", "z"] {
        vertex.properties.add(PropertyDef::new(axis.to_owned(), scalar(coordinate.clone())));
    }
    vertex.properties.add(PropertyDef::new("kind".to_owned(), scalar(ScalarType::UChar)));
    let mut face = ElementDef::new("face".to_owned());
    face.count = mesh.triangles().len();
    let indices = PropertyType::List(ScalarType::UChar, ScalarType::Int);
    face.properties.add(PropertyDef::new("vertex_indices".to_owned(), indices));
    for label in ["material_back", "material_front"] {
        face.properties.add(PropertyDef::new(label.to_owned(), scalar(ScalarType::UChar)));
    }
    let mut header = Header::new();
    header.encoding = match options.encoding {
        PlyEncoding::BinaryLittleEndian => Encoding::BinaryLittleEndian,
        PlyEncoding::BinaryBigEndian => Encoding::BinaryBigEndian,
        PlyEncoding::Ascii => Encoding::Ascii,
    };
    header.comments.push(format!("made by interfacet {}", env!("CARGO_PKG_VERSION")));
    header.comments.push("unit mm".to_owned());
    for material in mesh.materials() {
        // A comment is one line, whatever a name holds.
        let name = material.name.split(char::is_control).collect::<Vec<_>>().join(" ");
        header.comments.push(format!("material {} {} {}", material.id.0, name, material.mean));
    }
    header.elements.add(vertex);
    header.elements.add(face);
    header
}

/// A vertex as the writer asks for it.
struct Vertex {
    position: [f64; 3],
    kind: u8,
}

impl Vertex {
    fn coordinate(&self, name: &str) -> Option<f64> {
        ["x", "y", "z"].iter().position(|&axis| axis == name).map(|axis| self.position[axis])
    }
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self { position: [0.0; 3], kind: 0 }
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        self.coordinate(name).map(|c| c as f32)
    }

    fn get_double(&self, name: &str) -> Option<f64> {
        self.coordinate(name)
    }

    fn get_uchar(&self, name: &str) -> Option<u8> {
        (name == "kind").then_some(self.kind)
    }
}

/// A face as the writer asks for it.
struct Face {
    indices: [i32; 3],
    back: u8,
    front: u8,
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self { indices: [0; 3], back: 0, front: 0 }
    }

    fn get_list_int(&self, name: &str) -> Option<&[i32]> {
        (name == "vertex_indices").then_some(&self.indices)
    }

    fn get_uchar(&self, name: &str) -> Option<u8> {
        match name {
            "material_back" => Some(self.back),
            "material_front" => Some(self.front),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::{ReadOptions, read_mesh};
    use crate::mesh::fixtures::{materials, parts, voxel_faces};
    use glam::DVec3;

    fn sample(offset: f64, step: f64) -> InterfaceMesh {
        let m = voxel_faces([2, 2, 1], &[1, 2, 3, 0], 255);
        let (p, t, pairs) = parts(&m);
        let p: Vec<DVec3> = p.iter().map(|&p| p * step + offset).collect();
        let kinds = crate::mesh::kinds_from_labels(p.len(), &t, &pairs);
        let mut materials = materials();
        materials[2].name = "stainless steel, 1.4301".to_owned();
        InterfaceMesh::new(p, kinds, t, pairs, materials).unwrap()
    }

    #[test]
    fn every_encoding_reads_back_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.ply");
        for encoding in [PlyEncoding::BinaryLittleEndian, PlyEncoding::BinaryBigEndian, PlyEncoding::Ascii] {
            // Exact in f32; and one that is not, near an origin far away.
            for (offset, step, word) in [(0.5, 0.25, "float"), (123_456.789, 0.001, "double")] {
                let m = sample(offset, step);
                write_ply(&path, &m, &PlyOptions { resolution: step, encoding }).unwrap();
                let text = std::fs::read(&path).unwrap();
                let head = String::from_utf8_lossy(&text[..600]).into_owned();
                assert!(head.contains(&format!("property {word} x\n")), "{head}");
                assert!(head.contains("comment unit mm\n"));
                assert!(head.contains("comment material 2 stainless steel, 1.4301 100\n"));
                assert_eq!(read_mesh(&path, &ReadOptions::default()).unwrap(), m);
            }
        }
    }

    #[test]
    fn float_is_used_while_it_costs_little() {
        let m = sample(500.0, 0.5);
        assert!(!needs_double(&m, 0.1));
        assert!(needs_double(&m, 0.01));
        assert!(needs_double(&m, 0.0));
    }

    #[test]
    fn a_name_cannot_break_the_header() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.ply");
        let m = sample(0.0, 1.0);
        let mut materials = m.materials().to_vec();
        materials[1].name = "two\nend_header\r\nlines".to_owned();
        let (p, t, pairs) = parts(&m);
        let m = InterfaceMesh::new(p, m.kinds().to_vec(), t, pairs, materials).unwrap();
        write_ply(&path, &m, &PlyOptions::new(1.0)).unwrap();
        let back = read_mesh(&path, &ReadOptions::default()).unwrap();
        assert_eq!(back.triangles(), m.triangles());
        assert_eq!(back.materials()[1].name, "two end_header  lines");
    }
}
