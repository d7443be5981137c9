//! Blur, noise and local grey levels against phantoms for which they are known.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests are tests; they say what they see

use interfacet::classify::classify;
use interfacet::execution::Execution;
use interfacet::grid::MaterialId;
use interfacet::material::{Levels, ScanQuality};
use interfacet::phantom::{Noise, Phantom, PhantomOptions, SceneName};
use interfacet::volume::{Samples, Slab};

/// The quality of a phantom, and its true widths per axis, mm.
fn of(options: &PhantomOptions) -> (ScanQuality, [f64; 3]) {
    let phantom = Phantom::new(options).unwrap();
    let samples = phantom.rasterise(&Execution::default()).unwrap();
    let geometry = phantom.geometry();
    let Samples::U16(values) = samples else { panic!("{:?}", samples.sample_type()) };
    let quality = ScanQuality::of(Slab::whole(&values, geometry.size()), geometry, phantom.materials());
    let (blur, spacing) = (phantom.sigma_mm(), geometry.spacing());
    (quality, std::array::from_fn(|a| (blur[a].powi(2) + spacing[a].powi(2) / 12.0).sqrt()))
}

/// Largest relative error of sigma per axis.
fn error(options: &PhantomOptions) -> f64 {
    let (quality, truth) = of(options);
    let found = quality.blur.sigma_axes_mm.unwrap();
    let errors: [f64; 3] = std::array::from_fn(|a| found[a] / truth[a] - 1.0);
    let profile = quality.profile.unwrap();
    let [x, y, z] = errors.map(|e| 100.0 * e);
    println!(
        "{:<17} {:?} cupping {} sigma {:?}: {x:+.2} {y:+.2} {z:+.2} %, {} patches, residual {:.4}, scatter {:.4}, isotropic {:?}",
        options.scene.name(),
        options.noise,
        options.cupping,
        options.sigma_axes,
        quality.blur.profiles,
        profile.residual,
        profile.scatter,
        quality.blur.isotropic,
    );
    errors.into_iter().fold(0.0, |most, e| e.abs().max(most))
}

#[test]
fn sigma_per_axis_is_found_with_noise_cupping_and_curvature() {
    let (mut worst1, mut worst4) = (0.0_f64, 0.0_f64);
    for scene in [SceneName::Cube, SceneName::PressFitRing, SceneName::Sphere, SceneName::SphereOnCylinder] {
        for sigma_axes in [[1.15; 3], [1.05, 1.15, 1.3]] {
            for cupping in [0.0, 0.1] {
                for noise in [1.0, 4.0] {
                    let options = PhantomOptions {
                        scene,
                        sigma_axes: Some(sigma_axes),
                        cupping,
                        noise: Noise::Percent(noise),
                        ..PhantomOptions::default()
                    };
                    let worst = if noise > 2.0 { &mut worst4 } else { &mut worst1 };
                    *worst = error(&options).max(*worst);
                }
            }
        }
    }
    assert!(worst1 < 0.01 && worst4 < 0.02, "{worst1} {worst4}");
}

#[test]
fn turned_and_small_objects_and_other_lattices() {
    let base = PhantomOptions { sigma_axes: Some([1.05, 1.15, 1.3]), ..PhantomOptions::default() };
    let turned = PhantomOptions { scene: SceneName::Cube, rotation: [25.0, 20.0, 30.0], ..base.clone() };
    assert!(error(&turned) < 0.02);
    let ball10 =
        PhantomOptions { scene: SceneName::Sphere, fill: 20.0 / 64.0, size: [64; 3], ..base.clone() };
    assert!(error(&ball10) < 0.02);
    let flat = PhantomOptions { spacing: [0.4, 0.4, 0.5], size: [96, 96, 80], ..base };
    assert!(error(&flat) < 0.01);
}

/// Errors of the levels of a cupped phantom, in percent of the contrast to the next material: RMS and largest,
/// over voxels of each material but air, at all places (surfaces too).
fn level_errors(options: &PhantomOptions) -> Vec<[f64; 2]> {
    let phantom = Phantom::new(options).unwrap();
    let table = phantom.materials();
    let samples = phantom.rasterise(&Execution::default()).unwrap();
    let Samples::U16(values) = samples else { panic!("{:?}", samples.sample_type()) };
    let size = options.size;
    let classified =
        classify(Slab::whole(&values, size), table, [2.5 * 1.19; 3], &Execution::default()).unwrap();
    let levels = Levels::new(&classified.levels, table);
    // The same object without blur and noise: the truth at every voxel.
    let exact = PhantomOptions { binary: true, noise: Noise::Grey(0.0), ..options.clone() };
    let Samples::U16(truth) = Phantom::new(&exact).unwrap().rasterise(&Execution::default()).unwrap() else {
        panic!("the same number type was asked for");
    };
    let plain = PhantomOptions { cupping: 0.0, ..exact };
    let Samples::U16(plain) = Phantom::new(&plain).unwrap().rasterise(&Execution::default()).unwrap() else {
        panic!("the same number type was asked for");
    };
    let means: Vec<f64> = table.materials().iter().map(|m| m.mean).collect();
    (0..table.count())
        .map(|m| {
            let others = means.iter().enumerate().filter(|(i, _)| *i != m);
            let contrast = others.map(|(_, v)| (v - means[m]).abs()).fold(f64::INFINITY, f64::min);
            let (mut n, mut squares, mut most) = (0.0_f64, 0.0_f64, 0.0_f64);
            for (i, v) in plain.iter().enumerate().filter(|(_, v)| (f64::from(**v) - means[m]).abs() < 1.0) {
                let _ = v;
                let at = [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])].map(|c| c as f32);
                let found = f64::from(levels.mean(MaterialId(m as u8), at));
                let error = 100.0 * (found - f64::from(truth[i])) / contrast;
                n += 1.0;
                squares += error * error;
                most = most.max(error.abs());
            }
            let drift = levels.drift(MaterialId(m as u8));
            let rms = (squares / n).sqrt();
            println!(
                "{:<17} {:?} cupping {} {}: level error rms {rms:.3} max {most:.3} % of contrast, drift {drift:.0?}, sigma there {:.3} %",
                options.scene.name(),
                options.noise,
                options.cupping,
                table.materials()[m].name,
                100.0 / contrast * f64::from(levels.sigma(MaterialId(m as u8), [48.0; 3])),
            );
            [rms, most]
        })
        .collect()
}

#[test]
fn levels_follow_cupping_to_the_surface_and_are_flat_without() {
    let mut worst = 0.0_f64;
    for scene in
        [SceneName::Cube, SceneName::PressFitRing, SceneName::SphereOnCylinder, SceneName::CubeInCube]
    {
        for noise in [1.0, 4.0] {
            for cupping in [0.0, 0.1] {
                let options = PhantomOptions {
                    scene,
                    cupping,
                    noise: Noise::Percent(noise),
                    ..PhantomOptions::default()
                };
                for [rms, most] in level_errors(&options) {
                    let limit = match (cupping > 0.0, noise > 2.0) {
                        (true, true) => [0.4, 1.5],
                        (true, false) => [0.3, 1.0],
                        (false, true) => [0.12, 0.12],
                        (false, false) => [0.12, 0.12],
                    };
                    worst = worst.max(rms / limit[0]).max(most / limit[1]);
                }
            }
        }
    }
    assert!(worst < 1.0, "{worst} of what is allowed");
}
