//! A Gaussian and the average over coarser voxels as one separable kernel, applied slice by slice: what a scan makes
//! of an object sampled on a fine grid.

use std::collections::VecDeque;

use rayon::prelude::*;

/// Where the Gaussian is cut off, in sigma.
const CUTOFF: f64 = 4.5;

/// Gaussian and box as one kernel: voxel i is the sum of `weights[k] * fine[factor * i + k]`, where the fine
/// grid starts `reach` fine voxels before the first voxel.
pub(crate) struct Kernel {
    weights: Vec<f32>,
    pub(crate) reach: usize,
    factor: usize,
}

impl Kernel {
    /// `sigma` in fine voxels, `factor` fine voxels along a voxel.
    pub(crate) fn new(sigma: f64, factor: usize) -> Self {
        let reach = (CUTOFF * sigma).ceil() as usize;
        let gauss: Vec<f64> = (0..=2 * reach)
            .map(|k| {
                let d = k as f64 - reach as f64;
                if sigma > 0.0 { libm::exp(-0.5 * d * d / (sigma * sigma)) } else { 1.0 }
            })
            .collect();
        let total: f64 = gauss.iter().sum::<f64>() * factor as f64;
        let weights = (0..gauss.len() + factor - 1)
            .map(|k| {
                let sum: f64 = (0..factor).filter_map(|b| gauss.get(k.checked_sub(b)?)).sum();
                (sum / total) as f32
            })
            .collect();
        Self { weights, reach, factor }
    }

    /// Fine voxels needed for `n` voxels.
    pub(crate) fn needed(&self, n: usize) -> usize {
        self.factor * n + 2 * self.reach
    }

    /// By what the standard deviation of white noise shrinks along this axis.
    pub(crate) fn gain(&self) -> f64 {
        self.weights.iter().map(|w| f64::from(*w) * f64::from(*w)).sum::<f64>().sqrt()
    }
}

/// A fine slice, `needed` voxels wide and high, reduced in x and y to `size`.
pub(crate) fn reduce(fine: &[f32], size: [usize; 2], kernels: &[Kernel; 3]) -> Vec<f32> {
    let (width, height) = (kernels[0].needed(size[0]), kernels[1].needed(size[1]));
    let mut rows = vec![0.0_f32; size[0] * height];
    let k = &kernels[0];
    for (row, values) in rows.chunks_mut(size[0]).zip(fine.chunks(width)) {
        // Rows of nothing but background are common and need no work.
        if values.iter().all(|v| *v == 0.0) {
            continue;
        }
        for (i, v) in row.iter_mut().enumerate() {
            let start = k.factor * i;
            *v = dot(&values[start..start + k.weights.len()], &k.weights);
        }
    }
    let mut out = vec![0.0_f32; size[0] * size[1]];
    let k = &kernels[1];
    for (j, row) in out.chunks_mut(size[0]).enumerate() {
        for (i, weight) in k.weights.iter().enumerate() {
            let at = (k.factor * j + i) * size[0];
            add_scaled(row, &rows[at..at + size[0]], *weight);
        }
    }
    out
}

/// Reduced slices of the fine grid, kept only while slices of the volume still need them.
#[derive(Default)]
pub(crate) struct Window {
    slices: VecDeque<Vec<f32>>,
    /// Index of the first one in the fine grid.
    first: usize,
}

impl Window {
    /// Makes what slices before `end` of the volume need, by `make(index)` of the fine slice.
    pub(crate) fn fill(
        &mut self,
        end: usize,
        kernel: &Kernel,
        make: impl Fn(usize) -> Vec<f32> + Sync + Send,
    ) {
        let next = self.first + self.slices.len();
        let new: Vec<Vec<f32>> = (next..kernel.needed(end)).into_par_iter().map(make).collect();
        self.slices.extend(new);
    }

    /// Slice `z` of the volume, of `plane` voxels.
    pub(crate) fn slice(&self, z: usize, kernel: &Kernel, plane: usize) -> Vec<f32> {
        let mut out = vec![0.0_f32; plane];
        for (k, weight) in kernel.weights.iter().enumerate() {
            add_scaled(&mut out, &self.slices[kernel.factor * z + k - self.first], *weight);
        }
        out
    }

    /// Drops what slices from `end` on do not need.
    pub(crate) fn drop_before(&mut self, end: usize, kernel: &Kernel) {
        let drop = (kernel.factor * end - self.first).min(self.slices.len());
        self.slices.drain(..drop);
        self.first += drop;
    }
}

fn add_scaled(out: &mut [f32], values: &[f32], weight: f32) {
    for (o, v) in out.iter_mut().zip(values) {
        *o += weight * v;
    }
}

/// Scalar product with eight partial sums, in a fixed order.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0_f32; 8];
    let (a8, a1) = a.as_chunks::<8>();
    let (b8, b1) = b.as_chunks::<8>();
    for (x, y) in a8.iter().zip(b8) {
        for k in 0..8 {
            sums[k] += x[k] * y[k];
        }
    }
    for (k, (x, y)) in a1.iter().zip(b1).enumerate() {
        sums[k] += x * y;
    }
    ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7]))
}
