//! Vertices that lie elsewhere than on their edge, in their face or in their cell, because a rule knows better.
//!
//! By construction marching puts every vertex where no triangles can meet, whatever the rule says
//! (`docs/contouring.md`). Near curves that costs accuracy: a curve often passes beside the face whose labels ask for it.
//! A [`Wish`] says where such a vertex should lie; [`settle`](super::settle()) grants those of which an exact test shows that no
//! triangles meet, and leaves a table of [`Moves`] for the rule.

use super::crossing::{CrossingRule, Node};
use super::piece::SeamKey;
use crate::grid::MaterialId;

/// Where a vertex should lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wish {
    /// The vertex.
    pub key: SeamKey,
    /// Where it lies by construction, lattice units.
    pub safe: [f32; 3],
    /// Where it should lie, lattice units.
    pub at: [f32; 3],
    /// Standard deviation there, along the normal of the interfaces, voxels of mean edge length.
    pub sigma: f32,
}

/// A wish is granted no farther than this along each axis, lattice units: a vertex that moves by less than one reaches no triangles but
/// those around it.
const FARTHEST: f32 = 0.99;
/// One for more than this is not granted at all: something else is meant.
const TOO_FAR: f32 = 2.0;

impl Wish {
    /// How far it is, along the axis where it is farthest.
    fn distance(&self) -> f32 {
        (0..3).map(|a| (self.at[a] - self.safe[a]).abs()).fold(0.0, f32::max)
    }

    /// Whether it is so near that it may be granted, or a part of it.
    pub(super) fn is_near(&self) -> bool {
        self.distance() < TOO_FAR
    }

    /// Where the vertex lies if as much is granted as may be.
    pub(super) fn most(&self) -> [f32; 3] {
        let distance = self.distance();
        if distance <= FARTHEST {
            return self.at;
        }
        let share = FARTHEST / distance;
        [0, 1, 2].map(|a| self.safe[a] + share * (self.at[a] - self.safe[a]))
    }
}

/// A rule that knows where vertices should lie beyond their safe places. All are told in lattice units: the centre of voxel
/// (x, y, z) is at (x, y, z). Points and cells are of the padded lattice. Must give the same answer whenever asked.
pub trait Wishes: CrossingRule {
    /// Whether the rule may wish anything for the cell whose lowest corner is `low`.
    fn speaks(&self, low: [usize; 3]) -> bool;

    /// For the crossing on the edge from `from` along `axis` between these materials.
    fn crossing(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<Node>;

    /// For the node at `safe` of the face across `axis` whose lowest corner is `low`.
    fn node(&self, low: [usize; 3], axis: usize, safe: [f32; 3]) -> Option<Node>;

    /// For the kink at `safe` of such a face.
    fn kink(&self, low: [usize; 3], axis: usize, safe: [f32; 3]) -> Option<Node>;

    /// The direction in which the interface between two materials faces near a place, from the first to the second; of any length.
    /// `None` if that is not known.
    fn facing(&self, labels: [MaterialId; 2], at: [f32; 3]) -> Option<[f32; 3]>;

    /// For the apex of a cell; `at` is the mean of where its nodes should lie.
    fn apex(&self, low: [usize; 3], at: [f32; 3]) -> Option<Node>;
}

/// A vertex that lies elsewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Move {
    /// The vertex.
    pub key: SeamKey,
    /// Where it lies, lattice units: elsewhere than by construction, or there, but not where it should.
    pub at: [f32; 3],
    /// Its standard deviation, voxels of mean edge length: what is left of the way to where it should lie is part of it.
    pub sigma: f32,
}

/// See the module's header.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Moves(Vec<Move>);

impl Moves {
    /// Of these vertices, in any order.
    pub(super) fn new(mut moves: Vec<Move>) -> Self {
        moves.sort_unstable_by_key(|m| m.key);
        Self(moves)
    }

    /// All, by key.
    #[must_use]
    pub fn all(&self) -> &[Move] {
        &self.0
    }

    /// Those of a kind whose lowest points lie in padded plane `z`.
    pub(super) fn in_plane(&self, kind: u64, z: usize) -> &[Move] {
        let [first, end] = [z, z + 1].map(|z| {
            let key = SeamKey::new(kind, [0, 0, z]);
            self.0.partition_point(|m| m.key < key)
        });
        &self.0[first..end]
    }

    /// The move of a vertex.
    pub(super) fn get(&self, key: SeamKey) -> Option<&Move> {
        self.0.binary_search_by_key(&key, |m| m.key).ok().map(|i| &self.0[i])
    }
}
