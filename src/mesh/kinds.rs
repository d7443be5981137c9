//! Vertex kinds from the labels round each vertex.

use rayon::prelude::*;

use crate::grid::{MaterialId, Pair, VertexKind};
use crate::triangle::VertexTable;

/// The kind of each of `vertices` vertices: how many materials its triangles name, with `OUTSIDE`
/// counted as one and meaning the border. Each pair belongs to the triangle at its place.
///
/// # Panics
/// If there are fewer pairs than triangles.
#[must_use]
pub fn kinds_from_labels(vertices: usize, triangles: &[[u32; 3]], pairs: &[Pair]) -> Vec<VertexKind> {
    let table = VertexTable::new(vertices, triangles);
    (0..vertices)
        .into_par_iter()
        .map_init(Vec::new, |ids: &mut Vec<MaterialId>, v| {
            ids.clear();
            for &t in table.triangles(v) {
                let pair = pairs[t as usize];
                for id in [pair.back(), pair.front()] {
                    if !ids.contains(&id) {
                        ids.push(id);
                    }
                }
            }
            VertexKind::new(ids.len(), ids.contains(&MaterialId::OUTSIDE))
        })
        .collect()
}
