//! From lengths about the middle of a root to the world, as the mesh will be written.

use glam::DVec3;

use super::roots::{RootGrid, SIDE};
use crate::grid::{Geometry, Written};

/// Places points in the world, mm.
pub(super) struct World<'a> {
    geometry: &'a Geometry,
    written: Written<'a>,
    grid: &'a RootGrid,
}

impl<'a> World<'a> {
    pub(super) fn new(geometry: &'a Geometry, grid: &'a RootGrid) -> Self {
        Self { geometry, written: Written::new(geometry), grid }
    }

    /// The point `at` of root `number` in the world.
    pub(super) fn place(&self, number: usize, at: DVec3) -> DVec3 {
        self.written.place(self.middle(number) + at / self.grid.cell)
    }

    /// A point of the world in lengths about the middle of root `number`.
    pub(super) fn seen_from(&self, number: usize, world: DVec3) -> DVec3 {
        (self.geometry.index(world) - self.middle(number)) * self.grid.cell
    }

    /// The middle of a root, voxels.
    fn middle(&self, number: usize) -> DVec3 {
        let low = DVec3::from(self.grid.low(number).map(|c| c as f64));
        // Padded cell 0 begins at voxel -1.
        low + (SIDE / 2) as f64 - 1.0
    }
}
