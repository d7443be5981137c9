//! The folder that `interfacet extract` leaves: meshes, junction curves, the report, a picture.
//!
//! The labelled mesh is written, checked and measured piece by piece while it is extracted. What is
//! made of it afterwards (shells, the picture) is made from the finished PLY file, again piece by piece: the
//! mesh is never in memory as a whole.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use thiserror::Error;

use super::picture::PictureError;
use super::render::{RenderOptions, render_ply};
use super::run_report::{InputReport, RunReport};
use super::shells::write_shells;
use crate::execution::{Cancelled, Execution};
use crate::export::{
    ExportError, MergedByStl, PlyOptions, PlyPieces, PlyStream, RESULT_MARK, ReadOptions, write_atomically,
    write_curves,
};
use crate::grid::Geometry;
use crate::mesh::{CheckOptions, MeshMaterial, MeshPiece, MeshReportBuilder};
use crate::pipeline::{Findings, MeshSink, PipelineOptions, SinkError};

/// Why a result could not be written.
#[derive(Debug, Error)]
pub enum ResultError {
    /// A file could not be written.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// The picture could not be drawn or written.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// There was no mesh: nothing has been extracted into this result.
    #[error("the result holds no mesh yet, so there is nothing to finish")]
    Empty,
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Writes the result of an extraction into a folder:
///
/// - `assembly.ply`: the labelled mesh;
/// - `materials/ID_NAME.stl` and `.ply`: the closed shell of each material but the background;
/// - `junctions.vtk`: the junction curves as polylines;
/// - `preview.png`: a picture of the mesh;
/// - `report.json`.
///
/// It is the sink of [`extract_into`](crate::pipeline::extract_into); then comes [`ResultWriter::finish`].
pub struct ResultWriter<'a> {
    folder: PathBuf,
    check: CheckOptions,
    execution: &'a Execution,
    mesh: Option<Mesh>,
    /// Seconds spent checking and writing so far.
    seconds: [f64; 2],
}

/// A mesh that is being written and looked at.
struct Mesh {
    options: PlyOptions,
    file: PlyStream,
    report: MeshReportBuilder,
    merged: MergedByStl,
    triangles: u64,
}

impl<'a> ResultWriter<'a> {
    /// A result in `folder`, which must exist.
    #[must_use]
    pub fn new(folder: &Path, check: CheckOptions, execution: &'a Execution) -> Self {
        Self { folder: folder.to_owned(), check, execution, mesh: None, seconds: [0.0; 2] }
    }

    fn assembly(&self) -> PathBuf {
        self.folder.join("assembly.ply")
    }

    /// Writes what is made of the finished mesh, and the report, which it returns.
    ///
    /// # Errors
    /// [`ResultError`] names the file that could not be written.
    pub fn finish(
        mut self,
        input: InputReport,
        options: PipelineOptions,
        findings: &Findings,
    ) -> Result<RunReport, ResultError> {
        let assembly = self.assembly();
        let Mesh { options: ply, file, report, merged, triangles } =
            self.mesh.take().ok_or(ResultError::Empty)?;
        let stage = self.execution.stage(WRITING, 4);
        let started = Instant::now();
        file.finish(self.execution)?;
        stage.advance(1);
        let checked = Instant::now();
        let mesh = report.finish();
        let check = self.seconds[0] + checked.elapsed().as_secs_f64();
        self.execution.check()?;
        let shells = self.folder.join("materials");
        std::fs::create_dir(&shells).map_err(|e| ExportError::writing(&shells, e))?;
        // Opened once: finding out where pieces begin takes a look at all faces.
        let pieces = match triangles {
            0 => None,
            _ => Some(PlyPieces::open(&assembly, &ReadOptions::default())?),
        };
        if let Some(pieces) = &pieces {
            write_shells(pieces, &shells, ply, self.execution)?;
        }
        stage.advance(1);
        let vertices = &mesh.junctions.vertices;
        write_curves(&self.folder.join("junctions.vtk"), |v| vertices.position(v), &mesh.junctions.curves)?;
        stage.advance(1);
        if let Some(pieces) = &pieces {
            let picture = render_ply(pieces, &RenderOptions::default(), self.execution)?;
            picture.save_png(&self.folder.join("preview.png"))?;
        }
        stage.advance(1);
        let mut costs = findings.costs.clone();
        costs.add("check", check);
        costs.add("write", self.seconds[1] + (started.elapsed() - checked.elapsed()).as_secs_f64());
        let findings = Findings { costs, ..findings.clone() };
        let report = RunReport::new(input, options, &findings, mesh, merged.count());
        write_atomically(&self.folder.join(RESULT_MARK), |out| {
            serde_json::to_writer_pretty(&mut *out, &report).map_err(io::Error::from)?;
            writeln!(out)
        })?;
        Ok(report)
    }
}

/// Bytes of the pieces of the finished file that are under way.
const PIECES: u64 = 48 << 20;

/// The name of the last stage.
const WRITING: &str = "writing";

impl MeshSink for ResultWriter<'_> {
    fn begin(&mut self, geometry: &Geometry, materials: &[MeshMaterial]) -> Result<(), SinkError> {
        let options = PlyOptions::for_volume(geometry);
        self.mesh = Some(Mesh {
            options,
            file: PlyStream::create(&self.assembly(), materials, options)?,
            report: MeshReportBuilder::new(materials.to_vec(), &self.check),
            merged: MergedByStl::new(geometry),
            triangles: 0,
        });
        Ok(())
    }

    fn stages(&self) -> &[(&'static str, f64)] {
        &[(WRITING, 1.0)]
    }

    fn memory(&self) -> u64 {
        // The picture: 12 bytes for every sample of it, and its pixels; and pieces of the file.
        let RenderOptions { width, height, supersampling, .. } = RenderOptions::default();
        let pixels = (width * height) as u64;
        pixels * (12 * (supersampling * supersampling) as u64 + 8) + PIECES
    }

    fn add(&mut self, piece: MeshPiece) -> Result<(), SinkError> {
        let mesh = self.mesh.as_mut().ok_or(ResultError::Empty)?;
        let started = Instant::now();
        // The bytes are written by a thread of their own while the piece is checked.
        mesh.file.add(&piece)?;
        mesh.triangles += piece.mesh.triangles().len() as u64;
        let written = Instant::now();
        mesh.merged.add(&piece);
        mesh.report.add(&piece, self.execution)?;
        self.seconds[0] += written.elapsed().as_secs_f64();
        self.seconds[1] += (written - started).as_secs_f64();
        Ok(())
    }
}
