//! Faces where the surface needs a vertex of its own: where a star's spokes lead to different leaves of a
//! cell (caps), or where two curves of a sheet lead to the same two vertices, so that two different mesh
//! edges would have the same ends.

use std::collections::BTreeMap;

use super::leaves::{Knot, Leaves, Pass, Tie, ring_edge, ring_face_axis};
use crate::contour::marching::pair_of;
use crate::contour::patch::Border;
use crate::contour::pattern::{FaceKnot, PatternTable};
use crate::grid::MaterialId;
use crate::grid::cube::{CORNERS, EDGES};

/// A cell with faces that are not simple.
#[derive(Debug, Clone, Copy)]
pub(super) struct OddCell {
    pub(super) entry: u16,
    pub(super) first_leaf: u32,
    pub(super) labels: [MaterialId; CORNERS],
}

/// A cell edge's crossing, and the cell's number in its ring.
type Found = Option<(u32, u8)>;

/// The knots of a surface, and the triangles of caps. `cells` are in order of their leaves.
pub(super) fn knots(leaves: &Leaves, table: &PatternTable, cells: &[OddCell]) -> (Vec<Knot>, Vec<Tie>) {
    let crossings = crossings_of_cells(leaves, table, cells);
    // Both cells of a face may ask for the same knots.
    let mut numbers = BTreeMap::<Vec<Pass>, u32>::new();
    let mut knots: Vec<Knot> = Vec::new();
    let mut ties = Vec::new();
    for (cell, crossings) in cells.iter().zip(&crossings) {
        let entry = table.leaves(cell.entry.into());
        let passes = |edges: &[u8], face: u8| {
            let mut passes: Vec<Pass> = edges
                .iter()
                .filter_map(|&e| Some((e, crossings[usize::from(e)]?)))
                .map(|(e, (crossing, at))| (crossing, pass(usize::from(e) / 4, at, usize::from(face) / 2)))
                .collect();
            passes.sort_unstable();
            passes
        };
        let mut number = |passes: Vec<Pass>| {
            *numbers.entry(passes).or_insert_with_key(|passes| {
                knots.push(Knot { passes: passes.clone(), twin: None });
                knots.len() as u32 - 1
            })
        };
        let mut torn = [None; 6];
        let mut twins = Vec::new();
        for knot in &entry.knots {
            match knot {
                FaceKnot::Torn { face, spokes } => {
                    torn[usize::from(*face)] = Some(number(passes(spokes, *face)));
                }
                FaceKnot::Double { face, curves } => {
                    twins.push([0, 1].map(|i| number(passes(&curves[i], *face))));
                }
            }
        }
        for [a, b] in twins {
            knots[a as usize].twin = Some(b);
            knots[b as usize].twin = Some(a);
        }
        for tie in &entry.ties {
            let sides = [tie.behind, tie.ahead].map(|c| cell.labels[usize::from(c)]);
            let Some((pair, turned)) = pair_of(sides, Border::Closed) else { continue };
            let Some(knot) = torn[usize::from(tie.face)] else { continue };
            let [main, cap] = tie.leaves.map(|l| cell.first_leaf + u32::from(l));
            let leaves = if turned { [cap, main] } else { [main, cap] };
            ties.push(Tie { knot, leaves, pair });
        }
    }
    (knots, ties)
}

/// Between which cells of the ring of a crossing along `axis` lies the face across `face_axis` of ring cell
/// `at`.
fn pass(axis: usize, at: u8, face_axis: usize) -> u8 {
    // Each ring cell has one face across each of the two other axes in the ring.
    if ring_face_axis(axis, usize::from(at)) == face_axis { at } else { (at + 3) % 4 }
}

/// The crossings on the edges of each cell.
fn crossings_of_cells(leaves: &Leaves, table: &PatternTable, cells: &[OddCell]) -> Vec<[Found; EDGES]> {
    let mut out = vec![[None; EDGES]; cells.len()];
    let mut start = 0;
    for root in &leaves.roots {
        let count = cells[start..].partition_point(|c| c.first_leaf < root.leaves.end);
        let own = &cells[start..start + count];
        if !own.is_empty() {
            leaves.crossings_of(root, |number, crossing, _| {
                for (k, &leaf) in crossing.ring.iter().enumerate() {
                    let Some(i) = own.partition_point(|c| c.first_leaf <= leaf).checked_sub(1) else {
                        continue;
                    };
                    let last = own[i].first_leaf + table.leaves(own[i].entry.into()).leaves.len() as u32;
                    if leaf < last {
                        out[start + i][ring_edge(usize::from(crossing.axis), k)] = Some((number, k as u8));
                    }
                }
            });
        }
        start += count;
    }
    out
}
