//! Topology by local models ([`Accuracy::Full`]) over rotations, seeds and noise: no stray shell, no part in two, no defect.
//!
//! Small grids: walls of five voxels, where fits are few and neighbouring sheets are near.

use interfacet::phantom::{Noise, PhantomOptions, SceneName};

#[path = "common/models.rs"]
mod models;

const ROTATIONS: [[f64; 3]; 4] =
    [[7.3, 11.9, 4.1], [23.0, -15.0, 32.0], [41.0, 9.0, -20.0], [12.0, 33.0, 7.0]];

/// Seed and percent of noise of each rotation's image.
const IMAGES: [(u64, f64); 4] = [(1, 1.0), (7, 4.0), (3, 1.0), (1, 1.0)];

/// The mesh of an object in these images must be sound and have the object's shells.
fn has_its_shells(scene: SceneName, size: usize, images: &[usize]) {
    let mut wrong = Vec::new();
    for &image in images {
        let (rotation, (seed, noise)) = (ROTATIONS[image], IMAGES[image]);
        let options = PhantomOptions {
            scene,
            size: [size; 3],
            rotation,
            seed,
            noise: Noise::Percent(noise),
            fill: 0.85,
            fine: 2,
            ..PhantomOptions::default()
        };
        let found = models::measured(&options);
        let differs = found.materials.iter().filter(|m| m.topology != m.expected);
        wrong.extend(differs.map(|m| (image, m.name.clone(), m.topology, m.expected)));
    }
    assert!(wrong.is_empty(), "{} at {size}: {wrong:#?}", scene.name());
}

#[test]
fn cubes_turned() {
    has_its_shells(SceneName::CubeInCube, 64, &[0, 1, 2, 3]);
}

#[test]
fn four_materials_turned() {
    // The second has a handle (docs/locate.md).
    has_its_shells(SceneName::FourMaterials, 48, &[0, 2, 3]);
}

#[test]
fn rings_turned() {
    has_its_shells(SceneName::PressFitRing, 64, &[0, 1, 2, 3]);
}
