//! Why a surface cannot be extracted.

use thiserror::Error;

use super::piece::SeamKey;
use crate::execution::Cancelled;

/// Why a surface cannot be extracted, or pieces of it not be merged.
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
    /// The labels hold less than the layers need.
    #[error(
        "contouring needs the labels of the padded planes {} to {}, but those of {} to {} are here",
        needed[0], needed[1], held[0], held[1]
    )]
    MissingPlanes {
        /// The first and the last plane needed.
        needed: [usize; 2],
        /// The first and the last plane held.
        held: [usize; 2],
    },
    /// Pieces are not given in order, or one is missing.
    #[error(
        "a piece of surface ends before layer {end}, but the next one begins with layer {start}; pieces must be merged in order and without gaps"
    )]
    PiecesApart {
        /// Where the first piece ends.
        end: usize,
        /// Where the next begins.
        start: usize,
    },
    /// Two pieces disagree about the vertices on the plane between them.
    #[error(
        "the pieces of surface below and above layer {layer} do not fit: the one below has {}, the one above {}; were they made from the same volume and materials?",
        name(*below),
        name(*above)
    )]
    SeamDiffers {
        /// The layer above the seam.
        layer: usize,
        /// The first vertex that differs, as the piece below has it.
        below: Option<SeamKey>,
        /// The same, as the piece above has it.
        above: Option<SeamKey>,
    },
    /// Two pieces put a vertex between them at different places.
    #[error(
        "the pieces of surface below and above layer {layer} put the vertex of {key} at different places; were they made from the same grey values and materials?"
    )]
    SeamMoved {
        /// The layer above the seam.
        layer: usize,
        /// The vertex.
        key: SeamKey,
    },
    /// Counts or vertex numbers of a piece contradict each other.
    #[error(
        "the piece of surface that begins with layer {layer} is damaged: its parts do not belong together"
    )]
    BrokenPiece {
        /// Its first layer.
        layer: usize,
    },
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A seam vertex for a message.
fn name(key: Option<SeamKey>) -> String {
    key.map_or_else(|| "no further vertex".into(), |key| format!("a vertex of {key}"))
}
