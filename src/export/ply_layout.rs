//! How our PLY files are laid out: the header, and how many bytes what follows takes.
//!
//! The header has the same length whatever the counts in it: a comment fills up what shorter numbers
//! leave. So it can be written last, when the counts are known, before what is there already.

use std::io;

use ply_rs_bw::ply::{
    Addable, DefaultElement, ElementDef, Encoding, Header, PropertyDef, PropertyType, ScalarType,
};
use ply_rs_bw::writer::Writer;

use crate::grid::Geometry;
use crate::mesh::{InterfaceMesh, MeshMaterial};

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

/// The type of a vertex's coordinates in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Coordinates {
    /// 32 bits each.
    #[default]
    Float,
    /// 64 bits each.
    Double,
}

impl Coordinates {
    /// `Float` while its step at `largest`, the largest coordinate, stays under a thousandth of
    /// `resolution` (both mm); so a resolution of 0 or one that is not a number gives `Double`.
    #[must_use]
    pub fn fitting(largest: f64, resolution: f64) -> Self {
        // One f32 step is at most 2^-23 of the number.
        let step = largest * f64::from(f32::EPSILON);
        if step <= resolution / 1000.0 { Self::Float } else { Self::Double }
    }

    fn scalar(self) -> ScalarType {
        match self {
            Self::Float => ScalarType::Float,
            Self::Double => ScalarType::Double,
        }
    }
}

/// Options of [`write_ply`](super::write_ply) and [`PlyStream`](super::PlyStream).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PlyOptions {
    /// The type of coordinates.
    pub coordinates: Coordinates,
    /// How numbers are laid down.
    pub encoding: PlyEncoding,
}

impl PlyOptions {
    /// Binary little endian; `double` coordinates where `float` would cost `mesh` more than a thousandth
    /// of `resolution` mm.
    #[must_use]
    pub fn for_mesh(mesh: &InterfaceMesh, resolution: f64) -> Self {
        let largest = mesh.positions().iter().fold(0.0, |m: f64, p| m.max(p.abs().max_element()));
        Self { coordinates: Coordinates::fitting(largest, resolution), ..Self::default() }
    }

    /// Binary little endian; for any mesh of a volume, known before there is one: no vertex lies beyond
    /// the sides of the box of voxels. Rounding to `float` keeps the order of coordinates, and so the cells'
    /// vertices in their cells, only where the lattice lies along the world's axes; any other lattice
    /// gets `double`.
    #[must_use]
    pub fn for_volume(geometry: &Geometry) -> Self {
        let coordinates = if geometry.fits_single() { Coordinates::Float } else { Coordinates::Double };
        Self { coordinates, ..Self::default() }
    }
}

/// Most vertices that the `int` indices of a face can name.
pub(super) const MOST_VERTICES: u64 = i32::MAX as u64;
/// Bytes of a binary face: its length, three indices, two materials.
pub(super) const FACE: usize = 1 + 3 * 4 + 2;
/// Decimals of the largest counts of vertices and faces.
const DIGITS: usize = 10 + 20;

/// What a vertex of a file holds: coordinates, kind and, if it is known, sigma.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct VertexForm {
    /// The type of coordinates.
    pub(super) coordinates: Coordinates,
    /// Whether there is a sigma.
    pub(super) sigma: bool,
}

impl VertexForm {
    /// Where the kind begins in a binary vertex; the sigma follows it.
    pub(super) const fn kind_at(self) -> usize {
        match self.coordinates {
            Coordinates::Float => 3 * 4,
            Coordinates::Double => 3 * 8,
        }
    }

    /// Bytes of a binary vertex.
    pub(super) const fn bytes(self) -> usize {
        self.kind_at() + 1 + if self.sigma { 4 } else { 0 }
    }
}

/// A sigma as files have it: -1 where it is unknown, as text has no word for that which all tools can read.
pub(super) fn written_sigma(sigma: f32) -> f32 {
    if sigma >= 0.0 && sigma.is_finite() { sigma } else { -1.0 }
}

/// The inverse of [`written_sigma`].
pub(super) fn read_sigma(written: f32) -> f32 {
    if written >= 0.0 { written } else { f32::NAN }
}

/// Where the faces begin and where they end, from a binary file's start; `None` beyond 2^64 - 1.
pub(super) fn extents(header: u64, form: VertexForm, [vertices, faces]: [u64; 2]) -> Option<[u64; 2]> {
    let start = vertices.checked_mul(form.bytes() as u64)?.checked_add(header)?;
    Some([start, faces.checked_mul(FACE as u64)?.checked_add(start)?])
}

/// The elements of our files, by which the library writes text and big endian.
pub(super) fn elements(form: VertexForm, [vertices, faces]: [usize; 2]) -> [ElementDef; 2] {
    let scalar = PropertyType::Scalar;
    let mut vertex = ElementDef::new("vertex".to_owned());
    vertex.count = vertices;
    for axis in ["x", "y", "z"] {
        vertex.properties.add(PropertyDef::new(axis.to_owned(), scalar(form.coordinates.scalar())));
    }
    vertex.properties.add(PropertyDef::new("kind".to_owned(), scalar(ScalarType::UChar)));
    if form.sigma {
        vertex.properties.add(PropertyDef::new("sigma".to_owned(), scalar(ScalarType::Float)));
    }
    let mut face = ElementDef::new("face".to_owned());
    face.count = faces;
    let indices = PropertyType::List(ScalarType::UChar, ScalarType::Int);
    face.properties.add(PropertyDef::new("vertex_indices".to_owned(), indices));
    for label in ["material_back", "material_front"] {
        face.properties.add(PropertyDef::new(label.to_owned(), scalar(ScalarType::UChar)));
    }
    [vertex, face]
}

/// The header of a file with so many vertices, with or without a sigma, and faces: as long as that of any other counts.
pub(super) fn header(
    materials: &[MeshMaterial],
    options: PlyOptions,
    sigma: bool,
    counts: [u64; 2],
) -> io::Result<Vec<u8>> {
    let digits: usize = counts.iter().map(|n| n.to_string().len()).sum();
    let mut sizes = [0; 2];
    for (size, count) in sizes.iter_mut().zip(counts) {
        *size = usize::try_from(count).map_err(io::Error::other)?;
    }
    let mut header = Header::new();
    header.encoding = match options.encoding {
        PlyEncoding::BinaryLittleEndian => Encoding::BinaryLittleEndian,
        PlyEncoding::BinaryBigEndian => Encoding::BinaryBigEndian,
        PlyEncoding::Ascii => Encoding::Ascii,
    };
    header.comments.push(format!("made by interfacet {}", env!("CARGO_PKG_VERSION")));
    header.comments.push("unit mm".to_owned());
    for material in materials {
        // A comment is one line, whatever a name holds.
        let name = material.name.split(char::is_control).collect::<Vec<_>>().join(" ");
        header.comments.push(format!("material {} {} {}", material.id.0, name, material.mean));
    }
    header.comments.push(format!("room for counts {}", ".".repeat(1 + DIGITS.saturating_sub(digits))));
    if sigma {
        header
            .comments
            .push("sigma is a standard deviation along the normal in mm, -1 where unknown".to_owned());
    }
    for element in elements(VertexForm { coordinates: options.coordinates, sigma }, sizes) {
        header.elements.add(element);
    }
    let mut text = Vec::new();
    Writer::<DefaultElement>::new().write_header(&mut text, &header)?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::materials;

    #[test]
    fn a_header_is_as_long_for_any_counts() {
        for coordinates in [Coordinates::Float, Coordinates::Double] {
            let options = PlyOptions { coordinates, ..PlyOptions::default() };
            let long = header(&materials(), options, true, [MOST_VERTICES, u64::MAX]).unwrap();
            assert!(String::from_utf8_lossy(&long).contains("element face 18446744073709551615\n"));
            for counts in [[0, 0], [7, 12], [MOST_VERTICES, 1 << 32], [123, 45_678_901_234]] {
                assert_eq!(header(&materials(), options, true, counts).unwrap().len(), long.len());
            }
        }
    }

    #[test]
    fn offsets_beyond_four_gibibytes_are_right() {
        let counts = [MOST_VERTICES, 5_000_000_000];
        let start = 600 + 13 * 2_147_483_647;
        let [float, double] =
            [Coordinates::Float, Coordinates::Double].map(|c| VertexForm { coordinates: c, sigma: false });
        assert_eq!(extents(600, float, counts), Some([start, start + 75_000_000_000]));
        assert_eq!(extents(600, double, [1 << 32, 0]), Some([600 + (25 << 32); 2]));
        assert_eq!(
            extents(600, VertexForm { sigma: true, ..float }, [1 << 32, 0]),
            Some([600 + (17 << 32); 2])
        );
        assert_eq!(extents(600, float, [0, u64::MAX]), None);
        assert_eq!(extents(600, double, [u64::MAX / 25, 9]), None);
    }

    #[test]
    fn float_is_used_while_it_costs_little() {
        assert_eq!(Coordinates::fitting(500.0, 0.1), Coordinates::Float);
        assert_eq!(Coordinates::fitting(500.0, 0.01), Coordinates::Double);
        assert_eq!(Coordinates::fitting(500.0, 0.0), Coordinates::Double);
        assert_eq!(Coordinates::fitting(500.0, f64::NAN), Coordinates::Double);
        let eye = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let of = |origin, direction| {
            PlyOptions::for_volume(&Geometry::new([40, 50, 60], [0.1; 3], origin, direction).unwrap())
                .coordinates
        };
        assert_eq!(of([0.0; 3], eye), Coordinates::Float);
        assert_eq!(of([0.0, 0.0, -1000.0], eye), Coordinates::Double);
        assert_eq!(of([0.0; 3], [[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]), Coordinates::Double);
    }
}
