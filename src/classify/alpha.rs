//! First pass: the class alpha of a voxel, from its grey value alone (Fujimori and Suzuki, table 1).

use std::ops::Range;

use rayon::prelude::*;

use super::bit_planes::{BitPlanes, WORD};
use crate::material::MaterialTable;
use crate::volume::{Sample, Slab};

/// One plane per material: the voxels whose grey value lies between the thresholds to the
/// neighbouring materials, `t_(i-1)i <= v < t_i(i+1)`. For the padded slices `slices`, which the slab
/// must hold.
#[must_use]
pub fn alpha<S: Sample>(slab: Slab<'_, S>, materials: &MaterialTable, slices: Range<usize>) -> BitPlanes {
    let n = materials.count();
    let ids = materials.materials();
    let thresholds: Vec<f32> = ids.windows(2).map(|w| materials.threshold(w[0].id, w[1].id) as f32).collect();
    let size = slab.size();
    let mut planes = BitPlanes::window(size, n, slices);
    planes.fill_slices(|z, mut slice| {
        for y in 1..=size[1] {
            let row = slab.row(y - 1, z - 1);
            for (i, &t) in thresholds.iter().enumerate() {
                at_least_row(row, t, slice.row(i + 1, y));
            }
            at_least_row(row, f32::NEG_INFINITY, slice.row(0, y));
            // Plane i now holds v >= t_(i-1)i; take away what the next one holds.
            for i in 0..n - 1 {
                for w in 0..slice.row(i, y).len() {
                    let above = slice.row(i + 1, y)[w];
                    slice.row(i, y)[w] &= !above;
                }
            }
        }
    });
    planes
}

/// How many voxels of the padded slices `slices` are of the densest material both in `b` and by grey
/// value alone.
#[must_use]
pub(super) fn count_densest_kept<S: Sample>(
    slab: Slab<'_, S>,
    b: &BitPlanes,
    materials: &MaterialTable,
    slices: Range<usize>,
) -> u64 {
    let n = b.count();
    let [.., below, densest] = materials.materials() else { return 0 };
    let threshold = materials.threshold(below.id, densest.id) as f32;
    let row = |y: usize, z: usize| {
        let samples = slab.row(y - 1, z - 1);
        let members = b.row(n - 1, y, z).iter().enumerate().filter(|(_, word)| **word != 0);
        members
            .map(|(w, word)| u64::from((word & at_least_word(samples, w, threshold)).count_ones()))
            .sum::<u64>()
    };
    let ys = 1..b.padded()[1] - 1;
    slices.into_par_iter().map(|z| ys.clone().map(|y| row(y, z)).sum::<u64>()).sum()
}

/// Sets bit x + 1 where `row[x] >= threshold`.
fn at_least_row<S: Sample>(row: &[S], threshold: f32, out: &mut [u64]) {
    for (w, word) in out.iter_mut().enumerate() {
        *word = at_least_word(row, w, threshold);
    }
}

/// The word `w` of a row of the padded lattice: bits where the sample is at least `threshold`.
#[must_use]
pub(super) fn at_least_word<S: Sample>(row: &[S], w: usize, threshold: f32) -> u64 {
    // Padded point p is sample p - 1.
    let (first, last) = ((w * WORD).max(1), ((w + 1) * WORD).min(row.len() + 1));
    if first >= last {
        return 0;
    }
    let samples = &row[first - 1..last - 1];
    let mut flags = [0u8; WORD];
    for (flag, v) in flags.iter_mut().zip(samples) {
        *flag = u8::from(v.to_f32() >= threshold);
    }
    pack(&flags) << (first - w * WORD)
}

/// The low bits of 64 bytes, packed.
#[inline(always)]
pub(super) fn pack(flags: &[u8; WORD]) -> u64 {
    // Multiplying eight 0/1 bytes by this constant gathers them, in order, in the top byte.
    const GATHER: u64 = 0x0102_0408_1020_4080;
    let mut out = 0;
    for (i, eight) in flags.as_chunks::<8>().0.iter().enumerate() {
        out |= (u64::from_le_bytes(*eight).wrapping_mul(GATHER) >> 56) << (8 * i);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_voxel_gets_the_class_of_its_grey_value() {
        let table = MaterialTable::new([("air", 0.0), ("al", 10.0), ("fe", 30.0)]).unwrap();
        for nx in [1usize, 62, 63, 64, 129] {
            let size = [nx, 2, 2];
            let samples: Vec<i16> = (0..nx * 4).map(|i| (i * 7 % 41) as i16 - 3).collect();
            let planes = alpha(Slab::whole(&samples, size), &table, 1..3);
            for (i, &v) in samples.iter().enumerate() {
                let (x, y, z) = (i % nx + 1, i / nx % 2 + 1, i / nx / 2 + 1);
                let class = if v < 5 {
                    0
                } else if v < 20 {
                    1
                } else {
                    2
                };
                for p in 0..3 {
                    assert_eq!(planes.bit(p, x, y, z), p == class, "voxel {i} of grey {v}");
                }
            }
            assert_eq!(planes.counts().iter().sum::<u64>(), 4 * nx as u64);
        }
    }
}
