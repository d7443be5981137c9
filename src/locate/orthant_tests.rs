//! Tests of the orthant probabilities against direct integration and closed forms.

#![allow(clippy::print_stdout)] // figures, with --nocapture

use std::f64::consts::FRAC_1_SQRT_2;

use super::*;
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn phi(x: f64) -> f64 {
    libm::exp(-0.5 * x * x) / TAU.sqrt()
}

fn cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x * FRAC_1_SQRT_2)
}

/// Composite Gauss-Legendre of order 12 over `parts` equal parts.
fn integrate(a: f64, b: f64, parts: usize, f: impl Fn(f64) -> f64) -> f64 {
    let rule = legendre(12);
    let w = (b - a) / parts as f64;
    (0..parts).map(|i| rule.iter().map(|&(t, g)| g * w * f(a + w * (i as f64 + t))).sum::<f64>()).sum()
}

/// Two planes by integration over the first distance.
fn slow_two(h: f64, k: f64, rho: f64) -> f64 {
    let root = ((1.0 - rho) * (1.0 + rho)).sqrt();
    let parts = (20.0 / root.max(0.02)) as usize + 20;
    integrate(-9.0, h.clamp(-9.0, 9.0), parts, |x| phi(x) * cdf((k - rho * x) / root))
}

/// Three planes by integration over the first two distances.
fn slow_three(h: [f64; 3], rho: [f64; 3], parts: usize) -> f64 {
    let r01 = rho[2];
    let root = (1.0 - r01 * r01).sqrt();
    let given = conditional(rho, determinant(rho), 2);
    integrate(-8.0, h[0].clamp(-8.0, 8.0), parts, |x| {
        let end = ((h[1] - r01 * x) / root).clamp(-8.0, 8.0);
        phi(x)
            * integrate(-8.0, end, parts, |y| {
                phi(y) * cdf(given[0] * x + given[1] * (r01 * x + root * y) + given[2] * h[2])
            })
    })
}

/// Unit normals with all angles between 30 and 150 degrees and a determinant of at least `least`.
pub(crate) fn normals(rng: &mut ChaCha8Rng, least: f64) -> [DVec3; 3] {
    loop {
        let n: [DVec3; 3] = std::array::from_fn(|_| {
            loop {
                let v = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
                if v.length() < 1.0 && v.length() > 0.1 {
                    break v.normalize();
                }
            }
        });
        let rho = correlations(n);
        if rho.iter().all(|r| r.abs() < 0.867) && n[0].dot(n[1].cross(n[2])).abs() > least {
            return n;
        }
    }
}

fn correlations(n: [DVec3; 3]) -> [f64; 3] {
    [n[1].dot(n[2]), n[2].dot(n[0]), n[0].dot(n[1])]
}

/// Distances of one voxel.
fn alone(h: [f64; 3]) -> Distances {
    Distances::new(h.map(|h| [h as f32; BATCH]))
}

/// Shares of one voxel.
fn shares(rho: [f64; 3], h: [f64; 3]) -> [f64; 8] {
    Planes::new(rho, [true; 8]).shares(&alone(h)).map(|row| f64::from(row[0]))
}

/// Two planes, the third at right angles to both and far away.
fn bivariate(h: f64, k: f64, rho: f64) -> f64 {
    shares([0.0, 0.0, rho], [h, k, 9.0])[3]
}

#[test]
fn two_planes_agree_with_integration_for_any_correlation() {
    let mut worst = 0.0f64;
    for rho in [
        -0.9999, -0.999, -0.97, -0.93, -0.92, -0.88, -0.87, -0.75, -0.74, -0.5, -0.19, -0.04, 0.0, 0.03, 0.1,
        0.3, 0.51, 0.6, 0.7499, 0.8, 0.879, 0.9, 0.924, 0.926, 0.95, 0.99, 0.9995,
    ] {
        let mut here = 0.0f64;
        for i in -9..=9 {
            for j in -9..=9 {
                let (h, k) = (f64::from(i) * 0.53, f64::from(j) * 0.51 + 0.07);
                here = here.max((bivariate(h, k, rho) - slow_two(h, k, rho)).abs());
            }
        }
        println!("rho {rho:8}: {here:.1e}");
        worst = worst.max(here);
    }
    assert!(worst < 5e-6, "{worst}");
}

#[test]
fn closed_forms() {
    for rho in [-0.99, -0.6, 0.2, 0.8, 0.95] {
        let exact = 0.25 + libm::asin(rho) / TAU;
        assert!((bivariate(0.0, 0.0, rho) - exact).abs() < 5e-6, "{rho}");
    }
    assert!((bivariate(0.3, 0.7, 1.0) - cdf(0.3)).abs() < 5e-6);
    assert!((bivariate(0.3, 0.7, -1.0) - (cdf(0.7) - cdf(-0.3))).abs() < 5e-6);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..500 {
        let rho = correlations(normals(&mut rng, 0.2));
        let exact = 0.125 + rho.iter().map(|&r| libm::asin(r)).sum::<f64>() / (4.0 * PI);
        let share = shares(rho, [0.0; 3])[7];
        assert!((share - exact).abs() < 1e-5, "{rho:?}: {share} {exact}");
    }
    let h = [0.4, -1.2, 2.0];
    let share = shares([0.0; 3], h)[7];
    assert!((share - h.iter().map(|&h| cdf(h)).product::<f64>()).abs() < 5e-6);
    // One plane at right angles to two that are not.
    let share = shares([0.6, 0.0, 0.0], h)[7];
    assert!((share - cdf(h[0]) * slow_two(h[1], h[2], 0.6)).abs() < 5e-6);
}

#[test]
fn three_planes_agree_with_integration() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for (least, below, tolerance) in [
        (0.7, 1.1, 1e-5),
        (0.5, 0.7, 1e-5),
        (0.3, 0.5, 1e-5),
        (0.2, 0.3, 1e-5),
        (0.1, 0.2, 5e-5),
        (0.05, 0.1, 5e-5),
    ] {
        let (mut worst, mut at) = (0.0f64, ([0.0; 3], [0.0; 3]));
        let mut done = 0;
        while done < 150 {
            let n = normals(&mut rng, least);
            if n[0].dot(n[1].cross(n[2])).abs() > below {
                continue;
            }
            done += 1;
            let rho = correlations(n);
            for _ in 0..3 {
                let q = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2.5..2.5)));
                let h = n.map(|n| n.dot(q));
                let error = (shares(rho, h)[7] - slow_three(h, rho, 10)).abs();
                if error > worst {
                    (worst, at) = (error, (h, rho));
                }
            }
        }
        println!("determinant {least} to {below}: {worst:.1e} at {at:?}");
        assert!(worst < tolerance, "{worst} at {at:?}");
    }
}

#[test]
fn slopes_are_those_of_the_shares() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut worst = 0.0f64;
    for _ in 0..400 {
        let n = normals(&mut rng, 0.2);
        let rho = correlations(n);
        let q = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2.5..2.5)));
        let h = n.map(|n| n.dot(q));
        let weight: [f64; 8] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let value = |h: [f64; 3], rho: [f64; 3]| -> f64 {
            let s = shares(rho, h);
            (0..8).map(|i| weight[i] * s[i]).sum()
        };
        let slopes = Planes::new(rho, [true; 8]).slopes(&alone(h), &weight.map(|w| w as f32));
        let [by_h, by_rho] = slopes.map(|by| by.map(|row| f64::from(row[0])));
        for i in 0..3 {
            let step = 1e-2;
            let (mut up, mut down) = (h, h);
            up[i] += step;
            down[i] -= step;
            worst = worst.max((by_h[i] - (value(up, rho) - value(down, rho)) / (2.0 * step)).abs());
            let (mut up, mut down) = (rho, rho);
            up[i] += step;
            down[i] -= step;
            if determinant(up).min(determinant(down)) > 0.03 {
                let difference = (by_rho[i] - (value(h, up) - value(h, down)) / (2.0 * step)).abs();
                assert!(
                    difference < 2e-3 * (1.0 + 0.01 / determinant(rho)),
                    "{i} {rho:?} {h:?} {difference}"
                );
            }
        }
    }
    println!("largest error of a slope {worst:.1e}");
    assert!(worst < 1e-4, "{worst}");
}
