//! Second and third pass: certain voxels, and voxels between two materials (Fujimori and Suzuki
//! §3.1), as Boolean algebra on bit planes.
//!
//! - *Core*: a voxel of class alpha_i whose whole ball of radius R is alpha_i gets b_i.
//! - *Pair*: over the ball of radius 2R around any other voxel, if exactly two b classes k1 < k2
//!   occur and every alpha class j there has k1 <= j <= k2, it gets k1 if v < t_k1k2, else k2.
//! - What is left is *junction*.
//!
//! Halo: the core pass reads R, the pair pass 2R further. Voxels beyond the volume do not count.

use std::ops::Range;

use super::alpha::at_least_word;
use super::ball::{Ball, Dilation};
use super::bit_planes::BitPlanes;
use crate::grid::MaterialId;
use crate::material::MaterialTable;
use crate::volume::{Sample, Slab};

/// The core voxels of each material in the padded slices `slices`: `alpha_i` eroded by the ball of
/// radius R. `alpha` must reach the ball further, or to the volume's end.
#[must_use]
pub fn core(alpha: &BitPlanes, ball: &Ball, slices: Range<usize>) -> BitPlanes {
    let (size, n, words) = (alpha.size(), alpha.count(), alpha.words());
    let near = Dilation::new(alpha, ball);
    let mut core = BitPlanes::window(size, n, slices);
    core.fill_slices(|z, mut slice| {
        let mut seen = vec![0; words];
        let mut scratch = vec![0; words];
        // Classes seen at all, and classes seen at least twice, in the ball.
        let mut one = vec![0; words];
        let mut two = vec![0; words];
        for y in 1..=size[1] {
            one.fill(0);
            two.fill(0);
            for i in 0..n {
                if near.row(i, y, z, &mut seen, &mut scratch) {
                    for ((one, two), seen) in one.iter_mut().zip(&mut two).zip(&seen) {
                        *two |= *one & seen;
                        *one |= seen;
                    }
                }
            }
            for i in 0..n {
                let own = alpha.row(i, y, z);
                for ((out, own), two) in slice.row(i, y).iter_mut().zip(own).zip(&two) {
                    *out = own & !two;
                }
            }
        }
    });
    core
}

/// The core voxels and those of the pair pass in the padded slices `slices`; what is in no plane is
/// junction. `ball` has radius 2R; `core` and `alpha` must reach it further, or to the volume's end.
#[must_use]
pub fn pair<S: Sample>(
    slab: Slab<'_, S>,
    core: &BitPlanes,
    alpha: &BitPlanes,
    ball: &Ball,
    materials: &MaterialTable,
    slices: Range<usize>,
) -> BitPlanes {
    let (size, n, words) = (alpha.size(), alpha.count(), alpha.words());
    let (near_b, near_alpha) = (Dilation::new(core, ball), Dilation::new(alpha, ball));
    let threshold = |i: usize, j: usize| materials.threshold(MaterialId(i as u8), MaterialId(j as u8)) as f32;
    let masks: Vec<u64> = (0..words).map(|w| alpha.voxel_mask(w)).collect();
    let mut b = BitPlanes::window(size, n, slices);
    b.fill_slices(|z, mut slice| {
        let mut seen_b = vec![0u64; n * words];
        let mut seen_alpha = vec![0u64; n * words];
        let mut scratch = vec![0u64; words];
        let mut open = vec![0u64; words];
        for y in 1..=size[1] {
            open.copy_from_slice(&masks);
            for i in 0..n {
                let certain = core.row(i, y, z);
                slice.row(i, y).copy_from_slice(certain);
                open.iter_mut().zip(certain).for_each(|(open, certain)| *open &= !certain);
            }
            if open.iter().all(|&w| w == 0) {
                continue;
            }
            for (i, (b, alpha)) in seen_b.chunks_mut(words).zip(seen_alpha.chunks_mut(words)).enumerate() {
                near_b.row(i, y, z, b, &mut scratch);
                near_alpha.row(i, y, z, alpha, &mut scratch);
            }
            let row = slab.row(y - 1, z - 1);
            for (w, &open) in open.iter().enumerate().filter(|(_, open)| **open != 0) {
                let seen_b = |i: usize| seen_b[i * words + w];
                let seen_alpha = |i: usize| seen_alpha[i * words + w];
                let (mut one, mut two, mut three) = (0, 0, 0);
                for i in 0..n {
                    three |= two & seen_b(i);
                    two |= one & seen_b(i);
                    one |= seen_b(i);
                }
                let exactly_two = open & two & !three;
                let mut lower = 0; // alpha classes below k1
                for k1 in 0..n - 1 {
                    let with_first = exactly_two & seen_b(k1) & !lower;
                    lower |= seen_alpha(k1);
                    if with_first == 0 {
                        continue;
                    }
                    let mut higher = 0; // alpha classes above k2
                    for k2 in (k1 + 1..n).rev() {
                        let here = with_first & seen_b(k2) & !higher;
                        higher |= seen_alpha(k2);
                        if here != 0 {
                            let above = at_least_word(row, w, threshold(k1, k2));
                            slice.row(k1, y)[w] |= here & !above;
                            slice.row(k2, y)[w] |= here & above;
                        }
                    }
                }
            }
        }
    });
    b
}

/// The voxels that are in none of the planes `b`.
#[must_use]
pub fn junction(b: &BitPlanes) -> BitPlanes {
    let size = b.size();
    let mut out = BitPlanes::window(size, 1, b.slices());
    out.fill_slices(|z, mut slice| {
        for y in 1..=size[1] {
            for w in 0..b.words() {
                let any = (0..b.count()).fold(0, |any, i| any | b.row(i, y, z)[w]);
                slice.row(0, y)[w] = b.voxel_mask(w) & !any;
            }
        }
    });
    out
}
