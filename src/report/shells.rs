//! Every material's closed shell, as STL and PLY, out of the labelled mesh.

use std::path::Path;

use super::result_folder::ResultError;
use crate::execution::Execution;
use crate::export::{PlyOptions, PlyPieces, ShellPlyStream, StlStream};
use crate::grid::MaterialId;
use crate::mesh::{MeshMaterial, MeshPiece, ShellSplitter};

/// Shells written in one go through the mesh: each has three open files and two threads that write.
const TOGETHER: usize = 8;

/// Writes the shell of each material but the background that has any triangles to `folder/ID_NAME.stl`
/// and `.ply`.
pub(super) fn write_shells(
    pieces: &PlyPieces,
    folder: &Path,
    options: PlyOptions,
    execution: &Execution,
) -> Result<(), ResultError> {
    let materials: Vec<_> = pieces.materials().iter().filter(|m| m.id != MaterialId::BACKGROUND).collect();
    for group in materials.chunks(TOGETHER) {
        let mut shells: Vec<_> =
            group.iter().map(|m| ShellFiles::new(m, pieces.materials(), folder, options)).collect();
        pieces.each(|piece| {
            execution.check()?;
            shells.iter_mut().try_for_each(|shell| shell.add(piece))
        })?;
        for shell in shells {
            if let Some((ply, stl)) = shell.files {
                ply.finish(execution)?;
                stl.finish(execution)?;
            }
        }
    }
    Ok(())
}

/// The files of a shell; they are made when its first triangle comes.
struct ShellFiles<'a> {
    material: &'a MeshMaterial,
    all: &'a [MeshMaterial],
    folder: &'a Path,
    options: PlyOptions,
    splitter: ShellSplitter,
    files: Option<(ShellPlyStream, StlStream)>,
}

impl<'a> ShellFiles<'a> {
    fn new(
        material: &'a MeshMaterial,
        all: &'a [MeshMaterial],
        folder: &'a Path,
        options: PlyOptions,
    ) -> Self {
        let splitter = ShellSplitter::new(material.id);
        Self { material, all, folder, options, splitter, files: None }
    }

    fn add(&mut self, piece: &MeshPiece) -> Result<(), ResultError> {
        let id = self.material.id;
        let mesh = &piece.mesh;
        // Seen from outside the material, in the order of the mesh.
        let outward: Vec<[u32; 3]> = mesh
            .triangles()
            .iter()
            .zip(mesh.pairs())
            .filter(|(_, pair)| pair.contains(id))
            .map(|(&[a, b, c], pair)| if pair.back() == id { [a, b, c] } else { [a, c, b] })
            .collect();
        let part = self.splitter.add(piece);
        if self.files.is_none() && (!outward.is_empty() || !part.positions.is_empty()) {
            let stem = self.folder.join(format!("{}_{}", id.0, self.material.name));
            let path = |extension: &str| {
                let mut path = stem.clone().into_os_string();
                path.push(extension);
                path
            };
            let ply = ShellPlyStream::create(path(".ply").as_ref(), self.all, id, self.options)?;
            let stl = StlStream::create(path(".stl").as_ref(), &self.material.name)?;
            self.files = Some((ply, stl));
        }
        if let Some((ply, stl)) = &mut self.files {
            ply.add(&part)?;
            stl.add(outward.len(), |i| outward[i].map(|v| mesh.positions()[v as usize]))?;
        }
        Ok(())
    }
}
