//! Tests of the four cones: the blur, derivatives, and fits.

#![allow(clippy::print_stdout)] // figures, with --nocapture

use super::super::corner_trials::{LEVELS, direction, gaussian, tilted, window};
use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn tetrahedron() -> [DVec3; 4] {
    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
        .map(|r| DVec3::from_array(r).normalize())
}

/// Three sectors on a plate: ray 3 up, the others in the plate.
fn plate() -> [DVec3; 4] {
    let at = |degrees: f64| DVec3::new(degrees.to_radians().cos(), degrees.to_radians().sin(), 0.0);
    [at(0.0), at(110.0), at(230.0), DVec3::Z]
}

fn turned(rays: [DVec3; 4], degrees: f64, rng: &mut ChaCha8Rng) -> [DVec3; 4] {
    let turn = glam::DQuat::from_axis_angle(direction(rng), rng.random_range(0.0..3.1));
    rays.map(|r| turn * tilted(r, degrees, rng))
}

fn slow(cone: &Cone, at: DVec3) -> f64 {
    let (n, step) = (40, 0.14);
    let line: Vec<(f64, f64)> = (-n..n)
        .map(|i| {
            let x = (f64::from(i) + 0.37) * step;
            (x * libm::exp(cone.log_sigma), libm::exp(-0.5 * x * x))
        })
        .collect();
    let total: f64 = line.iter().map(|l| l.1).sum();
    let mut sum = 0.0;
    for &(x, p) in &line {
        for &(y, q) in &line {
            sum += p
                * q
                * line
                    .iter()
                    .map(|&(z, r)| r * cone.levels[cone.material(at + DVec3::new(x, y, z))])
                    .sum::<f64>();
        }
    }
    sum / total.powi(3)
}

#[test]
fn blurred_values_are_means_over_a_gaussian() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut worst = 0.0f64;
    for rays in [tetrahedron(), plate()] {
        let rays = turned(rays, 12.0, &mut rng);
        let cone =
            Cone { apex: DVec3::splat(0.1), rays, levels: LEVELS.map(|l| l / 1000.0), log_sigma: 0.05 };
        for _ in 0..3 {
            let at = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.5..1.5)));
            worst = worst.max((cone.blurred(at).expect("possible") - slow(&cone, at)).abs());
        }
    }
    println!("largest difference of levels 4 to 40: {worst:.1e}");
    assert!(worst < 2e-2, "{worst}");
}

#[test]
fn derivatives_are_those_of_the_prediction() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for rays in [tetrahedron(), plate()] {
        let rays = turned(rays, 8.0, &mut rng);
        for _ in 0..40 {
            let at = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2.5..2.5)));
            let sample = [Sample { at, grey: 0.0 }];
            let model = Blurred { samples: &Batches::new(&sample), frames: rays.map(basis), noise: 1.0 };
            let mut x = SVector::<f64, CONE>::from_fn(|_, _| rng.random_range(-0.1..0.1));
            for m in 0..4 {
                x[LEVEL + m] = LEVELS[m] / 1000.0;
            }
            let value = |x: &SVector<f64, CONE>| model.cone(x).0.blurred(at).expect("possible");
            // The residual is the value: right sides are its products with the row.
            let mut equations = Normal::new(&[true; CONE]);
            model.normal_equations(&x, &mut equations);
            let row = equations.right / value(&x);
            for i in 0..CONE {
                let (mut up, mut down) = (x, x);
                up[i] += 4e-3;
                down[i] -= 4e-3;
                let numeric = (value(&up) - value(&down)) / 8e-3;
                assert!((row[i] - numeric).abs() < 5e-3, "{i}: {} {numeric}", row[i]);
            }
        }
    }
}

#[test]
fn normals_point_from_material_to_material() {
    let cone = Cone { apex: DVec3::ONE, rays: tetrahedron(), levels: LEVELS, log_sigma: 0.0 };
    for m in 0..4 {
        for n in (0..4).filter(|&n| n != m) {
            let [i, j] = Cone::sheet(m, n).map(|i| cone.rays[i]);
            let at = cone.apex + i + j;
            let step = cone.normal(m, n) * 0.05;
            assert_eq!((cone.material(at - step), cone.material(at + step)), (m, n));
            assert!((cone.distance(m, n, at + step) - 0.05).abs() < 1e-12);
        }
    }
}

/// Errors of fits: RMS and largest of the apex, pull of the apex and of sheets, lost ones, seconds.
fn run(rays: [DVec3; 4], noise: f64, labels_only: bool, trials: usize) -> ([f64; 5], usize) {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (mut sums, mut lost, mut good) = ([0.0f64; 5], 0, 0.0f64);
    let levels = LEVELS.map(|mean| LevelPrior { mean, sigma: 400.0 });
    let prior = ConePrior { levels, noise, log_sigma: 0.07 };
    let mut sheets = 0.0f64;
    for _ in 0..trials {
        let truth = Cone {
            apex: direction(&mut rng) * rng.random_range(0.0f64..1.0).cbrt(),
            rays: turned(rays, 12.0, &mut rng),
            levels: LEVELS.map(|l| l + 150.0 * gaussian(&mut rng)),
            log_sigma: 0.03 * gaussian(&mut rng),
        };
        let named: Vec<(u8, f64)> = (0..4u8).map(|m| (m, LEVELS[usize::from(m)])).collect();
        let scene = |q: DVec3| truth.blurred(q).expect("possible");
        let (samples, labels) = window(scene, &named, noise, 4.3, &mut rng);
        let start = if labels_only {
            Cone::of_labels(&samples, &labels, LEVELS)
        } else {
            let rays = truth.rays.map(|r| tilted(r, 10.0, &mut rng));
            Some(Cone { apex: DVec3::ZERO, rays, levels: LEVELS, log_sigma: 0.0 })
        };
        let begin = std::time::Instant::now();
        let fit = start.and_then(|s| s.fit(&samples, &prior, 40));
        sums[4] += begin.elapsed().as_secs_f64();
        let Some(fit) = fit.filter(|f| f.fit.converged && f.reduced() < 1.4) else {
            lost += 1;
            continue;
        };
        let e = fit.cone.apex - truth.apex;
        sums[0] += e.length_squared();
        sums[1] = sums[1].max(e.length());
        let v = nalgebra::Vector3::from(e.to_array());
        let inverse = fit.apex_covariance().try_inverse().expect("a covariance");
        sums[2] += (v.transpose() * inverse * v)[(0, 0)] / 3.0;
        for m in 0..4 {
            for n in 0..m {
                let [i, j] = Cone::sheet(m, n).map(|i| truth.rays[i]);
                let at = truth.apex + (i + j).normalize() * 2.5;
                sums[3] += (fit.cone.distance(m, n, at) / fit.sheet_sigma(m, n, at)).powi(2);
                sheets += 1.0;
            }
        }
        good += 1.0;
    }
    let [a, max, p, s, t] = sums;
    let of = |x: f64| (x / good.max(1.0)).sqrt();
    ([of(a), max, of(p), (s / sheets.max(1.0)).sqrt(), t / trials as f64], lost)
}

#[test]
fn cones_are_found() {
    for rays in [tetrahedron(), plate()] {
        let ([_, max, pull, sheets, _], lost) = run(rays, 76.0, false, 10);
        assert!(lost == 0 && max < 0.15, "lost {lost}, max {max}");
        assert!((0.5..1.6).contains(&pull) && (0.5..1.6).contains(&sheets), "{pull} {sheets}");
    }
}

#[test]
fn four_cones_are_no_corner_of_three_planes() {
    let mut rng = ChaCha8Rng::seed_from_u64(31);
    for noise in [76.0, 304.0] {
        for _ in 0..5 {
            let rays = turned(tetrahedron(), 12.0, &mut rng);
            let truth = Cone { apex: DVec3::ZERO, rays, levels: LEVELS, log_sigma: 0.0 };
            let named: Vec<(u8, f64)> = (0..4u8).map(|m| (m, LEVELS[usize::from(m)])).collect();
            let scene = |q: DVec3| truth.blurred(q).expect("possible");
            let (samples, labels) = window(scene, &named, noise, 4.3, &mut rng);
            // Those between material 0 and the others, which are the largest of its cone.
            let planes = [1, 2, 3].map(|m| (DVec3::ZERO, truth.normal(0, m)));
            let prior = super::super::corner_trials::prior(noise, &[0, 1, 2, 3]);
            let found = super::super::corner_starts::find(&planes, &samples, &labels, &[], &prior, 20.0);
            let text = found.as_ref().map(|f| (f.fit.reduced(), f.margin, f.is_sound(4.3)));
            println!("noise {noise}: {text:.2?}");
            assert!(found.is_none_or(|f| f.fit.reduced() > 2.0));
        }
    }
}
