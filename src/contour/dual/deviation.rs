//! How far the simplified surface lies from the unsimplified one.

use std::collections::BTreeSet;

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::forest::Forest;
use super::leaves::NONE;
use super::placement::World;
use super::polygons::Triangles;
use super::qef::{Placement, Qef};
use super::vertices::Vertices;

/// Distances from the vertices of the unsimplified mesh to the simplified one, voxels of mean edge.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Deviation {
    /// Root mean square.
    pub rms: f64,
    /// The largest.
    pub maximum: f64,
}

/// A distance, in voxels, that no look at further triangles can lower enough to matter.
const NEAR: f64 = 0.01;

/// Where no triangle is nearer than this, in voxels, more of them are looked at: so many edges away.
const FAR: f64 = 0.5;
/// See [`FAR`].
const RINGS: usize = 4;

/// Measures it. A vertex is compared with the triangles around the vertex that it became part of, and, where
/// it is not near them, with those around their other corners: an upper bound of the distance.
pub(super) fn deviation(
    forest: &Forest,
    vertices: &Vertices,
    made: &Triangles,
    placement: Placement,
    world: &World<'_>,
    edge: f64,
) -> Deviation {
    let around = Around::new(made);
    let leaves = &forest.leaves;
    let sums: Vec<(f64, f64, u64)> = forest
        .roots()
        .map(|(_, root)| {
            let first = root.leaves.start;
            let mut qefs = vec![Qef::default(); root.leaves.len()];
            leaves.add_planes(root, &mut qefs, |leaf| (leaf - first) as usize);
            let (mut sum, mut maximum, mut count) = (0.0, 0.0f64, 0);
            for (leaf, qef) in root.leaves.clone().zip(&qefs) {
                let vertex = vertices.of_leaf[leaf as usize];
                if vertex == NONE || qef.count() == 0.0 {
                    continue;
                }
                let at = leaves.vertex(root, leaf, qef, placement);
                let Some(distance) =
                    around.distance(vertex, world.place(root.number, at), [NEAR * edge, FAR * edge])
                else {
                    continue;
                };
                sum += distance * distance;
                maximum = maximum.max(distance);
                count += 1;
            }
            (sum, maximum, count)
        })
        .collect();
    let count: u64 = sums.iter().map(|s| s.2).sum();
    let sum: f64 = sums.iter().map(|s| s.0).sum();
    let maximum = sums.iter().fold(0.0, |m: f64, s| m.max(s.1));
    Deviation { rms: (sum / count.max(1) as f64).sqrt() / edge, maximum: maximum / edge }
}

/// The triangles around each vertex, and a sphere around each triangle.
struct Around<'a> {
    made: &'a Triangles,
    first: Vec<u32>,
    triangles: Vec<u32>,
    /// Middle and radius.
    spheres: Vec<(DVec3, f64)>,
}

impl<'a> Around<'a> {
    fn new(made: &'a Triangles) -> Self {
        let mut first = vec![0u32; made.positions.len() + 1];
        made.triangles.iter().flatten().for_each(|&v| first[v as usize + 1] += 1);
        (1..first.len()).for_each(|v| first[v] += first[v - 1]);
        let mut next = first.clone();
        let mut triangles = vec![0; 3 * made.triangles.len()];
        for (t, corners) in made.triangles.iter().enumerate() {
            for &v in corners {
                triangles[next[v as usize] as usize] = t as u32;
                next[v as usize] += 1;
            }
        }
        let sphere = |&t: &[u32; 3]| {
            let corners = t.map(|v| made.positions[v as usize]);
            let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
            (middle, corners.iter().fold(0.0, |r: f64, c| r.max(c.distance(middle))))
        };
        let spheres = made.triangles.par_iter().map(sphere).collect();
        Self { made, first, triangles, spheres }
    }

    fn of(&self, vertex: u32) -> &[u32] {
        &self.triangles[self.first[vertex as usize] as usize..self.first[vertex as usize + 1] as usize]
    }

    /// Distance from `p` to the triangles around a vertex and, if none is as near as `near`, to those around its
    /// neighbours, and if none is as near as `far`, to those some rings further out; `None` for a vertex without
    /// triangles.
    fn distance(&self, vertex: u32, p: DVec3, [near, far]: [f64; 2]) -> Option<f64> {
        let mut best = self.least(vertex, p, f64::INFINITY);
        if best > near {
            for v in self.neighbours(vertex) {
                best = self.least(v, p, best);
            }
        }
        if best > far {
            best = self.least_around(vertex, p, best);
        }
        best.is_finite().then_some(best)
    }

    /// The corners of the triangles around a vertex but itself, most of them twice.
    fn neighbours(&self, vertex: u32) -> impl Iterator<Item = u32> {
        let corners = self.of(vertex).iter().flat_map(|&t| self.made.triangles[t as usize]);
        corners.filter(move |&v| v != vertex)
    }

    /// The distance to the triangles around a vertex, if it is less than `best`.
    fn least(&self, vertex: u32, p: DVec3, mut best: f64) -> f64 {
        for &t in self.of(vertex) {
            let (middle, radius) = self.spheres[t as usize];
            // Nothing in its sphere is nearer.
            if p.distance_squared(middle) < (best + radius) * (best + radius) {
                let corners = self.made.triangles[t as usize].map(|v| self.made.positions[v as usize]);
                best = best.min(squared_distance(p, corners).sqrt());
            }
        }
        best
    }

    /// The same for all vertices up to [`RINGS`] edges away.
    fn least_around(&self, vertex: u32, p: DVec3, mut best: f64) -> f64 {
        let mut seen = BTreeSet::from([vertex]);
        let mut ring = vec![vertex];
        for _ in 0..RINGS {
            let next: BTreeSet<u32> = ring.iter().flat_map(|&v| self.neighbours(v)).collect();
            ring = next.difference(&seen).copied().collect();
            best = ring.iter().fold(best, |best, &v| self.least(v, p, best));
            seen.extend(&ring);
        }
        best
    }
}

/// Square of the distance from a point to a triangle (after Ericson, Real-Time Collision Detection, 5.1.5).
fn squared_distance(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return ap.length_squared();
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return bp.length_squared();
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (ap - ab * (d1 / (d1 - d3))).length_squared();
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return cp.length_squared();
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (ap - ac * (d2 / (d2 - d6))).length_squared();
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return (bp - (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))).length_squared();
    }
    let scale = 1.0 / (va + vb + vc);
    (ap - ab * (vb * scale) - ac * (vc * scale)).length_squared()
}
