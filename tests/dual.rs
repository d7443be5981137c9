//! Adaptive dual contouring without defects: all corner patterns, random label blocks with random Hermite
//! data, any collapses that the topology allows.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests are tests; counts, with --nocapture

use glam::{DVec3, Vec3};
use interfacet::classify::LabelVolume;
use interfacet::contour::CrossingRule;
use interfacet::contour::dual::{Bound, Builder, DualOptions, DualSurface};
use interfacet::contour::hermite::LabelHermite;
use interfacet::contour::{Border, Hermite, HermiteRule, Patch};
use interfacet::execution::Execution;
use interfacet::grid::{Geometry, MaterialId};
use interfacet::mesh::{CheckOptions, InterfaceMesh, MeshMaterial, check, measure};
use proptest::prelude::*;
use sound::assert_sound;
use wild::{Wild, for_all_patterns, lumps, mix};

mod sound;
mod wild;

impl HermiteRule for Wild {
    fn hermite(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Hermite {
        let h = mix(self.seed ^ 77, &[from[0], from[1], from[2], axis]);
        let part = |shift: u32| (h >> shift & 1023) as f32 / 511.5 - 1.0;
        let normal = Vec3::new(part(0), part(10), part(20)) + Vec3::AXES[axis];
        Hermite {
            position: self.position(from, axis, labels),
            normal: normal.normalize_or(Vec3::Z),
            weight: 1.0,
        }
    }
}

/// The same by a rule that claims to know curves, with planes that meet the edges' lines anywhere near the edges.
struct Knowing(Wild);

impl CrossingRule for Knowing {
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.0.position(from, axis, labels)
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        self.0.joins_first(ring, labels)
    }
}

impl HermiteRule for Knowing {
    fn hermite(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Hermite {
        let hermite = self.0.hermite(from, axis, labels);
        Hermite { position: 2.0 * hermite.position - 0.5, ..hermite }
    }

    fn knows_curves(&self) -> bool {
        true
    }
}

fn contour(
    labels: &LabelVolume,
    geometry: &Geometry,
    rule: &dyn HermiteRule,
    bound: Bound,
    border: Border,
) -> DualSurface {
    let options = DualOptions { bound, deviation: false, ..DualOptions::default() };
    contour_as(labels, geometry, rule, &options, border)
}

fn contour_as(
    labels: &LabelVolume,
    geometry: &Geometry,
    rule: &dyn HermiteRule,
    options: &DualOptions,
    border: Border,
) -> DualSurface {
    let execution = Execution::default();
    let mut builder = Builder::new(geometry);
    let layers = 0..geometry.size()[2] + 1;
    builder.add(labels, rule, layers, &execution, &execution.stage("", 0)).unwrap();
    builder.finish(geometry, options, border, &execution).unwrap()
}

fn patch(surface: &DualSurface) -> Patch {
    Patch {
        positions: surface.positions.iter().map(|p| p.as_vec3().to_array()).collect(),
        kinds: surface.kinds.clone(),
        triangles: surface.triangles.clone(),
        pairs: surface.pairs.clone(),
        ..Patch::default()
    }
}

fn mesh(surface: &DualSurface, materials: usize) -> InterfaceMesh {
    let material = |i: usize| MeshMaterial { id: MaterialId(i as u8), name: format!("m{i}"), mean: i as f64 };
    let DualSurface { positions, kinds, triangles, pairs, .. } = surface.clone();
    InterfaceMesh::new(positions, kinds, triangles, pairs, (0..materials).map(material).collect()).unwrap()
}

/// Components and Euler characteristic of each shell, and of each of its pieces.
fn topology(surface: &DualSurface, materials: usize) -> Vec<(u8, u64, i64, Vec<i64>)> {
    let mut shells: Vec<_> = measure(&mesh(surface, materials))
        .shells
        .iter()
        .map(|s| {
            let mut pieces: Vec<i64> = s.pieces.iter().map(|p| p.euler_characteristic).collect();
            pieces.sort_unstable();
            (s.material.0, s.components, s.euler_characteristic, pieces)
        })
        .collect();
    shells.sort();
    shells
}

const BOUNDS: [Bound; 4] = [Bound::None, Bound::Rms(0.3), Bound::Rms(0.6), Bound::Sum(f64::INFINITY)];

/// Every bound gives a sound surface with the same topology; returns the triangles of each.
fn assert_all_bounds(labels: &[u8], size: [usize; 3], seed: u64, border: Border) -> Vec<usize> {
    let (volume, ids) = LabelVolume::from_labels(labels, size).unwrap();
    let geometry = Geometry::axis_aligned(size, [1.0, 0.7, 1.6]).unwrap();
    let wild = Wild { seed, cell: [2; 3], bits: seed as u8 & 63 };
    let rule: Box<dyn HermiteRule> = if seed & 1 == 0 { Box::new(wild) } else { Box::new(Knowing(wild)) };
    let mut expected = None;
    BOUNDS
        .iter()
        .map(|&bound| {
            let surface = contour(&volume, &geometry, &*rule, bound, border);
            let what = || format!("{bound:?} {size:?} seed {seed} {border:?}");
            assert_sound(&patch(&surface), ids.len(), border, &what);
            if surface.triangles.is_empty() {
                return 0;
            }
            let defects =
                check(&mesh(&surface, ids.len()), &CheckOptions::default(), &Execution::default()).unwrap();
            assert_eq!(defects.self_intersections.count, surface.statistics.remedy.left, "{}", what());
            assert_eq!(surface.statistics.remedy.left, 0, "{} {:?}", what(), surface.statistics);
            if border == Border::Closed {
                let found = topology(&surface, ids.len());
                assert_eq!(*expected.get_or_insert_with(|| found.clone()), found, "{}", what());
            }
            surface.triangles.len()
        })
        .collect()
}

#[test]
fn all_patterns_as_leaves_are_sound_in_any_neighbourhood() {
    let geometry = Geometry::axis_aligned([4; 3], [1.0; 3]).unwrap();
    for_all_patterns(|labels, rule, what| {
        let (volume, ids) = LabelVolume::from_labels(labels, [4; 3]).unwrap();
        for bound in [Bound::None, Bound::Sum(f64::INFINITY)] {
            let surface = contour(&volume, &geometry, rule, bound, Border::Closed);
            assert_sound(&patch(&surface), ids.len(), Border::Closed, &|| format!("{what} {bound:?}"));
        }
    });
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_blocks_are_sound_at_any_bound(
        size in prop::array::uniform3(2usize..14),
        materials in 2u64..=8,
        smooth in 0usize..4,
        seed in 0u64..1 << 40,
        open in any::<bool>(),
    ) {
        let labels = lumps(size, materials, smooth, seed);
        prop_assume!(labels.iter().any(|&l| l != labels[0]));
        assert_all_bounds(&labels, size, seed, if open { Border::Open } else { Border::Closed });
    }
}

/// Balls of several materials: smooth, so that much collapses, over several roots.
fn balls(size: [usize; 3], materials: u64, seed: u64) -> Vec<u8> {
    let balls: Vec<([f64; 3], f64, u8)> = (0..9)
        .map(|i| {
            let r = |k: usize| (mix(seed, &[i, k]) % 1000) as f64 / 1000.0;
            let centre = [0, 1, 2].map(|a| r(a) * size[a] as f64);
            (centre, 4.0 + 9.0 * r(3), 1 + (mix(seed, &[i, 5]) % (materials - 1)) as u8)
        })
        .collect();
    (0..size.iter().product::<usize>())
        .map(|i| {
            let at = [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])].map(|v| v as f64);
            let inside = |(c, r, _): &&([f64; 3], f64, u8)| {
                (0..3).map(|a| (at[a] - c[a]).powi(2)).sum::<f64>() < r * r
            };
            balls.iter().rev().find(inside).map_or(0, |b| b.2)
        })
        .collect()
}

#[test]
fn smooth_bodies_keep_their_topology_across_roots() {
    let mut triangles = [0; 4];
    for seed in 0..24 {
        let size = [40, 36, 50 + seed as usize % 20];
        let labels = balls(size, 2 + seed % 4, seed);
        let border = if seed % 3 == 0 { Border::Open } else { Border::Closed };
        let of = assert_all_bounds(&labels, size, seed, border);
        triangles.iter_mut().zip(of).for_each(|(sum, n)| *sum += n);
    }
    println!("{triangles:?}");
    // Random normals allow few collapses by error; the topology alone allows most.
    assert!(triangles[3] * 4 < triangles[0], "{triangles:?}");
}

#[test]
fn merging_keeps_topology_and_soundness_and_does_not_depend_on_threads() {
    for seed in 0..8 {
        let size = [40, 44, 36 + seed as usize];
        let (labels, ids) = LabelVolume::from_labels(&balls(size, 2 + seed % 4, seed), size).unwrap();
        let geometry = Geometry::axis_aligned(size, [1.0, 0.9, 1.2]).unwrap();
        let rule = LabelHermite::new(&labels, [1.0, 0.9, 1.2]);
        let border = if seed % 3 == 0 { Border::Open } else { Border::Closed };
        let run = |merge: bool, bound: Bound, threads: usize| {
            let options = DualOptions { bound, merge, deviation: false, ..DualOptions::default() };
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| contour_as(&labels, &geometry, &rule, &options, border))
        };
        let octree = run(false, Bound::Rms(0.3), 2);
        // Its octree is the one above.
        let merged = run(true, Bound::Rms(0.6), 1);
        let what = || format!("seed {seed}");
        assert_sound(&patch(&merged), ids.len(), border, &what);
        let defects =
            check(&mesh(&merged, ids.len()), &CheckOptions::default(), &Execution::default()).unwrap();
        assert_eq!(defects.self_intersections.count + defects.alternation.count, 0, "{seed}");
        assert_eq!(topology(&octree, ids.len()), topology(&merged, ids.len()), "{seed}");
        assert_eq!(octree.statistics.merged, 0);
        let (before, after) = (octree.triangles.len(), merged.triangles.len());
        assert!(after * 10 < before * 9, "{before} triangles, {after} after merging");
        for threads in [2, 5] {
            let other = run(true, Bound::Rms(0.6), threads);
            assert_eq!(other.positions, merged.positions, "{seed}");
            assert_eq!(other.triangles, merged.triangles, "{seed}");
        }
    }
}

/// Volume enclosed by material 1, mm³.
fn volume(surface: &DualSurface) -> f64 {
    let at = |v: u32| surface.positions[v as usize];
    surface.triangles.iter().map(|t| at(t[0]).dot(at(t[1]).cross(at(t[2]))) / 6.0).sum()
}

#[test]
fn a_binary_box_keeps_its_edges_and_corners_wherever_blocks_cut_it() {
    let size = [70, 66, 40];
    let geometry = Geometry::axis_aligned(size, [1.0; 3]).unwrap();
    // Regression: with many planes of one face and few of the next in a block, the edge was taken for noise.
    for low in [4usize, 9, 15, 18, 21, 30] {
        let high = [62, 60, 36];
        let labels: Vec<u8> = (0..size.iter().product::<usize>())
            .map(|i| {
                let at = [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])];
                u8::from((0..3).all(|a| (low..high[a]).contains(&at[a])))
            })
            .collect();
        let (labels, _) = LabelVolume::from_labels(&labels, size).unwrap();
        let rule = LabelHermite::new(&labels, [1.0; 3]);
        let exact: f64 = high.iter().map(|h| (h - low) as f64).product();
        for bound in [Bound::None, Bound::Rms(0.1), Bound::Rms(0.2), Bound::Rms(0.4)] {
            let surface = contour(&labels, &geometry, &rule, bound, Border::Closed);
            let off = (volume(&surface) - exact).abs() / exact;
            assert!(off < 1e-4, "{low} {bound:?}: volume off by {off}");
            for corner in 0..8 {
                let to = [0, 1, 2].map(|a| if corner >> a & 1 == 0 { low } else { high[a] } as f64 - 0.5);
                let to = DVec3::from(to);
                let nearest = surface.positions.iter().map(|p| p.distance(to)).fold(f64::INFINITY, f64::min);
                assert!(nearest < 0.01, "{low} {bound:?}: corner {to} missed by {nearest}");
            }
        }
    }
}

/// Crossings of labels whose sigmas are known, but for every fifth; they grow along x, and are so large that no misfit shows.
struct Sure<'a>(LabelHermite<'a>);

impl CrossingRule for Sure<'_> {
    fn position(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> f32 {
        self.0.position(from, axis, labels)
    }

    fn joins_first(&self, ring: [[usize; 3]; 4], labels: [MaterialId; 2]) -> bool {
        self.0.joins_first(ring, labels)
    }

    fn has_sigmas(&self) -> bool {
        true
    }

    fn sigma(&self, [x, y, z]: [usize; 3], axis: usize, _: [MaterialId; 2]) -> f32 {
        if mix(5, &[x, y, z, axis]).is_multiple_of(5) { f32::NAN } else { 10.0 * x as f32 }
    }
}

impl HermiteRule for Sure<'_> {
    fn hermite(&self, from: [usize; 3], axis: usize, labels: [MaterialId; 2]) -> Hermite {
        self.0.hermite(from, axis, labels)
    }
}

#[test]
fn sigmas_of_vertices_are_between_those_of_their_crossings() {
    let (size, spacing) = ([40, 20, 20], [0.2, 0.1, 0.1]);
    let geometry = Geometry::axis_aligned(size, spacing).unwrap();
    let labels: Vec<u8> = (0..40 * 20 * 20usize)
        .map(|i| {
            let [x, y, z] = [i % 40, i / 40 % 20, i / 800].map(|c| c as f64);
            let inside = (y - 9.5).hypot(z - 9.7) < 6.0 && (4.0..36.0).contains(&x);
            if inside { 1 + u8::from(x + 0.3 * y > 22.0) } else { 0 }
        })
        .collect();
    let (volume, _) = LabelVolume::from_labels(&labels, size).unwrap();
    let edge = spacing.iter().product::<f64>().cbrt();
    for bound in [Bound::None, Bound::Rms(0.5)] {
        let rule = Sure(LabelHermite::new(&volume, spacing));
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| contour(&volume, &geometry, &rule, bound, Border::Closed))
        };
        let (surface, again) = (run(1), run(3));
        let bits = |s: &DualSurface| s.sigmas.iter().map(|s| s.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&surface), bits(&again));
        assert_eq!(surface.sigmas.len(), surface.positions.len());
        // A vertex without simplification stands for the crossings of its cell; merged ones go farther.
        let reach = if bound == Bound::None { 1.6 } else { 16.0 };
        let mut known = 0;
        for (sigma, at) in surface.sigmas.iter().zip(&surface.positions) {
            if !sigma.is_nan() {
                known += 1;
                let x = f64::from(*sigma) / edge / 10.0 - 1.0;
                assert!((x - at.x / spacing[0]).abs() < reach, "{x} {at}");
            }
        }
        assert!(20 * known > 19 * surface.sigmas.len(), "{known}");
        let mesh = InterfaceMesh::from_dual(surface.clone(), mesh(&surface, 3).materials().to_vec()).unwrap();
        assert_eq!(mesh.sigmas().map(<[f32]>::len), Some(surface.sigmas.len()));
        let pairs = measure(&mesh).pairs;
        assert!(pairs.iter().all(|p| p.sigma.is_some_and(|s| s.median > 0.0 && s.median <= s.percent_95)));
        let unsure = contour(&volume, &geometry, &rule.0, bound, Border::Closed);
        assert!(unsure.sigmas.is_empty() && unsure.positions == surface.positions);
    }
}
