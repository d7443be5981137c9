//! Generalized, non-binary marching cubes (Fujimori and Suzuki §4, after Hege et al. 1997).
//!
//! The padded lattice is walked in *layers* of cells. A layer owns the vertices in its lower plane
//! (crossings of x and y edges, nodes and kinks of z faces), those up to its upper plane (crossings of z edges,
//! nodes and kinks of x and y faces), and the apexes and tips inside its cells, numbered in this order. Counting comes
//! first (`count.rs`), then sums give every layer its place in the output, then the layers are filled
//! (`fill.rs`): the same mesh for any number of threads. Work follows the surface: 64 edges are
//! compared at a time, and only cells with a crossing are looked at one by one.
//!
//! Guarantees and their proofs: `docs/contouring.md`. Halo: one voxel.

mod bit_rows;
mod cell;
mod code_rows;
mod corners;
mod count;
mod fill;
mod kinks;
mod lattice;
mod pieces;
mod surroundings;

use std::ops::Range;

use rayon::iter::repeat_n;
use rayon::prelude::*;

use super::crossing::CrossingRule;
use super::error::ContourError;
use super::patch::{Border, Patch};
use super::pattern::PatternTable;
use crate::classify::LabelVolume;
use crate::execution::{Execution, Stage};
use crate::grid::{MaterialId, Pair, VertexKind};

pub use pieces::march_pieces;
pub use surroundings::{Facet, Surroundings, surroundings};

pub(in crate::contour) use cell::{Cell, pair_of, worst};

use count::LayerCount;
use fill::{LayerSlices, VertexSlices, fill_layer};
use lattice::{Between, Layer, Plane};

/// Layers that a thread takes at a time: the plane between two of them is looked at once.
const RUN: usize = 4;

/// What to contour, and how.
struct Job<'a, C> {
    labels: &'a LabelVolume,
    rule: &'a C,
    border: Border,
    table: &'static PatternTable,
    execution: &'a Execution,
}

/// Extracts the interfaces of a labelled volume.
///
/// # Errors
/// [`ContourError::TooManyVertices`] or [`ContourError::TooManyTriangles`] if an index could not name them;
/// [`ContourError::Cancelled`] if asked to stop.
pub fn march<C: CrossingRule>(
    labels: &LabelVolume,
    rule: &C,
    border: Border,
    execution: &Execution,
) -> Result<Patch, ContourError> {
    let layers = 0..labels.codes().padded()[2] - 1;
    let stage = execution.stage("contouring", 2 * layers.len() as u64);
    let job = Job { labels, rule, border, table: PatternTable::get(), execution };
    let counts = job.count(layers.clone(), &stage)?;
    let patch = job.fill(layers.start, &counts, 0, &stage)?;
    drop(stage);
    Ok(patch)
}

impl<C: CrossingRule> Job<'_, C> {
    /// Counts what layers will write.
    fn count(&self, layers: Range<usize>, stage: &Stage<'_>) -> Result<Vec<LayerCount>, ContourError> {
        let counted = runs(layers).into_par_iter().map(|run| {
            let mut counts = Vec::with_capacity(run.len());
            self.walk(run, stage, |layer| counts.push(LayerCount::new(self, layer)))?;
            Ok(counts)
        });
        Ok(counted.collect::<Result<Vec<_>, ContourError>>()?.into_iter().flatten().collect())
    }

    /// Makes the vertices and triangles of the counted layers, which begin at layer `first`, and leaves
    /// room for `more` vertices behind them.
    fn fill(
        &self,
        first: usize,
        counts: &[LayerCount],
        more: usize,
        stage: &Stage<'_>,
    ) -> Result<Patch, ContourError> {
        let vertices = counts.iter().map(|c| c.vertices).sum::<usize>() + more;
        check_vertices(vertices as u64)?;
        let triangles: usize = counts.iter().map(|c| c.triangles).sum();
        check_triangles(triangles as u64)?;
        let any_pair = Pair::new(MaterialId(1), MaterialId::BACKGROUND);
        let mut patch = Patch {
            positions: vec![[0.0; 3]; vertices],
            // By all threads: these two are not zeros, which cost nothing before they are written.
            kinds: repeat_n(VertexKind::Interface, vertices).collect(),
            sigmas: if self.rule.has_sigmas() { vec![f32::NAN; vertices] } else { Vec::new() },
            triangles: vec![[0; 3]; triangles],
            pairs: any_pair.map_or_else(Vec::new, |pair| repeat_n(pair, triangles).collect()),
        };
        let mut rest = LayerSlices {
            first_vertex: 0,
            vertices: VertexSlices::of(&mut patch.positions, &mut patch.kinds, &mut patch.sigmas),
            triangles: &mut patch.triangles,
            pairs: &mut patch.pairs,
        };
        let runs: Vec<_> = counts
            .chunks(RUN)
            .map(|run| (run, run.iter().map(|c| rest.split(c)).collect::<Vec<_>>()))
            .collect();
        runs.into_par_iter().enumerate().try_for_each(|(i, (counts, slices))| {
            let start = first + i * RUN;
            let mut each = counts.iter().zip(slices);
            self.walk(start..start + counts.len(), stage, |layer| {
                if let Some((count, out)) = each.next() {
                    fill_layer(self, layer, count, out);
                }
            })
        })?;
        Ok(patch)
    }

    /// Visits layers in order.
    fn walk(
        &self,
        layers: Range<usize>,
        stage: &Stage<'_>,
        visit: impl FnMut(Layer<'_>),
    ) -> Result<(), ContourError> {
        walk(self.labels, self.rule, self.border, layers, self.execution, stage, visit)
    }
}

/// The runs of layers that threads take at a time.
pub(in crate::contour) fn runs(layers: Range<usize>) -> Vec<Range<usize>> {
    layers.clone().step_by(RUN).map(|z| z..(z + RUN).min(layers.end)).collect()
}

/// Visits layers in order.
pub(in crate::contour) fn walk<C: CrossingRule + ?Sized>(
    labels: &LabelVolume,
    rule: &C,
    border: Border,
    layers: Range<usize>,
    execution: &Execution,
    stage: &Stage<'_>,
    mut visit: impl FnMut(Layer<'_>),
) -> Result<(), ContourError> {
    let mut lower = Plane::new(labels, rule, border, layers.start);
    for z in layers {
        execution.check()?;
        let upper = Plane::new(labels, rule, border, z + 1);
        let between = Between::new(labels, rule, border, z);
        visit(Layer { lower: &lower, between: &between, upper: &upper });
        lower = upper;
        stage.advance(1);
    }
    Ok(())
}

impl<'a> LayerSlices<'a> {
    /// Takes off what the next layer will write.
    fn split(&mut self, count: &LayerCount) -> Self {
        let first_vertex = self.first_vertex;
        self.first_vertex += count.vertices as u32;
        Self {
            first_vertex,
            vertices: VertexSlices {
                positions: self.vertices.positions.split_off_mut(..count.vertices).unwrap_or_default(),
                kinds: self.vertices.kinds.split_off_mut(..count.vertices).unwrap_or_default(),
                // None, if sigmas are not known.
                sigmas: self.vertices.sigmas.split_off_mut(..count.vertices).unwrap_or_default(),
            },
            triangles: self.triangles.split_off_mut(..count.triangles).unwrap_or_default(),
            pairs: self.pairs.split_off_mut(..count.triangles).unwrap_or_default(),
        }
    }
}

/// Refuses more vertices than can be numbered.
pub(in crate::contour) fn check_vertices(vertices: u64) -> Result<(), ContourError> {
    // PLY indices are signed; better refused now than after all the work.
    let limit = u64::from(i32::MAX.unsigned_abs());
    if vertices > limit { Err(ContourError::TooManyVertices { vertices, limit }) } else { Ok(()) }
}

/// Refuses more triangles than can be numbered.
pub(in crate::contour) fn check_triangles(triangles: u64) -> Result<(), ContourError> {
    let limit = u64::from(u32::MAX);
    if triangles > limit { Err(ContourError::TooManyTriangles { triangles, limit }) } else { Ok(()) }
}
