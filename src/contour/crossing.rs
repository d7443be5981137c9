//! Where on a cell edge an interface lies.
//!
//! Between materials x and y the crossing is where linear interpolation of the grey value meets
//! t_xy (Fujimori and Suzuki §4; Li et al. eq. 6). If an end of the edge was a junction voxel, its
//! grey value is not credible and the crossing is the midpoint, as published; so it is where the
//! grey values do not straddle t_xy (an end that was labelled by another pair's threshold) and at
//! the border with `OUTSIDE`. Positions are in lattice units, so anisotropic spacing needs no care
//! here.

use super::hermite::{PairQuality, Qualities};
use super::moves::Moves;
use crate::classify::BitPlanes;
use crate::grid::MaterialId;
use crate::material::MaterialTable;
use crate::volume::{Sample, Slab};

/// A crossing keeps this distance from the ends of its edge (in edge lengths), so that crossings
/// on different edges stay different points and no triangle is degenerate: large against the
/// rounding of `f32` lattice coordinates up to 2^15, small against any error of measurement.
pub const CROSSING_MARGIN: f32 = 1.0 / 256.0;

/// A point on a face of a cell, or inside a cell, that a [`CrossingRule`] knows better than contouring does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Where it is, in units of the cell (one per axis between neighbouring voxel centres), from the lowest corner of
    /// the face or cell. On a face, the coordinate across it is 0. Contouring keeps it [`CROSSING_MARGIN`] inside.
    pub at: [f32; 3],
    /// Standard deviation of its position along the normal of the interfaces there, in voxels of mean edge
    /// length; NaN if unknown.
    pub sigma: f32,
}

/// Decides positions of crossings and ambiguous faces. Points are of the padded lattice and inside
/// the volume. Must give the same answer whenever asked.
///
/// Beyond positions a rule may know their standard deviations, where junction curves pass through faces and
/// cells, and where sharp edges of one interface do; by default it knows none of them.
pub trait CrossingRule: Sync {
    /// Where the crossing lies on the edge from `from` to its neighbour `to` along `axis`, as a
    /// fraction of the edge within [`CROSSING_MARGIN`] and 1 - [`CROSSING_MARGIN`]; `labels` are
    /// the (different) materials of the two ends.
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32;

    /// The same position where the data tell it, `None` where the midpoint stands in for it. Labels that
    /// are all there is tell their midpoints.
    #[inline]
    fn located(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<f32> {
        Some(self.position(from, axis, labels))
    }

    /// On a face whose corners show `labels[0], labels[1], labels[0], labels[1]` in ring order:
    /// whether the diagonal of ring corners 0 and 2 is joined (else 1 and 3).
    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool;

    /// Whether [`sigma`](Self::sigma) ever gives a number. If not, no sigmas are kept.
    #[inline]
    fn has_sigmas(&self) -> bool {
        false
    }

    /// Standard deviation of the interface's position along its normal, in voxels of mean edge length, at the
    /// crossing on the edge from `from` along `axis`; NaN if unknown.
    #[inline]
    fn sigma(&self, _from: [usize; 3], _axis: usize, _labels: [MaterialId; 2]) -> f32 {
        f32::NAN
    }

    /// Position and standard deviation of a crossing at once.
    #[inline]
    fn placed(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> (f32, f32) {
        (self.position(from, axis, labels), self.sigma(from, axis, labels))
    }

    /// Where a junction curve passes through the lattice face across `axis` whose lowest corner is `low`, if that
    /// is known better than as the mean of the face's crossings. Asked for faces where three or four materials meet in
    /// a star, none of them `OUTSIDE`.
    #[inline]
    fn node(&self, _low: [usize; 3], _axis: usize) -> Option<Node> {
        None
    }

    /// The junction point, or a point of the junction curve, in the cell whose lowest corner is `low`, if that is
    /// known better than as the mean of the sheet's nodes.
    #[inline]
    fn apex(&self, _low: [usize; 3]) -> Option<Node> {
        None
    }

    /// Whether [`kink`](Self::kink) ever gives one. If not, it is not asked.
    #[inline]
    fn has_kinks(&self) -> bool {
        false
    }

    /// Where a sharp edge of one interface passes through the lattice face across `axis` whose lowest corner is
    /// `low`. Asked for faces with two materials, neither of them `OUTSIDE`, and two crossings.
    #[inline]
    fn kink(&self, _low: [usize; 3], _axis: usize) -> Option<Node> {
        None
    }

    /// Vertices that lie elsewhere than where they are safe by construction. Marching alone asks for them.
    #[inline]
    fn moves(&self) -> Option<&Moves> {
        None
    }
}

impl<R: CrossingRule + ?Sized> CrossingRule for &R {
    #[inline]
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        (**self).position(from, axis, labels)
    }

    #[inline]
    fn located(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<f32> {
        (**self).located(from, axis, labels)
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        (**self).joins_first(ring, labels)
    }

    fn has_sigmas(&self) -> bool {
        (**self).has_sigmas()
    }

    fn sigma(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        (**self).sigma(from, axis, labels)
    }

    fn placed(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> (f32, f32) {
        (**self).placed(from, axis, labels)
    }

    fn node(&self, low: [usize; 3], axis: usize) -> Option<Node> {
        (**self).node(low, axis)
    }

    fn apex(&self, low: [usize; 3]) -> Option<Node> {
        (**self).apex(low)
    }

    fn has_kinks(&self) -> bool {
        (**self).has_kinks()
    }

    fn kink(&self, low: [usize; 3], axis: usize) -> Option<Node> {
        (**self).kink(low, axis)
    }

    fn moves(&self) -> Option<&Moves> {
        (**self).moves()
    }
}

/// Crossings at edge midpoints; on ambiguous faces the material with the higher id is joined.
/// For volumes that are already segmented.
#[derive(Debug, Clone, Copy, Default)]
pub struct Midpoints;

impl CrossingRule for Midpoints {
    fn position(&self, _: [usize; 3], _: usize, _: [MaterialId; 2]) -> f32 {
        0.5
    }

    fn joins_first(&self, _: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        labels[0] > labels[1]
    }
}

/// Crossings of a single threshold, where every grey value is credible: an isosurface.
#[derive(Debug, Clone, Copy)]
pub struct Level<'a, S> {
    slab: Slab<'a, S>,
    threshold: f32,
    /// Of all crossings, if known.
    sigma: Option<f32>,
}

impl<'a, S: Sample> Level<'a, S> {
    /// For a slab and a grey value; labels must be 1 where the grey value is at least that, else 0.
    #[must_use]
    pub fn new(slab: Slab<'a, S>, threshold: f32) -> Self {
        Self { slab, threshold, sigma: None }
    }

    /// With crossings known to [`PairQuality::position_sigma`].
    #[must_use]
    pub fn with_sigma(self, quality: &PairQuality) -> Self {
        Self { sigma: Some(quality.position_sigma() as f32), ..self }
    }

    #[inline]
    fn above(&self, [x, y, z]: [usize; 3]) -> f32 {
        self.slab.grey([x - 1, y - 1, z - 1]) - self.threshold
    }
}

impl<S: Sample> CrossingRule for Level<'_, S> {
    #[inline]
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.located(from, axis, labels).unwrap_or(0.5)
    }

    #[inline]
    fn located(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<f32> {
        let mut to = from;
        to[axis] += 1;
        between(self.above(from), self.above(to), labels)
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        saddle_joins_first(ring.map(|p| self.above(p)), labels)
    }

    fn has_sigmas(&self) -> bool {
        self.sigma.is_some()
    }

    fn sigma(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.sigma.filter(|_| self.located(from, axis, labels).is_some()).unwrap_or(f32::NAN)
    }
}

/// Crossings by the threshold of the pair; see the module's header. On ambiguous faces the sign of
/// the bilinear interpolant at its saddle decides where all four grey values are credible,
/// otherwise the material with the higher id is joined.
#[derive(Debug, Clone)]
pub struct Thresholds<'a, S> {
    slab: Slab<'a, S>,
    junction: &'a BitPlanes,
    /// Number of materials, and the threshold of each pair.
    materials: usize,
    thresholds: Vec<f32>,
    /// What is known of each pair's crossings; empty if nothing is.
    sigmas: Vec<f32>,
}

impl<'a, S: Sample> Thresholds<'a, S> {
    /// For a slab of a volume of which the voxels in `junction` are not credible.
    #[must_use]
    pub fn new(slab: Slab<'a, S>, junction: &'a BitPlanes, materials: &'a MaterialTable) -> Self {
        let (ids, n) = (materials.materials(), materials.count());
        let threshold = |i: usize| materials.threshold(ids[i / n].id, ids[i % n].id) as f32;
        let thresholds = (0..n * n).map(threshold).collect();
        Self { slab, junction, materials: n, thresholds, sigmas: Vec::new() }
    }

    /// With crossings known to [`PairQuality::position_sigma`] of their
    /// pair; those at midpoints stay unknown.
    ///
    /// # Panics
    /// If there are qualities of fewer materials than the table has.
    #[must_use]
    pub fn with_sigmas(self, qualities: &Qualities) -> Self {
        let n = self.materials;
        let id = |i: usize| MaterialId(i as u8);
        let sigma = |i: usize| qualities.of([id(i / n), id(i % n)]).position_sigma() as f32;
        Self { sigmas: (0..n * n).map(sigma).collect(), ..self }
    }

    /// Grey value above the threshold of `labels`, or `None` where it is not credible.
    #[inline]
    fn above(&self, [x, y, z]: [usize; 3], threshold: f32) -> Option<f32> {
        if self.junction.bit(0, x, y, z) {
            return None;
        }
        Some(self.slab.grey([x - 1, y - 1, z - 1]) - threshold)
    }

    fn threshold(&self, labels: [MaterialId; 2]) -> f32 {
        self.of_pair(&self.thresholds, labels)
    }

    fn of_pair(&self, values: &[f32], labels: [MaterialId; 2]) -> f32 {
        let [a, b] = labels.map(|id| usize::from(id.0));
        // No threshold towards OUTSIDE: nothing lies above it.
        let known = a < self.materials && b < self.materials;
        if known { values[a * self.materials + b] } else { f32::NAN }
    }
}

impl<S: Sample> CrossingRule for Thresholds<'_, S> {
    #[inline]
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.located(from, axis, labels).unwrap_or(0.5)
    }

    #[inline]
    fn located(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<f32> {
        let mut to = from;
        to[axis] += 1;
        let threshold = self.threshold(labels);
        between(self.above(from, threshold)?, self.above(to, threshold)?, labels)
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        let threshold = self.threshold(labels);
        let [a, b, c, d] = ring.map(|p| self.above(p, threshold));
        let (Some(a), Some(b), Some(c), Some(d)) = (a, b, c, d) else { return labels[0] > labels[1] };
        saddle_joins_first([a, b, c, d], labels)
    }

    fn has_sigmas(&self) -> bool {
        !self.sigmas.is_empty()
    }

    fn sigma(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        match self.located(from, axis, labels) {
            Some(_) if self.has_sigmas() => self.of_pair(&self.sigmas, labels),
            _ => f32::NAN,
        }
    }
}

/// Where linear interpolation between `f` and `g`, grey values above the threshold at the ends of an edge,
/// meets zero; `None` if they do not straddle it as the labels do.
#[inline]
fn between(f: f32, g: f32, labels: [MaterialId; 2]) -> Option<f32> {
    let straddle = (f < 0.0) != (g < 0.0) && (f < 0.0) == (labels[0] < labels[1]);
    straddle.then(|| (f / (f - g)).clamp(CROSSING_MARGIN, 1.0 - CROSSING_MARGIN))
}

/// Whether the diagonal of corners 0 and 2 is joined on a face with these grey values above the threshold.
fn saddle_joins_first([a, b, c, d]: [f32; 4], labels: [MaterialId; 2]) -> bool {
    // Value of the bilinear interpolant at its saddle; it has a saddle as long as the signs
    // alternate, which only an end labelled by another pair's threshold can spoil.
    let alternate = (a < 0.0) == (c < 0.0) && (b < 0.0) == (d < 0.0) && (a < 0.0) != (b < 0.0);
    if !alternate {
        return labels[0] > labels[1];
    }
    let saddle = (a * c - b * d) / (a + c - b - d);
    (saddle < 0.0) == (a < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[allow(clippy::float_cmp)] // these positions are exact in binary
    fn crossings_follow_the_pair_and_only_credible_voxels() {
        let materials = MaterialTable::new([("air", 0.0), ("al", 10.0), ("fe", 40.0)]).unwrap();
        let samples = [0.0f32, 20.0, 40.0, 12.0, 5.0];
        let mut junction = BitPlanes::new([5, 1, 1], 1);
        let ids = |a, b| [MaterialId(a), MaterialId(b)];
        let rule = Thresholds::new(Slab::whole(&samples, [5, 1, 1]), &junction, &materials);
        // Samples 0 and 20 as air and iron (t = 20): the clamped end; as air and aluminium (t = 5).
        assert_eq!(rule.position([1, 1, 1], 0, ids(0, 2)), 1.0 - CROSSING_MARGIN);
        assert_eq!(rule.position([1, 1, 1], 0, ids(0, 1)), 0.25);
        // Samples 40 and 12 as iron and aluminium: (40 - 25) / 28.
        assert!((rule.position([3, 1, 1], 0, ids(2, 1)) - 15.0 / 28.0).abs() < 1e-6);
        // Labels that contradict the grey values.
        assert_eq!(rule.position([3, 1, 1], 0, ids(1, 2)), 0.5);
        junction.row_mut(0, 1, 1)[0] |= 1 << 1;
        let rule = Thresholds::new(Slab::whole(&samples, [5, 1, 1]), &junction, &materials);
        assert_eq!(rule.position([1, 1, 1], 0, ids(0, 1)), 0.5);
        // Sigmas are those of the pair, and unknown where the position is.
        assert!(!rule.has_sigmas() && rule.sigma([3, 1, 1], 0, ids(2, 1)).is_nan());
        let quality = PairQuality { blur: 1.0, noise: 0.1, contrast: 30.0 };
        let rule = rule.with_sigmas(&Qualities::alike(3, quality));
        assert!(rule.has_sigmas() && rule.sigma([1, 1, 1], 0, ids(0, 1)).is_nan());
        assert_eq!(rule.sigma([3, 1, 1], 0, ids(2, 1)), quality.position_sigma() as f32);
    }
}
