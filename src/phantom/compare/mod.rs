//! A mesh against the exact geometry of a phantom.
//!
//! Distances are taken both ways. *Mesh to truth*: points on every triangle, each with the area it stands
//! for (the triangle is cut into equal small ones of at most the sampling step), and every vertex with
//! no area of its own, so that a vertex can set the maximum but not the mean; for each the exact distance
//! to the true interface of the triangle's pair. *Truth to mesh*: points on the true interface, each with
//! its area, to the closest triangle of that pair. A mesh that misses a part is seen only by the second,
//! one with parts too many only by the first. Signs are the same both ways: positive where the mesh lies
//! in front of the truth, in the direction of its normals.
//!
//! Everything is given for all points, and apart for three groups: *near a junction* (within a given
//! distance of a junction curve), else *near a sharp edge* (as near to a curve at which one interface
//! bends), else *clear* of both. The groups are formed twice: by a wide distance, usually 2R, within which a
//! method that knows nothing of junctions and edges is disturbed, and by a close one, within which every method has its
//! difficulties. Blur rounds a sharp edge whatever the method (the half-value surface of
//! a blurred 90 degree edge lies 0.77 sigma inside of it), so the groups keep the two causes of error
//! apart; all points off the junctions are given together as well. Triangles of the volume's border (a
//! pair with `OUTSIDE`) are left out.
//!
//! The true sharp edges and junction curves are measured as curves, too ([`EdgeComparison`],
//! [`JunctionComparison`], which has the points where curves meet or turn as well); whole spheres by their spheres of least
//! squares ([`SphereComparison`]); thin parts by their thickness ([`ThicknessComparison`]); rounded edges apart
//! ([`FilletComparison`]); and standard deviations that a mesh states by the share of true errors below them
//! ([`Coverage`]).
//!
//! Guaranteed: the same figures for any number of threads. Not covered: whether the mesh is closed or
//! crosses itself; that is the mesh check's work.

mod connected;
mod coverage;
mod error_ply;
mod fillets;
mod junctions;
mod nearest;
mod points;
mod sharp_edges;
mod shells;
mod spheres;
mod statistics;
mod surfaces;
#[cfg(test)]
mod tests;
mod thickness;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use coverage::{Coverage, Covered};
pub use fillets::FilletComparison;
pub use junctions::{CurveDistances, JunctionComparison, NARROW, TIGHT};
pub use points::{FOUND, PointComparison};
pub use sharp_edges::{CREASE, EdgeComparison, EdgeSplit};
pub use shells::MaterialComparison;
pub use spheres::{SphereComparison, SphereFit};
pub use statistics::{Distances, Figures};
pub use surfaces::{DISTURBED, FalseTriangles, Groups, PairComparison, Split, Tally};
pub use thickness::ThicknessComparison;

use super::Phantom;
use crate::execution::{Cancelled, Execution};
use crate::mesh::InterfaceMesh;

/// How to compare. Lengths in voxels (edges of the cube with a voxel's volume).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CompareOptions {
    /// Points farther than this from every junction curve are clear of junctions, from every sharp edge
    /// clear of edges; triangles farther than this from their pair's true interface are false. Usually 2R.
    pub clear: f64,
    /// A second, smaller distance that tells points near junction curves or sharp edges from the others.
    pub near: f64,
    /// Largest distance of neighbouring sample points.
    pub step: f64,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { clear: 6.0, near: 3.0, step: 0.5 }
    }
}

/// Why a comparison cannot be made.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CompareError {
    /// A value outside its range.
    #[error("{name} is {value} voxels, but it must be a positive number")]
    Range {
        /// Which option.
        name: &'static str,
        /// As given.
        value: f64,
    },
    /// Standard deviations that are not one for each vertex.
    #[error("{got} standard deviations are given for a mesh of {needed} vertices")]
    Sigmas {
        /// How many were given.
        got: usize,
        /// The mesh's vertices.
        needed: usize,
    },
    /// Stopped before it was done.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A mesh measured against the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// The phantom's scene.
    pub scene: String,
    /// One voxel in mm: the edge of the cube with a voxel's volume.
    pub voxel_mm: f64,
    /// What was asked for.
    pub options: CompareOptions,
    /// Every pair in the truth or the mesh, ascending.
    pub pairs: Vec<PairComparison>,
    /// The junction curves, if the truth or the mesh has any.
    pub junctions: Option<JunctionComparison>,
    /// The true sharp edges, by pair.
    #[serde(default)]
    pub edges: Vec<EdgeComparison>,
    /// The true whole spheres, in the scene's order.
    #[serde(default)]
    pub spheres: Vec<SphereComparison>,
    /// The thin part or gap, if there is one.
    #[serde(default)]
    pub thickness: Option<ThicknessComparison>,
    /// The rounded edges, by radius.
    #[serde(default)]
    pub fillets: Vec<FilletComparison>,
    /// How the stated standard deviations of vertices compare with their true errors: all pairs, then each pair. Empty if
    /// none are stated.
    #[serde(default)]
    pub coverage: Vec<Coverage>,
    /// Every material, by id.
    pub materials: Vec<MaterialComparison>,
    /// Triangles that belong nowhere.
    pub false_triangles: FalseTriangles,
    /// Signed distance of each vertex in mm from the true interface of its triangles' pairs (the largest in
    /// size), NaN where there is none. Not written to files with the rest.
    #[serde(skip)]
    pub vertex_errors: Vec<f64>,
}

/// Measures a mesh, in the world of the phantom's volume, against the phantom. `sigmas`: the standard deviation that the
/// mesh states for each vertex along its normal, mm, if it states any.
///
/// # Errors
/// [`CompareError::Range`] for unusable options, [`CompareError::Sigmas`] for other than one standard deviation per
/// vertex, [`CompareError::Cancelled`] if it was stopped.
pub fn compare(
    mesh: &InterfaceMesh,
    phantom: &Phantom,
    sigmas: Option<&[f32]>,
    options: &CompareOptions,
    execution: &Execution,
) -> Result<Comparison, CompareError> {
    for (name, value) in [("clear", options.clear), ("near", options.near), ("step", options.step)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(CompareError::Range { name, value });
        }
    }
    let voxel = phantom.geometry().voxel_edge();
    let needed = mesh.positions().len();
    if let Some(got) = sigmas.map(<[f32]>::len).filter(|got| *got != needed) {
        return Err(CompareError::Sigmas { got, needed });
    }
    let [clear, near, step] = [options.clear, options.near, options.step].map(|v| v * voxel);
    let lengths = Lengths { voxel, clear, near, step };
    let truth = phantom.truth();
    let surfaces = surfaces::compare(mesh, truth, &lengths, execution)?;
    let junctions = junctions::compare(mesh, truth, &lengths);
    execution.check()?;
    let edges = sharp_edges::compare(mesh, truth, &lengths);
    execution.check()?;
    let coverage = sigmas.map_or_else(Vec::new, |sigmas| {
        coverage::compare(mesh, truth, sigmas, &surfaces.vertex_errors, &lengths)
    });
    execution.check()?;
    let materials = shells::compare(mesh, phantom);
    Ok(Comparison {
        scene: phantom.options().scene.name().to_owned(),
        voxel_mm: voxel,
        options: *options,
        pairs: surfaces.pairs,
        junctions,
        edges,
        spheres: spheres::compare(mesh, truth, &lengths),
        thickness: thickness::compare(mesh, phantom, &lengths),
        fillets: fillets::compare(mesh, truth, &lengths),
        coverage,
        materials,
        false_triangles: surfaces.false_triangles,
        vertex_errors: surfaces.vertex_errors,
    })
}

/// Lengths in mm.
struct Lengths {
    voxel: f64,
    clear: f64,
    near: f64,
    step: f64,
}
