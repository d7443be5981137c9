//! The triangles around an edge, in order.

use std::cmp::Ordering;

use glam::DVec3;

use super::triangle_pair::{Plane, side};

/// Triangles at the edge from `u` to `v`, given with their third corners, in counter-clockwise order seen against its
/// direction, from the first of them on. `None` if two lie on each other or one has no area. Exact.
pub(crate) fn in_turn<T: Copy>(u: DVec3, v: DVec3, triangles: &[(T, DVec3)]) -> Option<Vec<T>> {
    let zero = triangles.first()?.1;
    let plane = Plane::showing(&[u, v, zero])?;
    let sector = |tip: DVec3| match side(u, v, zero, tip) {
        Ordering::Less => 1, // up to half a turn on, by the sign rule of orient3d
        Ordering::Greater => 3,
        Ordering::Equal if plane.turn(u, v, zero) == plane.turn(u, v, tip) => 0,
        Ordering::Equal => 2,
    };
    let mut around: Vec<(u8, DVec3, T)> = triangles.iter().map(|&(t, tip)| (sector(tip), tip, t)).collect();
    if triangles.iter().any(|(_, tip)| Plane::showing(&[u, v, *tip]).is_none()) {
        return None;
    }
    let compare = |a: &(u8, DVec3, T), b: &(u8, DVec3, T)| {
        let within = || match a.0 {
            0 | 2 => Ordering::Equal,
            _ => side(u, v, a.1, b.1),
        };
        a.0.cmp(&b.0).then_with(within)
    };
    around.sort_by(compare);
    let tie = around.windows(2).any(|two| compare(&two[0], &two[1]) == Ordering::Equal);
    (!tie).then(|| around.into_iter().map(|(.., t)| t).collect())
}
