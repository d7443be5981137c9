//! [`Slab`]: whole slices of a volume in memory, addressed as in the whole volume.

use std::ops::Range;

use super::Sample;

/// Grey values of consecutive whole slices, whatever type the samples have: for stages whose work by far outweighs a call
/// for each grey value, and which are then compiled once for all types.
pub trait Greys: Sync {
    /// Voxels per axis of the whole volume.
    fn size(&self) -> [usize; 3];

    /// The slices that are here.
    fn slices(&self) -> Range<usize>;

    /// The grey value of voxel (x, y, z).
    ///
    /// # Panics
    /// If slice z is not here.
    fn grey(&self, voxel: [usize; 3]) -> f32;

    /// The grey values of as many voxels as there is room for, from this one on along x.
    ///
    /// # Panics
    /// If they are not here, or not of one row.
    fn greys(&self, from: [usize; 3], out: &mut [f32]);
}

impl<S: Sample> Greys for Slab<'_, S> {
    fn size(&self) -> [usize; 3] {
        self.size
    }

    fn slices(&self) -> Range<usize> {
        Slab::slices(self)
    }

    fn grey(&self, voxel: [usize; 3]) -> f32 {
        Slab::grey(self, voxel)
    }

    fn greys(&self, [x, y, z]: [usize; 3], out: &mut [f32]) {
        let row = &self.row(y, z)[x..x + out.len()];
        out.iter_mut().zip(row).for_each(|(out, sample)| *out = sample.to_f32());
    }
}

/// Samples of consecutive whole slices of a volume, x fastest. Voxels keep the coordinates that they
/// have in the whole volume, so that a stage computes the same from a slab as from all of it.
#[derive(Debug, Clone, Copy)]
pub struct Slab<'a, S> {
    samples: &'a [S],
    size: [usize; 3],
    slices: [usize; 2],
}

impl<'a, S: Sample> Slab<'a, S> {
    /// All slices of a volume of `size` voxels.
    ///
    /// # Panics
    /// If `samples` are not as many as the volume has voxels.
    #[must_use]
    pub fn whole(samples: &'a [S], size: [usize; 3]) -> Self {
        Self::new(samples, size, 0)
    }

    /// The slices from `first` on that `samples` hold, of a volume of `size` voxels.
    ///
    /// # Panics
    /// If `samples` are no whole slices or reach beyond the volume.
    #[must_use]
    pub fn new(samples: &'a [S], size: [usize; 3], first: usize) -> Self {
        let slice = size[0] * size[1];
        let end = first + samples.len() / slice.max(1);
        assert!(
            samples.len().is_multiple_of(slice.max(1)) && end <= size[2],
            "not whole slices of the volume"
        );
        Self { samples, size, slices: [first, end] }
    }

    /// Voxels per axis of the whole volume.
    #[must_use]
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// The slices that are here.
    #[must_use]
    pub fn slices(&self) -> Range<usize> {
        self.slices[0]..self.slices[1]
    }

    /// The samples of row (y, z).
    ///
    /// # Panics
    /// If slice z is not here.
    #[must_use]
    pub fn row(&self, y: usize, z: usize) -> &'a [S] {
        let start = ((z - self.slices[0]) * self.size[1] + y) * self.size[0];
        &self.samples[start..start + self.size[0]]
    }

    /// The grey value of voxel (x, y, z).
    ///
    /// # Panics
    /// If slice z is not here.
    #[must_use]
    pub fn grey(&self, [x, y, z]: [usize; 3]) -> f32 {
        self.samples[((z - self.slices[0]) * self.size[1] + y) * self.size[0] + x].to_f32()
    }
}
