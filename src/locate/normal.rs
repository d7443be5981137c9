//! The normal distribution and the share of a round Gaussian in a wedge, in single precision and without branches: for
//! loops over many voxels that compilers turn into SIMD instructions.
//!
//! Everything is in units of the blur's sigma. Largest errors (tests): 5e-7 for the exponential and the distribution
//! function (Abramowitz and Stegun 26.2.17), 1e-6 for the wedge. The wedge is Owen's T function, by Gauss-Legendre
//! quadrature with four nodes over slopes of at most one; beyond one by its reflection.

use std::f32::consts::{LN_2, LOG2_E, TAU};

/// One over the square root of a whole turn.
const SCALE: f32 = 0.398_942_3;

/// The exponential of a number that is not positive; of anything below -80 as of -80.
#[inline(always)]
pub(super) fn exp(x: f32) -> f32 {
    // Adding this rounds to whole numbers and leaves them in the low bits.
    const ROUND: f32 = 12_582_912.0;
    let t = x.max(-80.0) * LOG2_E;
    let rounded = t + ROUND;
    let f = t - (rounded - ROUND);
    let p = 1.0
        + f * (LN_2
            + f * (0.240_226_5
                + f * (0.055_504_1 + f * (0.009_618_13 + f * (0.001_333_36 + f * 0.000_154_04)))));
    f32::from_bits((rounded.to_bits() << 23).wrapping_add(p.to_bits()))
}

/// `exp(-x² / 2)`, the density but for its scale.
#[inline(always)]
pub(super) fn bell(x: f32) -> f32 {
    exp(-0.5 * x * x)
}

/// The density, from [`bell`].
#[inline(always)]
pub(super) fn density(bell: f32) -> f32 {
    SCALE * bell
}

/// The distribution function at `x`, from [`bell`] there.
#[inline(always)]
pub(super) fn distribution(x: f32, bell: f32) -> f32 {
    let tail = tail(x, bell);
    if x > 0.0 { 1.0 - tail } else { tail }
}

/// The distribution function at `-|x|`.
#[inline(always)]
fn tail(x: f32, bell: f32) -> f32 {
    let t = 1.0 / (1.0 + 0.231_641_9 * x.abs());
    SCALE
        * bell
        * t
        * (0.319_381_53 + t * (-0.356_563_78 + t * (1.781_477_9 + t * (-1.821_255_9 + t * 1.330_274_4))))
}

/// Nodes and weights of the quadrature on 0 to 1, nodes squared.
const NODES: [[f32; 2]; 4] = [
    [0.004_820_781, 0.173_927_42],
    [0.108_906_255, 0.326_072_57],
    [0.448_887_3, 0.326_072_57],
    [0.865_957_1, 0.173_927_42],
];

/// What a voxel sees of a ray at whose left it lies at distance d and along which at c: the share of the Gaussian
/// counter-clockwise from the direction away from the ray's origin to the ray, and the distribution function and
/// the density (but for its scale) at c and d.
#[derive(Clone, Copy)]
pub(super) struct Wedge {
    /// Share, 0 to 1.
    pub share: f32,
    /// Distribution function at c.
    pub along: f32,
    /// [`bell`] at c and d.
    pub bells: [f32; 2],
}

/// See [`Wedge`].
#[inline(always)]
pub(super) fn wedge(c: f32, d: f32) -> Wedge {
    let bells = [bell(c), bell(d)];
    let [tail_c, tail_d] = [tail(c, bells[0]), tail(d, bells[1])];
    let along = if c > 0.0 { 1.0 - tail_c } else { tail_c };
    let (c2, d2) = (c * c, d * d);
    let steep = c2 > d2;
    let (near, far) = if steep { (d2, c2) } else { (c2, d2) };
    let s2 = near / far.max(1e-12);
    let mut sum = 0.0;
    for [x2, weight] in NODES {
        sum += weight * exp(-0.5 * near * x2) / (1.0 + s2 * x2);
    }
    let low = if steep { bells[0] } else { bells[1] };
    let flat = s2.sqrt() * low * (1.0 / TAU) * sum;
    // (Phi(|c|) + Phi(|d|)) / 2 - Phi(|c|) Phi(|d|), without cancelling.
    let reflected = 0.5 * (tail_c + tail_d) - tail_c * tail_d - flat;
    let owen = if steep { reflected } else { flat };
    let signed = if c > 0.0 { owen } else { -owen };
    let half = 0.5 * tail_d + signed;
    Wedge { share: if d >= 0.0 { half } else { 1.0 - half }, along, bells }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::locate::fixtures;

    #[test]
    fn they_agree_with_the_functions() {
        for i in 0..4000 {
            let x = i as f32 * 0.004 - 8.0;
            let (b, exact) = (bell(x), f64::from(x));
            assert!((f64::from(density(b)) - fixtures::density(exact)).abs() < 5e-7, "{x}");
            assert!((f64::from(distribution(x, b)) - fixtures::distribution(exact)).abs() < 5e-7, "{x}");
            let far = f64::from(-x.abs() * 9.0);
            assert!((f64::from(exp(far as f32)) / far.exp() - 1.0).abs() < 1e-5, "{far}");
        }
    }

    #[test]
    fn wedges_agree_with_their_integrals() {
        let turn = std::f64::consts::PI;
        let mut worst = 0.0f64;
        for i in 0..40 {
            let rho = f64::from(i) * 0.2 + 0.01;
            for k in 1..120 {
                let angle = f64::from(k) * turn / 60.0;
                // A voxel at rho, and a ray at this angle counter-clockwise from the direction away from it.
                let (c, d) = (-rho * angle.cos(), rho * angle.sin());
                let found = f64::from(wedge(c as f32, d as f32).share);
                // In parts, which the integral's steps resolve.
                let parts: [f64; 17] = std::array::from_fn(|i| angle * i as f64 / 16.0);
                let greys: [f64; 17] = std::array::from_fn(|i| if i < 16 { 1.0 } else { 0.0 });
                let exact = fixtures::sectors(&parts, &greys, glam::DVec2::new(-rho, 0.0));
                worst = worst.max((found - exact).abs());
            }
        }
        assert!(worst < 3e-6, "{worst}");
    }

    #[test]
    fn quadrants_are_products() {
        for i in 0..100 {
            let (x, y) = (0.063 * i as f32 - 3.1, 2.9 - 0.049 * i as f32);
            // Between the rays along x and along y, from a voxel at (x, y).
            let (first, second) = (wedge(x, y), wedge(y, -x));
            let around = (y < 0.0) & (-x >= 0.0);
            let share = second.share - first.share + if around { 1.0 } else { 0.0 };
            let product = fixtures::distribution(f64::from(x)) * fixtures::distribution(f64::from(y));
            assert!((f64::from(share) - product).abs() < 1.5e-6, "{x} {y}: {share} {product}");
        }
    }
}
