//! The scan's blur, from grey profiles across clean interfaces between two materials.
//!
//! A point-spread function close to a Gaussian turns an interface into an error function
//! (Fujimori and Suzuki §3, figure 1). [`edge_patches`](super::edge_patches) gathers small bundles of
//! profiles, [`edge_fit`](super::edge_fit) fits a blurred, curved step to each, and
//! [`blur_axes`](super::blur_axes) makes of their widths one sigma per lattice axis: across a plane of
//! normal n the width is `s_n² = sum n_a² s_a²`. The median of all widths is the one sigma that stands for
//! all directions: a minority of bundles of another kind (slices of padding that cut the part off sharply,
//! streaks) cannot move it far.
//!
//! The sigma found includes the averaging over a voxel. The radius of the "estimated spherical
//! Gaussian kernel" is taken as R = [`RADIUS_PER_SIGMA`] sigma.

use serde::{Deserialize, Serialize};

use crate::grid::Geometry;

/// R in units of sigma.
///
/// The pair pass must see core voxels on both sides of a clean interface even where the grey range of a
/// third material lies in its blurred step. If that material's contrast to the near side is the share q of
/// the whole step, the core of the near side begins `R + |quantile(q/2)| sigma` away, so both ends of a
/// cell edge see it within 2R if R is at least about `|quantile(q/2)| sigma + 1`: 2.1 sigma for q = 0.2 (air,
/// aluminium, iron) and 2.5 sigma for q = 0.1, at the usual sigma of 1.2 voxels.
///
/// Measured on five scenes of 96³ (sigma 1.19 voxels, two rotations, noise 1 % and 4 %; `docs/accuracy.md`):
/// with 2.0 clean iron/air interfaces break up into midpoint crossings (RMS 0.06 to 0.28 voxel for 0.02 to
/// 0.11); 2.25 does well there, with junction curves 8 to 27 % better than at 2.5, but breaks up so at
/// q = 0.1 (errors of 0.55 voxel 28 voxels from any junction) and at sigma 0.76 (0.44 voxel, 25 away); 3.0 loses
/// walls 7 voxels thick and parts blocks (wrong topology in 5 of 20 runs; none with the others). Hence 2.5.
pub const RADIUS_PER_SIGMA: f64 = 2.5;
/// Used when too few clean profiles are found: a typical industrial scan (Fujimori and Suzuki §3
/// found "2 or 3 voxels").
pub const DEFAULT_RADIUS: f64 = 2.5;

/// No radius above this is estimated, in voxels of mean edge length: profiles that ask for more cannot have
/// been clean.
pub const MAX_ESTIMATED_RADIUS: f64 = 6.0;

/// Largest radius along an axis, in voxels: its sphere of 2R already holds 10^5 voxels.
pub const MAX_RADIUS: f64 = 16.0;

/// The blur found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Blur {
    /// Standard deviation of the blur in mm, averaging over the voxel included: the median over clean
    /// interfaces of all directions. `None` if too few were found.
    pub sigma_mm: Option<f64>,
    /// The same per lattice axis: a plane interface with unit normal n (along the axes, in mm) is an error
    /// function of width `s_n² = sum n_a² s_a²`. `None` where `sigma_mm` is.
    #[serde(default)]
    pub sigma_axes_mm: Option<[f64; 3]>,
    /// Axes along which sigma was not measured for itself, as too few interfaces face them: it is `sigma_mm`, or
    /// what fits the interfaces there are and is nearest to that.
    #[serde(default)]
    pub isotropic: [bool; 3],
    /// Bundles of profiles used.
    pub profiles: usize,
    /// Radius R in voxels per axis.
    pub radius: [f64; 3],
    /// The radius that the blur asks for, where a smaller one was used because thin parts would
    /// have been lost.
    pub lowered_from: Option<[f64; 3]>,
}

/// A radius is not lowered below this many sigma: beneath it the grey range of a third material
/// between two others is as thick as the ball, and passes for that material.
const LOWEST_RADIUS_PER_SIGMA: f64 = 1.4;

impl Blur {
    /// A radius R given by the user, in voxels of mean edge length.
    #[must_use]
    pub fn given(radius: f64, geometry: &Geometry) -> Self {
        Self {
            sigma_mm: None,
            sigma_axes_mm: None,
            isotropic: [true; 3],
            profiles: 0,
            radius: radius_per_axis(radius, geometry),
            lowered_from: None,
        }
    }

    /// The same blur with the next smaller radius, for parts thinner than twice this one; `None`
    /// once it is as small as the blur allows.
    #[must_use]
    pub fn lowered(&self, geometry: &Geometry) -> Option<Self> {
        const STEP: f64 = 0.8;
        let edge = geometry.voxel_edge();
        let sigma = self.sigma_mm.map_or(DEFAULT_RADIUS / RADIUS_PER_SIGMA, |s| s / edge);
        let lowest = (LOWEST_RADIUS_PER_SIGMA * sigma).max(1.0);
        let now = self.radius[0] * geometry.spacing()[0] / edge;
        let next = (STEP * now).max(lowest);
        let lowered_from = Some(self.lowered_from.unwrap_or(self.radius));
        (next < 0.99 * now).then(|| Self { radius: radius_per_axis(next, geometry), lowered_from, ..*self })
    }
}

/// Radius of a sphere of `radius` (in voxels of mean edge length) in voxels per axis.
#[must_use]
pub fn radius_per_axis(radius: f64, geometry: &Geometry) -> [f64; 3] {
    geometry.spacing().map(|s| radius * geometry.voxel_edge() / s)
}

impl Blur {
    /// The blur that asks for its own radius: [`RADIUS_PER_SIGMA`] sigma, or [`DEFAULT_RADIUS`] where no
    /// sigma (mm) was found.
    pub(super) fn found(
        geometry: &Geometry,
        sigma_mm: Option<f64>,
        sigma_axes_mm: Option<[f64; 3]>,
        isotropic: [bool; 3],
        profiles: usize,
    ) -> Self {
        // Below one voxel a ball has no neighbours; far above the usual, profiles cannot have been clean.
        let in_voxels =
            |s: f64| (RADIUS_PER_SIGMA * s / geometry.voxel_edge()).clamp(1.0, MAX_ESTIMATED_RADIUS);
        let radius = radius_per_axis(sigma_mm.map_or(DEFAULT_RADIUS, in_voxels), geometry);
        let radius = radius.map(|r| r.min(MAX_RADIUS));
        Self { sigma_mm, sigma_axes_mm, isotropic, profiles, radius, lowered_from: None }
    }
}
