//! [`PlyPieces`]: a labelled mesh out of a PLY file piece by piece, with the memory of a piece.
//!
//! Only files in the layout that we write. A first look at all faces finds out, for every block of them, the
//! lowest vertex that is still needed from there on; so a mesh in the order of layers, as contouring leaves it, is
//! cut into pieces of a few layers each. (Of a mesh in no order the pieces hold as many vertices as they must.)

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use glam::DVec3;
use rayon::prelude::*;

use super::ExportError;
use super::block_reader::read_blocks;
use super::ply_decode::{Layout, add_faces, add_positions, add_sigmas, kinds_by_code};
use super::ply_layout::FACE;
use super::ply_read::{Start, material_comments, start};
use super::read::ReadOptions;
use crate::grid::{MaterialId, VertexKind};
use crate::mesh::{InterfaceMesh, MeshMaterial, MeshPiece};

/// Faces in a piece.
const FACES: usize = 1 << 18;

/// A PLY file in our layout whose mesh can be gone through any number of times.
#[derive(Debug)]
pub struct PlyPieces {
    path: PathBuf,
    file: File,
    layout: Layout,
    materials: Vec<MeshMaterial>,
    /// For each piece the first vertex that it or a later one names, and one more than the last that it or
    /// an earlier one names.
    windows: Vec<[u64; 2]>,
}

/// Vertices that a piece needs.
#[derive(Debug, Clone, Default)]
struct Held {
    positions: Vec<DVec3>,
    kinds: Vec<VertexKind>,
    /// Empty if the file has none.
    sigmas: Vec<f32>,
}

impl PlyPieces {
    /// Opens a file and looks through its faces.
    ///
    /// # Errors
    /// [`ExportError`] naming the file: [`ExportError::Malformed`] also for a PLY file in another layout
    /// than ours, which only [`read_mesh`](super::read_mesh) can read.
    pub fn open(path: &Path, options: &ReadOptions) -> Result<Self, ExportError> {
        let failed = |source| ExportError::Read { path: path.to_owned(), source };
        let bad = |what: &str| ExportError::malformed(path, "PLY", what);
        let file = File::open(path).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        let mut input = BufReader::new(file);
        let Start { header, used, .. } = start(&mut input, length).map_err(|what| bad(&what))?;
        let layout = Layout::recognise(&header, used, length, options)
            .ok_or_else(|| bad("it is not laid out as this program does, or ends too early"))?;
        let materials = material_comments(&header)
            .into_iter()
            .map(|(id, name, mean)| MeshMaterial { id: MaterialId(id), name, mean })
            .collect();
        let file = input.into_inner();
        let mut windows = Vec::new();
        let [_, middle, end] = layout.offsets;
        read_blocks(&file, middle, end - middle, FACES * FACE, |bytes| {
            windows.push(window(bytes));
            io::Result::Ok(())
        })
        .map_err(failed)?;
        let vertices = layout.counts[0];
        if windows.iter().any(|w| w[1] > vertices) {
            return Err(bad("a face names a vertex that is not there"));
        }
        // What is needed before the end, seen from there; and what has been needed so far.
        let (mut low, mut high) = (vertices, 0);
        windows.iter_mut().rev().for_each(|w| {
            low = low.min(w[0]);
            w[0] = low;
        });
        for i in 0..windows.len() {
            // A piece also holds what comes before the next one begins.
            let next = windows.get(i + 1).map_or(vertices, |w| w[0]);
            high = next.max(windows[i][1]).max(high);
            windows[i][1] = high;
        }
        if let Some(first) = windows.first_mut() {
            first[0] = 0;
        }
        Ok(Self { path: path.to_owned(), file, layout, materials, windows })
    }

    /// The materials that the file lists.
    #[must_use]
    pub fn materials(&self) -> &[MeshMaterial] {
        &self.materials
    }

    /// Vertices and triangles of the whole mesh.
    #[must_use]
    pub fn counts(&self) -> [u64; 2] {
        self.layout.counts
    }

    /// Goes through the mesh from its beginning. A file without faces has no pieces.
    ///
    /// # Errors
    /// The first error of `take`; [`ExportError`] naming the file if it cannot be read or holds something
    /// that is not a mesh of ours.
    pub fn each<E: From<ExportError>>(
        &self,
        mut take: impl FnMut(&MeshPiece) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut held = Held::default();
        let (mut first_vertex, mut first_triangle) = (0, 0);
        for (i, &[_, end]) in self.windows.iter().enumerate() {
            self.read_vertices(first_vertex + held.positions.len() as u64, end, &mut held)?;
            let next = self.windows.get(i + 1).map_or(self.layout.counts[0], |w| w[0]);
            let owned = (next - first_vertex) as usize;
            let mesh = self.read_faces(first_triangle, first_vertex, held.clone())?;
            let needed_later = |t: &[u32; 3]| t.iter().any(|&v| v as usize >= owned);
            let triangles = mesh.triangles().len();
            let last = mesh.triangles().par_iter().position_first(needed_later).unwrap_or(triangles);
            take(&MeshPiece { mesh, owned, last_layer: [owned, last], first_vertex, first_triangle })?;
            held.positions.drain(..owned);
            held.kinds.drain(..owned);
            held.sigmas.drain(..owned.min(held.sigmas.len()));
            first_vertex = next;
            first_triangle += triangles as u64;
        }
        Ok(())
    }

    fn bytes(&self, start: u64, length: u64) -> Result<Vec<u8>, ExportError> {
        let mut bytes = Vec::new();
        let mut read = || {
            let mut file = &self.file;
            file.seek(SeekFrom::Start(start))?;
            // What is there, and no more, is made room for.
            if file.take(length).read_to_end(&mut bytes)? as u64 != length {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            Ok(())
        };
        read().map_err(|source| ExportError::Read { path: self.path.clone(), source })?;
        Ok(bytes)
    }

    fn bad(&self, what: &str) -> ExportError {
        ExportError::malformed(&self.path, "PLY", what)
    }

    fn read_vertices(&self, from: u64, to: u64, held: &mut Held) -> Result<(), ExportError> {
        let form = self.layout.form;
        let size = form.bytes();
        let bytes = self.bytes(self.layout.offsets[0] + from * size as u64, (to - from) * size as u64)?;
        add_positions(&mut held.positions, &bytes, form);
        add_sigmas(&mut held.sigmas, &bytes, form);
        let by_code = kinds_by_code();
        for vertex in bytes.chunks_exact(size) {
            let kind = by_code[usize::from(vertex[form.kind_at()])];
            held.kinds.push(kind.ok_or_else(|| self.bad("a vertex is of no known kind"))?);
        }
        Ok(())
    }

    /// The mesh of the faces from `first` on with these vertices, which begin with vertex `offset`.
    fn read_faces(&self, first: u64, offset: u64, vertices: Held) -> Result<InterfaceMesh, ExportError> {
        let count = (self.layout.counts[1] - first).min(FACES as u64);
        let bytes = self.bytes(self.layout.offsets[1] + first * FACE as u64, count * FACE as u64)?;
        let (mut triangles, mut pairs) = (Vec::new(), Vec::new());
        add_faces(&mut triangles, &mut pairs, &bytes)
            .ok_or_else(|| self.bad("a face is not a triangle between two materials"))?;
        // An index below it would be a file that has changed since it was looked through.
        triangles
            .par_iter_mut()
            .for_each(|t: &mut [u32; 3]| *t = t.map(|v| u64::from(v).wrapping_sub(offset) as u32));
        let Held { positions, kinds, sigmas } = vertices;
        InterfaceMesh::new(positions, kinds, triangles, pairs, self.materials.clone())
            .and_then(|mesh| mesh.with_sigmas(sigmas))
            .map_err(|source| ExportError::Mesh { path: self.path.clone(), source })
    }
}

/// The lowest vertex that some faces name, and one more than the highest.
fn window(faces: &[u8]) -> [u64; 2] {
    let of = |f: &[u8]| {
        let index = |i: usize| u64::from(u32::from_le_bytes([f[i], f[i + 1], f[i + 2], f[i + 3]]));
        let [a, b, c] = [index(1), index(5), index(9)];
        [a.min(b).min(c), a.max(b).max(c) + 1]
    };
    let both = |a: [u64; 2], b: [u64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
    faces.par_chunks_exact(FACE).with_min_len(1 << 12).map(of).reduce(|| [u64::MAX, 0], both)
}
