//! Contouring without defects: all corner patterns, random label blocks, any crossing positions.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use interfacet::classify::LabelVolume;
use interfacet::contour::marching::march;
use interfacet::contour::pattern::{PARTITIONS, PatternTable};
use interfacet::contour::{Border, CrossingRule, Midpoints, Patch};
use interfacet::execution::Execution;
use proptest::prelude::*;
use sound::assert_sound;
use wild::{Wild, lumps, mix};

mod sound;
mod wild;

fn extract(labels: &[u8], size: [usize; 3], rule: &impl CrossingRule, border: Border) -> (Patch, usize) {
    let (volume, ids) = LabelVolume::from_labels(labels, size).unwrap();
    (march(&volume, rule, border, &Execution::default()).unwrap(), ids.len())
}

#[test]
fn all_patterns_with_all_face_bits_are_sound_in_any_neighbourhood() {
    let table = PatternTable::get();
    let size = [4usize; 3];
    for partition in 0..PARTITIONS {
        let classes = *table.partitions().classes(partition);
        let ambiguous = table.ambiguous_faces(partition);
        for bits in (0..64u8).filter(|b| b & !ambiguous == 0) {
            // Two neighbourhoods: one material around, and a random mix of the pattern's classes.
            for seed in 0..2u64 {
                let mut labels = [9u8; 64];
                for (i, label) in labels.iter_mut().enumerate() {
                    let [x, y, z] = [i % 4, i / 4 % 4, i / 16];
                    let inner = [x, y, z].iter().all(|c| (1..3).contains(c));
                    *label = if inner {
                        1 + classes[(x - 1) | (y - 1) << 1 | (z - 1) << 2]
                    } else if seed == 0 {
                        0
                    } else {
                        (mix(partition as u64 + 64 * u64::from(bits), &[x, y, z]) % 9) as u8
                    };
                }
                if labels.iter().all(|&l| l == labels[0]) {
                    continue;
                }
                let rule = Wild { seed: partition as u64, cell: [2; 3], bits };
                let (patch, n) = extract(&labels, size, &rule, Border::Closed);
                assert_sound(&patch, n, Border::Closed, &|| {
                    format!("partition {partition} bits {bits} seed {seed}")
                });
            }
        }
    }
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
