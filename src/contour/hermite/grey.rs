//! Hermite data of grey volumes.

use glam::Vec3;

use super::columns::{Edge, Finder, Reach};
use super::noise::{PairQuality, Qualities};
use super::plane::Demand;
use super::{Hermite, HermiteRule, NormalRule, UNKNOWN_WEIGHT, gradient, in_lengths, inverse_lengths, sided};
use crate::classify::LabelVolume;
use crate::contour::crossing::CrossingRule;
use crate::grid::MaterialId;
use crate::volume::{Sample, Slab};

/// Columns on each side for the plane through crossings that are known.
const REACH: usize = 2;
/// And where the crossing itself is not: most around it are not either, and make stairs.
const UNKNOWN_REACH: usize = 3;
/// How well a plane must explain them.
const DEMAND: Demand = Demand { accepted: 2.5, agrees: 9.0 };
/// Standard deviation of crossings without noise, in voxels: what linear interpolation on a step that is
/// not linear is off by.
const INTERPOLATION: f32 = 0.06;
/// Blur (sigma in voxels) below which data are sharp: gradients mix the faces beside an edge.
const SHARP: f64 = 0.7;
/// Standard deviation of crossings by noise, in voxels, above which gradients must be smoothed.
const NOISY: f64 = 0.03;

/// Crossings by `C` ([`Thresholds`](crate::contour::Thresholds) or [`Level`](crate::contour::Level)) with
/// normals by a [`NormalRule`].
#[derive(Debug, Clone)]
pub struct GreyHermite<'a, C, S> {
    crossings: C,
    slab: Slab<'a, S>,
    labels: &'a LabelVolume,
    inverse: [f32; 3],
    materials: usize,
    /// What to do for each pair.
    pairs: Vec<Choice>,
}

/// What to do for the crossings of a pair.
#[derive(Debug, Clone, Copy)]
struct Choice {
    known: NormalRule,
    unknown: NormalRule,
    /// Square of the standard deviation of known crossings, voxels.
    variance: f32,
}

impl Choice {
    fn new(rule: NormalRule, quality: PairQuality) -> Self {
        let sigma = quality.position_sigma();
        let variance = INTERPOLATION.powi(2) + (sigma as f32).powi(2);
        let known = match rule {
            NormalRule::Auto if quality.blur < SHARP => NormalRule::Sided,
            NormalRule::Auto if sigma > NOISY => NormalRule::Smoothed,
            NormalRule::Auto => NormalRule::Gradient,
            given => given,
        };
        let unknown = if rule == NormalRule::Auto { NormalRule::Sided } else { rule };
        Self { known, unknown, variance }
    }
}

impl<'a, C: CrossingRule, S: Sample> GreyHermite<'a, C, S> {
    /// `crossings` must be of the grey values in `slab` and the materials in `labels`; spacing in mm per axis.
    #[must_use]
    pub fn new(
        crossings: C,
        slab: Slab<'a, S>,
        labels: &'a LabelVolume,
        spacing: [f64; 3],
        rule: NormalRule,
        qualities: &Qualities,
    ) -> Self {
        let n = qualities.materials();
        let id = |i: usize| MaterialId(i as u8);
        let pairs = (0..n * n).map(|i| Choice::new(rule, qualities.of([id(i / n), id(i % n)]))).collect();
        Self { crossings, slab, labels, inverse: inverse_lengths(spacing), materials: n, pairs }
    }

    fn sided(&self, edge: &Edge, variance: f32, reach: usize) -> Option<Vec3> {
        let within = Reach::of(edge, self.labels.size());
        let finder = Finder { labels: self.labels, crossings: &self.crossings, reach: within, variance };
        in_lengths(sided::plane(&finder, edge, reach, DEMAND)?.covector, self.inverse)
    }
}

impl<C: CrossingRule, S: Sample> CrossingRule for GreyHermite<'_, C, S> {
    #[inline]
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.crossings.position(from, axis, labels)
    }

    #[inline]
    fn located(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<f32> {
        self.crossings.located(from, axis, labels)
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        self.crossings.joins_first(ring, labels)
    }
}

impl<C: CrossingRule, S: Sample> HermiteRule for GreyHermite<'_, C, S> {
    /// # Panics
    /// If samples or labels held do not reach [`HALO`](super::HALO) slices beyond the edge, or a material is
    /// not one of those given.
    fn hermite(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Hermite {
        let [a, b] = labels.map(|id| usize::from(id.0));
        let choice = &self.pairs[a * self.materials + b];
        let located = self.crossings.located(from, axis, labels);
        let (rule, weight, reach) = match located {
            Some(_) => (choice.known, 1.0, REACH),
            None => (choice.unknown, UNKNOWN_WEIGHT, UNKNOWN_REACH),
        };
        let position = located.unwrap_or(0.5);
        let edge = Edge { from, axis, labels };
        let voxel = from.map(|p| p - 1);
        let rising = match rule {
            NormalRule::Gradient => gradient::published(self.slab, voxel, axis, position, self.inverse),
            NormalRule::Smoothed => gradient::smoothed(self.slab, voxel, axis, position, self.inverse),
            NormalRule::Auto | NormalRule::Sided => None,
        };
        // Grey values ascend with the ids of materials.
        let normal = rising.map(|n| if labels[0] < labels[1] { n } else { -n });
        let normal = normal.or_else(|| self.sided(&edge, choice.variance, reach));
        Hermite { position, normal: normal.unwrap_or_else(|| sided::along(axis)), weight }
    }
}
