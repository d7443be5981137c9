//! From lengths about the middle of a root to the world, as the mesh will be written.

use glam::DVec3;

use super::roots::{RootGrid, SIDE};
use crate::grid::Geometry;

/// Places points in the world, mm.
pub(super) struct World<'a> {
    geometry: &'a Geometry,
    grid: &'a RootGrid,
    /// Whether coordinates are rounded to `f32`, as a file will hold them: what is found to meet or not to
    /// meet here is what the file shows.
    single: bool,
}

impl<'a> World<'a> {
    pub(super) fn new(geometry: &'a Geometry, grid: &'a RootGrid) -> Self {
        Self { geometry, grid, single: geometry.fits_single() }
    }

    /// The point `at` of root `number` in the world.
    pub(super) fn place(&self, number: usize, at: DVec3) -> DVec3 {
        let low = DVec3::from(self.grid.low(number).map(|c| c as f64));
        // Padded cell 0 begins at voxel -1.
        let index = low + (SIDE / 2) as f64 + at / self.grid.cell - 1.0;
        let world = self.geometry.world(index);
        if self.single { world.as_vec3().as_dvec3() } else { world }
    }
}
