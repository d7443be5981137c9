//! Tests of the corner: derivatives, the blur itself, lines, and one fit.

#![allow(clippy::print_stdout)] // figures, with --nocapture

use super::super::corner::LineKind;
use super::super::orthant::tests::normals;
use super::super::sheet::Sample;
use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn corner(rng: &mut ChaCha8Rng, materials: [u8; 8]) -> Corner {
    Corner {
        apex: DVec3::new(0.1, -0.2, 0.15),
        normals: normals(rng, 0.3),
        materials,
        levels: [4.0, 11.6, 22.0, 40.0],
        log_sigma: 0.0,
        forms: [DMat3::ZERO; 3],
    }
}

/// The mean of the scene over a Gaussian about `at`, summed over a grid.
fn slow(corner: &Corner, at: DVec3) -> f64 {
    let (n, step) = (75, 0.08);
    let sigma = libm::exp(corner.log_sigma);
    let line: Vec<(f64, f64)> = (-n..n)
        .map(|i| {
            let x = (f64::from(i) + 0.37) * step;
            (x * sigma, libm::exp(-0.5 * x * x))
        })
        .collect();
    let total: f64 = line.iter().map(|l| l.1).sum();
    let mut sum = 0.0;
    for &(x, p) in &line {
        for &(y, q) in &line {
            let row: f64 = line
                .iter()
                .map(|&(z, r)| r * corner.levels[usize::from(corner.material(at + DVec3::new(x, y, z)))])
                .sum();
            sum += p * q * row;
        }
    }
    sum / total.powi(3)
}

#[test]
fn blurred_values_are_means_over_a_gaussian() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut worst = 0.0f64;
    for materials in [[0, 0, 0, 0, 0, 0, 0, 1], [0, 1, 0, 0, 3, 3, 3, 3], [0, 1, 2, 3, 3, 1, 0, 2]] {
        let mut c = corner(&mut rng, materials);
        c.log_sigma = 0.1;
        for _ in 0..5 {
            let at = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2.0..2.0)));
            worst = worst.max((c.blurred(at) - slow(&c, at)).abs());
        }
    }
    println!("largest difference of levels 4 to 40: {worst:.1e}");
    assert!(worst < 5e-3, "{worst}");
}

#[test]
fn derivatives_are_those_of_the_prediction() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for materials in [[0, 0, 0, 0, 0, 0, 0, 1], [0, 1, 0, 0, 3, 3, 3, 3], [0, 1, 2, 3, 3, 1, 0, 2]] {
        let c = corner(&mut rng, materials);
        for _ in 0..40 {
            let at = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2.5..2.5)));
            let sample = [Sample { at, grey: 0.0 }];
            let frames = c.normals.map(basis);
            let model = Blurred {
                samples: &Batches::new(&sample),
                anchors: &[],
                start: &c,
                frames,
                bends: true,
                noise: 1.0,
            };
            let mut x =
                SVector::<f64, CORNER>::from_fn(
                    |i, _| if i < BEND { rng.random_range(-0.1..0.1) } else { 0.0 },
                );
            for m in 0..MATERIALS {
                x[LEVEL + m] = c.levels[m];
            }
            let value = |x: &SVector<f64, CORNER>| model.corner(x).0.blurred(at);
            // The residual is the value: right sides are its products with the row.
            let mut equations = Normal::new(&[true; CORNER]);
            model.normal_equations(&x, &mut equations);
            let row = equations.right / value(&x);
            for i in 0..CORNER {
                // Bends that are small here: their effect on other derivatives is left out.
                // Of fourth order: steps are long, as values are in single precision.
                let slope = |step: f64| {
                    let (mut up, mut down) = (x, x);
                    up[i] += step;
                    down[i] -= step;
                    (value(&up) - value(&down)) / (2.0 * step)
                };
                let numeric = (4.0 * slope(1e-2) - slope(2e-2)) / 3.0;
                assert!((row[i] - numeric).abs() < 5e-3, "{materials:?} {i}: {} {numeric}", row[i]);
            }
        }
    }
}

#[test]
fn lines_are_edges_junctions_or_nothing() {
    let count = |materials: [u8; 8], kind: LineKind| {
        let c = Corner {
            apex: DVec3::ZERO,
            normals: DVec3::AXES,
            materials,
            levels: [0.0; MATERIALS],
            log_sigma: 0.0,
            forms: [DMat3::ZERO; 3],
        };
        c.lines().iter().filter(|l| l.kind == kind).count()
    };
    // A block's corner has three edges.
    let block = [0, 0, 0, 0, 0, 0, 0, 1];
    assert_eq!([LineKind::Edge, LineKind::Junction].map(|k| count(block, k)), [3, 0]);
    // An edge along z that ends on a plate: one edge, and two junction curves on the plate.
    let ends = [2, 2, 2, 2, 0, 0, 0, 1];
    assert_eq!([LineKind::Edge, LineKind::Junction].map(|k| count(ends, k)), [1, 2]);
    // Three blocks along the plate: the same curve goes on as nothing below.
    let straight = [2, 2, 2, 2, 0, 1, 0, 1];
    assert_eq!([LineKind::Edge, LineKind::Junction].map(|k| count(straight, k)), [0, 2]);
    assert_eq!(count([0, 1, 1, 0, 0, 0, 0, 0], LineKind::Crossing), 1);
    let c = Corner {
        apex: DVec3::ONE,
        normals: DVec3::AXES,
        materials: ends,
        levels: [0.0; MATERIALS],
        log_sigma: 0.0,
        forms: [DMat3::ZERO; 3],
    };
    let edge = c.lines().into_iter().find(|l| l.kind == LineKind::Edge).expect("an edge");
    assert_eq!((edge.direction, edge.planes), (DVec3::Z, [0, 1]));
    assert_eq!(c.material(DVec3::splat(2.0)), 1);
    assert_eq!(c.sides(2, DVec3::new(2.0, 2.0, 1.0)), [2, 1]);
    assert!(c.is_complete());
    assert!(!Corner { materials: [0, 1, 0, 1, 0, 0, 0, 0], ..c.clone() }.is_complete());
    assert!((c.distance(1, DVec3::new(0.0, 3.0, 0.0)) - 2.0).abs() < 1e-12);
}
