//! Roots: aligned blocks of cells of the padded lattice, in which the octree's nodes live, and the places of
//! cells in them.

use glam::DVec3;

use crate::contour::crossing::CROSSING_MARGIN;
use crate::grid::Geometry;

/// Levels of nodes above a cell.
pub(super) const LEVELS: u8 = 5;
/// Cells along a root's side.
pub(super) const SIDE: usize = 1 << LEVELS;

/// The roots of a volume, and its lengths.
#[derive(Debug, Clone)]
pub(super) struct RootGrid {
    /// Cells of the padded lattice per axis.
    pub(super) cells: [usize; 3],
    /// Roots per axis.
    pub(super) roots: [usize; 3],
    /// Size of a cell per axis, in voxels of mean edge.
    pub(super) cell: DVec3,
}

impl RootGrid {
    pub(super) fn new(geometry: &Geometry) -> Self {
        let cells = geometry.size().map(|n| n + 1);
        let roots = cells.map(|n| n.div_ceil(SIDE));
        let cell = DVec3::from(geometry.spacing()) / geometry.voxel_edge();
        Self { cells, roots, cell }
    }

    /// Number of the root that holds a cell.
    pub(super) fn root_of(&self, cell: [usize; 3]) -> usize {
        self.number(cell.map(|c| c / SIDE))
    }

    /// Number of the root at a place in the grid of roots.
    pub(super) fn number(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.roots[1] + y) * self.roots[0] + x
    }

    /// The sides of the volume that a cell reaches beyond: bit 2 · axis, or 2 · axis + 1 for the far side.
    #[inline]
    pub(super) fn sides(&self, cell: [usize; 3]) -> u8 {
        (0..3).fold(0, |sides, a| {
            sides | u8::from(cell[a] == 0) << (2 * a) | u8::from(cell[a] + 1 == self.cells[a]) << (2 * a + 1)
        })
    }

    /// The coordinates of points on these sides of the volume, in lengths about the middle of root `number`.
    pub(super) fn fixed(&self, number: usize, sides: u8) -> [Option<f64>; 3] {
        if sides == 0 {
            return [None; 3];
        }
        let low = self.low(number);
        [0, 1, 2].map(|a| {
            let cell = match sides >> (2 * a) & 3 {
                0 => return None,
                1 => 0,
                _ => self.cells[a] - 1,
            };
            Some((cell as f64 + 0.5 - (low[a] + SIDE / 2) as f64) * self.cell[a])
        })
    }

    /// The lowest cell of a root.
    pub(super) fn low(&self, root: usize) -> [usize; 3] {
        let [x, y, _] = self.roots;
        [root % x, root / x % y, root / (x * y)].map(|r| r * SIDE)
    }

    /// From the middle of root 0 to that of a root, lengths.
    pub(super) fn offset(&self, root: usize) -> DVec3 {
        DVec3::from(self.low(root).map(|c| c as f64)) * self.cell
    }
}

/// The place of a cell in its root: three coordinates of [`LEVELS`] bits, interleaved, x lowest.
#[inline]
pub(super) fn morton(cell: [usize; 3]) -> u16 {
    let spread = |v: usize| {
        let v = (v % SIDE) as u32;
        let v = (v | v << 8) & 0x0300_F00F;
        let v = (v | v << 4) & 0x030C_30C3;
        (v | v << 2) & 0x0924_9249
    };
    (spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2) as u16
}

/// The inverse of [`morton`].
#[inline]
pub(super) fn place(morton: u16) -> [usize; 3] {
    let gather = |v: u16| {
        let v = u32::from(v) & 0x0924_9249;
        let v = (v | v >> 2) & 0x030C_30C3;
        let v = (v | v >> 4) & 0x0300_F00F;
        ((v | v >> 8) & 0x1F) as usize
    };
    [gather(morton), gather(morton >> 1), gather(morton >> 2)]
}

/// A block of cells: an octree node's, or a cell itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Block {
    /// Its lowest cell's place in the root.
    pub(super) low: u16,
    /// Its side is 2^level cells.
    pub(super) level: u8,
}

impl Block {
    /// The corners of what a vertex of the block may take, in lengths about the middle of its root: the block
    /// but for a margin, so that vertices of different blocks are different points.
    pub(super) fn bounds(self, grid: &RootGrid) -> [DVec3; 2] {
        let low = DVec3::from(place(self.low).map(|c| c as f64 - (SIDE / 2) as f64));
        let (margin, side) = (f64::from(CROSSING_MARGIN), f64::from(1u32 << self.level));
        [(low + margin) * grid.cell, (low + side - margin) * grid.cell]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_found_again_and_siblings_are_neighbours() {
        for m in 0..1u16 << 15 {
            let at = place(m);
            assert_eq!(morton(at), m);
            let parent = place(m >> 3 << 3);
            assert!((0..3).all(|a| at[a] & !1 == parent[a]));
        }
        assert_eq!(morton([1, 0, 0]), 1);
        assert_eq!(morton([33, 2, 0]), 0b10_001);
    }
}
