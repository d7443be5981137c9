//! Which triangles use which vertex.

use super::filed::Filed;

/// For every vertex the triangles at it, ascending.
pub(crate) struct VertexTable(Filed<u32>);

impl VertexTable {
    /// The table of `triangles` over `vertices` vertices. A triangle that repeats a vertex is
    /// entered there once.
    pub(crate) fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let filed = Filed::new(vertices, triangles, |t, corners| {
            std::array::from_fn(|i| (!corners[..i].contains(&corners[i])).then(|| (corners[i], t as u32)))
        });
        Self(filed)
    }

    /// The triangles at vertex `v`.
    pub(crate) fn triangles(&self, v: usize) -> &[u32] {
        self.0.of(v)
    }
}
