//! Relaxation: vertices move to the middle of their neighbours as far as their QEF leaves them free.
//!
//! A vertex of a flat face may slide in it, one on a sharp edge along it, one at a corner stays: moves go along
//! eigenvectors of small eigenvalues only, stay in the block and keep the error within the tolerance
//! (or where it was). Then vertices beside slivers may move in any direction, by as much as no scan could tell; but not those of
//! curves that models know.
//! A fixed number of steps; each looks at the positions before it, so the result does
//! not depend on the order, and a step reaches one ring.

use glam::DVec3;
use rayon::prelude::*;

use super::forest::Forest;
use super::leaves::NONE;
use super::octree::Bound;
use super::polygons::distinct;
use super::qef::{Certain, Place, Qef};
use super::vertices::Vertices;
use crate::triangle::triangle_quality;

/// Steps; the prototype's three.
const STEPS: usize = 3;
/// Steps of vertices beside slivers, in any direction.
const SLIVER_STEPS: usize = 6;
/// Root mean square distance to its planes that a vertex beside a sliver may get, in voxels of mean edge.
const SLIVER: Bound = Bound::Rms(0.1);
/// A polygon whose triangles have a lower quality q is a sliver.
const LOW: f64 = 0.3;

/// Moves the vertices, whose planes are `qefs`, by root.
pub(super) fn relax(forest: &Forest, vertices: &mut Vertices, qefs: &[Vec<Qef>], bound: Bound) {
    let mut mover = Mover::new(forest, vertices, qefs, bound.scaled(forest.leaves.closer()));
    let certain: Vec<Vec<Certain>> =
        qefs.par_iter().map(|own| own.iter().map(|qef| Certain::new(&qef.matrix())).collect()).collect();
    for _ in 0..STEPS {
        let free = |_, [root, k]: [usize; 2], d| Some(certain[root][k].leaves_open(d));
        mover.step(vertices, free, |error, count| bound.admits(error, count));
    }
    // Only what these steps move, and what is around it, is looked at again.
    let first = mover.beside_slivers(vertices);
    let near = mover.touched(&first);
    mover.rings.par_iter_mut().for_each(|rings| rings.retain(|ring| any(ring, &near)));
    for _ in 0..SLIVER_STEPS {
        let mut beside = mover.beside_slivers(vertices);
        beside.par_iter_mut().zip(&near).for_each(|(beside, near)| *beside &= near);
        let admits = |error, count| bound.admits(error, count) || SLIVER.admits(error, count);
        beside.iter_mut().zip(&vertices.all).for_each(|(beside, vertex)| *beside &= !vertex.curve);
        mover.step(vertices, |v: usize, _, d| beside[v].then_some(d), admits);
    }
}

/// Moves vertices, all at once.
struct Mover<'a> {
    forest: &'a Forest,
    qefs: &'a [Vec<Qef>],
    /// How far vertices of curves may get from their planes where models know those.
    curves: Bound,
    /// The middles of roots, in lengths about that of root 0.
    middle: Vec<DVec3>,
    /// For each root the rings, in vertices, that reach it and are no single vertex.
    rings: Vec<Vec<[u32; 4]>>,
}

impl<'a> Mover<'a> {
    fn new(forest: &'a Forest, vertices: &Vertices, qefs: &'a [Vec<Qef>], curves: Bound) -> Self {
        let grid = &forest.leaves.grid;
        let middle = forest.leaves.roots.iter().map(|r| grid.offset(r.number)).collect();
        Self { forest, qefs, curves, middle, rings: rings(forest, vertices) }
    }

    /// Moves each vertex towards the mean of its neighbours: by as much of the way `d` as `free(vertex, [root,
    /// its number there], d)` leaves of it, as far as block and error allow.
    fn step(
        &self,
        vertices: &mut Vertices,
        free: impl Fn(usize, [usize; 2], DVec3) -> Option<DVec3> + Sync,
        admits: impl Fn(f64, f64) -> bool + Sync,
    ) {
        let grid = &self.forest.leaves.grid;
        let moved: Vec<Vec<DVec3>> = self
            .forest
            .roots()
            .map(|(i, root)| {
                let own = vertices.in_root(i);
                let sums = self.neighbour_sums(vertices, i);
                own.zip(sums.iter().zip(&self.qefs[i]))
                    .enumerate()
                    .map(|(k, (v, ((sum, count), qef)))| {
                        let vertex = &vertices.all[v];
                        let at = vertex.position;
                        if vertex.pinned || *count == 0.0 {
                            return at;
                        }
                        let Some(step) = free(v, [i, k], *sum / *count - self.middle[i] - at) else {
                            return at;
                        };
                        let [low, high] = self.forest.block(vertex.owner).bounds(grid);
                        let bounds = [low.min(at), high.max(at)];
                        let place = Place { bounds, fixed: grid.fixed(root.number, vertex.sides) };
                        let admits = |error, count| {
                            if vertex.curve { self.curves.admits(error, count) } else { admits(error, count) }
                        };
                        stepped(at, step, qef, &place, &admits)
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

    /// Where a vertex lies, in lengths about that of root 0.
    fn at(&self, vertices: &Vertices, v: u32) -> DVec3 {
        let vertex = &vertices.all[v as usize];
        vertex.position + self.middle[vertex.root as usize]
    }

    /// Flags the vertices of polygons that are slivers however they are split.
    fn beside_slivers(&self, vertices: &Vertices) -> Vec<bool> {
        let is_sliver = |ring: &&[u32; 4]| {
            let (ring, count) = distinct(**ring);
            if count < 3 || ring[..count].contains(&NONE) {
                return false;
            }
            let at = ring.map(|v| if v == NONE { DVec3::ZERO } else { self.at(vertices, v) });
            let [p, q, r, s] = at;
            let worse = |a, b| triangle_quality(a).min(triangle_quality(b));
            let best = match count {
                3 => triangle_quality([p, q, r]),
                _ => worse([p, q, r], [p, r, s]).max(worse([q, r, s], [q, s, p])),
            };
            best < LOW
        };
        let found: Vec<u32> = self
            .rings
            .par_iter()
            .flat_map_iter(|rings| rings.iter().filter(is_sliver).flatten().copied())
            .collect();
        let mut out = vec![false; vertices.all.len()];
        found.into_iter().filter(|&v| v != NONE).for_each(|v| out[v as usize] = true);
        out
    }

    /// Flags the vertices of all rings that have a flagged one.
    fn touched(&self, flags: &[bool]) -> Vec<bool> {
        let mut out = vec![false; flags.len()];
        let touched = self.rings.iter().flatten().filter(|ring| any(ring, flags)).flatten();
        touched.filter(|&&v| v != NONE).for_each(|&v| out[v as usize] = true);
        out
    }

    /// For each vertex of a root the sum of its neighbours' places along the sides of polygons, and their number.
    fn neighbour_sums(&self, vertices: &Vertices, root: usize) -> Vec<(DVec3, f64)> {
        let own = vertices.in_root(root);
        let mut sums = vec![(DVec3::ZERO, 0.0); own.len()];
        for ring in &self.rings[root] {
            for k in 0..4 {
                let (a, b) = (ring[k], ring[(k + 1) % 4]);
                if a == b || a == NONE || b == NONE {
                    continue;
                }
                for (to, from) in [(a as usize, b), (b as usize, a)] {
                    if own.contains(&to) {
                        let sum = &mut sums[to - own.start];
                        sum.0 += self.at(vertices, from);
                        sum.1 += 1.0;
                    }
                }
            }
        }
        sums
    }
}

/// Whether a ring has a flagged vertex.
fn any(ring: &[u32; 4], flags: &[bool]) -> bool {
    ring.iter().any(|&v| v != NONE && flags[v as usize])
}

/// A step as far as error and block allow: all of it, half, or none.
fn stepped(
    at: DVec3,
    mut step: DVec3,
    qef: &Qef,
    place: &Place,
    admits: &impl Fn(f64, f64) -> bool,
) -> DVec3 {
    let old = qef.error(at);
    for _ in 0..2 {
        // As nodes keep it, so that later rounds find the same place.
        let moved = place.clamp(place.clamp(at + step).as_vec3().as_dvec3());
        let error = qef.error(moved);
        if error <= old || admits(error, qef.count()) {
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
