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
use super::sheet::{Reading, Sample};
use super::view::View;
use super::wedge::{Flank, Prior, Stage, WedgeFit, by_noise};
use crate::grid::MaterialId;

/// Edge of the box within which misfits are alike, blur units.
const TOGETHER: f64 = 3.0;
/// Patches correct a curve by no more than this, blur units: else they are of other sheets.
const FARTHEST: f64 = 1.0;

/// Patches up to this distance from the curve tell, blur units: farther than where they only help.
const REACH: f64 = 12.0;

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
        let Some(noise) = self.noise_of_misfit(&prior.reading, view.units.density()) else { return self };
        let mut on = Vec::new();
        let bends = flanks_of(view, flats, middle, &self.wedge, materials, REACH, &mut on);
        let again = self.weighed(samples, &on, &Prior { bends, ..*prior }, noise);
        again.unwrap_or(self)
    }

    /// What a voxel is worth where the misfit of a window with so many in a cube of one blur unit is more than noise; `None` where it is
    /// not.
    fn noise_of_misfit(&self, reading: &Reading, density: f64) -> Option<f64> {
        let white = reading.white.powi(2);
        let left = self.reduced() * reading.noise.powi(2);
        let alike = (density * TOGETHER.powi(3)).max(1.0);
        (left > white * by_noise(self.samples, 1.0)).then(|| (white + alike * (left - white)).sqrt())
    }

    /// The fit with this noise; `None` if places on fewer than two sheets are known or it strays.
    fn weighed(&self, samples: &[Sample], flanks: &[Flank], prior: &Prior<R>, noise: f64) -> Option<Self> {
        let shown = (0..R).filter(|&i| flanks.iter().any(|flank| flank.ray == i)).count();
        if shown < 2 {
            return None;
        }
        let reading = Reading { noise, ..prior.reading };
        let mut again = self.wedge.fit(samples, flanks, &Prior { reading, ..*prior }, Stage::Curved)?;
        again.fit.chi2 *= (noise / prior.reading.noise).powi(2);
        let moved = again.wedge.point(0.0).distance(self.wedge.point(0.0));
        (moved <= FARTHEST).then_some(again)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::locate::fixtures::{noisy, reading, sectors, window};
    use crate::locate::sheet::LevelPrior;
    use crate::locate::wedge::{EDGE, Wedge};

    const WHITE: f64 = 0.5;

    /// The fit of a right-angled edge along z with its apex at zero whose tip is too dark by `dark` percent of the contrast, and what it was made of.
    fn edge(dark: f64) -> (WedgeFit<2, EDGE>, Vec<Sample>, Prior<2>) {
        let misfit = |at: DVec3| dark * (-0.5 * (at.truncate() - 0.5).length_squared()).exp();
        let grey = |at: DVec3| sectors(&[0.0, FRAC_PI_2], &[100.0, 0.0], at.truncate()) - misfit(at);
        let samples = noisy(&window(4.0, grey), WHITE, 3);
        let level = |mean: f64| LevelPrior { mean, sigma: 2.0 };
        let prior = Prior {
            levels: [level(100.0), level(0.0)],
            reading: Reading { white: WHITE, ..reading(1.0) },
            log_sigma: 0.05,
            curvature: 0.06,
            bends: [Some((0.0, 0.002)); 2],
        };
        let start = Wedge::new(DVec3::splat(0.1), DVec3::Z, [DVec3::X, DVec3::Y], [100.0, 0.0]);
        let fit = start.fit(&samples, &[], &prior, Stage::Planar).unwrap();
        (fit, samples, prior)
    }

    /// Places on both sheets, as patches give them.
    fn flanks() -> Vec<Flank> {
        let on = |ray: usize, at: DVec3| Flank { ray, at, sigma: 0.03 };
        let along = [4.0, 6.0, 9.0].into_iter().flat_map(|c| [-2.0, 2.0].map(|z| (c, z)));
        along.flat_map(|(c, z)| [on(0, DVec3::new(c, 0.0, z)), on(1, DVec3::new(0.0, c, z))]).collect()
    }

    fn off(fit: &WedgeFit<2, EDGE>) -> f64 {
        fit.wedge.point(0.0).truncate().length()
    }

    #[test]
    fn what_noise_explains_stays_as_it_is() {
        let (fit, ..) = edge(0.0);
        assert!(off(&fit) < 0.03, "{}", off(&fit));
        assert_eq!(fit.noise_of_misfit(&Reading { white: WHITE, ..reading(1.0) }, 1.7), None);
    }

    #[test]
    fn a_dark_tip_moves_an_edge_less_where_patches_show_its_sheets() {
        let (fit, samples, prior) = edge(12.0);
        assert!(off(&fit) > 0.15, "{}", off(&fit));
        let noise = fit.noise_of_misfit(&prior.reading, 1.7).unwrap();
        let steadied = fit.weighed(&samples, &flanks(), &prior, noise).unwrap();
        assert!(off(&steadied) < 0.7 * off(&fit), "{} for {}", off(&steadied), off(&fit));
        // It says so, and leaves more: patches, not the window, have decided.
        assert!(steadied.apex_sigma(0.0)[1] > fit.apex_sigma(0.0)[1]);
        assert!(steadied.reduced() > fit.reduced());
    }

    #[test]
    fn one_sheet_alone_does_not_tell() {
        let (fit, samples, prior) = edge(12.0);
        let of_one: Vec<Flank> = flanks().into_iter().filter(|flank| flank.ray == 0).collect();
        assert!(fit.weighed(&samples, &of_one, &prior, 5.0).is_none());
    }
}
