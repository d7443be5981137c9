//! Bit planes: one bit per voxel, 64 voxels per operation.
//!
//! The planes cover the *padded lattice*: the volume with one layer of `OUTSIDE` on every side, so
//! voxel (x, y, z) is bit x + 1 of row (y + 1, z + 1). Rows are padded to whole words. Planes that
//! belong together are kept slice by slice, so that a slice of all of them is one contiguous piece
//! which a thread can own.

use rayon::prelude::*;

/// Bits in a word.
pub const WORD: usize = 64;

/// `count` bit planes over one padded lattice.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BitPlanes {
    count: usize,
    /// Padded lattice points per axis.
    padded: [usize; 3],
    words: usize,
    data: Vec<u64>,
}

impl BitPlanes {
    /// `count` empty planes for a volume of `size` voxels.
    #[must_use]
    pub fn new(size: [usize; 3], count: usize) -> Self {
        let padded = size.map(|n| n + 2);
        let words = padded[0].div_ceil(WORD);
        Self { count, padded, words, data: vec![0; count * words * padded[1] * padded[2]] }
    }

    /// Number of planes.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Padded lattice points per axis: the volume's size plus two.
    #[must_use]
    pub fn padded(&self) -> [usize; 3] {
        self.padded
    }

    /// Words per row.
    #[must_use]
    pub fn words(&self) -> usize {
        self.words
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        8 * self.data.len()
    }

    fn start(&self, plane: usize, y: usize, z: usize) -> usize {
        ((z * self.count + plane) * self.padded[1] + y) * self.words
    }

    /// A row of a plane, in padded coordinates.
    #[must_use]
    pub fn row(&self, plane: usize, y: usize, z: usize) -> &[u64] {
        let start = self.start(plane, y, z);
        &self.data[start..start + self.words]
    }

    /// A row of a plane to be changed, in padded coordinates.
    pub fn row_mut(&mut self, plane: usize, y: usize, z: usize) -> &mut [u64] {
        let start = self.start(plane, y, z);
        &mut self.data[start..start + self.words]
    }

    /// One bit, in padded coordinates.
    #[must_use]
    pub fn bit(&self, plane: usize, x: usize, y: usize, z: usize) -> bool {
        self.data[self.start(plane, y, z) + x / WORD] >> (x % WORD) & 1 == 1
    }

    /// The bits of two neighbouring lattice points x and x + 1 of a row.
    #[must_use]
    pub fn two_bits(&self, plane: usize, x: usize, y: usize, z: usize) -> u8 {
        let start = self.start(plane, y, z);
        let (word, shift) = (x / WORD, x % WORD);
        let low = self.data[start + word] >> shift;
        let high =
            if shift == WORD - 1 && word + 1 < self.words { self.data[start + word + 1] << 1 } else { 0 };
        ((low | high) & 3) as u8
    }

    /// Fills the slices of the volume (not the outside layers) in parallel: `fill(z, slice)` gets
    /// the padded z and the words of all planes of that slice, plane by plane, row by row.
    pub fn fill_slices(&mut self, fill: impl Fn(usize, SliceMut<'_>) + Sync) {
        let (count, rows, words) = (self.count, self.padded[1], self.words);
        let inner = 1..self.padded[2] - 1;
        self.data.par_chunks_mut((count * rows * words).max(1)).enumerate().for_each(|(z, data)| {
            if inner.contains(&z) {
                fill(z, SliceMut { rows, words, data });
            }
        });
    }

    /// The number of set bits of each plane.
    #[must_use]
    pub fn counts(&self) -> Vec<u64> {
        let slice = self.padded[1] * self.words;
        let zero = || vec![0u64; self.count];
        self.data
            .par_chunks((self.count * slice).max(1))
            .fold(zero, |mut sum, data| {
                for (s, plane) in sum.iter_mut().zip(data.chunks(slice)) {
                    *s += plane.iter().map(|w| u64::from(w.count_ones())).sum::<u64>();
                }
                sum
            })
            .reduce(zero, |a, b| a.iter().zip(&b).map(|(a, b)| a + b).collect())
    }

    /// One of the planes on its own.
    #[must_use]
    pub fn plane(&self, plane: usize) -> Self {
        let size = self.padded.map(|n| n - 2);
        let mut out = Self::new(size, 1);
        out.fill_slices(|z, mut slice| {
            for y in 0..self.padded[1] {
                slice.row(0, y).copy_from_slice(self.row(plane, y, z));
            }
        });
        out
    }

    /// The number of bits set both in `plane` of these planes and in `other_plane` of others over
    /// the same lattice.
    #[must_use]
    pub fn count_common(&self, plane: usize, other: &Self, other_plane: usize) -> u64 {
        let row = |y: usize, z: usize| {
            let pairs = self.row(plane, y, z).iter().zip(other.row(other_plane, y, z));
            pairs.map(|(a, b)| u64::from((a & b).count_ones())).sum::<u64>()
        };
        (0..self.padded[2]).into_par_iter().map(|z| (0..self.padded[1]).map(|y| row(y, z)).sum::<u64>()).sum()
    }

    /// The word mask of a row's voxels: its bits without the outside points at both ends.
    #[must_use]
    pub fn voxel_mask(&self, word: usize) -> u64 {
        let bits = |from: usize, to: usize| {
            // Bits from..to of the row that fall into this word.
            let (low, high) = (word * WORD, (word + 1) * WORD);
            let (from, to) = (from.clamp(low, high) - low, to.clamp(low, high) - low);
            let below = |n: usize| if n >= WORD { u64::MAX } else { (1u64 << n) - 1 };
            below(to) & !below(from)
        };
        bits(1, self.padded[0] - 1)
    }
}

/// All planes of one slice, to be filled.
pub struct SliceMut<'a> {
    rows: usize,
    words: usize,
    data: &'a mut [u64],
}

impl SliceMut<'_> {
    /// Row y (padded) of a plane.
    pub fn row(&mut self, plane: usize, y: usize) -> &mut [u64] {
        let start = (plane * self.rows + y) * self.words;
        &mut self.data[start..start + self.words]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_found_where_they_were_put() {
        for nx in [1, 5, 61, 62, 63, 64, 65, 130] {
            let mut planes = BitPlanes::new([nx, 2, 3], 2);
            planes.fill_slices(|z, mut slice| {
                for x in 1..=nx {
                    if (x + z) % 3 == 0 {
                        slice.row(1, 2)[x / WORD] |= 1 << (x % WORD);
                    }
                }
            });
            let mut expected = 0;
            for z in 1..=3 {
                for x in 0..nx + 2 {
                    let set = (1..=nx).contains(&x) && (x + z) % 3 == 0;
                    expected += u64::from(set);
                    assert_eq!(planes.bit(1, x, 2, z), set);
                    assert!(!planes.bit(0, x, 2, z));
                    if x <= nx {
                        let two =
                            u8::from(planes.bit(1, x, 2, z)) | u8::from(planes.bit(1, x + 1, 2, z)) << 1;
                        assert_eq!(planes.two_bits(1, x, 2, z), two);
                    }
                }
            }
            assert_eq!(planes.counts(), vec![0, expected]);
            assert_eq!(planes.plane(1).counts(), vec![expected]);
            assert_eq!(planes.count_common(1, &planes.plane(1), 0), expected);
            assert_eq!(planes.count_common(0, &planes, 1), 0);
            let voxels: u32 = (0..planes.words()).map(|w| planes.voxel_mask(w).count_ones()).sum();
            assert_eq!(voxels as usize, nx);
            assert_eq!(planes.voxel_mask(0) & 1, 0);
        }
    }
}
