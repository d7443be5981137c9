//! Samples that are no numbers are refused where they enter.

use super::{Samples, VolumeError};
use crate::grid::VoxelBox;

/// Refuses samples (of the box `part` of a volume) that are infinite or not a number. One such
/// value would spread through every mean, gradient and fit that touches it.
///
/// # Errors
/// [`VolumeError::NotFinite`] with their number and the index of the first one.
pub fn check_finite(samples: &Samples, part: &VoxelBox) -> Result<(), VolumeError> {
    let Samples::F32(values) = samples else { return Ok(()) };
    check_values(values, part)
}

/// As [`check_finite`], of values known to be `f32`.
pub(super) fn check_values(values: &[f32], part: &VoxelBox) -> Result<(), VolumeError> {
    let Some(i) = values.iter().position(|v| !v.is_finite()) else { return Ok(()) };
    let count = values[i..].iter().filter(|v| !v.is_finite()).count();
    let [x, y, _] = part.size();
    let first = [part.low[0] + i % x, part.low[1] + i / x % y, part.low[2] + i / x / y];
    Err(VolumeError::NotFinite { count, first, value: values[i] })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bad_voxel_is_named_by_its_index_in_the_volume() {
        let part = VoxelBox { low: [10, 20, 30], high: [13, 22, 32] };
        let mut values: Vec<f32> = (0..12).map(|i| i as f32).collect();
        assert!(check_finite(&Samples::F32(values.clone()), &part).is_ok());
        values[10] = f32::NAN;
        values[11] = f32::INFINITY;
        let error = check_finite(&Samples::F32(values), &part).unwrap_err();
        let VolumeError::NotFinite { count, first, value } = error else { panic!("{error}") };
        assert_eq!((count, first, value.is_nan()), (2, [11, 21, 31], true));
    }
}
