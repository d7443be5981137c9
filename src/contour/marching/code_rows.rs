//! The code words of a row of the padded lattice: 64 lattice points at a time.

use crate::classify::{LabelVolume, WORD};
use crate::contour::patch::Border;

/// Most code planes that there can be: codes are bytes.
pub(super) const MAX_PLANES: usize = 8;

/// A row of all code planes.
#[derive(Clone, Copy)]
pub(super) struct CodeRow<'a> {
    /// The words of the slice from this row of the first plane on.
    data: &'a [u64],
    words: usize,
    /// Words from a plane to the next.
    stride: usize,
    count: usize,
}

impl<'a> CodeRow<'a> {
    /// Row (y, z) of the padded lattice.
    #[inline]
    pub(super) fn new(labels: &'a LabelVolume, y: usize, z: usize) -> Self {
        let codes = labels.codes();
        let (words, rows) = (codes.words(), codes.padded()[1]);
        let data = &codes.slice_data(z..z + 1)[y * words..];
        Self { data, words, stride: rows * words, count: codes.count() }
    }

    /// The words of plane `p`.
    #[inline]
    pub(super) fn plane(&self, p: usize) -> &'a [u64] {
        &self.data[p * self.stride..p * self.stride + self.words]
    }

    /// Code bits `p` of the points of word `w`.
    #[inline]
    pub(super) fn word(&self, p: usize, w: usize) -> u64 {
        self.data[p * self.stride + w]
    }

    /// Code bits `p` of the points after those of word `w`: bit i belongs to point i + 1.
    #[inline]
    pub(super) fn next(&self, p: usize, w: usize) -> u64 {
        shifted(self.plane(p), w)
    }

    /// Word `w` of every plane; there are no more than `P`.
    #[inline]
    pub(super) fn words<const P: usize>(&self, w: usize) -> [u64; P] {
        let mut words = [0; P];
        words.iter_mut().enumerate().take(self.count).for_each(|(p, word)| *word = self.word(p, w));
        words
    }

    /// The words of every plane for the points after those of word `w`.
    #[inline]
    pub(super) fn next_words<const P: usize>(&self, w: usize) -> [u64; P] {
        let mut words = [0; P];
        words.iter_mut().enumerate().take(self.count).for_each(|(p, word)| *word = self.next(p, w));
        words
    }
}

/// The code at a bit of the words of every plane.
#[inline]
pub(super) fn code<const P: usize>(words: &[u64; P], bit: usize) -> u8 {
    words.iter().rev().fold(0, |code, word| code << 1 | (word >> bit & 1) as u8)
}

/// Half word `half` of a row and the one behind it.
#[inline]
pub(super) fn half_word(row: &[u64], half: usize) -> u64 {
    let (w, odd) = (half / 2, half % 2);
    if odd == 0 { row[w] } else { row[w] >> (WORD / 2) | row.get(w + 1).map_or(0, |n| n << (WORD / 2)) }
}

/// Word `w` of a row, moved down by one point.
#[inline]
pub(super) fn shifted(row: &[u64], w: usize) -> u64 {
    row[w] >> 1 | row.get(w + 1).map_or(0, |next| next << (WORD - 1))
}

/// Words that are worked on at a time.
pub(super) const BLOCK: usize = 4;

/// Consecutive words of a plane.
pub(super) type Block = [u64; BLOCK];

/// A slice of all code planes, the rows of each one after the other.
///
/// The point behind the last of a row is here the first of the next row. That makes no crossing and no
/// node: the first of a row is `OUTSIDE`, and the last is `OUTSIDE` or, where words are not full, air.
#[derive(Clone, Copy)]
pub(super) struct CodeSlice<'a> {
    planes: [&'a [u64]; MAX_PLANES],
}

impl<'a> CodeSlice<'a> {
    /// Slice `z` of the padded lattice.
    pub(super) fn new(labels: &'a LabelVolume, z: usize) -> Self {
        let codes = labels.codes();
        let mut planes = [&[] as &[u64]; MAX_PLANES];
        let data = codes.slice_data(z..z + 1).chunks(codes.words() * codes.padded()[1]);
        planes.iter_mut().zip(data).for_each(|(plane, data)| *plane = data);
        Self { planes }
    }

    /// Code bits `p` of the points from word `i` on; zeros behind the last.
    #[inline(always)]
    pub(super) fn block(&self, p: usize, i: usize) -> Block {
        let rest = self.planes[p].get(i..).unwrap_or_default();
        rest.first_chunk().copied().unwrap_or_else(|| {
            let mut block = [0; BLOCK];
            block.iter_mut().zip(rest).for_each(|(to, from)| *to = *from);
            block
        })
    }

    /// Code bits `p` of the points after those: bit i belongs to point i + 1.
    #[inline(always)]
    pub(super) fn next_block(&self, p: usize, i: usize) -> Block {
        let (here, next) = (self.block(p, i), self.block(p, i + 1));
        let mut block = [0; BLOCK];
        for k in 0..BLOCK {
            block[k] = here[k] >> 1 | next[k] << (WORD - 1);
        }
        block
    }
}

/// The edges that need a crossing: their ends differ, and triangles will refer to it (none are made
/// between air and `OUTSIDE`, nor, with an open border, to `OUTSIDE` at all). `ends` gives the words of
/// code plane p at the lower and the upper ends; `outside` is the code of `OUTSIDE`.
#[inline(always)]
pub(super) fn crossed(
    planes: usize,
    outside: usize,
    border: Border,
    ends: impl Fn(usize) -> [Block; 2],
) -> Block {
    let (mut differ, mut out, mut some) = ([0; BLOCK], [[u64::MAX; BLOCK]; 2], [[0; BLOCK]; 2]);
    for p in 0..planes {
        let [a, b] = ends(p);
        // All ones where this bit of the code of OUTSIDE is zero.
        let flip = ((outside >> p & 1) as u64).wrapping_sub(1);
        for k in 0..BLOCK {
            differ[k] |= a[k] ^ b[k];
            out[0][k] &= a[k] ^ flip;
            out[1][k] &= b[k] ^ flip;
            some[0][k] |= a[k];
            some[1][k] |= b[k];
        }
    }
    for k in 0..BLOCK {
        differ[k] &= match border {
            Border::Open => !(out[0][k] | out[1][k]),
            Border::Closed => !(!some[0][k] & out[1][k] | out[0][k] & !some[1][k]),
        };
    }
    differ
}

/// The faces that have a node: three or four materials in a star. `ring` gives the words of code plane p
/// at the four corners in ring order.
#[inline(always)]
pub(super) fn starred(planes: usize, ring: impl Fn(usize) -> [Block; 4]) -> Block {
    let (mut sides, mut diagonals) = ([[0; BLOCK]; 4], [[0; BLOCK]; 2]);
    for p in 0..planes {
        let [a, b, c, d] = ring(p);
        for k in 0..BLOCK {
            sides[0][k] |= a[k] ^ b[k];
            sides[1][k] |= b[k] ^ c[k];
            sides[2][k] |= c[k] ^ d[k];
            sides[3][k] |= d[k] ^ a[k];
            diagonals[0][k] |= a[k] ^ c[k];
            diagonals[1][k] |= b[k] ^ d[k];
        }
    }
    let mut stars = [0; BLOCK];
    for (k, star) in stars.iter_mut().enumerate() {
        let (both, other_both) = (sides[0][k] & sides[1][k], sides[2][k] & sides[3][k]);
        let (one, other_one) = (sides[0][k] ^ sides[1][k], sides[2][k] ^ sides[3][k]);
        // Three sides crossed, or four with different materials across both diagonals.
        *star = both & other_one | other_both & one | both & other_both & diagonals[0][k] & diagonals[1][k];
    }
    stars
}

/// The faces with two materials, neither of them `OUTSIDE`, and two crossings. `ring` gives the words of code plane p at
/// the four corners in ring order; `outside` is the code of `OUTSIDE`.
#[inline(always)]
pub(super) fn plain(planes: usize, outside: usize, ring: impl Fn(usize) -> [Block; 4]) -> Block {
    let (mut sides, mut out) = ([[0; BLOCK]; 4], [[u64::MAX; BLOCK]; 4]);
    for p in 0..planes {
        let corners = ring(p);
        let flip = ((outside >> p & 1) as u64).wrapping_sub(1);
        for c in 0..4 {
            for k in 0..BLOCK {
                sides[c][k] |= corners[c][k] ^ corners[(c + 1) % 4][k];
                out[c][k] &= corners[c][k] ^ flip;
            }
        }
    }
    let mut plain = [0; BLOCK];
    for (k, plain) in plain.iter_mut().enumerate() {
        let [a, b, c, d] = sides.map(|side| side[k]);
        // An even number of sides, but neither none nor all four.
        let two = (a | b | c | d) & !(a & b & c & d) & !(a ^ b ^ c ^ d);
        *plain = two & !out.iter().fold(0, |any, corner| any | corner[k]);
    }
    plain
}
