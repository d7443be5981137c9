//! The folder that `interfacet extract` leaves: meshes, junction curves, the report, a picture.

use std::io::{self, Write};
use std::path::Path;

use thiserror::Error;

use super::picture::PictureError;
use super::render::{RenderOptions, render};
use super::run_report::RunReport;
use crate::execution::{Cancelled, Execution};
use crate::export::{
    ExportError, PlyOptions, RESULT_MARK, write_atomically, write_junctions, write_ply, write_stl,
};
use crate::grid::MaterialId;
use crate::mesh::{JunctionCurve, MeshError, split};
use crate::pipeline::Extraction;

/// Why a result could not be written.
#[derive(Debug, Error)]
pub enum ResultError {
    /// A file could not be written.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// The picture could not be drawn or written.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// A material's shell makes no mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Writes the result of an extraction into `folder`, which must exist:
///
/// - `assembly.ply`: the labelled mesh;
/// - `materials/ID_NAME.stl` and `.ply`: the closed shell of each material but the background;
/// - `junctions.vtk`: the junction curves as polylines;
/// - `preview.png`: a picture of the mesh;
/// - `report.json`.
///
/// # Errors
/// [`ResultError`] names the file that could not be written.
pub fn write_result(
    folder: &Path,
    extraction: &Extraction,
    curves: &[JunctionCurve],
    report: &RunReport,
    execution: &Execution,
) -> Result<(), ResultError> {
    let mesh = &extraction.mesh;
    let options = PlyOptions::for_volume(&extraction.geometry);
    let stage = execution.stage("writing", mesh.materials().len() as u64 + 3);
    write_ply(&folder.join("assembly.ply"), mesh, options)?;
    stage.advance(1);
    let shells = folder.join("materials");
    std::fs::create_dir(&shells).map_err(|e| ExportError::writing(&shells, e))?;
    for material in mesh.materials().iter().filter(|m| m.id != MaterialId::BACKGROUND) {
        execution.check()?;
        let shell = split(mesh, material.id);
        if shell.triangles.is_empty() {
            continue; // the report says that nothing became this material
        }
        let stem = format!("{}_{}", material.id.0, material.name);
        write_stl(&shells.join(format!("{stem}.stl")), &shell, &material.name)?;
        write_ply(&shells.join(format!("{stem}.ply")), &shell.to_mesh(mesh, material.id)?, options)?;
        stage.advance(1);
    }
    execution.check()?;
    write_junctions(&folder.join("junctions.vtk"), mesh, curves)?;
    stage.advance(1);
    if !mesh.triangles().is_empty() {
        render(mesh, &RenderOptions::default())?.save_png(&folder.join("preview.png"))?;
    }
    stage.advance(1);
    write_atomically(&folder.join(RESULT_MARK), |out| {
        serde_json::to_writer_pretty(&mut *out, report).map_err(io::Error::from)?;
        writeln!(out)
    })?;
    Ok(())
}
