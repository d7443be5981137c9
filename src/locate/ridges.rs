//! Local extrema of grey: where something thin may be that no grey value tells from a blurred interface.
//!
//! At a blurred interface the grey value passes through every level between two materials, but it has no extremum there.
//! Across something thin it has one: it falls (or rises) on both sides. A quadratic form is fitted to the 5³ voxels
//! around a voxel, weighted by a Gaussian of the blur's size, which gives grey value, gradient and second derivatives.
//! A *ridge* is a voxel where
//!
//! - the largest second derivative is beyond noise, and no other is of opposite sign and like size (a saddle);
//! - the extremum along the directions of large second derivatives is within a voxel;
//! - across them the grey value hardly changes. This tells a thin part from what lies before a sharp edge, whose grey
//!   values also fall to both sides, but far faster along;
//! - on both sides the grey value has left that of the ridge by more than noise, within four units.
//!
//! Guaranteed: a voxel's answer needs voxels within [`REACH`] units and [`AROUND`] voxels of it alone.

use glam::DVec3;
use nalgebra::{Matrix3, SMatrix, SVector};

use super::view::View;
use crate::volume::Greys;

/// Voxels around that a form is fitted to, along each axis and way.
pub(super) const AROUND: usize = 2;
/// How far on both sides of a ridge grey values are looked at, blur units.
pub(super) const REACH: f64 = 4.0;
/// Weights fall with this standard deviation, blur units.
const WIDTH: f64 = 1.0;
/// An extremum within this many voxels of a voxel is its own.
const NEAR: f64 = 0.95;
/// In standard deviations of the noise: second derivatives, differences.
const SURE: f64 = 6.0;
/// Second derivatives of at least this share of the largest belong to it; of opposite sign they may reach
/// `SADDLE` of it.
const LARGE: f64 = 0.4;
const SADDLE: f64 = 0.35;
/// Change per blur unit along a ridge, as a share of its height.
const ALONG: f64 = 0.25;
/// Grey values are compared this far on both sides before anything is fitted, blur units.
const ASIDE: f64 = 1.8;

/// A ridge, or a valley, at a voxel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ridge {
    /// Whether it is brighter than what is around.
    pub bright: bool,
    /// In how many directions: 1 something like a plate, 2 a rod, 3 a ball.
    pub rank: usize,
    /// The direction of the largest second derivative, blur units.
    pub normal: DVec3,
    /// Where the extremum is, blur units from the voxel.
    pub offset: DVec3,
    /// Grey value there.
    pub grey: f64,
    /// Size of the second derivative, grey values.
    pub strength: f64,
    /// The grey value farthest from the ridge's on each side, along and against the normal.
    pub sides: [f64; 2],
}

/// Monomials of a quadratic form, so that its coefficients are value, gradient and second derivatives.
fn monomials(at: DVec3) -> SVector<f64, 10> {
    let DVec3 { x, y, z } = at;
    SVector::from([1.0, x, y, z, 0.5 * x * x, 0.5 * y * y, 0.5 * z * z, x * y, x * z, y * z])
}

/// Finds ridges in a scan.
#[derive(Debug)]
pub(super) struct Finder {
    offsets: Vec<[isize; 3]>,
    weights: Vec<SVector<f64, 10>>,
    /// Standard deviation of a second derivative per standard deviation of a grey value.
    spread: f64,
    /// Pairs of places that are compared first, voxels.
    opposite: Vec<[isize; 3]>,
    per_voxel: DVec3,
    noise: f64,
}

impl Finder {
    /// For what `view` shows; `None` if a form cannot be fitted.
    #[must_use]
    pub(super) fn new(view: &View<'_>) -> Option<Self> {
        let per_voxel = view.units.per_voxel;
        let n = AROUND as isize;
        let all = |n: isize| {
            (-n..=n).flat_map(move |z| (-n..=n).flat_map(move |y| (-n..=n).map(move |x| [x, y, z])))
        };
        let place = |o: [isize; 3]| DVec3::from(o.map(|c| c as f64)) * per_voxel;
        let weight = |o: [isize; 3]| libm::exp(-0.5 * place(o).length_squared() / (WIDTH * WIDTH));
        let mut matrix = SMatrix::<f64, 10, 10>::zeros();
        for o in all(n) {
            let m = monomials(place(o));
            matrix += m * m.transpose() * weight(o);
        }
        let inverse = matrix.try_inverse()?;
        let offsets: Vec<_> = all(n).collect();
        let weights: Vec<_> = offsets.iter().map(|&o| inverse * monomials(place(o)) * weight(o)).collect();
        let spread =
            (4..7).map(|k| weights.iter().map(|w| w[k] * w[k]).sum::<f64>().sqrt()).fold(0.0, f64::max);
        let half: Vec<_> = all(1).filter(|o| *o > [0, 0, 0]).collect();
        let opposite = half
            .into_iter()
            .map(|o| {
                let far = ASIDE / place(o).length();
                o.map(|c| (c as f64 * far).round() as isize)
            })
            .collect();
        let noise = view.scan.noise.iter().copied().fold(0.0, f64::max);
        Some(Self { offsets, weights, spread, opposite, per_voxel, noise })
    }

    /// The ridge at a voxel, if there is one.
    #[must_use]
    pub(super) fn at(&self, slab: &dyn Greys, voxel: [usize; 3]) -> Option<Ridge> {
        let grey = |o: [isize; 3]| grey_at(slab, voxel, o);
        let own = grey([0; 3])?;
        let least = 4.0 * self.noise;
        let extreme = self.opposite.iter().any(|&o| {
            let [Some(a), Some(b)] = [grey(o), grey(o.map(|c| -c))] else { return false };
            (a < own - least && b < own - least) || (a > own + least && b > own + least)
        });
        if !extreme {
            return None;
        }
        let mut form = SVector::<f64, 10>::zeros();
        for (o, w) in self.offsets.iter().zip(&self.weights) {
            form += w * grey(*o)?;
        }
        let second =
            Matrix3::new(form[4], form[7], form[8], form[7], form[5], form[9], form[8], form[9], form[6]);
        let gradient = DVec3::new(form[1], form[2], form[3]);
        let eigen = second.symmetric_eigen();
        let strongest = eigen.eigenvalues.iamax();
        let strength = eigen.eigenvalues[strongest];
        if strength.abs() < SURE * self.spread * self.noise {
            return None;
        }
        let axis = |k: usize| {
            let c = eigen.eigenvectors.column(k);
            DVec3::new(c[0], c[1], c[2])
        };
        let (mut rank, mut offset, mut along) = (0, DVec3::ZERO, 0.0f64);
        for k in 0..3 {
            let (ratio, slope) = (eigen.eigenvalues[k] / strength, gradient.dot(axis(k)));
            if ratio < -SADDLE {
                return None;
            }
            if ratio > LARGE {
                rank += 1;
                offset -= axis(k) * (slope / eigen.eigenvalues[k]);
            } else {
                along = along.hypot(slope);
            }
        }
        if (offset / self.per_voxel).length() > NEAR {
            return None;
        }
        let bright = strength < 0.0;
        let sign = if bright { 1.0 } else { -1.0 };
        let normal = axis(strongest);
        let top = form[0] + 0.5 * gradient.dot(offset);
        let sides = [1.0, -1.0].map(|way| {
            (0..6)
                .filter_map(|k| {
                    let at = (offset + normal * (way * (REACH - 0.5 * f64::from(k)))) / self.per_voxel;
                    grey(at.to_array().map(|c| c.round() as isize))
                })
                .reduce(|a, b| if (a < b) == bright { a } else { b })
        });
        let [Some(a), Some(b)] = sides else { return None };
        let height = (sign * (top - a)).min(sign * (top - b));
        (height > SURE * self.noise && along < ALONG * height).then_some(Ridge {
            bright,
            rank,
            normal,
            offset,
            grey: top,
            strength: strength.abs(),
            sides: [a, b],
        })
    }
}

/// The grey value of the voxel at an offset, if it is here.
pub(super) fn grey_at(slab: &dyn Greys, voxel: [usize; 3], o: [isize; 3]) -> Option<f64> {
    let (size, slices) = (slab.size(), slab.slices());
    let mut at = [0; 3];
    for a in 0..3 {
        at[a] = voxel[a].checked_add_signed(o[a]).filter(|&c| c < size[a])?;
    }
    slices.contains(&at[2]).then(|| f64::from(slab.grey(at)))
}
