//! The closest point of a set of triangles or segments.

use glam::DVec3;
use parry3d_f64::math::Vector;
use parry3d_f64::query::{PointQuery, PointQueryWithLocation, Ray, RayCast};
use parry3d_f64::shape::{Polyline, TriMesh};

fn outer(p: DVec3) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

fn inner(p: Vector) -> DVec3 {
    DVec3::new(p.x, p.y, p.z)
}

/// Triangles to be asked for the closest point.
pub(super) struct Triangles {
    mesh: TriMesh,
    normals: Vec<DVec3>,
}

impl Triangles {
    /// `None` if no triangle has an area.
    pub(super) fn new(positions: &[DVec3], triangles: impl Iterator<Item = [u32; 3]>) -> Option<Self> {
        let mut kept = Vec::new();
        let mut normals = Vec::new();
        for triangle in triangles {
            let [a, b, c] = triangle.map(|v| positions[v as usize]);
            if let Some(normal) = (b - a).cross(c - a).try_normalize() {
                kept.push(triangle);
                normals.push(normal);
            }
        }
        let mesh = TriMesh::new(positions.iter().copied().map(outer).collect(), kept).ok()?;
        Some(Self { mesh, normals })
    }

    /// Distance from `p` to the closest point: positive where that lies in front of `p`, in the direction of its
    /// triangle's normal.
    pub(super) fn signed(&self, p: DVec3) -> f64 {
        let (projection, (triangle, _)) = self.mesh.project_local_point_and_get_location(outer(p), false);
        let offset = inner(projection.point) - p;
        if offset.dot(self.normals[triangle as usize]) < 0.0 { -offset.length() } else { offset.length() }
    }

    /// Distance from `p` in the direction of the unit vector `d` to the first triangle, if one is within `limit`.
    pub(super) fn hit(&self, p: DVec3, d: DVec3, limit: f64) -> Option<f64> {
        self.mesh.cast_local_ray(&Ray::new(outer(p), outer(d)), limit, false)
    }
}

/// Segments to be asked for the closest point.
pub(super) struct Segments(Polyline);

impl Segments {
    /// `None` if there are no segments.
    pub(super) fn new(positions: &[DVec3], segments: Vec<[u32; 2]>) -> Option<Self> {
        if segments.is_empty() {
            return None;
        }
        Some(Self(Polyline::new(positions.iter().copied().map(outer).collect(), Some(segments))))
    }

    /// Distance of the closest point.
    pub(super) fn distance(&self, p: DVec3) -> f64 {
        (inner(self.0.project_local_point(outer(p), false).point) - p).length()
    }
}
