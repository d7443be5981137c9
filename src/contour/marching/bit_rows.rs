//! Crossed edges, or faces with a node, of one kind in one plane or layer: a bit for each, and their
//! numbers.

use crate::classify::set_bits;

/// Bits in rows; set bits are numbered in row-major order.
#[derive(Debug, Default)]
pub(super) struct BitRows {
    words: usize,
    bits: Vec<u64>,
    /// Number of the first set bit of each row, and behind the last row the number of all.
    firsts: Vec<u32>,
}

impl BitRows {
    /// `rows` rows of `words` words; `fill` writes them, one after the other, which are empty before.
    #[inline(always)] // for the instructions of its caller
    pub(super) fn new(words: usize, rows: usize, fill: impl FnOnce(&mut [u64])) -> Self {
        let mut bits = vec![0; words * rows];
        fill(&mut bits);
        let mut firsts = Vec::with_capacity(rows + 1);
        let mut total = 0;
        for row in bits.chunks(words.max(1)) {
            firsts.push(total);
            total += row.iter().map(|w| w.count_ones()).sum::<u32>();
        }
        firsts.resize(rows + 1, total);
        Self { words, bits, firsts }
    }

    /// Clears the bits (x, y) that are not to be kept.
    pub(super) fn retain(&mut self, mut keep: impl FnMut(usize, usize) -> bool) {
        let mut bits = std::mem::take(&mut self.bits);
        for (i, word) in bits.iter_mut().enumerate() {
            let (x, y) = (64 * (i % self.words), i / self.words);
            *word = set_bits(*word).filter(|bit| keep(x + bit, y)).fold(0, |word, bit| word | 1 << bit);
        }
        *self = Self::new(self.words, bits.len() / self.words.max(1), |new| new.copy_from_slice(&bits));
    }

    /// Bit (x, y).
    #[inline]
    pub(super) fn has(&self, x: usize, y: usize) -> bool {
        self.bits[y * self.words + x / 64] >> (x % 64) & 1 == 1
    }

    /// Whether there are no rows.
    pub(super) fn is_empty(&self) -> bool {
        self.bits.is_empty()
    }

    /// Number of set bits.
    #[inline]
    pub(super) fn total(&self) -> u32 {
        self.firsts.last().copied().unwrap_or(0)
    }

    /// Number of the first set bit of row `y`, or of what would follow the last row.
    #[inline]
    pub(super) fn first(&self, y: usize) -> u32 {
        self.firsts[y]
    }

    /// Number of bit (x, y), if it is set.
    pub(super) fn number(&self, x: usize, y: usize) -> Option<u32> {
        let is_here = x < 64 * self.words && y + 1 < self.firsts.len() && self.has(x, y);
        is_here.then(|| {
            let (row, below) = (self.row(y), (1u64 << (x % 64)) - 1);
            let before: u32 = row[..x / 64].iter().map(|w| w.count_ones()).sum();
            self.firsts[y] + before + (row[x / 64] & below).count_ones()
        })
    }

    /// The words of row `y`.
    #[inline]
    pub(super) fn row(&self, y: usize) -> &[u64] {
        &self.bits[y * self.words..(y + 1) * self.words]
    }

    /// The rows that have a set bit.
    pub(super) fn filled_rows(&self) -> impl Iterator<Item = usize> {
        self.firsts.windows(2).enumerate().filter(|(_, f)| f[0] != f[1]).map(|(y, _)| y)
    }

    /// All set bits (x, y) in order of their number.
    pub(super) fn iter(&self) -> impl Iterator<Item = (usize, usize)> {
        self.filled_rows().flat_map(move |y| {
            let words = self.row(y).iter().enumerate();
            words.flat_map(move |(w, &word)| set_bits(word).map(move |bit| (64 * w + bit, y)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_bits_are_numbered_row_by_row() {
        let words = [[0, 1 << 63], [0, 0], [0b1010, 1]];
        let rows = BitRows::new(2, 3, |bits| bits.copy_from_slice(words.as_flattened()));
        assert_eq!(rows.iter().collect::<Vec<_>>(), [(127, 0), (1, 2), (3, 2), (64, 2)]);
        assert_eq!([0, 1, 2, 3].map(|y| rows.first(y)), [0, 1, 1, 4]);
        assert_eq!((rows.total(), rows.filled_rows().collect::<Vec<_>>()), (4, vec![0, 2]));
        let numbers = rows.iter().map(|(x, y)| rows.number(x, y).unwrap());
        assert!(numbers.eq(0..4) && rows.number(0, 2).is_none() && rows.number(500, 2).is_none());
        let mut some = rows;
        some.retain(|x, y| (x, y) != (3, 2));
        assert_eq!(some.iter().collect::<Vec<_>>(), [(127, 0), (1, 2), (64, 2)]);
        assert_eq!([0, 1, 2, 3].map(|y| some.first(y)), [0, 1, 1, 3]);
        assert!(some.has(127, 0) && some.has(64, 2) && !some.has(3, 2));
    }
}
