//! One sigma per lattice axis from the widths of many blurred steps.
//!
//! 1. Steps that are not clean go: residuals far above what is usual for their two materials (a third material,
//!    a sharp edge, a streak).
//! 2. The *median* of the widths, each weighted with the candidates it stands for, is the sigma for all
//!    directions. Widths far from it are not the scan's: slices of padding cut a part off within one voxel.
//! 3. `s_n² = sum n_a² s_a²` is fitted to the rest by least squares, reweighted with Tukey's biweight, from the
//!    medians along each axis on, with a weak pull to the median of all. Axes that too few steps face get that.

use nalgebra::{Matrix3, Vector3};

use super::blur::Blur;
use super::edge_fit::EdgeFit;
use super::edge_patches::Patch;
use super::edge_profile::EdgeProfile;
use crate::grid::Geometry;

/// A patch, its fit, and the candidates it stands for.
pub(super) type Fitted = (Patch, EdgeFit, f64);

/// Fewest patches to trust.
const MIN_PATCHES: usize = 100;
/// Residuals up to so many times the usual ones of the pair are usual, and a share of the contrast that is
/// nothing.
const USUAL: f64 = 1.4;
const NOTHING: f64 = 0.004;
/// Widths that can be the scan's, as multiples of the median.
const SPREAD: [f64; 2] = [0.6, 2.5];
/// Share of a width below which its error is no matter: steps of high contrast do not decide alone.
const FLOOR: f64 = 0.02;
/// Strength of the pull to the median, in patches.
const PULL: f64 = 1.0;
/// Most of an axis that the pull may decide before it counts as not measured.
const PULLED: f64 = 0.1;
/// Sum of n_a² over the steps below which none of them is heard about axis a: a few odd ones (padding, streaks)
/// would decide it.
const MIN_SUM: f64 = 15.0;
/// Tukey's constant: 95 % as good as least squares where nothing is wrong.
const TUKEY: f64 = 4.685;
const ROUNDS: usize = 30;
/// Squared widths within so much (of the squared median) of the fit are never outliers.
const SCALE: f64 = 0.02;
/// A patch faces an axis if the square of its normal's component there is at least this, and so many patches
/// give a median of their own to begin with.
const FACING: f64 = 0.6;
const MIN_FACING: usize = 10;

/// The blur of a volume whose clean interfaces are `fitted`, and the profile of those it was taken from.
pub(super) fn blur(geometry: &Geometry, fitted: &[Fitted]) -> (Blur, Option<EdgeProfile>) {
    let clean = clean(fitted);
    if clean.len() < MIN_PATCHES {
        return (Blur::found(geometry, None, None, [true; 3], clean.len()), None);
    }
    let median =
        weighted_median(&clean.iter().map(|(_, fit, weight)| (fit.sigma, *weight)).collect::<Vec<_>>());
    let kept: Vec<&Fitted> = clean
        .into_iter()
        .filter(|(_, fit, _)| (SPREAD[0]..SPREAD[1]).contains(&(fit.sigma / median)))
        .collect();
    let fits: Vec<&EdgeFit> = kept.iter().map(|(_, fit, _)| fit).collect();
    let (axes, isotropic, weights) = per_axis(&fits, median);
    let used = kept.iter().zip(&weights).filter(|(_, w)| **w > 0.0);
    let profile = EdgeProfile::of(used.clone().map(|((patch, fit, _), _)| (patch, fit, width(fit, axes))));
    (Blur::found(geometry, Some(median), Some(axes), isotropic, used.count()), Some(profile))
}

/// Width of a step with the fit's normal for a sigma per axis.
fn width(fit: &EdgeFit, axes: [f64; 3]) -> f64 {
    fit.normal2.iter().zip(axes).map(|(n2, s)| n2 * s * s).sum::<f64>().sqrt()
}

/// Those whose residuals are usual for their pair of materials.
fn clean(fitted: &[Fitted]) -> Vec<&Fitted> {
    let pair = |patch: &Patch| {
        [patch.materials[0].min(patch.materials[1]), patch.materials[0].max(patch.materials[1])]
    };
    let mut pairs: Vec<[usize; 2]> = fitted.iter().map(|(patch, ..)| pair(patch)).collect();
    pairs.sort_unstable();
    pairs.dedup();
    let usual: Vec<f64> = pairs
        .iter()
        .map(|own| {
            let of_pair = fitted.iter().filter(|(patch, ..)| pair(patch) == *own);
            weighted_median(&of_pair.map(|(_, fit, weight)| (fit.rms, *weight)).collect::<Vec<_>>())
        })
        .collect();
    fitted
        .iter()
        .filter(|(patch, fit, _)| {
            let contrast = (fit.plateaus[1] - fit.plateaus[0]).abs();
            let limit = pairs.binary_search(&pair(patch)).map_or(0.0, |i| USUAL * usual[i]);
            fit.rms <= limit + NOTHING * contrast
        })
        .collect()
}

/// Sigma per axis, which axes were not measured, and the weight of each fit in the end.
fn per_axis(fits: &[&EdgeFit], median: f64) -> ([f64; 3], [bool; 3], Vec<f64>) {
    // In units of the median: pull and data are plain numbers.
    let rows: Vec<(Vector3<f64>, f64, f64)> = fits
        .iter()
        .map(|fit| {
            let s2 = (fit.sigma / median).powi(2);
            let error = (fit.sigma_error / fit.sigma).hypot(FLOOR) / FLOOR;
            (Vector3::from(fit.normal2), s2, error.powi(-2))
        })
        .collect();
    let strength = rows.iter().map(|r| r.2).sum::<f64>() / rows.len().max(1) as f64;
    let few = [0, 1, 2].map(|a| rows.iter().map(|r| r.0[a]).sum::<f64>() < MIN_SUM);
    let mut axes2 = Vector3::from([0, 1, 2].map(|a| {
        let facing: Vec<_> = rows.iter().filter(|r| r.0[a] >= FACING).map(|r| (r.1, r.2)).collect();
        if facing.len() >= MIN_FACING && !few[a] { weighted_median(&facing) } else { 1.0 }
    }));
    let mut robust = vec![1.0; rows.len()];
    let mut isotropic = [false; 3];
    for _ in 0..ROUNDS {
        let residuals: Vec<f64> =
            rows.iter().map(|(n2, s2, weight)| (s2 - n2.dot(&axes2)) * weight.sqrt()).collect();
        let scale = weighted_median(&residuals.iter().map(|r| (r.abs(), 1.0)).collect::<Vec<_>>()) / 0.6745;
        let limit = TUKEY * scale.max(SCALE);
        for (robust, r) in robust.iter_mut().zip(&residuals) {
            let share = (r / limit).powi(2);
            *robust = if share < 1.0 { (1.0 - share).powi(2) } else { 0.0 };
        }
        let mut matrix = Matrix3::identity() * (PULL * strength);
        let mut right = Vector3::repeat(PULL * strength);
        for ((n2, s2, weight), robust) in rows.iter().zip(&robust) {
            matrix += n2 * n2.transpose() * (weight * robust);
            right += n2 * (s2 * weight * robust);
        }
        let inverse = matrix.try_inverse().unwrap_or_else(Matrix3::zeros);
        isotropic = std::array::from_fn(|a| few[a] || inverse[(a, a)] * PULL * strength > PULLED);
        for a in (0..3).filter(|&a| few[a]) {
            // As good as certain that it is the median.
            matrix[(a, a)] += 1e9 * strength;
            right[a] += 1e9 * strength;
        }
        axes2 = matrix.try_inverse().map_or(Vector3::repeat(1.0), |m| m * right);
        axes2.apply(|v| *v = v.clamp(SPREAD[0].powi(2), SPREAD[1].powi(2)));
    }
    (std::array::from_fn(|a| median * axes2[a].sqrt()), isotropic, robust)
}

/// The value with half of the weight below it; 0 without values.
fn weighted_median(values: &[(f64, f64)]) -> f64 {
    weighted_quantile(values, 0.5)
}

/// The value that those of the share `part` of the weight do not exceed, of values with weights; 0 without values.
pub(super) fn weighted_quantile(values: &[(f64, f64)], part: f64) -> f64 {
    let mut values = values.to_vec();
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let wanted = part * values.iter().map(|v| v.1).sum::<f64>();
    let mut below = 0.0;
    let found = values.iter().find(|(_, weight)| {
        below += weight;
        below >= wanted
    });
    found.or(values.last()).map_or(0.0, |v| v.0)
}
