//! Contouring without defects: all corner patterns, random label blocks, any crossing positions.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use interfacet::classify::LabelVolume;
use interfacet::contour::marching::march;
use interfacet::contour::{Border, CrossingRule, Midpoints, Patch};
use interfacet::execution::Execution;
use proptest::prelude::*;
use sound::assert_sound;
use wild::{Wild, for_all_patterns, lumps, mix};

mod sound;
mod wild;

fn extract(labels: &[u8], size: [usize; 3], rule: &impl CrossingRule, border: Border) -> (Patch, usize) {
    let (volume, ids) = LabelVolume::from_labels(labels, size).unwrap();
    (march(&volume, rule, border, &Execution::default()).unwrap(), ids.len())
}

#[test]
fn all_patterns_with_all_face_bits_are_sound_in_any_neighbourhood() {
    for_all_patterns(|labels, rule, what| {
        let (patch, n) = extract(labels, [4; 3], rule, Border::Closed);
        assert_sound(&patch, n, Border::Closed, &|| what.to_owned());
    });
}

#[test]
fn a_checkerboard_of_eight_materials_is_sound() {
    for n in 2..=8usize {
        let size = [9, 8, 7];
        let labels: Vec<u8> = (0..9 * 8 * 7)
            .map(|i| {
                let [x, y, z] = [i % 9, i / 9 % 8, i / 72];
                ((x + 3 * y + 5 * z) % n) as u8
            })
            .collect();
        for border in [Border::Closed, Border::Open] {
            let (patch, n) = extract(&labels, size, &Midpoints, border);
            assert_sound(&patch, n, border, &|| format!("{n} materials, {border:?}"));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn random_label_blocks_are_sound(
        size in [1usize..7, 1usize..7, 1usize..7],
        materials in 2u64..9,
        smooth in 0usize..3,
        seed: u64,
    ) {
        let labels = lumps(size, materials, smooth, seed);
        prop_assume!(labels.iter().any(|&l| l != labels[0]));
        for border in [Border::Closed, Border::Open] {
            let rule = Wild { seed, cell: [usize::MAX; 3], bits: 0 };
            let (patch, n) = extract(&labels, size, &rule, border);
            assert_sound(&patch, n, border, &|| format!("{size:?} {materials} {smooth} {seed} {border:?}"));
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_patch() {
    let size = [67, 21, 23];
    let labels: Vec<u8> =
        (0..67 * 21 * 23).map(|i| (mix(5, &[i % 67 / 2, i / 67 % 21 / 3, i / 1407]) % 5) as u8).collect();
    let rule = Wild { seed: 3, cell: [usize::MAX; 3], bits: 0 };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| extract(&labels, size, &rule, Border::Closed).0)
    };
    let one = run(1);
    assert!(one == run(2) && one == run(8));
}
