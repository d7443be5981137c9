//! Second and third pass: certain voxels, and voxels between two materials (Fujimori and Suzuki
//! §3.1), as Boolean algebra on bit planes.
//!
//! - *Core*: a voxel of class alpha_i whose whole ball of radius R is alpha_i gets b_i.
//! - *Pair*: over the ball of radius 2R around any other voxel, if exactly two b classes k1 < k2
//!   occur and every alpha class j there has k1 <= j <= k2, it gets k1 if v < t_k1k2, else k2.
//! - What is left is *junction*.
//!
//! Halo: the core pass reads R, the pair pass 2R further. Voxels beyond the volume do not count.

use super::alpha::at_least_word;
use super::ball::Ball;
use super::bit_planes::BitPlanes;
use crate::grid::MaterialId;
use crate::material::MaterialTable;
use crate::volume::Sample;

/// The core voxels of each material: `alpha_i` eroded by the ball of radius R.
#[must_use]
pub fn core(alpha: &BitPlanes, ball: &Ball) -> BitPlanes {
    let near = ball.dilate(alpha);
    let size = alpha.padded().map(|n| n - 2);
    let mut core = BitPlanes::new(size, alpha.count());
    core.fill_slices(|z, mut slice| {
        for y in 1..=size[1] {
            for w in 0..alpha.words() {
                // Classes seen at all, and classes seen at least twice, in the ball.
                let (mut one, mut two) = (0, 0);
                for i in 0..alpha.count() {
                    let seen = near.row(i, y, z)[w];
                    two |= one & seen;
                    one |= seen;
                }
                for i in 0..alpha.count() {
                    slice.row(i, y)[w] = alpha.row(i, y, z)[w] & !two;
                }
            }
        }
    });
    core
}

/// Adds the voxels of the pair pass to the core planes; what is in no plane afterwards is junction.
pub fn pair<S: Sample>(
    samples: &[S],
    b: &mut BitPlanes,
    alpha: &BitPlanes,
    ball: &Ball,
    materials: &MaterialTable,
) {
    let n = alpha.count();
    let size = alpha.padded().map(|n| n - 2);
    let near_b = ball.dilate(b);
    let near_alpha = ball.dilate(alpha);
    let threshold = |i: usize, j: usize| materials.threshold(MaterialId(i as u8), MaterialId(j as u8)) as f32;
    b.fill_slices(|z, mut slice| {
        let mut seen_b = vec![0u64; n];
        let mut seen_alpha = vec![0u64; n];
        for y in 1..=size[1] {
            let start = ((z - 1) * size[1] + y - 1) * size[0];
            let row = &samples[start..start + size[0]];
            for w in 0..alpha.words() {
                let certain = (0..n).fold(0, |any, i| any | slice.row(i, y)[w]);
                let open = alpha_any(alpha, y, z, w) & !certain;
                if open == 0 {
                    continue;
                }
                let (mut one, mut two, mut three) = (0, 0, 0);
                for i in 0..n {
                    seen_b[i] = near_b.row(i, y, z)[w];
                    seen_alpha[i] = near_alpha.row(i, y, z)[w];
                    three |= two & seen_b[i];
                    two |= one & seen_b[i];
                    one |= seen_b[i];
                }
                let exactly_two = open & two & !three;
                let mut lower = 0; // alpha classes below k1
                for k1 in 0..n - 1 {
                    let with_first = exactly_two & seen_b[k1] & !lower;
                    lower |= seen_alpha[k1];
                    if with_first == 0 {
                        continue;
                    }
                    let mut higher = 0; // alpha classes above k2
                    for k2 in (k1 + 1..n).rev() {
                        let here = with_first & seen_b[k2] & !higher;
                        higher |= seen_alpha[k2];
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
}

/// The voxels of a word: those with any alpha class.
fn alpha_any(alpha: &BitPlanes, y: usize, z: usize, w: usize) -> u64 {
    (0..alpha.count()).fold(0, |any, i| any | alpha.row(i, y, z)[w])
}

/// The voxels that are in none of the planes `b`.
#[must_use]
pub fn junction(b: &BitPlanes) -> BitPlanes {
    let size = b.padded().map(|n| n - 2);
    let mut out = BitPlanes::new(size, 1);
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
