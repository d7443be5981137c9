//! Reads a mesh file, whatever its format: by its first bytes, then by its name.

use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::{ExportError, ply_read, stl_read};
use crate::grid::{MaterialId, Pair, VertexKind};
use crate::mesh::{InterfaceMesh, MeshMaterial, kinds_from_labels};

/// Options of [`read_mesh`]: what other tools call things in a PLY file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReadOptions {
    /// The face property with the label behind a triangle.
    pub back: String,
    /// The face property with the label in front of a triangle, where its normal points.
    pub front: String,
    /// The vertex property with the kind's code.
    pub kind: String,
    /// The names that the list of a face's vertices may have.
    pub vertex_indices: Vec<String>,
}

impl Default for ReadOptions {
    /// The names we write: `material_back`, `material_front`, `kind`; `vertex_indices` or `vertex_index`.
    fn default() -> Self {
        Self {
            back: "material_back".to_owned(),
            front: "material_front".to_owned(),
            kind: "kind".to_owned(),
            vertex_indices: vec!["vertex_indices".to_owned(), "vertex_index".to_owned()],
        }
    }
}

/// Reads a PLY or STL file.
///
/// A file without labels is read as one material, 1, in air. Labels that are not in our order (the
/// denser material behind) are swapped and their triangles flipped; the label -1 is `OUTSIDE` as
/// 255 is. Kinds that are missing or unknown are worked out from the labels round each vertex.
/// The corners of an STL's triangles are one vertex where their coordinates are equal bit for bit.
///
/// # Errors
/// [`ExportError`] naming the file, what is wrong with it and where.
pub fn read_mesh(path: &Path, options: &ReadOptions) -> Result<InterfaceMesh, ExportError> {
    let failed = |source| ExportError::Read { path: path.to_owned(), source };
    let unknown = |what: &str| ExportError::UnknownFormat { path: path.to_owned(), what: what.to_owned() };
    let mut file = File::open(path).map_err(failed)?;
    let about = file.metadata().map_err(failed)?;
    if !about.is_file() {
        return Err(unknown("it is not a regular file"));
    }
    let mut head = Vec::new();
    file.by_ref().take(512).read_to_end(&mut head).map_err(failed)?;
    file.rewind().map_err(failed)?;
    let named = |ending: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    let raw = if head.is_empty() {
        return Err(unknown("the file is empty"));
    } else if head.starts_with(b"ply\n") || head.starts_with(b"ply\r") {
        ply_read::read(path, file, about.len(), options)?
    } else if stl_read::looks_right(&head, about.len()) || named("stl") {
        stl_read::read(path, file, about.len())?
    } else if named("ply") {
        return Err(ExportError::malformed(path, "PLY", "it does not start with the line 'ply'"));
    } else {
        return Err(unknown("it starts neither like a PLY nor like an STL file"));
    };
    raw.into_mesh(path)
}

/// What a reader gathers.
#[derive(Default)]
pub(super) struct Raw {
    pub(super) positions: Vec<DVec3>,
    /// One per vertex, or empty if the file has none.
    pub(super) kinds: Vec<Option<VertexKind>>,
    /// One per vertex, or empty if the file has none.
    pub(super) sigmas: Vec<f32>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) labels: Labels,
    /// Id, name, mean.
    pub(super) materials: Vec<(u8, String, f64)>,
}

/// The labels of a file's triangles.
#[derive(Default)]
pub(super) enum Labels {
    /// There are none.
    #[default]
    None,
    /// One pair for each triangle.
    Given(Vec<Pair>),
}

impl Raw {
    /// Adds a polygon as a fan of triangles.
    pub(super) fn add_polygon(&mut self, corners: &[u32], back: f64, front: f64) -> Result<(), String> {
        if corners.len() < 3 {
            return Err(format!("a face with {} vertices", corners.len()));
        }
        let mut flip = false;
        if let Labels::Given(pairs) = &mut self.labels {
            let (back, front) = (label(back)?, label(front)?);
            let pair = Pair::new(back, front)
                .ok_or_else(|| format!("the same material, {}, on both sides", back.0))?;
            flip = pair.back() != back;
            pairs.extend(std::iter::repeat_n(pair, corners.len() - 2));
        }
        for two in corners[1..].windows(2) {
            self.triangles.push(if flip {
                [corners[0], two[1], two[0]]
            } else {
                [corners[0], two[0], two[1]]
            });
        }
        Ok(())
    }

    fn into_mesh(self, path: &Path) -> Result<InterfaceMesh, ExportError> {
        let pairs = match self.labels {
            Labels::Given(pairs) => pairs,
            Labels::None => {
                // Ids 1 and 0 always differ, so there is always a pair.
                let pair = Pair::new(MaterialId(1), MaterialId::BACKGROUND);
                pair.into_iter().cycle().take(self.triangles.len()).collect()
            }
        };
        let mut materials = self.materials;
        let mut known = [false; 256];
        materials.retain(|m| !std::mem::replace(&mut known[usize::from(m.0)], true));
        for id in named(&pairs) {
            if id != MaterialId::OUTSIDE && !std::mem::replace(&mut known[usize::from(id.0)], true) {
                let name = if id == MaterialId::BACKGROUND {
                    "air".to_owned()
                } else {
                    format!("material {}", id.0)
                };
                materials.push((id.0, name, f64::NAN));
            }
        }
        materials.sort_by_key(|m| m.0);
        let materials = materials
            .into_iter()
            .map(|(id, name, mean)| MeshMaterial { id: MaterialId(id), name, mean })
            .collect();
        // A bad index must be refused before kinds are looked up by it.
        let n = self.positions.len();
        let is_bad = |t: &[u32; 3]| t.iter().any(|&v| v as usize >= n);
        if let Some(t) = self.triangles.par_iter().position_first(is_bad) {
            let vertex = self.triangles[t].into_iter().find(|&v| v as usize >= n).unwrap_or(0);
            let source = crate::mesh::MeshError::Index { triangle: t, vertex, vertices: n };
            return Err(ExportError::Mesh { path: path.to_owned(), source });
        }
        let kinds = if self.kinds.par_iter().all(Option::is_some) && self.kinds.len() == n {
            self.kinds.into_iter().flatten().collect()
        } else {
            let mut kinds = kinds_from_labels(n, &self.triangles, &pairs);
            for (kind, given) in kinds.iter_mut().zip(self.kinds) {
                *kind = given.unwrap_or(*kind);
            }
            kinds
        };
        InterfaceMesh::new(self.positions, kinds, self.triangles, pairs, materials)
            .and_then(|mesh| mesh.with_sigmas(self.sigmas))
            .map_err(|source| ExportError::Mesh { path: path.to_owned(), source })
    }
}

/// All materials that pairs name, ascending.
fn named(pairs: &[Pair]) -> Vec<MaterialId> {
    let none = || vec![false; 256];
    let seen = pairs.par_iter().fold(none, |mut seen, pair| {
        seen[usize::from(pair.back().0)] = true;
        seen[usize::from(pair.front().0)] = true;
        seen
    });
    let seen = seen.reduce(none, |a, b| a.iter().zip(b).map(|(a, b)| a | b).collect());
    (0..=255).filter(|&id| seen[usize::from(id)]).map(MaterialId).collect()
}

#[allow(clippy::float_cmp)] // a label is a whole number or it is none
fn label(value: f64) -> Result<MaterialId, String> {
    match value {
        v if v == -1.0 || v == 255.0 => Ok(MaterialId::OUTSIDE),
        v if v.fract() == 0.0 && (0.0..MaterialId::MAX_COUNT as f64).contains(&v) => Ok(MaterialId(v as u8)),
        v => Err(format!(
            "the label {v}; labels are 0 to {}, and 255 or -1 for outside",
            MaterialId::MAX_COUNT - 1
        )),
    }
}

/// Text from a file or a library as one line of bounded length: files may put anything into it.
pub(super) fn bounded(text: &str) -> String {
    const MOST: usize = 300;
    let words: Vec<_> = text.split_whitespace().map(|w| w.replace(char::is_control, "?")).collect();
    let line = words.join(" ");
    if line.chars().count() <= MOST { line } else { line.chars().take(MOST).chain("...".chars()).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, options: &ReadOptions) -> Result<InterfaceMesh, ExportError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.ply");
        std::fs::write(&path, text).unwrap();
        read_mesh(&path, options)
    }

    /// As other tools write labels: other names and types, in no order, -1 for the outside.
    const FOREIGN: &str = "ply\nformat ascii 1.0\ncomment something\nelement vertex 4\nproperty double x\n\
        property double y\nproperty double z\nproperty int NodeType\nelement cell 1\nproperty float w\n\
        element face 2\nproperty short Label0\nproperty list int ushort vertex_index\nproperty short Label1\n\
        property uchar red\nend_header\n0 0 0 4\n1 0 0 77\n\n1 1 0 13\n0 1 0 2\n0.5\n\
        1 4 0 1 2 3 2 9\n-1 3 0 1 2 1 9\n";

    fn foreign() -> ReadOptions {
        ReadOptions {
            back: "Label0".to_owned(),
            front: "Label1".to_owned(),
            kind: "NodeType".to_owned(),
            ..ReadOptions::default()
        }
    }

    #[test]
    fn labels_of_other_tools_are_put_in_our_order() {
        let m = read(FOREIGN, &foreign()).unwrap();
        // 1 behind 2 becomes 2 behind 1, flipped; outside behind 1 becomes 1 behind outside, flipped.
        assert_eq!(m.triangles(), [[0, 2, 1], [0, 3, 2], [0, 2, 1]]);
        let pairs: Vec<_> = m.pairs().iter().map(|p| (p.back().0, p.front().0)).collect();
        assert_eq!(pairs, [(2, 1), (2, 1), (1, 255)]);
        // Kinds as given; 77 is none, so it is worked out: 2, 1 and the outside meet there.
        let codes: Vec<_> = m.kinds().iter().map(|k| k.code()).collect();
        assert_eq!(codes, [4, 13, 13, 2]);
        let names: Vec<_> = m.materials().iter().map(|m| (m.id.0, m.name.as_str())).collect();
        assert_eq!(names, [(1, "material 1"), (2, "material 2")]);
    }

    #[test]
    fn names_that_are_not_there_are_named() {
        // With our names these labels are not seen: one material in air.
        let m = read(FOREIGN, &ReadOptions::default()).unwrap();
        assert!(m.pairs().iter().all(|p| (p.back().0, p.front().0) == (1, 0)));
        let options = ReadOptions { front: "Label2".to_owned(), ..foreign() };
        let error = read(FOREIGN, &options).unwrap_err().to_string();
        assert!(error.contains("Label2") && error.contains("Label0, vertex_index, Label1, red"), "{error}");
        let options = ReadOptions { kind: "Kind".to_owned(), ..foreign() };
        assert!(read(FOREIGN, &options).unwrap_err().to_string().contains("NodeType"));
        // One label without the other is a mistake, not a file without labels.
        let half = FOREIGN.replace("Label0", "material_back");
        assert!(read(&half, &ReadOptions::default()).unwrap_err().to_string().contains("material_front"));
    }

    #[test]
    fn files_that_are_no_meshes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in
            [("a.tif", &b"II*\0"[..]), ("b.ply", b"plyx"), ("c.stl", b"abc"), ("d", b"solid x")]
        {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            let error = read_mesh(&path, &ReadOptions::default()).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
        for path in [folder.path().to_owned(), folder.path().join("missing")] {
            assert!(read_mesh(&path, &ReadOptions::default()).is_err());
        }
    }
}
