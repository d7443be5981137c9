//! Which triangles use which vertex.

/// For every vertex the triangles at it, ascending.
pub(crate) struct VertexTable {
    /// `start[v]..start[v + 1]` are the places of vertex `v`'s triangles.
    start: Vec<usize>,
    triangles: Vec<u32>,
}

impl VertexTable {
    /// The table of `triangles` over `vertices` vertices. A triangle that repeats a vertex is
    /// entered there once.
    pub(crate) fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        fn distinct(t: &[u32; 3]) -> impl Iterator<Item = u32> {
            (0..3).filter(|&i| !t[..i].contains(&t[i])).map(|i| t[i])
        }
        let mut start = vec![0usize; vertices + 1];
        for t in triangles {
            for v in distinct(t) {
                start[v as usize + 1] += 1;
            }
        }
        for v in 0..vertices {
            start[v + 1] += start[v];
        }
        let mut next = start.clone();
        let mut list = vec![0; start[vertices]];
        for (i, t) in triangles.iter().enumerate() {
            for v in distinct(t) {
                list[next[v as usize]] = i as u32;
                next[v as usize] += 1;
            }
        }
        Self { start, triangles: list }
    }

    /// The triangles at vertex `v`.
    pub(crate) fn triangles(&self, v: usize) -> &[u32] {
        &self.triangles[self.start[v]..self.start[v + 1]]
    }
}
