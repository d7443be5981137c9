//! A wedge where its window is not explained: what lies farther away counts for more.
//!
//! Beam hardening, scatter, streaks and detectors that average intensities change grey values smoothly, by some percent of the
//! contrast where much metal ends, and alike in all voxels within the blur of each other. Were each voxel evidence of its own,
//! the wedge would be bent until it explains them: on simulated scans sharp edges of iron came out blunter than they are and 0.3
//! voxel inside. Patches of the interfaces beside the curve know better where its sheets are.
//!
//! So where a fit leaves more than the materials' noise, the rest of it is taken as one misfit that all voxels within
//! [`TOGETHER`] of each other share: for a mean of n voxels it does not fall with n, so a voxel's variance is that of
//! the noise and so many times the misfit's. With this the wedge is fitted once more. Where the noise explains what is left,
//! as on phantoms without physics, nothing changes.

use glam::DVec3;

use super::flanks::{FlatIndex, flanks_of};
use super::sheet::Sample;
use super::view::View;
use super::wedge::{Prior, Stage, WedgeFit, by_noise};
use crate::grid::MaterialId;

/// Edge of the box within which misfits are alike, blur units.
const TOGETHER: f64 = 3.0;
/// Patches correct a curve by no more than this, blur units: else they are of other sheets.
const FARTHEST: f64 = 1.0;

/// Patches up to this distance from the curve tell, blur units: farther than where they only help.
pub(super) const REACH: f64 = 12.0;

impl<const R: usize, const N: usize> WedgeFit<R, N> {
    /// The same wedge (about `middle`, voxels) with its window worth as much as the misfit that it leaves allows, if patches show two
    /// of its sheets or more. The misfit stays counted in units of the scan's noise.
    pub(super) fn steadied(
        self,
        view: &View<'_>,
        flats: &FlatIndex,
        middle: DVec3,
        materials: &[MaterialId; R],
        samples: &[Sample],
        prior: &Prior<R>,
    ) -> Self {
        let (noise, white) = (prior.reading.noise.powi(2), prior.reading.white.powi(2));
        let left = self.reduced() * noise;
        if left <= white * by_noise(samples.len(), 1.0) {
            return self;
        }
        let mut on = Vec::new();
        let bends = flanks_of(view, flats, middle, &self.wedge, materials, REACH, &mut on);
        let shown = (0..R).filter(|&i| on.iter().any(|flank| flank.ray == i)).count();
        if shown < 2 {
            return self;
        }
        let alike = (view.units.density() * TOGETHER.powi(3)).max(1.0);
        let mut prior = Prior { bends, ..*prior };
        prior.reading.noise = (white + alike * (left - white)).sqrt();
        let Some(mut again) = self.wedge.fit(samples, &on, &prior, Stage::Curved) else { return self };
        if again.wedge.point(0.0).distance(self.wedge.point(0.0)) > FARTHEST {
            return self;
        }
        again.fit.chi2 *= prior.reading.noise.powi(2) / noise;
        again
    }
}
