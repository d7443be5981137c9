//! Relaxation: vertices move to the middle of their neighbours as far as their QEF leaves them free.
//!
//! A vertex of a flat face may slide in it, one on a sharp edge along it, one at a corner stays: moves go along
//! eigenvectors of small eigenvalues only, stay in the block and keep the error within the tolerance
//! (or where it was). A fixed number of steps; each looks at the positions before it, so the result does
//! not depend on the order, and a step reaches one ring.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::forest::Forest;
use super::leaves::NONE;
use super::octree::Bound;
use super::qef::{Certain, Place, Qef};
use super::roots::SIDE;
use super::vertices::Vertices;

/// Steps; the prototype's three.
const STEPS: usize = 3;

/// Moves the vertices, whose planes are `qefs`, by root.
pub(super) fn relax(forest: &Forest, vertices: &mut Vertices, qefs: &[Vec<Qef>], bound: Bound) {
    let grid = &forest.leaves.grid;
    // The directions in which each vertex is free; none for one that is pinned.
    let free: Vec<Vec<Option<Certain>>> = forest
        .roots()
        .map(|(i, _)| {
            let own = vertices.all[vertices.in_root(i)].iter().zip(&qefs[i]);
            own.map(|(v, qef)| (!v.pinned).then(|| Certain::new(&qef.matrix()))).collect()
        })
        .collect();
    // In lengths about the middle of root 0, so that neighbours in other roots can be averaged.
    let middle: Vec<DVec3> = forest
        .leaves
        .roots
        .iter()
        .map(|r| DVec3::from(grid.low(r.number).map(|c| (c + SIDE / 2) as f64)) * grid.cell)
        .collect();
    let rings = rings(forest, vertices);
    for _ in 0..STEPS {
        let moved: Vec<Vec<DVec3>> = forest
            .roots()
            .map(|(i, root)| {
                let own = vertices.in_root(i);
                let sums = neighbour_sums(vertices, &rings[i], own.clone(), &middle);
                own.zip(&sums)
                    .zip(qefs[i].iter().zip(&free[i]))
                    .map(|((v, (sum, count)), (qef, free))| {
                        let vertex = &vertices.all[v];
                        let Some(free) = free.as_ref().filter(|_| *count > 0.0) else {
                            return vertex.position;
                        };
                        let step = free.leaves_open(*sum / *count - middle[i] - vertex.position);
                        let bounds = forest.block(vertex.owner).bounds(grid);
                        let place = Place { bounds, fixed: grid.fixed(root.number, vertex.sides) };
                        stepped(vertex.position, step, qef, &place, bound)
                    })
                    .collect()
            })
            .collect();
        vertices
            .all
            .par_iter_mut()
            .zip(moved.into_par_iter().flatten_iter().collect::<Vec<_>>())
            .for_each(|(vertex, position)| vertex.position = position);
    }
}

/// A step as far as error and block allow: all of it, half, or none.
fn stepped(at: DVec3, mut step: DVec3, qef: &Qef, place: &Place, bound: Bound) -> DVec3 {
    let old = qef.error(at);
    for _ in 0..2 {
        // As nodes keep it, so that later rounds find the same place.
        let moved = place.clamp(place.clamp(at + step).as_vec3().as_dvec3());
        let error = qef.error(moved);
        if error <= old || bound.admits(error, qef.count()) {
            return moved;
        }
        step /= 2.0;
    }
    at
}

/// For each root the rings, in vertices, that reach it and are no single vertex.
fn rings(forest: &Forest, vertices: &Vertices) -> Vec<Vec<[u32; 4]>> {
    forest
        .roots()
        .map(|(_, root)| {
            let mut rings = Vec::new();
            forest.leaves.crossings_of(root, |_, crossing, _| {
                let ring = crossing.ring.map(|leaf| vertices.of_leaf[leaf as usize]);
                if ring[1..].iter().any(|v| *v != ring[0]) {
                    rings.push(ring);
                }
            });
            rings
        })
        .collect()
}

/// For each vertex in `own` the sum of its neighbours' places along the sides of polygons, and their number.
fn neighbour_sums(
    vertices: &Vertices,
    rings: &[[u32; 4]],
    own: Range<usize>,
    middle: &[DVec3],
) -> Vec<(DVec3, f64)> {
    let mut sums = vec![(DVec3::ZERO, 0.0); own.len()];
    for ring in rings {
        for k in 0..4 {
            let (a, b) = (ring[k], ring[(k + 1) % 4]);
            if a == b || a == NONE || b == NONE {
                continue;
            }
            for (to, from) in [(a as usize, b as usize), (b as usize, a as usize)] {
                if own.contains(&to) {
                    let from = &vertices.all[from];
                    let sum = &mut sums[to - own.start];
                    sum.0 += from.position + middle[from.root as usize];
                    sum.1 += 1.0;
                }
            }
        }
    }
    sums
}
