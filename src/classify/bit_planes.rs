//! Bit planes: one bit per voxel, 64 voxels per operation.
//!
//! The planes cover the *padded lattice*: the volume with one layer of `OUTSIDE` on every side, so
//! voxel (x, y, z) is bit x + 1 of row (y + 1, z + 1). Rows are padded to whole words. Planes that
//! belong together are kept slice by slice, so that a slice of all of them is one contiguous piece
//! which a thread can own. Planes may hold a *window* of slices only; rows keep the coordinates that
//! they have in the whole lattice.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Bits in a word.
pub const WORD: usize = 64;

/// The positions of the set bits of a word, ascending.
#[inline]
pub(crate) fn set_bits(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = word.trailing_zeros() as usize;
        let some = word != 0;
        word &= word.wrapping_sub(1);
        some.then_some(bit)
    })
}

/// `count` bit planes over one padded lattice, or over some slices of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Unchecked")]
pub struct BitPlanes {
    count: usize,
    /// Padded lattice points per axis.
    padded: [usize; 3],
    words: usize,
    /// The first of the slices that are held, in padded coordinates.
    first: usize,
    data: Vec<u64>,
}

/// Planes as they come from outside.
#[derive(Deserialize)]
struct Unchecked {
    count: usize,
    padded: [usize; 3],
    words: usize,
    first: usize,
    data: Vec<u64>,
}

impl TryFrom<Unchecked> for BitPlanes {
    type Error = &'static str;

    fn try_from(planes: Unchecked) -> Result<Self, Self::Error> {
        let Unchecked { count, padded, words, first, data } = planes;
        let slice = count.checked_mul(padded[1]).and_then(|n| n.checked_mul(words)).filter(|&n| n > 0);
        let slices = slice.filter(|&n| data.len().is_multiple_of(n)).map(|n| data.len() / n);
        let end = slices.and_then(|n| first.checked_add(n));
        let fits = padded.iter().all(|&n| n > 2) && words == padded[0].div_ceil(WORD);
        if fits && end.is_some_and(|end| end <= padded[2]) {
            return Ok(Self { count, padded, words, first, data });
        }
        Err("damaged bit planes: their numbers contradict each other")
    }
}

impl BitPlanes {
    /// `count` empty planes for a volume of `size` voxels.
    #[must_use]
    pub fn new(size: [usize; 3], count: usize) -> Self {
        Self::window(size, count, 0..size[2] + 2)
    }

    /// `count` empty planes that hold the padded slices `slices` of a volume of `size` voxels.
    #[must_use]
    pub fn window(size: [usize; 3], count: usize, slices: Range<usize>) -> Self {
        let padded = size.map(|n| n + 2);
        debug_assert!(slices.end <= padded[2]);
        let words = padded[0].div_ceil(WORD);
        let data = vec![0; count * words * padded[1] * slices.len()];
        Self { count, padded, words, first: slices.start, data }
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

    /// Voxels per axis of the whole volume.
    #[must_use]
    pub fn size(&self) -> [usize; 3] {
        self.padded.map(|n| n - 2)
    }

    /// The slices that are held, in padded coordinates.
    #[must_use]
    pub fn slices(&self) -> Range<usize> {
        self.first..self.first + self.data.len() / self.slice_words()
    }

    /// The slices of voxels that are held, in padded coordinates: none of `OUTSIDE`.
    #[must_use]
    pub fn voxel_slices(&self) -> Range<usize> {
        let held = self.slices();
        held.start.max(1)..held.end.min(self.padded[2] - 1)
    }

    /// Words of one slice of all planes.
    fn slice_words(&self) -> usize {
        (self.count * self.padded[1] * self.words).max(1)
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
        (((z - self.first) * self.count + plane) * self.padded[1] + y) * self.words
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

    /// The bits of all planes at a lattice point, that of plane 0 lowest; of at most eight planes.
    #[must_use]
    #[inline]
    pub fn code(&self, x: usize, y: usize, z: usize) -> u8 {
        // A plain loop: this is asked for every voxel of every ball.
        let (first, shift, stride) = (self.start(0, y, z) + x / WORD, x % WORD, self.padded[1] * self.words);
        let mut code = 0;
        for plane in 0..self.count {
            code |= ((self.data[first + plane * stride] >> shift & 1) as u8) << plane;
        }
        code
    }

    /// The bits of the [`WORD`] lattice points of a row from x on, that of x lowest; zero beyond the row's end.
    #[must_use]
    #[inline]
    pub fn bits_from(&self, plane: usize, x: usize, y: usize, z: usize) -> u64 {
        let (word, shift) = (x / WORD, x % WORD);
        let row = self.row(plane, y, z);
        let next = if shift == 0 { 0 } else { row.get(word + 1).map_or(0, |next| next << (WORD - shift)) };
        row.get(word).map_or(0, |own| own >> shift) | next
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

    /// Fills the slices of voxels that are held (none of `OUTSIDE`) in parallel: `fill(z, slice)`
    /// gets the padded z and the words of all planes of that slice, plane by plane, row by row.
    pub fn fill_slices(&mut self, fill: impl Fn(usize, SliceMut<'_>) + Sync) {
        let inner = self.voxel_slices();
        self.fill_all_slices(|z, slice| {
            if inner.contains(&z) {
                fill(z, slice);
            }
        });
    }

    /// Fills all slices that are held, in the same way.
    pub(super) fn fill_all_slices(&mut self, fill: impl Fn(usize, SliceMut<'_>) + Sync) {
        let (rows, words, first, slice) = (self.padded[1], self.words, self.first, self.slice_words());
        self.data.par_chunks_mut(slice).enumerate().for_each(|(i, data)| {
            fill(first + i, SliceMut { rows, words, data });
        });
    }

    /// The words of consecutive slices of all planes.
    ///
    /// # Panics
    /// If they are not held.
    #[must_use]
    pub fn slice_data(&self, slices: Range<usize>) -> &[u64] {
        let words = self.slice_words();
        &self.data[(slices.start - self.first) * words..(slices.end - self.first) * words]
    }

    /// The words of a slice of all planes, to be changed.
    ///
    /// # Panics
    /// If it is not held.
    pub fn slice_mut(&mut self, z: usize) -> &mut [u64] {
        let words = self.slice_words();
        &mut self.data[(z - self.first) * words..(z + 1 - self.first) * words]
    }

    /// The same planes with other slices: those held by both are kept, the others are empty.
    #[must_use]
    pub fn moved(mut self, slices: Range<usize>) -> Self {
        let (held, words) = (self.slices(), self.slice_words());
        let kept = slices.start.max(held.start)..slices.end.min(held.end).max(slices.start.max(held.start));
        if kept.start == slices.start {
            // In place: what is no longer wanted goes, the rest moves down.
            self.data.truncate((kept.end - held.start) * words);
            self.data.drain(..(kept.start - held.start) * words);
            self.data.resize(slices.len() * words, 0);
            self.first = slices.start;
            return self;
        }
        let mut out = Self::window(self.size(), self.count, slices.clone());
        if !kept.is_empty() {
            let at = (kept.start - slices.start) * words;
            out.data[at..at + kept.len() * words].copy_from_slice(self.slice_data(kept));
        }
        out
    }

    /// Overwrites consecutive slices of all planes.
    ///
    /// # Panics
    /// If they are not held or `words` are not as many as the slices have.
    pub fn set_slices(&mut self, first: usize, words: &[u64]) {
        let start = (first - self.first) * self.slice_words();
        self.data[start..start + words.len()].copy_from_slice(words);
    }

    /// The number of set bits of each plane in the slices that are held.
    #[must_use]
    pub fn counts(&self) -> Vec<u64> {
        self.counts_in(self.slices())
    }

    /// The number of set bits of each plane in some of the slices that are held.
    #[must_use]
    pub fn counts_in(&self, slices: Range<usize>) -> Vec<u64> {
        let slice = self.padded[1] * self.words;
        let zero = || vec![0u64; self.count];
        self.slice_data(slices)
            .par_chunks(self.slice_words())
            .fold(zero, |mut sum, data| {
                for (s, plane) in sum.iter_mut().zip(data.chunks(slice)) {
                    *s += plane.iter().map(|w| u64::from(w.count_ones())).sum::<u64>();
                }
                sum
            })
            .reduce(zero, |a, b| a.iter().zip(&b).map(|(a, b)| a + b).collect())
    }

    /// The number of bits set both in `plane` of these planes and in `other_plane` of others over
    /// the same lattice, in slices that both hold.
    #[must_use]
    pub fn count_common(&self, plane: usize, other: &Self, other_plane: usize, slices: Range<usize>) -> u64 {
        let row = |y: usize, z: usize| {
            let pairs = self.row(plane, y, z).iter().zip(other.row(other_plane, y, z));
            pairs.map(|(a, b)| u64::from((a & b).count_ones())).sum::<u64>()
        };
        slices.into_par_iter().map(|z| (0..self.padded[1]).map(|y| row(y, z)).sum::<u64>()).sum()
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
                    let bits = planes.bits_from(1, x, 2, z);
                    for k in 0..WORD {
                        let set = x + k < nx + 2 && planes.bit(1, x + k, 2, z);
                        assert_eq!(bits >> k & 1 == 1, set);
                    }
                    if x <= nx {
                        let two =
                            u8::from(planes.bit(1, x, 2, z)) | u8::from(planes.bit(1, x + 1, 2, z)) << 1;
                        assert_eq!(planes.two_bits(1, x, 2, z), two);
                    }
                }
            }
            assert_eq!(planes.counts(), vec![0, expected]);
            assert_eq!(planes.count_common(1, &planes, 1, 1..4), expected);
            assert_eq!(planes.count_common(0, &planes, 1, 1..4), 0);
            let voxels: u32 = (0..planes.words()).map(|w| planes.voxel_mask(w).count_ones()).sum();
            assert_eq!(voxels as usize, nx);
            assert_eq!(planes.voxel_mask(0) & 1, 0);
        }
    }

    #[test]
    fn a_window_holds_its_slices_under_their_own_numbers() {
        let fill = |planes: &mut BitPlanes| {
            planes.fill_slices(|z, mut slice| slice.row(1, 2)[1] = z as u64);
        };
        let mut window = BitPlanes::window([100, 3, 9], 2, 4..8);
        fill(&mut window);
        assert_eq!((window.slices(), window.voxel_slices()), (4..8, 4..8));
        assert_eq!(window.row(1, 2, 5)[1], 5);
        for (to, kept) in [(6..10, 6..8), (2..6, 4..6), (8..11, 8..8), (0..3, 3..3), (5..7, 5..7)] {
            let moved = window.clone().moved(to.clone());
            assert_eq!(moved.slices(), to);
            for z in to {
                assert_eq!(moved.row(1, 2, z)[1], if kept.contains(&z) { z as u64 } else { 0 });
            }
        }
        let mut last = BitPlanes::window([100, 3, 9], 2, 7..11);
        fill(&mut last);
        assert_eq!((last.voxel_slices(), last.row(1, 2, 10)[1]), (7..10, 0));
        last.set_slices(7, window.slice_data(7..8));
        assert_eq!(last.row(1, 2, 7)[1], 7);
    }
}
