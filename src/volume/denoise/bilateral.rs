//! The bilateral filter (Tomasi and Manduchi 1998): a mean in which voxels count the less the farther they
//! are and the more their grey value differs.
//!
//! Both weights are Gaussian; that of the difference is a power of a polynomial (within 0.009), which a
//! processor computes for several voxels at a time, where a table would be looked up for each. What is
//! added up are differences to the voxel's own grey value: exact also far from 0.

use super::kernel::{ball, falling, moved, within};
use super::rows::each_row;
use crate::execution::{Cancelled, Execution};
use crate::volume::Slab;

/// Where the Gaussian of the distance is cut off, in standard deviations.
pub(super) const CUT: f64 = 2.5;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Bilateral {
    /// Offsets and weights of distance.
    taps: Vec<([isize; 3], f32)>,
    /// One over twice the variance of the difference.
    steepness: f32,
}

impl Bilateral {
    /// Standard deviations `sigma` in mm and `grey` in grey values.
    pub(super) fn new(sigma: f64, grey: f64, spacing: [f64; 3]) -> Self {
        let weight = |square: f64| (-0.5 * square / (sigma * sigma)).exp() as f32;
        let taps = ball(CUT * sigma, spacing).into_iter().map(|tap| (tap.offset, weight(tap.square)));
        // No division by 0, however small it was given.
        let steepness = ((0.5 / (grey * grey)) as f32).min(f32::MAX);
        Self { taps: taps.collect(), steepness }
    }

    pub(super) fn offsets(&self) -> impl Iterator<Item = [isize; 3]> {
        self.taps.iter().map(|tap| tap.0)
    }

    /// Filters the slices `first` and following into `out`.
    pub(super) fn apply(
        &self,
        slab: Slab<'_, f32>,
        first: usize,
        out: &mut [f32],
        execution: &Execution,
    ) -> Result<(), Cancelled> {
        let (size, arch) = (slab.size(), pulp::Arch::new());
        let room = || [vec![0.0_f32; size[0]], vec![0.0_f32; size[0]]];
        each_row(size, first, out, execution, room, |[sums, weights], [y, z], out| {
            arch.dispatch(|| self.row(slab, y, z, [sums, weights, out]));
        })
    }

    #[inline(always)]
    fn row(&self, slab: Slab<'_, f32>, y: usize, z: usize, [sums, weights, out]: [&mut [f32]; 3]) {
        let [width, height, depth] = slab.size();
        let own = slab.row(y, z);
        sums.fill(0.0);
        weights.fill(0.0);
        for &([dx, dy, dz], near) in &self.taps {
            let (Some(y), Some(z)) = (moved(y, dy, height), moved(z, dz, depth)) else { continue };
            let [places, others] = within(dx, width);
            let others = &slab.row(y, z)[others];
            let (sums, weights) = (&mut sums[places.clone()], &mut weights[places.clone()]);
            for (((sum, weight), own), other) in sums.iter_mut().zip(weights).zip(&own[places]).zip(others) {
                let difference = other - own;
                let like = near * falling(self.steepness * (difference * difference));
                *sum += like * difference;
                *weight += like;
            }
        }
        // The voxel itself counts with weight 1, so no weight is 0.
        for (((out, own), sum), weight) in out.iter_mut().zip(own).zip(sums).zip(weights) {
            *out = own + *sum / *weight;
        }
    }
}
