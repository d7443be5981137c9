//! Vertices that are wished elsewhere: whatever is wished, no triangles meet, and the same is granted in any slabs.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests are tests; figures, with --nocapture

use interfacet::classify::LabelVolume;
use interfacet::contour::marching::{march, march_pieces};
use interfacet::contour::{
    Border, ContourError, CrossingRule, Moves, Node, Patch, Piece, Surroundings, Wishes, merge, settle,
    surroundings,
};
use interfacet::execution::Execution;
use interfacet::grid::{Geometry, MaterialId};
use interfacet::mesh::{CheckOptions, InterfaceMesh, MeshMaterial, check};
use sound::assert_sound;
use wild::{Wild, lumps, mix};

mod sound;
mod wild;

/// Crossings anywhere, and wishes for places up to `reach` away.
struct Wishful<'a> {
    wild: Wild,
    reach: f32,
    moves: Option<&'a Moves>,
}

impl Wishful<'_> {
    fn wish(&self, [x, y, z]: [usize; 3], salt: usize, from: [f32; 3]) -> Option<Node> {
        let h = mix(self.wild.seed, &[x, y, z, salt]);
        let by = [0, 10, 20].map(|shift| self.reach * (2.0 * (h >> shift & 1023) as f32 / 1023.0 - 1.0));
        (h >> 30 & 3 != 0).then_some(Node { at: [0, 1, 2].map(|a| from[a] + by[a]), sigma: 0.5 })
    }
}

impl CrossingRule for Wishful<'_> {
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.wild.position(from, axis, labels)
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        self.wild.joins_first(ring, labels)
    }

    fn has_kinks(&self) -> bool {
        true
    }

    fn kink(&self, low: [usize; 3], axis: usize) -> Option<Node> {
        let h = mix(self.wild.seed, &[low[0], low[1], low[2], axis, 50]);
        let at = [0, 10, 20].map(|shift| 0.3 + 0.4 * (h >> shift & 1023) as f32 / 1023.0);
        (h >> 30 & 7 == 0).then_some(Node { at, sigma: 0.5 })
    }

    fn moves(&self) -> Option<&Moves> {
        self.moves
    }
}

impl Wishes for Wishful<'_> {
    fn speaks(&self, _: [usize; 3]) -> bool {
        true
    }

    fn crossing(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Option<Node> {
        let mut at = from.map(|c| c as f32 - 1.0);
        at[axis] += self.position(from, axis, labels);
        self.wish(from, axis, at)
    }

    fn node(&self, low: [usize; 3], axis: usize, safe: [f32; 3]) -> Option<Node> {
        self.wish(low, 3 + axis, safe)
    }

    fn kink(&self, low: [usize; 3], axis: usize, _: [f32; 3]) -> Option<Node> {
        self.wish(low, 6 + axis, low.map(|c| c as f32 - 0.5))
    }

    fn facing(&self, _: [MaterialId; 2], _: [f32; 3]) -> Option<[f32; 3]> {
        None
    }

    fn apex(&self, low: [usize; 3], at: [f32; 3]) -> Option<Node> {
        self.wish(low, 9, at)
    }
}

fn mesh(patch: Patch, geometry: &Geometry, materials: usize) -> InterfaceMesh {
    let material = |i: usize| MeshMaterial { id: MaterialId(i as u8), name: format!("m{i}"), mean: i as f64 };
    InterfaceMesh::from_patch(patch, geometry, (0..materials).map(material).collect()).unwrap()
}

/// What can be granted, looked at in slabs of `layers` layers.
fn granted(volume: &LabelVolume, rule: &Wishful<'_>, geometry: &Geometry, layers: usize) -> (usize, Moves) {
    let (all, execution) = (volume.codes().padded()[2] - 1, Execution::default());
    let mut around = Surroundings::default();
    for z in (0..all).step_by(layers) {
        let slab = z..(z + layers).min(all);
        around.append(surroundings(volume, rule, Border::Closed, slab, &execution).unwrap());
    }
    (around.wishes.len(), settle(around, geometry, &execution).unwrap())
}

#[test]
fn no_triangles_meet_whatever_is_wished_and_slabs_do_not_show() {
    let size = [13, 12, 11];
    let geometry = Geometry::axis_aligned(size, [0.3, 0.4, 0.5]).unwrap();
    let execution = Execution::default();
    let (mut wished, mut some) = (0, 0);
    for seed in 0..16 {
        // One voxel's labels alone make cells with several sheets, which kinks alone let meet: see tests/kinks.rs.
        let labels = lumps(size, 3 + seed % 3, 2, seed);
        let (volume, ids) = LabelVolume::from_labels(&labels, size).unwrap();
        let wild = || Wild { seed, cell: [usize::MAX; 3], bits: 0 };
        // What is wished farther than a vertex may move is granted as far as it may.
        let reach = [0.1, 0.4, 0.99, 1.9][seed as usize % 4];
        let rule = Wishful { wild: wild(), reach, moves: None };
        let (wishes, moves) = granted(&volume, &rule, &geometry, usize::MAX);
        // Unknown sigmas are the same by their bits.
        let bits = |m: &Moves| {
            let all = m.all().iter().map(|m| (m.key, m.at.map(f32::to_bits), m.sigma.to_bits()));
            all.collect::<Vec<_>>()
        };
        assert!(bits(&granted(&volume, &rule, &geometry, 4).1) == bits(&moves), "{seed}");
        wished += wishes;
        let plain = march(&volume, &rule, Border::Closed, &execution).unwrap();
        let moved = Wishful { wild: wild(), reach, moves: Some(&moves) };
        let patch = march(&volume, &moved, Border::Closed, &execution).unwrap();
        assert_sound(&patch, ids.len(), Border::Closed, &|| format!("{seed}"));
        assert_eq!(plain.triangles, patch.triangles);
        let places = patch
            .positions
            .iter()
            .zip(&plain.positions)
            .filter(|(a, b)| a.map(f32::to_bits) != b.map(f32::to_bits))
            .inspect(|(a, b)| assert!((0..3).all(|i| (a[i] - b[i]).abs() < 1.0), "{seed}: {a:?} {b:?}"))
            .count();
        assert!(places <= moves.all().len(), "{seed}");
        some += places;
        let mut pieces: Vec<Piece> = Vec::new();
        march_pieces(&volume, &moved, Border::Closed, 0..size[2] + 1, 500, &execution, &mut |piece| {
            pieces.push(piece);
            Ok::<_, ContourError>(())
        })
        .unwrap();
        assert!(pieces.len() > 1 && merge(pieces).unwrap().patch == patch);
        let met = |patch: Patch| {
            let mesh = mesh(patch, &geometry, ids.len());
            let mut defects = check(&mesh, &CheckOptions::default(), &execution).unwrap();
            let count = std::mem::take(&mut defects.self_intersections.count);
            assert!(defects.is_empty(), "{seed}: {:?}", defects.by_kind());
            count
        };
        // Kinks beside another sheet may meet it, with or without moves; those that move do not.
        let (before, after) = (met(plain), met(patch));
        assert!(after <= before, "{seed}: {after} pairs meet, {before} without moves");
    }
    println!("{some} of {wished} wishes granted, at least in part");
    assert!(some > wished / 4, "{some} of {wished}");
}
