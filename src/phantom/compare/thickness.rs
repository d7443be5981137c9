//! The thin part or gap of a phantom in the mesh: how thick is it?

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Lengths;
use super::nearest::Triangles;
use super::statistics::{Distances, Sample};
use crate::grid::MaterialId;
use crate::mesh::InterfaceMesh;
use crate::phantom::Phantom;

/// A mesh's faces may be this many voxels off before the thin part counts as missing.
const REACH: f64 = 2.0;

/// The thin part or gap of a phantom in the mesh, away from its rim by the near distance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ThicknessComparison {
    /// Its exact thickness, voxels.
    pub exact: f64,
    /// Share of its area where the mesh has both faces within two voxels of their place, percent.
    pub present_percent: f64,
    /// The mesh's thickness less the exact one, there.
    pub error: Option<Distances>,
}

/// `None` for phantoms without a thin part, or one so small that nothing of it is away from its rim.
pub(super) fn compare(
    mesh: &InterfaceMesh,
    phantom: &Phantom,
    lengths: &Lengths,
) -> Option<ThicknessComparison> {
    let truth = phantom.truth();
    let [low, high] = phantom.options().scene.thin_faces()?;
    let surfaces = truth.scene().surfaces();
    let exact = phantom.options().thickness * lengths.voxel;
    let away = |p: DVec3| {
        truth.closest_edge(p).is_none_or(|c| c.1 > lengths.near)
            && truth.closest_junction(p).is_none_or(|c| c.1 > lengths.near)
    };
    let on_low = |p: DVec3| surfaces[low].signed_distance(p).abs() < 1e-6 * lengths.voxel;
    let points: Vec<(DVec3, f64)> = truth
        .all_samples(lengths.step)
        .into_par_iter()
        .filter(|(_, p, _)| on_low(*p) && away(*p) && away(surfaces[high].foot(*p)))
        .map(|(_, p, area)| (p, area))
        .collect();
    let area: f64 = points.iter().map(|p| p.1).sum();
    if points.is_empty() {
        return None;
    }
    let all = mesh.triangles().iter().zip(mesh.pairs());
    let inner = all.filter(|(_, pair)| !pair.contains(MaterialId::OUTSIDE)).map(|(t, _)| *t);
    let surface = Triangles::new(mesh.positions(), inner);
    let limit = 0.5 * exact + REACH * lengths.voxel;
    let measured = |(p, weight): &(DVec3, f64)| {
        let surface = surface.as_ref()?;
        // Both ways from the middle: the first face met each way bounds the part there.
        let out = surfaces[low].normal(*p);
        let middle = *p - 0.5 * exact * out;
        let thickness = surface.hit(middle, out, limit)? + surface.hit(middle, -out, limit)?;
        Some(Sample { signed: thickness - exact, weight: *weight })
    };
    let samples: Vec<Sample> = points.par_iter().filter_map(measured).collect();
    let present: f64 = samples.iter().map(|s| s.weight).sum();
    Some(ThicknessComparison {
        exact: phantom.options().thickness,
        present_percent: 100.0 * present / area,
        error: Distances::of(samples.into_iter(), lengths.voxel),
    })
}
