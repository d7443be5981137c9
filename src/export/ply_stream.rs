//! [`PlyStream`]: a labelled mesh into a PLY file piece by piece, with the memory of a few blocks.
//!
//! Vertices come before faces in a PLY file, and the counts before both. So vertices go into the
//! file behind a header of fixed length, faces into a scratch file without a name beside it; in the end the
//! faces are appended (by the system, where it can copy within a file system) and the header
//! gets its counts. The bytes do not depend on how the mesh was cut into pieces.

use std::io::{self, Read, Seek, Write};
use std::path::Path;

use super::ExportError;
use super::block_writer::BlockWriter;
use super::ply_encode::{self, Pairs, Vertices};
use super::ply_layout::{MOST_VERTICES, PlyOptions, header};
use super::staging::StagedFile;
use crate::execution::Execution;
use crate::grid::{MaterialId, Pair};
use crate::mesh::{InterfaceMesh, MeshMaterial, MeshPiece, ShellPiece};

/// Elements in a block: about a megabyte.
const BLOCK: usize = 1 << 16;
/// Bytes copied between two looks at whether to stop.
const COPY: u64 = 64 << 20;

/// Writes a labelled mesh that comes in pieces to a PLY file, whole or not at all: the file appears
/// at its path with [`PlyStream::finish`]; dropped before, nothing is left behind.
#[derive(Debug)]
pub struct PlyStream {
    // Before `staged`: files are closed before they are removed.
    writer: BlockWriter,
    staged: StagedFile,
    options: PlyOptions,
    materials: Vec<MeshMaterial>,
    /// Vertices and faces so far.
    counts: [u64; 2],
    /// One more than the highest vertex number that a face names.
    needed: u64,
    /// The counts in the end, if they were known in the beginning.
    known: Option<[u64; 2]>,
    /// Whether vertices have a sigma, once that is known: the header waits for it.
    sigma: Option<bool>,
}

/// The file of the vertices among those of the writer.
const VERTICES: usize = 0;
/// The scratch file.
const SCRATCH: usize = 1;

impl PlyStream {
    /// Begins the file `path` of a mesh of these materials.
    ///
    /// # Errors
    /// [`ExportError`] naming `path` if nothing can be written there.
    pub fn create(path: &Path, materials: &[MeshMaterial], options: PlyOptions) -> Result<Self, ExportError> {
        Self::begin(path, materials, options, None)
    }

    /// With counts that are known, faces go behind the vertices at once.
    fn begin(
        path: &Path,
        materials: &[MeshMaterial],
        options: PlyOptions,
        known: Option<[u64; 2]>,
    ) -> Result<Self, ExportError> {
        let failed = |e| ExportError::writing(path, e);
        let (staged, file) = StagedFile::create(path)?;
        let mut files = vec![file];
        if known.is_none() {
            files.push(staged.scratch()?);
        }
        let writer = BlockWriter::start(files).map_err(failed)?;
        let materials = materials.to_vec();
        Ok(Self { writer, staged, options, materials, counts: [0; 2], needed: 0, known, sigma: None })
    }

    /// Adds the next piece: its own vertices, and its triangles.
    ///
    /// # Errors
    /// [`ExportError`] naming the file: [`ExportError::TooLarge`] as soon as there are more vertices than
    /// `int` counts, [`ExportError::Pieces`] if this is not the next piece; an error of the disk may be
    /// told by a later call than the one whose bytes it concerns.
    pub fn add(&mut self, piece: &MeshPiece) -> Result<(), ExportError> {
        let MeshPiece { mesh, owned, first_vertex, first_triangle, .. } = piece;
        if [*first_vertex, *first_triangle] != self.counts || *owned > mesh.positions().len() {
            return Err(self.wrong(format!(
                "a piece from vertex {first_vertex} and triangle {first_triangle} on, where vertex {} and triangle {} are next",
                self.counts[0], self.counts[1]
            )));
        }
        self.room(first_vertex.saturating_add(mesh.positions().len() as u64))?;
        self.vertices(Vertices::of(mesh, *owned))?;
        // It fits: all of the piece's vertices were found to.
        let offset = *first_vertex as u32;
        self.needed = self.needed.max(first_vertex + mesh.positions().len() as u64);
        self.faces(mesh.triangles(), offset, Pairs::Each(mesh.pairs()))
    }

    /// Puts the file in place.
    ///
    /// # Errors
    /// [`ExportError`] naming the file; [`ExportError::Pieces`] if the last piece still had a seam,
    /// [`ExportError::Cancelled`] if the execution was.
    pub fn finish(mut self, execution: &Execution) -> Result<(), ExportError> {
        if self.needed > self.counts[0] {
            let (needed, there) = (self.needed, self.counts[0]);
            return Err(self.wrong(format!("faces need {needed} vertices, but there are {there}")));
        }
        if self.known.is_some_and(|known| known != self.counts) {
            return Err(self.wrong("not as many vertices and faces as were promised".to_owned()));
        }
        let sigma = self.begun(false)?;
        let Self { writer, staged, options, materials, counts, known, .. } = self;
        let failed = |e| ExportError::writing(staged.target(), e);
        let mut files = writer.finish().map_err(failed)?.into_iter();
        let (file, scratch) = (files.next(), files.next());
        let mut file = file.ok_or_else(|| failed(io::ErrorKind::NotFound.into()))?;
        if let Some(mut scratch) = scratch {
            scratch.rewind().map_err(failed)?;
            // By the system itself where it can, as `copy` knows.
            while io::copy(&mut (&scratch).take(COPY), &mut file).map_err(failed)? > 0 {
                execution.check()?;
            }
        }
        if known.is_none() {
            file.rewind().map_err(failed)?;
            file.write_all(&header(&materials, options, sigma, counts).map_err(failed)?).map_err(failed)?;
        }
        execution.check()?;
        staged.commit(file)
    }

    fn wrong(&self, what: String) -> ExportError {
        ExportError::Pieces { path: self.staged.target().to_owned(), what }
    }

    /// Refuses more vertices than there can be.
    fn room(&self, vertices: u64) -> Result<(), ExportError> {
        if vertices <= MOST_VERTICES {
            return Ok(());
        }
        Err(ExportError::TooLarge {
            path: self.staged.target().to_owned(),
            what: format!("at least {vertices} vertices; PLY's int indices reach {MOST_VERTICES}"),
        })
    }

    fn send(
        &mut self,
        file: usize,
        fill: impl FnOnce(&mut Vec<u8>) -> io::Result<()>,
    ) -> Result<(), ExportError> {
        let mut bytes = self.writer.buffer();
        let sent = fill(&mut bytes).and_then(|()| self.writer.send(file, bytes));
        sent.map_err(|e| ExportError::writing(self.staged.target(), e))
    }

    /// Begins the file, if it has not been: with a sigma for each vertex or without. Returns which.
    fn begun(&mut self, sigma: bool) -> Result<bool, ExportError> {
        if let Some(sigma) = self.sigma {
            return Ok(sigma);
        }
        self.sigma = Some(sigma);
        let counts = self.known.unwrap_or_default();
        let head = header(&self.materials, self.options, sigma, counts);
        let head = head.map_err(|e| ExportError::writing(self.staged.target(), e))?;
        self.send(VERTICES, |bytes| {
            *bytes = head;
            Ok(())
        })?;
        Ok(sigma)
    }

    fn vertices(&mut self, all: Vertices<'_>) -> Result<(), ExportError> {
        // A piece without vertices does not know whether others have sigmas.
        if all.positions.is_empty() {
            return Ok(());
        }
        if self.begun(all.sigmas.is_some())? != all.sigmas.is_some() {
            return Err(self.wrong("some of the vertices with a sigma and some without".to_owned()));
        }
        let options = self.options;
        for part in all.chunks(BLOCK) {
            self.send(VERTICES, |bytes| ply_encode::vertices(bytes, part, options))?;
        }
        self.counts[0] += all.positions.len() as u64;
        Ok(())
    }

    fn faces(&mut self, triangles: &[[u32; 3]], offset: u32, pairs: Pairs<'_>) -> Result<(), ExportError> {
        let options = self.options;
        let file = if self.known.is_some() { VERTICES } else { SCRATCH };
        if file == VERTICES {
            self.begun(false)?;
        }
        for (k, triangles) in triangles.chunks(BLOCK).enumerate() {
            let pairs = pairs.from(k * BLOCK);
            self.send(file, |bytes| ply_encode::faces(bytes, triangles, offset, pairs, options))?;
        }
        self.counts[1] += triangles.len() as u64;
        Ok(())
    }
}

/// Writes `mesh` to the PLY file `path`, whole or not at all: the bytes that a [`PlyStream`] writes.
///
/// # Errors
/// [`ExportError`] naming `path`; [`ExportError::TooLarge`] if there are more vertices than `int` counts.
pub fn write_ply(path: &Path, mesh: &InterfaceMesh, options: PlyOptions) -> Result<(), ExportError> {
    let counts = [mesh.positions().len() as u64, mesh.triangles().len() as u64];
    let mut out = PlyStream::begin(path, mesh.materials(), options, Some(counts))?;
    out.room(counts[0])?;
    out.vertices(Vertices::of(mesh, mesh.positions().len()))?;
    out.faces(mesh.triangles(), 0, Pairs::Each(mesh.pairs()))?;
    out.finish(&Execution::default())
}

/// Writes one material's shell that comes in portions to a PLY file: the material behind every triangle,
/// the background in front, whatever is really there. Appears at its path with
/// [`ShellPlyStream::finish`]; dropped before, nothing is left behind.
#[derive(Debug)]
pub struct ShellPlyStream {
    stream: PlyStream,
    pair: Pair,
}

impl ShellPlyStream {
    /// Begins the file `path` of the shell of `material`; `materials` are those of the mesh.
    ///
    /// # Errors
    /// [`ExportError`] naming `path` if nothing can be written there;
    /// [`ExportError::Pieces`] for the background, which has no shell.
    pub fn create(
        path: &Path,
        materials: &[MeshMaterial],
        material: MaterialId,
        options: PlyOptions,
    ) -> Result<Self, ExportError> {
        let Some(pair) = Pair::new(material, MaterialId::BACKGROUND) else {
            let what = "the background has no shell".to_owned();
            return Err(ExportError::Pieces { path: path.to_owned(), what });
        };
        let shown: Vec<_> = materials.iter().filter(|m| pair.contains(m.id)).cloned().collect();
        Ok(Self { stream: PlyStream::create(path, &shown, options)?, pair })
    }

    /// Adds vertices (they are numbered in the order in which they come) and triangles in these numbers. A
    /// triangle may name a vertex that comes later.
    ///
    /// # Errors
    /// As [`PlyStream::add`]; [`ExportError::Pieces`] if there is not one kind for each vertex, or sigmas for some only.
    pub fn add(&mut self, piece: &ShellPiece) -> Result<(), ExportError> {
        let stream = &mut self.stream;
        let ShellPiece { positions, kinds, sigmas, triangles } = piece;
        if positions.len() != kinds.len() {
            return Err(stream.wrong(format!("{} vertices with {} kinds", positions.len(), kinds.len())));
        }
        if !sigmas.is_empty() && sigmas.len() != positions.len() {
            return Err(stream.wrong(format!("{} vertices with {} sigmas", positions.len(), sigmas.len())));
        }
        let sigmas = (!sigmas.is_empty()).then_some(sigmas.as_slice());
        let needed = triangles.iter().flatten().max().map_or(0, |&v| u64::from(v) + 1);
        stream.room(needed.max(stream.counts[0].saturating_add(positions.len() as u64)))?;
        stream.needed = stream.needed.max(needed);
        stream.vertices(Vertices { positions, kinds, sigmas })?;
        stream.faces(triangles, 0, Pairs::All(self.pair))
    }

    /// Puts the file in place.
    ///
    /// # Errors
    /// As [`PlyStream::finish`].
    pub fn finish(self, execution: &Execution) -> Result<(), ExportError> {
        self.stream.finish(execution)
    }
}

#[cfg(test)]
#[path = "ply_tests.rs"]
pub(super) mod tests;
