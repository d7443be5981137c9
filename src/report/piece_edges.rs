//! The edges worth a line of a mesh that comes in pieces.
//!
//! What an edge is depends on all of its triangles, so its uses are kept until no later piece can touch it. Only
//! edges between vertices that are not inside an interface are looked at: where three materials meet, or on the
//! border of the volume, where a surface may end.

use glam::DVec3;
use rayon::prelude::*;

use super::edges::{EdgeMark, mark_of};
use crate::grid::{Pair, VertexKind};
use crate::mesh::MeshPiece;

/// A triangle's use of an edge.
#[derive(Debug, Clone, Copy)]
struct Use {
    /// Vertices in the whole mesh, the lower one first.
    ends: [u64; 2],
    /// Where they lie.
    at: [DVec3; 2],
    pair: Pair,
}

/// Finds the marked edges piece by piece.
#[derive(Debug, Default)]
pub(super) struct PieceEdges {
    /// Uses of edges that later pieces can touch.
    pending: Vec<Use>,
    marked: Vec<(EdgeMark, [DVec3; 2])>,
}

impl PieceEdges {
    /// Adds the next piece. Edges are marked if `shown` says yes to one of their triangles.
    pub(super) fn add(&mut self, piece: &MeshPiece, shown: impl Fn(Pair) -> bool) {
        let (mesh, first) = (&piece.mesh, piece.first_vertex);
        let matters = |v: u32| mesh.kinds()[v as usize] != VertexKind::Interface;
        let triangles = mesh.triangles().par_iter().zip(mesh.pairs());
        self.pending.par_extend(triangles.flat_map_iter(|(&[a, b, c], &pair)| {
            let edges = [(a, b), (b, c), (c, a)].into_iter().filter(|&(p, q)| matters(p) && matters(q));
            edges.map(move |(p, q)| {
                let ends = [p.min(q), p.max(q)];
                let at = ends.map(|v| mesh.positions()[v as usize]);
                Use { ends: ends.map(|v| first + u64::from(v)), at, pair }
            })
        }));
        self.settle(first + piece.last_layer[0] as u64, shown);
    }

    /// All marked edges, with their ends in the world.
    pub(super) fn finish(mut self, shown: impl Fn(Pair) -> bool) -> Vec<(EdgeMark, [DVec3; 2])> {
        self.settle(u64::MAX, shown);
        self.marked
    }

    /// Marks edges whose lower vertex is below `frontier`, which nothing touches any more.
    fn settle(&mut self, frontier: u64, shown: impl Fn(Pair) -> bool) {
        self.pending.par_sort_by_key(|u| u.ends);
        let done = self.pending.partition_point(|u| u.ends[0] < frontier);
        for edge in self.pending[..done].chunk_by(|a, b| a.ends == b.ends) {
            if edge.iter().any(|u| shown(u.pair))
                && let Some(mark) = mark_of(edge.iter().map(|u| u.pair))
            {
                self.marked.push((mark, edge[0].at));
            }
        }
        self.pending.drain(..done);
    }
}
