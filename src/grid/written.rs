//! Where points of a lattice lie in the world as a mesh has them, in memory and in a file.

use glam::DVec3;

use super::Geometry;

/// Places points in the world, mm. Where a file will hold coordinates as `f32` ([`Geometry::fits_single`]) they are rounded so
/// at once: what is found to meet or not to meet in memory is what the file shows.
#[derive(Debug, Clone, Copy)]
pub struct Written<'a> {
    geometry: &'a Geometry,
    single: bool,
}

impl<'a> Written<'a> {
    /// For the lattice of `geometry`.
    #[must_use]
    pub fn new(geometry: &'a Geometry) -> Self {
        Self { geometry, single: geometry.fits_single() }
    }

    /// The place of a (fractional) lattice index.
    #[must_use]
    pub fn place(&self, index: DVec3) -> DVec3 {
        let world = self.geometry.world(index);
        if self.single { world.as_vec3().as_dvec3() } else { world }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_rounded_where_a_file_rounds_them() {
        let geometry = |origin: f64| {
            let eye = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            Geometry::new([9; 3], [0.092; 3], [origin; 3], eye).unwrap()
        };
        let (near, far) = (geometry(0.0), geometry(5000.0));
        let index = DVec3::new(1.1, 2.3, 3.7);
        let place = Written::new(&near).place(index);
        assert_ne!(place, near.world(index));
        assert_eq!(place, near.world(index).as_vec3().as_dvec3());
        assert_eq!(Written::new(&far).place(index), far.world(index));
    }
}
