//! The true sharp edges against a mesh: does its surface reach them, do edges of its triangles run along them?
//!
//! *Edge to surface*: points along the true edges of a pair, each with its length, to the closest triangle of that
//! pair. A rounded or bevelled edge is far from its surface. *Edge to mesh edge*: the same points to the closest
//! edge of any such triangle: large triangles that cut across a true edge are seen by it, though their corners lie on
//! the surface. *Crease to edge*: points on the mesh's creases (edges of two triangles of the pair that fold by
//! more than [`CREASE`]) to the closest true edge of any pair; creases far from every true edge are noise or steps.
//!
//! The first two are given for all points, and for those *clear* of ends: farther than the clear distance from
//! every corner and every junction curve, where blur moves more than one edge. The first is also given by angle (right
//! angles, others) and by whether an end is within the near distance.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Lengths;
use super::nearest::{Segments, Triangles};
use super::statistics::{Distances, Sample, total};
use crate::grid::Pair;
use crate::mesh::InterfaceMesh;
use crate::phantom::Truth;

/// Edges of a mesh that fold by more than this many degrees are creases: half of a right angle, so that neither
/// a rounded edge (many small folds) nor noise counts as one.
pub const CREASE: f64 = 45.0;

/// Edges of up to this many degrees more or less than 90 count as right-angled: a bolt's are 82 to 98.
const RIGHT: f64 = 10.0;

/// A crease this many voxels from every true edge is one where none should be.
const STRAY: f64 = 2.0;

/// From true edges of one kind to the mesh's surface.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct EdgeSplit {
    /// From points farther than the near distance from every corner and every junction curve.
    pub off_ends: Option<Distances>,
    /// From the others.
    pub at_ends: Option<Distances>,
}

/// The sharp edges of one pair. Distances have no sign; `None` where the mesh has nothing to measure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EdgeComparison {
    /// The material behind.
    pub back: u8,
    /// The material in front.
    pub front: u8,
    /// Length of the true edges, mm.
    pub truth_length: f64,
    /// Length of the mesh's creases, mm.
    pub crease_length: f64,
    /// From the true edges to the mesh's surface.
    pub to_surface: Option<Distances>,
    /// Of these, from points clear of corners and junctions.
    pub to_surface_clear: Option<Distances>,
    /// From the true edges to the edges of the mesh's triangles.
    pub to_mesh_edge: Option<Distances>,
    /// Of these, from points clear of corners and junctions.
    pub to_mesh_edge_clear: Option<Distances>,
    /// From the mesh's creases to the true edges.
    pub crease_to_edge: Option<Distances>,
    /// Length of the mesh's creases farther than two voxels from every true edge, mm.
    #[serde(default)]
    pub stray_crease_length: f64,
    /// From the true edges of 80 to 100 degrees to the mesh's surface.
    #[serde(default)]
    pub right: EdgeSplit,
    /// From all others.
    #[serde(default)]
    pub oblique: EdgeSplit,
}

/// A point of a true edge.
struct Point {
    place: DVec3,
    /// Length of edge it stands for, mm.
    weight: f64,
    /// Farther than the clear distance from corners and junctions.
    clear: bool,
    /// Farther than the near distance from them.
    off_ends: bool,
    /// On an edge of about 90 degrees.
    right: bool,
}

pub(super) fn compare(mesh: &InterfaceMesh, truth: &Truth, lengths: &Lengths) -> Vec<EdgeComparison> {
    let mut pairs: Vec<Pair> = truth.edges().filter_map(|e| e.edge_pair()).collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs.into_iter().map(|pair| of_pair(mesh, truth, lengths, pair)).collect()
}

fn of_pair(mesh: &InterfaceMesh, truth: &Truth, lengths: &Lengths, pair: Pair) -> EdgeComparison {
    let all = mesh.triangles().iter().zip(mesh.pairs());
    let own: Vec<[u32; 3]> = all.filter(|(_, p)| **p == pair).map(|(t, _)| *t).collect();
    let points: Vec<Point> = truth
        .edges()
        .filter(|e| e.edge_pair() == Some(pair))
        .flat_map(|e| {
            let right = (truth.smallest_wedge(e, 0.5 * (e.low + e.high)) - 90.0).abs() <= RIGHT;
            e.curve.samples(e.low, e.high, lengths.step).into_iter().map(move |s| (right, s))
        })
        .map(|(right, (place, weight))| Point {
            place,
            weight,
            clear: is_clear(truth, place, lengths.clear),
            off_ends: is_clear(truth, place, lengths.near),
            right,
        })
        .collect();
    let sides = Sides::of(mesh, &own);
    let measured = |distance: &(dyn Fn(DVec3) -> f64 + Sync)| -> Vec<Sample> {
        let sample = |p: &Point| Sample { signed: distance(p.place), weight: p.weight };
        points.par_iter().map(sample).collect()
    };
    let surface = Triangles::new(mesh.positions(), own.iter().copied());
    let on_surface = surface.map_or_else(Vec::new, |s| measured(&|p| s.signed(p).abs()));
    let on_edges =
        Segments::new(mesh.positions(), sides.all).map_or_else(Vec::new, |s| measured(&|p| s.distance(p)));
    let of = |samples: &[Sample], keep: &dyn Fn(&Point) -> bool| {
        let kept = points.iter().zip(samples).filter(|(p, _)| keep(p)).map(|(_, s)| *s);
        Distances::of(kept, lengths.voxel)
    };
    let by_ends = |right: bool| EdgeSplit {
        off_ends: of(&on_surface, &|p| p.right == right && p.off_ends),
        at_ends: of(&on_surface, &|p| p.right == right && !p.off_ends),
    };
    let ends = |edge: &[u32; 2]| edge.map(|v| mesh.positions()[v as usize]);
    let creases = sides.creases.par_iter().flat_map_iter(|edge| along(ends(edge), lengths.step));
    let samples: Vec<Sample> = creases
        .filter_map(|(p, weight)| truth.closest_edge(p).map(|(_, signed)| Sample { signed, weight }))
        .collect();
    let stray = samples.iter().filter(|s| s.signed > STRAY * lengths.voxel);
    EdgeComparison {
        back: pair.back().0,
        front: pair.front().0,
        truth_length: points.iter().map(|p| p.weight).sum(),
        crease_length: total(sides.creases.iter().map(|e| ends(e)[0].distance(ends(e)[1]))),
        to_surface: of(&on_surface, &|_| true),
        to_surface_clear: of(&on_surface, &|p| p.clear),
        to_mesh_edge: of(&on_edges, &|_| true),
        to_mesh_edge_clear: of(&on_edges, &|p| p.clear),
        stray_crease_length: total(stray.map(|s| s.weight)),
        crease_to_edge: Distances::of(samples.iter().copied(), lengths.voxel),
        right: by_ends(true),
        oblique: by_ends(false),
    }
}

fn is_clear(truth: &Truth, p: DVec3, clear: f64) -> bool {
    truth.closest_junction(p).is_none_or(|j| j.1 > clear)
        && truth.corners().iter().all(|c| c.distance(p) > clear)
}

/// Points along a segment, at most `step` apart, each with the length it stands for, and its ends with none.
pub(super) fn along([a, b]: [DVec3; 2], step: f64) -> impl Iterator<Item = (DVec3, f64)> {
    let length = (b - a).length();
    let count = (length / step).ceil().max(1.0);
    let inside = (0..count as usize).map(move |k| (a.lerp(b, (k as f64 + 0.5) / count), length / count));
    inside.chain([(a, 0.0), (b, 0.0)])
}

/// The edges of a pair's triangles.
struct Sides {
    all: Vec<[u32; 2]>,
    /// Those of exactly two triangles of the pair that fold by more than [`CREASE`].
    creases: Vec<[u32; 2]>,
}

impl Sides {
    fn of(mesh: &InterfaceMesh, own: &[[u32; 3]]) -> Self {
        let mut sides: Vec<([u32; 2], u32)> = own
            .iter()
            .zip(0..)
            .flat_map(|([a, b, c], t)| [[*a, *b], [*b, *c], [*c, *a]].map(|[p, q]| ([p.min(q), p.max(q)], t)))
            .collect();
        sides.par_sort_unstable();
        let normal = |t: u32| {
            let [a, b, c] = own[t as usize].map(|v| mesh.positions()[v as usize]);
            (b - a).cross(c - a).normalize_or_zero()
        };
        let least = libm::cos(CREASE.to_radians());
        let mut out = Self { all: Vec::new(), creases: Vec::new() };
        for around in sides.chunk_by(|a, b| a.0 == b.0) {
            out.all.push(around[0].0);
            if let [(edge, t), (_, u)] = *around {
                let (n, m) = (normal(t), normal(u));
                // A triangle without area has no direction to fold from.
                if n != DVec3::ZERO && m != DVec3::ZERO && n.dot(m) < least {
                    out.creases.push(edge);
                }
            }
        }
        out
    }
}
