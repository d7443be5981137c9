//! The tables that all work on a window shares.

use super::window::Window;
use crate::triangle::{EdgeTable, VertexTable};

/// Edges and vertices of a window, each with the triangles round it.
pub(crate) struct Tables {
    pub(crate) edges: EdgeTable,
    pub(crate) vertices: VertexTable,
}

impl Tables {
    /// The tables of everything in the window, owned by it or not.
    pub(crate) fn new(window: &Window<'_>) -> Self {
        let (n, triangles) = (window.positions().len(), window.triangles());
        Self { edges: EdgeTable::new(n, triangles), vertices: VertexTable::new(n, triangles) }
    }
}
