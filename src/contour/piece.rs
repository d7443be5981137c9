//! A run of layers' share of the surface: what one slab contributes, ready to be merged.

use std::ops::Range;

use super::patch::Patch;

/// The surface in a run of layers of cells; see `docs/scale.md`.
///
/// `patch` holds first the `owned` vertices of these layers in order, then the *seam above*: the vertices on
/// the plane where the next piece begins, which that piece owns. Triangles name both by their place in
/// the patch. If global numbers are given to pieces one after the other, local vertex i of a piece that
/// begins at f is global vertex f + i, the seam above included.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Piece {
    /// The layers, by the padded z of their lower plane.
    pub layers: Range<usize>,
    /// Vertices and triangles, lattice units of the whole volume.
    pub patch: Patch,
    /// How many of the vertices these layers own.
    pub owned: usize,
    /// The first vertex and triangle of the last layer: all that a later piece can touch comes from
    /// there on.
    pub last_layer: [usize; 2],
    /// Integer keys of the first owned vertices, those on the lowest plane: the seam below.
    pub seam_below: Vec<u64>,
    /// Integer keys of the vertices behind the owned ones.
    pub seam_above: Vec<u64>,
}
