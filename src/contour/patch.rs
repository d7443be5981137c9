//! A piece of surface as contouring leaves it, in lattice units.

use serde::{Deserialize, Serialize};

use crate::grid::{Pair, VertexKind};

/// What happens to the surface at the volume's border.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Border {
    /// Every material but the background is closed by triangles whose front is `OUTSIDE`, half a
    /// voxel beyond the outermost voxel centres: the sides of the box of voxels.
    #[default]
    Closed,
    /// Interfaces end there with open edges.
    Open,
}

/// Labelled triangles in lattice units: the centre of voxel (x, y, z) is at (x, y, z).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Patch {
    /// Vertex positions, lattice units.
    pub positions: Vec<[f32; 3]>,
    /// What each vertex is.
    pub kinds: Vec<VertexKind>,
    /// Vertices of each triangle, counter-clockwise seen from its front (in a right-handed lattice).
    pub triangles: Vec<[u32; 3]>,
    /// The pair of each triangle.
    pub pairs: Vec<Pair>,
}
