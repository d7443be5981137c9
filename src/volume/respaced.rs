//! A volume whose spacing the user knows better than its file.

use super::source::SPACING_ASSUMED;
use super::{SampleType, Samples, SliceReader, VolumeError, VolumeSource};
use crate::execution::Execution;
use crate::grid::{Geometry, GeometryError, VoxelBox};

/// Another volume with its spacing replaced, which its notes say. Samples, origin and direction
/// stay as they are.
pub struct Respaced {
    source: Box<dyn VolumeSource>,
    geometry: Geometry,
}

impl Respaced {
    /// `source` with the spacing `spacing`, in millimetres.
    ///
    /// # Errors
    /// [`GeometryError::Spacing`] if it is not usable.
    pub fn new(source: Box<dyn VolumeSource>, spacing: [f64; 3]) -> Result<Self, GeometryError> {
        let geometry = source.geometry().with_spacing(spacing)?;
        Ok(Self { source, geometry })
    }
}

impl VolumeSource for Respaced {
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
        self.source.read(part)
    }

    fn append(&self, part: &VoxelBox, out: &mut Samples, execution: &Execution) -> Result<(), VolumeError> {
        self.source.append(part, out, execution)
    }

    fn slices(&self, frame: &VoxelBox) -> Result<Box<dyn SliceReader + '_>, VolumeError> {
        self.source.slices(frame)
    }

    fn in_memory(&self) -> Option<&Samples> {
        self.source.in_memory()
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = self.source.notes();
        let text = |[x, y, z]: [f64; 3]| format!("{x} x {y} x {z} mm");
        let given = text(self.geometry.spacing());
        match notes.iter().position(|note| note == SPACING_ASSUMED) {
            Some(assumed) => notes[assumed] = format!("the spacing {given} was given; the file has none"),
            None => {
                let own = text(self.source.geometry().spacing());
                notes.push(format!("the spacing {given} was given, in place of the file's {own}"));
            }
        }
        notes
    }
}
