//! A run of layers' share of the surface: what one slab contributes, and how the shares are put together.

use std::fmt;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::error::ContourError;
use super::marching::{check_triangles, check_vertices};
use super::patch::{Patch, append_sigmas};

/// The surface in a run of layers of cells; see `docs/scale.md`.
///
/// `patch` holds first the `owned` vertices of these layers in order, then the *seam above*: the vertices on
/// the plane where the next piece begins, which that piece owns. Triangles name both by their place in
/// the patch. If global numbers are given to pieces one after the other, local vertex i of a piece that
/// begins at f is global vertex f + i, the seam above included.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
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

impl Piece {
    /// Puts the piece of the next layers on top: its seam below must be this one's seam above, by keys,
    /// positions and kinds. If it is refused, this piece stays as it was.
    ///
    /// # Errors
    /// [`ContourError`] says what does not fit, or that there would be more vertices or triangles than
    /// can be numbered.
    pub fn append(&mut self, next: Self) -> Result<(), ContourError> {
        // What this piece's triangles name was looked at when they came.
        self.check_counts()?;
        next.check()?;
        let layer = self.layers.end;
        if next.layers.start != layer {
            return Err(ContourError::PiecesApart { end: layer, start: next.layers.start });
        }
        if self.seam_above != next.seam_below {
            let differ = |(a, b): &(&u64, &u64)| a != b;
            let at = self.seam_above.iter().zip(&next.seam_below).position(|pair| differ(&pair));
            let at = at.unwrap_or(self.seam_above.len().min(next.seam_below.len()));
            let key = |seam: &[u64]| seam.get(at).map(|&key| SeamKey(key));
            let (below, above) = (key(&self.seam_above), key(&next.seam_below));
            return Err(ContourError::SeamDiffers { layer, below, above });
        }
        let (mine, theirs) = (&self.patch, &next.patch);
        for (i, &key) in self.seam_above.iter().enumerate() {
            let bits = |patch: &Patch, v: usize| (patch.positions[v].map(f32::to_bits), patch.kinds[v]);
            if bits(mine, self.owned + i) != bits(theirs, i) {
                return Err(ContourError::SeamMoved { layer, key: SeamKey(key) });
            }
        }
        check_vertices((self.owned + theirs.positions.len()) as u64)?;
        check_triangles((mine.triangles.len() + theirs.triangles.len()) as u64)?;

        let first = [self.owned, mine.triangles.len()];
        let offset = self.owned as u32;
        let patch = &mut self.patch;
        patch.positions.truncate(self.owned);
        patch.positions.extend(next.patch.positions);
        append_sigmas(&mut patch.sigmas, self.owned, &next.patch.sigmas, next.patch.kinds.len());
        patch.kinds.truncate(self.owned);
        patch.kinds.extend(next.patch.kinds);
        patch.triangles.extend(next.patch.triangles.into_iter().map(|t| t.map(|v| v + offset)));
        patch.pairs.extend(next.patch.pairs);
        if !next.layers.is_empty() {
            self.last_layer = [0, 1].map(|i| first[i] + next.last_layer[i]);
        }
        if self.layers.is_empty() {
            self.seam_below = next.seam_below;
        }
        self.owned += next.owned;
        self.layers.end = next.layers.end;
        self.seam_above = next.seam_above;
        Ok(())
    }

    /// Refuses a piece whose parts do not belong together, as a damaged file may hold.
    fn check(&self) -> Result<(), ContourError> {
        self.check_counts()?;
        let vertices = self.patch.positions.len();
        let named = self.patch.triangles.iter().flatten().all(|&v| (v as usize) < vertices);
        if named { Ok(()) } else { Err(ContourError::BrokenPiece { layer: self.layers.start }) }
    }

    /// The same without a look at every triangle.
    fn check_counts(&self) -> Result<(), ContourError> {
        let patch = &self.patch;
        let vertices = patch.positions.len();
        let fits = self.owned.checked_add(self.seam_above.len()) == Some(vertices)
            && patch.kinds.len() == vertices
            && (patch.sigmas.is_empty() || patch.sigmas.len() == vertices)
            && patch.pairs.len() == patch.triangles.len()
            && self.seam_below.len() <= vertices
            && self.last_layer[0] <= self.owned
            && self.last_layer[1] <= patch.triangles.len();
        if fits { Ok(()) } else { Err(ContourError::BrokenPiece { layer: self.layers.start }) }
    }
}

/// The layers of cells that belong to a slab of the padded slices `slices` of voxels: layer z to the one with
/// slice z, and to the first also the layer below it. Their surface takes the labels and samples of these
/// slices and of the one above.
#[must_use]
pub fn layers_of(slices: &Range<usize>) -> Range<usize> {
    if slices.start == 1 { 0..slices.end } else { slices.clone() }
}

/// Merges pieces, given in order of their layers. The patch of the pieces of all layers is the whole
/// surface; with some layers missing at an end, it has an open edge there.
///
/// # Errors
/// As [`Piece::append`].
pub fn merge(pieces: impl IntoIterator<Item = Piece>) -> Result<Piece, ContourError> {
    let mut pieces = pieces.into_iter();
    let mut merged = pieces.next().unwrap_or_default();
    merged.check()?;
    pieces.try_for_each(|piece| merged.append(piece))?;
    Ok(merged)
}

/// Integer key of a vertex: its kind, and the lowest point of its edge, face or cell in the padded lattice, z above y
/// above x. The first four kinds lie on a plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SeamKey(pub u64);

impl SeamKey {
    /// A crossing of an edge along x.
    pub const X_EDGE: u64 = 0;
    /// A crossing of an edge along y.
    pub const Y_EDGE: u64 = 1;
    /// A node of a face across z.
    pub const Z_FACE: u64 = 2;
    /// A kink of a face across z.
    pub const Z_KINK: u64 = 3;
    /// A crossing of an edge along z.
    pub const Z_EDGE: u64 = 4;
    /// A node of a face across x.
    pub const X_FACE: u64 = 5;
    /// A node of a face across y.
    pub const Y_FACE: u64 = 6;
    /// A kink of a face across x.
    pub const X_KINK: u64 = 7;
    /// A kink of a face across y.
    pub const Y_KINK: u64 = 8;
    /// The first apex of a cell; the next have the numbers behind it.
    pub const APEX: u64 = 16;
    /// The first tip of a cell; the next have the numbers behind it.
    pub const TIP: u64 = 32;
    /// Crossings of edges along each axis.
    pub const EDGES: [u64; 3] = [Self::X_EDGE, Self::Y_EDGE, Self::Z_EDGE];
    /// Nodes of faces across each axis.
    pub const NODES: [u64; 3] = [Self::X_FACE, Self::Y_FACE, Self::Z_FACE];
    /// Kinks of faces across each axis.
    pub const KINKS: [u64; 3] = [Self::X_KINK, Self::Y_KINK, Self::Z_KINK];
    /// Bits of a coordinate: padded ones go up to 2^15 + 1.
    const BITS: u32 = 16;

    /// The key of the vertex of this kind at a point of the padded lattice.
    #[must_use]
    pub fn new(kind: u64, low: [usize; 3]) -> Self {
        Self(low.iter().rev().fold(kind, |key, &c| key << Self::BITS | (c as u64 & 0xFFFF)))
    }

    /// Its kind.
    #[must_use]
    pub fn kind(self) -> u64 {
        self.0 >> (3 * Self::BITS)
    }

    /// How far below [`SeamKey::low`] the cells begin that have the vertex: along each axis the one there, or also the one before.
    pub(super) fn below(self) -> [usize; 3] {
        let axis_of = |kinds: [u64; 3]| kinds.iter().position(|&kind| kind == self.kind());
        let (edge, face) = (axis_of(Self::EDGES), axis_of(Self::NODES).or(axis_of(Self::KINKS)));
        [0, 1, 2].map(|a| usize::from(edge.is_some_and(|axis| a != axis) || face == Some(a)))
    }

    /// The lowest point of its edge or face in the padded lattice.
    #[must_use]
    pub fn low(self) -> [usize; 3] {
        [0, 1, 2].map(|a| (self.0 >> (a * Self::BITS) & 0xFFFF) as usize)
    }
}

impl fmt::Display for SeamKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = match self.kind() {
            Self::X_EDGE => "the x edge",
            Self::Y_EDGE => "the y edge",
            Self::Z_FACE => "the z face",
            Self::Z_KINK => "the kink of the z face",
            Self::Z_EDGE => "the z edge",
            Self::X_FACE => "the x face",
            Self::Y_FACE => "the y face",
            Self::X_KINK => "the kink of the x face",
            Self::Y_KINK => "the kink of the y face",
            Self::APEX..Self::TIP => "the cell",
            Self::TIP.. => "the tip of the cell",
            _ => "an unknown thing",
        };
        let [x, y, z] = self.low();
        write!(f, "{what} at ({x}, {y}, {z}) of the padded lattice")
    }
}

#[cfg(test)]
mod key_tests {
    use super::*;

    #[test]
    fn cells_around_a_vertex() {
        let below = |kind| SeamKey::new(kind, [5, 6, 7]).below();
        assert_eq!(SeamKey::EDGES.map(below), [[0, 1, 1], [1, 0, 1], [1, 1, 0]]);
        assert_eq!(SeamKey::NODES.map(below), [[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
        assert_eq!(SeamKey::KINKS.map(below), [[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
        assert_eq!(below(SeamKey::APEX + 1), [0; 3]);
    }
}
