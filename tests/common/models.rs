//! A phantom's mesh by local models ([`Accuracy::Full`]), against the truth.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use interfacet::execution::Execution;
use interfacet::mesh::{CheckOptions, check};
use interfacet::phantom::compare::{CompareOptions, Comparison, compare};
use interfacet::phantom::{Phantom, PhantomOptions};
use interfacet::pipeline::{Accuracy, PipelineOptions, extract};
use interfacet::volume::MemorySource;

/// Compared with the truth; the mesh must have no defect.
pub(crate) fn measured(options: &PhantomOptions) -> Comparison {
    let execution = Execution::default();
    let phantom = Phantom::new(options).unwrap();
    let samples = phantom.rasterise(&execution).unwrap();
    let source = MemorySource::new(phantom.geometry().clone(), samples).unwrap();
    let pipeline = PipelineOptions { accuracy: Accuracy::Full, ..PipelineOptions::default() };
    let mesh = extract(&source, &pipeline, &execution).unwrap().mesh;
    let defects = check(&mesh, &CheckOptions::default(), &execution).unwrap();
    assert!(defects.is_empty() && defects.self_intersections_checked, "{:?}", defects.by_kind());
    compare(&mesh, &phantom, mesh.sigmas(), &CompareOptions::default(), &execution).unwrap()
}
