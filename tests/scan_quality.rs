//! Blur against phantoms whose blur is known.

use interfacet::execution::Execution;
use interfacet::material::ScanQuality;
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
    let turned = PhantomOptions { scene: SceneName::Cube, rotation: [35.0, 40.0, 20.0], ..base.clone() };
    assert!(error(&turned) < 0.02);
    let ball10 =
        PhantomOptions { scene: SceneName::Sphere, fill: 20.0 / 64.0, size: [64; 3], ..base.clone() };
    assert!(error(&ball10) < 0.02);
    let flat = PhantomOptions { spacing: [0.4, 0.4, 0.5], size: [96, 96, 80], ..base };
    assert!(error(&flat) < 0.01);
}
