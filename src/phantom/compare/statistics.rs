//! Weighted statistics of distances.

use serde::{Deserialize, Serialize};

/// Figures of a set of distances, all in the same unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Weighted mean of the signed distances. For curves, whose distances have no sign: the mean.
    pub signed_mean: f64,
    /// Root of the weighted mean square.
    pub rms: f64,
    /// 95 % of the weight is at most this far.
    pub p95: f64,
    /// 99 % of the weight is at most this far.
    pub p99: f64,
    /// The largest distance, vertices included.
    pub max: f64,
}

/// Figures of a set of distances in voxels and mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Distances {
    /// Number of sample points.
    pub samples: usize,
    /// What they stand for: mm² on surfaces, mm on curves.
    pub measure: f64,
    /// In voxels.
    pub voxels: Figures,
    /// In mm.
    pub mm: Figures,
}

/// A signed distance in mm and what the point stands for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub(super) signed: f64,
    pub(super) weight: f64,
}

/// Sum of lengths; 0 of none, where the standard library's is -0.
pub(super) fn total(lengths: impl Iterator<Item = f64>) -> f64 {
    lengths.fold(0.0, |sum, length| sum + length)
}

impl Distances {
    /// The figures of `samples`; `None` if there are none. `voxel` is mm per voxel.
    pub(super) fn of(samples: impl Iterator<Item = Sample>, voxel: f64) -> Option<Self> {
        let mut all: Vec<Sample> = samples.collect();
        let measure: f64 = all.iter().map(|s| s.weight).sum();
        if all.is_empty() {
            return None;
        }
        // Samples without weight alone (a mesh of degenerate triangles) count equally.
        let equal = measure <= 0.0;
        if equal {
            all.iter_mut().for_each(|s| s.weight = 1.0);
        }
        let total: f64 = all.iter().map(|s| s.weight).sum();
        let signed_mean = all.iter().map(|s| s.weight * s.signed).sum::<f64>() / total;
        let square = all.iter().map(|s| s.weight * s.signed * s.signed).sum::<f64>() / total;
        all.sort_by(|a, b| a.signed.abs().total_cmp(&b.signed.abs()));
        let quantile = |share: f64| {
            let mut below = 0.0;
            let found = all.iter().find(|s| {
                below += s.weight;
                below >= share * total
            });
            found.or(all.last()).map_or(0.0, |s| s.signed.abs())
        };
        let (p95, p99) = (quantile(0.95), quantile(0.99));
        let max = all.last().map_or(0.0, |s| s.signed.abs());
        let mm = Figures { signed_mean, rms: square.sqrt(), p95, p99, max };
        let voxels = Figures {
            signed_mean: mm.signed_mean / voxel,
            rms: mm.rms / voxel,
            p95: mm.p95 / voxel,
            p99: mm.p99 / voxel,
            max: mm.max / voxel,
        };
        Some(Self { samples: all.len(), measure: if equal { 0.0 } else { measure }, voxels, mm })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_count_and_weightless_samples_set_the_maximum_only() {
        let samples = [(1.0, 3.0), (-1.0, 1.0), (5.0, 0.0)].map(|(signed, weight)| Sample { signed, weight });
        let figures = Distances::of(samples.into_iter(), 0.5).unwrap();
        assert!((figures.mm.signed_mean - 0.5).abs() < 1e-12);
        assert!((figures.mm.rms - 1.0).abs() < 1e-12);
        assert!((figures.mm.p95 - 1.0).abs() < 1e-12);
        assert!((figures.mm.p99 - 1.0).abs() < 1e-12);
        assert!((figures.voxels.max - 10.0).abs() < 1e-12);
        assert!(Distances::of(std::iter::empty(), 1.0).is_none());
    }
}
