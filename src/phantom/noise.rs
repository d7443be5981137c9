//! White Gaussian noise that depends on the seed and the row only, so threads cannot change it.

use std::f64::consts::TAU;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Standard normal numbers of one row of voxels. Box and Muller's method with functions from `libm`:
/// the same on every platform.
pub(super) struct Normals {
    rng: ChaCha8Rng,
    spare: Option<f64>,
}

impl Normals {
    /// The generator of row `row` (counted through the volume).
    pub(super) fn of_row(seed: u64, row: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(row);
        Self { rng, spare: None }
    }

    /// In (0, 1].
    fn uniform(&mut self) -> f64 {
        ((self.rng.next_u64() >> 11) + 1) as f64 / (1_u64 << 53) as f64
    }

    pub(super) fn next(&mut self) -> f64 {
        if let Some(value) = self.spare.take() {
            return value;
        }
        let radius = (-2.0 * libm::log(self.uniform())).sqrt();
        let (sin, cos) = libm::sincos(TAU * self.uniform());
        self.spare = Some(radius * sin);
        radius * cos
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_have_mean_zero_variance_one_and_rows_differ() {
        let n = 200_000;
        let mut normals = Normals::of_row(1, 7);
        let values: Vec<f64> = (0..n).map(|_| normals.next()).collect();
        let mean = values.iter().sum::<f64>() / f64::from(n);
        let variance = values.iter().map(|v| v * v).sum::<f64>() / f64::from(n);
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.015, "{mean} {variance}");
        assert!((Normals::of_row(1, 8).next() - values[0]).abs() > 1e-12);
        assert!((Normals::of_row(2, 7).next() - values[0]).abs() > 1e-12);
    }
}
