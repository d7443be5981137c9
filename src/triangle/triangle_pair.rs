//! Do two triangles meet where they must not? Exactly decided.
//!
//! Every decision is a sign of `orient3d` or `orient2d` from the crate `robust` (Shewchuk's adaptive
//! predicates), so there is no tolerance: triangles that touch in one point do touch, triangles that
//! miss each other by one bit do not. Exactness holds as long as products of three coordinate
//! differences neither overflow nor underflow an f64. Triangles without area must not be passed.

use std::cmp::Ordering;

use glam::DVec3;
use robust::{Coord, Coord3D, orient2d, orient3d};

/// A triangle's corners.
pub(crate) type Corners = [DVec3; 3];

/// The sign of the volume of the tetrahedron `abcd`: which side of the plane `abc` holds `d`.
pub(crate) fn side(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> Ordering {
    // Faces of voxels are full of points in one plane of the lattice, where the exact sign costs most.
    let flat = a.cmpeq(b) & a.cmpeq(c) & a.cmpeq(d);
    if flat.any() {
        return Ordering::Equal;
    }
    let p = |v: DVec3| Coord3D { x: v.x, y: v.y, z: v.z };
    sign(orient3d(p(a), p(b), p(c), p(d)))
}

fn sign(value: f64) -> Ordering {
    value.partial_cmp(&0.0).unwrap_or(Ordering::Equal)
}

/// A coordinate plane to look at flat things in: the axis that is dropped.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plane(usize);

impl Plane {
    fn flat(self, v: DVec3) -> Coord<f64> {
        match self.0 {
            0 => Coord { x: v.y, y: v.z },
            1 => Coord { x: v.z, y: v.x },
            _ => Coord { x: v.x, y: v.y },
        }
    }

    /// The sign of the area of `abc` seen in this plane.
    pub(crate) fn turn(self, a: DVec3, b: DVec3, c: DVec3) -> Ordering {
        let (a, b, c) = (self.flat(a), self.flat(b), self.flat(c));
        sign(orient2d(a, b, c))
    }

    /// A plane in which the triangle has an area; `None` if its corners are collinear.
    pub(crate) fn showing(t: &Corners) -> Option<Self> {
        // The plane across the largest component of the normal almost always does, at once.
        let n = (t[1] - t[0]).cross(t[2] - t[0]).abs();
        let first = if n.x >= n.y && n.x >= n.z {
            0
        } else if n.y >= n.z {
            1
        } else {
            2
        };
        [Self(first), Self((first + 1) % 3), Self((first + 2) % 3)]
            .into_iter()
            .find(|p| p.turn(t[0], t[1], t[2]) != Ordering::Equal)
    }
}

/// Whether the corners are exactly collinear (or equal): a triangle without area.
pub(crate) fn is_degenerate(t: &Corners) -> bool {
    Plane::showing(t).is_none()
}

/// Whether two closed triangles that share no vertex have a point in common.
pub(crate) fn touch(s: &Corners, t: &Corners) -> bool {
    let of_t = t.map(|v| side(s[0], s[1], s[2], v));
    if misses(&of_t) {
        return false;
    }
    if of_t == [Ordering::Equal; 3] {
        return touch_flat(s, t);
    }
    let of_s = s.map(|v| side(t[0], t[1], t[2], v));
    if misses(&of_s) {
        return false;
    }
    // Convex sets meet exactly if an edge of one meets the other.
    (0..3).any(|i| segment_meets(t[i], t[(i + 1) % 3], of_t[i], of_t[(i + 1) % 3], s))
        || (0..3).any(|i| segment_meets(s[i], s[(i + 1) % 3], of_s[i], of_s[(i + 1) % 3], t))
}

/// Whether two closed triangles whose first corners are one and the same vertex meet anywhere else.
///
/// What they have in common is convex and holds the vertex. If it holds more, it reaches the side
/// opposite the vertex in one of the two, so these two segments are all there is to test.
pub(crate) fn touch_beyond_vertex(s: &Corners, t: &Corners) -> bool {
    let of_t = [1, 2].map(|i| side(s[0], s[1], s[2], t[i]));
    if misses(&of_t) {
        return false;
    }
    if of_t == [Ordering::Equal; 2] {
        return wedges_overlap(s, t);
    }
    let of_s = [1, 2].map(|i| side(t[0], t[1], t[2], s[i]));
    if misses(&of_s) {
        return false;
    }
    segment_meets(t[1], t[2], of_t[0], of_t[1], s) || segment_meets(s[1], s[2], of_s[0], of_s[1], t)
}

/// Whether the triangles `uva` and `uvb` lie folded onto each other: in one plane, on one side of
/// the edge they share. It is the only way in which they can meet away from that edge.
pub(crate) fn folded(u: DVec3, v: DVec3, a: DVec3, b: DVec3) -> bool {
    side(u, v, a, b) == Ordering::Equal
        && Plane::showing(&[u, v, a]).is_some_and(|p| p.turn(u, v, a) == p.turn(u, v, b))
}

/// As [`touch`], in one plane: two closed convex polygons miss each other exactly if the line of a
/// side of one has the other strictly beyond it.
fn touch_flat(s: &Corners, t: &Corners) -> bool {
    let Some(plane) = Plane::showing(s) else { return false };
    let separates = |s: &Corners, t: &Corners| {
        let inner = plane.turn(s[0], s[1], s[2]);
        (0..3).any(|i| t.iter().all(|&v| plane.turn(s[i], s[(i + 1) % 3], v) == inner.reverse()))
    };
    !separates(s, t) && !separates(t, s)
}

/// As [`touch_beyond_vertex`], in one plane: the two wedges at the common vertex have more in common
/// exactly if a side of one lies in the other. Both are less than half a turn wide.
fn wedges_overlap(s: &Corners, t: &Corners) -> bool {
    let Some(plane) = Plane::showing(s) else { return false };
    let apex = s[0];
    // Sides in counter-clockwise order: from a to b, from c to d.
    let ordered = |t: &Corners| match plane.turn(t[0], t[1], t[2]) {
        Ordering::Less => [t[2], t[1]],
        _ => [t[1], t[2]],
    };
    let ([a, b], [c, d]) = (ordered(s), ordered(t));
    let turn = |p: DVec3, q: DVec3| plane.turn(apex, p, q);
    let (ac, ad, bc, bd) = (turn(a, c), turn(a, d), turn(b, c), turn(b, d));
    ac.is_ge() && bc.is_le()
        || ad.is_ge() && bd.is_le()
        || ac.is_le() && ad.is_ge()
        || bc.is_le() && bd.is_ge()
}

/// All strictly on one side.
fn misses(sides: &[Ordering]) -> bool {
    sides.iter().all(|&s| s == Ordering::Greater) || sides.iter().all(|&s| s == Ordering::Less)
}

/// Whether the closed segment `pq` meets the closed triangle `t`; `sp` and `sq` are the sides of
/// the triangle's plane on which its ends lie.
fn segment_meets(p: DVec3, q: DVec3, sp: Ordering, sq: Ordering, t: &Corners) -> bool {
    if sp == Ordering::Equal && sq == Ordering::Equal {
        return segment_meets_flat(p, q, t);
    }
    if sp == sq {
        return false;
    }
    // The line crosses the plane in one point: inside unless it passes sides on different hands.
    let turns = [side(p, q, t[0], t[1]), side(p, q, t[1], t[2]), side(p, q, t[2], t[0])];
    !(turns.contains(&Ordering::Greater) && turns.contains(&Ordering::Less))
}

/// As [`segment_meets`], with all five points in one plane.
fn segment_meets_flat(p: DVec3, q: DVec3, t: &Corners) -> bool {
    let Some(plane) = Plane::showing(t) else { return false };
    let inside = |x: DVec3| {
        let turns = [plane.turn(t[0], t[1], x), plane.turn(t[1], t[2], x), plane.turn(t[2], t[0], x)];
        !(turns.contains(&Ordering::Greater) && turns.contains(&Ordering::Less))
    };
    inside(p) || inside(q) || (0..3).any(|i| segments_meet_flat(p, q, t[i], t[(i + 1) % 3], plane))
}

/// Whether two closed segments meet, seen in `plane`.
fn segments_meet_flat(p: DVec3, q: DVec3, a: DVec3, b: DVec3, plane: Plane) -> bool {
    let (pa, pb) = (plane.turn(p, q, a), plane.turn(p, q, b));
    let (ap, aq) = (plane.turn(a, b, p), plane.turn(a, b, q));
    if [pa, pb, ap, aq].iter().all(|&s| s == Ordering::Equal) {
        // On one line: they meet if their extents overlap on both axes.
        let (p, q, a, b) = (plane.flat(p), plane.flat(q), plane.flat(a), plane.flat(b));
        let overlap = |p: f64, q: f64, a: f64, b: f64| p.max(q) >= a.min(b) && a.max(b) >= p.min(q);
        return overlap(p.x, q.x, a.x, b.x) && overlap(p.y, q.y, a.y, b.y);
    }
    // Zero counts as both sides: an end on the other segment's line.
    let apart = |s: Ordering, t: Ordering| s == t && s != Ordering::Equal;
    !apart(pa, pb) && !apart(ap, aq)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn t(c: [[i32; 3]; 3]) -> Corners {
        c.map(|p| DVec3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2])))
    }

    #[test]
    fn touching_counts_and_missing_by_a_bit_does_not() {
        let base = t([[0, 0, 0], [4, 0, 0], [0, 4, 0]]);
        assert!(touch(&base, &t([[1, 1, -1], [1, 1, 1], [5, 5, 0]])), "pierces");
        assert!(touch(&base, &t([[1, 1, 0], [1, 1, 5], [2, 2, 5]])), "corner on face");
        assert!(touch(&base, &t([[2, 2, 0], [5, 5, 5], [6, 6, 5]])), "corner on edge");
        assert!(touch(&base, &t([[4, 0, 0], [9, 0, 1], [9, 0, 0]])), "corner on corner");
        assert!(touch(&base, &t([[1, 1, 0], [2, 1, 0], [1, 2, 0]])), "inside, coplanar");
        assert!(touch(&base, &t([[-9, -9, 0], [30, -9, 0], [-9, 30, 0]])), "around, coplanar");
        assert!(!touch(&base, &t([[3, 3, 0], [4, 4, 0], [4, 3, 0]])), "beside, coplanar");
        let mut close = t([[1, 1, 0], [1, 1, 5], [2, 2, 5]]);
        close[0].z = f64::MIN_POSITIVE.sqrt();
        assert!(!touch(&base, &close), "above by very little");
    }

    #[test]
    fn neighbours_may_meet_at_what_they_share_only() {
        let base = t([[0, 0, 0], [4, 0, 0], [0, 4, 0]]);
        assert!(!touch_beyond_vertex(&base, &t([[0, 0, 0], [-4, 0, 0], [0, -4, 0]])));
        assert!(!touch_beyond_vertex(&base, &t([[0, 0, 0], [4, 0, 1], [0, 4, 1]])));
        assert!(touch_beyond_vertex(&base, &t([[0, 0, 0], [1, 1, 0], [1, 1, 5]])));
        assert!(touch_beyond_vertex(&base, &t([[0, 0, 0], [2, 1, -1], [1, 2, 1]])));
        assert!(touch_beyond_vertex(&base, &t([[0, 0, 0], [8, 0, 0], [0, 0, 8]])), "along an edge");
        let [u, v, a] = base;
        assert!(folded(u, v, a, DVec3::new(1.0, 9.0, 0.0)));
        assert!(!folded(u, v, a, DVec3::new(1.0, -9.0, 0.0)));
        assert!(!folded(u, v, a, DVec3::new(1.0, 9.0, 1e-300)));
    }

    fn corner() -> impl Strategy<Value = [i32; 3]> {
        [-3..=3, -3..=3, -3..=3]
    }

    fn triangle() -> impl Strategy<Value = Corners> {
        [corner(), corner(), corner()].prop_map(t).prop_filter("has an area", |t| !is_degenerate(t))
    }

    /// Separating axes in exact integers: an independent truth for small coordinates.
    fn touch_by_axes(s: &Corners, t: &Corners) -> bool {
        let int = |v: DVec3| [v.x as i64, v.y as i64, v.z as i64];
        let sub = |a: [i64; 3], b: [i64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        let cross = |a: [i64; 3], b: [i64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let dot = |a: [i64; 3], b: [i64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let (s, t) = (s.map(int), t.map(int));
        let edges = |t: [[i64; 3]; 3]| [0, 1, 2].map(|i| sub(t[(i + 1) % 3], t[i]));
        let (es, et) = (edges(s), edges(t));
        let (ns, nt) = (cross(es[0], es[1]), cross(et[0], et[1]));
        let mut axes = vec![ns, nt];
        for a in es {
            axes.push(cross(ns, a));
            for b in et {
                axes.push(cross(a, b));
            }
        }
        axes.extend(et.map(|b| cross(nt, b)));
        !axes.into_iter().any(|axis| {
            let (a, b) = (s.map(|v| dot(v, axis)), t.map(|v| dot(v, axis)));
            a.iter().max() < b.iter().min() || b.iter().max() < a.iter().min()
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]

        #[test]
        fn symmetric_under_swap_and_renaming_and_true(s in triangle(), t in triangle(), r in 0usize..3) {
            let expected = touch_by_axes(&s, &t);
            let turned = [s[r], s[(r + 1) % 3], s[(r + 2) % 3]];
            let flipped = [t[0], t[2], t[1]];
            prop_assert_eq!(touch(&s, &t), expected);
            prop_assert_eq!(touch(&t, &s), expected);
            prop_assert_eq!(touch(&turned, &flipped), expected);
        }

        #[test]
        fn beyond_a_vertex_is_symmetric(s in triangle(), t in triangle()) {
            let shift = s[0] - t[0];
            let t = t.map(|v| v + shift);
            let here = touch_beyond_vertex(&s, &t);
            prop_assert_eq!(here, touch_beyond_vertex(&t, &s));
            prop_assert_eq!(here, touch_beyond_vertex(&[s[0], s[2], s[1]], &t));
            // With its common corner cut off by half, one of them meets the other only if both do so
            // beyond the corner; and then not always, as the meeting may be near the corner.
            let cut = |k: f64| [t[1], t[2], t[0] + (t[1] - t[0]) * k, t[0] + (t[2] - t[0]) * k];
            for k in [0.5, 0.25, 0.125, 0.0625] {
                let [p, q, r, u] = cut(k);
                if touch(&s, &[p, q, r]) || touch(&s, &[q, r, u]) {
                    prop_assert!(here);
                }
            }
            // Coordinates are small: all that meets beyond the corner reaches a 1024th of the way out.
            if here {
                let [p, q, r, u] = cut(1.0 / 1024.0);
                prop_assert!(touch(&s, &[p, q, r]) || touch(&s, &[q, r, u]));
            }
        }
    }
}
