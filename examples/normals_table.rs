//! Prints the table of `docs/hermite.md`: angles between the estimated normals of crossings and the true ones,
//! on phantoms; and how long each estimate takes for a crossing.
//!
//! `cargo run --release --example normals_table` prints all of it; with `CASES=sphere` in the environment only
//! the cases whose name holds that.

#![allow(clippy::print_stdout)] // the table is its purpose

#[path = "../tests/normals/mod.rs"]
mod normals;

use interfacet::contour::NormalRule;
use interfacet::phantom::SceneName;
use normals::{Found, Scan, options, statistics};

const RULES: [NormalRule; 4] =
    [NormalRule::Gradient, NormalRule::Smoothed, NormalRule::Sided, NormalRule::Auto];

fn line(name: &str, found: &[Found]) {
    type Class = (&'static str, fn(&Found) -> bool);
    let classes: [Class; 7] = [
        ("clear", |f| f.edge > 4.0 && f.junction > 4.0),
        ("edge 1.5-4", |f| f.edge > 1.5 && f.edge <= 4.0 && f.junction > 4.0),
        ("edge 0.5-1.5", |f| f.edge > 0.5 && f.edge <= 1.5 && f.junction > 4.0),
        ("edge <0.5", |f| f.edge <= 0.5 && f.junction > 4.0),
        ("junction 1.5-4", |f| f.junction > 1.5 && f.junction <= 4.0),
        ("junction <1.5", |f| f.junction <= 1.5),
        ("unknown", |f| f.weight < 1.0),
    ];
    for (class, of) in classes {
        let of: Vec<&Found> = found.iter().filter(|f| of(f)).collect();
        if of.is_empty() {
            continue;
        }
        let [mean, p95, most] = statistics(of.iter().map(|f| f.degrees).collect());
        let rms = (of.iter().map(|f| f.off * f.off).sum::<f64>() / of.len() as f64).sqrt();
        let share = 100.0 * of.iter().filter(|f| f.degrees > 30.0).count() as f64 / of.len() as f64;
        println!(
            "{name:<44} {class:<15} {:>6}  {mean:6.2} {p95:6.2} {most:6.1}  >30: {share:4.1} %  position {rms:.3}",
            of.len()
        );
    }
}

fn main() {
    let size = 64;
    let want = std::env::var("CASES").unwrap_or_default();
    for (scene, sigma, noise) in [
        (SceneName::Sphere, 1.15, 0.0),
        (SceneName::Sphere, 1.15, 1.0),
        (SceneName::Sphere, 1.15, 6.0),
        (SceneName::Sphere, 0.0, 0.0),
        (SceneName::Steps, 0.0, 0.0),
        (SceneName::Steps, 0.0, 6.0),
        (SceneName::Steps, 0.5, 1.0),
        (SceneName::Steps, 1.15, 1.0),
        (SceneName::CubeInCube, 0.0, 0.0),
        (SceneName::CubeInCube, 1.15, 1.0),
        (SceneName::SphereOnCylinder, 1.15, 1.0),
    ] {
        let name = format!("{} {sigma} {noise}%", scene.name());
        if !name.contains(&want) {
            continue;
        }
        let scan = Scan::new(&options(scene, size, sigma, noise));
        for rule in RULES {
            line(&format!("{name} {rule:?}"), &scan.grey(rule));
        }
        if noise == 0.0 {
            line(&format!("{name} labels"), &scan.segmented().by_labels());
        }
    }
    Scan::new(&options(SceneName::Sphere, 128, 1.15, 1.0)).time();
}
