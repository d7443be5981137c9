//! Vertices and faces as bytes of a PLY file.
//!
//! Binary little endian is the form that large meshes take, so it is laid down here, in parallel;
//! text and big endian go through the library, element by element, to the same layout.

use std::io;

use glam::DVec3;
use ply_rs_bw::ply::PropertyAccess;
use ply_rs_bw::writer::Writer;
use rayon::prelude::*;

use super::ply_layout::{Coordinates, FACE, PlyEncoding, PlyOptions, VertexForm, elements, written_sigma};
use crate::grid::{Pair, VertexKind};
use crate::mesh::InterfaceMesh;

/// The vertices of a mesh, or some of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertices<'a> {
    pub(super) positions: &'a [DVec3],
    pub(super) kinds: &'a [VertexKind],
    /// If the file has them.
    pub(super) sigmas: Option<&'a [f32]>,
}

impl<'a> Vertices<'a> {
    /// The first of a mesh.
    pub(super) fn of(mesh: &'a InterfaceMesh, count: usize) -> Self {
        let (positions, kinds) = (&mesh.positions()[..count], &mesh.kinds()[..count]);
        Self { positions, kinds, sigmas: mesh.sigmas().map(|sigmas| &sigmas[..count]) }
    }

    /// Runs of `size`.
    pub(super) fn chunks(self, size: usize) -> impl Iterator<Item = Self> {
        (0..self.positions.len()).step_by(size).map(move |from| {
            let range = from..(from + size).min(self.positions.len());
            let (positions, kinds) = (&self.positions[range.clone()], &self.kinds[range.clone()]);
            Self { positions, kinds, sigmas: self.sigmas.map(|sigmas| &sigmas[range]) }
        })
    }

    fn form(self, options: PlyOptions) -> VertexForm {
        VertexForm { coordinates: options.coordinates, sigma: self.sigmas.is_some() }
    }
}

/// Elements that one task encodes.
const TASK: usize = 1 << 13;

/// The pairs of some triangles.
#[derive(Debug, Clone, Copy)]
pub(super) enum Pairs<'a> {
    /// One for each.
    Each(&'a [Pair]),
    /// The same for all.
    All(Pair),
}

impl<'a> Pairs<'a> {
    /// Those of the triangles from `start` on.
    pub(super) fn from(self, start: usize) -> Self {
        match self {
            Self::Each(pairs) => Self::Each(&pairs[start..]),
            all => all,
        }
    }
}

/// Puts vertices into `out`, which is emptied first.
pub(super) fn vertices(out: &mut Vec<u8>, all: Vertices<'_>, options: PlyOptions) -> io::Result<()> {
    if options.encoding != PlyEncoding::BinaryLittleEndian {
        return vertices_by_library(out, all, options);
    }
    let Vertices { positions, kinds, sigmas } = all;
    let form = all.form(options);
    let size = form.bytes();
    // What is in it is written over: only growth costs anything.
    out.resize(size * positions.len(), 0);
    let tasks = out.par_chunks_mut(size * TASK).zip(positions.par_chunks(TASK)).zip(kinds.par_chunks(TASK));
    tasks.for_each(|((bytes, positions), kinds)| {
        let each = bytes.chunks_exact_mut(size).zip(positions.iter().zip(kinds));
        match options.coordinates {
            Coordinates::Float => each.for_each(|(bytes, (p, kind))| {
                let [x, y, z] = p.to_array().map(|c| (c as f32).to_le_bytes());
                bytes[..4].copy_from_slice(&x);
                bytes[4..8].copy_from_slice(&y);
                bytes[8..12].copy_from_slice(&z);
                bytes[12] = kind.code();
            }),
            Coordinates::Double => each.for_each(|(bytes, (p, kind))| {
                let [x, y, z] = p.to_array().map(f64::to_le_bytes);
                bytes[..8].copy_from_slice(&x);
                bytes[8..16].copy_from_slice(&y);
                bytes[16..24].copy_from_slice(&z);
                bytes[24] = kind.code();
            }),
        }
    });
    if let Some(sigmas) = sigmas {
        let at = form.kind_at() + 1;
        let tasks = out.par_chunks_mut(size).with_min_len(TASK).zip(sigmas);
        tasks.for_each(|(bytes, sigma)| bytes[at..].copy_from_slice(&written_sigma(*sigma).to_le_bytes()));
    }
    Ok(())
}

/// Puts faces into `out`, which is emptied first; vertex i of a triangle becomes `offset` + i, which the
/// caller has found to fit.
pub(super) fn faces(
    out: &mut Vec<u8>,
    triangles: &[[u32; 3]],
    offset: u32,
    pairs: Pairs<'_>,
    options: PlyOptions,
) -> io::Result<()> {
    if options.encoding != PlyEncoding::BinaryLittleEndian {
        return faces_by_library(out, triangles, offset, pairs, options);
    }
    out.resize(FACE * triangles.len(), 0);
    let face = |(bytes, (triangle, pair)): (&mut [u8], (&[u32; 3], Pair))| {
        let [a, b, c] = triangle.map(|v| v.wrapping_add(offset).to_le_bytes());
        bytes[0] = 3;
        bytes[1..5].copy_from_slice(&a);
        bytes[5..9].copy_from_slice(&b);
        bytes[9..13].copy_from_slice(&c);
        bytes[13] = pair.back().0;
        bytes[14] = pair.front().0;
    };
    let tasks = out.par_chunks_mut(FACE * TASK).zip(triangles.par_chunks(TASK)).enumerate();
    tasks.for_each(|(k, (bytes, triangles))| {
        let bytes = bytes.chunks_exact_mut(FACE);
        match pairs.from(k * TASK) {
            Pairs::Each(pairs) => bytes.zip(triangles.iter().zip(pairs.iter().copied())).for_each(face),
            Pairs::All(pair) => bytes.zip(triangles.iter().map(|t| (t, pair))).for_each(face),
        }
    });
    Ok(())
}

fn vertices_by_library(out: &mut Vec<u8>, all: Vertices<'_>, options: PlyOptions) -> io::Result<()> {
    out.clear();
    let ([def, _], writer) = (elements(all.form(options), [0; 2]), Writer::<Vertex>::new());
    for (i, (position, kind)) in all.positions.iter().zip(all.kinds).enumerate() {
        let sigma = all.sigmas.map_or(f32::NAN, |sigmas| sigmas[i]);
        let element =
            Vertex { position: position.to_array(), kind: kind.code(), sigma: written_sigma(sigma) };
        match options.encoding {
            PlyEncoding::BinaryLittleEndian => writer.write_little_endian_element(out, &element, &def),
            PlyEncoding::BinaryBigEndian => writer.write_big_endian_element(out, &element, &def),
            PlyEncoding::Ascii => writer.write_ascii_element(out, &element, &def),
        }?;
    }
    Ok(())
}

fn faces_by_library(
    out: &mut Vec<u8>,
    triangles: &[[u32; 3]],
    offset: u32,
    pairs: Pairs<'_>,
    options: PlyOptions,
) -> io::Result<()> {
    out.clear();
    let form = VertexForm { coordinates: options.coordinates, sigma: false };
    let ([_, def], writer) = (elements(form, [0; 2]), Writer::<Face>::new());
    for (i, triangle) in triangles.iter().enumerate() {
        let pair = match pairs {
            Pairs::Each(pairs) => pairs[i],
            Pairs::All(pair) => pair,
        };
        let indices = triangle.map(|v| v.wrapping_add(offset) as i32);
        let element = Face { indices, back: pair.back().0, front: pair.front().0 };
        match options.encoding {
            PlyEncoding::BinaryLittleEndian => writer.write_little_endian_element(out, &element, &def),
            PlyEncoding::BinaryBigEndian => writer.write_big_endian_element(out, &element, &def),
            PlyEncoding::Ascii => writer.write_ascii_element(out, &element, &def),
        }?;
    }
    Ok(())
}

/// A vertex as the library asks for it.
struct Vertex {
    position: [f64; 3],
    kind: u8,
    sigma: f32,
}

impl Vertex {
    fn coordinate(&self, name: &str) -> Option<f64> {
        ["x", "y", "z"].iter().position(|&axis| axis == name).map(|axis| self.position[axis])
    }
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self { position: [0.0; 3], kind: 0, sigma: f32::NAN }
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        if name == "sigma" { Some(self.sigma) } else { self.coordinate(name).map(|c| c as f32) }
    }

    fn get_double(&self, name: &str) -> Option<f64> {
        self.coordinate(name)
    }

    fn get_uchar(&self, name: &str) -> Option<u8> {
        (name == "kind").then_some(self.kind)
    }
}

/// A face as the library asks for it.
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
    use crate::mesh::fixtures::voxel_faces;

    #[test]
    fn our_bytes_are_those_of_the_library() {
        let mesh = voxel_faces([3, 2, 2], &[1, 2, 3, 0, 1, 1, 2, 3, 3, 3, 0, 0], 255);
        let positions: Vec<_> = mesh.positions().iter().map(|&p| p / 3.0 - 0.1).collect();
        let (mut ours, mut theirs) = (vec![1; 7], vec![2; 9]);
        for coordinates in [Coordinates::Float, Coordinates::Double] {
            let options = PlyOptions { coordinates, encoding: PlyEncoding::BinaryLittleEndian };
            let sigmas: Vec<f32> =
                (0..positions.len()).map(|i| if i == 3 { f32::NAN } else { 0.1 / (i + 1) as f32 }).collect();
            for sigmas in [None, Some(sigmas.as_slice())] {
                let all = Vertices { positions: &positions, kinds: mesh.kinds(), sigmas };
                vertices(&mut ours, all, options).unwrap();
                vertices_by_library(&mut theirs, all, options).unwrap();
                assert_eq!(ours, theirs);
            }
            for pairs in [Pairs::Each(mesh.pairs()), Pairs::All(mesh.pairs()[0])] {
                faces(&mut ours, mesh.triangles(), 70_000, pairs, options).unwrap();
                faces_by_library(&mut theirs, mesh.triangles(), 70_000, pairs, options).unwrap();
                assert_eq!(ours, theirs);
            }
        }
    }
}
