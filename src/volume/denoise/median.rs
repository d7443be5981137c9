//! The median of a ball.
//!
//! Where the whole ball is inside the volume, a sorting network puts many places' values in order at a
//! time: comparisons do not depend on what is compared, so a processor does several at once. Only what
//! the middle needs is kept of Batcher's merge sort. At the border there are fewer values, an even
//! number perhaps; then the mean of the two in the middle counts.

use super::kernel::{ball, moved};
use super::rows::each_row;
use crate::execution::{Cancelled, Execution};
use crate::volume::Slab;

/// Places sorted at a time: two to four of a processor's wide registers.
const LANES: usize = 16;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Median {
    offsets: Vec<[isize; 3]>,
    reach: [usize; 3],
    /// Pairs to be put in order, the smaller first.
    network: Vec<[u32; 2]>,
}

impl Median {
    /// Of the voxels within `radius` mm.
    pub(super) fn new(radius: f64, spacing: [f64; 3]) -> Self {
        let offsets: Vec<[isize; 3]> = ball(radius, spacing).into_iter().map(|tap| tap.offset).collect();
        let reach = [0, 1, 2].map(|a| offsets.iter().map(|o| o[a].unsigned_abs()).max().unwrap_or(0));
        let network = median_network(offsets.len());
        Self { offsets, reach, network }
    }

    pub(super) fn offsets(&self) -> impl Iterator<Item = [isize; 3]> {
        self.offsets.iter().copied()
    }

    /// Filters the slices `first` and following into `out`.
    pub(super) fn apply(
        &self,
        slab: Slab<'_, f32>,
        first: usize,
        out: &mut [f32],
        execution: &Execution,
    ) -> Result<(), Cancelled> {
        let size @ [width, height, depth] = slab.size();
        let [rx, ry, rz] = self.reach;
        let arch = pulp::Arch::new();
        let room = || (vec![[0.0_f32; LANES]; self.offsets.len()], Vec::with_capacity(self.offsets.len()));
        each_row(size, first, out, execution, room, |(block, values), [y, z], out| {
            let inside = y >= ry && y + ry < height && z >= rz && z + rz < depth;
            let interior = if inside { rx..width.saturating_sub(rx) } else { 0..0 };
            let mut x = 0;
            while x < width {
                if x >= interior.start && x + LANES <= interior.end {
                    arch.dispatch(|| self.many([x, y, z], slab, block));
                    out[x..x + LANES].copy_from_slice(&block[self.offsets.len() / 2]);
                    x += LANES;
                } else {
                    out[x] = self.one([x, y, z], slab, values);
                    x += 1;
                }
            }
        })
    }

    /// Sorts the surroundings of the voxels from x on so far that their medians are in the middle.
    #[inline(always)]
    fn many(&self, [x, y, z]: [usize; 3], slab: Slab<'_, f32>, block: &mut [[f32; LANES]]) {
        for (values, [dx, dy, dz]) in block.iter_mut().zip(&self.offsets) {
            let row = slab.row(y.saturating_add_signed(*dy), z.saturating_add_signed(*dz));
            values.copy_from_slice(&row[x.saturating_add_signed(*dx)..][..LANES]);
        }
        for [low, high] in &self.network {
            let (a, b) = (block[*low as usize], block[*high as usize]);
            for lane in 0..LANES {
                block[*low as usize][lane] = if b[lane] < a[lane] { b[lane] } else { a[lane] };
                block[*high as usize][lane] = if b[lane] < a[lane] { a[lane] } else { b[lane] };
            }
        }
    }

    fn one(&self, [x, y, z]: [usize; 3], slab: Slab<'_, f32>, values: &mut Vec<f32>) -> f32 {
        let [width, height, depth] = slab.size();
        values.clear();
        values.extend(self.offsets.iter().filter_map(|[dx, dy, dz]| {
            let (x, y) = (moved(x, *dx, width)?, moved(y, *dy, height)?);
            Some(slab.row(y, moved(z, *dz, depth)?)[x])
        }));
        let half = values.len() / 2;
        let even = values.len().is_multiple_of(2);
        let (below, middle, _) = values.select_nth_unstable_by(half, f32::total_cmp);
        if !even {
            return *middle;
        }
        let lower = below.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        0.5 * lower + 0.5 * *middle
    }
}

/// Batcher's odd-even merge sort of `n` values, without what does not matter for the middle one.
fn median_network(n: usize) -> Vec<[u32; 2]> {
    let mut pairs = Vec::new();
    let mut p = 1;
    while p < n {
        let mut k = p;
        while k >= 1 {
            for j in (k % p..n.saturating_sub(k)).step_by(2 * k) {
                for i in j..(j + k).min(n - k) {
                    if i / (2 * p) == (i + k) / (2 * p) {
                        pairs.push([i as u32, (i + k) as u32]);
                    }
                }
            }
            k /= 2;
        }
        p *= 2;
    }
    let mut matters = vec![false; n];
    matters[n / 2] = true;
    let mut kept: Vec<[u32; 2]> = pairs
        .into_iter()
        .rev()
        .filter(|pair| {
            let needed = pair.iter().any(|i| matters[*i as usize]);
            pair.iter().for_each(|i| matters[*i as usize] |= needed);
            needed
        })
        .collect();
    kept.reverse();
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_network_finds_the_median_of_all_zeros_and_ones() {
        // Enough for all values: the 0-1 principle holds for each comparison network.
        for n in [1, 3, 5, 7, 9, 13, 15] {
            let network = median_network(n);
            for bits in 0..1_u32 << n {
                let mut values: Vec<u32> = (0..n).map(|i| bits >> i & 1).collect();
                for [low, high] in network.iter().map(|pair| pair.map(|i| i as usize)) {
                    if values[high] < values[low] {
                        values.swap(low, high);
                    }
                }
                assert_eq!(values[n / 2] == 1, bits.count_ones() as usize > n / 2, "{n} {bits:b}");
            }
        }
    }
}
