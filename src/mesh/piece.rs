//! A run of layers of a mesh, for work that goes through a mesh without holding all of it.

use super::InterfaceMesh;

/// A contiguous part of a larger mesh; see `docs/scale.md`.
///
/// Pieces come in order and without gaps. Local vertex i is vertex `first_vertex + i` of the whole mesh,
/// local triangle i is triangle `first_triangle + i`. Vertices from `owned` on are the *seam*: they belong to the
/// next piece, which begins with them. No vertex before `last_layer[0]` and no triangle before
/// `last_layer[1]` touches anything in later pieces.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshPiece {
    /// The vertices, owned ones first, and the triangles in local numbers.
    pub mesh: InterfaceMesh,
    /// How many of the vertices are this piece's own.
    pub owned: usize,
    /// The first vertex and triangle, both local, that later pieces can touch.
    pub last_layer: [usize; 2],
    /// Number in the whole mesh of vertex 0.
    pub first_vertex: u64,
    /// Number in the whole mesh of triangle 0.
    pub first_triangle: u64,
}

impl MeshPiece {
    /// A whole mesh as its only piece.
    #[must_use]
    pub fn whole(mesh: InterfaceMesh) -> Self {
        let (vertices, triangles) = (mesh.positions().len(), mesh.triangles().len());
        Self { mesh, owned: vertices, last_layer: [vertices, triangles], first_vertex: 0, first_triangle: 0 }
    }
}
