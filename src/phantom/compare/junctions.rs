//! Junction curves of a mesh against the true ones.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Lengths;
use super::nearest::Segments;
use super::sharp_edges::along;
use super::statistics::{Distances, Sample};
use crate::grid::MaterialId;
use crate::mesh::InterfaceMesh;
use crate::phantom::Truth;

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
    /// From the mesh's to the true ones; `None` if the mesh or the truth has none.
    pub mesh_to_truth: Option<Distances>,
    /// From the true ones to the mesh's; `None` if the mesh or the truth has none.
    pub truth_to_mesh: Option<Distances>,
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
    let mesh_length = edges.iter().map(|e| length(*e)).sum();
    let truth_length = truth.junction_length();
    if edges.is_empty() && touching == 0 && truth.junctions().next().is_none() {
        return None;
    }
    let forward: Vec<Sample> = edges
        .par_iter()
        .flat_map_iter(|&[p, q]| along([p, q].map(|v| mesh.positions()[v as usize]), lengths.step))
        .filter_map(|(p, weight)| truth.closest_junction(p).map(|(_, signed)| Sample { signed, weight }))
        .collect();
    let backward: Vec<Sample> = Segments::new(mesh.positions(), edges).map_or_else(Vec::new, |segments| {
        let points: Vec<(DVec3, f64)> =
            truth.junctions().flat_map(|j| j.curve.samples(j.low, j.high, lengths.step)).collect();
        points.par_iter().map(|&(p, weight)| Sample { signed: segments.distance(p), weight }).collect()
    });
    Some(JunctionComparison {
        mesh_length,
        touching_edges: touching,
        truth_length,
        mesh_to_truth: Distances::of(forward.into_iter(), lengths.voxel),
        truth_to_mesh: Distances::of(backward.into_iter(), lengths.voxel),
    })
}
