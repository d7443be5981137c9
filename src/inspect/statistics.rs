//! Sums over residuals, per pair of materials.

use serde::{Deserialize, Serialize};

use crate::grid::{MaterialId, Pair};

/// Bins of the histogram of absolute residuals, and how many of them are one contrast.
const BINS: usize = 20_000;
const PER_CONTRAST: f64 = 10_000.0;

/// Figures of the residuals of some voxels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// How many voxels.
    pub voxels: u64,
    /// Mean of measured less modelled grey values.
    pub mean: f64,
    /// Root of the mean square, grey values.
    pub rms: f64,
    /// Median of the absolute residual, grey values, to 0.01 % of the contrast.
    pub median: f64,
    /// 95 % of the absolute residuals are at most this, grey values, to 0.01 % of the contrast.
    pub p95: f64,
    /// `rms`, `median` and `p95` in percent of the contrast.
    pub percent: [f64; 3],
}

/// The residual along one interface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairResidual {
    /// The material behind.
    pub back: MaterialId,
    /// The material in front.
    pub front: MaterialId,
    /// Difference of their mean grey values.
    pub contrast: f64,
    /// All voxels that are nearest to it.
    pub all: Option<Figures>,
    /// Those away from junction curves.
    pub away: Option<Figures>,
    /// Those near junction curves.
    pub near: Option<Figures>,
}

/// The residual well inside of a material: what noise and levels leave without any surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DeepResidual {
    /// The material.
    pub material: MaterialId,
    /// How many voxels.
    pub voxels: u64,
    /// Root of the mean square, grey values; 0 without voxels.
    pub rms: f64,
}

/// Sums over residuals of voxels that share a contrast.
#[derive(Debug, Clone)]
pub(super) struct Sums {
    contrast: f64,
    voxels: u64,
    sum: f64,
    squares: f64,
    /// Of absolute residuals; the last bin holds all larger ones.
    histogram: Vec<u64>,
}

impl Sums {
    pub(super) fn new(contrast: f64) -> Self {
        Self { contrast, voxels: 0, sum: 0.0, squares: 0.0, histogram: Vec::new() }
    }

    pub(super) fn add(&mut self, residual: f64) {
        if self.histogram.is_empty() {
            self.histogram = vec![0; BINS + 1];
        }
        self.voxels += 1;
        self.sum += residual;
        self.squares += residual * residual;
        self.histogram[((residual.abs() / self.contrast * PER_CONTRAST) as usize).min(BINS)] += 1;
    }

    /// Adds the sums of others.
    pub(super) fn join(&mut self, more: &Self) {
        self.voxels += more.voxels;
        self.sum += more.sum;
        self.squares += more.squares;
        if self.histogram.is_empty() {
            self.histogram.clone_from(&more.histogram);
        } else {
            self.histogram.iter_mut().zip(&more.histogram).for_each(|(own, more)| *own += more);
        }
    }

    /// The figures of all voxels of some sums with the same contrast; `None` without any.
    pub(super) fn figures(all: &[&Self]) -> Option<Figures> {
        let contrast = all.first()?.contrast;
        let voxels: u64 = all.iter().map(|s| s.voxels).sum();
        if voxels == 0 {
            return None;
        }
        let n = voxels as f64;
        let quantile = |share: f64| {
            let rank = (share * n).ceil().max(1.0) as u64;
            let mut seen = 0;
            let bin = (0..=BINS).find(|&bin| {
                seen += all.iter().filter_map(|s| s.histogram.get(bin)).sum::<u64>();
                seen >= rank
            });
            (bin.unwrap_or(BINS) as f64 + 0.5) / PER_CONTRAST * contrast
        };
        let mean = all.iter().map(|s| s.sum).sum::<f64>() / n;
        let rms = (all.iter().map(|s| s.squares).sum::<f64>() / n).sqrt();
        let (median, p95) = (quantile(0.5), quantile(0.95));
        let percent = [rms, median, p95].map(|v| 100.0 * v / contrast);
        Some(Figures { voxels, mean, rms, median, p95, percent })
    }
}

/// Sums for one interface.
#[derive(Debug, Clone)]
pub(super) struct PairSums {
    pub(super) pair: Pair,
    pub(super) contrast: f64,
    /// Away from junctions, near them.
    pub(super) sums: [Sums; 2],
}

impl PairSums {
    pub(super) fn new(pair: Pair, contrast: f64) -> Self {
        Self { pair, contrast, sums: [Sums::new(contrast), Sums::new(contrast)] }
    }

    pub(super) fn finish(&self) -> PairResidual {
        let [away, near] = &self.sums;
        PairResidual {
            back: self.pair.back(),
            front: self.pair.front(),
            contrast: self.contrast,
            all: Sums::figures(&[away, near]),
            away: Sums::figures(&[away]),
            near: Sums::figures(&[near]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_those_of_the_values_added() {
        let mut sums = Sums::new(100.0);
        assert_eq!(Sums::figures(&[&sums]), None);
        (1..=100).for_each(|k| sums.add(if k % 2 == 0 { 0.1 } else { -0.1 } * f64::from(k)));
        let f = Sums::figures(&[&sums, &Sums::new(100.0)]).unwrap();
        assert_eq!(f.voxels, 100);
        assert!((f.mean - 0.05).abs() < 1e-12 && (f.rms - 5.816_785_2).abs() < 1e-6);
        assert!((f.median - 5.0).abs() < 0.02 && (f.p95 - 9.5).abs() < 0.02, "{f:?}");
    }
}
