//! Normals from gradients of the grey value: as published, and smoothed.

use glam::Vec3;

use super::in_lengths;
use crate::volume::{Sample, Slab};

/// Sigma of the smoothing, in voxels along each axis.
const SIGMA: f32 = 1.0;
/// Samples on each side that are smoothed over: beyond two sigma there is 5 % of the weight.
const REACH: usize = 2;

/// Normal towards rising grey values at fraction `t` of the edge from voxel `from` along `axis`: gradients by
/// central differences at both ends (eq. 7), normalised and interpolated (eq. 8). Lattice units become
/// lengths before normalising. At the border of the volume the difference to the one neighbour.
#[inline]
pub(super) fn published<S: Sample>(
    slab: Slab<'_, S>,
    from: [usize; 3],
    axis: usize,
    t: f32,
    inverse: [f32; 3],
) -> Option<Vec3> {
    let mut to = from;
    to[axis] += 1;
    let [below, above] = [from, to].map(|p| in_lengths(central(slab, p), inverse));
    // An end without a gradient has no say.
    let (below, above) = (below.or(above)?, above.or(below)?);
    below.lerp(above, t).try_normalize()
}

/// Gradient by central differences, grey per voxel (eq. 7).
#[inline]
fn central<S: Sample>(slab: Slab<'_, S>, p: [usize; 3]) -> [f32; 3] {
    let size = slab.size();
    std::array::from_fn(|a| {
        let (mut low, mut high) = (p, p);
        low[a] = p[a].saturating_sub(1);
        high[a] = (p[a] + 1).min(size[a] - 1);
        let steps = high[a] - low[a];
        (slab.grey(high) - slab.grey(low)) * if steps == 2 { 0.5 } else { 1.0 }
    })
}

/// Weights along one axis: Gaussian mean, and slope of the line fitted with Gaussian weights. So a linear
/// field has its exact gradient, also at the border of the volume, where fewer samples are left.
struct Taps {
    start: usize,
    count: usize,
    mean: [f32; 2 * REACH + 2],
    slope: [f32; 2 * REACH + 2],
}

impl Taps {
    /// Around coordinate `at + t` of an axis of `size` samples, t in 0..1; t = 0 needs one sample less.
    #[inline]
    fn new(at: usize, t: f32, size: usize) -> Self {
        let start = at.saturating_sub(REACH);
        let end = (at + REACH + 1 + usize::from(t > 0.0)).min(size);
        let (mut mean, mut slope) = ([0.0; 2 * REACH + 2], [0.0; 2 * REACH + 2]);
        let count = end - start;
        let (mut sum, mut first, mut second) = (0.0f32, 0.0f32, 0.0f32);
        for k in 0..count {
            let d = (start + k) as f32 - at as f32 - t;
            let weight = (d * d * (-0.5 / (SIGMA * SIGMA))).exp();
            (mean[k], slope[k]) = (weight, d);
            sum += weight;
            first += weight * d;
            second += weight * d * d;
        }
        let middle = first / sum;
        // A single sample has no slope.
        let spread = if count > 1 { 1.0 / (second - first * middle) } else { 0.0 };
        for k in 0..count {
            slope[k] = mean[k] * (slope[k] - middle) * spread;
            mean[k] /= sum;
        }
        Self { start, count, mean, slope }
    }
}

/// Normal towards rising grey values at fraction `t` of the edge from voxel `from` along `axis`, of the
/// volume smoothed by a Gaussian of [`SIGMA`]; only the samples around the crossing are looked at.
pub(super) fn smoothed<S: Sample>(
    slab: Slab<'_, S>,
    from: [usize; 3],
    axis: usize,
    t: f32,
    inverse: [f32; 3],
) -> Option<Vec3> {
    let size = slab.size();
    let [x, y, z]: [Taps; 3] =
        std::array::from_fn(|a| Taps::new(from[a], if a == axis { t } else { 0.0 }, size[a]));
    let mut gradient = [0.0f32; 3];
    for k in 0..z.count {
        let mut plane = [0.0f32; 3];
        for j in 0..y.count {
            let row = &slab.row(y.start + j, z.start + k)[x.start..x.start + x.count];
            let (mut mean, mut slope) = (0.0f32, 0.0f32);
            for ((sample, m), s) in row.iter().zip(&x.mean).zip(&x.slope) {
                let grey = sample.to_f32();
                mean += m * grey;
                slope += s * grey;
            }
            plane[0] += y.mean[j] * slope;
            plane[1] += y.slope[j] * mean;
            plane[2] += y.mean[j] * mean;
        }
        gradient[0] += z.mean[k] * plane[0];
        gradient[1] += z.mean[k] * plane[1];
        gradient[2] += z.slope[k] * plane[2];
    }
    in_lengths(gradient, inverse)
}
