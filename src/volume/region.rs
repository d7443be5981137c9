//! A part of a volume as a volume of its own.

use super::source::check_box;
use super::{SampleType, Samples, SliceReader, VolumeError, VolumeSource};
use crate::execution::Execution;
use crate::grid::{Geometry, VoxelBox};

/// A box of another volume; its origin moves along, so every voxel stays where it was in the world.
pub struct RegionOfInterest {
    source: Box<dyn VolumeSource>,
    part: VoxelBox,
    geometry: Geometry,
}

impl RegionOfInterest {
    /// The part `part` of `source`.
    ///
    /// # Errors
    /// [`VolumeError::Box`] if it is empty or not inside the volume.
    pub fn new(source: Box<dyn VolumeSource>, part: VoxelBox) -> Result<Self, VolumeError> {
        let refused = VolumeError::Box { part, size: source.geometry().size() };
        check_box(&part, source.geometry().size())?;
        // Cropping a valid geometry by a box inside it can fail only for an origin at infinity.
        let geometry = source.geometry().crop(&part).map_err(|_| refused)?;
        Ok(Self { source, part, geometry })
    }

    /// A box of this volume as a box of the volume behind it.
    fn within_source(&self, part: &VoxelBox) -> Result<VoxelBox, VolumeError> {
        check_box(part, self.geometry.size())?;
        let moved = |corner: [usize; 3]| std::array::from_fn(|a| corner[a] + self.part.low[a]);
        Ok(VoxelBox { low: moved(part.low), high: moved(part.high) })
    }
}

impl VolumeSource for RegionOfInterest {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    fn sample_type(&self) -> SampleType {
        self.source.sample_type()
    }

    fn cheap_partial_reads(&self) -> bool {
        self.source.cheap_partial_reads()
    }

    fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
        self.source.read(&self.within_source(part)?)
    }

    fn append(&self, part: &VoxelBox, out: &mut Samples, execution: &Execution) -> Result<(), VolumeError> {
        self.source.append(&self.within_source(part)?, out, execution)
    }

    fn slices(&self, frame: &VoxelBox) -> Result<Box<dyn SliceReader + '_>, VolumeError> {
        self.source.slices(&self.within_source(frame)?)
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = self.source.notes();
        let range = |a: usize| format!("{}:{}", self.part.low[a], self.part.high[a]);
        let [x, y, z] = self.source.geometry().size();
        notes.push(format!(
            "only the region {},{},{} of the {x} x {y} x {z} voxels was read",
            range(0),
            range(1),
            range(2)
        ));
        notes
    }
}
