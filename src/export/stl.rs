//! Binary STL writer for one material's shell.
//!
//! STL knows no units and no labels, so the header says both: the material's name and `mm`.
//! Coordinates are f32, as the format demands; normals are worked out from the full coordinates.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::ExportError;
use super::block_writer::BlockWriter;
use super::staging::StagedFile;
use crate::execution::Execution;
use crate::mesh::Shell;

/// Bytes of an STL header.
pub(super) const HEADER: usize = 80;
/// Bytes of a triangle in a binary STL: normal, three corners, two bytes of attributes.
pub(super) const TRIANGLE: usize = 50;
/// Triangles in a block: about a megabyte.
const BLOCK: usize = 1 << 14;
/// Triangles that a task encodes at least.
const TASK: usize = 1 << 11;

/// Writes a shell that comes in portions to a binary STL file, whole or not at all: the file appears at
/// its path with [`StlStream::finish`]; dropped before, nothing is left behind.
#[derive(Debug)]
pub struct StlStream {
    // Before `staged`: files are closed before they are removed.
    writer: BlockWriter,
    staged: StagedFile,
    /// Triangles so far.
    count: u32,
}

impl StlStream {
    /// Begins the file `path`. `name` is the material's.
    ///
    /// # Errors
    /// [`ExportError`] naming `path` if nothing can be written there.
    pub fn create(path: &Path, name: &str) -> Result<Self, ExportError> {
        let failed = |e| ExportError::writing(path, e);
        let (staged, mut file) = StagedFile::create(path)?;
        file.write_all(&header(name)).and_then(|()| file.write_all(&[0; 4])).map_err(failed)?;
        let writer = BlockWriter::start(vec![file]).map_err(failed)?;
        Ok(Self { writer, staged, count: 0 })
    }

    /// Adds `count` triangles; `corners` tells the corners (world, mm) of each, counter-clockwise seen from
    /// outside the material. It is asked from several threads.
    ///
    /// # Errors
    /// [`ExportError`] naming the file: [`ExportError::TooLarge`] as soon as there are more than 2^32 - 1
    /// triangles; an error of the disk may be told by a later call than the one whose bytes it concerns.
    pub fn add(
        &mut self,
        count: usize,
        corners: impl Fn(usize) -> [DVec3; 3] + Sync,
    ) -> Result<(), ExportError> {
        self.count = u32::try_from(u64::from(self.count).saturating_add(count as u64)).map_err(|_| {
            ExportError::TooLarge {
                path: self.staged.target().to_owned(),
                what: format!("more than {} triangles, which is as far as STL counts", u32::MAX),
            }
        })?;
        for start in (0..count).step_by(BLOCK) {
            let mut bytes = self.writer.buffer();
            bytes.resize(TRIANGLE * BLOCK.min(count - start), 0);
            let triangles = bytes.par_chunks_exact_mut(TRIANGLE).with_min_len(TASK).enumerate();
            triangles.for_each(|(i, bytes)| encode(bytes, corners(start + i)));
            self.writer.send(0, bytes).map_err(|e| ExportError::writing(self.staged.target(), e))?;
        }
        Ok(())
    }

    /// Puts the file in place.
    ///
    /// # Errors
    /// [`ExportError`] naming the file; [`ExportError::Cancelled`] if the execution was.
    pub fn finish(self, execution: &Execution) -> Result<(), ExportError> {
        let Self { writer, staged, count } = self;
        let counted = |mut file: File| {
            file.seek(SeekFrom::Start(HEADER as u64))?;
            file.write_all(&count.to_le_bytes())?;
            Ok(file)
        };
        let file = writer.finish().and_then(|files| {
            files.into_iter().next().ok_or(io::ErrorKind::NotFound.into()).and_then(counted)
        });
        let file = file.map_err(|e| ExportError::writing(staged.target(), e))?;
        execution.check()?;
        staged.commit(file)
    }
}

/// Writes a shell to the binary STL file `path`, whole or not at all. `name` is the material's.
///
/// # Errors
/// [`ExportError`] naming `path`; [`ExportError::TooLarge`] for more than 2^32 - 1 triangles.
pub fn write_stl(path: &Path, shell: &Shell, name: &str) -> Result<(), ExportError> {
    let mut out = StlStream::create(path, name)?;
    out.add(shell.triangles.len(), |t| shell.triangles[t].map(|v| shell.positions[v as usize]))?;
    out.finish(&Execution::default())
}

/// Puts a triangle into `bytes`.
fn encode(bytes: &mut [u8], [a, b, c]: [DVec3; 3]) {
    // Scaled first: the cross product of tiny sides must not vanish.
    let (s, t) = (b - a, c - a);
    let size = s.abs().max(t.abs()).max_element();
    let normal = if size > 0.0 { (s / size).cross(t / size).normalize_or_zero() } else { DVec3::ZERO };
    for (bytes, v) in bytes.chunks_exact_mut(12).zip([normal, a, b, c]) {
        let [x, y, z] = v.to_array().map(|c| (c as f32).to_le_bytes());
        bytes[..4].copy_from_slice(&x);
        bytes[4..8].copy_from_slice(&y);
        bytes[8..].copy_from_slice(&z);
    }
    // Buffers are used again.
    bytes[48..].fill(0);
}

/// The header: never starts with `solid`, by which readers know text files. Non-ASCII letters of
/// the name become `?`, as the format has no encoding.
fn header(name: &str) -> [u8; HEADER] {
    let text = format!("interfacet {} unit mm material {name}", env!("CARGO_PKG_VERSION"));
    let mut header = [b' '; HEADER];
    for (place, c) in header.iter_mut().zip(text.chars()) {
        *place = if c.is_ascii() && !c.is_ascii_control() { c as u8 } else { b'?' };
    }
    header
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::{ReadOptions, read_mesh};
    use crate::grid::MaterialId;
    use crate::mesh::check::{CheckOptions, check};
    use crate::mesh::fixtures::voxel_faces;
    use crate::mesh::split;

    #[test]
    fn a_shell_goes_out_and_comes_back_closed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.stl");
        let shell = split(&voxel_faces([2, 1, 1], &[1, 2], 0), MaterialId(1));
        write_stl(&path, &shell, "Stahl, gehärtet\n").unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(bytes.len(), HEADER + 4 + TRIANGLE * 12);
        assert!(bytes.starts_with(b"interfacet ") && !bytes[..HEADER].contains(&b'\n'));
        let back = read_mesh(&path, &ReadOptions::default()).unwrap();
        assert_eq!(back.positions().len(), 8);
        assert!(check(&back, &CheckOptions::default(), &Execution::default()).unwrap().is_empty());
        // Another reader agrees, also about the normals: they point away from the cube's middle.
        let other = stl_io::read_stl(&mut File::open(&path).unwrap()).unwrap();
        for face in &other.faces {
            let middle: f32 = face
                .vertices
                .iter()
                .map(|&v| (0..3).map(|a| (other.vertices[v][a] - 0.5) * face.normal[a]).sum::<f32>())
                .sum();
            assert!((middle - 1.5).abs() < 1e-6);
        }
    }

    #[test]
    fn portions_make_the_same_file_and_too_many_triangles_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let [whole, cut] = ["whole.stl", "cut.stl"].map(|name| folder.path().join(name));
        let shell = split(&voxel_faces([3, 2, 1], &[1, 2, 1, 1, 1, 2], 0), MaterialId(1));
        write_stl(&whole, &shell, "a").unwrap();
        let mut out = StlStream::create(&cut, "a").unwrap();
        for portion in shell.triangles.chunks(7) {
            out.add(portion.len(), |t| portion[t].map(|v| shell.positions[v as usize])).unwrap();
        }
        out.finish(&Execution::default()).unwrap();
        assert!(std::fs::read(&whole).unwrap() == std::fs::read(&cut).unwrap());
        let mut out = StlStream::create(&cut, "a").unwrap();
        out.count = u32::MAX - 1;
        out.add(1, |_| [DVec3::ZERO; 3]).unwrap();
        let error = out.add(1, |_| [DVec3::ZERO; 3]).unwrap_err();
        assert!(matches!(error, ExportError::TooLarge { .. }) && error.to_string().contains("4294967295"));
    }
}
