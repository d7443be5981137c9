//! Normals of crossings on phantoms with exact geometry.

#![allow(clippy::unwrap_used, clippy::float_cmp)] // tests; some normals and weights are exact

mod normals;

use glam::Vec3;
use interfacet::classify::LabelVolume;
use interfacet::contour::hermite::{GreyHermite, HALO, LabelHermite, PairQuality, Qualities};
use interfacet::contour::{HermiteRule, Level, NormalRule};
use interfacet::phantom::SceneName;
use interfacet::volume::Slab;
use normals::{Found, Scan, crossings, options, statistics};
use proptest::prelude::*;

const RULES: [NormalRule; 4] =
    [NormalRule::Gradient, NormalRule::Smoothed, NormalRule::Sided, NormalRule::Auto];

fn hermite(rule: &impl HermiteRule, labels: &LabelVolume, from: [usize; 3], axis: usize) -> (Vec3, f32) {
    let mut to = from;
    to[axis] += 1;
    let h = rule.hermite(from, axis, [labels.at(from), labels.at(to)]);
    (h.normal, h.weight)
}

/// Samples by voxel, x fastest.
fn samples<T>(size: [usize; 3], of: impl Fn([usize; 3]) -> T) -> Vec<T> {
    let [nx, ny, nz] = size;
    (0..nx * ny * nz).map(|i| of([i % nx, i / nx % ny, i / nx / ny])).collect()
}

/// Box in a box, one of its faces flush with the outer one's.
fn boxes([x, y, z]: [usize; 3]) -> u8 {
    let outer = (6..26).contains(&x) && (7..23).contains(&y) && (5..19).contains(&z);
    let inner = (11..21).contains(&x) && (11..18).contains(&y) && (12..19).contains(&z);
    u8::from(outer) + u8::from(inner)
}

#[test]
fn crossings_of_axis_aligned_boxes_have_the_axis_as_normal_also_beside_edges_corners_and_junctions() {
    let size = [32, 30, 24];
    let (labels, _) = LabelVolume::from_labels(&samples(size, boxes), size).unwrap();
    let rule = LabelHermite::new(&labels, [1.0, 0.7, 1.9]);
    for (from, axis) in crossings(&labels) {
        assert_eq!(hermite(&rule, &labels, from, axis), (Vec3::AXES[axis], 1.0), "{from:?} {axis}");
    }
    let grey = samples(size, |p| if boxes(p) > 0 { 255u8 } else { 0 });
    let slab = Slab::whole(&grey, size);
    let labels = LabelVolume::from_threshold(slab, 127.5);
    let qualities = Qualities::alike(2, PairQuality::default());
    for (normals, error) in [(NormalRule::Sided, 0.0), (NormalRule::Auto, 1e-5)] {
        let level = Level::new(slab, 127.5);
        let rule = GreyHermite::new(level, slab, &labels, [1.0; 3], normals, &qualities);
        for (from, axis) in crossings(&labels) {
            let (normal, weight) = hermite(&rule, &labels, from, axis);
            assert!(normal.distance(Vec3::AXES[axis]) <= error && weight > 0.99, "{from:?} {axis} {normal}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    /// Planes through linear fields, any spacing: exact but for the margin of crossings, for gradients also
    /// at the volume's border.
    #[test]
    fn planes_have_their_normals(n in prop::array::uniform3(-1.0f32..1.0), spacing in prop::array::uniform3(0.5f64..2.0), level in -0.5f32..0.5) {
        prop_assume!(Vec3::from(n).length() > 0.3);
        check_plane(Vec3::from(n).normalize(), spacing, level);
    }
}

/// Which of a lattice point's edges meet a plane that passes it more nearly than the margin of crossings is not told;
/// one of the axes shows too little of it.
#[test]
fn planes_through_lattice_points_have_their_normals() {
    for level in [-4e-3, -1e-3, -1e-4, 0.0, 1e-4, 1e-3, 4e-3] {
        check_plane(Vec3::new(0.011, -0.39, 0.96).normalize(), [1.12, 0.5, 1.81], level);
    }
}

/// Every rule's normals of the plane where a linear field has a level.
fn check_plane(n: Vec3, spacing: [f64; 3], level: f32) {
    let (size, edge) = ([13; 3], spacing.map(|s| s as f32));
    let grey = samples(size, |p| (0..3).map(|a| n[a] * edge[a] * (p[a] as f32 - 6.0)).sum::<f32>());
    let slab = Slab::whole(&grey, size);
    let labels = LabelVolume::from_threshold(slab, level);
    let qualities = Qualities::alike(2, PairQuality::default());
    let (exact, near) = ((1e-4, 0), (0.01, 3));
    for (normals, (error, margin)) in RULES.into_iter().zip([exact, exact, near, near]) {
        let rule = GreyHermite::new(Level::new(slab, level), slab, &labels, spacing, normals, &qualities);
        for (from, axis) in crossings(&labels) {
            if from.iter().any(|&k| k <= margin || k + margin > 13) {
                continue;
            }
            let mut to = from;
            to[axis] += 1;
            let sign = if labels.at(from) < labels.at(to) { 1.0 } else { -1.0 };
            let (found, _) = hermite(&rule, &labels, from, axis);
            assert!(
                found.distance(sign * n) < error,
                "{normals:?} {from:?} {axis}: {found}, not {n} (spacing {spacing:?}, level {level})"
            );
        }
    }
}

#[test]
fn nothing_beyond_the_halo_is_looked_at() {
    let size = [20, 19, 24];
    // Wild enough for every kind of neighbourhood.
    let grey = samples(size, |[x, y, z]| {
        let [x, y, z] = [x, y, z].map(|k| k as f32);
        (0.4 * x).sin()
            + (0.5 * y + 0.1 * x).cos()
            + (0.45 * z - 0.2 * y).sin()
            + 0.2 * (9.7 * x * y + z * z).sin()
    });
    let whole = Slab::whole(&grey, size);
    let labels = LabelVolume::from_threshold(whole, 0.1);
    let qualities = Qualities::alike(2, PairQuality::default());
    let z = 10;
    // Padded slices z and z + 1 have the edges asked for.
    let held = z - HALO..z + 2 + HALO;
    let slice = size[0] * size[1];
    let part = Slab::new(&grey[(held.start - 1) * slice..(held.end - 1) * slice], size, held.start - 1);
    let few = labels.window(held);
    let mut n = 0;
    for normals in RULES {
        let all = GreyHermite::new(Level::new(whole, 0.1), whole, &labels, [1.0; 3], normals, &qualities);
        let some = GreyHermite::new(Level::new(part, 0.1), part, &few, [1.0; 3], normals, &qualities);
        for (from, axis) in crossings(&labels) {
            if from[2] == z {
                assert_eq!(hermite(&all, &labels, from, axis), hermite(&some, &few, from, axis));
                n += 1;
            }
        }
    }
    assert!(n > 400, "{n}");
}

fn mean(found: &[Found], of: impl Fn(&Found) -> bool) -> f64 {
    statistics(found.iter().filter(|f| of(f)).map(|f| f.degrees).collect())[0]
}

/// `docs/hermite.md` has the figures; the limits here are about a third above them.
#[test]
fn sharp_tilted_steps_keep_the_normals_of_both_faces() {
    let scan = Scan::new(&options(SceneName::Steps, 64, 0.0, 0.0));
    let (auto, smoothed) = (scan.grey(NormalRule::Auto), scan.grey(NormalRule::Smoothed));
    let beside = |f: &Found| f.edge > 0.5 && f.edge <= 1.5;
    assert!(mean(&auto, |f| f.edge > 4.0) < 0.9);
    assert!(mean(&auto, |f| f.edge > 1.5 && f.edge <= 4.0) < 1.9);
    assert!(mean(&auto, beside) < 7.5 && mean(&smoothed, beside) > 15.0);
}

#[test]
fn noise_does_not_spoil_normals_of_a_sphere_and_labels_alone_tell_them() {
    let scan = Scan::new(&options(SceneName::Sphere, 64, 1.15, 6.0));
    assert!(mean(&scan.grey(NormalRule::Auto), |_| true) < 2.6);
    assert!(mean(&scan.grey(NormalRule::Gradient), |_| true) > 6.0);
    let labels = Scan::new(&options(SceneName::Sphere, 64, 0.0, 0.0)).segmented().by_labels();
    assert!(mean(&labels, |_| true) < 1.9 && labels.iter().all(|f| f.degrees < 16.0));
}

#[test]
fn crossings_near_a_third_material_count_little_and_keep_their_face() {
    let found = Scan::new(&options(SceneName::CubeInCube, 64, 0.0, 0.0)).grey(NormalRule::Auto);
    let far = |f: &Found| f.junction > 6.0;
    assert!(found.iter().any(|f| f.weight < 1.0) && found.iter().any(|f| f.weight == 1.0 && far(f)));
    assert!(mean(&found, |f| f.junction > 1.5 && f.junction <= 4.0 && f.edge > 4.0) < 2.0);
}
