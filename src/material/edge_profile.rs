//! The profile of all interfaces on each other: how well an error function describes the scan.

use serde::{Deserialize, Serialize};

use super::edge_fit::{EdgeFit, normal_cdf};
use super::edge_patches::Patch;

/// Bins, and the distance (in widths s) that they reach on both sides.
const BINS: usize = 33;
const REACH: f64 = 4.0;

/// Voxels at about one distance from their interface.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ProfileBin {
    /// Middle of the bin: distance from the interface in units of the blur's sigma along the normal; negative
    /// on the less dense side.
    pub distance: f64,
    /// Voxels in it.
    pub count: u64,
    /// Their mean grey value; 0 and 1 are the plateaus of both materials.
    pub grey: f64,
    /// What an error function of the blur found says of the same voxels.
    pub model: f64,
}

/// All interfaces used for the blur on each other, normalised.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EdgeProfile {
    /// 33 bins from -4 to 4.
    pub bins: Vec<ProfileBin>,
    /// How far the mean profile is from the error function: root mean square of `grey - model` over the bins
    /// (as a share of the contrast), noise averaged out. The blur is Gaussian as far as this is small.
    pub residual: f64,
    /// The same over single voxels: noise, mostly.
    pub scatter: f64,
    /// How well interfaces of single pairs are blurred steps.
    pub misfits: Vec<Misfit>,
}

/// How far grey values at the interfaces of a pair of materials are from a blurred step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Misfit {
    /// Positions of the materials in the table, ascending.
    pub pair: [usize; 2],
    /// Interfaces measured.
    pub patches: usize,
    /// Beyond the noise inside of both materials: root mean square as a share of the contrast, of the median interface. Blur
    /// that is not Gaussian, streaks, clipped grey values.
    pub share: f64,
    /// By how much squared deviations, noise and all, are larger at an interface that nine in ten are better than: 1 with
    /// noise alone, more where streaks and shadows are not everywhere. From the better half: among the others are such that
    /// bend.
    pub spread: f64,
}

impl EdgeProfile {
    /// Of fitted patches, each with the width (mm) that the blur found gives its normal.
    pub(super) fn of<'a>(patches: impl Iterator<Item = (&'a Patch, &'a EdgeFit, f64)>) -> Self {
        let mut sums = [(0_u64, 0.0, 0.0); BINS];
        let (mut squares, mut count) = (0.0, 0_u64);
        let step = 2.0 * REACH / (BINS - 1) as f64;
        for (patch, fit, sigma) in patches {
            let [low, high] = fit.plateaus;
            // The less dense material on the left.
            let side = if high > low { 1.0 } else { -1.0 };
            for (&v, &d) in patch.grey.iter().zip(&fit.distances) {
                let t = f64::from(d) / sigma;
                let share = fit.share(f64::from(v), f64::from(d));
                let grey = if high > low { share } else { 1.0 - share };
                let bin = (side * t + REACH) / step + 0.5;
                if bin >= 0.0 && bin < BINS as f64 {
                    let model = normal_cdf(side * t);
                    let sum = &mut sums[bin as usize];
                    *sum = (sum.0 + 1, sum.1 + grey, sum.2 + model);
                    squares += (grey - model).powi(2);
                    count += 1;
                }
            }
        }
        let bins: Vec<ProfileBin> = sums
            .iter()
            .enumerate()
            .map(|(i, &(count, grey, model))| {
                let n = count.max(1) as f64;
                ProfileBin { distance: i as f64 * step - REACH, count, grey: grey / n, model: model / n }
            })
            .collect();
        let filled = bins.iter().filter(|b| b.count > 0);
        let misfit: f64 = filled.clone().map(|b| (b.grey - b.model).powi(2)).sum();
        let residual = (misfit / filled.count().max(1) as f64).sqrt();
        Self { bins, residual, scatter: (squares / count.max(1) as f64).sqrt(), misfits: Vec::new() }
    }
}
