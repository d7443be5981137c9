//! Which interface a voxel is nearest to, and how far from it and from the nearest junction curve it is.

use glam::DVec3;
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::{Segment, Triangle};

use super::by_slice::BySlice;
use crate::grid::Pair;

/// Triangles and junction edges with coordinates in voxels times spacing: distances are mm, axes the lattice's.
pub(super) struct Near<'a> {
    pub(super) positions: &'a [DVec3],
    pub(super) triangles: &'a [[u32; 3]],
    pub(super) pairs: &'a [Pair],
    /// Ends of junction edges.
    pub(super) junctions: &'a [[DVec3; 2]],
    /// Which of them reach, with their surroundings, into which slice of the volume.
    pub(super) by_slice: &'a [BySlice; 2],
    pub(super) spacing: DVec3,
    pub(super) size: [usize; 2],
    /// How far from interfaces, and from junctions, voxels are looked at, mm.
    pub(super) reach: [f64; 2],
}

/// What is near a voxel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Nearest {
    /// The interface nearest to it, unless none is within reach.
    pub(super) pair: Option<Pair>,
    /// Whether a junction curve is within its reach.
    pub(super) junction: bool,
}

fn vector(p: DVec3) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

impl Near<'_> {
    /// Calls `visit(voxel of the slice, centre)` for the voxels of slice `z` in a box around points.
    fn around(&self, points: &[DVec3], reach: f64, z: usize, mut visit: impl FnMut(usize, Vector)) {
        let low = points.iter().fold(DVec3::INFINITY, |a, p| a.min(*p)) - reach;
        let high = points.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p)) + reach;
        let range = |a: usize| {
            let first = (low[a] / self.spacing[a]).ceil().max(0.0) as usize;
            let end = ((high[a] / self.spacing[a]).floor() + 1.0).max(0.0) as usize;
            first..end.min(self.size[a])
        };
        let z = z as f64 * self.spacing.z;
        if z < low.z || z > high.z {
            return;
        }
        for y in range(1) {
            for x in range(0) {
                let at = Vector::new(x as f64 * self.spacing.x, y as f64 * self.spacing.y, z);
                visit(y * self.size[0] + x, at);
            }
        }
    }

    /// What is near the voxels of slice `z`. Of interfaces at the same distance the first triangle's.
    pub(super) fn slice(&self, z: usize) -> Vec<Nearest> {
        let voxels = self.size[0] * self.size[1];
        let mut best = vec![self.reach[0].powi(2); voxels];
        let mut out = vec![Nearest { pair: None, junction: false }; voxels];
        for &t in self.by_slice[0].of(z) {
            let corners = self.triangles[t as usize].map(|v| self.positions[v as usize]);
            let [a, b, c] = corners.map(vector);
            let normal = (b - a).cross(c - a);
            let squared = normal.length_squared();
            let triangle = Triangle::new(a, b, c);
            self.around(&corners, self.reach[0], z, |voxel, at| {
                let height = normal.dot(at - a);
                // Its plane alone is too far away.
                if height * height > best[voxel] * squared {
                    return;
                }
                let distance = (triangle.project_local_point(at, false).point - at).length_squared();
                if distance < best[voxel] {
                    best[voxel] = distance;
                    out[voxel].pair = Some(self.pairs[t as usize]);
                }
            });
        }
        for &j in self.by_slice[1].of(z) {
            let ends = self.junctions[j as usize];
            let segment = Segment::new(vector(ends[0]), vector(ends[1]));
            self.around(&ends, self.reach[1], z, |voxel, at| {
                let distance = (segment.project_local_point(at, false).point - at).length_squared();
                out[voxel].junction |= distance <= self.reach[1].powi(2);
            });
        }
        out
    }
}
