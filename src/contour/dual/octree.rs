//! Bottom-up collapse in a root: clusters of leaves become nodes while error and topology allow it.
//!
//! Level by level, the parts in the eight halves of a block are grouped into clusters by their common
//! crossings. A cluster becomes a node of the next level if it passes the tests of `topology.rs` and its QEF
//! stays within the tolerance at its minimum; only nodes are parts of the next level (the paper's condition
//! that all children are leaves or pseudo-leaves). Reads nothing outside the root but the crossings
//! on its faces.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::leaves::{Leaves, NONE, Root, flag, ring_edge};
use super::qef::{Place, Placement, Qef};
use super::roots::{Block, LEVELS};
use super::topology::{Clusters, Outline, Refusal};
use crate::grid::MaterialId;
use crate::grid::cube::EDGES;

/// When a collapse is admitted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bound {
    /// Never: the unsimplified surface.
    None,
    /// While the root mean square distance of the vertex to the planes of its crossings is at most this,
    /// in voxels of mean edge.
    Rms(f64),
    /// While the sum of squared distances is less than this, in voxels squared: the paper's parameter.
    Sum(f64),
    /// With the root mean square distance that gives about this many triangles.
    Triangles(u64),
}

impl Bound {
    /// Whether an error, summed over `count` planes, is admitted.
    pub(super) fn admits(self, error: f64, count: f64) -> bool {
        match self {
            Self::None | Self::Triangles(_) => false,
            Self::Rms(rms) => error <= rms * rms * count,
            Self::Sum(sum) => error < sum,
        }
    }

    /// The bound for distances that may be `share` times as large.
    pub(super) fn scaled(self, share: f64) -> Self {
        match self {
            Self::Rms(rms) => Self::Rms(share * rms),
            Self::Sum(sum) => Self::Sum(share * share * sum),
            Self::None | Self::Triangles(_) => self,
        }
    }
}

/// A node: a cluster that became one vertex.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    pub(super) block: Block,
    /// The node that it became part of, or [`NONE`].
    pub(super) parent: u32,
    /// In lengths about the middle of its root.
    pub(super) position: Vec3,
}

/// Attempts to collapse, and why they failed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Collapses {
    /// Clusters that became a node.
    pub made: u64,
    /// Refused because the error was above the tolerance.
    pub error: u64,
    /// Refused because a material's part would not have been a disc (V).
    pub disc: u64,
    /// Refused because of the curves on a face of the block (F).
    pub face: u64,
    /// Refused because an edge of the block carries two crossings (E).
    pub edge: u64,
    /// Not tried because a neighbour in the same block had not passed.
    pub neighbour: u64,
    /// Refused because it would have reached two opposite sides of the volume.
    pub border: u64,
}

impl Collapses {
    fn refused(&mut self, refusal: Refusal) {
        *(match refusal {
            Refusal::Disc => &mut self.disc,
            Refusal::Face => &mut self.face,
            Refusal::Edge => &mut self.edge,
            Refusal::Neighbour => &mut self.neighbour,
        }) += 1;
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.made += other.made;
        self.error += other.error;
        self.disc += other.disc;
        self.face += other.face;
        self.edge += other.edge;
        self.neighbour += other.neighbour;
        self.border += other.border;
    }
}

/// What became of a root.
#[derive(Debug, Default)]
pub(super) struct Tree {
    /// Parents and numbers are local to the root.
    pub(super) nodes: Vec<Node>,
    /// The node that each leaf became part of, or [`NONE`].
    pub(super) parents: Vec<u32>,
    pub(super) collapses: Collapses,
}

/// A leaf or node that may become part of a node.
struct Part {
    low: u16,
    crossings: [u32; EDGES],
    /// As in its [`Outline`].
    pair: [MaterialId; 2],
    qef: Qef,
    /// Sides of the volume that it reaches.
    sides: u8,
    /// Leaf or, from level 1 on, node.
    number: u32,
}

/// Collapses a root.
pub(super) fn collapse(leaves: &Leaves, root: &Root, bound: Bound, placement: Placement) -> Tree {
    let tree = Tree { parents: vec![NONE; root.leaves.len()], ..Tree::default() };
    if bound == Bound::None {
        return tree;
    }
    let mut parts = parts_of(leaves, root);
    let (clusters, members) = (Clusters::default(), Vec::new());
    let mut collapser = Collapser { leaves, root, bound, placement, clusters, members, tree };
    for level in 1..=LEVELS {
        let shift = 3 * u32::from(level);
        let mut next = Vec::new();
        for group in parts.chunk_by(|a, b| a.low >> shift == b.low >> shift) {
            let block = Block { low: group[0].low >> shift << shift, level };
            collapser.collapse_block(block, group, &mut next);
        }
        parts = next;
    }
    collapser.tree
}

/// The simple leaves of a root, in order of their cells.
fn parts_of(leaves: &Leaves, root: &Root) -> Vec<Part> {
    let first = root.leaves.start as usize;
    let mut parts: Vec<Part> = root
        .leaves
        .clone()
        .map(|leaf| Part {
            low: leaves.places[leaf as usize],
            crossings: [NONE; EDGES],
            pair: [MaterialId::BACKGROUND; 2],
            qef: Qef::default(),
            sides: leaves.sides(root, leaf),
            number: leaf - root.leaves.start,
        })
        .collect();
    leaves.crossings_of(root, |number, crossing, at| {
        let [a, b] = crossing.labels;
        let pair = [a.min(b), a.max(b)];
        for (i, &leaf) in crossing.ring.iter().enumerate().filter(|(_, l)| root.leaves.contains(l)) {
            let part = &mut parts[leaf as usize - first];
            part.crossings[ring_edge(crossing.axis.into(), i)] = number;
            part.pair = joined(part.pair, pair);
            leaves.add_plane(&mut part.qef, root, leaf, crossing, at);
        }
    });
    parts.retain(|p| leaves.flags[first + p.number as usize] & flag::SIMPLE != 0 && p.qef.count() > 0.0);
    parts
}

/// The materials of two parts together; none yet is twice air.
fn joined(a: [MaterialId; 2], b: [MaterialId; 2]) -> [MaterialId; 2] {
    if a == b || a == [MaterialId::BACKGROUND; 2] { b } else { [MaterialId::OUTSIDE; 2] }
}

/// Collapses the blocks of a root.
struct Collapser<'a> {
    leaves: &'a Leaves,
    root: &'a Root,
    bound: Bound,
    placement: Placement,
    clusters: Clusters,
    /// The parts of the cluster at hand.
    members: Vec<usize>,
    tree: Tree,
}

impl Collapser<'_> {
    /// Groups the parts in a block and makes nodes of the clusters that pass.
    fn collapse_block(&mut self, block: Block, group: &[Part], next: &mut Vec<Part>) {
        let child_of = |part: &Part| (part.low >> (3 * (u32::from(block.level) - 1)) & 7) as u8;
        self.clusters.set(group.iter().map(|p| Outline {
            child: child_of(p),
            crossings: p.crossings,
            pair: p.pair,
        }));
        for cluster in 0..group.len() {
            if self.clusters.cluster(cluster) != cluster {
                continue;
            }
            let Self { clusters, members, .. } = self;
            members.clear();
            members.extend((cluster..group.len()).filter(|&i| clusters.cluster(i) == cluster));
            if let Some(part) = self.make_node(block, cluster, group) {
                next.push(part);
            }
        }
    }

    /// Makes a node of the members if they pass.
    fn make_node(&mut self, block: Block, cluster: usize, group: &[Part]) -> Option<Part> {
        let Self { leaves, root, bound, placement, clusters, members, tree } = self;
        let mut qef = Qef::default();
        let mut sides = 0u8;
        let mut pair = [MaterialId::BACKGROUND; 2];
        for &i in &*members {
            qef.merge(&group[i].qef);
            pair = joined(pair, group[i].pair);
            sides |= group[i].sides;
        }
        // Both bits of an axis.
        if sides & sides >> 1 & 0b01_01_01 != 0 {
            tree.collapses.border += 1;
            return None;
        }
        let (bounds, fixed) = (block.bounds(&leaves.grid), leaves.grid.fixed(root.number, sides));
        let position = placement.vertex(&qef, &Place { bounds, fixed });
        let bound = if pair == [MaterialId::OUTSIDE; 2] { bound.scaled(leaves.closer()) } else { *bound };
        if !bound.admits(qef.error(position), qef.count()) {
            tree.collapses.error += 1;
            return None;
        }
        let labels = |crossing: u32| leaves.crossings[crossing as usize].labels;
        let crossings = match clusters.test(cluster, labels) {
            Ok(crossings) => crossings,
            Err(refusal) => {
                tree.collapses.refused(refusal);
                return None;
            }
        };
        tree.collapses.made += 1;
        let number = tree.nodes.len() as u32;
        for &i in &*members {
            let child = group[i].number as usize;
            if block.level == 1 {
                tree.parents[child] = number;
            } else {
                tree.nodes[child].parent = number;
            }
        }
        tree.nodes.push(Node { block, parent: NONE, position: position.as_vec3() });
        Some(Part { low: block.low, crossings, pair, qef, sides, number })
    }
}
