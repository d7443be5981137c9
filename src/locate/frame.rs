//! Blur units: lattice coordinates divided by the sigma of the blur along each axis, so that the blur is round
//! and of sigma one whatever the voxel and the scanner make of it.

use glam::DVec3;

/// Maps voxels to blur units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlurUnits {
    /// Blur units per voxel along each axis.
    pub per_voxel: DVec3,
    /// Voxels of mean edge length per blur unit, the mean of the axes: to say lengths to people.
    pub mean_voxels: f64,
}

impl BlurUnits {
    /// How many voxels a cube of one blur unit has.
    #[must_use]
    pub fn density(&self) -> f64 {
        1.0 / self.per_voxel.element_product()
    }

    /// For a blur of `sigma` voxels along each axis, all positive.
    #[must_use]
    pub fn new(sigma: [f64; 3]) -> Self {
        let sigma = DVec3::from(sigma);
        Self { per_voxel: sigma.recip(), mean_voxels: (sigma.x * sigma.y * sigma.z).cbrt() }
    }

    /// For a blur that is wider by a factor.
    #[must_use]
    pub fn wider(&self, factor: f64) -> Self {
        Self { per_voxel: self.per_voxel / factor, mean_voxels: self.mean_voxels * factor }
    }

    /// Of a point in voxels.
    #[inline]
    #[must_use]
    pub fn of(&self, voxel: DVec3) -> DVec3 {
        voxel * self.per_voxel
    }

    /// The point in voxels.
    #[inline]
    #[must_use]
    pub fn voxel(&self, units: DVec3) -> DVec3 {
        units / self.per_voxel
    }
}

/// A right-handed basis whose third axis is `t`, a unit vector.
#[must_use]
pub(super) fn basis(t: DVec3) -> [DVec3; 3] {
    let (a, b) = t.any_orthonormal_pair();
    // `any_orthonormal_pair` promises orthogonality only; the sign makes it right-handed.
    if a.cross(b).dot(t) > 0.0 { [a, b, t] } else { [b, a, t] }
}
