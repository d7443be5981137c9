//! The edges worth a line: junction curves, the border of the volume, open edges.

use rayon::prelude::*;

use crate::grid::MaterialId;
use crate::mesh::InterfaceMesh;

/// Why an edge is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum EdgeMark {
    /// Three or more materials meet, one of them is the world beyond the volume.
    Border,
    /// Three or more materials meet.
    Junction,
    /// Only one triangle has this edge.
    Open,
}

/// An edge worth a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct MarkedEdge {
    /// Its vertices, the lower index first.
    pub(super) vertices: [u32; 2],
    /// Why.
    pub(super) mark: EdgeMark,
}

/// All marked edges with a triangle for which `shown` says yes, by ascending vertices. What an edge is
/// depends on all of its triangles, shown or not.
pub(super) fn marked_edges(mesh: &InterfaceMesh, shown: impl Fn(usize) -> bool + Sync) -> Vec<MarkedEdge> {
    let incidence = Incidence::of(mesh);
    let pairs = mesh.pairs();
    (0..mesh.positions().len())
        .into_par_iter()
        .fold(Vec::new, |mut found, low| {
            let mut around: Vec<(u32, u32)> = incidence.around(low).to_vec();
            around.sort_unstable();
            for edge in around.chunk_by(|a, b| a.0 == b.0) {
                if !edge.iter().any(|&(_, t)| shown(t as usize)) {
                    continue;
                }
                let triangles = edge.iter().map(|&(_, t)| pairs[t as usize]);
                if let Some(mark) = mark_of(triangles) {
                    found.push(MarkedEdge { vertices: [low as u32, edge[0].0], mark });
                }
            }
            found
        })
        // An ordered concatenation: rayon reduces neighbours only, left to right.
        .reduce(Vec::new, |mut a, mut b| {
            a.append(&mut b);
            a
        })
}

/// What an edge with triangles of these pairs is.
pub(super) fn mark_of(pairs: impl ExactSizeIterator<Item = crate::grid::Pair>) -> Option<EdgeMark> {
    if pairs.len() == 1 {
        return Some(EdgeMark::Open);
    }
    let mut materials: [Option<MaterialId>; 3] = [None; 3];
    let mut outside = false;
    for id in pairs.flat_map(|p| [p.back(), p.front()]) {
        outside |= id == MaterialId::OUTSIDE;
        for slot in &mut materials {
            if slot.is_none() {
                *slot = Some(id);
            }
            if *slot == Some(id) {
                break;
            }
        }
    }
    match (materials[2].is_some(), outside) {
        (false, _) => None,
        (true, false) => Some(EdgeMark::Junction),
        (true, true) => Some(EdgeMark::Border),
    }
}

/// For every vertex its edges to higher vertices, once per triangle: (higher vertex, triangle).
struct Incidence {
    starts: Vec<usize>,
    entries: Vec<(u32, u32)>,
}

impl Incidence {
    fn of(mesh: &InterfaceMesh) -> Self {
        let edges = |t: &[u32; 3]| {
            let [a, b, c] = *t;
            [(a, b), (b, c), (c, a)].map(|(p, q)| (p.min(q), p.max(q)))
        };
        // Count, then allocate, then fill.
        let mut starts = vec![0usize; mesh.positions().len() + 1];
        for (low, _) in mesh.triangles().iter().flat_map(edges) {
            starts[low as usize + 1] += 1;
        }
        for v in 1..starts.len() {
            starts[v] += starts[v - 1];
        }
        let mut next = starts.clone();
        let mut entries = vec![(0, 0); 3 * mesh.triangles().len()];
        for (t, triangle) in mesh.triangles().iter().enumerate() {
            for (low, high) in edges(triangle) {
                let slot = &mut next[low as usize];
                entries[*slot] = (high, t as u32);
                *slot += 1;
            }
        }
        Self { starts, entries }
    }

    fn around(&self, low: usize) -> &[(u32, u32)] {
        &self.entries[self.starts[low]..self.starts[low + 1]]
    }
}
