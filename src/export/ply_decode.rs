//! Bytes of a PLY file in our own layout as vertices and faces: blocks decoded in parallel.
//!
//! Only what is right is read here. Whatever is unusual (another layout, a face that is no triangle, a bad
//! label, a file that ends too early) is left to the general reader, which knows what to make of it or what
//! to say about it.

use std::fs::File;
use std::io;

use glam::DVec3;
use ply_rs_bw::ply::{ElementDef, Encoding, Header, PropertyType, ScalarType};
use rayon::prelude::*;

use super::block_reader::read_blocks;
use super::ply_layout::{Coordinates, FACE, VertexForm, extents, read_sigma};
use super::read::{Labels, Raw, ReadOptions};
use crate::grid::{MaterialId, Pair, VertexKind};

/// Elements in a block: about a megabyte.
pub(super) const BLOCK: usize = 1 << 16;
/// Elements that a task decodes at least.
const TASK: usize = 1 << 12;

/// A file in our layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    /// What a vertex holds.
    pub(super) form: VertexForm,
    /// Vertices and faces.
    pub(super) counts: [u64; 2],
    /// Where the vertices begin, the faces begin, and the faces end.
    pub(super) offsets: [u64; 3],
}

impl Layout {
    /// The layout of a file of `length` bytes with this header, which ends at `start`; `None` if it is
    /// not ours.
    pub(super) fn recognise(header: &Header, start: u64, length: u64, options: &ReadOptions) -> Option<Self> {
        let elements: Vec<&ElementDef> = header.elements.iter().map(|(_, e)| e).collect();
        let [vertex, face] = elements[..] else { return None };
        if header.encoding != Encoding::BinaryLittleEndian || [&vertex.name, &face.name] != ["vertex", "face"]
        {
            return None;
        }
        let of = |e: &ElementDef| -> Vec<(String, PropertyType)> {
            e.properties.iter().map(|(_, p)| (p.name.clone(), p.data_type.clone())).collect()
        };
        let byte = || PropertyType::Scalar(ScalarType::UChar);
        let both = [Coordinates::Float, Coordinates::Double];
        let forms =
            both.into_iter().flat_map(|c| [false, true].map(|sigma| VertexForm { coordinates: c, sigma }));
        let form = forms.into_iter().find(|form| {
            let number = || match form.coordinates {
                Coordinates::Float => PropertyType::Scalar(ScalarType::Float),
                Coordinates::Double => PropertyType::Scalar(ScalarType::Double),
            };
            let axes = ["x", "y", "z"].map(|axis| (axis.to_owned(), number()));
            let sigma = form.sigma.then(|| ("sigma".to_owned(), PropertyType::Scalar(ScalarType::Float)));
            let rest = [Some((options.kind.clone(), byte())), sigma].into_iter().flatten();
            of(vertex) == axes.into_iter().chain(rest).collect::<Vec<_>>()
        })?;
        let indices = || PropertyType::List(ScalarType::UChar, ScalarType::Int);
        let has_indices = |name: &String| {
            of(face)
                == [
                    (name.clone(), indices()),
                    (options.back.clone(), byte()),
                    (options.front.clone(), byte()),
                ]
        };
        let counts = [vertex.count as u64, face.count as u64];
        let [middle, end] = extents(start, form, counts)?;
        let ours = options.vertex_indices.iter().any(has_indices) && end <= length;
        ours.then_some(Self { form, counts, offsets: [start, middle, end] })
    }
}

/// Reads all of a file in our layout; `None` if anything in it is unusual.
pub(super) fn read(file: &File, layout: &Layout, materials: &[(u8, String, f64)]) -> Option<Raw> {
    let Layout { form, counts, offsets: [start, middle, end] } = *layout;
    let [vertices, faces] = counts.map(usize::try_from);
    let (vertices, faces) = (vertices.ok()?, faces.ok()?);
    let mut raw = Raw { materials: materials.to_vec(), ..Raw::default() };
    let mut pairs = Vec::new();
    // The file has as many bytes as these take, up to a small factor.
    raw.positions.try_reserve_exact(vertices).ok()?;
    raw.kinds.try_reserve_exact(vertices).ok()?;
    raw.triangles.try_reserve_exact(faces).ok()?;
    pairs.try_reserve_exact(faces).ok()?;
    if form.sigma {
        raw.sigmas.try_reserve_exact(vertices).ok()?;
    }
    let size = form.bytes();
    let kinds = kinds_by_code();
    read_blocks(file, start, middle - start, BLOCK * size, |bytes| {
        add_positions(&mut raw.positions, bytes, form);
        add_sigmas(&mut raw.sigmas, bytes, form);
        let codes = bytes.par_chunks_exact(size).with_min_len(TASK);
        raw.kinds.par_extend(codes.map(|v| kinds[usize::from(v[form.kind_at()])]));
        io::Result::Ok(())
    })
    .ok()?;
    read_blocks(file, middle, end - middle, BLOCK * FACE, |bytes| {
        add_faces(&mut raw.triangles, &mut pairs, bytes).ok_or(io::ErrorKind::InvalidData)?;
        io::Result::Ok(())
    })
    .ok()?;
    raw.labels = Labels::Given(pairs);
    Some(raw)
}

/// What every code means.
pub(super) fn kinds_by_code() -> [Option<VertexKind>; 256] {
    std::array::from_fn(|code| VertexKind::from_code(code as u8))
}

/// Adds the positions of whole vertices.
pub(super) fn add_positions(positions: &mut Vec<DVec3>, bytes: &[u8], form: VertexForm) {
    let vertices = bytes.par_chunks_exact(form.bytes()).with_min_len(TASK);
    match form.coordinates {
        Coordinates::Float => positions.par_extend(vertices.map(|v| {
            let number = |i| f64::from(f32::from_le_bytes([v[i], v[i + 1], v[i + 2], v[i + 3]]));
            DVec3::new(number(0), number(4), number(8))
        })),
        Coordinates::Double => positions.par_extend(vertices.map(|v| {
            let number = |i| {
                let mut bytes = [0; 8];
                bytes.copy_from_slice(&v[i..i + 8]);
                f64::from_le_bytes(bytes)
            };
            DVec3::new(number(0), number(8), number(16))
        })),
    }
}

/// Adds the sigmas of whole vertices, if they have one.
pub(super) fn add_sigmas(sigmas: &mut Vec<f32>, bytes: &[u8], form: VertexForm) {
    if form.sigma {
        let at = form.kind_at() + 1;
        let vertices = bytes.par_chunks_exact(form.bytes()).with_min_len(TASK);
        let number = |v: &[u8]| f32::from_le_bytes([v[at], v[at + 1], v[at + 2], v[at + 3]]);
        sigmas.par_extend(vertices.map(|v| read_sigma(number(v))));
    }
}

/// Adds whole faces, in our order of materials; `None`, and nothing added, if one is unusual.
pub(super) fn add_faces(triangles: &mut Vec<[u32; 3]>, pairs: &mut Vec<Pair>, bytes: &[u8]) -> Option<()> {
    let faces = || bytes.par_chunks_exact(FACE).with_min_len(TASK);
    if !faces().all(is_usual) {
        return None;
    }
    // Ids 0 and 1 differ: there always is one, and it is never used.
    let any = Pair::new(MaterialId(1), MaterialId::BACKGROUND)?;
    let pair = move |f: &[u8]| Pair::new(MaterialId(f[13]), MaterialId(f[14])).unwrap_or(any);
    triangles.par_extend(faces().map(|f| {
        let index = |i| u32::from_le_bytes([f[i], f[i + 1], f[i + 2], f[i + 3]]);
        let [a, b, c] = [index(1), index(5), index(9)];
        if pair(f).back().0 == f[13] { [a, b, c] } else { [a, c, b] }
    }));
    pairs.par_extend(faces().map(pair));
    Some(())
}

/// Whether a face is a triangle with indices that are not negative between two materials.
fn is_usual(f: &[u8]) -> bool {
    let is_label = |id: u8| usize::from(id) < MaterialId::MAX_COUNT || id == MaterialId::OUTSIDE.0;
    f[0] == 3 && (f[4] | f[8] | f[12]) < 0x80 && f[13] != f[14] && is_label(f[13]) && is_label(f[14])
}
