//! The lattice in the world: size, spacing, origin and direction.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::VoxelBox;

/// Why a geometry is refused.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum GeometryError {
    /// An axis has no voxels, or the number of voxels overflows.
    #[error(
        "the volume size {size:?} is not usable: every axis needs 1 to {limit} voxels and all voxels together must be countable"
    )]
    Size {
        /// Voxels per axis as given.
        size: [usize; 3],
        /// The largest number of voxels along one axis.
        limit: usize,
    },
    /// A spacing is zero, negative, infinite or not a number, or beyond what can be computed with.
    #[error(
        "the voxel spacing {spacing:?} is not usable: every value must be a positive number of millimetres, from {:e} to {:e}; give the right one with --spacing",
        Geometry::SPACINGS[0],
        Geometry::SPACINGS[1]
    )]
    Spacing {
        /// Millimetres per voxel as given.
        spacing: [f64; 3],
    },
    /// The origin is not finite.
    #[error("the origin {origin:?} is not usable: every value must be a finite number of millimetres")]
    Origin {
        /// As given.
        origin: [f64; 3],
    },
    /// The direction matrix is singular or not finite.
    #[error(
        "the direction matrix {direction:?} is not usable: its columns must be finite and linearly independent (determinant {determinant})"
    )]
    Direction {
        /// Columns as given.
        direction: [[f64; 3]; 3],
        /// Its determinant.
        determinant: f64,
    },
}

/// Where a volume's voxels are: `world = origin + direction · (spacing ∘ index)`, in millimetres.
/// An integer index is a voxel's *centre*; the volume's border is at index -0.5 and size - 0.5.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    size: [usize; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    /// Column a is the world direction of index axis a.
    direction: [[f64; 3]; 3],
}

impl Geometry {
    /// The largest number of voxels along one axis: lattice coordinates are kept as `f32` while a
    /// mesh is built, and a crossing must stay distinct from its voxel.
    pub const MAX_AXIS: usize = 1 << 15;

    /// The least and the largest spacing, in millimetres: a femtometre and a thousand kilometres.
    /// Beyond, cubes and sums of squares of lengths would leave the range of a number.
    pub const SPACINGS: [f64; 2] = [1e-12, 1e9];

    /// A checked geometry. `direction[a]` is the world direction of index axis `a`; it is scaled to
    /// unit length (the scale belongs into `spacing`).
    ///
    /// # Errors
    /// [`GeometryError`] names the value that is not usable.
    pub fn new(
        size: [usize; 3],
        spacing: [f64; 3],
        origin: [f64; 3],
        direction: [[f64; 3]; 3],
    ) -> Result<Self, GeometryError> {
        let countable = VoxelBox::whole(size).checked_len().is_some_and(|n| n <= isize::MAX as usize / 8);
        if !countable || size.iter().any(|&n| n == 0 || n > Self::MAX_AXIS) {
            return Err(GeometryError::Size { size, limit: Self::MAX_AXIS });
        }
        if !spacing.iter().all(|s| (Self::SPACINGS[0]..=Self::SPACINGS[1]).contains(s)) {
            return Err(GeometryError::Spacing { spacing });
        }
        if !origin.iter().all(|o| o.is_finite()) {
            return Err(GeometryError::Origin { origin });
        }
        let unit = direction.map(|column| DVec3::from(column).normalize_or_zero());
        let determinant = DMat3::from_cols(unit[0], unit[1], unit[2]).determinant();
        if !determinant.is_finite() || determinant.abs() < 1e-6 {
            return Err(GeometryError::Direction { direction, determinant });
        }
        Ok(Self { size, spacing, origin, direction: unit.map(Into::into) })
    }

    /// A geometry along the world axes with its origin at voxel (0, 0, 0).
    ///
    /// # Errors
    /// As [`Geometry::new`].
    pub fn axis_aligned(size: [usize; 3], spacing: [f64; 3]) -> Result<Self, GeometryError> {
        Self::new(size, spacing, [0.0; 3], DMat3::IDENTITY.to_cols_array_2d())
    }

    /// Voxels per axis.
    #[must_use]
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Number of voxels.
    #[must_use]
    pub fn voxels(&self) -> usize {
        self.size.iter().product()
    }

    /// Millimetres between neighbouring voxel centres, per index axis.
    #[must_use]
    pub fn spacing(&self) -> [f64; 3] {
        self.spacing
    }

    /// World position of the centre of voxel (0, 0, 0), in millimetres.
    #[must_use]
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// Unit world directions of the index axes (columns).
    #[must_use]
    pub fn direction(&self) -> [[f64; 3]; 3] {
        self.direction
    }

    /// World vector per index step: the columns are `direction[a] * spacing[a]`.
    #[must_use]
    pub fn index_to_world(&self) -> DMat3 {
        let column = |a: usize| DVec3::from(self.direction[a]) * self.spacing[a];
        DMat3::from_cols(column(0), column(1), column(2))
    }

    /// World position, in millimetres, of a (fractional) lattice index.
    #[must_use]
    pub fn world(&self, index: DVec3) -> DVec3 {
        DVec3::from(self.origin) + self.index_to_world() * index
    }

    /// (Fractional) lattice index of a world position in millimetres.
    #[must_use]
    pub fn index(&self, world: DVec3) -> DVec3 {
        self.index_to_world().inverse() * (world - DVec3::from(self.origin))
    }

    /// Volume of a voxel in mm³.
    #[must_use]
    pub fn voxel_volume(&self) -> f64 {
        self.index_to_world().determinant().abs()
    }

    /// Edge of the cube with a voxel's volume, in mm: the "voxel" in which accuracy is stated.
    #[must_use]
    pub fn voxel_edge(&self) -> f64 {
        self.voxel_volume().cbrt()
    }

    /// The largest coordinate, mm, without its sign, of a corner of the box of voxels: of any point in it.
    #[must_use]
    pub fn largest_coordinate(&self) -> f64 {
        let far = self.size.map(|n| n as f64 - 0.5);
        let corner = |i: usize| {
            let index = std::array::from_fn(|a| if i >> a & 1 == 0 { -0.5 } else { far[a] });
            self.world(DVec3::from_array(index)).abs().max_element()
        };
        (0..8).map(corner).fold(0.0, f64::max)
    }

    /// Whether points in the box of voxels may be rounded to `f32` coordinates: that costs less than a
    /// thousandth of the finest voxel edge, and keeps the order of coordinates, as the lattice lies along the
    /// world's axes.
    #[must_use]
    pub fn fits_single(&self) -> bool {
        let finest = self.spacing.into_iter().fold(f64::INFINITY, f64::min);
        // One f32 step is at most 2^-23 of the number.
        self.is_along_axes() && self.largest_coordinate() * f64::from(f32::EPSILON) <= finest / 1000.0
    }

    /// Whether the index axes form a left-handed system, so that windings turn over in the world.
    #[must_use]
    pub fn is_mirrored(&self) -> bool {
        self.index_to_world().determinant() < 0.0
    }

    /// Whether every index axis runs exactly along a world axis, one way or the other.
    #[must_use]
    pub fn is_along_axes(&self) -> bool {
        self.direction.iter().flatten().filter(|&&c| c != 0.0).count() == 3
    }

    /// The geometry of a part of this volume.
    ///
    /// # Errors
    /// [`GeometryError::Size`] if the box is empty.
    pub fn crop(&self, part: &VoxelBox) -> Result<Self, GeometryError> {
        let low = DVec3::from(part.low.map(|v| v as f64));
        Self::new(part.size(), self.spacing, self.world(low).into(), self.direction)
    }

    /// The same lattice with another spacing.
    ///
    /// # Errors
    /// [`GeometryError::Spacing`] if it is not usable.
    pub fn with_spacing(&self, spacing: [f64; 3]) -> Result<Self, GeometryError> {
        Self::new(self.size, spacing, self.origin, self.direction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn world_and_index_are_inverse_and_cropping_moves_the_origin() {
        let g = Geometry::new(
            [10, 20, 30],
            [0.4, 0.5, 0.6],
            [1.0, 2.0, 3.0],
            [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 2.0]],
        )
        .unwrap();
        let i = DVec3::new(3.0, 4.5, 6.0);
        assert!((g.index(g.world(i)) - i).length() < 1e-12);
        assert!((g.voxel_volume() - 0.4 * 0.5 * 0.6).abs() < 1e-12);
        assert!(!g.is_mirrored() && g.is_along_axes());
        let turned = [[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]];
        assert!(!Geometry::new([1; 3], [1.0; 3], [0.0; 3], turned).unwrap().is_along_axes());
        let part = g.crop(&VoxelBox { low: [3, 4, 5], high: [6, 6, 6] }).unwrap();
        assert_eq!(part.size(), [3, 2, 1]);
        assert!((part.world(DVec3::ZERO) - g.world(DVec3::new(3.0, 4.0, 5.0))).length() < 1e-12);
    }

    #[test]
    fn unusable_values_are_refused_by_name() {
        let eye = DMat3::IDENTITY.to_cols_array_2d();
        let new = |size, spacing, dir| Geometry::new(size, spacing, [0.0; 3], dir);
        assert!(matches!(new([0, 1, 1], [1.0; 3], eye), Err(GeometryError::Size { .. })));
        assert!(matches!(new([1 << 40, 1, 1], [1.0; 3], eye), Err(GeometryError::Size { .. })));
        assert!(matches!(new([2, 2, 2], [1.0, 0.0, 1.0], eye), Err(GeometryError::Spacing { .. })));
        assert!(matches!(new([2, 2, 2], [1.0, f64::NAN, 1.0], eye), Err(GeometryError::Spacing { .. })));
        assert!(matches!(
            new([2, 2, 2], [1.0; 3], [[1.0, 0.0, 0.0]; 3]),
            Err(GeometryError::Direction { .. })
        ));
    }
}
