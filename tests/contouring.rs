//! Contouring without defects: all corner patterns, random label blocks, any crossing positions.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::collections::HashMap;

use interfacet::classify::LabelVolume;
use interfacet::contour::marching::march;
use interfacet::contour::pattern::{PARTITIONS, PatternTable};
use interfacet::contour::{Border, CrossingRule, Midpoints, Patch};
use interfacet::execution::Execution;
use interfacet::grid::MaterialId;
use proptest::prelude::*;
use wild::{Wild, lumps, mix};

mod wild;

/// Asserts that every material's shell is closed, consistently oriented, and that every vertex
/// link of it is one cycle; that kinds say how many materials meet; that no vertex is unused.
fn assert_sound(patch: &Patch, materials: usize, border: Border, what: &dyn Fn() -> String) {
    let mut used = vec![false; patch.positions.len()];
    let mut around: Vec<Vec<u8>> = vec![Vec::new(); patch.positions.len()];
    for (t, pair) in patch.triangles.iter().zip(&patch.pairs) {
        assert!(t[0] != t[1] && t[1] != t[2] && t[2] != t[0], "{}", what());
        assert!(pair.front() == MaterialId::OUTSIDE || pair.back() > pair.front(), "{}", what());
        for &v in t {
            used[v as usize] = true;
            for id in [pair.back().0, pair.front().0] {
                if !around[v as usize].contains(&id) {
                    around[v as usize].push(id);
                }
            }
        }
    }
    assert!(used.iter().all(|&u| u), "a vertex without triangles: {}", what());
    for (kind, around) in patch.kinds.iter().zip(&around) {
        if border == Border::Closed {
            assert_eq!(usize::from(kind.code() % 10), around.len().clamp(2, 4), "{}", what());
        }
    }
    for material in 0..materials as u8 {
        // The background's shell lacks its side towards OUTSIDE; with an open border all do.
        let shell: Vec<[u32; 3]> = patch
            .triangles
            .iter()
            .zip(&patch.pairs)
            .filter_map(|(&[a, b, c], pair)| match material {
                m if pair.back().0 == m => Some([a, b, c]),
                m if pair.front().0 == m => Some([a, c, b]),
                _ => None,
            })
            .collect();
        let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
        let mut links: HashMap<u32, HashMap<u32, u32>> = HashMap::new();
        for t in &shell {
            for k in 0..3 {
                let (a, b, c) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
                *edges.entry((a, b)).or_default() += 1;
                let repeated = links.entry(a).or_default().insert(b, c);
                assert!(repeated.is_none(), "material {material}, edge {a}-{b} used twice: {}", what());
            }
        }
        let may_be_open = material == 0 || border == Border::Open;
        for &(a, b) in edges.keys() {
            let border_edge = patch.kinds[a as usize].is_border() && patch.kinds[b as usize].is_border();
            let matched = edges.contains_key(&(b, a));
            assert!(
                matched || may_be_open && border_edge,
                "material {material}, edge {a}-{b} is open: {}",
                what()
            );
        }
        for (v, link) in &links {
            if may_be_open && patch.kinds[*v as usize].is_border() {
                continue;
            }
            let start = *link.keys().next().unwrap();
            let (mut at, mut steps) = (link[&start], 1);
            while at != start {
                at = *link.get(&at).unwrap_or_else(|| panic!("material {material}, vertex {v}: {}", what()));
                steps += 1;
            }
            assert_eq!(
                steps,
                link.len(),
                "material {material}: link of vertex {v} has several cycles: {}",
                what()
            );
        }
    }
}

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
