//! The mean of a box.

use super::kernel::reach;
use super::separable::Separable;

/// The mean over the voxels whose centres are within `radius` mm along each axis.
pub(super) fn mean(radius: f64, spacing: [f64; 3]) -> Separable {
    Separable::new(reach(radius, spacing).map(|n| vec![1.0; n as usize + 1]))
}
