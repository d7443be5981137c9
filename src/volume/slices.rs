//! [`SliceReader`]: the slices of a volume in ascending order, in one pass.

use std::ops::Range;

use super::source::check_box;
use super::{Samples, VolumeError, VolumeSource};
use crate::execution::Execution;
use crate::grid::VoxelBox;

/// Reads whole slices of a part of a volume, its *frame*. In ascending order, with or without gaps,
/// a volume costs one pass, also where it is compressed. An earlier slice than the last one read is
/// given as well, and begins a new pass.
pub trait SliceReader: Send {
    /// Appends the samples of the slices `slices` of the frame to `out`, which must be of the volume's
    /// type. What `out` holds beyond its former samples is not to be used after an error.
    ///
    /// # Errors
    /// [`VolumeError::Box`] for slices beyond the frame; [`VolumeError::Cancelled`] if `execution`
    /// was; otherwise whatever went wrong while reading.
    fn read(
        &mut self,
        slices: Range<usize>,
        out: &mut Samples,
        execution: &Execution,
    ) -> Result<(), VolumeError>;
}

/// The slices of a volume of which any box can be read.
pub(crate) struct SlicesByBox<'a, V: ?Sized> {
    source: &'a V,
    frame: VoxelBox,
}

impl<'a, V: VolumeSource + ?Sized> SlicesByBox<'a, V> {
    /// The slices of `frame`.
    pub(crate) fn new(source: &'a V, frame: &VoxelBox) -> Result<Self, VolumeError> {
        check_box(frame, source.geometry().size())?;
        Ok(Self { source, frame: *frame })
    }
}

impl<V: VolumeSource + ?Sized> SliceReader for SlicesByBox<'_, V> {
    fn read(
        &mut self,
        slices: Range<usize>,
        out: &mut Samples,
        execution: &Execution,
    ) -> Result<(), VolumeError> {
        self.source.append(&slices_of(&self.frame, slices)?, out, execution)
    }
}

/// The box of the slices `slices` of a frame, counted from its lowest one.
pub(crate) fn slices_of(frame: &VoxelBox, slices: Range<usize>) -> Result<VoxelBox, VolumeError> {
    let [width, height, depth] = frame.size();
    let own = VoxelBox { low: [0, 0, slices.start], high: [width, height, slices.end] };
    check_box(&own, [width, height, depth])?;
    let [x, y, z] = frame.low;
    let high = [frame.high[0], frame.high[1], z + slices.end];
    Ok(VoxelBox { low: [x, y, z + slices.start], high })
}
