//! Filters that are one filter along each axis: mean and Gaussian.
//!
//! Weights add up to 1 along each axis; at the volume's border those that are left are scaled up, which
//! is the same as scaling the three-dimensional kernel, as the part of it inside is a box.

use rayon::prelude::*;

use super::kernel::{moved, within};
use crate::execution::{Cancelled, Execution};
use crate::volume::Slab;

/// Symmetric weights per axis: those of the voxel itself, its neighbours, and so on.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Separable {
    weights: [Vec<f32>; 3],
}

impl Separable {
    /// From the weight of each number of voxels along each axis; `weights[axis][0]` is that of the voxel.
    pub(super) fn new(weights: [Vec<f64>; 3]) -> Self {
        Self { weights: weights.map(|axis| axis.into_iter().map(|w| w as f32).collect()) }
    }

    pub(super) fn reach(&self) -> [usize; 3] {
        [0, 1, 2].map(|axis| self.weights[axis].len() - 1)
    }

    /// Filters the slices `first` and following into `out`.
    pub(super) fn apply(
        &self,
        slab: Slab<'_, f32>,
        first: usize,
        out: &mut [f32],
        execution: &Execution,
    ) -> Result<(), Cancelled> {
        let [width, height, depth] = slab.size();
        let [along_x, along_y, along_z] = self.weights.each_ref().map(|w| w.as_slice());
        let shares = shares(along_x, width);
        out.par_chunks_mut(width * height).enumerate().try_for_each(|(i, out)| {
            execution.check()?;
            let mut across = vec![0.0; width * height];
            for (y, row) in across.chunks_mut(width).enumerate() {
                line(along_z, first + i, depth, row, |z| slab.row(y, z));
            }
            let mut row = vec![0.0; width];
            for (y, out) in out.chunks_mut(width).enumerate() {
                row.fill(0.0);
                line(along_y, y, height, &mut row, |y| &across[y * width..][..width]);
                along_row(along_x, &shares, &row, out);
            }
            Ok(())
        })
    }
}

/// Adds up whole rows: the filter along y or z at place `at` of `n`. `out` must be 0.
fn line<'a>(weights: &[f32], at: usize, n: usize, out: &mut [f32], row: impl Fn(usize) -> &'a [f32]) {
    let reach = weights.len() as isize - 1;
    let places = || (-reach..=reach).filter_map(|by| Some((moved(at, by, n)?, weights[by.unsigned_abs()])));
    let share: f32 = places().map(|(_, weight)| weight).sum();
    for (place, weight) in places() {
        let weight = weight / share;
        out.iter_mut().zip(row(place)).for_each(|(out, v)| *out += weight * v);
    }
}

/// Of the weights, how much lies in a row of `n` voxels, for each of them.
fn shares(weights: &[f32], n: usize) -> Vec<f32> {
    let reach = weights.len() as isize - 1;
    let inside = |x: usize| (-reach..=reach).filter(move |by| moved(x, *by, n).is_some());
    (0..n).map(|x| inside(x).map(|by| weights[by.unsigned_abs()]).sum()).collect()
}

fn along_row(weights: &[f32], shares: &[f32], row: &[f32], out: &mut [f32]) {
    let reach = weights.len() as isize - 1;
    out.fill(0.0);
    for by in -reach..=reach {
        let weight = weights[by.unsigned_abs()];
        let [places, others] = within(by, row.len());
        out[places].iter_mut().zip(&row[others]).for_each(|(out, v)| *out += weight * v);
    }
    out.iter_mut().zip(shares).for_each(|(out, share)| *out /= share);
}
