//! From the unsimplified surface to the finished one.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Builder;
use super::flips::{FlipMesh, FlipOptions, flip};
use super::forest::Forest;
use super::grading::grade;
use super::octree::{Bound, Collapses, Placement};
use super::placement::World;
use super::polygons::Triangles;
use super::remedy::{Making, Remedy, mend};
use crate::contour::error::ContourError;
use crate::contour::patch::Border;
use crate::execution::Execution;
use crate::grid::{Geometry, MaterialId, Pair, VertexKind};

/// How to simplify.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DualOptions {
    /// What error a collapse may make.
    pub bound: Bound,
    /// Where a vertex goes whose best place is outside its block.
    pub placement: Placement,
}

impl Default for DualOptions {
    fn default() -> Self {
        Self { bound: Bound::Rms(0.1), placement: Placement::Clamped }
    }
}

/// What simplification did.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Collapses made and refused.
    pub collapses: Collapses,
    /// Nodes split by grading.
    pub graded: u64,
    /// What was done about triangles that met.
    pub remedy: Remedy,
    /// Edges flipped for better triangles.
    pub flips: u64,
}

/// A labelled surface in the world.
#[derive(Debug, Clone, Default)]
pub struct DualSurface {
    /// Vertex positions, mm.
    pub positions: Vec<DVec3>,
    /// What each vertex is.
    pub kinds: Vec<VertexKind>,
    /// Vertices of each triangle, counter-clockwise seen from its front.
    pub triangles: Vec<[u32; 3]>,
    /// The pair of each triangle.
    pub pairs: Vec<Pair>,
    /// What was done.
    pub statistics: Statistics,
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
        let leaves = self.into_leaves();
        let stage = execution.stage("simplifying", leaves.roots.len() as u64);
        let mut forest = Forest::grow(leaves, options.bound, options.placement, execution, &stage)?;
        drop(stage);
        let graded = grade(&mut forest);
        execution.check()?;
        let grid = forest.leaves.grid.clone();
        let world = World::new(geometry, &grid);
        let DualOptions { bound, placement } = *options;
        let making = Making { bound, placement, border, world: &world, execution };
        let (_, mut made, remedy) = mend(&mut forest, making)?;
        let mut flips = 0;
        if bound != Bound::None {
            let tolerance = match bound {
                Bound::Rms(rms) => rms,
                // A plane's distance that a vertex of a few crossings may have.
                Bound::Sum(sum) => (sum / 16.0).sqrt(),
                Bound::None => 0.0,
            };
            let options =
                FlipOptions { tolerance: tolerance * geometry.voxel_edge(), angle: 15.0, rounds: 8 };
            let mesh = FlipMesh { positions: &made.positions, pairs: &made.pairs, locked: &[] };
            flips = flip(mesh, &mut made.triangles, &options, execution)?.count() as u64;
        }
        let statistics = Statistics { collapses: forest.collapses, graded, remedy, flips };
        Ok(finished(made, geometry, statistics))
    }
}

/// Leaves out vertices that no triangle uses (those of polygons that an open border leaves out), and says
/// what the others are.
fn finished(made: Triangles, geometry: &Geometry, statistics: Statistics) -> DualSurface {
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
    let positions = (0..positions.len()).filter(used).map(|v| positions[v]).collect();
    DualSurface { positions, kinds, triangles, pairs, statistics }
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
