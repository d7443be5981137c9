//! Leaves and the nodes they became part of, and which of them are vertices now.
//!
//! A leaf's vertex is the highest node above it that was not *split*. Grading and the remedy split nodes that
//! are vertices, so a split node's parents are split too.

use rayon::prelude::*;

use super::leaves::{Leaves, NONE, Root};
use super::octree::{Bound, Collapses, Node, Tree, collapse};
use super::qef::Placement;
use super::roots::Block;
use crate::contour::error::ContourError;
use crate::execution::{Execution, Stage};

/// A leaf or a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Owner {
    Leaf(u32),
    Node(u32),
}

/// The octrees of all roots.
#[derive(Debug, Clone)]
pub(super) struct Forest {
    pub(super) leaves: Leaves,
    /// By root; parents are numbers in this list.
    pub(super) nodes: Vec<Node>,
    /// The first node of each root, and behind the last root the number of all.
    first_nodes: Vec<u32>,
    /// The node that each leaf became part of, or [`NONE`].
    parents: Vec<u32>,
    /// Nodes that are vertices no more.
    split: Vec<bool>,
    pub(super) collapses: Collapses,
}

impl Forest {
    /// Leaves alone.
    pub(super) fn new(leaves: Leaves) -> Self {
        let (first_nodes, parents) = (vec![0; leaves.roots.len() + 1], vec![NONE; leaves.places.len()]);
        let (nodes, split) = (Vec::new(), Vec::new());
        Self { leaves, nodes, first_nodes, parents, split, collapses: Collapses::default() }
    }

    /// Collapses all roots anew.
    pub(super) fn grow(
        &mut self,
        bound: Bound,
        placement: Placement,
        execution: &Execution,
        stage: &Stage<'_>,
    ) -> Result<(), ContourError> {
        let trees: Vec<Tree> = self
            .leaves
            .roots
            .par_iter()
            .map(|root| {
                execution.check()?;
                let tree = collapse(&self.leaves, root, bound, placement);
                stage.advance(1);
                Ok(tree)
            })
            .collect::<Result<_, ContourError>>()?;
        self.nodes = Vec::with_capacity(trees.iter().map(|t| t.nodes.len()).sum());
        self.collapses = Collapses::default();
        for (i, (tree, root)) in trees.iter().zip(&self.leaves.roots).enumerate() {
            let first = self.nodes.len() as u32;
            let global = |n: u32| if n == NONE { NONE } else { n + first };
            self.first_nodes[i] = first;
            self.nodes.extend(tree.nodes.iter().map(|n| Node { parent: global(n.parent), ..*n }));
            let parents = &mut self.parents[root.leaves.start as usize..root.leaves.end as usize];
            parents.iter_mut().zip(&tree.parents).for_each(|(to, &from)| *to = global(from));
            self.collapses.merge(&tree.collapses);
        }
        self.first_nodes[trees.len()] = self.nodes.len() as u32;
        self.split = vec![false; self.nodes.len()];
        Ok(())
    }

    /// What is the vertex of a leaf.
    #[inline]
    pub(super) fn owner(&self, leaf: u32) -> Owner {
        let mut owner = Owner::Leaf(leaf);
        let mut node = self.parents[leaf as usize];
        while node != NONE {
            if !self.split[node as usize] {
                owner = Owner::Node(node);
            }
            node = self.nodes[node as usize].parent;
        }
        owner
    }

    /// The block of a leaf or node.
    pub(super) fn block(&self, owner: Owner) -> Block {
        match owner {
            Owner::Leaf(leaf) => Block { low: self.leaves.places[leaf as usize], level: 0 },
            Owner::Node(node) => self.nodes[node as usize].block,
        }
    }

    /// The level of a leaf's vertex.
    #[inline]
    pub(super) fn level(&self, leaf: u32) -> u8 {
        match self.owner(leaf) {
            Owner::Leaf(_) => 0,
            Owner::Node(node) => self.nodes[node as usize].block.level,
        }
    }

    /// The node that a leaf or node became part of, or [`NONE`].
    pub(super) fn parent(&self, owner: Owner) -> u32 {
        match owner {
            Owner::Leaf(leaf) => self.parents[leaf as usize],
            Owner::Node(node) => self.nodes[node as usize].parent,
        }
    }

    /// Splits a node that is a vertex: its parts become vertices.
    pub(super) fn split(&mut self, node: u32) {
        self.split[node as usize] = true;
    }

    /// The nodes of a root, given by its index.
    pub(super) fn nodes_of(&self, root: usize) -> std::ops::Range<u32> {
        self.first_nodes[root]..self.first_nodes[root + 1]
    }

    /// The root of a node, as an index.
    pub(super) fn root_of_node(&self, node: u32) -> usize {
        self.first_nodes.partition_point(|first| *first <= node) - 1
    }

    /// The roots with their indices.
    pub(super) fn roots(&self) -> impl IndexedParallelIterator<Item = (usize, &Root)> {
        self.leaves.roots.par_iter().enumerate()
    }
}
