//! One phantom, extracted and compared.

use std::time::Instant;

use serde::Serialize;

use interfacet::execution::Execution;
use interfacet::mesh::{CheckOptions, check};
use interfacet::phantom::compare::{CompareOptions, Comparison, compare};
use interfacet::phantom::{Phantom, PhantomOptions};
use interfacet::pipeline::{Extraction, PipelineOptions, extract};
use interfacet::volume::MemorySource;

use super::cases::Case;
use super::metrics::Metrics;

/// What became of a phantom.
#[derive(Debug, Serialize)]
pub(crate) struct Outcome {
    /// The object.
    pub case: Case,
    /// The column of the table, from 0.
    pub column: usize,
    /// The image.
    pub phantom: PhantomOptions,
    /// For making, extracting and comparing it.
    pub seconds: f64,
    /// The figures, or why there is no mesh.
    pub found: Result<Found, String>,
}

/// A mesh measured.
#[derive(Debug, Serialize)]
pub(crate) struct Found {
    /// Radius R that was used, voxels.
    pub radius: f64,
    /// Triangles of the mesh.
    pub triangles: usize,
    /// Defects of the mesh.
    pub defects: u64,
    /// What the targets are about.
    pub metrics: Metrics,
    /// Everything.
    pub comparison: Comparison,
}

/// Makes, extracts and compares; an extraction that fails is an outcome, not an error.
pub(crate) fn run(
    case: &Case,
    column: usize,
    options: &PhantomOptions,
    pipeline: &PipelineOptions,
) -> anyhow::Result<Outcome> {
    let start = Instant::now();
    let execution = Execution::default();
    let phantom = Phantom::new(options)?;
    let source = MemorySource::new(phantom.geometry().clone(), phantom.rasterise(&execution)?)?;
    let found = match extract(&source, pipeline, &execution) {
        Err(error) => Err(error.to_string()),
        Ok(extraction) => Ok(measured(&extraction, &phantom, &execution)?),
    };
    let seconds = start.elapsed().as_secs_f64();
    Ok(Outcome { case: *case, column, phantom: options.clone(), seconds, found })
}

fn measured(extraction: &Extraction, phantom: &Phantom, execution: &Execution) -> anyhow::Result<Found> {
    let radius = extraction.findings.blur.as_ref().map_or(f64::NAN, |blur| blur.radius[0]);
    let mesh = &extraction.mesh;
    let base = CompareOptions::default();
    let clear = if radius.is_finite() { 2.0 * radius } else { base.clear };
    let comparison =
        compare(mesh, phantom, extraction.mesh.sigmas(), &CompareOptions { clear, ..base }, execution)?;
    Ok(Found {
        radius,
        triangles: mesh.triangles().len(),
        defects: check(mesh, &CheckOptions::default(), execution)?.total(),
        metrics: Metrics::of(&comparison),
        comparison,
    })
}
