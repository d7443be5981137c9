//! Which triangles use which edge: one pass over the corners, linear in time and memory.
//!
//! Every undirected edge is filed under its lower vertex id and, there, sorted by its higher one and
//! by triangle. So the order of edges and of the triangles round one depends on the mesh alone.

use rayon::prelude::*;

/// A triangle's use of an edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
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
pub(crate) struct EdgeTable {
    /// `start[v]..start[v + 1]` are the uses of edges whose lower vertex is `v`.
    start: Vec<usize>,
    uses: Vec<EdgeUse>,
}

/// How many vertices one parallel task handles.
const CHUNK: usize = 1 << 14;

/// The most triangles a table can hold, as a use keeps one bit for the direction.
pub(crate) const MAX_TRIANGLES: usize = 1 << 31;

impl EdgeTable {
    /// The edges of `triangles` over `vertices` vertices; triangles beyond [`MAX_TRIANGLES`] are
    /// not possible in a mesh whose indices are 32 bit and which shares vertices at all.
    pub(crate) fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        debug_assert!(triangles.len() <= MAX_TRIANGLES);
        let mut start = vec![0usize; vertices + 1];
        let edges = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
        for triangle in triangles {
            for [a, b] in edges(triangle) {
                if a != b {
                    start[a.min(b) as usize + 1] += 1;
                }
            }
        }
        for v in 0..vertices {
            start[v + 1] += start[v];
        }
        let mut next = start.clone();
        let mut uses = vec![EdgeUse { high: 0, code: 0 }; start[vertices]];
        for (t, triangle) in triangles.iter().enumerate() {
            for [a, b] in edges(triangle) {
                if a != b {
                    let slot = &mut next[a.min(b) as usize];
                    uses[*slot] = EdgeUse { high: a.max(b), code: ((t as u32) << 1) | u32::from(a > b) };
                    *slot += 1;
                }
            }
        }
        drop(next);
        let mut table = Self { start, uses };
        table.sort();
        table
    }

    fn sort(&mut self) {
        let chunks = self.chunks();
        let start = &self.start;
        let mut rest = self.uses.as_mut_slice();
        let mut tasks = Vec::with_capacity(chunks.len());
        for lows in chunks {
            let (head, tail) = rest.split_at_mut(start[lows.end] - start[lows.start]);
            tasks.push((head, lows));
            rest = tail;
        }
        tasks.into_par_iter().for_each(|(uses, lows)| {
            let first = start[lows.start];
            for low in lows {
                uses[start[low] - first..start[low + 1] - first].sort_unstable();
            }
        });
    }

    /// Number of vertices the table was made for.
    pub(crate) fn vertices(&self) -> usize {
        self.start.len() - 1
    }

    /// The edges whose lower vertex is `low`, each with its uses, by ascending higher vertex.
    pub(crate) fn edges_of(&self, low: usize) -> impl Iterator<Item = (u32, &[EdgeUse])> {
        self.uses[self.start[low]..self.start[low + 1]]
            .chunk_by(|a, b| a.high == b.high)
            .map(|uses| (uses[0].high, uses))
    }

    /// The uses of the edge between two vertices; empty if there is no such edge.
    pub(crate) fn uses(&self, a: u32, b: u32) -> &[EdgeUse] {
        let (low, high) = (a.min(b) as usize, a.max(b));
        let all = &self.uses[self.start[low]..self.start[low + 1]];
        let first = all.partition_point(|u| u.high < high);
        let last = all.partition_point(|u| u.high <= high);
        &all[first..last]
    }

    /// All edges `(low, high, uses)` in ascending order.
    pub(crate) fn edges(&self) -> impl Iterator<Item = (u32, u32, &[EdgeUse])> {
        (0..self.vertices())
            .flat_map(move |low| self.edges_of(low).map(move |(high, uses)| (low as u32, high, uses)))
    }

    /// Ranges of lower vertices to hand to parallel tasks: their bounds do not depend on threads.
    pub(crate) fn chunks(&self) -> Vec<std::ops::Range<usize>> {
        let n = self.vertices();
        (0..n).step_by(CHUNK).map(|first| first..(first + CHUNK).min(n)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_found_with_their_triangles_and_directions() {
        let table = EdgeTable::new(5, &[[0, 1, 2], [2, 1, 3], [4, 4, 1]]);
        let all: Vec<_> = table
            .edges()
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
