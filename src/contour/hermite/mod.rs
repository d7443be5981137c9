//! Hermite data: where a cell edge meets the interface, and how the interface lies there.
//!
//! Three estimates of the normal, see [`NormalRule`]: gradients of the grey value as published, gradients of
//! the smoothed grey value, and a plane through the crossings around, which needs no grey values and keeps
//! apart the faces beside an edge. [`GreyHermite`] serves grey volumes, [`LabelHermite`] segmented ones.
//! `docs/hermite.md` has the figures that the choices here rest on.

mod columns;
mod gradient;
mod grey;
mod noise;
mod plane;
mod segmented;
mod sided;

use glam::Vec3;
use serde::{Deserialize, Serialize};

pub use grey::GreyHermite;
pub use noise::{PairQuality, Qualities};
pub use segmented::LabelHermite;

use super::crossing::CrossingRule;
use crate::grid::MaterialId;

/// Lattice points that the Hermite data of an edge may depend on, beyond the ends of the edge, along each
/// axis. So a slab must hold this many slices more than those whose edges are asked for, as far as the volume
/// goes.
pub const HALO: usize = 4;

/// Weight of a crossing that is only known to be somewhere on its edge: its distances count a fifth, which is
/// about what the standard deviation of a known position (0.06 voxel) is of that of an unknown one (0.29).
pub const UNKNOWN_WEIGHT: f32 = 0.04;

/// Position and normal of a crossing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hermite {
    /// Fraction of the edge, as [`CrossingRule::position`] gives it. A rule that knows curves may give one beyond the edge's ends, where
    /// its plane meets the edge's line.
    pub position: f32,
    /// Unit normal, in lengths (lattice axes, spacing taken into account), from the material at the
    /// edge's lower end to the one at its upper end.
    pub normal: Vec3,
    /// How much the crossing counts in a QEF: 1, or less where its position is not known well, in (0, 1].
    pub weight: f32,
}

/// Decides positions and normals of crossings. Must give the same answer whenever asked.
pub trait HermiteRule: CrossingRule {
    /// Hermite data of the edge from padded point `from` to its neighbour along `axis`, whose ends have
    /// the (different) materials `labels`, neither of them `OUTSIDE`.
    fn hermite(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Hermite;

    /// Whether planes are known so well where interfaces meet that the curve is where they cut, though that be beside the cell.
    fn knows_curves(&self) -> bool {
        false
    }
}

/// How normals of grey volumes are estimated. Segmented volumes have one way only, [`NormalRule::Sided`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NormalRule {
    /// The default: a gradient where grey values rise as gently as in a scan (`Smoothed` if there is noise to
    /// smooth), else `Sided`, or `Smoothed` where the crossings around are one smooth face.
    #[default]
    Auto,
    /// Central differences at both ends, normalised and interpolated (Li et al. eq. 7 and 8).
    Gradient,
    /// Gradient at the crossing of the grey value smoothed by a Gaussian of one voxel.
    Smoothed,
    /// A plane through the crossings of the same pair around, on this side of any sharp edge.
    Sided,
}

/// The unit vector, in lengths, along a covector of the lattice (a gradient per voxel): `inverse` is one over
/// the voxel's edges. `None` for a vector without a direction.
#[inline]
fn in_lengths(covector: [f32; 3], inverse: [f32; 3]) -> Option<Vec3> {
    let vector = Vec3::from(covector) * Vec3::from(inverse);
    let length = vector.length();
    // Divided, not multiplied by the inverse: so a vector along an axis becomes exactly that axis.
    (length > 0.0 && length.is_finite()).then(|| vector / length)
}

/// One over the edges of a voxel, in voxels of mean edge length.
fn inverse_lengths(spacing: [f64; 3]) -> [f32; 3] {
    let mean = spacing.iter().product::<f64>().cbrt();
    spacing.map(|s| (mean / s) as f32)
}
