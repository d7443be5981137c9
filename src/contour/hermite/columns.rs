//! The interface as heights over columns of the lattice, from labels and crossings.

use super::plane::{Column, Demand, MAX_COLUMNS, MAX_REACH, Plane, fit};
use super::{HALO, UNKNOWN_WEIGHT};
use crate::classify::LabelVolume;
use crate::contour::crossing::CrossingRule;
use crate::grid::MaterialId;
use crate::grid::cube::other_axes;

/// Square of the standard deviation of a crossing that is only known to be on its edge.
pub(super) const UNKNOWN_VARIANCE: f32 = 1.0 / 12.0;

/// An edge of the lattice that carries a crossing: its lower end, direction, and the materials of its lower
/// and upper end.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub(super) from: [usize; 3],
    pub(super) axis: usize,
    pub(super) labels: [MaterialId; 2],
}

/// Lattice points that may be looked at, first and last per axis: [`HALO`] beyond an edge, inside the volume.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    low: [usize; 3],
    high: [usize; 3],
}

impl Reach {
    pub(super) fn of(edge: &Edge, size: [usize; 3]) -> Self {
        let low = edge.from.map(|p| p.saturating_sub(HALO).max(1));
        let high = std::array::from_fn(|a| (edge.from[a] + usize::from(a == edge.axis) + HALO).min(size[a]));
        Self { low, high }
    }
}

/// Finds crossings of one pair.
pub(super) struct Finder<'a> {
    pub(super) labels: &'a LabelVolume,
    pub(super) crossings: &'a dyn CrossingRule,
    pub(super) reach: Reach,
    /// Square of the standard deviation of known crossings.
    pub(super) variance: f32,
}

impl Finder<'_> {
    /// The crossing in the column `by` steps along `across` from that of `edge`, which is the nearest that can
    /// be reached without leaving the two materials; at most `most` levels away.
    pub(super) fn beside(&self, edge: &Edge, steps: [(usize, i32); 2], most: usize) -> Option<Edge> {
        let Edge { from: mut p, axis, labels } = *edge;
        for (across, by) in steps {
            p[across] = p[across].checked_add_signed(by as isize)?;
            if p[across] < self.reach.low[across] || p[across] > self.reach.high[across] {
                return None;
            }
        }
        // From the level of the edge towards the other material.
        let here = self.labels.at(p);
        if here == labels[0] {
            for _ in 0..=most {
                if p[axis] >= self.reach.high[axis] {
                    return None;
                }
                let mut next = p;
                next[axis] += 1;
                let label = self.labels.at(next);
                if label == labels[1] {
                    return Some(Edge { from: p, axis, labels });
                }
                if label != labels[0] {
                    return None;
                }
                p = next;
            }
        } else if here == labels[1] {
            for _ in 0..most {
                if p[axis] <= self.reach.low[axis] {
                    return None;
                }
                p[axis] -= 1;
                let label = self.labels.at(p);
                if label == labels[0] {
                    return Some(Edge { from: p, axis, labels });
                }
                if label != labels[1] {
                    return None;
                }
            }
        }
        None
    }

    /// The height of a crossing from the level `base`, and whether it is known.
    pub(super) fn column(&self, edge: &Edge, base: usize, at: [f32; 2]) -> Column {
        let located = self.crossings.located(edge.from, edge.axis, edge.labels);
        let (weight, variance) =
            if located.is_some() { (1.0, self.variance) } else { (UNKNOWN_WEIGHT, UNKNOWN_VARIANCE) };
        let level = edge.from[edge.axis] as f32 - base as f32;
        Column { at, height: level + located.unwrap_or(0.5), weight, variance }
    }

    /// The columns around that of `middle`, itself first, up to `reach` away along both other axes. Each is
    /// reached from its neighbour nearer the middle, so nothing beyond a third material or a jump is found.
    pub(super) fn around(&self, middle: &Edge, reach: usize) -> Window {
        let mut columns = [Column::default(); MAX_COLUMNS + 1];
        let mut found: [Option<Edge>; MAX_COLUMNS] = [None; MAX_COLUMNS];
        let across = other_axes(middle.axis);
        let index = |u: i8, v: i8| {
            let [i, j] = [u, v].map(|k| (i32::from(k) + MAX_REACH as i32) as usize);
            i * (2 * MAX_REACH + 1) + j
        };
        let base = middle.from[middle.axis];
        columns[0] = self.column(middle, base, [0.0; 2]);
        found[index(0, 0)] = Some(*middle);
        let mut n = 1;
        for ring in 1..=reach as i8 {
            for (u, v) in Ring::new(ring) {
                // Straight inwards; from the corners of a ring diagonally.
                let by = [
                    if u.abs() == ring { u.signum() } else { 0 },
                    if v.abs() == ring { v.signum() } else { 0 },
                ];
                let Some(inner) = found[index(u - by[0], v - by[1])] else { continue };
                let steps = [(across[0], i32::from(by[0])), (across[1], i32::from(by[1]))];
                let most = if by[0] != 0 && by[1] != 0 { 3 } else { 2 };
                let Some(edge) = self.beside(&inner, steps, most) else { continue };
                found[index(u, v)] = Some(edge);
                columns[n] = self.column(&edge, base, [u, v].map(f32::from));
                n += 1;
            }
        }
        Window { columns, n, reach }
    }
}

/// Columns around a crossing.
pub(super) struct Window {
    columns: [Column; MAX_COLUMNS + 1],
    n: usize,
    reach: usize,
}

impl Window {
    /// How many columns it has.
    pub(super) fn count(&self) -> usize {
        self.n
    }

    /// Puts a crossing first that lies beside the column in the middle.
    pub(super) fn put_first(&mut self, own: Column) {
        self.columns[self.n] = self.columns[0];
        self.columns[0] = own;
        self.n += 1;
    }

    /// The plane on the crossing's side of any edge; whether one smooth face has all columns.
    pub(super) fn fit(&self, demand: Demand) -> Option<(Plane, bool)> {
        fit(&self.columns[..self.n], self.reach, demand)
    }
}

/// The columns at distance `ring` from the middle, in a fixed order.
struct Ring {
    ring: i8,
    next: (i8, i8),
}

impl Ring {
    fn new(ring: i8) -> Self {
        Self { ring, next: (-ring, -ring) }
    }
}

impl Iterator for Ring {
    type Item = (i8, i8);

    fn next(&mut self) -> Option<(i8, i8)> {
        let (ring, (u, v)) = (self.ring, self.next);
        if u > ring {
            return None;
        }
        self.next = if v == ring {
            (u + 1, -ring)
        } else if u.abs() == ring {
            (u, v + 1)
        } else {
            (u, ring)
        };
        Some((u, v))
    }
}
