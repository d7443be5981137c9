//! From the unsimplified surface to the finished one.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Builder;
use super::census::{self, NodeCounts, PairPolygons};
use super::deviation::{Deviation, deviation};
use super::flips::{FlipMesh, FlipOptions, flip};
use super::forest::Forest;
use super::grading::grade;
use super::merge::{MergeOptions, merge};
use super::octree::{Bound, Collapses};
use super::placement::World;
use super::polygons::Triangles;
use super::qef::Placement;
use super::remedy::{Making, Remedy, mend};
use super::sigmas;
use super::vertices::Vertices;
use crate::contour::error::ContourError;
use crate::contour::patch::Border;
use crate::execution::{CostLog, Execution};
use crate::grid::{Geometry, MaterialId, Pair, VertexKind};

/// Stages of [`Builder::finish`], with their shares of its time.
pub const STAGES: [(&str, f64); 2] = [(COLLAPSING, 1.0), (MENDING, 2.0)];
const COLLAPSING: &str = "simplifying";
const MENDING: &str = "mending and measuring";

/// How to simplify.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DualOptions {
    /// What error a collapse may make.
    pub bound: Bound,
    /// Where a vertex goes whose best place is outside its block.
    pub placement: Placement,
    /// Whether vertices are merged beyond the octree's blocks, where the bound is a root mean square.
    pub merge: bool,
    /// Standard deviation of the crossings' positions, in voxels of mean edge.
    pub noise: f64,
    /// Whether to measure the distance from the unsimplified mesh, which takes about as long as simplifying.
    pub deviation: bool,
}

impl Default for DualOptions {
    fn default() -> Self {
        Self {
            bound: Bound::Rms(0.1),
            placement: Placement::Clamped,
            merge: true,
            noise: 0.0,
            deviation: true,
        }
    }
}

/// What simplification did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// The bound that was used.
    pub bound: Bound,
    /// Nodes of the octree by type.
    pub nodes: NodeCounts,
    /// Crossings and polygons of each interface.
    pub polygons: Vec<PairPolygons>,
    /// How many percent fewer triangles than the unsimplified mesh the result has.
    pub simplification_percent: f64,
    /// Distance from the unsimplified mesh; `None` without simplification.
    pub deviation: Option<Deviation>,
    /// Collapses made and refused.
    pub collapses: Collapses,
    /// Nodes split by grading.
    pub graded: u64,
    /// What was done about triangles that met.
    pub remedy: Remedy,
    /// Edges flipped for better triangles.
    pub flips: u64,
    /// Vertices merged into another one.
    pub merged: u64,
    /// Merges taken back because triangles met.
    pub merges_undone: u64,
}

/// A labelled surface in the world.
#[derive(Debug, Clone)]
pub struct DualSurface {
    /// Vertex positions, mm.
    pub positions: Vec<DVec3>,
    /// What each vertex is.
    pub kinds: Vec<VertexKind>,
    /// Standard deviation of each vertex's position along the normal of the surface, mm; NaN where it is unknown.
    /// Empty if none is known.
    pub sigmas: Vec<f32>,
    /// Vertices of each triangle, counter-clockwise seen from its front.
    pub triangles: Vec<[u32; 3]>,
    /// The pair of each triangle.
    pub pairs: Vec<Pair>,
    /// What was done.
    pub statistics: Statistics,
    /// What its steps cost.
    pub costs: CostLog,
}

impl Builder {
    /// Simplifies the surface and makes its triangles.
    ///
    /// # Errors
    /// [`ContourError::Cancelled`].
    pub fn finish(
        self,
        geometry: &Geometry,
        options: &DualOptions,
        border: Border,
        execution: &Execution,
    ) -> Result<DualSurface, ContourError> {
        let DualOptions { bound, placement, .. } = *options;
        let mut costs = CostLog::default();
        let mut forest = Forest::new(costs.measure("leaves", || self.into_leaves()));
        let (bound, wanted) = match bound {
            Bound::Triangles(wanted) => {
                (bound_for(&mut forest, wanted, options, border, execution)?, Some(wanted))
            }
            bound => (bound, None),
        };
        let octree = octree_bound(bound, options);
        let graded = costs.measure("collapse", || grow(&mut forest, octree, placement, execution))?;
        let grid = forest.leaves.grid.clone();
        let world = World::new(geometry, &grid);
        let stage = execution.stage(MENDING, 0);
        let making = Making { bound: octree, placement, border, world: &world, execution };
        let (mut vertices, mut made, remedy) = costs.measure("mend", || mend(&mut forest, making))?;
        let polygons = census::polygons(&forest, &vertices, border);
        let nodes = census::nodes(&forest, &vertices);
        let mut survivors: Option<Vec<u32>> = None;
        let (mut merged, mut merges_undone) = (0, 0);
        if let (Bound::Rms(rms), true) = (bound, options.merge) {
            // Down to a number of triangles: the number decides, not the tolerance.
            let tolerance = if wanted.is_some() { rms } else { part(rms, MERGE_PART, options.noise) };
            let options = MergeOptions {
                tolerance,
                on_curves: forest.leaves.closer(),
                edge: geometry.voxel_edge(),
                wanted: wanted.unwrap_or(0),
            };
            let merges = costs
                .measure("merge", || merge(&forest, &vertices, &mut made, &world, &options, execution))?;
            (merged, merges_undone) = (merges.count, merges.undone);
            survivors = Some(merges.survivors);
        }
        let became = |v: usize| survivors.as_ref().map_or(v, |to| to[v] as usize);
        let mut sigmas = costs.measure("sigmas", || {
            let mut sums = sigmas::sums(&forest, &vertices, &world, |v| made.positions[became(v)]);
            survivors.iter().for_each(|survivors| sigmas::merge(&mut sums, survivors));
            sigmas::roots(&sums)
        });
        survivors.iter().for_each(|survivors| vertices.move_leaves(survivors));
        let mut flips = 0;
        if let Some(tolerance) = tolerance(bound) {
            let options = FlipOptions {
                tolerance: tolerance * geometry.voxel_edge(),
                angle: FLIP_ANGLE,
                rounds: FLIP_ROUNDS,
            };
            let mesh = FlipMesh { positions: &made.positions, pairs: &made.pairs, locked: &[] };
            let flipped = costs.measure("flip", || flip(mesh, &mut made.triangles, &options, execution));
            flips = flipped?.count() as u64;
        }
        let measured = options.deviation && bound != Bound::None;
        let deviation = measured.then(|| {
            costs.measure("deviation", || {
                deviation(&forest, &vertices, &made, placement, &world, geometry.voxel_edge())
            })
        });
        let before = 2 * polygons.iter().map(|n| n.crossings).sum::<u64>();
        let fewer = before.saturating_sub(made.triangles.len() as u64);
        let statistics = Statistics {
            bound,
            nodes,
            polygons,
            simplification_percent: 100.0 * fewer as f64 / before.max(1) as f64,
            deviation,
            collapses: forest.collapses,
            graded,
            remedy,
            flips,
            merged,
            merges_undone,
        };
        drop(stage);
        execution.check()?;
        sigmas.extend(&made.extra_sigmas);
        Ok(finished(made, &sigmas, geometry, statistics, costs))
    }
}

/// Collapses what the bound admits, and grades; returns how many nodes grading split.
fn grow(
    forest: &mut Forest,
    bound: Bound,
    placement: Placement,
    execution: &Execution,
) -> Result<u64, ContourError> {
    let stage = execution.stage(COLLAPSING, forest.leaves.roots.len() as u64);
    forest.grow(bound, placement, execution, &stage)?;
    drop(stage);
    let graded = grade(forest);
    execution.check()?;
    Ok(graded)
}

/// The part of the tolerance that the octree may use where merging follows, and that merging may use. With these the
/// error to the truth is no larger than that of the octree alone with all of the tolerance, which leaves much of it
/// unused in most places; fewer triangles are left and better ones (docs/dual.md).
const OCTREE_PART: f64 = 0.5;
/// See [`OCTREE_PART`].
const MERGE_PART: f64 = 0.65;

/// But below this many standard deviations of the crossings' positions hardly anything can be joined.
const NOISE_PART: f64 = 1.25;

/// A part of a tolerance, or more of it where noise demands it.
fn part(rms: f64, part: f64, noise: f64) -> f64 {
    (rms * part).max((NOISE_PART * noise).min(rms))
}

/// The octree's bound.
fn octree_bound(bound: Bound, options: &DualOptions) -> Bound {
    match bound {
        Bound::Rms(rms) if options.merge => Bound::Rms(part(rms, OCTREE_PART, options.noise)),
        bound => bound,
    }
}

/// Steps of the search for a bound.
const SEARCH_STEPS: usize = 12;
/// How many times the triangles wanted the octree shall have where merging follows.
const BEFORE_MERGING: u64 = 3;

/// The bound for a number of triangles. It is found by bisection of its logarithm between a thousandth of a
/// voxel and 30 voxels; where merging follows, as the one whose octree has some times as many, or, of an
/// unsimplified mesh that has not, half of what is too many.
fn bound_for(
    forest: &mut Forest,
    wanted: u64,
    options: &DualOptions,
    border: Border,
    execution: &Execution,
) -> Result<Bound, ContourError> {
    let mut count = |bound: Bound| {
        grow(forest, octree_bound(bound, options), options.placement, execution)?;
        Ok::<_, ContourError>(census::triangles(forest, &Vertices::numbered(forest), border))
    };
    let all = count(Bound::None)?;
    if all <= wanted {
        return Ok(Bound::None);
    }
    let sought =
        if options.merge { wanted.saturating_mul(BEFORE_MERGING).min(wanted.midpoint(all)) } else { wanted };
    let mut best = (all.abs_diff(sought), Bound::None);
    let (mut low, mut high) = (1e-3f64, 30.0f64);
    for _ in 0..SEARCH_STEPS {
        let middle = (low * high).sqrt();
        let found = count(Bound::Rms(middle))?;
        let off = found.abs_diff(sought);
        if off < best.0 {
            best = (off, Bound::Rms(middle));
        }
        if found > sought {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok(best.1)
}

/// Largest angle between triangles whose common edge is flipped, degrees.
const FLIP_ANGLE: f64 = 15.0;
/// Rounds of flips at most.
const FLIP_ROUNDS: usize = 8;

/// How far flips may move the surface, in voxels.
fn tolerance(bound: Bound) -> Option<f64> {
    match bound {
        Bound::None | Bound::Triangles(_) => None,
        Bound::Rms(rms) => Some(rms),
        // The root mean square where the sum is used up by the planes of a small block.
        Bound::Sum(sum) => Some((sum / 16.0).sqrt().min(1.0)),
    }
}

/// Leaves out vertices that no triangle uses (those of polygons that an open border leaves out), and says
/// what the others are.
fn finished(
    made: Triangles,
    sigmas: &[f32],
    geometry: &Geometry,
    statistics: Statistics,
    costs: CostLog,
) -> DualSurface {
    let Triangles { positions, on_border, mut triangles, pairs, .. } = made;
    let mut meetings = vec![Meeting::default(); positions.len()];
    for (t, pair) in triangles.iter().zip(&pairs) {
        for &v in t {
            [pair.back(), pair.front()].into_iter().for_each(|material| meetings[v as usize].add(material));
        }
    }
    let mut numbers = Vec::with_capacity(positions.len());
    let mut count = 0;
    for meeting in &meetings {
        numbers.push(count);
        count += u32::from(meeting.count > 0);
    }
    triangles.par_iter_mut().for_each(|t| {
        *t = t.map(|v| numbers[v as usize]);
        if geometry.is_mirrored() {
            t.swap(1, 2);
        }
    });
    let used = |v: &usize| meetings[*v].count > 0;
    let kinds =
        (0..positions.len()).filter(used).map(|v| VertexKind::new(meetings[v].count.into(), on_border[v]));
    let kinds = kinds.collect();
    // In voxels of mean edge so far.
    let edge = geometry.voxel_edge() as f32;
    let sigmas = (0..sigmas.len()).filter(used).map(|v| sigmas[v] * edge).collect();
    let positions = (0..positions.len()).filter(used).map(|v| positions[v]).collect();
    DualSurface { positions, kinds, sigmas, triangles, pairs, statistics, costs }
}

/// The materials that meet at a vertex; more than four are not told apart from four.
#[derive(Debug, Clone, Copy, Default)]
struct Meeting {
    materials: [u8; 4],
    count: u8,
}

impl Meeting {
    fn add(&mut self, material: MaterialId) {
        let known = &self.materials[..usize::from(self.count)];
        if self.count < 4 && !known.contains(&material.0) {
            self.materials[usize::from(self.count)] = material.0;
            self.count += 1;
        }
    }
}
