//! The scan's blur, from grey profiles across clean interfaces between two materials.
//!
//! A point-spread function close to a Gaussian turns an interface into an error function
//! (Fujimori and Suzuki §3, figure 1). Profiles are taken along the lattice axes where the grey
//! gradient is nearly parallel to the axis and both ends lie on a material's plateau; each is
//! normalised to 0..1, placed by its own crossing of one half, shortened by the cosine of its
//! angle, and fitted by an error function. The median of all sigmas is taken: a minority of
//! profiles of another kind (slices of padding that cut the part off sharply, streaks) cannot move
//! it far, as they would a fit to all profiles together.
//!
//! The sigma found includes the averaging over a voxel. The radius of the "estimated spherical
//! Gaussian kernel" is taken as R = [`RADIUS_PER_SIGMA`] sigma.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::sampling::{POINTS, SampleGrid, steps};
use super::table::MaterialTable;
use crate::grid::Geometry;
use crate::volume::{Sample, SampleWindow, Slab, VolumeError};

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

/// Half-length of a profile, in voxels.
const REACH: usize = 6;
/// A gradient counts as parallel to an axis if its cosine is at least this.
const MIN_COSINE: f64 = 0.9;
/// Ends must be this close to a material's mean, as a share of the profile's contrast.
const PLATEAU: f64 = 0.12;
/// Fewest profiles to trust.
const MIN_PROFILES: usize = 200;
/// Distances (mm, along the normal) and normalised grey values along a profile.
type Profile = [(f64, f64); 2 * REACH + 1];

/// The blur found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Blur {
    /// Standard deviation of the blur in mm; `None` if too few clean profiles were found.
    pub sigma_mm: Option<f64>,
    /// Profiles used.
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
        Self { sigma_mm: None, profiles: 0, radius: radius_per_axis(radius, geometry), lowered_from: None }
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

/// Slices that a look for profiles must see on both sides of those it looks at.
pub const BLUR_HALO: usize = REACH + 1;

/// Estimates the blur of a volume in memory.
///
/// # Panics
/// If the slab does not hold all slices.
#[must_use]
pub fn estimate_blur<S: Sample>(slab: Slab<'_, S>, geometry: &Geometry, materials: &MaterialTable) -> Blur {
    let mut sigmas = Sigmas::new(geometry, materials);
    steps(slab.size()).for_each(|core| sigmas.add(slab, core));
    sigmas.blur()
}

/// Estimates the blur of a volume in one pass of a window on it, by slabs of `thickness` slices (and
/// [`BLUR_HALO`]).
///
/// # Errors
/// [`VolumeError`] if the volume cannot be read.
pub fn read_blur<S: Sample>(
    window: &mut SampleWindow<'_, S>,
    geometry: &Geometry,
    materials: &MaterialTable,
    thickness: usize,
) -> Result<Blur, VolumeError> {
    let mut sigmas = Sigmas::new(geometry, materials);
    window.sweep(thickness, BLUR_HALO, |slab, core| {
        sigmas.add(slab, core);
        Ok::<_, VolumeError>(())
    })?;
    Ok(sigmas.blur())
}

/// The sigmas (in voxels of mean edge length) of the clean profiles through the points of the grid.
struct Sigmas<'a> {
    geometry: &'a Geometry,
    materials: &'a MaterialTable,
    grid: SampleGrid,
    sigmas: Vec<f64>,
}

impl<'a> Sigmas<'a> {
    fn new(geometry: &'a Geometry, materials: &'a MaterialTable) -> Self {
        let grid = SampleGrid::new(geometry.size(), POINTS);
        Self { geometry, materials, grid, sigmas: Vec::new() }
    }

    /// Adds the profiles through the points in the slices `core`.
    fn add<S: Sample>(&mut self, slab: Slab<'_, S>, core: Range<usize>) {
        let Self { geometry, materials, grid, sigmas } = self;
        let (materials, grid): (&MaterialTable, &SampleGrid) = (materials, grid);
        let (spacing, edge) = (geometry.spacing(), geometry.voxel_edge());
        let [across, down, _] = grid.points;
        let planes = grid.within(core);
        sigmas.par_extend((0..down * planes.len()).into_par_iter().flat_map_iter(|i| {
            let (y, z) = (grid.at(i % down), grid.at(planes.start + i / down));
            (0..3).flat_map(move |axis| {
                let candidates = Candidates::new(slab, [y, z], axis);
                let xs = (0..across).map(|i| grid.at(i)).filter(move |&x| candidates.is_one(x));
                xs.filter_map(move |x| {
                    Some(fit_sigma(&profile(slab, spacing, materials, [x, y, z], axis)?) / edge)
                })
            })
        }));
    }

    /// The blur, from the median.
    fn blur(mut self) -> Blur {
        let edge = self.geometry.voxel_edge();
        let (profiles, middle) = (self.sigmas.len(), self.sigmas.len() / 2);
        let sigma =
            (profiles >= MIN_PROFILES).then(|| *self.sigmas.select_nth_unstable_by(middle, f64::total_cmp).1);
        // Below one voxel a ball has no neighbours; far above the usual, profiles cannot have been clean.
        let radius =
            sigma.map_or(DEFAULT_RADIUS, |s| (RADIUS_PER_SIGMA * s).clamp(1.0, MAX_ESTIMATED_RADIUS));
        Blur {
            sigma_mm: sigma.map(|s| s * edge),
            profiles,
            radius: radius_per_axis(radius, self.geometry).map(|r| r.min(MAX_RADIUS)),
            lowered_from: None,
        }
    }
}

/// The values that tell of most voxels of a row that they are not the last ones before a crossing.
struct Candidates<'a, S> {
    /// The rows of both ends, the voxel and the next one; none if the volume ends before.
    rows: Option<[&'a [S]; 4]>,
    /// Where in its row each of them is, from the voxel.
    offsets: [isize; 4],
}

impl<'a, S: Sample> Candidates<'a, S> {
    /// For profiles along `axis` through the row (y, z).
    fn new(slab: Slab<'a, S>, [y, z]: [usize; 2], axis: usize) -> Self {
        let steps = [-(REACH as isize), REACH as isize, 0, 1];
        let size = slab.size();
        let fits = |at: usize, n: usize| at >= REACH && at + REACH + 1 < n;
        let (rows, offsets) = match axis {
            0 => (Some([slab.row(y, z); 4]), steps),
            1 => (fits(y, size[1]).then(|| steps.map(|d| slab.row(y.wrapping_add_signed(d), z))), [0; 4]),
            _ => (fits(z, size[2]).then(|| steps.map(|d| slab.row(y, z.wrapping_add_signed(d)))), [0; 4]),
        };
        Self { rows, offsets }
    }

    /// Whether voxel x is the last one on the near side of the half.
    fn is_one(&self, x: usize) -> bool {
        let Some(rows) = self.rows else { return false };
        let value = |i: usize| {
            rows[i].get(x.wrapping_add_signed(self.offsets[i])).map_or(f64::NAN, |v| f64::from(v.to_f32()))
        };
        let [first, last, own, next] = std::array::from_fn(value);
        let half = 0.5 * (first + last);
        (own < half) != (next < half) && (own < half) == (first < half)
    }
}

/// The profile through `voxel` along `axis`, if the voxel is the last one before a clean crossing.
fn profile<S: Sample>(
    slab: Slab<'_, S>,
    spacing: [f64; 3],
    materials: &MaterialTable,
    voxel: [usize; 3],
    axis: usize,
) -> Option<Profile> {
    if voxel[axis] < REACH || voxel[axis] + REACH + 1 >= slab.size()[axis] {
        return None;
    }
    let step = |a: usize, d: isize| {
        let mut voxel = voxel;
        voxel[a] = voxel[a].wrapping_add_signed(d);
        f64::from(slab.grey(voxel))
    };
    let along = |d: isize| step(axis, d);
    let (first, last) = (along(-(REACH as isize)), along(REACH as isize));
    let contrast = last - first;
    let half = 0.5 * (first + last);
    // The voxel is the last one on the near side of the half.
    if (along(0) < half) == (along(1) < half) || (along(0) < half) != (first < half) {
        return None;
    }
    let nearest = |v: f64| {
        let distance = |m: &super::Material| (m.mean - v).abs();
        materials.materials().iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))
    };
    let (near, far) = (nearest(first)?, nearest(last)?);
    let on_plateau = |v: f64, mean: f64| (v - mean).abs() <= PLATEAU * contrast.abs();
    if near.id == far.id || !on_plateau(first, near.mean) || !on_plateau(last, far.mean) {
        return None;
    }
    // Both ends must be flat, or a third material may begin just beyond.
    if (along(-(REACH as isize) + 1) - first).abs() > PLATEAU * contrast.abs()
        || (along(REACH as isize - 1) - last).abs() > PLATEAU * contrast.abs()
    {
        return None;
    }
    let gradient: [f64; 3] = std::array::from_fn(|a| (step(a, 1) - step(a, -1)) / (2.0 * spacing[a]));
    let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    let cosine = gradient[axis].abs() / norm;
    if cosine.is_nan() || cosine < MIN_COSINE {
        return None;
    }
    let crossing = (half - along(0)) / (along(1) - along(0));
    let mean = |m: &super::Material| m.mean;
    Some(std::array::from_fn(|i| {
        let d = i as isize - REACH as isize;
        let mm = (d as f64 - crossing) * spacing[axis] * cosine;
        (mm, (along(d) - mean(near)) / (mean(far) - mean(near)))
    }))
}

/// The sigma of the error function that fits a profile best.
fn fit_sigma(profile: &Profile) -> f64 {
    let misfit =
        |sigma: f64| profile.iter().map(|&(mm, u)| (u - normal_cdf(mm / sigma)).powi(2)).sum::<f64>();
    // Golden-section search; the misfit has one minimum in sigma. Of the two inner places one was an
    // inner place before, so its misfit is known.
    let ratio = 0.5 * (5f64.sqrt() - 1.0);
    let length = profile[REACH + 1].0 - profile[REACH].0;
    let (mut low, mut high) = (0.05 * length, 4.0 * length);
    let inner = |low: f64, high: f64| [high - ratio * (high - low), low + ratio * (high - low)];
    let mut values = inner(low, high).map(misfit);
    while high - low > 1e-3 * length {
        let [a, b] = inner(low, high);
        if values[0] < values[1] {
            high = b;
            values = [misfit(inner(low, high)[0]), values[0]];
        } else {
            low = a;
            values = [values[1], misfit(inner(low, high)[1])];
        }
    }
    0.5 * (low + high)
}

/// The standard normal distribution function.
fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_blur_of_a_tilted_step_is_found_on_an_anisotropic_lattice() {
        let size = [40, 30, 30];
        let spacing = [0.4, 0.4, 0.5];
        let geometry = Geometry::axis_aligned(size, spacing).unwrap();
        let n = glam::DVec3::new(1.0, 0.2, 0.15).normalize();
        for sigma in [0.35, 0.5, 0.8] {
            let samples: Vec<u16> = (0..36_000)
                .map(|i| {
                    let p = [i % 40, i / 40 % 30, i / 1200].map(|c| c as f64);
                    let d = n.dot(glam::DVec3::from(std::array::from_fn(|a| p[a] * spacing[a]))) - 9.0;
                    (4000.0 + 7600.0 * normal_cdf(d / sigma)) as u16
                })
                .collect();
            let table = MaterialTable::new([("air", 4000.0), ("al", 11600.0)]).unwrap();
            let blur = estimate_blur(Slab::whole(&samples, size), &geometry, &table);
            let found = blur.sigma_mm.unwrap();
            assert!((found / sigma - 1.0).abs() < 0.04, "{found} for {sigma}, {} profiles", blur.profiles);
            assert!((blur.radius[0] / blur.radius[2] - 1.25).abs() < 1e-9);
        }
    }

    #[test]
    fn without_profiles_the_usual_radius_is_taken() {
        let geometry = Geometry::axis_aligned([20; 3], [1.0; 3]).unwrap();
        let table = MaterialTable::new([("air", 0.0), ("al", 10.0)]).unwrap();
        let blur = estimate_blur(Slab::whole(&[0u8; 8000], [20; 3]), &geometry, &table);
        assert_eq!((blur.sigma_mm, blur.profiles), (None, 0));
        assert!((blur.radius[0] - DEFAULT_RADIUS).abs() < 1e-9);
    }
}
