//! Mean and noise of each material from the voxels deepest inside of it.
//!
//! A voxel whose 26 neighbours are of its own class can still lie within the blur of the next
//! material: with a blur of 1.2 voxels such a layer pulled the mean of a part of 128³ by up to 1 %.
//! A voxel is *deep to d* if in the 26 directions (axes, diagonals of faces and cubes) the voxels
//! 1, 2, ... d steps away are all of its class. Mean and noise are taken over the deepest voxels
//! there are at least [`MIN_VOXELS`] and [`MIN_SHARE`] of, so that a thin material keeps what it has
//! and a few unusual places do not speak for it.

use rayon::prelude::*;

use super::neighbourhood::{DEPTH, Neighbourhood, class_ranges};
use super::sampling::{class_of, thresholds};
use crate::volume::Sample;

/// Fewest voxels to take a mean from; fewer than this, and less deep ones are taken.
const MIN_VOXELS: u64 = 100;
/// Smallest share of the voxels deep to 1.
const MIN_SHARE: f64 = 0.05;

/// Moments of the grey values of some voxels, about the class's rough grey value.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    /// How many.
    pub(super) voxels: u64,
    base: f64,
    sum: f64,
    squares: f64,
}

impl Moments {
    /// Of no voxels yet.
    pub(super) fn about(base: f64) -> Self {
        Self { base, ..Self::default() }
    }

    /// Their mean; `None` without voxels.
    pub(super) fn mean(&self) -> Option<f64> {
        (self.voxels > 0).then(|| self.base + self.sum / self.voxels as f64)
    }

    /// Their standard deviation; `None` for fewer than two.
    pub(super) fn sigma(&self) -> Option<f64> {
        let n = self.voxels as f64;
        (self.voxels > 1).then(|| (self.squares / n - (self.sum / n).powi(2)).max(0.0).sqrt())
    }

    pub(super) fn add(&mut self, grey: f64) {
        let d = grey - self.base;
        self.voxels += 1;
        self.sum += d;
        self.squares += d * d;
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.voxels += other.voxels;
        self.sum += other.sum;
        self.squares += other.squares;
    }
}

/// For each class around `greys` (ascending, thresholds halfway between): the moments of its deepest
/// voxels among `points`.
pub(super) fn deep_statistics<S: Sample>(points: &[Neighbourhood<S>], greys: &[f64]) -> Vec<Moments> {
    let thresholds = thresholds(greys);
    let ranges = class_ranges(&thresholds);
    let fresh =
        || -> Vec<[Moments; DEPTH]> { greys.iter().map(|&base| [Moments::about(base); DEPTH]).collect() };
    // Fixed chunks, summed in order: the same sums for any number of threads.
    let parts: Vec<_> = points
        .par_chunks(1 << 14)
        .map(|chunk| {
            let mut found = fresh();
            for point in chunk {
                let own = class_of(&thresholds, point.grey);
                for moments in &mut found[own][..point.depth(ranges[own])] {
                    moments.add(f64::from(point.grey.to_f32()));
                }
            }
            found
        })
        .collect();
    let mut total = fresh();
    for part in &parts {
        for (t, p) in total.iter_mut().flatten().zip(part.iter().flatten()) {
            t.merge(p);
        }
    }
    total
        .iter()
        .map(|depths| {
            let enough = (MIN_SHARE * depths[0].voxels as f64).max(MIN_VOXELS as f64);
            *depths.iter().rev().find(|m| m.voxels as f64 >= enough).unwrap_or(&depths[0])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Survey;
    use crate::volume::Slab;

    /// A slab of the upper material, `width` voxels thick, with soft sides.
    fn slab(width: f64) -> Vec<Moments> {
        let size = [40, 20, 20];
        let smooth = |d: f64| 0.5 * libm::erfc(-d / (1.2 * std::f64::consts::SQRT_2));
        let samples: Vec<f32> = (0..16_000)
            .map(|i| {
                let x = (i % 40) as f64 - 20.3;
                (100.0 + 900.0 * (smooth(x + 0.5 * width) - smooth(x - 0.5 * width))) as f32
            })
            .collect();
        let survey = Survey::of(Slab::whole(&samples, size), None).unwrap();
        deep_statistics(&survey.points, &[100.0, 1000.0])
    }

    #[test]
    fn blurred_sides_do_not_pull_the_mean() {
        let found = slab(12.0);
        assert!((found[1].mean().unwrap() - 1000.0).abs() < 2.0, "{found:?}");
        assert!((found[0].mean().unwrap() - 100.0).abs() < 2.0, "{found:?}");
        assert!(found[1].sigma().unwrap() < 5.0);
    }

    #[test]
    fn a_thin_material_keeps_the_voxels_it_has() {
        let found = slab(4.0);
        assert!(found[1].voxels > 100 && found[1].mean().unwrap() > 850.0, "{found:?}");
    }
}
