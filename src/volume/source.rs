//! Region reads: every volume, in memory or on disk, is a [`VolumeSource`].

use std::path::PathBuf;

use thiserror::Error;

use super::{SampleType, Samples};
use crate::grid::{Geometry, GeometryError, VoxelBox};

/// Why a volume cannot be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum VolumeError {
    /// The file system refused.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// What was to be read.
        path: PathBuf,
        /// What the system said.
        #[source]
        error: std::io::Error,
    },
    /// Header values that make no geometry.
    #[error("{}: {error}", path.display())]
    Geometry {
        /// The file whose header it is.
        path: PathBuf,
        /// What is wrong with it.
        #[source]
        error: GeometryError,
    },
    /// A box that is empty or reaches beyond the volume.
    #[error("the box {box_low:?} to {box_high:?} is not inside the volume of {size:?} voxels", box_low = .part.low, box_high = .part.high)]
    Box {
        /// The box asked for.
        part: VoxelBox,
        /// Voxels per axis of the volume.
        size: [usize; 3],
    },
    /// Fewer samples than the size says.
    #[error("{got} samples for a volume of {size:?} voxels, which needs {needed}")]
    Length {
        /// Samples given.
        got: usize,
        /// Voxels per axis.
        size: [usize; 3],
        /// Samples needed.
        needed: usize,
    },
}

/// A volume of grey values from which any box can be read.
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
    /// [`VolumeError::Length`] if their number does not fit the geometry.
    pub fn new(geometry: Geometry, samples: Samples) -> Result<Self, VolumeError> {
        if samples.len() != geometry.voxels() {
            let (size, needed) = (geometry.size(), geometry.voxels());
            return Err(VolumeError::Length { got: samples.len(), size, needed });
        }
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
