//! Relaxation: vertices move to the middle of their neighbours as far as their QEF leaves them free.
//!
//! A vertex of a flat face may slide in it, one on a sharp edge along it, one at a corner stays: moves go along
//! eigenvectors of small eigenvalues only, stay in the block and keep the error within the tolerance
//! (or where it was). A fixed number of steps; each looks at the positions before it, so the result does
//! not depend on the order, and a step reaches one ring.

use glam::DVec3;
use rayon::prelude::*;

use super::forest::Forest;
use super::leaves::NONE;
use super::octree::Bound;
use super::qef::{Eigen, Place};
use super::roots::SIDE;
use super::vertices::Vertices;

/// Steps; the prototype's three.
const STEPS: usize = 3;

/// Moves the vertices.
pub(super) fn relax(forest: &Forest, vertices: &mut Vertices, bound: Bound) {
    let grid = &forest.leaves.grid;
    let eigen: Vec<Option<Eigen>> =
        vertices.all.par_iter().map(|v| (!v.pinned).then(|| Eigen::new(&v.qef.matrix()))).collect();
    // In lengths about the middle of root 0, so that neighbours in other roots can be averaged.
    let middle: Vec<DVec3> = forest
        .leaves
        .roots
        .iter()
        .map(|r| DVec3::from(grid.low(r.number).map(|c| (c + SIDE / 2) as f64)) * grid.cell)
        .collect();
    for _ in 0..STEPS {
        let sums = neighbour_sums(forest, vertices, &middle);
        vertices.all.par_iter_mut().zip(&eigen).zip(&sums).for_each(|((vertex, eigen), (sum, count))| {
            let Some(eigen) = eigen.as_ref().filter(|_| *count > 0.0) else { return };
            let target = *sum / *count - middle[vertex.root as usize];
            let place = Place { bounds: forest.block(vertex.owner).bounds(grid), fixed: vertex.fixed };
            let old = vertex.qef.error(vertex.position);
            let mut step = eigen.along_small(target - vertex.position);
            for _ in 0..2 {
                let moved = place.clamp(vertex.position + step);
                let error = vertex.qef.error(moved);
                if error <= old || bound.admits(error, vertex.qef.count()) {
                    // As nodes keep it, so that later rounds find the same place.
                    vertex.position = place.clamp(moved.as_vec3().as_dvec3());
                    break;
                }
                step /= 2.0;
            }
        });
    }
}

/// For each vertex the sum of its neighbours' places along the sides of polygons, and their number.
fn neighbour_sums(forest: &Forest, vertices: &Vertices, middle: &[DVec3]) -> Vec<(DVec3, f64)> {
    let leaves = &forest.leaves;
    let by_root: Vec<Vec<(DVec3, f64)>> = forest
        .roots()
        .map(|(i, root)| {
            let first = vertices.all.partition_point(|v| (v.root as usize) < i);
            let count = vertices.all[first..].partition_point(|v| v.root as usize == i);
            let mut sums = vec![(DVec3::ZERO, 0.0); count];
            leaves.crossings_of(root, |_, crossing, _| {
                let ring = crossing.ring.map(|leaf| vertices.of_leaf[leaf as usize]);
                for k in 0..4 {
                    let (a, b) = (ring[k], ring[(k + 1) % 4]);
                    if a == b || a == NONE || b == NONE {
                        continue;
                    }
                    for (own, other) in [(a as usize, b as usize), (b as usize, a as usize)] {
                        if (first..first + count).contains(&own) {
                            let other = &vertices.all[other];
                            let sum = &mut sums[own - first];
                            sum.0 += other.position + middle[other.root as usize];
                            sum.1 += 1.0;
                        }
                    }
                }
            });
            sums
        })
        .collect();
    by_root.into_iter().flatten().collect()
}
