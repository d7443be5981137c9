//! From lengths about the middle of a root to the world, as the mesh will be written.

use glam::DVec3;

use super::roots::{RootGrid, SIDE};
use crate::grid::{Geometry, Written};

/// Places points in the world, mm.
pub(super) struct World<'a> {
    written: Written<'a>,
    grid: &'a RootGrid,
}

impl<'a> World<'a> {
    pub(super) fn new(geometry: &'a Geometry, grid: &'a RootGrid) -> Self {
        Self { written: Written::new(geometry), grid }
    }

    /// The point `at` of root `number` in the world.
    pub(super) fn place(&self, number: usize, at: DVec3) -> DVec3 {
        let low = DVec3::from(self.grid.low(number).map(|c| c as f64));
        // Padded cell 0 begins at voxel -1.
        self.written.place(low + (SIDE / 2) as f64 + at / self.grid.cell - 1.0)
    }
}
