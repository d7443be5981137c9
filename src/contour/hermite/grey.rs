//! Hermite data of grey volumes.

use glam::Vec3;

use super::columns::{Edge, Finder, Reach};
use super::noise::Qualities;
use super::plane::Demand;
use super::{Hermite, HermiteRule, NormalRule, UNKNOWN_WEIGHT, gradient, in_lengths, inverse_lengths, sided};
use crate::classify::LabelVolume;
use crate::contour::crossing::{CrossingRule, Node};
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
/// The slope of a step, in contrasts per voxel, from which on it is too sharp for gradients: that of a blur with
/// a sigma of 0.75 voxel. A scan's is 1 to 2; sampled without blur, a face has 0.58 to 1.
const STEEP: f32 = 0.5;
/// Standard deviation of crossings by noise, in voxels, up to which gradients need no smoothing.
const LITTLE_NOISE: f32 = 0.02;
/// The smoothed gradient is taken for a smooth face if it lies within this cosine (15 degrees) of its plane:
/// else something near the face, not seen in its crossings, has spoilt it.
const AGREE: f32 = 0.966;

/// Crossings by `C` ([`Thresholds`](crate::contour::Thresholds) or [`Level`](crate::contour::Level)) with
/// normals by a [`NormalRule`].
#[derive(Debug, Clone)]
pub struct GreyHermite<'a, C, S> {
    crossings: C,
    slab: Slab<'a, S>,
    labels: &'a LabelVolume,
    inverse: [f32; 3],
    materials: usize,
    rule: NormalRule,
    /// Square of the standard deviation of known crossings, voxels, for each pair of materials.
    variances: Vec<f32>,
    /// The slope of a sharp step, grey per voxel along its normal, for each pair of materials.
    steep: Vec<f32>,
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
        let variance = |i: usize| {
            let sigma = qualities.of([id(i / n), id(i % n)]).position_sigma() as f32;
            INTERPOLATION * INTERPOLATION + sigma * sigma
        };
        let variances = (0..n * n).map(variance).collect();
        let steep = |i: usize| STEEP * qualities.of([id(i / n), id(i % n)]).contrast as f32;
        let steep = (0..n * n).map(steep).collect();
        let inverse = inverse_lengths(spacing);
        Self { crossings, slab, labels, inverse, materials: n, rule, variances, steep }
    }

    /// By the crossings around; for `Auto` by the smoothed gradient where those are one smooth face.
    fn sided(&self, edge: &Edge, located: Option<f32>) -> Option<Vec3> {
        let [a, b] = edge.labels.map(|id| usize::from(id.0));
        let variance = self.variances[a * self.materials + b];
        let within = Reach::of(edge, self.labels.size());
        let finder = Finder { labels: self.labels, crossings: &self.crossings, reach: within, variance };
        let reach = if located.is_some() { REACH } else { UNKNOWN_REACH };
        let side = sided::plane(&finder, edge, reach, DEMAND)?;
        let normal = in_lengths(side.covector, self.inverse)?;
        if self.rule == NormalRule::Auto
            && side.smooth
            && let Some(t) = located
            && let Some(smoothed) = self.gradient(NormalRule::Smoothed, edge, t)
            && smoothed.dot(normal) > AGREE
        {
            return Some(smoothed);
        }
        Some(normal)
    }

    /// Whether grey values rise too steeply at a crossing for gradients to tell one face from the next.
    fn is_steep(&self, edge: &Edge, normal: Vec3) -> bool {
        let voxel = edge.from.map(|p| p - 1);
        let mut next = voxel;
        next[edge.axis] += 1;
        let rise = (self.slab.grey(next) - self.slab.grey(voxel)).abs();
        let [a, b] = edge.labels.map(|id| usize::from(id.0));
        rise > self.steep[a * self.materials + b] * normal[edge.axis].abs()
    }

    /// The gradient to take where grey values are smooth: the published one costs less, where there is little
    /// noise that smoothing would take away.
    fn smooth_rule(&self, edge: &Edge) -> NormalRule {
        let [a, b] = edge.labels.map(|id| usize::from(id.0));
        let noise = self.variances[a * self.materials + b] - INTERPOLATION * INTERPOLATION;
        if noise < LITTLE_NOISE * LITTLE_NOISE { NormalRule::Gradient } else { NormalRule::Smoothed }
    }

    /// As grey values ask for: their smoothed gradient where they are credible and blurred, as those of a scan
    /// are; else by the crossings around.
    fn auto(&self, edge: &Edge, located: Option<f32>) -> Option<Vec3> {
        if let Some(t) = located
            && let Some(normal) = self.gradient(self.smooth_rule(edge), edge, t)
            && !self.is_steep(edge, normal)
        {
            return Some(normal);
        }
        self.sided(edge, located)
    }

    /// By grey values, if the rule says so.
    #[inline]
    fn gradient(&self, rule: NormalRule, edge: &Edge, t: f32) -> Option<Vec3> {
        let voxel = edge.from.map(|p| p - 1);
        let rising = match rule {
            NormalRule::Gradient => gradient::published(self.slab, voxel, edge.axis, t, self.inverse),
            NormalRule::Smoothed => gradient::smoothed(self.slab, voxel, edge.axis, t, self.inverse),
            NormalRule::Auto | NormalRule::Sided => None,
        }?;
        // Grey values ascend with the ids of materials.
        Some(if edge.labels[0] < edge.labels[1] { rising } else { -rising })
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

    fn has_sigmas(&self) -> bool {
        self.crossings.has_sigmas()
    }

    #[inline]
    fn sigma(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.crossings.sigma(from, axis, labels)
    }

    fn node(&self, low: [usize; 3], axis: usize) -> Option<Node> {
        self.crossings.node(low, axis)
    }

    fn apex(&self, low: [usize; 3]) -> Option<Node> {
        self.crossings.apex(low)
    }

    fn has_kinks(&self) -> bool {
        self.crossings.has_kinks()
    }

    #[inline]
    fn kink(&self, low: [usize; 3], axis: usize) -> Option<Node> {
        self.crossings.kink(low, axis)
    }
}

impl<C: CrossingRule, S: Sample> HermiteRule for GreyHermite<'_, C, S> {
    /// # Panics
    /// If samples or labels held do not reach [`HALO`](super::HALO) slices beyond the edge, or a material is
    /// not one of those given.
    fn hermite(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Hermite {
        let located = self.crossings.located(from, axis, labels);
        let (position, weight) = located.map_or((0.5, UNKNOWN_WEIGHT), |t| (t, 1.0));
        let edge = Edge { from, axis, labels };
        let normal = match self.rule {
            NormalRule::Auto => self.auto(&edge, located),
            rule => self.gradient(rule, &edge, position).or_else(|| self.sided(&edge, located)),
        };
        Hermite { position, normal: normal.unwrap_or_else(|| sided::along(axis)), weight }
    }
}
