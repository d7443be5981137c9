//! Standard deviations of vertices, from those of the crossings that they stand for and from how well they fit them.
//!
//! A vertex gets the root mean square of its crossings' sigmas. Not divided by their number: crossings in one
//! block share the grey values they come from and the model they were fitted with, so their errors go together. Crossings
//! whose sigma is unknown (midpoints count little in a QEF) or that lie at the border are left out. A merged vertex
//! stands for the crossings of all that became part of it.
//!
//! To that comes what simplification does: a vertex that stands for much of a face that bends lies beside it (on the
//! tangent planes' side). How far its crossings and their normals together tell ([`Qef::beside`]), and no farther than what its distances from
//! their planes show: on an edge, which bends without end, they show no more than noise. (What crossings' own deviations explain of these distances is not taken off:
//! neighbouring crossings err together, so it is little. With it off, a ball's vertices are stated too sure.)

use glam::DVec3;
use rayon::prelude::*;

use super::forest::Forest;
use super::leaves::{Leaves, unpack_sigma};
use super::placement::World;
use super::qef::Qef;
use super::vertices::Vertices;
use crate::contour::marching::worst;

/// Square of a vertex's distance from a face that bends over its mean square distance from the face's planes. Those of points spread
/// evenly over a disc are evenly spread over the heights from 0 to h above its middle: mean h / 2, variance h² / 12.
const BENT: f64 = 3.0;

/// What the square of a distance that is known counts for: most vertices of a face that bends alike are equally far beside it, about half of them
/// a little more than was found. With this two thirds of a ball's vertices lie within one deviation.
const SURE: f64 = 1.25;

/// What is known of a vertex.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sum {
    /// Sum of the squares of crossings' sigmas.
    squares: f64,
    /// The planes of these crossings, about the vertex.
    planes: Qef,
}

impl Sum {
    /// Square of sigma; unknown without crossings.
    fn variance(&self) -> f64 {
        let count = self.planes.count();
        if count == 0.0 {
            return f64::NAN;
        }
        let misfit = self.planes.error(DVec3::ZERO) / count;
        let bent = (BENT * misfit).min(SURE * self.planes.beside().powi(2));
        self.squares / count + bent
    }
}

/// The sums of the vertices of leaves and nodes; empty if no sigmas are known. `at` has where each vertex, or what it became
/// part of, lies in the world.
pub(super) fn sums(
    forest: &Forest,
    vertices: &Vertices,
    world: &World<'_>,
    at: impl Fn(usize) -> DVec3 + Sync,
) -> Vec<Sum> {
    let leaves = &forest.leaves;
    if leaves.sigmas.is_empty() {
        return Vec::new();
    }
    let by_root: Vec<Vec<Sum>> = forest
        .roots()
        .map(|(i, root)| {
            let own = vertices.in_root(i);
            let number = |leaf: u32| vertices.of_leaf[leaf as usize] as usize - own.start;
            let mut sums = vec![Sum::default(); own.len()];
            leaves.crossings_of(root, |c, crossing, place| {
                let sigma = f64::from(unpack_sigma(leaves.sigmas[c as usize]));
                if sigma.is_nan() {
                    return;
                }
                for leaf in crossing.ring.into_iter().filter(|l| root.leaves.contains(l)) {
                    let sum = &mut sums[number(leaf)];
                    sum.squares += sigma * sigma;
                    leaves.add_plane(&mut sum.planes, root, leaf, crossing, place);
                }
            });
            for (sum, v) in sums.iter_mut().zip(own) {
                sum.planes = sum.planes.shifted(-world.seen_from(root.number, at(v)));
            }
            sums
        })
        .collect();
    // One by one: twice all of them at once would be the peak without simplification.
    let mut sums = Vec::with_capacity(vertices.all.len());
    by_root.into_iter().for_each(|part| sums.extend(part));
    sums
}

/// Lets each vertex's sum be part of that of the vertex that it became part of.
pub(super) fn merge(sums: &mut [Sum], survivors: &[u32]) {
    for v in 0..sums.len() {
        let to = survivors[v] as usize;
        if to != v {
            let Sum { squares, planes } = std::mem::take(&mut sums[v]);
            let kept = &mut sums[to];
            kept.squares += squares;
            kept.planes.merge(&planes);
        }
    }
}

/// The sigma of each sum; unknown without crossings.
pub(super) fn roots(sums: &[Sum]) -> Vec<f32> {
    sums.par_iter().map(|sum| sum.variance().sqrt() as f32).collect()
}

/// The least sure sigma of some crossings that a vertex is the mean of: unknown if one of them is. `None` if none are
/// known at all.
pub(super) fn worst_sigma(leaves: &Leaves, crossings: impl IntoIterator<Item = u32>) -> Option<f32> {
    if leaves.sigmas.is_empty() {
        return None;
    }
    let sigmas = crossings.into_iter().map(|c| unpack_sigma(leaves.sigmas[c as usize]));
    Some(worst(sigmas))
}
