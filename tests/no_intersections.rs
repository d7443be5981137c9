//! No two triangles of a contoured mesh meet except in what they share, decided exactly: all corner
//! patterns, random label blocks, facing hexagons, any crossing positions.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::collections::BTreeSet;

use interfacet::contour::pattern::{PARTITIONS, PatternTable};
use interfacet::contour::{CROSSING_MARGIN, CrossingRule};
use interfacet::execution::Execution;
use interfacet::grid::cube::other_axes;
use interfacet::grid::{Geometry, MaterialId};
use interfacet::mesh::{CheckOptions, Defects, check};
use proptest::prelude::*;
use wild::{Wild, lumps, mesh, mix};

mod wild;

fn defects(labels: &[u8], size: [usize; 3], rule: &impl CrossingRule) -> Defects {
    let mesh = mesh(labels, &Geometry::axis_aligned(size, [1.0; 3]).unwrap(), rule);
    check(&mesh, &CheckOptions::default(), &Execution::default()).unwrap()
}

/// Many small blocks side by side along x and y, z layers apart: one check instead of thousands.
struct Tiles {
    size: [usize; 3],
    labels: Vec<u8>,
    /// Face bits of the cell in the middle of each tile.
    bits: Vec<u8>,
    positions: Positions,
    seed: u64,
}

/// Where the crossings are.
#[derive(Clone, Copy)]
enum Positions {
    /// As [`Wild`] has them.
    Wild,
    /// At one end of their edge or the other, at random.
    Ends,
    /// In tile n, those of the middle cell's edge e at the end that bit e of n says.
    Every,
}

/// Voxels along a side of a tile.
const TILE: usize = 4;

impl Tiles {
    /// A tile for each of `middles` (the classes of its middle cell's corners, and its face bits);
    /// the voxels round the middle are material 0 or, if `mixed`, random.
    fn new(middles: &[([u8; 8], u8)], seed: u64, mixed: bool, positions: Positions) -> Self {
        let side = (middles.len() as f64).cbrt().ceil() as usize;
        let n = side * TILE;
        let mut labels = vec![0u8; n * n * n];
        for (i, label) in labels.iter_mut().enumerate() {
            let at = [i % n, i / n % n, i / (n * n)];
            let tile = Self::tile(side, at);
            let inside = at.map(|c| c % TILE);
            let inner = inside.iter().all(|c| (1..3).contains(c));
            *label = match middles.get(tile) {
                Some((classes, _)) if inner => {
                    1 + classes[(inside[0] - 1) | (inside[1] - 1) << 1 | (inside[2] - 1) << 2]
                }
                Some(_) if mixed => (mix(seed ^ 0x55, &at) % 9) as u8,
                _ => 0,
            };
        }
        let bits = middles.iter().map(|m| m.1).collect();
        Self { size: [n; 3], labels, bits, positions, seed }
    }

    fn tile(side: usize, at: [usize; 3]) -> usize {
        let [x, y, z] = at.map(|c| c / TILE);
        (z * side + y) * side + x
    }

    /// The pattern of the cell that a point (lattice units) lies in, for messages.
    fn pattern_at(&self, point: [f64; 3]) -> [u8; 8] {
        let low = point.map(f64::floor);
        std::array::from_fn(|c| {
            let at: [f64; 3] = std::array::from_fn(|a| low[a] + (c >> a & 1) as f64);
            let n = self.size[0];
            if at.iter().any(|&v| v < 0.0 || v >= n as f64) {
                return 255;
            }
            let [x, y, z] = at.map(|v| v as usize);
            self.labels[(z * n + y) * n + x]
        })
    }

    fn assert_sound(&self, what: &str) {
        let found = defects(&self.labels, self.size, self);
        let places: Vec<_> =
            found.self_intersections.first.iter().map(|d| d.centroids.map(|c| self.pattern_at(c))).collect();
        assert!(found.is_empty(), "{what}: {:?}; patterns of intersections: {places:?}", found.by_kind());
    }
}

impl CrossingRule for Tiles {
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        let end = |high: bool| if high { 1.0 - CROSSING_MARGIN } else { CROSSING_MARGIN };
        let wild = Wild { seed: self.seed, cell: [usize::MAX; 3], bits: 0 };
        // Points are padded: one more than a voxel's index.
        let at = from.map(|c| c - 1);
        match self.positions {
            Positions::Wild => wild.position(from, axis, labels),
            Positions::Ends => end(mix(self.seed, &[at[0], at[1], at[2], axis]) & 1 == 1),
            Positions::Every => {
                let others = other_axes(axis).map(|a| at[a] % TILE);
                if at[axis] % TILE != 1 || others.iter().any(|c| !(1..3).contains(c)) {
                    return wild.position(from, axis, labels);
                }
                let edge = 4 * axis + others[0] - 1 + 2 * (others[1] - 1);
                end(Self::tile(self.size[0] / TILE, at) >> edge & 1 == 1)
            }
        }
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        let low = ring[0].map(|c| c - 1);
        let bits = self.bits.get(Self::tile(self.size[0] / TILE, low)).copied().unwrap_or(0);
        let cell = low.map(|c| c / TILE * TILE + 2);
        Wild { seed: self.seed, cell, bits }.joins_first(ring, labels)
    }
}

#[test]
fn no_entry_of_the_table_intersects_itself_or_its_neighbours() {
    let table = PatternTable::get();
    let mut middles = Vec::new();
    for partition in 0..PARTITIONS {
        let ambiguous = table.ambiguous_faces(partition);
        let classes = *table.partitions().classes(partition);
        middles.extend((0..64u8).filter(|b| b & !ambiguous == 0).map(|bits| (classes, bits)));
    }
    assert_eq!(middles.len(), table.len());
    for seed in 0..seeds() {
        let positions = if seed & 1 == 0 { Positions::Ends } else { Positions::Wild };
        let mixed = (seed + 1) % 4 > 1;
        Tiles::new(&middles, seed, mixed, positions).assert_sound(&format!("seed {seed}"));
    }
}

/// How many seeds to try; INTERFACET_SEEDS asks for a longer run than the usual one.
fn seeds() -> u64 {
    std::env::var("INTERFACET_SEEDS").ok().and_then(|s| s.parse().ok()).unwrap_or(2)
}

/// Two loops of six crossings, each cut off by two corners that are joined through one of two
/// opposite faces: the one case in which fans of two sheets would meet (fanned instead of coned,
/// these tests fail). Every combination of crossings at the ends of their edges, and random ones.
#[test]
fn facing_hexagons_never_meet() {
    let table = PatternTable::get();
    let mut middles = Vec::new();
    // Corners 0 and 3 joined through a face, 5 and 6 through the opposite one; of one material or two.
    for classes in [[0u8, 1, 1, 0, 1, 0, 0, 1], [0, 1, 1, 0, 1, 2, 2, 1]] {
        let partition = (0..PARTITIONS).find(|&p| *table.partitions().classes(p) == classes).unwrap();
        let ambiguous = table.ambiguous_faces(partition);
        let bits = (0..64u8).filter(|b| b & !ambiguous == 0);
        // Two sheets with an apex each.
        middles.extend(
            bits.filter(|&b| table.surface(table.entry(partition, b)).apexes.len() == 2)
                .map(|bits| (classes, bits)),
        );
    }
    assert!(middles.iter().map(|m| m.0[6]).collect::<BTreeSet<_>>().len() == 2, "{middles:?}");
    for (i, &middle) in middles.iter().enumerate() {
        let what = format!("{middle:?}");
        Tiles::new(&[middle; 1 << 12], i as u64, false, Positions::Every).assert_sound(&what);
    }
    let many: Vec<_> = middles.iter().copied().cycle().take(3000).collect();
    for seed in 0..seeds() {
        Tiles::new(&many, seed, false, Positions::Wild).assert_sound(&format!("seed {seed}"));
    }
}

/// Positions are `f32` in lattice units: at the end of the longest axis their step is coarsest.
#[test]
fn rounding_at_the_far_end_of_the_lattice_brings_no_defects() {
    for axis in 0..3 {
        let mut size = [11, 12, 13];
        size[axis] = Geometry::MAX_AXIS;
        for seed in 0..3 {
            let noise = lumps(size.map(|n| n.min(24)), 3 + 2 * seed, (seed % 2) as usize, seed);
            let labels: Vec<u8> = (0..size.iter().product::<usize>())
                .map(|i| {
                    let mut at = [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])];
                    let Some(c) = (at[axis] + 24).checked_sub(Geometry::MAX_AXIS) else { return 0 };
                    at[axis] = c;
                    let n = size.map(|n| n.min(24));
                    noise[(at[2] * n[1] + at[1]) * n[0] + at[0]]
                })
                .collect();
            let found = defects(&labels, size, &Wild { seed, cell: [usize::MAX; 3], bits: 0 });
            assert!(found.is_empty(), "axis {axis} seed {seed}: {:?}", found.by_kind());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn random_label_blocks_have_no_defects(
        size in [1usize..8, 1usize..8, 1usize..8],
        materials in 2u64..9,
        smooth in 0usize..3,
        seed: u64,
    ) {
        let labels = lumps(size, materials, smooth, seed);
        prop_assume!(labels.iter().any(|&l| l != labels[0]));
        let found = defects(&labels, size, &Wild { seed, cell: [usize::MAX; 3], bits: 0 });
        prop_assert!(found.is_empty(), "{:?}", found.by_kind());
    }
}
