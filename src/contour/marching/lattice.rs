//! What the lattice holds for contouring: the vertices in a plane, and those between two planes.
//!
//! The vertices in a plane depend on the samples and labels of that plane alone, so the layers on both
//! sides, and the pieces on both sides of a seam, number them alike.

use super::bit_rows::BitRows;
use super::code_rows::{CodeRow, crossed, shifted, starred};
use crate::classify::LabelVolume;
use crate::contour::patch::Border;

/// The vertices in plane `z`, numbered in this order.
#[derive(Debug)]
pub(super) struct Plane {
    pub(super) z: usize,
    /// Crossings of x edges and of y edges.
    pub(super) edges: [BitRows; 2],
    /// Nodes of z faces.
    pub(super) nodes: BitRows,
}

impl Plane {
    pub(super) fn new(labels: &LabelVolume, border: Border, z: usize) -> Self {
        let (codes, outside) = (labels.codes(), labels.materials());
        let (rows, words, planes) = (codes.padded()[1], codes.words(), codes.count());
        let row = |y: usize| CodeRow::new(labels, y, z);
        let x_edges = by_rows(words, rows, rows, row, |a, w| {
            crossed(planes, outside, border, |p| [a.word(p, w), a.next(p, w)])
        });
        let two_rows = |y: usize| [row(y), row(y + 1)];
        let y_edges = by_rows(words, rows, rows - 1, two_rows, |[a, b], w| {
            crossed(planes, outside, border, |p| [a.word(p, w), b.word(p, w)])
        });
        let nodes = BitRows::new(words, rows, |y, out| {
            if y + 1 == rows {
                return;
            }
            let [a, b] = two_rows(y);
            // At least one side of a star is a crossing that is needed.
            let (x, x_above, sides) = (x_edges.row(y), x_edges.row(y + 1), y_edges.row(y));
            for (w, out) in out.iter_mut().enumerate() {
                if x[w] | x_above[w] | sides[w] | shifted(sides, w) != 0 {
                    *out = starred(planes, |p| [a.word(p, w), a.next(p, w), b.next(p, w), b.word(p, w)]);
                }
            }
        });
        Self { z, edges: [x_edges, y_edges], nodes }
    }

    /// Number of vertices.
    pub(super) fn vertices(&self) -> u32 {
        self.edges[0].total() + self.edges[1].total() + self.nodes.total()
    }
}

/// The vertices between plane `z` and the next, but for those inside cells, numbered in this order.
#[derive(Debug)]
pub(super) struct Between {
    pub(super) z: usize,
    /// Crossings of z edges.
    pub(super) edges: BitRows,
    /// Nodes of x faces and of y faces.
    pub(super) nodes: [BitRows; 2],
}

impl Between {
    pub(super) fn new(labels: &LabelVolume, border: Border, z: usize) -> Self {
        let (codes, outside) = (labels.codes(), labels.materials());
        let (rows, words, planes) = (codes.padded()[1], codes.words(), codes.count());
        let row = |y: usize| [CodeRow::new(labels, y, z), CodeRow::new(labels, y, z + 1)];
        let edges = by_rows(words, rows, rows, row, |[a, b], w| {
            crossed(planes, outside, border, |p| [a.word(p, w), b.word(p, w)])
        });
        let two_rows = |y: usize| [row(y), row(y + 1)];
        let x_nodes = by_rows(words, rows, rows - 1, two_rows, |[[a, d], [b, c]], w| {
            starred(planes, |p| [a.word(p, w), b.word(p, w), c.word(p, w), d.word(p, w)])
        });
        let y_nodes = by_rows(words, rows, rows, row, |[a, b], w| {
            starred(planes, |p| [a.word(p, w), a.next(p, w), b.next(p, w), b.word(p, w)])
        });
        Self { z, edges, nodes: [x_nodes, y_nodes] }
    }

    /// Number of vertices.
    pub(super) fn vertices(&self) -> u32 {
        self.edges.total() + self.nodes[0].total() + self.nodes[1].total()
    }
}

/// Bits made row by row from what `row` finds for each of the first `used` rows; the others are empty.
fn by_rows<R>(
    words: usize,
    rows: usize,
    used: usize,
    row: impl Fn(usize) -> R,
    word: impl Fn(&R, usize) -> u64,
) -> BitRows {
    BitRows::new(words, rows, |y, out| {
        if y < used {
            let row = row(y);
            out.iter_mut().enumerate().for_each(|(w, out)| *out = word(&row, w));
        }
    })
}

/// A layer of cells: its two planes and what is between them.
#[derive(Clone, Copy)]
pub(super) struct Layer<'a> {
    pub(super) lower: &'a Plane,
    pub(super) between: &'a Between,
    pub(super) upper: &'a Plane,
}

impl Layer<'_> {
    /// The cells of row `y` that have a crossing, word by word.
    pub(super) fn active(&self, y: usize, words: &mut Vec<u64>) {
        let (lower, upper, up) = (&self.lower.edges, &self.upper.edges, &self.between.edges);
        words.clear();
        // Edges along y and z belong to the cells on both their sides along x.
        let both = lower[1].row(y).iter().zip(upper[1].row(y)).zip(up.row(y)).zip(up.row(y + 1));
        words.extend(both.map(|(((a, b), c), d)| a | b | c | d));
        for w in 0..words.len() {
            let along =
                lower[0].row(y)[w] | lower[0].row(y + 1)[w] | upper[0].row(y)[w] | upper[0].row(y + 1)[w];
            words[w] = words[w] | shifted(words, w) | along;
        }
    }
}
