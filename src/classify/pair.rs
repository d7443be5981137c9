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
    let arch = pulp::Arch::new();
    core.fill_slices(|z, mut slice| {
        let all = vec![u64::MAX; words];
        let mut seen = vec![0; words];
        // Classes seen at all, and classes seen at least twice, in the ball.
        let mut one = vec![0; words];
        let mut two = vec![0; words];
        arch.dispatch(
            #[inline(always)]
            || {
                for y in 1..=size[1] {
                    one.fill(0);
                    two.fill(0);
                    for i in 0..n {
                        near.row(i, y, z, &all, &mut seen);
                        for ((one, two), seen) in one.iter_mut().zip(&mut two).zip(&seen) {
                            *two |= *one & seen;
                            *one |= seen;
                        }
                    }
                    for i in 0..n {
                        let own = alpha.row(i, y, z);
                        for ((out, own), two) in slice.row(i, y).iter_mut().zip(own).zip(&two) {
                            *out = own & !two;
                        }
                    }
                }
            },
        );
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
    let at_least =
        |y: usize, z: usize, w: usize, threshold: f32| at_least_word(slab.row(y - 1, z - 1), w, threshold);
    decide_pairs(&at_least, core, alpha, ball, materials, slices)
}

/// [`pair`], of which only `at_least(y, z, w, threshold)` knows the type of samples: which of the word's
/// voxels have at least that grey value. (Compiled once, and not for each type: it is long.)
fn decide_pairs(
    at_least: &(dyn Fn(usize, usize, usize, f32) -> u64 + Sync),
    core: &BitPlanes,
    alpha: &BitPlanes,
    ball: &Ball,
    materials: &MaterialTable,
    slices: Range<usize>,
) -> BitPlanes {
    let (size, n, words) = (alpha.size(), alpha.count(), alpha.words());
    let (near_b, near_alpha) = (Dilation::new(core, ball), Dilation::new(alpha, ball));
    let masks: Vec<u64> = (0..words).map(|w| alpha.voxel_mask(w)).collect();
    // All (k1, k2), and the threshold between them.
    let pairs: Vec<(usize, usize, f32)> = (0..n)
        .flat_map(|i| (i + 1..n).map(move |j| (i, j)))
        .map(|(i, j)| (i, j, materials.threshold(MaterialId(i as u8), MaterialId(j as u8)) as f32))
        .collect();
    let mut b = BitPlanes::window(size, n, slices);
    let arch = pulp::Arch::new();
    b.fill_slices(|z, mut slice| {
        let empty = || vec![0u64; words];
        let (mut open, mut wanted, mut exactly_two) = (empty(), empty(), empty());
        let mut seen_b = vec![0u64; n * words];
        let mut seen_alpha = vec![0u64; n * words];
        arch.dispatch(
            #[inline(always)]
            || {
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
                    for (i, seen) in seen_b.chunks_mut(words).enumerate() {
                        near_b.row(i, y, z, &open, seen);
                    }
                    for (w, exact) in exactly_two.iter_mut().enumerate() {
                        let (mut one, mut two, mut three) = (0, 0, 0);
                        for seen in seen_b.chunks(words).map(|seen| seen[w]) {
                            three |= two & seen;
                            two |= one & seen;
                            one |= seen;
                        }
                        *exact = open[w] & two & !three;
                    }
                    for j in 0..n {
                        // Of class j it matters only where it lies outside of k1..=k2.
                        let (below, above) = seen_b.split_at(j * words);
                        for (w, wanted) in wanted.iter_mut().enumerate() {
                            let lower = twice(below.chunks(words).map(|seen| seen[w]));
                            let higher = twice(above.chunks(words).skip(1).map(|seen| seen[w]));
                            *wanted = exactly_two[w] & (lower | higher);
                        }
                        let seen = &mut seen_alpha[j * words..(j + 1) * words];
                        near_alpha.row(j, y, z, &wanted, seen);
                        // Elsewhere it was not asked for.
                        seen.iter_mut().zip(&wanted).for_each(|(seen, wanted)| *seen &= wanted);
                    }
                    for w in (0..words).filter(|&w| exactly_two[w] != 0) {
                        let strange = seen_alpha.chunks(words).fold(0, |any, seen| any | seen[w]);
                        let plain = exactly_two[w] & !strange;
                        for &(k1, k2, threshold) in &pairs {
                            let here = plain & seen_b[k1 * words + w] & seen_b[k2 * words + w];
                            if here != 0 {
                                let above = at_least(y, z, w, threshold);
                                slice.row(k1, y)[w] |= here & !above;
                                slice.row(k2, y)[w] |= here & above;
                            }
                        }
                    }
                }
            },
        );
    });
    b
}

/// The bits that are set in at least two of the words.
#[inline(always)]
fn twice(words: impl Iterator<Item = u64>) -> u64 {
    words.fold((0, 0), |(one, two), word| (one | word, two | one & word)).1
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
