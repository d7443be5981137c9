//! A filtered volume that is kept, so that each voxel is filtered once only.

use std::io::Write;
use std::path::Path;

use super::Denoised;
use crate::execution::{Execution, Stage};
use crate::grid::VoxelBox;
use crate::volume::collect::{Endian, reserve};
use crate::volume::positioned::{PositionedFile, io_error};
use crate::volume::raw::RawSource;
use crate::volume::{MemorySource, SampleType, Samples, VolumeError, VolumeSource};

impl Denoised<'_> {
    /// The whole volume, filtered, in memory: four bytes a voxel. `stage` advances by a step a slice.
    ///
    /// # Errors
    /// As [`VolumeSource::append`].
    pub fn in_memory(&self, execution: &Execution, stage: &Stage<'_>) -> Result<MemorySource, VolumeError> {
        let mut all = Vec::new();
        reserve(&mut all, self.geometry().voxels())?;
        self.each(execution, stage, |filtered| {
            all.extend_from_slice(filtered);
            Ok(())
        })?;
        MemorySource::new(self.geometry().clone(), Samples::F32(all))
    }

    /// The whole volume, filtered, in a file in `folder` that has no name and is gone when the source is,
    /// however the process ends: four bytes a voxel. `stage` advances by a step a slice.
    ///
    /// # Errors
    /// As [`VolumeSource::append`]; [`VolumeError::Io`] if the file cannot be written.
    pub fn in_file(
        &self,
        folder: &Path,
        execution: &Execution,
        stage: &Stage<'_>,
    ) -> Result<Box<dyn VolumeSource>, VolumeError> {
        let failed = |error| io_error(folder, error);
        let mut file = tempfile::tempfile_in(folder).map_err(failed)?;
        self.each(execution, stage, |filtered| {
            file.write_all(bytemuck::cast_slice(filtered)).map_err(|error| io_error(folder, error))
        })?;
        let file = PositionedFile::scratch(file, folder)?;
        let source = RawSource::new(file, self.geometry().clone(), SampleType::F32, Endian::NATIVE, 0)?;
        Ok(Box::new(source))
    }

    /// Hands on all filtered slices in order.
    fn each(
        &self,
        execution: &Execution,
        stage: &Stage<'_>,
        mut take: impl FnMut(&[f32]) -> Result<(), VolumeError>,
    ) -> Result<(), VolumeError> {
        let size = self.geometry().size();
        let mut reader = self.slices(&VoxelBox::whole(size))?;
        for start in (0..size[2]).step_by(self.slices_at_a_time()) {
            let end = (start + self.slices_at_a_time()).min(size[2]);
            let mut filtered = Samples::none(SampleType::F32);
            reader.read(start..end, &mut filtered, execution)?;
            let Samples::F32(values) = filtered else { continue };
            take(&values)?;
            stage.advance((end - start) as u64);
        }
        Ok(())
    }
}
