//! The truth against brute force.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::*;
use crate::grid::MaterialId;

pub(super) fn options(scene: SceneName, size: usize) -> PhantomOptions {
    // Pores have their size in voxels and need room.
    let size = if scene == SceneName::Pores { size.max(48) } else { size };
    PhantomOptions { scene, size: [size; 3], ..PhantomOptions::default() }
}

pub(super) fn phantom(scene: SceneName, size: usize) -> Phantom {
    Phantom::new(&options(scene, size)).unwrap()
}

/// Random points in a ball's box.
fn points(ball: (DVec3, f64), n: usize, seed: u64) -> Vec<DVec3> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut unit = || (rng.next_u64() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0;
    (0..n).map(|_| ball.0 + ball.1 * DVec3::new(unit(), unit(), unit())).collect()
}

#[test]
fn closest_points_lie_between_the_pairs_materials_and_beat_dense_samples() {
    for scene in SceneName::ALL {
        let truth = phantom(scene, 64).truth().clone();
        assert!(!truth.pairs().is_empty());
        let step = 0.5;
        let samples = truth.all_samples(step);
        let probes = points((DVec3::ZERO, 1.0), 60, 5);
        for &pair in truth.pairs() {
            let own: Vec<DVec3> = samples.iter().filter(|s| s.0 == pair).map(|s| s.1).collect();
            let mut last: Option<(DVec3, f64)> = None;
            for q in points(truth.ball(), 100, 3) {
                let closest = truth.closest(pair, q).unwrap();
                assert!(((q - closest.point).length() - closest.distance).abs() < 1e-9);
                // Both materials occur in any small ball around the closest point.
                let around: Vec<MaterialId> =
                    probes.iter().map(|p| truth.material_at(closest.point + 1e-4 * *p)).collect();
                assert!(
                    around.contains(&pair.back()) && around.contains(&pair.front()),
                    "{scene:?} {pair:?}"
                );
                let dense = own.iter().map(|p| (*p - q).length()).fold(f64::INFINITY, f64::min);
                assert!(closest.distance <= dense + 1e-9, "{scene:?} {pair:?} {} {dense}", closest.distance);
                assert!(
                    dense <= closest.distance + 1.5 * step,
                    "{scene:?} {pair:?} {} {dense}",
                    closest.distance
                );
                // A point of one of the two materials is on that material's side.
                let here = truth.material_at(q);
                if here == pair.front() && closest.distance > 1e-6 && truth.closest_junction(q).is_none() {
                    assert!(closest.in_front);
                }
                if let Some((other, distance)) = last {
                    assert!((distance - closest.distance).abs() <= (q - other).length() + 1e-9);
                }
                last = Some((q, closest.distance));
            }
            assert!(truth.closest(pair, own[0]).unwrap().distance < 1e-9);
        }
    }
}

#[test]
fn a_small_step_off_an_interface_is_on_the_stated_side_at_the_stated_distance() {
    for scene in SceneName::ALL {
        let truth = phantom(scene, 64).truth().clone();
        for (pair, p, _) in truth.all_samples(3.0) {
            for (k, direction) in points((DVec3::ZERO, 1.0), 6, 9).into_iter().enumerate() {
                let q = p + 0.02 * direction;
                let found = truth.closest(pair, q).unwrap();
                let here = truth.material_at(q);
                assert!(found.distance <= 0.02 * direction.length() + 1e-12);
                if pair.contains(here) && found.distance > 1e-9 {
                    assert_eq!(found.in_front, here == pair.front(), "{scene:?} {pair:?} {k}");
                }
            }
        }
    }
}

#[test]
fn exact_volumes_agree_with_quadrature_along_lines() {
    for scene in SceneName::ALL {
        let truth = phantom(scene, 64).truth().clone();
        let (centre, radius) = truth.ball();
        let along = DVec3::new(0.3, 0.5, 0.81).normalize();
        let (u, v) = along.any_orthonormal_pair();
        let n = 400;
        let width = 2.0 * radius / f64::from(n);
        let mut sums = vec![0.0; truth.topology().len()];
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let offset = |k: i32| (f64::from(k) + 0.5) * width - radius;
            let p = centre + offset(i) * u + offset(j) * v;
            let mut cuts: Vec<f64> = truth
                .scene()
                .surfaces()
                .iter()
                .flat_map(|s| s.crossings(p, along))
                .flatten()
                .filter(|t| t.abs() < radius)
                .collect();
            cuts.extend([-radius, radius]);
            cuts.sort_by(f64::total_cmp);
            for w in cuts.windows(2) {
                let material = truth.material_at(p + 0.5 * (w[0] + w[1]) * along);
                sums[usize::from(material.0)] += (w[1] - w[0]) * width * width;
            }
        }
        for (id, sum) in sums.iter().enumerate().skip(1) {
            let exact = truth.volume(MaterialId(id as u8)).unwrap();
            assert!((sum / exact - 1.0).abs() < 5e-4, "{scene:?} {id}: {sum} {exact}");
        }
    }
}

#[test]
fn junction_curves_have_three_materials_around_and_points_four() {
    for scene in SceneName::ALL {
        let truth = phantom(scene, 64).truth().clone();
        let has = scene.materials().len() > 2 && scene != SceneName::Pores;
        assert_eq!(truth.junctions().count() > 0, has, "{scene:?}");
        let probes = points((DVec3::ZERO, 1.0), 200, 5);
        for piece in truth.junctions() {
            assert_eq!(piece.materials.len(), 3, "{scene:?}");
            for (p, _) in piece.curve.samples(piece.low, piece.high, 2.0) {
                let mut around: Vec<_> = probes.iter().map(|d| truth.material_at(p + 1e-4 * *d)).collect();
                around.sort_unstable();
                around.dedup();
                assert_eq!(around, piece.materials, "{scene:?}");
                assert!(truth.closest_junction(p).unwrap().1 < 1e-9);
            }
        }
        // The middle, and where the plane between the two sectors ends at the rim.
        assert_eq!(truth.junction_points().len(), if scene == SceneName::FourMaterials { 2 } else { 0 });
    }
    let ring = phantom(SceneName::PressFitRing, 64);
    let circle = ring.truth().junctions().next().unwrap().length();
    assert!((ring.truth().junction_length() - 2.0 * circle).abs() < 1e-6);
}

#[test]
fn a_truth_file_restores_the_phantom_and_bad_options_are_refused_by_name() {
    let phantom = phantom(SceneName::FourMaterials, 32);
    let text = Sidecar::new(&phantom).to_json().unwrap();
    let read = Sidecar::from_json(&text).unwrap();
    assert_eq!(&read.options, phantom.options());
    assert_eq!(read.materials.len(), 4);
    let later = text.replace("\"version\": 1", "\"version\": 9");
    assert!(matches!(Sidecar::from_json(&later), Err(PhantomError::Version { version: 9, .. })));
    let refused = |change: fn(&mut PhantomOptions)| {
        let mut options = PhantomOptions { scene: SceneName::ThinGap, ..PhantomOptions::default() };
        change(&mut options);
        Phantom::new(&options).unwrap_err().to_string()
    };
    assert!(refused(|o| o.thickness = 1e3).contains("thickness"));
    assert!(refused(|o| o.fill = 0.0).contains("fill"));
    assert!(refused(|o| o.sigma = f64::NAN).contains("sigma"));
    assert!(refused(|o| o.greys = Some(vec![1.0])).contains("air, aluminium"));
    assert!(refused(|o| o.size = [0; 3]).contains("size"));
    assert!(SceneName::from_name("ball").is_err());
}

#[test]
fn wedges_kinks_and_radii_of_curves_are_those_of_the_solids() {
    let range = |scene: SceneName| {
        let phantom = phantom(scene, 64);
        let truth = phantom.truth();
        let mut found = (f64::INFINITY, f64::NEG_INFINITY);
        for piece in truth.junctions() {
            for k in 0..40 {
                let t = piece.low + (piece.high - piece.low) * (f64::from(k) + 0.5) / 40.0;
                let wedge = truth.smallest_wedge(piece, t);
                found = (found.0.min(wedge), found.1.max(wedge));
            }
        }
        for edge in truth.edges().filter(|_| scene != SceneName::BoltInPlate) {
            let wedge = truth.smallest_wedge(edge, 0.4 * edge.low + 0.6 * edge.high);
            assert!((wedge - 90.0).abs() < 1e-6, "{scene:?} {wedge}");
        }
        (found, truth.junction_kinks().len())
    };
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 0.5, "{found} {expected}");
    let ((low, high), kinks) = range(SceneName::PressFitRing);
    near(low, 90.0);
    near(high, 90.0);
    assert_eq!(kinks, 0, "circles have no ends");
    let ((low, high), kinks) = range(SceneName::CubeInCube);
    near(low, 70.5);
    assert!(high < 90.0);
    assert_eq!(kinks, 4);
    let ((low, high), _) = range(SceneName::SphereOnCylinder);
    near(low, 77.0);
    near(high, 77.0);
    // Six straight pieces in a ring; where four materials meet is no kink.
    assert_eq!(range(SceneName::FlushCubes).1, 6);
    let wedge = |angle: f64| {
        let options = PhantomOptions { angle, ..options(SceneName::Wedge, 64) };
        let phantom = Phantom::new(&options).unwrap();
        let truth = phantom.truth();
        assert_eq!(truth.junction_kinks().len(), 4);
        truth
            .junctions()
            .map(|piece| (truth.smallest_wedge(piece, 0.5 * (piece.low + piece.high)), piece.length()))
            .fold([0.0; 2], |[inclined, upright], (found, length)| {
                if (found - 90.0).abs() < 1e-6 {
                    [inclined, upright + length]
                } else {
                    assert!((found - angle.min(180.0 - angle)).abs() < 1e-6, "{found} for {angle}");
                    [inclined + length, upright]
                }
            })
    };
    for angle in [15.0, 30.0, 60.0, 120.0, 135.0] {
        let [inclined, upright] = wedge(angle);
        assert!((inclined / upright - 1.6 / 1.4).abs() < 1e-9, "{angle}");
    }
    let four = phantom(SceneName::FourMaterials, 64);
    let truth = four.truth();
    for kink in truth.junction_kinks() {
        assert!(truth.junction_points().iter().all(|p| p.distance(*kink) > 1.0));
    }
    let (centre, a, b) = (DVec3::ONE, 2.0 * DVec3::X, 3.0 * DVec3::Y);
    let curve = Curve::Ellipse { centre, a, b };
    // b^2 / a and a^2 / b at the ends of the half axes.
    assert!((curve.radius(0.0) - 4.5).abs() < 1e-12);
    assert!((curve.radius(std::f64::consts::FRAC_PI_2) - 4.0 / 3.0).abs() < 1e-12);
}

#[test]
fn sharp_edges_and_corners_are_those_of_the_solids() {
    // Corners, length of sharp edges in units of the object's scale.
    let expected = |scene: SceneName, corners: usize, length: f64, unit: f64| {
        let phantom = phantom(scene, 64);
        let truth = phantom.truth();
        assert_eq!(truth.corners().len(), corners, "{scene:?}");
        let scale = (truth.volume(MaterialId(1)).unwrap() / unit).cbrt();
        assert!(
            (truth.edge_length() / scale - length).abs() < 1e-6,
            "{scene:?} {}",
            truth.edge_length() / scale
        );
        let probes = points((DVec3::ZERO, 1.0), 200, 5);
        for edge in truth.edges() {
            let pair = edge.edge_pair().unwrap();
            for (p, _) in edge.curve.samples(edge.low, edge.high, 2.0) {
                assert!(truth.closest(pair, p).unwrap().distance < 1e-9);
                let around = probes.iter().map(|d| truth.material_at(p + 1e-4 * *d));
                assert!({ around }.all(|m| pair.contains(m)), "{scene:?}");
            }
        }
    };
    expected(SceneName::Cube, 8, 24.0, 8.0);
    // The outer cube's corners, three where the ring of junctions passes over its edges, and the inner
    // cube's: one inside, three on the faces.
    expected(SceneName::FlushCubes, 8 + 3 + 1 + 3, 24.0 + 3.0 * 1.1, 8.0 - 1.1_f64.powi(3));
    let flush = phantom(SceneName::FlushCubes, 64);
    let truth = flush.truth();
    let scale = (truth.volume(MaterialId(2)).unwrap()).cbrt() / 1.1;
    assert!((truth.junction_length() / scale - 6.0 * 1.1).abs() < 1e-9);
    assert!(phantom(SceneName::Sphere, 32).truth().corners().is_empty());
    // Circles are edges without ends.
    assert_eq!(phantom(SceneName::PressFitRing, 64).truth().corners().len(), 8);
}

#[test]
fn rounded_edges_are_seams_and_no_sharp_edges_at_every_radius() {
    for radius in [1.0, 2.5, 6.0] {
        let made = PhantomOptions { fillet: radius, spacing: [0.5; 3], ..options(SceneName::Fillet, 64) };
        let phantom = Phantom::new(&made).unwrap();
        let truth = phantom.truth();
        let seams: Vec<&CurvePiece> = truth.curves().iter().filter(|piece| piece.is_smooth).collect();
        assert_eq!(seams.len(), 8, "two at each rounded edge");
        let height = seams[0].length();
        assert!(seams.iter().all(|seam| (seam.length() - height).abs() < 1e-9 && seam.edge_pair().is_none()));
        // Top and bottom keep their sharp edges, without corners: straight pieces and quarters of circles.
        assert!(truth.corners().is_empty());
        let scale = height / 1.8;
        let r = 0.5 * radius;
        let around = 4.0 * (1.85 * scale - 2.0 * r) + std::f64::consts::TAU * r;
        assert!((truth.edge_length() - 2.0 * around).abs() < 1e-6, "{radius}");
        assert!(truth.edges().all(|e| (truth.smallest_wedge(e, 0.5 * (e.low + e.high)) - 90.0).abs() < 1e-4));
        // Half-way up a rounded edge the surface is r (sqrt 2 - 1) from where the sharp one would be.
        let (pair, turn) = (truth.pairs()[0], surface::rotation(phantom.options().rotation));
        let edge = truth.ball().0 + turn * (scale * DVec3::new(1.0, 0.85, 0.0));
        let found = truth.closest(pair, edge).unwrap();
        assert!((found.distance - r * (2.0_f64.sqrt() - 1.0)).abs() < 1e-9 && found.in_front);
    }
    let too_large = PhantomOptions { fillet: 30.0, ..options(SceneName::Fillet, 64) };
    assert!(Phantom::new(&too_large).unwrap_err().to_string().contains("fillet"));
}

#[test]
fn pores_have_the_radii_in_voxels_at_every_size_and_need_room() {
    for (size, spacing) in [(48, 1.0), (96, 0.25)] {
        let made = PhantomOptions { spacing: [spacing; 3], ..options(SceneName::Pores, size) };
        let phantom = Phantom::new(&made).unwrap();
        let radii: Vec<f64> = phantom
            .truth()
            .scene()
            .surfaces()
            .iter()
            .filter_map(
                |s| if let Surface::Sphere { radius, .. } = s { Some(radius / spacing) } else { None },
            )
            .collect();
        assert_eq!(radii.len(), 6);
        for (found, expected) in radii.iter().zip([2.0, 2.0, 3.0, 3.0, 4.0, 4.0]) {
            assert!((found - expected).abs() < 1e-9);
        }
    }
    let small = PhantomOptions { scene: SceneName::Pores, size: [40; 3], ..PhantomOptions::default() };
    assert!(Phantom::new(&small).unwrap_err().to_string().contains("size"));
    let flat = PhantomOptions { angle: 10.0, ..PhantomOptions::default() };
    assert!(Phantom::new(&flat).unwrap_err().to_string().contains("angle"));
}
