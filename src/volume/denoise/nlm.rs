//! Non-local means (Buades, Coll and Morel 2005): a mean in which voxels count by how alike their
//! surroundings are.
//!
//! For a row and an offset the squared differences of two rows are added up over the rows of the box
//! that is compared, then along x: whole rows at a time, and what is compared stays in the fastest
//! cache, so that tables of sums over the volume would be slower. A box that reaches beyond the volume sees
//! the nearest voxels there.

use rayon::prelude::*;

use super::kernel::{ball, cuboid, falling, moved, within};
use super::rows::each_row;
use crate::execution::{Cancelled, Execution};
use crate::volume::Slab;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct NonLocalMeans {
    offsets: Vec<[isize; 3]>,
    /// Half the edge of the box in voxels.
    patch: [usize; 3],
    /// Voxels along x that rows are continued by.
    margin: usize,
    /// One over the square of the grey parameter and the voxels of a box.
    steepness: f32,
}

/// Rows of numbers to work with.
struct Room {
    squares: Vec<f32>,
    sums: Vec<f32>,
    weights: Vec<f32>,
}

impl NonLocalMeans {
    /// Within `search` mm, by boxes of half edge `patch` mm; `grey` in grey values.
    pub(super) fn new(search: f64, patch: f64, grey: f64, spacing: [f64; 3]) -> Self {
        let offsets: Vec<[isize; 3]> = ball(search, spacing).into_iter().map(|tap| tap.offset).collect();
        let compared = cuboid(patch, spacing);
        let patch = [0, 1, 2].map(|a| compared.iter().map(|t| t.offset[a].unsigned_abs()).max().unwrap_or(0));
        let across = offsets.iter().map(|o| o[0].unsigned_abs()).max().unwrap_or(0);
        let steepness = ((1.0 / (grey * grey * compared.len() as f64)) as f32).min(f32::MAX);
        Self { offsets, patch, margin: across + patch[0], steepness }
    }

    pub(super) fn reach(&self) -> [usize; 3] {
        let farthest = |a: usize| self.offsets.iter().map(|o| o[a].unsigned_abs()).max().unwrap_or(0);
        [0, 1, 2].map(|a| farthest(a) + self.patch[a])
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
        let width = size[0];
        let rows = self.continued(slab);
        let room = || Room {
            squares: vec![0.0; width + 2 * self.patch[0]],
            sums: vec![0.0; width],
            weights: vec![0.0; width],
        };
        each_row(size, first, out, execution, room, |room, at, out| {
            arch.dispatch(|| self.row(slab, &rows, at, room, out));
        })
    }

    /// The rows of the slab, continued by their first and last values.
    fn continued(&self, slab: Slab<'_, f32>) -> Vec<f32> {
        let [width, height, _] = slab.size();
        let (slices, wide) = (slab.slices(), width + 2 * self.margin);
        let mut out = vec![0.0; wide * height * slices.len()];
        out.par_chunks_mut(wide).enumerate().for_each(|(i, out)| {
            let row = slab.row(i % height, slices.start + i / height);
            out[..self.margin].fill(row[0]);
            out[self.margin..][..width].copy_from_slice(row);
            out[self.margin + width..].fill(row[width - 1]);
        });
        out
    }

    #[inline(always)]
    fn row(&self, slab: Slab<'_, f32>, rows: &[f32], [y, z]: [usize; 2], room: &mut Room, out: &mut [f32]) {
        let [width, height, depth] = slab.size();
        let Room { squares, sums, weights } = room;
        let wide = width + 2 * self.margin;
        // The row nearest to one that may lie beyond the volume.
        let nearest = |y: usize, dy: isize, z: usize, dz: isize| {
            let y = y.saturating_add_signed(dy).min(height - 1);
            let z = z.saturating_add_signed(dz).min(depth - 1) - slab.slices().start;
            &rows[(z * height + y) * wide..][..wide]
        };
        let [px, py, pz] = self.patch.map(|n| n as isize);
        let own = slab.row(y, z);
        sums.fill(0.0);
        weights.fill(0.0);
        for &[dx, dy, dz] in &self.offsets {
            let (Some(there_y), Some(there_z)) = (moved(y, dy, height), moved(z, dz, depth)) else {
                continue;
            };
            squares.fill(0.0);
            let from = self.margin - self.patch[0];
            for (by, bz) in (-pz..=pz).flat_map(|bz| (-py..=py).map(move |by| (by, bz))) {
                let here = &nearest(y, by, z, bz)[from..][..squares.len()];
                // The margin is as wide as the farthest offset and half a box.
                let there =
                    &nearest(there_y, by, there_z, bz)[from.saturating_add_signed(dx)..][..squares.len()];
                for ((square, a), b) in squares.iter_mut().zip(here).zip(there) {
                    *square += (a - b) * (a - b);
                }
            }
            let [places, others] = within(dx, width);
            let others = &slab.row(there_y, there_z)[others];
            let (sums, weights) = (&mut sums[places.clone()], &mut weights[places.clone()]);
            // A box around place x is the squares from x on.
            let (own, squares) =
                (&own[places.clone()], &squares[places.start..places.end + 2 * self.patch[0]]);
            match px {
                1 => {
                    let three = squares.iter().zip(&squares[1..]).zip(&squares[2..]);
                    let sum = three.map(|((a, b), c)| a + b + c);
                    self.add(sum, own, others, sums, weights);
                }
                _ => {
                    let sum = squares.windows(2 * self.patch[0] + 1).map(|w| w.iter().sum());
                    self.add(sum, own, others, sums, weights);
                }
            }
        }
        for (((out, own), sum), weight) in out.iter_mut().zip(own).zip(sums).zip(weights) {
            *out = own + *sum / *weight;
        }
    }

    #[inline(always)]
    fn add(
        &self,
        squares: impl Iterator<Item = f32>,
        own: &[f32],
        others: &[f32],
        sums: &mut [f32],
        weights: &mut [f32],
    ) {
        let places = sums.iter_mut().zip(weights).zip(own).zip(others);
        for ((((sum, weight), own), other), square) in places.zip(squares) {
            let like = falling(self.steepness * square);
            *sum += like * (other - own);
            *weight += like;
        }
    }
}
