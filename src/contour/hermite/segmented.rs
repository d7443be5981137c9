//! Hermite data of volumes that are already segmented.

use super::columns::{Edge, Finder, Reach, UNKNOWN_VARIANCE};
use super::plane::Demand;
use super::{Hermite, HermiteRule, in_lengths, inverse_lengths, sided};
use crate::classify::LabelVolume;
use crate::contour::crossing::{CrossingRule, Midpoints};
use crate::grid::MaterialId;

/// Columns on each side that a plane is fitted to: the stairs of a tilted face average out over many.
const REACH: usize = 3;
/// Stairs of a plane are off by 1/12 in the mean square; curved faces by more, edges by much more.
const DEMAND: Demand = Demand { accepted: 2.5, agrees: 9.0 };

/// Crossings at midpoints, normals from planes through the midpoints around. All weights are 1: every
/// position is as good as any other.
#[derive(Debug, Clone)]
pub struct LabelHermite<'a> {
    labels: &'a LabelVolume,
    inverse: [f32; 3],
}

impl<'a> LabelHermite<'a> {
    /// For labels on a lattice of that spacing, mm per axis.
    #[must_use]
    pub fn new(labels: &'a LabelVolume, spacing: [f64; 3]) -> Self {
        Self { labels, inverse: inverse_lengths(spacing) }
    }
}

impl CrossingRule for LabelHermite<'_> {
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        Midpoints.position(from, axis, labels)
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        Midpoints.joins_first(ring, labels)
    }
}

impl HermiteRule for LabelHermite<'_> {
    /// # Panics
    /// If the labels held do not reach [`HALO`](super::HALO) slices beyond the edge.
    fn hermite(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Hermite {
        let edge = Edge { from, axis, labels };
        let reach = Reach::of(&edge, self.labels.size());
        let finder = Finder { labels: self.labels, crossings: &Midpoints, reach, variance: UNKNOWN_VARIANCE };
        let side = sided::plane(&finder, &edge, REACH, DEMAND);
        let normal = side.and_then(|s| in_lengths(s.covector, self.inverse));
        let normal = normal.unwrap_or_else(|| sided::along(axis));
        Hermite { position: self.position(from, axis, labels), normal, weight: 1.0 }
    }
}
