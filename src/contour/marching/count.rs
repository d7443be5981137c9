//! First pass over a layer: which cells are active, and how much each will write.

use crate::classify::{LabelVolume, WORD};
use crate::contour::crossing::CrossingRule;
use crate::contour::patch::Border;
use crate::contour::pattern::{CellTriangle, PatternTable};
use crate::grid::{MaterialId, Pair};

use super::cell::Cell;
use super::edge_rows::LayerEdges;

/// A cell with a crossing and its table entry.
#[derive(Debug, Clone, Copy)]
pub(super) struct ActiveCell {
    pub(super) x: u16,
    pub(super) y: u16,
    pub(super) entry: u16,
}

/// What a layer of cells will write.
#[derive(Debug)]
pub(super) struct LayerCount {
    /// Crossings on the x and y edges of its lower plane and on its z edges.
    pub(super) crossings: [u32; 3],
    /// Positions (y · row length + x, ascending) of its cells whose lower x, y, z face has a node.
    pub(super) face_nodes: [Vec<u32>; 3],
    /// Vertices inside its cells.
    pub(super) apexes: u32,
    /// Its triangles.
    pub(super) triangles: usize,
    /// Its active cells in row-major order.
    pub(super) cells: Vec<ActiveCell>,
}

impl LayerCount {
    pub(super) fn new<C: CrossingRule>(labels: &LabelVolume, rule: &C, border: Border, z: usize) -> Self {
        let table = PatternTable::get();
        let edges = LayerEdges::new(labels, z, border);
        let [row, rows, _] = labels.codes().padded();
        let crossings = [edges.plane[0][0].total(), edges.plane[0][1].total(), edges.up.total()];
        let mut out =
            Self { crossings, face_nodes: Default::default(), apexes: 0, triangles: 0, cells: Vec::new() };
        for y in 0..rows - 1 {
            for w in 0..labels.codes().words() {
                let mut active = edges.active(y, w);
                while active != 0 {
                    let x = w * WORD + active.trailing_zeros() as usize;
                    active &= active - 1;
                    if x + 1 >= row {
                        break;
                    }
                    let cell = Cell::new(labels, [x, y, z]);
                    let (partition, entry) = cell.entry(table, rule);
                    let surface = table.surface(entry);
                    out.cells.push(ActiveCell { x: x as u16, y: y as u16, entry: entry as u16 });
                    out.apexes += surface.apexes.len() as u32;
                    out.triangles += if cell.is_border() {
                        surface.triangles.iter().filter(|t| pair_of(&cell, t, border).is_some()).count()
                    } else {
                        surface.triangles.len()
                    };
                    let stars = table.star_faces(partition);
                    for (axis, nodes) in out.face_nodes.iter_mut().enumerate() {
                        if stars >> (2 * axis) & 1 == 1 {
                            nodes.push((y * row + x) as u32);
                        }
                    }
                }
            }
        }
        out
    }

    /// Number of vertices that the layer owns.
    pub(super) fn vertices(&self) -> u64 {
        let crossings: u64 = self.crossings.iter().map(|&n| u64::from(n)).sum();
        let nodes: usize = self.face_nodes.iter().map(Vec::len).sum();
        crossings + nodes as u64 + u64::from(self.apexes)
    }
}

/// The pair of a triangle and whether it must be turned over to face its front, or `None` where no
/// triangle is made: between air and `OUTSIDE`, and, with an open border, anything and `OUTSIDE`.
pub(super) fn pair_of(cell: &Cell, triangle: &CellTriangle, border: Border) -> Option<(Pair, bool)> {
    let behind = cell.labels[usize::from(triangle.behind)];
    let ahead = cell.labels[usize::from(triangle.ahead)];
    let pair = Pair::new(behind, ahead)?;
    let dropped = pair.front() == MaterialId::OUTSIDE
        && (border == Border::Open || pair.back() == MaterialId::BACKGROUND);
    (!dropped).then_some((pair, pair.back() != behind))
}
