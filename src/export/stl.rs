//! Binary STL writer for one material's shell.
//!
//! STL knows no units and no labels, so the header says both: the material's name and `mm`.
//! Coordinates are f32, as the format demands; normals are worked out from the full coordinates.

use std::io::Write;
use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::{ExportError, write_atomically};
use crate::mesh::{InterfaceMesh, Shell};

/// Bytes of an STL header.
pub(super) const HEADER: usize = 80;
/// Bytes of a triangle in a binary STL: normal, three corners, two bytes of attributes.
pub(super) const TRIANGLE: usize = 50;

/// Writes a shell to the binary STL file `path`, whole or not at all. `name` is the material's.
///
/// # Errors
/// [`ExportError`] naming `path`; [`ExportError::TooLarge`] for more than 2^32 - 1 triangles.
pub fn write_stl(path: &Path, shell: &Shell, name: &str) -> Result<(), ExportError> {
    let count = u32::try_from(shell.triangles.len()).map_err(|_| ExportError::TooLarge {
        path: path.to_owned(),
        what: format!("{} triangles; STL counts to {}", shell.triangles.len(), u32::MAX),
    })?;
    write_atomically(path, |out| {
        out.write_all(&header(name))?;
        out.write_all(&count.to_le_bytes())?;
        for triangle in &shell.triangles {
            let corners = triangle.map(|v| shell.positions[v as usize]);
            let [a, b, c] = corners;
            // Scaled first: the cross product of tiny sides must not vanish.
            let (s, t) = (b - a, c - a);
            let size = s.abs().max(t.abs()).max_element();
            let normal =
                if size > 0.0 { (s / size).cross(t / size).normalize_or_zero() } else { DVec3::ZERO };
            let mut bytes = [0; TRIANGLE];
            let numbers = [normal, a, b, c].into_iter().flat_map(|v| v.to_array());
            for (place, number) in bytes.chunks_exact_mut(4).zip(numbers) {
                place.copy_from_slice(&(number as f32).to_le_bytes());
            }
            out.write_all(&bytes)?;
        }
        out.flush()
    })
}

/// How many vertices of `mesh` STL's `f32` coordinates make one with another: none unless the mesh
/// lies far from the world's origin for the size of its triangles. A shell in which that happens
/// is in general no longer closed or manifold for a reader.
#[must_use]
pub fn vertices_merged_by_stl(mesh: &InterfaceMesh) -> usize {
    let rounded = |p: &DVec3| p.to_array().map(|c| (c as f32 + 0.0).to_bits()); // -0 is 0
    let mut places: Vec<[u32; 3]> = mesh.positions().par_iter().map(rounded).collect();
    places.par_sort_unstable();
    places.dedup();
    mesh.positions().len() - places.len()
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
    use crate::execution::Execution;
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
        let other = stl_io::read_stl(&mut std::fs::File::open(&path).unwrap()).unwrap();
        for face in &other.faces {
            let middle: f32 = face
                .vertices
                .iter()
                .map(|&v| (0..3).map(|a| (other.vertices[v][a] - 0.5) * face.normal[a]).sum::<f32>())
                .sum();
            assert!((middle - 1.5).abs() < 1e-6);
        }
    }
}
