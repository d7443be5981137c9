//! Noise of each material, free of slow drift, and how it is correlated.
//!
//! Along lines of voxels well inside of a material, second differences `v(-h) - 2 v(0) + v(h)` are free of any
//! linear drift (cupping, beam hardening). Their mean square is `sigma² (6 - 8 rho(h) + 2 rho(2h))` with rho the
//! autocorrelation at a lag along that axis. Noise of reconstructed volumes is correlated over a voxel or two, so
//! lags 5 and 6 give sigma² itself, and from there lags 1 and 2 give rho(2), then rho(1).
//!
//! Squares above 25 times the usual are left out: specks are not noise. Not guaranteed: correlation that reaches
//! further than 4 voxels (rings, streaks) is counted as drift and makes sigma too small.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::edge_patches::mixed;
use super::sampling::{SampleGrid, class_of, thresholds};
use super::table::MaterialTable;
use crate::volume::{Sample, Slab};

/// Longest lag.
const LAGS: usize = 6;
/// All voxels this far to the sides of a line must be of its material.
const MARGIN: usize = 3;
/// Slices needed on both sides of a line's middle.
pub(super) const REACH: usize = LAGS + MARGIN;
/// Middles of lines that are looked at, at most, and lines kept of each material and axis.
const POINTS: usize = 400_000;
const KEPT: usize = 8_192;
/// Fewest lines of a material along each axis to trust.
const MIN_LINES: usize = 64;
/// Differences above so many times the usual are no noise.
const USUAL: f64 = 5.0;
/// Radius of the ball whose mean tells [`Noise::effective`].
const BALL: i32 = 3;

/// The noise inside of a material.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    /// Standard deviation of single voxels, grey values, from differences of near voxels: without slow drift.
    pub sigma: f64,
    /// Autocorrelation at lags 1 and 2 along each axis.
    pub autocorrelation: [[f64; 2]; 3],
    /// Correlation length per axis, in voxels: sigma of the (sampled) Gaussian filter that turns white noise into
    /// noise correlated like this; 0 for white noise.
    pub correlation: [f64; 3],
    /// Times the variance of the mean over a ball of radius 3 voxels is that of as many independent voxels; 1 for
    /// white noise.
    pub effective: f64,
    /// Lines of voxels it was measured along, on the axis with the fewest.
    pub lines: u64,
}

/// Second differences of a line, by lag.
type Line = [f32; LAGS];

/// Lines found so far.
#[derive(Debug, Clone)]
pub(super) struct Lines {
    grid: SampleGrid,
    thresholds: Vec<f32>,
    /// By material and axis; the lowest hashes are kept.
    kept: Vec<[Vec<(u64, Line)>; 3]>,
}

impl Lines {
    pub(super) fn new(size: [usize; 3], table: &MaterialTable) -> Self {
        let greys: Vec<f64> = table.materials().iter().map(|m| m.mean).collect();
        let kept = vec![Default::default(); greys.len()];
        Self { grid: SampleGrid::new(size, POINTS), thresholds: thresholds(&greys), kept }
    }

    /// Looks for lines through the grid points in the slices `core`; `slab` must hold [`REACH`] more slices on
    /// both sides, as far as there are any.
    pub(super) fn add<S: Sample>(&mut self, slab: Slab<'_, S>, core: Range<usize>) {
        let (grid, thresholds) = (&self.grid, &self.thresholds);
        let [across, down, _] = grid.points;
        let planes = grid.within(core);
        let found: Vec<(usize, usize, u64, Line)> = (0..down * planes.len())
            .into_par_iter()
            .flat_map_iter(|i| {
                let (y, z) = (grid.at(i % down), grid.at(planes.start + i / down));
                let points =
                    (0..across).flat_map(move |i| (0..3).map(move |axis| ([grid.at(i), y, z], axis)));
                points.filter_map(move |(at, axis)| line(slab, thresholds, at, axis))
            })
            .collect();
        for (material, axis, hash, line) in found {
            self.kept[material][axis].push((hash, line));
        }
        for lines in self.kept.iter_mut().flatten().filter(|lines| lines.len() > KEPT) {
            lines.sort_unstable_by_key(|line| line.0);
            lines.truncate(KEPT);
        }
    }

    /// The noise of each material; `None` where too few voxels are well inside. `whole` says that grey values
    /// were rounded to whole numbers.
    pub(super) fn finish(mut self, whole: bool) -> Vec<Option<Noise>> {
        self.kept.iter_mut().flatten().for_each(|lines| lines.sort_unstable_by_key(|line| line.0));
        self.kept.iter().map(|lines| noise(lines, if whole { 1.0 } else { 0.0 })).collect()
    }
}

/// The line along `axis` through a voxel, if all around it is of one material; which one, and its hash.
fn line<S: Sample>(
    slab: Slab<'_, S>,
    thresholds: &[f32],
    at: [usize; 3],
    axis: usize,
) -> Option<(usize, usize, u64, Line)> {
    let size = slab.size();
    let room = |a: usize| if a == axis { REACH } else { MARGIN };
    if (0..3).any(|a| at[a] < room(a) || at[a] + room(a) >= size[a]) {
        return None;
    }
    let grey = |along: isize, step: [isize; 3]| {
        let mut voxel = at;
        voxel[axis] = voxel[axis].wrapping_add_signed(along);
        slab.grey(std::array::from_fn(|a| voxel[a].wrapping_add_signed(step[a])))
    };
    let own = class_of(thresholds, grey(0, [0; 3]));
    let margin = MARGIN as isize;
    // The ends of the line and the middle, with their surroundings: what is thin enough to pass between them is
    // too thin to matter.
    for along in [0, -6, 6, -3, 3] {
        for step in 0..27_isize {
            let step = [step % 3 - 1, step / 3 % 3 - 1, step / 9 - 1].map(|s| s * margin);
            if class_of(thresholds, grey(along, step)) != own {
                return None;
            }
        }
    }
    let middle = f64::from(grey(0, [0; 3]));
    let line = std::array::from_fn(|i| {
        let h = i as isize + 1;
        (f64::from(grey(-h, [0; 3])) - 2.0 * middle + f64::from(grey(h, [0; 3]))) as f32
    });
    let index = (at[2] * size[1] + at[1]) * size[0] + at[0];
    Some((own, axis, mixed(index as u64), line))
}

fn noise(lines: &[Vec<(u64, Line)>; 3], rounding: f64) -> Option<Noise> {
    let fewest = lines.iter().map(Vec::len).min().unwrap_or(0);
    if fewest < MIN_LINES {
        return None;
    }
    let squares = lines.each_ref().map(|lines| std::array::from_fn(|h| mean_square(lines, h, rounding)));
    let far: [[f64; LAGS]; 3] = squares;
    let variance = far.iter().map(|d| d[4] + d[5]).sum::<f64>() / (6.0 * 6.0);
    if variance <= 0.0 {
        let autocorrelation = [[0.0; 2]; 3];
        let (correlation, lines) = ([0.0; 3], fewest as u64);
        return Some(Noise { sigma: 0.0, autocorrelation, correlation, effective: 1.0, lines });
    }
    let autocorrelation = far.map(|d| {
        // rho(4) from lag 4 (rho(8) is none), then rho(2), then rho(1).
        let rho =
            |lag: usize, twice: f64| ((6.0 + 2.0 * twice - d[lag - 1] / variance) / 8.0).clamp(-1.0, 1.0);
        let four = rho(4, 0.0);
        let two = rho(2, four);
        [rho(1, two), two]
    });
    let correlation = autocorrelation.map(length);
    let effective = effective(correlation);
    Some(Noise { sigma: variance.sqrt(), autocorrelation, correlation, effective, lines: fewest as u64 })
}

/// The mean square of the differences at a lag, without those that are no noise.
fn mean_square(lines: &[(u64, Line)], lag: usize, rounding: f64) -> f64 {
    let mut sizes: Vec<f64> = lines.iter().map(|(_, line)| f64::from(line[lag]).abs()).collect();
    let middle = sizes.len() / 2;
    let median = *sizes.select_nth_unstable_by(middle, f64::total_cmp).1;
    let most = USUAL * median / 0.6745 + 3.0 * rounding;
    let usual = lines.iter().map(|(_, line)| f64::from(line[lag])).filter(|d| d.abs() <= most);
    let (n, sum) = usual.fold((0.0, 0.0), |(n, sum), d| (n + 1.0, sum + d * d));
    sum / f64::max(n, 1.0)
}

/// Autocorrelation at a lag of white noise filtered by a sampled Gaussian.
fn autocorrelation(sigma: f64, lag: i32) -> f64 {
    if sigma <= 0.0 {
        return if lag == 0 { 1.0 } else { 0.0 };
    }
    let weight = |i: i32| libm::exp(-0.5 * (f64::from(i) / sigma).powi(2));
    let reach = (5.0 * sigma).ceil() as i32 + 1;
    let sum = |lag: i32| (-reach..=reach).map(|i| weight(i) * weight(i + lag)).sum::<f64>();
    sum(lag) / sum(0)
}

/// The filter's sigma that explains autocorrelations at lags 1 and 2 best, by least squares; to 0.01.
fn length(rho: [f64; 2]) -> f64 {
    let misfit = |sigma: f64| {
        (autocorrelation(sigma, 1) - rho[0]).powi(2) + (autocorrelation(sigma, 2) - rho[1]).powi(2)
    };
    let candidates = (0..=300).map(|i| 0.01 * f64::from(i));
    let best = candidates.map(|s| (misfit(s), s)).min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or(0.0, |b| b.1)
}

/// The variance of a ball's mean against that for white noise: the mean over its voxels of the sum of their
/// correlations with all of its voxels.
fn effective(correlation: [f64; 3]) -> f64 {
    let rho: [Vec<f64>; 3] =
        correlation.map(|sigma| (0..=2 * BALL).map(|lag| autocorrelation(sigma, lag)).collect());
    let side = 2 * BALL + 1;
    let ball: Vec<[i32; 3]> = (0..side.pow(3))
        .map(|i| [i % side - BALL, i / side % side - BALL, i / (side * side) - BALL])
        .filter(|p| p.iter().map(|c| c * c).sum::<i32>() <= BALL * BALL)
        .collect();
    let pair = |p: &[i32; 3], q: &[i32; 3]| {
        (0..3).map(|a| rho[a][(p[a] - q[a]).unsigned_abs() as usize]).product::<f64>()
    };
    let sum: f64 = ball.iter().map(|p| ball.iter().map(|q| pair(p, q)).sum::<f64>()).sum();
    (sum / ball.len() as f64).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// White noise of a phantom's kind, filtered by sampled Gaussians, on a steep ramp.
    fn filtered(size: [usize; 3], sigma: [f64; 3], seed: u64) -> Vec<f32> {
        let uniform = |i: u64| (mixed(i ^ (seed << 40)) >> 11) as f64 / (1_u64 << 53) as f64;
        let mut values: Vec<f64> = (0..size.iter().product::<usize>() as u64)
            .map(|i| (0..12).map(|k| uniform(12 * i + k)).sum::<f64>() - 6.0)
            .collect();
        let strides = [1, size[0], size[0] * size[1]];
        for a in 0..3 {
            if sigma[a] > 0.0 {
                let reach = (4.0 * sigma[a]).ceil() as isize;
                let weight = |d: isize| (-0.5 * (d as f64 / sigma[a]).powi(2)).exp();
                let norm = (-reach..=reach).map(|d| weight(d).powi(2)).sum::<f64>().sqrt();
                let at = |i: usize, d: isize| {
                    let c = (i / strides[a] % size[a]) as isize;
                    // Around the edge: the noise stays stationary.
                    let to = (c + d).rem_euclid(size[a] as isize) - c;
                    i.wrapping_add_signed(to * strides[a] as isize)
                };
                let old = values.clone();
                for (i, v) in values.iter_mut().enumerate() {
                    *v = (-reach..=reach).map(|d| weight(d) * old[at(i, d)]).sum::<f64>() / norm;
                }
            }
        }
        values
            .iter()
            .enumerate()
            .map(|(i, v)| (5000.0 + 40.0 * v + 3.0 * (i % size[0]) as f64) as f32)
            .collect()
    }

    #[test]
    fn sigma_and_correlation_are_found_on_a_ramp() {
        let size = [72, 64, 60];
        let table = MaterialTable::new([("air", 0.0), ("al", 5000.0)]).unwrap();
        for sigma in [[0.0; 3], [0.6, 0.8, 1.0], [0.8; 3]] {
            let samples = filtered(size, sigma, 3);
            let slab = Slab::whole(&samples, size);
            let mut lines = Lines::new(size, &table);
            lines.add(slab, 0..size[2]);
            let found = lines.finish(false);
            assert!(found[0].is_none());
            let found = found[1].clone().unwrap();
            println!("{sigma:?}: {found:?}");
            assert!((found.sigma / 40.0 - 1.0).abs() < 0.04, "{found:?}");
            for (a, &sigma) in sigma.iter().enumerate() {
                assert!((found.correlation[a] - sigma).abs() < if sigma > 0.0 { 0.06 } else { 0.35 });
                assert!((found.autocorrelation[a][0] - autocorrelation(sigma, 1)).abs() < 0.04);
            }
            let mut slabs = Lines::new(size, &table);
            (0..size[2]).for_each(|z| slabs.add(slab, z..z + 1));
            assert_eq!(slabs.finish(false)[1].as_ref(), Some(&found));
        }
    }

    #[test]
    fn white_noise_is_not_inflated_and_correlated_noise_is() {
        assert!((effective([0.0; 3]) - 1.0).abs() < 1e-12);
        // Without an edge the sum would be (2 sqrt(pi) 0.8)³ = 22.8.
        let found = effective([0.8; 3]);
        assert!(found > 10.0 && found < 22.8, "{found}");
    }
}
