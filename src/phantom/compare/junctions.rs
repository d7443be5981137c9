//! Junction curves of a mesh against the true ones.
//!
//! Given for all points, and apart for the kinds of curves that methods find differently hard: *tight* ones, of a radius
//! of curvature under [`TIGHT`] voxels; of the others *narrow* ones, around which some material is a wedge of less
//! than [`NARROW`] degrees; and *plain* ones, the rest. A point of the mesh counts with the true curve nearest to it.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Lengths;
use super::nearest::Segments;
use super::points::{self, PointComparison};
use super::sharp_edges::along;
use super::statistics::{Distances, Sample, total};
use crate::grid::MaterialId;
use crate::mesh::InterfaceMesh;
use crate::phantom::{CurvePiece, Truth};

/// Junction curves around which a material fills less than this many degrees are narrow.
pub const NARROW: f64 = 50.0;
/// Junction curves of a radius of curvature under this many voxels are tight.
pub const TIGHT: f64 = 6.0;

/// Distances of one kind of junction curves, without a sign.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct CurveDistances {
    /// From the mesh's to the true ones; `None` if there are none of them.
    pub mesh_to_truth: Option<Distances>,
    /// From the true ones to the mesh's; `None` if the truth has none of them or the mesh no junction curves.
    pub truth_to_mesh: Option<Distances>,
}

/// Junction curves of a mesh against the true ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JunctionComparison {
    /// Length of the mesh's junction curves, mm.
    pub mesh_length: f64,
    /// Edges of two materials but three or more triangles, where sheets of one interface touch: not counted as
    /// junction curves.
    pub touching_edges: usize,
    /// Length of the true ones, mm.
    pub truth_length: f64,
    /// All of them; in JSON the fields stand beside the lengths.
    #[serde(flatten)]
    pub all: CurveDistances,
    /// Those that are neither tight nor narrow.
    #[serde(default)]
    pub plain: CurveDistances,
    /// Those with a wedge of less than [`NARROW`] degrees, tight ones left out.
    #[serde(default)]
    pub narrow: CurveDistances,
    /// Those of a radius of curvature under [`TIGHT`] voxels.
    #[serde(default)]
    pub tight: CurveDistances,
    /// The points where four or more materials meet.
    #[serde(default)]
    pub points: PointComparison,
    /// The points where a junction curve ends or turns sharply with fewer materials around.
    #[serde(default)]
    pub kinks: PointComparison,
}

/// Edges of a mesh at which more than two triangles or materials meet, without those on the volume's border.
#[derive(Default)]
pub(super) struct Edges {
    /// Three or more materials: on a junction curve.
    pub(super) junction: Vec<[u32; 2]>,
    /// Two materials, but three or more triangles: sheets of one interface that touch.
    pub(super) touching: usize,
}

pub(super) fn edges(mesh: &InterfaceMesh) -> Edges {
    let mut sides: Vec<([u32; 2], u32)> = mesh
        .triangles()
        .iter()
        .enumerate()
        .flat_map(|(t, [a, b, c])| {
            [[*a, *b], [*b, *c], [*c, *a]].map(|[p, q]| ([p.min(q), p.max(q)], t as u32))
        })
        .collect();
    sides.par_sort_unstable();
    let mut out = Edges::default();
    for around in sides.chunk_by(|a, b| a.0 == b.0) {
        let mut materials: Vec<MaterialId> = around
            .iter()
            .flat_map(|(_, t)| {
                let pair = mesh.pairs()[*t as usize];
                [pair.back(), pair.front()]
            })
            .collect();
        materials.sort_unstable();
        materials.dedup();
        if materials.contains(&MaterialId::OUTSIDE) {
            continue;
        }
        if materials.len() >= 3 {
            out.junction.push(around[0].0);
        } else if around.len() >= 3 {
            out.touching += 1;
        }
    }
    out
}

pub(super) fn compare(mesh: &InterfaceMesh, truth: &Truth, lengths: &Lengths) -> Option<JunctionComparison> {
    let Edges { junction: edges, touching } = edges(mesh);
    let length = |[p, q]: [u32; 2]| (mesh.positions()[p as usize] - mesh.positions()[q as usize]).length();
    let mesh_length = total(edges.iter().map(|e| length(*e)));
    let truth_length = total(truth.junctions().map(CurvePiece::length));
    if edges.is_empty() && touching == 0 && truth.junctions().next().is_none() {
        return None;
    }
    let forward: Vec<(Kind, Sample)> = edges
        .par_iter()
        .flat_map_iter(|&[p, q]| along([p, q].map(|v| mesh.positions()[v as usize]), lengths.step))
        .filter_map(|(p, weight)| {
            let on = truth.on_junction(p)?;
            Some((kind(truth, on.piece, on.t, lengths.voxel), Sample { signed: on.distance, weight }))
        })
        .collect();
    let segments = Segments::new(mesh.positions(), edges);
    let backward: Vec<(Kind, Sample)> = segments.as_ref().map_or_else(Vec::new, |segments| {
        let points: Vec<(&CurvePiece, DVec3, f64)> = truth
            .junctions()
            .flat_map(|j| {
                j.curve
                    .samples(j.low, j.high, lengths.step)
                    .into_iter()
                    .map(move |(p, weight)| (j, p, weight))
            })
            .collect();
        points
            .par_iter()
            .map(|&(piece, p, weight)| {
                let t = piece.curve.closest(p, piece.low, piece.high);
                (kind(truth, piece, t, lengths.voxel), Sample { signed: segments.distance(p), weight })
            })
            .collect()
    });
    let of = |keep: &dyn Fn(Kind) -> bool| {
        let [mesh_to_truth, truth_to_mesh] = [&forward, &backward]
            .map(|samples| Distances::of(samples.iter().filter(|s| keep(s.0)).map(|s| s.1), lengths.voxel));
        CurveDistances { mesh_to_truth, truth_to_mesh }
    };
    let at = |p: &[DVec3]| points::compare(mesh, p, segments.as_ref(), lengths);
    Some(JunctionComparison {
        mesh_length,
        touching_edges: touching,
        truth_length,
        all: of(&|_| true),
        plain: of(&|kind| kind == Kind::Plain),
        narrow: of(&|kind| kind == Kind::Narrow),
        tight: of(&|kind| kind == Kind::Tight),
        points: at(truth.junction_points()),
        kinks: at(truth.junction_kinks()),
    })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Plain,
    Narrow,
    Tight,
}

/// The kind of a junction piece at parameter `t`.
fn kind(truth: &Truth, piece: &CurvePiece, t: f64, voxel: f64) -> Kind {
    // At the very ends other surfaces pass.
    let margin = 1e-3 * (piece.high - piece.low);
    let t = t.clamp(piece.low + margin, piece.high - margin);
    if piece.curve.radius(t) < TIGHT * voxel {
        Kind::Tight
    } else if truth.smallest_wedge(piece, t) < NARROW {
        Kind::Narrow
    } else {
        Kind::Plain
    }
}
