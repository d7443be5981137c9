//! The points at which junction curves meet, end or turn, against a mesh.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::Lengths;
use super::nearest::Segments;
use super::statistics::{Distances, Sample};
use crate::grid::VertexKind;
use crate::mesh::InterfaceMesh;

/// A true point is missed if no vertex on a junction is within this many voxels.
pub const FOUND: f64 = 2.0;

/// True points against a mesh.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct PointComparison {
    /// How many the truth has.
    pub truth: usize,
    /// Those with neither a junction point nor a vertex of a junction curve within [`FOUND`] voxels.
    pub missed: usize,
    /// Those without a junction point within [`FOUND`] voxels: the nearest vertex of a junction curve, or of a junction
    /// point farther away, was taken.
    pub by_curve: usize,
    /// From each true point to the vertex that stands for it; `None` if there is nothing to measure.
    pub distances: Option<Distances>,
    /// From each true point to the nearest point of the mesh's junction curves, vertex or not.
    pub to_curve: Option<Distances>,
}

/// `curves`: the mesh's junction curves, if it has any.
pub(super) fn compare(
    mesh: &InterfaceMesh,
    points: &[DVec3],
    curves: Option<&Segments>,
    lengths: &Lengths,
) -> PointComparison {
    let of_kind = |kinds: &[VertexKind]| -> Vec<DVec3> {
        let all = mesh.positions().iter().zip(mesh.kinds());
        all.filter(|(_, kind)| kinds.contains(kind)).map(|(p, _)| *p).collect()
    };
    let nodes = of_kind(&[VertexKind::JunctionPoint]);
    let vertices = of_kind(&[VertexKind::JunctionPoint, VertexKind::JunctionCurve]);
    let nearest =
        |among: &[DVec3], p: DVec3| among.iter().map(|q| q.distance(p)).fold(f64::INFINITY, f64::min);
    let found = FOUND * lengths.voxel;
    let mut out = PointComparison { truth: points.len(), ..PointComparison::default() };
    let (mut distances, mut to_curve) = (Vec::new(), Vec::new());
    for &p in points {
        let mut signed = nearest(&nodes, p);
        if signed > found {
            signed = nearest(&vertices, p);
            out.by_curve += usize::from(signed <= found);
            out.missed += usize::from(signed > found);
        }
        if signed.is_finite() {
            distances.push(Sample { signed, weight: 1.0 });
        }
        if let Some(curves) = curves {
            to_curve.push(Sample { signed: curves.distance(p), weight: 1.0 });
        }
    }
    out.distances = Distances::of(distances.into_iter(), lengths.voxel);
    out.to_curve = Distances::of(to_curve.into_iter(), lengths.voxel);
    out
}
