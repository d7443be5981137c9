//! Where a mesh meets the plane of a slice: segments and junction points.
//!
//! A vertex on the plane counts as above it. So every triangle gives one segment or none, neighbours agree
//! on their common point, and triangles in the plane itself give nothing: marching puts many vertices exactly
//! on the planes of voxel centres.

use glam::{DVec2, DVec3};

use super::edges::{EdgeMark, marked_edges};
use crate::grid::cube::other_axes;
use crate::grid::{Geometry, Pair};
use crate::mesh::InterfaceMesh;

/// The outline of a mesh in a slice. Points are lattice indices along the two axes of the slice.
#[derive(Debug, Default)]
pub(super) struct Outline {
    /// In the order of the mesh's triangles.
    pub(super) segments: Vec<([DVec2; 2], Pair)>,
    /// Where junction curves pass through the slice.
    pub(super) junctions: Vec<DVec2>,
}

/// The outline of triangles with a pair for which `shown` says yes, in the plane `index` along `axis` of
/// the lattice.
pub(super) fn outline(
    mesh: &InterfaceMesh,
    geometry: &Geometry,
    axis: usize,
    index: f64,
    shown: impl Fn(Pair) -> bool + Sync,
) -> Outline {
    let points: Vec<DVec3> = mesh.positions().iter().map(|&p| geometry.index(p)).collect();
    let height = |v: u32| points[v as usize][axis] - index;
    // Where an edge meets the plane; the lower vertex index first, so that neighbours get equal bits.
    let crossing = |p: u32, q: u32| {
        let (p, q) = (p.min(q), p.max(q));
        let (hp, hq) = (height(p), height(q));
        ((hp >= 0.0) != (hq >= 0.0)).then(|| {
            let at = points[p as usize].lerp(points[q as usize], hp / (hp - hq));
            let [u, v] = other_axes(axis);
            DVec2::new(at[u], at[v])
        })
    };
    let mut found = Outline::default();
    for (&[a, b, c], &pair) in mesh.triangles().iter().zip(mesh.pairs()).filter(|(_, pair)| shown(**pair)) {
        let mut ends = [(a, b), (b, c), (c, a)].into_iter().filter_map(|(p, q)| crossing(p, q));
        if let (Some(p), Some(q)) = (ends.next(), ends.next()) {
            found.segments.push(([p, q], pair));
        }
    }
    if !found.segments.is_empty() {
        let touches = |t: usize| {
            let [a, b, c] = mesh.triangles()[t].map(|v| height(v) >= 0.0);
            (a != b || b != c) && shown(mesh.pairs()[t])
        };
        found.junctions = marked_edges(mesh, touches)
            .into_iter()
            .filter(|e| e.mark == EdgeMark::Junction)
            .filter_map(|e| crossing(e.vertices[0], e.vertices[1]))
            .collect();
    }
    found
}
