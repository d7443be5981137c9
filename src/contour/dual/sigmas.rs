//! Standard deviations of vertices, from those of the crossings that they stand for.
//!
//! A vertex gets the root mean square of its crossings' sigmas. Not divided by their number: crossings in one
//! block share the grey values they come from and the model they were fitted with, so their errors go together. Crossings
//! whose sigma is unknown (midpoints count little in a QEF) or that lie at the border are left out. A merged vertex
//! stands for the crossings of all that became part of it.

use rayon::prelude::*;

use super::forest::Forest;
use super::leaves::{Leaves, unpack_sigma};
use super::vertices::Vertices;
use crate::contour::marching::worst;

/// Sum of squares, and number of crossings.
type Sum = (f64, u32);

/// The sums of the vertices of leaves and nodes; empty if no sigmas are known.
pub(super) fn sums(forest: &Forest, vertices: &Vertices) -> Vec<Sum> {
    let leaves = &forest.leaves;
    if leaves.sigmas.is_empty() {
        return Vec::new();
    }
    let by_root: Vec<Vec<Sum>> = forest
        .roots()
        .map(|(i, root)| {
            let own = vertices.in_root(i);
            let mut sums = vec![Sum::default(); own.len()];
            leaves.crossings_of(root, |c, crossing, _| {
                let sigma = f64::from(unpack_sigma(leaves.sigmas[c as usize]));
                if sigma.is_nan() {
                    return;
                }
                for leaf in crossing.ring.into_iter().filter(|l| root.leaves.contains(l)) {
                    let sum = &mut sums[vertices.of_leaf[leaf as usize] as usize - own.start];
                    sum.0 += sigma * sigma;
                    sum.1 += 1;
                }
            });
            sums
        })
        .collect();
    by_root.concat()
}

/// Lets each vertex's sum be part of that of the vertex that it became part of.
pub(super) fn merge(sums: &mut [Sum], survivors: &[u32]) {
    for v in 0..sums.len() {
        let to = survivors[v] as usize;
        if to != v {
            let (square, count) = std::mem::take(&mut sums[v]);
            sums[to].0 += square;
            sums[to].1 += count;
        }
    }
}

/// The sigma of each sum; unknown without crossings.
pub(super) fn roots(sums: &[Sum]) -> impl Iterator<Item = f32> {
    sums.iter().map(
        |&(square, count)| {
            if count == 0 { f32::NAN } else { (square / f64::from(count)).sqrt() as f32 }
        },
    )
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
