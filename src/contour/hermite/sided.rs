//! Normals from the crossings of the same pair around: the estimate that keeps edges.
//!
//! Over the two axes across its edge, or over those across another axis where that lies better, the
//! interface is a height field; its heights are the crossings on parallel edges. No grey values, so a third
//! material cannot spoil it, and labels alone are enough.

use glam::Vec3;

use super::columns::{Edge, Finder, Window};
use super::plane::Demand;
use crate::contour::crossing::CROSSING_MARGIN;
use crate::grid::cube::other_axes;

/// Above this slope (levels per column) the interface is looked at along the axis in which it climbs.
const STEEP: f32 = 1.0;

/// A plane beside a crossing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Side {
    /// Normal as a covector of the lattice, from the material at the edge's lower end to that at its upper end.
    pub(super) covector: [f32; 3],
    /// Whether one smooth face has all columns around.
    pub(super) smooth: bool,
}

/// The plane on this side of any edge.
pub(super) fn plane(finder: &Finder<'_>, edge: &Edge, reach: usize, demand: Demand) -> Option<Side> {
    let found = steep_axes(finder, edge).map(|axis| nearest(finder, edge, axis?));
    let found = match found {
        // Of two axes that are both too steep to follow, the one along which the interface is nearer.
        [Some(a), Some(b)] => Some(if shows_more(finder, &b, &a, reach) { b } else { a }),
        [a, b] => a.or(b),
    };
    match found {
        Some(found) => turned(finder, edge, &found, reach, demand),
        None => side(&finder.around(edge, reach), demand, edge, 1.0),
    }
}

/// Whether columns through `a` show more of the interface than those through `b`: it is nearer, or where the margin
/// of crossings hides which one is, more columns are found around it.
fn shows_more(finder: &Finder<'_>, a: &Nearest, b: &Nearest, reach: usize) -> bool {
    if a.at_margin && b.at_margin && a.end == b.end {
        let [na, nb] = [a, b].map(|found| finder.around(&found.edge, reach).count());
        na > nb || na == nb && a.distance < b.distance
    } else {
        a.distance < b.distance
    }
}

/// By columns along another axis.
fn turned(
    finder: &Finder<'_>,
    edge: &Edge,
    &Nearest { edge: ref middle, sign, .. }: &Nearest,
    reach: usize,
    demand: Demand,
) -> Option<Side> {
    let axis = middle.axis;
    let mut window = finder.around(middle, reach);
    // The crossing itself, seen from the column that was found.
    let mut own = finder.column(edge, middle.from[edge.axis], [0.0; 2]);
    own.at[usize::from(other_axes(axis)[1] == edge.axis)] = own.height;
    own.height = edge.from[axis] as f32 - middle.from[axis] as f32;
    window.put_first(own);
    side(&window, demand, middle, sign)
}

/// The plane of a window; its gradient of `height above the plane`, times `sign`.
fn side(window: &Window, demand: Demand, edge: &Edge, sign: f32) -> Option<Side> {
    let (plane, smooth) = window.fit(demand)?;
    let [a, b] = other_axes(edge.axis);
    let mut covector = [0.0; 3];
    covector[edge.axis] = sign;
    covector[a] = -sign * plane.slope[0];
    covector[b] = -sign * plane.slope[1];
    Some(Side { covector, smooth })
}

/// The axes in which the interface climbs more steeply than [`STEEP`] on both sides of the edge: the steeper
/// one, or both if neither can be followed.
fn steep_axes(finder: &Finder<'_>, edge: &Edge) -> [Option<usize>; 2] {
    let here = finder.column(edge, edge.from[edge.axis], [0.0; 2]).height;
    let rise = |axis: usize| {
        let to = |by: i32| {
            let beside = finder.beside(edge, [(axis, by), (axis, 0)], 2)?;
            Some((finder.column(&beside, edge.from[edge.axis], [0.0; 2]).height - here).abs())
        };
        to(1).unwrap_or(f32::INFINITY).min(to(-1).unwrap_or(f32::INFINITY))
    };
    let [a, b] = other_axes(edge.axis);
    let (ra, rb) = (rise(a), rise(b));
    let (axis, most) = if rb > ra { (b, rb) } else { (a, ra) };
    if ra.min(rb) == f32::INFINITY {
        return [Some(a), Some(b)];
    }
    [(most > STEEP).then_some(axis), None]
}

/// A crossing along another axis than the edge's.
struct Nearest {
    edge: Edge,
    /// Of the normal along that axis.
    sign: f32,
    /// How near it is, squared.
    distance: f32,
    /// The end of the edge asked for from which its own edge starts.
    end: usize,
    /// Whether it is as near to the edge's end as a crossing may be: it can be nearer.
    at_margin: bool,
}

/// The crossing nearest to that of `edge` among those along `axis` that start from one of its ends.
fn nearest(finder: &Finder<'_>, edge: &Edge, axis: usize) -> Option<Nearest> {
    let t = finder.column(edge, edge.from[edge.axis], [0.0; 2]).height;
    let mut best: Option<Nearest> = None;
    for (sign, labels) in [(1.0, edge.labels), (-1.0, [edge.labels[1], edge.labels[0]])] {
        for end in 0..2 {
            let mut from = edge.from;
            from[edge.axis] += end;
            let start = Edge { from, axis, labels };
            let Some(found) = finder.beside(&start, [(axis, 0), (axis, 0)], 2) else { continue };
            let height = finder.column(&found, from[axis], [0.0; 2]).height;
            // An interface through both crossings passes the axis at this slope; the end nearer to the
            // crossing on the edge is nearer to the crossing found.
            let along = if end == 0 { t } else { 1.0 - t };
            let distance = height * height + along * along;
            if best.as_ref().is_none_or(|b| distance < b.distance) {
                let at_margin = height.abs() <= CROSSING_MARGIN;
                best = Some(Nearest { edge: found, sign, distance, end, at_margin });
            }
        }
    }
    best
}

/// The unit vector along an axis: where nothing is known.
pub(super) fn along(axis: usize) -> Vec3 {
    Vec3::from(std::array::from_fn(|a| if a == axis { 1.0 } else { 0.0 }))
}
