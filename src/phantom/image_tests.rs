//! The volumes against closed forms: area sampling, blur, noise, cupping.

use glam::DVec3;

use super::tests::{options, phantom};
use super::*;

#[test]
fn grey_values_sum_up_to_the_exact_volumes() {
    for scene in SceneName::ALL {
        let phantom = Phantom::new(&PhantomOptions {
            noise: Noise::Grey(0.0),
            sample_type: SampleType::F32,
            ..options(scene, 32)
        })
        .unwrap();
        let samples = phantom.rasterise(&Execution::default()).unwrap();
        let means = phantom.materials().materials();
        let sum: f64 = (0..samples.len()).map(|i| f64::from(samples.get(i)) - means[0].mean).sum();
        let exact: f64 =
            means[1..].iter().map(|m| phantom.truth().volume(m.id).unwrap() * (m.mean - means[0].mean)).sum();
        assert!(
            (sum * phantom.geometry().voxel_volume() / exact - 1.0).abs() < 3e-5,
            "{scene:?} {sum} {exact}"
        );
    }
}

/// Distribution function of the standard normal distribution.
fn normal(x: f64) -> f64 {
    0.5 * libm::erfc(-x / std::f64::consts::SQRT_2)
}

#[test]
fn a_plate_has_the_profile_of_the_blur_and_the_voxels_box() {
    for (spacing, axes) in [([1.0; 3], None), ([0.5, 0.8, 1.1], None), ([1.0; 3], Some([1.0, 1.2, 1.4]))] {
        let phantom = Phantom::new(&PhantomOptions {
            noise: Noise::Grey(0.0),
            sample_type: SampleType::F32,
            thickness: 7.0,
            spacing,
            sigma_axes: axes,
            ..options(SceneName::ThinPlate, 48)
        })
        .unwrap();
        let samples = phantom.rasterise(&Execution::default()).unwrap();
        let geometry = phantom.geometry();
        let truth = phantom.truth();
        // Surfaces 4 and 5 of the plate's box are its large faces.
        let top = truth.scene().surfaces()[5];
        let normal_direction = top.normal(DVec3::ZERO);
        let thickness = 7.0 * geometry.voxel_edge();
        let sigma = phantom.sigma_mm();
        let variance: f64 = (0..3)
            .map(|a| normal_direction[a].powi(2) * (sigma[a].powi(2) + spacing[a].powi(2) / 12.0))
            .sum();
        let s = variance.sqrt();
        let (centre, radius) = truth.ball();
        let mut worst: f64 = 0.0;
        let mut count = 0;
        for i in 0..samples.len() {
            let index = DVec3::new((i % 48) as f64, (i / 48 % 48) as f64, (i / 48 / 48) as f64);
            let p = geometry.world(index);
            let side = (p - centre) - (p - centre).dot(normal_direction) * normal_direction;
            if side.length() > 0.3 * radius {
                continue;
            }
            count += 1;
            let d = top.signed_distance(p);
            let share = normal((d + thickness) / s) - normal(d / s);
            let value = (f64::from(samples.get(i)) - 4000.0) / 36000.0;
            worst = worst.max((value - share).abs());
        }
        assert!(count > 1000);
        // The box of a voxel is no Gaussian: that alone makes about a thousandth.
        assert!(worst < 2e-3, "{worst}");
    }
}

#[test]
fn threads_do_not_change_a_byte_and_the_seed_does() {
    let phantom = phantom(SceneName::BoltInPlate, 24);
    let run = |threads: usize, phantom: &Phantom| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| phantom.rasterise(&Execution::default()).unwrap())
    };
    let one = run(1, &phantom);
    assert_eq!(one, run(4, &phantom));
    let other = Phantom::new(&PhantomOptions { seed: 2, ..phantom.options().clone() }).unwrap();
    assert_ne!(one, run(1, &other));
}

#[test]
fn correlated_noise_has_the_strength_and_the_reach_asked_for_whatever_the_threads() {
    let make = |noise: f64, noise_correlation: f64| {
        let options = PhantomOptions {
            noise: Noise::Grey(noise),
            noise_correlation,
            sample_type: SampleType::F32,
            ..options(SceneName::Cube, 64)
        };
        Phantom::new(&options).unwrap()
    };
    let run = |threads: usize, phantom: &Phantom| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| phantom.rasterise(&Execution::default()).unwrap())
    };
    let silent = run(2, &make(0.0, 1.2));
    for correlation in [0.0, 0.8, 1.5] {
        let phantom = make(50.0, correlation);
        let samples = run(1, &phantom);
        assert_eq!(samples, run(3, &phantom));
        let noise: Vec<f64> =
            (0..samples.len()).map(|i| f64::from(samples.get(i)) - f64::from(silent.get(i))).collect();
        // Products of neighbours along x, y and z; what is lost at the ends of rows does not matter here.
        let n = noise.len() as f64;
        let product = |lag: usize| noise.iter().zip(&noise[lag..]).map(|(a, b)| a * b).sum::<f64>() / n;
        let variance = product(0);
        assert!((variance.sqrt() / 50.0 - 1.0).abs() < 0.03, "{correlation}: {}", variance.sqrt());
        // Noise filtered by a Gaussian has the correlation exp(-d^2 / (4 sigma^2)).
        let expected = if correlation > 0.0 { (-0.25 / (correlation * correlation)).exp() } else { 0.0 };
        for lag in [1, 64, 64 * 64] {
            let found = product(lag) / variance;
            assert!((found - expected).abs() < 0.03, "{correlation} {lag}: {found} {expected}");
        }
    }
}

#[test]
fn cupping_darkens_the_middle_only() {
    let base = PhantomOptions {
        noise: Noise::Grey(0.0),
        sample_type: SampleType::F32,
        ..options(SceneName::Sphere, 32)
    };
    let middle = |cupping| {
        let phantom = Phantom::new(&PhantomOptions { cupping, ..base.clone() }).unwrap();
        phantom.rasterise(&Execution::default()).unwrap().get((16 * 32 + 16) * 32 + 16)
    };
    assert!((middle(0.0) - 11600.0).abs() < 0.01);
    assert!((f64::from(middle(0.1)) - (11600.0 - 760.0)).abs() < 40.0);
    // Off the middle it follows the square of the distance, and the blur adds its variance: the percentage is that
    // of the difference from air, and the noise's percentage is that of the undarkened difference.
    let phantom = Phantom::new(&PhantomOptions { cupping: 0.1, ..base.clone() }).unwrap();
    let samples = phantom.rasterise(&Execution::default()).unwrap();
    let (centre, radius) = phantom.truth().ball();
    let spread = 3.0 * (1.15_f64 * 1.15 + 1.0 / 12.0);
    for x in 12..=20 {
        let p = phantom.geometry().world(DVec3::new(f64::from(x), 16.0, 16.0));
        let share = ((p - centre).length_squared() + spread) / (radius * radius);
        let expected = 4000.0 + 7600.0 * (1.0 - 0.1 * (1.0 - share));
        let found = f64::from(samples.get((16 * 32 + 16) * 32 + x as usize));
        assert!((found - expected).abs() < 2.0, "{x}: {found} {expected}");
    }
    let noisy = PhantomOptions { cupping: 0.1, noise: Noise::Percent(2.0), ..base };
    assert!((Phantom::new(&noisy).unwrap().noise_sigma() - 0.02 * 7600.0).abs() < 1e-9);
}

#[test]
fn a_box_on_voxel_boundaries_has_two_grey_values_only_with_and_without_area_sampling() {
    let aligned = PhantomOptions {
        scene: SceneName::Cube,
        size: [24, 23, 16],
        spacing: [0.5, 0.7, 1.1],
        extent: Some([16.0, 15.0, 6.0]),
        rotation: [0.0; 3],
        shift: [0.0; 3],
        sigma: 0.0,
        noise: Noise::Grey(0.0),
        ..PhantomOptions::default()
    };
    let values = |options: &PhantomOptions| {
        let phantom = Phantom::new(options).unwrap();
        let samples = phantom.rasterise(&Execution::default()).unwrap();
        let [air, metal] = [0, 1].map(|k| phantom.materials().materials()[k].mean);
        let all: Vec<f64> = (0..samples.len()).map(|i| f64::from(samples.get(i))).collect();
        let count = |wanted: f64| all.iter().filter(|v| (**v - wanted).abs() < 0.5).count();
        (count(air), count(metal), all.len())
    };
    let metal = 16 * 15 * 6;
    let voxels = 24 * 23 * 16;
    for binary in [false, true] {
        let options = PhantomOptions { binary, sigma: if binary { 3.0 } else { 0.0 }, ..aligned.clone() };
        assert_eq!(values(&options), (voxels - metal, metal, voxels), "{binary}");
    }
    // Turned, only a binary one has two grey values.
    let turned = PhantomOptions { rotation: [7.0, 11.0, 4.0], extent: Some([12.0, 10.0, 4.0]), ..aligned };
    let (air, metal, all) = values(&turned);
    assert!(air + metal < all);
    let (air, metal, all) = values(&PhantomOptions { binary: true, ..turned.clone() });
    assert_eq!(air + metal, all);
    let refused = |change: PhantomOptions| Phantom::new(&change).unwrap_err().to_string();
    assert!(refused(PhantomOptions { extent: Some([30.0; 3]), ..turned.clone() }).contains("extent"));
    assert!(refused(PhantomOptions { extent: Some([0.0; 3]), ..turned.clone() }).contains("extent"));
    assert!(refused(PhantomOptions { scene: SceneName::Steps, ..turned }).contains("only cube"));
}
