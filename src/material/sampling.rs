//! Which voxels are looked at where looking at all would cost more than it tells.

use std::ops::Range;

use crate::volume::Sample;

/// Points of a [`SampleGrid`] at most.
pub(super) const POINTS: usize = 4_000_000;

/// Interior voxels (those with a full 3 x 3 x 3 neighbourhood) on a regular grid of at most a given
/// number of points: it follows from the size alone. Empty if an axis has fewer than 3 voxels.
#[derive(Debug, Clone, Copy)]
pub(super) struct SampleGrid {
    /// Voxels from point to point.
    pub(super) stride: usize,
    /// Points per axis.
    pub(super) points: [usize; 3],
}

impl SampleGrid {
    /// The grid of a volume of `size` voxels.
    pub(super) fn new(size: [usize; 3], wanted: usize) -> Self {
        if size.iter().any(|&n| n < 3) {
            return Self { stride: 1, points: [0; 3] };
        }
        let points = |stride: usize| size.map(|n| (n - 2).div_ceil(stride));
        let longest = size.into_iter().max().unwrap_or(1);
        let few = |stride: &usize| points(*stride).iter().product::<usize>() <= wanted;
        let stride = (1..longest).find(few).unwrap_or(longest);
        Self { stride, points: points(stride) }
    }

    /// All points.
    pub(super) fn len(&self) -> usize {
        self.points.iter().product()
    }

    /// The coordinate of point i along an axis.
    pub(super) fn at(&self, i: usize) -> usize {
        1 + i * self.stride
    }

    /// The points along z that lie in the slices `core`.
    pub(super) fn within(&self, core: Range<usize>) -> Range<usize> {
        let first = |z: usize| z.saturating_sub(1).div_ceil(self.stride).min(self.points[2]);
        first(core.start)..first(core.end)
    }
}

/// Thresholds halfway between ascending grey values.
pub(super) fn thresholds(greys: &[f64]) -> Vec<f32> {
    greys.windows(2).map(|w| (0.5 * (w[0] + w[1])) as f32).collect()
}

/// The class of a grey value: how many thresholds it reaches.
pub(super) fn class_of<S: Sample>(thresholds: &[f32], value: S) -> usize {
    let value = value.to_f32();
    thresholds.iter().filter(|&&t| value >= t).count()
}

/// Runs of slices of a volume of `size` voxels, each of a few million voxels.
pub(super) fn steps(size: [usize; 3]) -> impl Iterator<Item = Range<usize>> {
    let thickness = (1_usize << 22).div_ceil(size[0] * size[1]);
    (0..size[2]).step_by(thickness).map(move |z| z..(z + thickness).min(size[2]))
}
