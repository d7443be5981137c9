//! The crossed lattice edges of one axis in one plane or layer: a bit per edge, and their numbers.

use crate::classify::{LabelVolume, WORD};
use crate::contour::patch::Border;

/// Crossed edges, row by row; an edge's *rank* is its number in row-major order.
#[derive(Debug)]
pub(super) struct EdgeRows {
    words: usize,
    bits: Vec<u64>,
    /// Rank of the first edge of each word.
    ranks: Vec<u32>,
    total: u32,
}

impl EdgeRows {
    /// The edges along `axis` whose lower end lies in plane `z` of the padded lattice and that need
    /// a crossing: their ends differ, and triangles will refer to it (none are made between air and
    /// `OUTSIDE`, nor, with an open border, to `OUTSIDE` at all).
    pub(super) fn new(labels: &LabelVolume, axis: usize, z: usize, border: Border) -> Self {
        let codes = labels.codes();
        let [_, rows, planes] = codes.padded();
        let words = codes.words();
        let outside = labels.materials();
        let mut bits = vec![0u64; words * rows];
        let last_row = if axis == 1 { rows - 1 } else { rows };
        let last_row = if axis == 2 && z + 1 >= planes { 0 } else { last_row };
        for y in 0..last_row {
            for w in 0..words {
                let (mut differ, mut a_air, mut a_out, mut b_air, mut b_out) =
                    (0, u64::MAX, u64::MAX, u64::MAX, u64::MAX);
                for p in 0..codes.count() {
                    let row = codes.row(p, y, z);
                    let a = row[w];
                    let b = match axis {
                        0 => a >> 1 | if w + 1 < words { row[w + 1] << (WORD - 1) } else { 0 },
                        1 => codes.row(p, y + 1, z)[w],
                        _ => codes.row(p, y, z + 1)[w],
                    };
                    differ |= a ^ b;
                    a_air &= !a;
                    b_air &= !b;
                    let flip = if outside >> p & 1 == 1 { 0 } else { u64::MAX };
                    a_out &= a ^ flip;
                    b_out &= b ^ flip;
                }
                let unneeded = match border {
                    Border::Closed => a_air & b_out | a_out & b_air,
                    Border::Open => a_out | b_out,
                };
                bits[y * words + w] = differ & !unneeded;
            }
        }
        let mut total = 0;
        let ranks = bits
            .iter()
            .map(|w| {
                let rank = total;
                total += w.count_ones();
                rank
            })
            .collect();
        Self { words, bits, ranks, total }
    }

    /// Number of edges.
    pub(super) fn total(&self) -> u32 {
        self.total
    }

    /// Word `w` of row `y`.
    pub(super) fn word(&self, y: usize, w: usize) -> u64 {
        self.bits[y * self.words + w]
    }

    /// Word `w` of row `y`, and the same word of the next point along x: bit i is edge i or i + 1.
    pub(super) fn word_or_next(&self, y: usize, w: usize) -> u64 {
        let here = self.word(y, w);
        let next = if w + 1 < self.words { self.word(y, w + 1) << (WORD - 1) } else { 0 };
        here | here >> 1 | next
    }

    /// Rank of the crossed edge at (x, y).
    pub(super) fn rank(&self, x: usize, y: usize) -> u32 {
        let at = y * self.words + x / WORD;
        let below = self.bits[at] & ((1u64 << (x % WORD)) - 1);
        self.ranks[at] + below.count_ones()
    }

    /// All crossed edges (x, y) in order of their rank.
    pub(super) fn iter(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.bits.iter().enumerate().filter(|(_, w)| **w != 0).flat_map(move |(at, &word)| {
            let (y, first) = (at / self.words, at % self.words * WORD);
            std::iter::successors(Some(word), |w| Some(w & w.wrapping_sub(1)))
                .take_while(|w| *w != 0)
                .map(move |w| (first + w.trailing_zeros() as usize, y))
        })
    }
}

/// The three kinds of edges that the cells of layer `z` touch.
#[derive(Debug)]
pub(super) struct LayerEdges {
    /// Along x and y in the planes z and z + 1.
    pub(super) plane: [[EdgeRows; 2]; 2],
    /// Along z between them.
    pub(super) up: EdgeRows,
}

impl LayerEdges {
    pub(super) fn new(labels: &LabelVolume, z: usize, border: Border) -> Self {
        let plane = |z| [0, 1].map(|axis| EdgeRows::new(labels, axis, z, border));
        Self { plane: [plane(z), plane(z + 1)], up: EdgeRows::new(labels, 2, z, border) }
    }

    /// The cells of row `y` with a crossing, word `w`.
    pub(super) fn active(&self, y: usize, w: usize) -> u64 {
        let flat = |p: &[EdgeRows; 2]| p[0].word(y, w) | p[0].word(y + 1, w) | p[1].word_or_next(y, w);
        flat(&self.plane[0])
            | flat(&self.plane[1])
            | self.up.word_or_next(y, w)
            | self.up.word_or_next(y + 1, w)
    }
}
