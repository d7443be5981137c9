//! What tests of the fits share: windows of voxels with exactly blurred models, and noise.

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use glam::{DVec2, DVec3};

use super::sheet::{Reading, Sample};

/// The lattice in a ball of `radius` blur units, turned and shifted so that no voxel lies on an axis by accident;
/// grey values by `grey`.
pub(super) fn window(radius: f64, grey: impl Fn(DVec3) -> f64) -> Vec<Sample> {
    let (pitch, n) = (0.84, 6);
    let turn = glam::DMat3::from_euler(glam::EulerRot::XYZ, 0.31, -0.22, 0.47);
    let mut out = Vec::new();
    for z in -n..=n {
        for y in -n..=n {
            for x in -n..=n {
                let at =
                    turn * DVec3::new(f64::from(x) + 0.21, f64::from(y) - 0.13, f64::from(z) + 0.37) * pitch;
                if at.length() <= radius {
                    out.push(Sample { at, grey: grey(at) });
                }
            }
        }
    }
    out
}

/// The same samples with white noise of standard deviation `sigma`.
pub(super) fn noisy(samples: &[Sample], sigma: f64, seed: u64) -> Vec<Sample> {
    let uniform = |i: u64| {
        let h = (seed << 32 ^ i).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let h = (h ^ h >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let h = (h ^ h >> 32).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((h ^ h >> 31) >> 11) as f64 / (1u64 << 53) as f64
    };
    let normal = |i: u64| {
        let (a, b) = (1.0 - uniform(2 * i), uniform(2 * i + 1));
        (-2.0 * a.ln()).sqrt() * (TAU * b).cos()
    };
    samples.iter().zip(0..).map(|(s, i)| Sample { grey: s.grey + sigma * normal(i), ..*s }).collect()
}

/// Grey values that are never clipped.
pub(super) fn reading(noise: f64) -> Reading {
    Reading::unclipped(noise)
}

pub(super) fn density(x: f64) -> f64 {
    (-0.5 * x * x).exp() / TAU.sqrt()
}

pub(super) fn distribution(x: f64) -> f64 {
    0.5 * libm::erfc(-x * FRAC_1_SQRT_2)
}

/// Share of a ball of `radius` at distance `r` from its centre.
pub(super) fn ball(radius: f64, r: f64) -> f64 {
    let (near, far) = (radius - r, radius + r);
    distribution(near) + distribution(far) - 1.0 - (density(near) - density(far)) / r
}

/// Share of an endless cylinder of `radius` at distance `r` from its axis.
pub(super) fn cylinder(radius: f64, r: f64) -> f64 {
    // Across, at x = radius sin t, the cylinder is a slab; the sum is exact to rounding, its ends being flat.
    let steps = 400;
    let h = PI / f64::from(steps);
    let part = |i: i32| {
        let t = (f64::from(i) + 0.5) * h - 0.5 * PI;
        let (x, half) = (radius * t.sin(), radius * t.cos());
        density(x - r) * (2.0 * distribution(half) - 1.0) * half
    };
    (0..steps).map(part).sum::<f64>() * h
}

/// Grey value at `r` from the apex of planar sectors: sector i, of grey value `greys[i]`, begins at angle
/// `theta[i]` (ascending, within a turn).
pub(super) fn sectors(theta: &[f64], greys: &[f64], r: DVec2) -> f64 {
    // In every direction from the apex the share of the Gaussian is closed; a sum over each sector.
    let steps = 90;
    let part = |angle: f64| {
        let u = DVec2::from_angle(angle);
        let (c, d) = (u.dot(r), u.perp_dot(r));
        density(d) * (density(c) + c * distribution(c))
    };
    let share = |i: usize| {
        let end = if i + 1 < theta.len() { theta[i + 1] } else { theta[0] + TAU };
        let h = (end - theta[i]) / f64::from(steps);
        // Simpson.
        let inner = (1..steps).map(|k| {
            let weight = if k % 2 == 1 { 4.0 } else { 2.0 };
            weight * part(theta[i] + h * f64::from(k))
        });
        h / 3.0 * (part(theta[i]) + inner.sum::<f64>() + part(end))
    };
    greys.iter().enumerate().map(|(i, grey)| grey * share(i)).sum()
}

pub(super) fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}
