//! Crossing positions and face decisions that no scan would give, reproducible from a seed.

#![allow(dead_code, clippy::unwrap_used)] // each test binary uses its part; helpers of tests are tests

use interfacet::classify::LabelVolume;
use interfacet::contour::marching::march;
use interfacet::contour::pattern::{PARTITIONS, PatternTable};
use interfacet::contour::{Border, CROSSING_MARGIN, CrossingRule};
use interfacet::execution::Execution;
use interfacet::grid::{Geometry, MaterialId};
use interfacet::mesh::{InterfaceMesh, MeshMaterial};

/// Any crossing positions and any face decisions, reproducible from a seed; the faces of the cell
/// at `cell` (padded) are decided by `bits`.
pub(crate) struct Wild {
    pub(crate) seed: u64,
    pub(crate) cell: [usize; 3],
    pub(crate) bits: u8,
}

/// A hash.
pub(crate) fn mix(mut h: u64, values: &[usize]) -> u64 {
    for &v in values {
        h = (h ^ v as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
        h ^= h >> 32;
    }
    h.wrapping_mul(0xD6E8_FEB8_6659_FD93) >> 20
}

impl CrossingRule for Wild {
    fn position(&self, [x, y, z]: [usize; 3], axis: usize, _: [MaterialId; 2]) -> f32 {
        let h = mix(self.seed, &[x, y, z, axis]);
        match h % 4 {
            0 => CROSSING_MARGIN,
            1 => 1.0 - CROSSING_MARGIN,
            _ => CROSSING_MARGIN + (1.0 - 2.0 * CROSSING_MARGIN) * ((h >> 2) % 4096) as f32 / 4095.0,
        }
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], _: [MaterialId; 2]) -> bool {
        let [low, high] = [ring[0], ring[2]];
        let axis = (0..3).find(|&a| low[a] == high[a]).unwrap();
        let of_cell = (0..3).all(|a| {
            let offset = low[a].wrapping_sub(self.cell[a]);
            if a == axis { offset < 2 } else { offset == 0 }
        });
        if of_cell {
            self.bits >> (2 * axis + low[axis] - self.cell[axis]) & 1 == 1
        } else {
            mix(self.seed, &[low[0], low[1], low[2], axis, 7]) & 1 == 1
        }
    }
}

/// The closed mesh of a block of labels.
pub(crate) fn mesh(labels: &[u8], geometry: &Geometry, rule: &impl CrossingRule) -> InterfaceMesh {
    let (volume, ids) = LabelVolume::from_labels(labels, geometry.size()).unwrap();
    let patch = march(&volume, rule, Border::Closed, &Execution::default()).unwrap();
    let material = |(i, mean): (usize, &f64)| MeshMaterial {
        id: MaterialId(i as u8),
        name: format!("m{mean}"),
        mean: *mean,
    };
    InterfaceMesh::from_patch(patch, geometry, ids.iter().enumerate().map(material).collect()).unwrap()
}

/// Labels of `materials` in lumps of 2^`smooth` voxels a side.
pub(crate) fn lumps([nx, ny, nz]: [usize; 3], materials: u64, smooth: usize, seed: u64) -> Vec<u8> {
    let at = |c: [usize; 3]| (mix(seed, &c.map(|v| v >> smooth)) % materials) as u8;
    (0..nx * ny * nz).map(|i| at([i % nx, i / nx % ny, i / (nx * ny)])).collect()
}

/// Calls `test` with every pattern of a cell's corners and all bits of its ambiguous faces, in the middle of a
/// block of 4 x 4 x 4 labels: with one material around, and with a random mix of the pattern's. The words
/// say which it is.
pub(crate) fn for_all_patterns(mut test: impl FnMut(&[u8; 64], &Wild, &str)) {
    let table = PatternTable::get();
    for partition in 0..PARTITIONS {
        let classes = *table.partitions().classes(partition);
        let ambiguous = table.ambiguous_faces(partition);
        for bits in (0..64u8).filter(|b| b & !ambiguous == 0) {
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
                if labels.iter().any(|&l| l != labels[0]) {
                    let rule = Wild { seed: partition as u64, cell: [2; 3], bits };
                    test(&labels, &rule, &format!("partition {partition} bits {bits} seed {seed}"));
                }
            }
        }
    }
}
