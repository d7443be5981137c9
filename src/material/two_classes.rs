//! The two materials on both sides of one grey value: how many voxels they have, and their means.

use rayon::prelude::*;

use super::counts::rows;
use super::deep::Moments;
use super::find::{FindError, default_name};
use super::table::MaterialTable;
use crate::volume::{Sample, SampleWindow, VolumeError};

/// The voxels below a grey value and those at or above it.
#[derive(Debug, Clone, Copy)]
pub struct TwoClasses {
    iso: f32,
    classes: [Moments; 2],
    range: [f32; 2],
}

impl TwoClasses {
    /// Counts the voxels of a volume below `iso` and the others, in one pass by slabs of `thickness` slices.
    ///
    /// # Errors
    /// [`VolumeError`] if the volume cannot be read.
    pub fn read<S: Sample>(
        window: &mut SampleWindow<'_, S>,
        iso: f32,
        thickness: usize,
    ) -> Result<Self, VolumeError> {
        let none = Self {
            iso,
            classes: [Moments::about(f64::from(iso)); 2],
            range: [f32::INFINITY, f32::NEG_INFINITY],
        };
        let mut all = none;
        window.sweep(thickness, 0, |slab, core| {
            let count = |row: &&[S]| row.iter().map(|v| v.to_f32()).fold(none, Self::with);
            // Row after row in order, so that slabs and threads do not matter.
            let found: Vec<Self> = rows(slab, core).par_iter().map(count).collect();
            found.iter().for_each(|row| all.merge(row));
            Ok::<_, VolumeError>(())
        })?;
        Ok(all)
    }

    fn with(mut self, grey: f32) -> Self {
        self.classes[usize::from(grey >= self.iso)].add(f64::from(grey));
        self.range = [self.range[0].min(grey), self.range[1].max(grey)];
        self
    }

    fn merge(&mut self, other: &Self) {
        self.classes.iter_mut().zip(&other.classes).for_each(|(all, more)| all.merge(more));
        self.range = [self.range[0].min(other.range[0]), self.range[1].max(other.range[1])];
    }

    /// Voxels below the grey value, and voxels at or above it.
    #[must_use]
    pub fn voxels(&self) -> [u64; 2] {
        self.classes.map(|class| class.voxels)
    }

    /// The two as materials `air` and `material1`, with the means of all their voxels, blurred edges
    /// included; for that reason without a noise.
    ///
    /// # Errors
    /// [`FindError::IsoOutside`] if one of them has no voxels.
    pub fn table(&self) -> Result<MaterialTable, FindError> {
        let [Some(below), Some(above)] = self.classes.map(|class| class.mean()) else {
            let [low, high] = self.range;
            return Err(FindError::IsoOutside { iso: f64::from(self.iso), low, high });
        };
        let table = MaterialTable::new([(default_name(0), below), (default_name(1), above)])?;
        Ok(table.with_statistics(&self.voxels().map(|n| (None, Some(n)))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::execution::Execution;
    use crate::grid::Geometry;
    use crate::volume::{MemorySource, Samples};

    fn classes(iso: f32) -> TwoClasses {
        let geometry = Geometry::axis_aligned([2, 3, 2], [1.0; 3]).unwrap();
        let samples = Samples::I16(vec![-4, 0, 3, 5, 6, 9, -2, 0, 1, 5, 4, 12]);
        let (source, execution) = (MemorySource::new(geometry, samples).unwrap(), Execution::default());
        TwoClasses::read(&mut SampleWindow::<i16>::new(&source, &execution).unwrap(), iso, 1).unwrap()
    }

    #[test]
    fn a_voxel_at_the_value_is_material() {
        let found = classes(5.0);
        assert_eq!(found.voxels(), [7, 5]);
        let table = found.table().unwrap();
        let means: Vec<f64> = table.materials().iter().map(|m| m.mean).collect();
        assert!((means[0] - 2.0 / 7.0).abs() < 1e-12 && (means[1] - 37.0 / 5.0).abs() < 1e-12, "{means:?}");
        assert_eq!(table.materials()[1].voxels, Some(5));
    }

    #[test]
    fn a_value_that_parts_nothing_is_refused() {
        for iso in [-4.0, 12.5] {
            let error = classes(iso).table().unwrap_err();
            assert_eq!(error, FindError::IsoOutside { iso: f64::from(iso), low: -4.0, high: 12.0 });
        }
    }
}
