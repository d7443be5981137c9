//! Hermite data by the models: what dual contouring asks for.

use glam::{DVec3, Vec3};

use super::rule::Located;
use crate::classify::LabelVolume;
use crate::contour::hermite::{GreyHermite, Qualities};
use crate::contour::{CrossingRule, Hermite, HermiteRule, Node, NormalRule};
use crate::grid::MaterialId;
use crate::volume::{Sample, Slab};

/// Positions and normals by models; where they say nothing, normals by grey values.
pub struct LocatedHermite<'a> {
    located: &'a Located<'a>,
    grey: Box<dyn HermiteRule + 'a>,
    /// Blur units to a covector of lengths.
    scale: DVec3,
}

impl<'a> LocatedHermite<'a> {
    /// With crossings by `located`, of the grey values in `slab` and the labels that agree with the models; spacing
    /// in mm per axis, `rule` and `qualities` as for [`GreyHermite::new`].
    #[must_use]
    pub fn new<S: Sample>(
        located: &'a Located<'a>,
        slab: Slab<'a, S>,
        labels: &'a LabelVolume,
        spacing: [f64; 3],
        rule: NormalRule,
        qualities: &Qualities,
    ) -> Self {
        let grey = Box::new(GreyHermite::new(located, slab, labels, spacing, rule, qualities));
        Self { located, grey, scale: located.units.per_voxel / DVec3::from(spacing) }
    }
}

impl CrossingRule for LocatedHermite<'_> {
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.located.position(from, axis, labels)
    }

    fn located(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<f32> {
        self.located.located(from, axis, labels)
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        self.located.joins_first(ring, labels)
    }

    fn has_sigmas(&self) -> bool {
        self.located.has_sigmas()
    }

    fn sigma(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.located.sigma(from, axis, labels)
    }

    fn node(&self, low: [usize; 3], axis: usize) -> Option<Node> {
        self.located.node(low, axis)
    }
}

impl HermiteRule for LocatedHermite<'_> {
    fn knows_curves(&self) -> bool {
        true
    }

    fn hermite(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Hermite {
        let Some(found) = self.located.find(from, axis, labels) else {
            return self.grey.hermite(from, axis, labels);
        };
        let normal = (found.normal * self.scale).as_vec3().try_normalize();
        Hermite {
            // Beyond the edge, too: there its plane is.
            position: found.position as f32,
            normal: normal.unwrap_or(Vec3::AXES[axis]),
            weight: 1.0,
        }
    }
}
