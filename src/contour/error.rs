//! Why a surface cannot be extracted.

use thiserror::Error;

use crate::execution::Cancelled;

/// Why a surface cannot be extracted.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
pub enum ContourError {
    /// More vertices than an index can name.
    #[error(
        "the surface would have {vertices} vertices; at most {limit} can be numbered. Work on a part of the volume with --roi, or check the materials: noise taken for a material gives a surface round every voxel"
    )]
    TooManyVertices {
        /// Vertices counted.
        vertices: u64,
        /// How many there may be.
        limit: u64,
    },
    /// More triangles than can be numbered.
    #[error(
        "the surface would have {triangles} triangles; at most {limit} can be numbered. Work on a part of the volume with --roi"
    )]
    TooManyTriangles {
        /// Triangles counted.
        triangles: u64,
        /// How many there may be.
        limit: u64,
    },
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}
