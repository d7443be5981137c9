//! What the lattice holds for contouring: the vertices in a plane, and those between two planes.
//!
//! The vertices in a plane depend on the samples and labels of that plane alone, so the layers on both
//! sides, and the pieces on both sides of a seam, number them alike.

use super::bit_rows::BitRows;
use super::code_rows::{BLOCK, Block, CodeSlice, crossed, plain, shifted, starred};
use super::corners::{Corners, visit_cells};
use super::count::entry;
use super::kinks::kinked;
use crate::classify::LabelVolume;
use crate::contour::crossing::CrossingRule;
use crate::contour::patch::Border;
use crate::contour::pattern::PatternTable;

/// The vertices in plane `z`, numbered in this order.
#[derive(Debug)]
pub(super) struct Plane {
    pub(super) z: usize,
    /// Crossings of x edges and of y edges.
    pub(super) edges: [BitRows; 2],
    /// Nodes of z faces.
    pub(super) nodes: BitRows,
    /// Kinks of z faces; empty if the rule knows none.
    pub(super) kinks: BitRows,
}

impl Plane {
    pub(super) fn new<C: CrossingRule + ?Sized>(
        labels: &LabelVolume,
        rule: &C,
        border: Border,
        z: usize,
    ) -> Self {
        // Wide instructions, and one that counts bits, where the processor has them.
        let mut made = pulp::Arch::new().dispatch(|| Self::make(labels, border, z));
        if rule.has_kinks() {
            made.kinks = kinked(labels, rule, 2, z);
        }
        made
    }

    #[inline(always)]
    fn make(labels: &LabelVolume, border: Border, z: usize) -> Self {
        let (codes, outside) = (labels.codes(), labels.materials());
        let (rows, words, planes) = (codes.padded()[1], codes.words(), codes.count());
        let at = CodeSlice::new(labels, z);
        let x_edges = by_blocks(words, rows, rows, |i| {
            crossed(planes, outside, border, |p| [at.block(p, i), at.next_block(p, i)])
        });
        let y_edges = by_blocks(words, rows, rows - 1, |i| {
            crossed(planes, outside, border, |p| [at.block(p, i), at.block(p, i + words)])
        });
        let nodes = face_rows(labels, 2, z, Faces::Starred);
        Self { z, edges: [x_edges, y_edges], nodes, kinks: BitRows::default() }
    }

    /// Number of vertices.
    pub(super) fn vertices(&self) -> u32 {
        self.edges[0].total() + self.edges[1].total() + self.nodes.total() + self.kinks.total()
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
    /// Kinks of x faces and of y faces; empty if the rule knows none.
    pub(super) kinks: [BitRows; 2],
}

impl Between {
    pub(super) fn new<C: CrossingRule + ?Sized>(
        labels: &LabelVolume,
        rule: &C,
        border: Border,
        z: usize,
    ) -> Self {
        let mut made = pulp::Arch::new().dispatch(|| Self::make(labels, border, z));
        if rule.has_kinks() {
            made.kinks = [0, 1].map(|axis| kinked(labels, rule, axis, z));
        }
        made
    }

    #[inline(always)]
    fn make(labels: &LabelVolume, border: Border, z: usize) -> Self {
        let (codes, outside) = (labels.codes(), labels.materials());
        let (rows, words, planes) = (codes.padded()[1], codes.words(), codes.count());
        let [low, up] = [z, z + 1].map(|z| CodeSlice::new(labels, z));
        let edges = by_blocks(words, rows, rows, |i| {
            crossed(planes, outside, border, |p| [low.block(p, i), up.block(p, i)])
        });
        let [x_nodes, y_nodes] = [0, 1].map(|axis| face_rows(labels, axis, z, Faces::Starred));
        Self { z, edges, nodes: [x_nodes, y_nodes], kinks: Default::default() }
    }

    /// Number of vertices.
    pub(super) fn vertices(&self) -> u32 {
        let [x, y] = [0, 1].map(|axis| self.nodes[axis].total() + self.kinks[axis].total());
        self.edges.total() + x + y
    }
}

/// Which faces of the lattice.
#[derive(Debug, Clone, Copy)]
pub(super) enum Faces {
    /// Those with a node.
    Starred,
    /// Those that may have a kink.
    Plain,
}

/// The bits of some faces across `axis` with lowest corners in plane `z`.
#[inline(always)]
pub(super) fn face_rows(labels: &LabelVolume, axis: usize, z: usize, which: Faces) -> BitRows {
    let (codes, outside) = (labels.codes(), labels.materials());
    let (rows, words, planes) = (codes.padded()[1], codes.words(), codes.count());
    let low = CodeSlice::new(labels, z);
    let up = if axis == 2 { low } else { CodeSlice::new(labels, z + 1) };
    let used = if axis == 1 { rows } else { rows - 1 };
    by_blocks(words, rows, used, |i| {
        let next = i + words;
        let ring = |p: usize| match axis {
            0 => [low.block(p, i), up.block(p, i), up.block(p, next), low.block(p, next)],
            1 => [low.block(p, i), low.next_block(p, i), up.next_block(p, i), up.block(p, i)],
            _ => [low.block(p, i), low.next_block(p, i), low.next_block(p, next), low.block(p, next)],
        };
        match which {
            Faces::Starred => starred(planes, ring),
            Faces::Plain => plain(planes, outside, ring),
        }
    })
}

/// Bits of the first `used` rows; `block` makes the words from a given one on. Other rows are empty.
#[inline(always)]
fn by_blocks(words: usize, rows: usize, used: usize, block: impl Fn(usize) -> Block) -> BitRows {
    BitRows::new(words, rows, |bits| {
        let bits = &mut bits[..used * words];
        for i in (0..bits.len()).step_by(BLOCK) {
            let made = block(i);
            let rest = &mut bits[i..];
            match rest.first_chunk_mut() {
                Some(out) => *out = made,
                None => rest.iter_mut().zip(made).for_each(|(out, word)| *out = word),
            }
        }
    })
}

/// A layer of cells: its two planes and what is between them.
#[derive(Clone, Copy)]
pub(in crate::contour) struct Layer<'a> {
    pub(super) lower: &'a Plane,
    pub(super) between: &'a Between,
    pub(super) upper: &'a Plane,
}

impl Layer<'_> {
    /// Its number.
    pub(in crate::contour) fn z(&self) -> usize {
        self.lower.z
    }

    /// The faces of cell (x, y) that have a kink, as a bit set. To be asked only if the rule knows kinks.
    #[inline]
    pub(super) fn kinks(&self, x: usize, y: usize) -> u8 {
        let [x_faces, y_faces] = &self.between.kinks;
        let has = [
            x_faces.has(x, y),
            x_faces.has(x + 1, y),
            y_faces.has(x, y),
            y_faces.has(x, y + 1),
            self.lower.kinks.has(x, y),
            self.upper.kinks.has(x, y),
        ];
        has.into_iter().enumerate().fold(0, |set, (f, has)| set | u8::from(has) << f)
    }

    /// Calls `visit` with x, y, corners and the table's entry of each cell that has a crossing, row by row.
    #[inline]
    pub(in crate::contour) fn visit<C: CrossingRule + ?Sized>(
        &self,
        labels: &LabelVolume,
        rule: &C,
        table: &PatternTable,
        mut visit: impl FnMut([usize; 2], Corners, usize),
    ) {
        let z = self.z();
        let mut active = Vec::new();
        for y in 0..labels.codes().padded()[1] - 1 {
            self.active(y, &mut active);
            visit_cells(labels, [y, z], &active, |x, corners| {
                visit([x, y], corners, entry(labels, rule, table, [x, y, z], corners).0);
            });
        }
    }

    /// The cells of row `y` that have a crossing, word by word.
    #[inline]
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
