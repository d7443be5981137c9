//! Region reads: every volume, in memory or on disk, is a [`VolumeSource`].

use super::finite::check_finite;
use super::slices::{SliceReader, SlicesByBox};
use super::{SampleType, Samples, VolumeError};
use crate::execution::Execution;
use crate::grid::{Geometry, VoxelBox};

/// The note of a source whose file says nothing about spacing.
pub(crate) const SPACING_ASSUMED: &str = "the file gives no spacing that could be relied on: 1 mm was taken";

/// A volume of grey values from which any box can be read, from any thread.
///
/// No source ever yields a sample that is not finite.
pub trait VolumeSource: Send + Sync {
    /// Size, spacing, origin and direction of the whole volume.
    fn geometry(&self) -> &Geometry;

    /// Number type of the samples.
    fn sample_type(&self) -> SampleType;

    /// Whether reading a small box costs about as much as its share of the volume. `false` for a
    /// compressed stream, which must be read from its start.
    fn cheap_partial_reads(&self) -> bool;

    /// The samples of `part`, x fastest.
    ///
    /// # Errors
    /// [`VolumeError::Box`] if the box is empty or not inside the volume; otherwise whatever went
    /// wrong while reading.
    fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError>;

    /// Appends the samples of `part` to `out`, which must be of this volume's type. What `out` holds
    /// beyond its former samples is not to be used after an error.
    ///
    /// # Errors
    /// As [`VolumeSource::read`]; [`VolumeError::Cancelled`] if `execution` was, while much was read.
    fn append(&self, part: &VoxelBox, out: &mut Samples, execution: &Execution) -> Result<(), VolumeError> {
        execution.check()?;
        out.append(self.read(part)?)
    }

    /// A reader of the slices of `frame`, whose numbers begin at 0 with the frame's lowest slice.
    ///
    /// # Errors
    /// [`VolumeError::Box`] if the frame is empty or not inside the volume; [`VolumeError::Io`].
    fn slices(&self, frame: &VoxelBox) -> Result<Box<dyn SliceReader + '_>, VolumeError> {
        Ok(Box::new(SlicesByBox::new(self, frame)?))
    }

    /// All samples, if they are in memory as they are.
    fn in_memory(&self) -> Option<&Samples> {
        None
    }

    /// What a report should say about how this volume was read: assumptions made, values replaced.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }

    /// All samples.
    ///
    /// # Errors
    /// As [`VolumeSource::read`].
    fn read_all(&self) -> Result<Samples, VolumeError> {
        self.read(&VoxelBox::whole(self.geometry().size()))
    }
}

/// A volume held in memory.
#[derive(Debug, Clone)]
pub struct MemorySource {
    geometry: Geometry,
    samples: Samples,
}

impl MemorySource {
    /// A volume of `samples`, x fastest.
    ///
    /// # Errors
    /// [`VolumeError::Length`] if their number does not fit the geometry, [`VolumeError::NotFinite`]
    /// if one of them is not a number.
    pub fn new(geometry: Geometry, samples: Samples) -> Result<Self, VolumeError> {
        if samples.len() != geometry.voxels() {
            let (size, needed) = (geometry.size(), geometry.voxels());
            return Err(VolumeError::Length { got: samples.len(), size, needed });
        }
        check_finite(&samples, &VoxelBox::whole(geometry.size()))?;
        Ok(Self { geometry, samples })
    }
}

/// Checks that a box to be read is not empty and lies inside a volume of `size` voxels.
pub(crate) fn check_box(part: &VoxelBox, size: [usize; 3]) -> Result<(), VolumeError> {
    if part.is_empty() || !part.is_inside(&VoxelBox::whole(size)) {
        return Err(VolumeError::Box { part: *part, size });
    }
    Ok(())
}

/// Copies a box out of a volume of `size` elements (x fastest).
pub(crate) fn crop<T: Copy>(all: &[T], size: [usize; 3], part: &VoxelBox) -> Vec<T> {
    let mut out = Vec::with_capacity(part.size().iter().product());
    for z in part.low[2]..part.high[2] {
        for y in part.low[1]..part.high[1] {
            let row = (z * size[1] + y) * size[0];
            out.extend_from_slice(&all[row + part.low[0]..row + part.high[0]]);
        }
    }
    out
}

impl VolumeSource for MemorySource {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    fn sample_type(&self) -> SampleType {
        self.samples.sample_type()
    }

    fn cheap_partial_reads(&self) -> bool {
        true
    }

    fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
        let size = self.geometry.size();
        check_box(part, size)?;
        Ok(match &self.samples {
            Samples::U8(v) => Samples::U8(crop(v, size, part)),
            Samples::U16(v) => Samples::U16(crop(v, size, part)),
            Samples::I16(v) => Samples::I16(crop(v, size, part)),
            Samples::F32(v) => Samples::F32(crop(v, size, part)),
        })
    }

    fn in_memory(&self) -> Option<&Samples> {
        Some(&self.samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_is_read_from_memory_in_order_and_checked() {
        let geometry = Geometry::axis_aligned([3, 2, 2], [1.0; 3]).unwrap();
        let source = MemorySource::new(geometry, Samples::U8((0..12).collect())).unwrap();
        let part = VoxelBox { low: [1, 0, 1], high: [3, 2, 2] };
        assert_eq!(source.read(&part).unwrap(), Samples::U8(vec![7, 8, 10, 11]));
        let beyond = VoxelBox { low: [1, 0, 1], high: [4, 2, 2] };
        assert!(matches!(source.read(&beyond), Err(VolumeError::Box { .. })));
    }
}
