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
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Patch {
    /// Vertex positions, lattice units.
    pub positions: Vec<[f32; 3]>,
    /// What each vertex is.
    pub kinds: Vec<VertexKind>,
    /// Standard deviation of each vertex's position along the normal of the surface, voxels of mean edge length; NaN
    /// where it is unknown. Empty if none is known.
    pub sigmas: Vec<f32>,
    /// Vertices of each triangle, counter-clockwise seen from its front (in a right-handed lattice).
    pub triangles: Vec<[u32; 3]>,
    /// The pair of each triangle.
    pub pairs: Vec<Pair>,
}

impl PartialEq for Patch {
    /// Sigmas are compared by their bits: unknown ones are equal.
    fn eq(&self, other: &Self) -> bool {
        self.positions == other.positions
            && self.kinds == other.kinds
            && same_sigmas(&self.sigmas, &other.sigmas)
            && self.triangles == other.triangles
            && self.pairs == other.pairs
    }
}

/// Whether two lists of sigmas are the same, bit for bit.
pub(crate) fn same_sigmas(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

/// Puts the sigmas of `count` vertices behind those of `before`. Where one of the two lists is empty because none is
/// known, its vertices' are unknown; if both are, so is the outcome.
pub(crate) fn append_sigmas(all: &mut Vec<f32>, before: usize, more: &[f32], count: usize) {
    if all.is_empty() && more.is_empty() {
        return;
    }
    all.resize(before, f32::NAN);
    all.extend_from_slice(&more[..count.min(more.len())]);
    all.resize(before + count, f32::NAN);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_known_is_filled_in_with_unknown() {
        let (mut all, nan) = (Vec::new(), f32::NAN);
        append_sigmas(&mut all, 0, &[], 2);
        assert!(all.is_empty());
        append_sigmas(&mut all, 2, &[1.0, 2.0, 3.0], 2);
        assert!(same_sigmas(&all, &[nan, nan, 1.0, 2.0]));
        append_sigmas(&mut all, 3, &[], 2);
        assert!(same_sigmas(&all, &[nan, nan, 1.0, nan, nan]));
    }
}
