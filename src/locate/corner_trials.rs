//! Fits of synthetic corners: errors, calibration, and time.

#![allow(clippy::print_stdout)] // figures, with --nocapture

use glam::{DMat3, DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::corner::{Corner, MATERIALS};
use super::corner_fit::{Anchor, CornerPrior};
use super::corner_sites::UNSURE;
use super::corner_starts::find;
use super::fixtures::reading;
use super::sheet::{LevelPrior, Sample};
use super::wedge::is_explained;

/// A normally distributed number, by Box and Muller.
pub(crate) fn gaussian(rng: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..std::f64::consts::TAU));
    (-2.0 * a.ln()).sqrt() * b.cos()
}

pub(crate) fn direction(rng: &mut ChaCha8Rng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| gaussian(rng))).normalize()
}

/// Turned about a random axis at right angles by up to `degrees`.
pub(crate) fn tilted(n: DVec3, degrees: f64, rng: &mut ChaCha8Rng) -> DVec3 {
    let angle: f64 = rng.random_range(0.0..degrees.max(1e-9));
    let across = n.cross(direction(rng)).normalize();
    n * angle.to_radians().cos() + across * angle.to_radians().sin()
}

/// The window and labels of a scene: voxels within `radius` of the origin, labels by the nearest level.
pub(crate) fn window(
    scene: impl Fn(DVec3) -> f64,
    levels: &[(u8, f64)],
    noise: f64,
    radius: f64,
    rng: &mut ChaCha8Rng,
) -> (Vec<Sample>, Vec<u8>) {
    let spacing = 0.85;
    let turn = DQuat::from_axis_angle(direction(rng), rng.random_range(0.0..std::f64::consts::PI));
    let shift = DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..1.0)));
    let n = (radius / spacing) as i32 + 2;
    let mut samples = Vec::new();
    for z in -n..=n {
        for y in -n..=n {
            for x in -n..=n {
                let at = turn * ((DVec3::new(f64::from(x), f64::from(y), f64::from(z)) + shift) * spacing);
                if at.length() <= radius {
                    samples.push(Sample { at, grey: scene(at) + noise * gaussian(rng) });
                }
            }
        }
    }
    let label = |s: &Sample| {
        let near = |l: &(u8, f64)| (l.1 - s.grey).abs();
        levels.iter().fold(levels[0], |m, l| if near(l) < near(&m) { *l } else { m }).0
    };
    let labels = samples.iter().map(label).collect();
    (samples, labels)
}

/// Tallies of a series of trials.
#[derive(Default)]
struct Tally {
    errors: Vec<f64>,
    /// Sum of squared errors over their standard deviations, of the apex and of planes at 2.5 units.
    pull: f64,
    plane: (f64, f64, usize),
    tilt: f64,
    octants: usize,
    lost: usize,
    none: usize,
    seconds: f64,
    trials: usize,
    margin: f64,
    sound: usize,
    deceived: usize,
}

pub(crate) const LEVELS: [f64; MATERIALS] = [4000.0, 11600.0, 22000.0, 40000.0];

pub(crate) fn prior(noise: f64, materials: &[u8]) -> CornerPrior {
    let level = |m: usize| LevelPrior { mean: LEVELS[m], sigma: 400.0 };
    let levels = std::array::from_fn(|m| materials.contains(&(m as u8)).then(|| level(m)));
    CornerPrior { levels, noise, log_sigma: 0.07, bends: [(DMat3::ZERO, 0.0); 3] }
}

struct Case {
    name: &'static str,
    materials: [u8; 8],
    /// Normals before they are turned.
    normals: [DVec3; 3],
}

/// Normals with the given angles between 0 and 1, and of 2 with both.
fn slanted(degrees: f64) -> [DVec3; 3] {
    let a = degrees.to_radians();
    // Three at equal angles: about an axis, at the polar angle that gives them.
    let polar = (a.cos() * 2.0 / 3.0 + 1.0 / 3.0).sqrt().acos();
    std::array::from_fn(|i| {
        let turn = std::f64::consts::TAU * i as f64 / 3.0;
        DVec3::new(polar.sin() * turn.cos(), polar.sin() * turn.sin(), polar.cos())
    })
}

fn cases() -> Vec<Case> {
    let square = DVec3::AXES;
    let tilt = |d: f64| {
        let mut n = square;
        n[1] = DVec3::new(d.to_radians().cos(), d.to_radians().sin(), 0.0);
        n
    };
    vec![
        Case { name: "block convex", materials: [0, 0, 0, 0, 0, 0, 0, 1], normals: square },
        Case { name: "block concave", materials: [1, 1, 1, 1, 1, 1, 1, 0], normals: square },
        Case { name: "block slanted 60", materials: [0, 0, 0, 0, 0, 0, 0, 1], normals: slanted(60.0) },
        Case { name: "block slanted 110", materials: [0, 0, 0, 0, 0, 0, 0, 1], normals: slanted(110.0) },
        Case { name: "Fe in Al, air", materials: [0, 0, 0, 0, 1, 1, 1, 3], normals: square },
        Case { name: "Fe in Al, air, 60", materials: [0, 0, 0, 0, 1, 1, 1, 3], normals: tilt(60.0) },
        Case { name: "Al edge on Fe", materials: [3, 3, 3, 3, 0, 0, 0, 1], normals: square },
        Case { name: "Fe edge on Al", materials: [1, 1, 1, 1, 0, 0, 0, 3], normals: square },
        Case { name: "Fe edge on Al, 60", materials: [1, 1, 1, 1, 0, 0, 0, 3], normals: tilt(60.0) },
        Case { name: "Fe edge on Al, 120", materials: [1, 1, 1, 1, 0, 0, 0, 3], normals: tilt(120.0) },
        Case { name: "four materials", materials: [0, 0, 1, 1, 2, 3, 2, 3], normals: square },
        Case { name: "four on a plate", materials: [3, 3, 3, 3, 0, 1, 2, 0], normals: square },
    ]
}

/// How wrong a start is, and what the fit is told.
#[derive(Clone, Copy)]
struct How {
    off: f64,
    degrees: f64,
    radius: f64,
    /// Stated over true noise.
    stated: f64,
    /// Whether places 4.5 and 6 units away are known to the plane's noise there.
    anchors: bool,
    /// Share of labels that are random.
    wrong: f64,
}

const USUAL: How = How { off: 1.0, degrees: 10.0, radius: 4.3, stated: 1.0, anchors: false, wrong: 0.0 };

/// Tries a case `trials` times from starts that are `off` units and up to `degrees` wrong.
fn run(case: &Case, percent: f64, how: &How, trials: usize) -> Tally {
    let &How { off, degrees, radius, stated, anchors: anchored, wrong } = how;
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let present: Vec<(u8, f64)> =
        (0..4u8).filter(|m| case.materials.contains(m)).map(|m| (m, LEVELS[usize::from(m)])).collect();
    let contrast = present.windows(2).map(|w| w[1].1 - w[0].1).fold(f64::INFINITY, f64::min);
    let noise = contrast * percent / 100.0;
    let mut tally = Tally { trials, ..Tally::default() };
    for _ in 0..trials {
        let turn = DQuat::from_axis_angle(direction(&mut rng), rng.random_range(0.0..3.1));
        let truth = Corner {
            // The window is centred at the start's apex.
            apex: direction(&mut rng) * off * rng.random_range(0.0f64..1.0).cbrt(),
            normals: case.normals.map(|n| turn * n),
            materials: case.materials,
            levels: LEVELS.map(|l| l + 150.0 * gaussian(&mut rng)),
            log_sigma: 0.03 * gaussian(&mut rng),
            forms: [DMat3::ZERO; 3],
        };
        let (samples, mut labels) = window(|q| truth.blurred(q), &present, noise, radius, &mut rng);
        for label in &mut labels {
            if rng.random_range(0.0..1.0) < wrong {
                *label = present[rng.random_range(0..present.len())].0;
            }
        }
        let mut anchors = Vec::new();
        for plane in 0..3 {
            for k in 0..8 {
                let n = truth.normals[plane];
                let [u, v, _] = super::frame::basis(n);
                let (s, c) = (f64::from(k) * std::f64::consts::FRAC_PI_4).sin_cos();
                let at = truth.apex + (u * c + v * s) * if k % 2 == 0 { 4.5 } else { 6.0 };
                let sides = truth.sides(plane, at).map(|m| LEVELS[usize::from(m)]);
                let sigma = 0.7 * noise / (sides[1] - sides[0]).abs().max(1e-9);
                // Near another plane it would not be known.
                let clear = (0..3).all(|i| i == plane || truth.distance(i, at).abs() > 2.5);
                if anchored && clear && sigma < 1.0 {
                    anchors.push(Anchor { plane, at: at + n * (sigma * gaussian(&mut rng)), sigma });
                }
            }
        }
        let planes = truth.normals.map(|n| (DVec3::ZERO, tilted(n, degrees, &mut rng)));
        let begin = std::time::Instant::now();
        let found = find(&planes, &samples, &labels, &anchors, &prior(noise * stated, &case.materials), 20.0);
        tally.seconds += begin.elapsed().as_secs_f64();
        let Some(found) = found else {
            tally.none += 1;
            continue;
        };
        let fit = &found.fit;
        let error = fit.corner.apex - truth.apex;
        tally.octants += usize::from(fit.corner.materials != truth.materials);
        if fit.reduced() > 1.4 / (stated * stated) || !fit.fit.converged || error.length() > 1.0 {
            tally.lost += 1;
            tally.deceived += usize::from(found.is_sound(radius));
            continue;
        }
        tally.margin += found.margin;
        tally.sound += usize::from(found.is_sound(radius));
        tally.errors.push(error.length());
        if let Some(inverse) = fit.apex_covariance().try_inverse() {
            let e = nalgebra::Vector3::from(error.to_array());
            tally.pull += (e.transpose() * inverse * e)[(0, 0)] / 3.0;
        }
        for i in 0..3 {
            // A place of the true plane in 2.5 units from the apex.
            let across = truth.normals[i].cross(direction(&mut rng)).normalize();
            let at = truth.apex + across * 2.5;
            if truth.sides(i, at)[0] == truth.sides(i, at)[1] {
                continue;
            }
            let d = fit.corner.distance(i, at);
            tally.plane.0 += d * d;
            tally.plane.1 += (d / fit.plane_sigma(i, at)).powi(2);
            tally.plane.2 += 1;
            tally.tilt = tally.tilt.max(fit.corner.normals[i].angle_between(truth.normals[i]).to_degrees());
        }
    }
    tally
}

fn show(name: &str, percent: f64, t: &Tally) -> f64 {
    let n = t.errors.len().max(1) as f64;
    let rms = (t.errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
    let max = t.errors.iter().fold(0.0f64, |a, &b| a.max(b));
    let plane = t.plane.2.max(1) as f64;
    println!(
        "{name:20} {percent:3} %: apex {rms:.4} max {max:.4}, err/sigma {:.2}; planes {:.4}, err/sigma {:.2}, tilt {:.2}; \
         lost {}, none {}, octants {}, margin {:.0}; sound {}, lost but sound {}, {:.0} us",
        (t.pull / n).sqrt(),
        (t.plane.0 / plane).sqrt(),
        (t.plane.1 / plane).sqrt(),
        t.tilt,
        t.lost,
        t.none,
        t.octants,
        t.margin / n,
        t.sound,
        t.deceived,
        t.seconds * 1e6 / t.trials as f64,
    );
    (t.pull / n).sqrt()
}

#[test]
fn corners_are_found() {
    for case in cases().iter().step_by(3) {
        let t = run(case, 1.0, &How { off: 0.7, degrees: 7.0, ..USUAL }, 10);
        let pull = show(case.name, 1.0, &t);
        assert!(t.lost + t.none + t.octants <= 1, "{}", case.name);
        assert!(t.errors.iter().all(|&e| e < 0.2), "{}", case.name);
        assert!((0.5..1.7).contains(&pull), "{}", case.name);
    }
}

/// The mean of a scene of levels over a Gaussian about `at`, summed over a grid.
fn slow(scene: &impl Fn(DVec3) -> f64, at: DVec3) -> f64 {
    let (n, step) = (14, 0.25);
    let line: Vec<(f64, f64)> = (-n..n)
        .map(|i| {
            let x = (f64::from(i) + 0.5) * step;
            (x, libm::exp(-0.5 * x * x))
        })
        .collect();
    let total: f64 = line.iter().map(|l| l.1).sum();
    let mut sum = 0.0;
    for &(x, p) in &line {
        for &(y, q) in &line {
            sum += p * q * line.iter().map(|&(z, r)| r * scene(at + DVec3::new(x, y, z))).sum::<f64>();
        }
    }
    sum / total.powi(3)
}

#[test]
fn bent_planes_do_not_move_the_apex() {
    let materials = [0, 0, 0, 0, 1, 1, 1, 3];
    for radius in [30.0, 15.0] {
        let mut rng = ChaCha8Rng::seed_from_u64(17);
        let (mut planar, mut bent) = (0.0f64, 0.0f64);
        for _ in 0..3 {
            let turn = DQuat::from_axis_angle(direction(&mut rng), rng.random_range(0.0..3.1));
            let n = DVec3::AXES.map(|n| turn * n);
            // The first plane is a sphere's: its middle lies behind.
            let scene = |q: DVec3| {
                let d = [(q + n[0] * radius).length() - radius, n[1].dot(q), n[2].dot(q)];
                let o: usize = (0..3).map(|i| usize::from(d[i] > 0.0) << i).sum();
                LEVELS[usize::from(materials[o])]
            };
            let present: Vec<(u8, f64)> =
                (0..4u8).filter(|m| materials.contains(m)).map(|m| (m, LEVELS[usize::from(m)])).collect();
            let noise = 76.0;
            let (samples, labels) = window(|q| slow(&scene, q), &present, noise, 4.3, &mut rng);
            let planes = n.map(|n| (DVec3::ZERO, tilted(n, 7.0, &mut rng)));
            let mut prior = prior(noise, &materials);
            let off = |prior: &CornerPrior| {
                find(&planes, &samples, &labels, &[], prior, 20.0)
                    .map_or(f64::INFINITY, |f| f.fit.corner.apex.length())
            };
            planar = planar.max(off(&prior));
            let sphere = DMat3::IDENTITY - DMat3::from_cols(n[0] * n[0].x, n[0] * n[0].y, n[0] * n[0].z);
            prior.bends[0] = (sphere * (-1.0 / radius), 0.02);
            bent = bent.max(off(&prior));
        }
        println!("radius {radius}: apex off by {planar:.3} with planes, {bent:.3} with a bent one");
        assert!(bent < 0.12 && bent < planar, "radius {radius}: {bent}, {planar}");
    }
}

#[test]
fn what_is_no_corner() {
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    for (name, materials) in [
        ("flat", [0, 1, 0, 1, 0, 1, 0, 1]),
        ("edge", [0, 0, 0, 1, 0, 0, 0, 1]),
        ("junction", [0, 1, 3, 3, 0, 1, 3, 3]),
    ] {
        for _ in 0..6 {
            let turn = DQuat::from_axis_angle(direction(&mut rng), rng.random_range(0.0..3.1));
            let truth = Corner {
                apex: direction(&mut rng) * 0.7,
                normals: DVec3::AXES.map(|n| turn * n),
                materials,
                levels: LEVELS,
                log_sigma: 0.0,
                forms: [DMat3::ZERO; 3],
            };
            let present: Vec<(u8, f64)> =
                (0..4u8).filter(|m| materials.contains(m)).map(|m| (m, LEVELS[usize::from(m)])).collect();
            let noise = 152.0;
            let (samples, labels) = window(|q| truth.blurred(q), &present, noise, 4.3, &mut rng);
            let planes = truth.normals.map(|n| (DVec3::ZERO, tilted(n, 10.0, &mut rng)));
            let found = find(&planes, &samples, &labels, &[], &prior(noise, &materials), 20.0);
            // As where corners are looked for.
            let taken = found.as_ref().is_some_and(|f| {
                f.is_sound(4.3)
                    && is_explained(f.fit.reduced(), f.fit.samples, &reading(noise), LEVELS[3] - LEVELS[0])
                    && f.fit.apex_sigmas()[2] < UNSURE
            });
            let text =
                found.map(|f| (f.fit.corner.materials, f.fit.reduced(), f.fit.apex_sigmas(), f.margin));
            println!("{name}: {text:.2?}");
            assert!(!taken, "{name}");
        }
    }
}
