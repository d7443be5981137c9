//! The unsimplified surface: leaves (vertices, one for each sheet of a cell) and crossings, each of which
//! joins the four leaves around it in a ring.
//!
//! Everything is ordered by root (z, then y, then x), and in a root by the place of the cell, so that a root's
//! leaves and crossings are contiguous. A crossing belongs to the cell whose lowest corner is its edge's
//! lower end; the other cells of its ring lie below, in the same root or in an earlier one.
//!
//! Cost follows the surface: about 30 bytes a leaf and 40 a crossing.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::qef::{Place, Placement, Qef};
use super::roots::{Block, RootGrid, place};
use super::strays::strayed;
use crate::contour::crossing::CROSSING_MARGIN;
use crate::contour::marching::pair_of;
use crate::contour::patch::Border;
use crate::grid::cube::edge_between;
use crate::grid::{MaterialId, Pair};

/// No leaf, node or crossing.
pub(super) const NONE: u32 = u32::MAX;

/// Where curves are known, their vertices stay so many times closer to the planes of their crossings than other vertices: the
/// tolerance is meant for faces, and curves are few.
const CLOSER: f64 = 0.3;

/// A crossing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crossing {
    /// Leaves around the edge, counter-clockwise about its axis: in its own cell first.
    pub(super) ring: [u32; 4],
    /// Unit normal in lengths, along the edge.
    pub(super) normal: Vec3,
    /// Where its interface meets the edge's line, as a fraction of the edge: models may know it beyond the ends.
    pub(super) position: f32,
    /// Place in the root of the cell that it belongs to.
    pub(super) cell: u16,
    /// Materials at the lower and the upper end.
    pub(super) labels: [MaterialId; 2],
    /// Axis of the edge.
    pub(super) axis: u8,
    /// How much it counts, in 255ths.
    pub(super) weight: u8,
}

impl Crossing {
    /// Where it is on its edge, in lengths about the middle of root `low`, whose distance from its own root is `apart`
    /// cells.
    #[inline]
    pub(super) fn at(&self, grid: &RootGrid, apart: [i32; 3]) -> DVec3 {
        let cell = place(self.cell);
        let half = super::roots::SIDE as i32 / 2;
        let mut at = DVec3::from([0, 1, 2].map(|a| f64::from(cell[a] as i32 + apart[a] - half)));
        at[usize::from(self.axis)] += f64::from(margined(self.position));
        at * grid.cell
    }

    /// How far its interface meets the edge's line beyond that, in lengths.
    fn beyond(&self, grid: &RootGrid) -> DVec3 {
        let axis = usize::from(self.axis);
        DVec3::AXES[axis] * f64::from(self.position - margined(self.position)) * grid.cell[axis]
    }

    /// The pair of its polygon, and whether the ring must be turned over to face its front; `None` where an
    /// open border leaves the polygon out.
    pub(super) fn pair(&self, border: Border) -> Option<(Pair, bool)> {
        pair_of(self.labels, border)
    }
}

/// The cells around an edge along `axis`, in ring order, as offsets below the edge's own cell.
pub(super) fn ring_offset(axis: usize, i: usize) -> [usize; 3] {
    let mut offset = [0; 3];
    let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
    offset[b] = usize::from(i == 1 || i == 2);
    offset[c] = usize::from(i >= 2);
    offset
}

/// The number that an edge along `axis` has in ring cell `i`.
pub(super) fn ring_edge(axis: usize, i: usize) -> usize {
    let low = ring_offset(axis, i).iter().enumerate().fold(0, |c, (a, o)| c | o << a);
    edge_between(low, low | 1 << axis)
}

/// The face that ring cells `i` and i + 1 share: its axis.
pub(super) fn ring_face_axis(axis: usize, i: usize) -> usize {
    (axis + 1 + i % 2) % 3
}

/// A leaf that is more than the sheet of a cell with one simple sheet.
pub(super) mod flag {
    /// Its sheet has no caps and no face with two curves: it may be part of a cluster.
    pub(crate) const SIMPLE: u8 = 1;
    /// Its cell has other leaves: it lies at the mean of its crossings.
    pub(crate) const CROWDED: u8 = 2;
    /// It is a cap: it lies between its main leaf and the corners that it cuts off.
    pub(crate) const CAP: u8 = 4;
    /// Its cell reaches beyond the volume.
    pub(crate) const BORDER: u8 = 8;
    /// A curve passes its cell.
    pub(crate) const CURVE: u8 = 16;
}

/// What a root holds.
#[derive(Debug, Clone, Default)]
pub(super) struct Root {
    /// Its number in the grid of roots.
    pub(super) number: usize,
    pub(super) leaves: Range<u32>,
    pub(super) crossings: Range<u32>,
    /// The crossings of other roots that have a leaf of this one in their ring.
    pub(super) foreign: Range<u32>,
}

/// A cap, its main leaf, and the corners of its cell that it cuts off.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cap {
    pub(super) leaf: u32,
    pub(super) main: u32,
    pub(super) corners: u8,
}

/// The way of a polygon through a face: a crossing, and i where the face lies between the cells i and i + 1
/// of its ring.
pub(super) type Pass = (u32, u8);

/// A piece of curve on a face, with the vertex that it may need.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Knot {
    /// The polygons that pass here, ascending.
    pub(super) passes: Vec<Pass>,
    /// For one of two curves of a sheet: the knot of the other one. The vertex is needed only if both lead
    /// to the same two vertices.
    pub(super) twin: Option<u32>,
}

/// A triangle from a face vertex to two leaves of a sheet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Tie {
    pub(super) knot: u32,
    /// With the knot first, counter-clockwise seen from the pair's front.
    pub(super) leaves: [u32; 2],
    pub(super) pair: Pair,
}

/// The unsimplified surface; see the module header.
#[derive(Debug, Clone)]
pub(super) struct Leaves {
    pub(super) grid: RootGrid,
    /// Those that have leaves.
    pub(super) roots: Vec<Root>,
    /// The place of each leaf's cell in its root.
    pub(super) places: Vec<u16>,
    pub(super) flags: Vec<u8>,
    pub(super) crossings: Vec<Crossing>,
    /// Of each crossing, packed; empty if none are known.
    pub(super) sigmas: Vec<u16>,
    /// Whether crossings are known so well that curves are where their planes cut.
    pub(super) knows_curves: bool,
    pub(super) foreign: Vec<u32>,
    pub(super) caps: Vec<Cap>,
    pub(super) knots: Vec<Knot>,
    pub(super) ties: Vec<Tie>,
}

impl Leaves {
    /// The root of a leaf, as an index of `roots`.
    pub(super) fn root_of_leaf(&self, leaf: u32) -> usize {
        self.roots.partition_point(|r| r.leaves.end <= leaf)
    }

    /// The root of a crossing, as an index of `roots`.
    pub(super) fn root_of_crossing(&self, crossing: u32) -> usize {
        self.roots.partition_point(|r| r.crossings.end <= crossing)
    }

    /// How many times closer than other vertices those of curves stay to the planes of their crossings.
    pub(super) fn closer(&self) -> f64 {
        if self.knows_curves { CLOSER } else { 1.0 }
    }

    /// Where the vertex of a leaf may lie.
    pub(super) fn place(&self, root: &Root, leaf: u32) -> Place {
        let block = Block { low: self.places[leaf as usize], level: 0 };
        let fixed = self.grid.fixed(root.number, self.sides(root, leaf));
        Place { bounds: block.bounds(&self.grid), fixed }
    }

    /// The vertex of a leaf in the unsimplified surface, whose planes are `qef`.
    pub(super) fn vertex(&self, root: &Root, leaf: u32, qef: &Qef, placement: Placement) -> DVec3 {
        let inside = self.vertex_inside(root, leaf, qef, placement);
        let strays = placement == Placement::Clamped && self.may_stray(leaf);
        if strays { strayed(self.grid.cell, qef, &self.place(root, leaf), inside) } else { inside }
    }

    /// The same of a leaf that may not stray.
    pub(super) fn vertex_inside(&self, root: &Root, leaf: u32, qef: &Qef, placement: Placement) -> DVec3 {
        let place = self.place(root, leaf);
        if self.flags[leaf as usize] & flag::CROWDED != 0 {
            place.clamp(qef.mass_point())
        } else {
            placement.vertex(qef, &place)
        }
    }

    /// How many cells root `of` lies beyond root `from`.
    pub(super) fn apart(&self, of: &Root, from: &Root) -> [i32; 3] {
        let (of, from) = (self.grid.low(of.number), self.grid.low(from.number));
        [0, 1, 2].map(|a| of[a] as i32 - from[a] as i32)
    }

    /// Calls `visit` with each crossing that has a leaf of `root` in its ring, with its number and its
    /// position in lengths about the middle of the root.
    pub(super) fn crossings_of(&self, root: &Root, mut visit: impl FnMut(u32, &Crossing, DVec3)) {
        for c in root.crossings.clone() {
            let crossing = &self.crossings[c as usize];
            visit(c, crossing, crossing.at(&self.grid, [0; 3]));
        }
        let mut other = None::<(&Root, [i32; 3])>;
        for &c in &self.foreign[root.foreign.start as usize..root.foreign.end as usize] {
            let crossing = &self.crossings[c as usize];
            let apart = match other {
                Some((r, apart)) if r.crossings.contains(&c) => apart,
                _ => {
                    let r = &self.roots[self.root_of_crossing(c)];
                    let apart = self.apart(r, root);
                    other = Some((r, apart));
                    apart
                }
            };
            visit(c, crossing, crossing.at(&self.grid, apart));
        }
    }

    /// What the crossing at `at` says about the vertex of a leaf: adds the plane that it should lie on. Beyond the
    /// volume's last voxels nothing is known; the surface goes straight on to the border there.
    #[inline]
    pub(super) fn add_plane(
        &self,
        qef: &mut Qef,
        root: &Root,
        leaf: u32,
        crossing: &Crossing,
        mut at: DVec3,
    ) {
        let mut through = at + crossing.beyond(&self.grid);
        if self.flags[leaf as usize] & flag::BORDER != 0 {
            let fixed = self.grid.fixed(root.number, self.sides(root, leaf));
            let onto = |p: DVec3| DVec3::from([0, 1, 2].map(|a| fixed[a].unwrap_or(p[a])));
            (at, through) = (onto(at), onto(through));
        }
        qef.add(at, through, crossing.normal.as_dvec3(), weight(crossing.weight));
    }

    /// Adds the planes of all leaves of a root: those of a leaf to the QEF that `number` gives for it.
    pub(super) fn add_planes(&self, root: &Root, qefs: &mut [Qef], number: impl Fn(u32) -> usize) {
        self.crossings_of(root, |_, crossing, at| {
            for leaf in crossing.ring.into_iter().filter(|l| root.leaves.contains(l)) {
                self.add_plane(&mut qefs[number(leaf)], root, leaf, crossing, at);
            }
        });
    }

    /// The sides of the volume that a leaf's cell reaches beyond; there its vertex lies.
    pub(super) fn sides(&self, root: &Root, leaf: u32) -> u8 {
        let (low, at) = (self.grid.low(root.number), place(self.places[leaf as usize]));
        self.grid.sides([0, 1, 2].map(|a| low[a] + at[a]))
    }
}

/// Weight as it is kept, and back.
pub(super) fn pack_weight(weight: f32) -> u8 {
    (weight * 255.0).round().clamp(1.0, 255.0) as u8
}

/// The inverse of [`pack_weight`].
#[inline]
fn weight(packed: u8) -> f64 {
    f64::from(packed) / 255.0
}

/// Sigma as it is kept: the nearest number whose `f32` has no bits but its upper 16, which is within 0.4 %.
pub(super) fn pack_sigma(sigma: f32) -> u16 {
    if sigma.is_nan() { (f32::NAN.to_bits() >> 16) as u16 } else { ((sigma.to_bits() + 0x8000) >> 16) as u16 }
}

/// The inverse of [`pack_sigma`].
pub(super) fn unpack_sigma(packed: u16) -> f32 {
    f32::from_bits(u32::from(packed) << 16)
}

/// A fraction within the margins that crossings keep.
pub(super) fn margined(position: f32) -> f32 {
    position.clamp(CROSSING_MARGIN, 1.0 - CROSSING_MARGIN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::cube::{corner_offset, other_axes};

    #[test]
    fn sigmas_are_kept_to_half_a_percent() {
        assert!(unpack_sigma(pack_sigma(f32::NAN)).is_nan() && unpack_sigma(pack_sigma(-f32::NAN)).is_nan());
        for i in 0..20_000 {
            let sigma = 1e-6 * (i as f32 * 1e-3).exp();
            assert!((unpack_sigma(pack_sigma(sigma)) / sigma - 1.0).abs() < 0.004, "{sigma}");
        }
        assert_eq!(unpack_sigma(pack_sigma(0.0)).to_bits(), 0);
    }

    #[test]
    fn a_ring_goes_round_its_edge() {
        for axis in 0..3 {
            for i in 0..4 {
                // The edge, seen from each cell, is the same one.
                let (offset, edge) = (ring_offset(axis, i), ring_edge(axis, i));
                let [low, _] = crate::grid::cube::edge_corners(edge);
                assert_eq!(corner_offset(low), offset);
                let next = ring_offset(axis, (i + 1) % 4);
                let moved: Vec<usize> = (0..3).filter(|&a| offset[a] != next[a]).collect();
                assert_eq!(moved, [ring_face_axis(axis, i)]);
                assert!(other_axes(axis).contains(&moved[0]));
            }
        }
    }
}
