//! First pass: the class alpha of a voxel, from its grey value alone (Fujimori and Suzuki, table 1).

use super::bit_planes::{BitPlanes, WORD};
use crate::material::MaterialTable;
use crate::volume::{Sample, Slab};

/// One plane per material: the voxels whose grey value lies between the thresholds to the
/// neighbouring materials, `t_(i-1)i <= v < t_i(i+1)`. The planes hold the slices of the slab.
#[must_use]
pub fn alpha<S: Sample>(slab: Slab<'_, S>, materials: &MaterialTable) -> BitPlanes {
    let n = materials.count();
    let ids = materials.materials();
    let thresholds: Vec<f32> = ids.windows(2).map(|w| materials.threshold(w[0].id, w[1].id) as f32).collect();
    let size = slab.size();
    let held = slab.slices();
    let mut planes = BitPlanes::window(size, n, held.start + 1..held.end + 1);
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
fn pack(flags: &[u8; WORD]) -> u64 {
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
            let planes = alpha(Slab::whole(&samples, size), &table);
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
