//! The voxels of a window in batches, in single precision, and their normal equations: loops of fixed length that
//! compilers turn into SIMD instructions.
//!
//! Sums are made in eight lanes whatever the machine's width, so every machine gets the same bits.

use super::least_squares::{Moving, Normal};
use super::sheet::{Reading, Sample};

/// Voxels of a batch.
pub(super) const BATCH: usize = 32;
/// Lanes of a sum.
const LANES: usize = 8;

/// One number of each voxel of a batch.
pub(super) type Row = [f32; BATCH];

/// Voxels, padded to whole batches with such as count nothing.
#[derive(Debug, Default)]
pub(super) struct Batches {
    batches: Vec<Batch>,
    voxels: usize,
}

/// Voxels of a batch.
#[derive(Debug, Clone)]
pub(super) struct Batch {
    /// Places, blur units from the window's middle, by axis.
    pub at: [Row; 3],
    /// Grey values.
    pub grey: Row,
    /// 1, or 0 for padding.
    pub counts: Row,
}

impl Batches {
    /// Of these voxels.
    pub(super) fn new(samples: &[Sample]) -> Self {
        let batches = samples.chunks(BATCH).map(|chunk| {
            // Padding repeats a voxel: nothing unusual is computed there.
            let of = |i: usize| chunk.get(i).unwrap_or(&chunk[0]);
            Batch {
                at: std::array::from_fn(|a| std::array::from_fn(|i| of(i).at[a] as f32)),
                grey: std::array::from_fn(|i| of(i).grey as f32),
                counts: std::array::from_fn(|i| if i < chunk.len() { 1.0 } else { 0.0 }),
            }
        });
        Self { batches: batches.collect(), voxels: samples.len() }
    }

    /// How many voxels there are, without padding.
    pub(super) fn voxels(&self) -> usize {
        self.voxels
    }

    /// The batches.
    pub(super) fn all(&self) -> &[Batch] {
        &self.batches
    }

    /// The first batch.
    #[cfg(test)]
    pub(super) fn first(&self) -> &Batch {
        &self.batches[0]
    }
}

impl Batch {
    /// What predictions of the grey values are off by in standard deviations, and what a unit of grey value
    /// counts: nothing in padding and where the truth may be beyond the end of the scale as predicted.
    #[inline(always)]
    pub(super) fn residuals(&self, reading: &Reading, predicted: &Row) -> [Row; 2] {
        let (weight, [low, high]) = ((1.0 / reading.noise) as f32, reading.clip.map(|c| c as f32));
        let mut out = [[0.0; BATCH]; 2];
        for i in 0..BATCH {
            let off = predicted[i] - self.grey[i];
            let beyond = (self.grey[i] >= high && off > 0.0) || (self.grey[i] <= low && off < 0.0);
            let weight = if beyond { 0.0 } else { self.counts[i] * weight };
            out[1][i] = weight;
            out[0][i] = off * weight;
        }
        out
    }
}

/// A model, as far as it is evaluated for batches of voxels.
pub(super) trait Rows<const N: usize> {
    /// Adds a batch's rows of the Jacobian and residuals; to be inlined, or it does not get the machine's best instructions.
    fn add(&self, batch: &Batch, reading: &Reading, sums: &mut Sums<N>);
}

/// Adds all batches to the normal equations, with the best instructions that this machine has; returns the sum of squared
/// residuals.
pub(super) fn assemble<const N: usize>(
    model: &impl Rows<N>,
    batches: &Batches,
    reading: &Reading,
    equations: &mut Normal<N>,
) -> f64 {
    struct Assemble<'a, M, const N: usize> {
        model: &'a M,
        batches: &'a Batches,
        reading: &'a Reading,
        sums: Sums<N>,
    }
    impl<M: Rows<N>, const N: usize> pulp::NullaryFnOnce for Assemble<'_, M, N> {
        type Output = Sums<N>;

        #[inline(always)]
        fn call(mut self) -> Sums<N> {
            for batch in &self.batches.batches {
                self.model.add(batch, self.reading, &mut self.sums);
            }
            self.sums
        }
    }
    let sums = Sums::new(&equations.active);
    let sums = pulp::Arch::new().dispatch(Assemble { model, batches, reading, sums });
    sums.finish(equations)
}

/// Sums of products of rows, in lanes.
pub(super) struct Sums<const N: usize> {
    moving: Moving<N>,
    matrix: [[[f32; LANES]; N]; N],
    right: [[f32; LANES]; N],
    chi2: [f32; LANES],
}

impl<const N: usize> Sums<N> {
    /// Of the parameters that move.
    fn new(active: &[bool; N]) -> Self {
        let (matrix, right) = ([[[0.0; LANES]; N]; N], [[0.0; LANES]; N]);
        Self { moving: Moving::new(active), matrix, right, chi2: [0.0; LANES] }
    }

    /// Adds a batch: its rows of the Jacobian, and its residuals.
    #[inline(always)]
    pub(super) fn add(&mut self, rows: &[Row; N], residuals: &Row) {
        let Self { moving, matrix, right, .. } = self;
        for (n, &i) in moving.all().iter().enumerate() {
            for &j in &moving.all()[..=n] {
                multiply(&rows[i], &rows[j], &mut matrix[i][j]);
            }
            multiply(&rows[i], residuals, &mut right[i]);
        }
        multiply(residuals, residuals, &mut self.chi2);
    }

    /// Adds the sums to the normal equations; returns that of squared residuals.
    fn finish(&self, equations: &mut Normal<N>) -> f64 {
        let sum = |lanes: &[f32; LANES]| lanes.iter().map(|v| f64::from(*v)).sum::<f64>();
        for (n, &i) in self.moving.all().iter().enumerate() {
            for &j in &self.moving.all()[..=n] {
                equations.matrix[(i, j)] += sum(&self.matrix[i][j]);
            }
            equations.right[i] += sum(&self.right[i]);
        }
        sum(&self.chi2)
    }
}

/// Adds products to the lanes of a sum.
#[inline(always)]
pub(super) fn multiply(a: &Row, b: &Row, sum: &mut [f32; LANES]) {
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for lane in 0..LANES {
            sum[lane] += a[lane] * b[lane];
        }
    }
}

/// Scalar product.
#[inline(always)]
pub(super) fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::locate::fixtures::{reading, window};

    /// A line in x: grey = b + a x.
    struct Line([f32; 2]);

    impl Rows<2> for Line {
        fn add(&self, batch: &Batch, reading: &Reading, sums: &mut Sums<2>) {
            let predicted = batch.at[0].map(|x| self.0[0] + self.0[1] * x);
            let [residuals, weights] = batch.residuals(reading, &predicted);
            let mut rows = [weights; 2];
            for i in 0..BATCH {
                rows[1][i] *= batch.at[0][i];
            }
            sums.add(&rows, &residuals);
        }
    }

    #[test]
    fn sums_are_those_of_all_voxels_but_padding() {
        let samples = window(2.7, |p| p.y);
        assert!(samples.len() % BATCH > 0);
        let mut e = Normal::new(&[true; 2]);
        let chi2 = assemble(&Line([0.5, -0.3]), &Batches::new(&samples), &reading(0.5), &mut e);
        let (mut matrix, mut right, mut expected) = ([0.0; 3], [0.0; 2], 0.0);
        for s in &samples {
            let (row, r) = ([2.0, 2.0 * s.at.x], 2.0 * (0.5 - 0.3 * s.at.x - s.grey));
            matrix = [matrix[0] + row[0] * row[0], matrix[1] + row[0] * row[1], matrix[2] + row[1] * row[1]];
            right = [right[0] + row[0] * r, right[1] + row[1] * r];
            expected += r * r;
        }
        let pairs =
            [(e.matrix[(0, 0)], matrix[0]), (e.matrix[(1, 0)], matrix[1]), (e.matrix[(1, 1)], matrix[2])];
        for (found, expected) in
            pairs.into_iter().chain([(e.right[0], right[0]), (e.right[1], right[1]), (chi2, expected)])
        {
            assert!((found - expected).abs() < 1e-5 * expected.abs().max(100.0), "{found} {expected}");
        }
    }

    #[test]
    fn clipped_grey_values_tell_that_the_truth_is_beyond_and_no_more() {
        let sample = |grey: f64| Sample { at: glam::DVec3::ZERO, grey };
        let clipped = Reading { noise: 1.0, white: 1.0, clip: [0.0, 255.0], slack: 1.0 };
        let chi2 = |level: f32, grey: f64| {
            let mut e = Normal::new(&[true; 2]);
            assemble(&Line([level, 0.0]), &Batches::new(&[sample(grey)]), &clipped, &mut e)
        };
        let none = |v: f64| v.abs() < 1e-6;
        assert!(none(chi2(300.0, 255.0)) && none(chi2(-3.0, 0.0)));
        assert!((chi2(250.0, 255.0) - 25.0).abs() < 1e-3 && (chi2(3.0, 0.0) - 9.0).abs() < 1e-3);
        assert!((chi2(300.0, 254.0) - 46.0 * 46.0).abs() < 1e-2);
    }
}
