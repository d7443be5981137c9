//! Which triangles use which edge: one pass over the corners, linear in time and memory.
//!
//! Every undirected edge is filed under its lower vertex id and, there, sorted by its higher one and
//! by triangle. So the order of edges and of the triangles round one depends on the mesh alone.

use std::ops::Range;

use super::filed::Filed;

/// A triangle's use of an edge.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct EdgeUse {
    /// The edge's higher vertex id.
    pub(crate) high: u32,
    /// The triangle, shifted left by one, plus 1 if it runs through the edge from high to low.
    code: u32,
}

impl EdgeUse {
    /// The triangle that uses the edge.
    pub(crate) fn triangle(self) -> usize {
        (self.code >> 1) as usize
    }

    /// Whether the triangle runs through the edge from its lower to its higher vertex id.
    pub(crate) fn is_forward(self) -> bool {
        self.code & 1 == 0
    }
}

/// All edges of a triangle list; see the module header. Edges from a vertex to itself (of triangles
/// that repeat a vertex) are left out.
pub(crate) struct EdgeTable(Filed<EdgeUse>);

/// How many vertices one parallel task handles.
const CHUNK: usize = if cfg!(test) { 1 << 4 } else { 1 << 14 };

/// The most triangles a table can hold, as a use keeps one bit for the direction.
pub(crate) const MAX_TRIANGLES: usize = 1 << 31;

impl EdgeTable {
    /// The edges of `triangles` over `vertices` vertices; triangles beyond [`MAX_TRIANGLES`] are
    /// not possible in a mesh whose indices are 32 bit and which shares vertices at all.
    pub(crate) fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        debug_assert!(triangles.len() <= MAX_TRIANGLES);
        let filed = Filed::new(vertices, triangles, |t, &[a, b, c]| {
            [[a, b], [b, c], [c, a]].map(|[a, b]| {
                let code = ((t as u32) << 1) | u32::from(a > b);
                (a != b).then(|| (a.min(b), EdgeUse { high: a.max(b), code }))
            })
        });
        Self(filed)
    }

    /// The edges whose lower vertex is `low`, each with its uses, by ascending higher vertex.
    pub(crate) fn edges_of(&self, low: usize) -> impl Iterator<Item = (u32, &[EdgeUse])> {
        self.0.of(low).chunk_by(|a, b| a.high == b.high).map(|uses| (uses[0].high, uses))
    }

    /// The uses of the edge between two vertices; empty if there is no such edge.
    pub(crate) fn uses(&self, a: u32, b: u32) -> &[EdgeUse] {
        let (low, high) = (a.min(b) as usize, a.max(b));
        let all = self.0.of(low);
        let first = all.partition_point(|u| u.high < high);
        let last = all.partition_point(|u| u.high <= high);
        &all[first..last]
    }

    /// Cuts lower vertices into ranges to hand to parallel tasks: their bounds do not depend on threads.
    pub(crate) fn chunks(lows: Range<usize>) -> Vec<Range<usize>> {
        lows.clone().step_by(CHUNK).map(|first| first..(first + CHUNK).min(lows.end)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_found_with_their_triangles_and_directions() {
        let table = EdgeTable::new(5, &[[0, 1, 2], [2, 1, 3], [4, 4, 1]]);
        let edges = |low| table.edges_of(low).map(move |(high, uses)| (low as u32, high, uses));
        let all: Vec<_> = (0..5)
            .flat_map(edges)
            .map(|(a, b, uses)| {
                (a, b, uses.iter().map(|u| (u.triangle(), u.is_forward())).collect::<Vec<_>>())
            })
            .collect();
        assert_eq!(
            all,
            vec![
                (0, 1, vec![(0, true)]),
                (0, 2, vec![(0, false)]),
                (1, 2, vec![(0, true), (1, false)]),
                (1, 3, vec![(1, true)]),
                (1, 4, vec![(2, false), (2, true)]),
                (2, 3, vec![(1, false)]),
            ]
            .into_iter()
            .map(|(a, b, mut u)| {
                u.sort_by_key(|&(t, f)| (t, !f));
                (a, b, u)
            })
            .collect::<Vec<_>>()
        );
        assert_eq!(table.uses(2, 1).len(), 2);
        assert!(table.uses(0, 4).is_empty());
    }
}
