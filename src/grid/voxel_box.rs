//! Boxes of voxels.

use serde::{Deserialize, Serialize};

/// A box of voxels, half open: `low <= index < high` per axis (x, y, z).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct VoxelBox {
    /// The lowest voxel inside.
    pub low: [usize; 3],
    /// One past the highest voxel inside.
    pub high: [usize; 3],
}

impl VoxelBox {
    /// The box of a whole volume of `size` voxels.
    #[must_use]
    pub fn whole(size: [usize; 3]) -> Self {
        Self { low: [0; 3], high: size }
    }

    /// Voxels per axis; 0 where the box is empty.
    #[must_use]
    pub fn size(&self) -> [usize; 3] {
        std::array::from_fn(|a| self.high[a].saturating_sub(self.low[a]))
    }

    /// Number of voxels, or `None` if it does not fit a `usize`.
    #[must_use]
    pub fn checked_len(&self) -> Option<usize> {
        let [x, y, z] = self.size();
        x.checked_mul(y)?.checked_mul(z)
    }

    /// Whether no voxel is inside.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.size().contains(&0)
    }

    /// Whether every voxel of `self` lies in `other`.
    #[must_use]
    pub fn is_inside(&self, other: &Self) -> bool {
        (0..3).all(|a| other.low[a] <= self.low[a] && self.high[a] <= other.high[a])
    }
}
