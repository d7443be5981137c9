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
    pub(super) fn new(labels: &'a LabelVolume, y: usize, z: usize) -> Self {
        let codes = labels.codes();
        let (words, rows) = (codes.words(), codes.padded()[1]);
        let data = &codes.slice_data(z..z + 1)[y * words..];
        Self { data, words, stride: rows * words, count: codes.count() }
    }

    /// The words of plane `p`.
    #[inline]
    fn plane(&self, p: usize) -> &'a [u64] {
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

    /// Code bits `p` of the points from `half` half words on.
    #[inline]
    pub(super) fn half_word(&self, p: usize, half: usize) -> u64 {
        let row = self.plane(p);
        let (w, odd) = (half / 2, half % 2);
        if odd == 0 { row[w] } else { row[w] >> (WORD / 2) | row.get(w + 1).map_or(0, |n| n << (WORD / 2)) }
    }

    /// Word `w` of every plane.
    pub(super) fn words(&self, w: usize) -> [u64; MAX_PLANES] {
        std::array::from_fn(|p| if p < self.count { self.word(p, w) } else { 0 })
    }

    /// The words of every plane for the points after those of word `w`.
    pub(super) fn next_words(&self, w: usize) -> [u64; MAX_PLANES] {
        std::array::from_fn(|p| if p < self.count { self.next(p, w) } else { 0 })
    }

    /// The code at a bit of such words.
    #[inline]
    pub(super) fn code(&self, words: &[u64; MAX_PLANES], bit: usize) -> u8 {
        words[..self.count].iter().rev().fold(0, |code, word| code << 1 | (word >> bit & 1) as u8)
    }
}

/// Word `w` of a row, moved down by one point.
#[inline]
pub(super) fn shifted(row: &[u64], w: usize) -> u64 {
    row[w] >> 1 | row.get(w + 1).map_or(0, |next| next << (WORD - 1))
}

/// The edges, 64 at a time, that need a crossing: their ends differ, and triangles will refer to it
/// (none are made between air and `OUTSIDE`, nor, with an open border, to `OUTSIDE` at all). `ends`
/// gives the words of code plane p at the lower and the upper ends; `outside` is the code of `OUTSIDE`.
#[inline]
pub(super) fn crossed(
    planes: usize,
    outside: usize,
    border: Border,
    ends: impl Fn(usize) -> [u64; 2],
) -> u64 {
    let (mut differ, mut a_out, mut b_out) = (0, u64::MAX, u64::MAX);
    for p in 0..planes {
        let [a, b] = ends(p);
        differ |= a ^ b;
        // All ones where this bit of the code of OUTSIDE is zero.
        let flip = ((outside >> p & 1) as u64).wrapping_sub(1);
        a_out &= a ^ flip;
        b_out &= b ^ flip;
    }
    if differ == 0 || a_out | b_out == 0 {
        return differ;
    }
    let unneeded = match border {
        Border::Open => a_out | b_out,
        Border::Closed => {
            let some = (0..planes).map(&ends).fold([0, 0], |some, [a, b]| [some[0] | a, some[1] | b]);
            !some[0] & b_out | a_out & !some[1]
        }
    };
    differ & !unneeded
}

/// The faces, 64 at a time, that have a node: three or four materials in a star. `ring` gives the words
/// of code plane p at the four corners in ring order.
pub(super) fn starred(planes: usize, ring: impl Fn(usize) -> [u64; 4]) -> u64 {
    let mut sides = [0; 4];
    for p in 0..planes {
        let [a, b, c, d] = ring(p);
        sides[0] |= a ^ b;
        sides[1] |= b ^ c;
        sides[2] |= c ^ d;
        sides[3] |= d ^ a;
    }
    let (both, other_both) = (sides[0] & sides[1], sides[2] & sides[3]);
    let (one, other_one) = (sides[0] ^ sides[1], sides[2] ^ sides[3]);
    // Three sides crossed, or four with different materials across both diagonals.
    let mut star = both & other_one | other_both & one;
    let all = both & other_both;
    if all != 0 {
        let (mut first, mut second) = (0, 0);
        for p in 0..planes {
            let [a, b, c, d] = ring(p);
            first |= a ^ c;
            second |= b ^ d;
        }
        star |= all & first & second;
    }
    star
}
