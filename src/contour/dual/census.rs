//! What the octree and the surface consist of, for the report.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::forest::{Forest, Owner};
use super::polygons::mapped;
use super::roots::place;
use super::vertices::Vertices;
use crate::contour::patch::Border;
use crate::grid::Pair;

/// Nodes of the octree by type (Li et al. 2022, table 1). The root is the smallest power of two of cells that
/// holds the volume.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeCounts {
    /// Inner nodes: blocks that hold smaller nodes.
    pub inner: u64,
    /// Leaves: sheets of a cell that were not collapsed.
    pub leaf: u64,
    /// Pseudo-leaves: clusters that became one vertex.
    pub pseudo_leaf: u64,
}

/// Polygons of an interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct PairPolygons {
    /// Its materials.
    pub pair: Pair,
    /// Crossings, each of which has a polygon in the unsimplified surface.
    pub crossings: u64,
    /// Polygons that are left.
    pub polygons: u64,
}

/// Counts the nodes.
pub(super) fn nodes(forest: &Forest, vertices: &Vertices) -> NodeCounts {
    let grid = &forest.leaves.grid;
    let mut blocks: Vec<(u64, u8)> = vertices
        .all
        .par_iter()
        .map(|v| {
            let (low, block) = (grid.low(forest.leaves.roots[v.root as usize].number), forest.block(v.owner));
            let at = place(block.low);
            (interleave([0, 1, 2].map(|a| (low[a] + at[a]) as u64)), block.level)
        })
        .collect();
    blocks.par_sort_unstable();
    blocks.dedup();
    let largest = grid.cells.into_iter().max().unwrap_or(1);
    let depth = largest.next_power_of_two().trailing_zeros() as u8;
    let mut inner = 0;
    for level in 1..=depth {
        let mut last = None;
        for (at, own) in &blocks {
            let block = Some(at >> (3 * u32::from(level)));
            if *own < level && block != last {
                inner += 1;
                last = block;
            }
        }
    }
    let leaf = vertices.all.iter().filter(|v| matches!(v.owner, Owner::Leaf(_))).count() as u64;
    NodeCounts { inner, leaf, pseudo_leaf: vertices.all.len() as u64 - leaf }
}

/// Counts crossings and polygons of each pair, by ascending pair.
pub(super) fn polygons(forest: &Forest, vertices: &Vertices, border: Border) -> Vec<PairPolygons> {
    let by_root: Vec<Vec<PairPolygons>> = forest
        .roots()
        .map(|(_, root)| {
            let mut counts: Vec<PairPolygons> = Vec::new();
            for c in root.crossings.clone() {
                let crossing = &forest.leaves.crossings[c as usize];
                let Some((pair, _)) = crossing.pair(border) else { continue };
                let polygons = u64::from(mapped(vertices, crossing.ring).1 >= 3);
                match counts.iter_mut().find(|n| n.pair == pair) {
                    Some(n) => {
                        n.crossings += 1;
                        n.polygons += polygons;
                    }
                    None => counts.push(PairPolygons { pair, crossings: 1, polygons }),
                }
            }
            counts
        })
        .collect();
    let mut all: Vec<PairPolygons> = by_root.into_iter().flatten().collect();
    all.sort_unstable_by_key(|n| n.pair);
    all.chunk_by(|a, b| a.pair == b.pair)
        .map(|same| PairPolygons {
            pair: same[0].pair,
            crossings: same.iter().map(|n| n.crossings).sum(),
            polygons: same.iter().map(|n| n.polygons).sum(),
        })
        .collect()
}

/// Triangles that the polygons will have, but for knots.
pub(super) fn triangles(forest: &Forest, vertices: &Vertices, border: Border) -> u64 {
    forest
        .roots()
        .map(|(_, root)| {
            let of = |c: u32| {
                let crossing = &forest.leaves.crossings[c as usize];
                let corners = crossing.pair(border).map_or(0, |_| mapped(vertices, crossing.ring).1);
                corners.saturating_sub(2) as u64
            };
            root.crossings.clone().map(of).sum::<u64>()
        })
        .sum()
}

/// Interleaves the bits of three coordinates of up to 21 bits.
fn interleave(at: [u64; 3]) -> u64 {
    (0..21)
        .fold(0, |code, bit| (0..3).fold(code, |code, a| code | (at[a] >> bit & 1) << (3 * bit + a as u32)))
}
