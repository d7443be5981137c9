//! A cheap certificate that two triangles have no point in common, for most pairs of which that is true.
//!
//! Method: if for some direction d all d.p of one triangle are less than all of the other, they are apart. Any
//! direction will do, so d needs no exactness; it is taken as it was rounded. Only the products d.p, from one
//! corner of the first triangle, have errors: under 4 u |d|1 |p|max each (u = 2^-53), and [`MARGIN`] allows for
//! far more. Tried are both normals and, for triangles in nearly one plane, the normals of all sides
//! in their triangle's plane.

use super::triangle_pair::Corners;

/// Of |d|1 |p|max; 16 u would do for two corners.
const MARGIN: f64 = 1e-14;

/// Whether two triangles are apart for sure.
pub(super) fn surely_apart(s: &Corners, t: &Corners) -> bool {
    let (a, b) = (s.map(|p| p - s[0]), t.map(|p| p - s[0]));
    let reach = a.iter().chain(&b).map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let parts = |d: glam::DVec3| {
        let (x, y) = (a.map(|p| d.dot(p)), b.map(|p| d.dot(p)));
        let low = |x: [f64; 3]| x[0].min(x[1]).min(x[2]);
        let high = |x: [f64; 3]| x[0].max(x[1]).max(x[2]);
        let gap = (low(y) - high(x)).max(low(x) - high(y));
        let slack = MARGIN * reach * (d.x.abs() + d.y.abs() + d.z.abs());
        // Slack that has underflowed proves nothing.
        gap > slack && slack > 1e-280
    };
    let normals = [a, b].map(|t| (t[1] - t[0]).cross(t[2] - t[0]));
    if normals.into_iter().any(&parts) {
        return true;
    }
    [(a, normals[0]), (b, normals[1])]
        .into_iter()
        .any(|(t, n)| (0..3).any(|i| parts((t[(i + 1) % 3] - t[i]).cross(n))))
}
