//! Hermite data: where a cell edge meets the interface, and how the interface lies there.

use glam::Vec3;

use super::crossing::CrossingRule;
use crate::grid::MaterialId;

/// Position and normal of a crossing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hermite {
    /// Fraction of the edge, as [`CrossingRule::position`] gives it.
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
}
