//! Gaussian noise that depends on the seed and the place only, so threads cannot change it.
//!
//! White noise is drawn voxel by voxel. Correlated noise is white noise on a lattice larger by the filter's
//! reach on every side, blurred by a Gaussian and multiplied so that its standard deviation is the wanted one
//! (exactly so in the mean over all seeds; one volume of n voxels has n / (8 pi^1.5 sigma^3) independent values).

use std::f64::consts::TAU;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::Phantom;
use crate::volume::kernel::{Kernel, Window, reduce};

/// The noise of a phantom, slice by slice in ascending order.
pub(super) struct NoiseField {
    sigma: f64,
    seed: u64,
    /// Voxels of the volume along x and y.
    size: [usize; 2],
    correlated: Option<Correlated>,
}

/// The filter of correlated noise and the slices it needs.
struct Correlated {
    kernels: [Kernel; 3],
    window: Window,
    /// Brings the filtered white noise to standard deviation one.
    scale: f64,
}

impl NoiseField {
    pub(super) fn new(phantom: &Phantom) -> Self {
        let size = phantom.geometry().size();
        let sigma = phantom.noise_sigma();
        let reach = phantom.options().noise_correlation;
        let correlated = (reach > 0.0 && sigma > 0.0).then(|| {
            let kernels: [Kernel; 3] = std::array::from_fn(|_| Kernel::new(reach, 1));
            let scale = 1.0 / kernels.iter().map(Kernel::gain).product::<f64>();
            Correlated { kernels, window: Window::default(), scale }
        });
        Self { sigma, seed: phantom.options().seed, size: [size[0], size[1]], correlated }
    }

    /// Makes what the slices before `end` need.
    pub(super) fn fill(&mut self, end: usize) {
        let (seed, size) = (self.seed, self.size);
        let Some(Correlated { kernels, window, .. }) = &mut self.correlated else { return };
        let [width, height] = [0, 1].map(|a| kernels[a].needed(size[a]));
        let kernels = &*kernels;
        window.fill(end, &kernels[2], |k| {
            let white: Vec<f32> = (0..height)
                .flat_map(|y| Normals::of_row(seed, (k * height + y) as u64).take(width))
                .map(|v| v as f32)
                .collect();
            reduce(&white, size, kernels)
        });
    }

    /// Adds the grey value of the background and the noise to slice `z`.
    pub(super) fn add(&self, slice: &mut [f32], z: usize, background: f64) {
        if let Some(Correlated { kernels, window, scale }) = &self.correlated {
            let noise = window.slice(z, &kernels[2], slice.len());
            for (v, noise) in slice.iter_mut().zip(noise) {
                *v = (f64::from(*v) + background + self.sigma * scale * f64::from(noise)) as f32;
            }
            return;
        }
        for (y, row) in slice.chunks_mut(self.size[0]).enumerate() {
            let mut normals = Normals::of_row(self.seed, (z * self.size[1] + y) as u64);
            for v in row {
                let noise = if self.sigma > 0.0 { self.sigma * normals.draw() } else { 0.0 };
                *v = (f64::from(*v) + background + noise) as f32;
            }
        }
    }

    /// Drops what slices from `end` on do not need.
    pub(super) fn drop_before(&mut self, end: usize) {
        if let Some(Correlated { kernels, window, .. }) = &mut self.correlated {
            window.drop_before(end, &kernels[2]);
        }
    }
}

/// Standard normal numbers of one row of voxels. Box and Muller's method with functions from `libm`:
/// the same on every platform.
struct Normals {
    rng: ChaCha8Rng,
    spare: Option<f64>,
}

impl Normals {
    /// The generator of row `row` (counted through the volume).
    fn of_row(seed: u64, row: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(row);
        Self { rng, spare: None }
    }

    /// In (0, 1].
    fn uniform(&mut self) -> f64 {
        ((self.rng.next_u64() >> 11) + 1) as f64 / (1_u64 << 53) as f64
    }

    fn draw(&mut self) -> f64 {
        if let Some(value) = self.spare.take() {
            return value;
        }
        let radius = (-2.0 * libm::log(self.uniform())).sqrt();
        let (sin, cos) = libm::sincos(TAU * self.uniform());
        self.spare = Some(radius * sin);
        radius * cos
    }
}

impl Iterator for Normals {
    type Item = f64;

    fn next(&mut self) -> Option<f64> {
        Some(self.draw())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_have_mean_zero_variance_one_and_rows_differ() {
        let n = 200_000;
        let mut normals = Normals::of_row(1, 7);
        let values: Vec<f64> = (0..n).map(|_| normals.draw()).collect();
        let mean = values.iter().sum::<f64>() / f64::from(n);
        let variance = values.iter().map(|v| v * v).sum::<f64>() / f64::from(n);
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.015, "{mean} {variance}");
        assert!((Normals::of_row(1, 8).draw() - values[0]).abs() > 1e-12);
        assert!((Normals::of_row(2, 7).draw() - values[0]).abs() > 1e-12);
    }
}
