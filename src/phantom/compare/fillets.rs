//! Rounded edges of the truth against the mesh: they must not become sharp ones.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Lengths;
use super::nearest::Triangles;
use super::statistics::{Distances, Sample, total};
use crate::mesh::InterfaceMesh;
use crate::phantom::{CurvePiece, Surface, Truth};

/// The rounded edges of one radius: cylinders that pass into other surfaces without a bend.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FilletComparison {
    /// Their radius, voxels.
    pub radius: f64,
    /// Their length, mm: half that of their seams.
    pub length: f64,
    /// From points on them, farther than the near distance from every sharp edge and junction curve, to the mesh. An edge
    /// in the place of a right-angled fillet of radius r is 0.41 r off in the middle.
    pub to_mesh: Option<Distances>,
}

pub(super) fn compare(mesh: &InterfaceMesh, truth: &Truth, lengths: &Lengths) -> Vec<FilletComparison> {
    let surfaces = truth.scene().surfaces();
    let mut rounded: Vec<usize> = truth
        .curves()
        .iter()
        .filter(|piece| piece.is_smooth)
        .flat_map(|piece| piece.touching_surfaces())
        .filter(|&s| matches!(surfaces[s], Surface::Cylinder { .. }))
        .collect();
    rounded.sort_unstable();
    rounded.dedup();
    if rounded.is_empty() {
        return Vec::new();
    }
    let radius = |s: usize| if let Surface::Cylinder { radius, .. } = surfaces[s] { radius } else { 0.0 };
    let mut radii: Vec<f64> = rounded.iter().map(|&s| radius(s)).collect();
    radii.sort_by(f64::total_cmp);
    radii.dedup_by(|a, b| (*a - *b).abs() < 1e-9 * *b);
    // Fine enough for the smallest.
    let step = lengths.step.min(0.25 * radii[0]);
    let samples = truth.all_samples(step);
    let away = |p: DVec3| {
        truth.closest_edge(p).is_none_or(|c| c.1 > lengths.near)
            && truth.closest_junction(p).is_none_or(|c| c.1 > lengths.near)
    };
    let surface = Triangles::new(mesh.positions(), mesh.triangles().iter().copied());
    radii
        .into_iter()
        .map(|r| {
            let own: Vec<usize> =
                rounded.iter().copied().filter(|&s| (radius(s) - r).abs() < 1e-9 * r).collect();
            let on =
                |p: DVec3| own.iter().any(|&s| surfaces[s].signed_distance(p).abs() < 1e-9 * lengths.voxel);
            let found: Vec<Sample> = samples
                .par_iter()
                .filter(|(_, p, _)| on(*p) && away(*p))
                .filter_map(|&(_, p, weight)| Some(Sample { signed: surface.as_ref()?.signed(p), weight }))
                .collect();
            let seams = truth
                .curves()
                .iter()
                .filter(|piece| piece.is_smooth && piece.touching_surfaces().iter().any(|s| own.contains(s)));
            FilletComparison {
                radius: r / lengths.voxel,
                length: 0.5 * total(seams.map(CurvePiece::length)),
                to_mesh: Distances::of(found.into_iter(), lengths.voxel),
            }
        })
        .collect()
}
