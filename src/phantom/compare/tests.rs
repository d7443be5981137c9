//! The comparison on meshes with known errors.

use glam::DVec3;

use super::*;
use crate::grid::{MaterialId, Pair};
use crate::mesh::{MeshMaterial, kinds_from_labels};
use crate::phantom::{PhantomOptions, SceneName};

fn phantom(scene: SceneName, spacing: f64) -> Phantom {
    let options = PhantomOptions { scene, size: [48; 3], spacing: [spacing; 3], ..PhantomOptions::default() };
    Phantom::new(&options).unwrap()
}

fn mesh_of(
    phantom: &Phantom,
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    pairs: Vec<Pair>,
) -> InterfaceMesh {
    let kinds = kinds_from_labels(positions.len(), &triangles, &pairs);
    let materials = phantom
        .materials()
        .materials()
        .iter()
        .map(|m| MeshMaterial { id: m.id, name: m.name.clone(), mean: m.mean })
        .collect();
    InterfaceMesh::new(positions, kinds, triangles, pairs, materials).unwrap()
}

fn pair(a: u8, b: u8) -> Pair {
    Pair::new(MaterialId(a), MaterialId(b)).unwrap()
}

/// A globe of `n` rings, wound counter-clockwise seen from outside.
fn globe(centre: DVec3, radius: f64, n: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    use std::f64::consts::{PI, TAU};
    let around = 2 * n;
    let mut positions = vec![centre - DVec3::Z * radius];
    for i in 1..n {
        let latitude = PI * f64::from(i) / f64::from(n) - PI / 2.0;
        for k in 0..around {
            let longitude = TAU * f64::from(k) / f64::from(around);
            let ring = latitude.cos();
            let p = DVec3::new(ring * longitude.cos(), ring * longitude.sin(), latitude.sin());
            positions.push(centre + p * radius);
        }
    }
    positions.push(centre + DVec3::Z * radius);
    let at = |i: u32, k: u32| 1 + (i - 1) * around + k % around;
    let last = positions.len() as u32 - 1;
    let mut triangles = Vec::new();
    for k in 0..around {
        triangles.push([0, at(1, k + 1), at(1, k)]);
        triangles.push([last, at(n - 1, k), at(n - 1, k + 1)]);
        for i in 1..n - 1 {
            triangles.push([at(i, k), at(i, k + 1), at(i + 1, k + 1)]);
            triangles.push([at(i, k), at(i + 1, k + 1), at(i + 1, k)]);
        }
    }
    (positions, triangles)
}

#[test]
fn a_globe_too_large_by_a_known_amount_is_measured_so_both_ways() {
    let phantom = phantom(SceneName::Sphere, 0.5);
    let (centre, radius) = phantom.truth().ball();
    for offset in [0.1, -0.05] {
        let (positions, triangles) = globe(centre, radius + offset, 120);
        let pairs = vec![pair(1, 0); triangles.len()];
        let mesh = mesh_of(&phantom, positions, triangles, pairs);
        let found =
            compare(&mesh, &phantom, None, &CompareOptions::default(), &Execution::default()).unwrap();
        assert_eq!(found.pairs.len(), 1);
        for split in [found.pairs[0].mesh_to_truth, found.pairs[0].truth_to_mesh] {
            let all = split.all.unwrap();
            // Chords of the globe lie up to r (π/240)² / 2 inside.
            assert!((all.mm.signed_mean - offset).abs() < 2e-3, "{} {offset}", all.mm.signed_mean);
            assert!((all.voxels.rms - 2.0 * offset.abs()).abs() < 4e-3);
            assert!((all.mm.max - offset.abs()).abs() < 4e-3);
            assert!(split.wide.near_junction.is_none() && split.wide.near_edge.is_none());
            assert_eq!(split.wide.clear, split.wide.off_junctions);
            assert!(split.wide.clear.is_some());
            assert_eq!(split.close, split.wide, "without curves no distance matters");
        }
        let material = &found.materials[1];
        let growth = 100.0 * ((1.0 + offset / radius).powi(3) - 1.0);
        assert!((material.volume_error_percent.unwrap() - growth).abs() < 0.1);
        assert_eq!(material.topology, material.expected);
        assert_eq!(found.materials[0].topology, found.materials[0].expected);
        assert_eq!(found.false_triangles, FalseTriangles::default());
        assert!(found.junctions.is_none());
        assert!(found.vertex_errors.iter().all(|e| (e - offset).abs() < 1e-9));
        let json = serde_json::to_string(&found).unwrap();
        assert!(serde_json::from_str::<Comparison>(&json).is_ok());
    }
}

#[test]
fn a_globe_elsewhere_is_false_and_a_missing_interface_is_seen_from_the_truth() {
    let phantom = phantom(SceneName::SphereOnCylinder, 1.0);
    let (centre, _) = phantom.truth().ball();
    // An iron/air ball far outside of the object, and an aluminium/air one inside of it.
    let (mut positions, mut triangles) = globe(centre + DVec3::new(-30.0, 0.0, 0.0), 2.0, 8);
    let mut pairs = vec![pair(2, 0); triangles.len()];
    let count = triangles.len();
    let (more, their) = globe(centre, 1.0, 8);
    let base = positions.len() as u32;
    positions.extend(more);
    triangles.extend(their.iter().map(|t| t.map(|v| v + base)));
    pairs.extend(vec![pair(1, 0); their.len()]);
    let mesh = mesh_of(&phantom, positions, triangles, pairs);
    let found = compare(&mesh, &phantom, None, &CompareOptions::default(), &Execution::default()).unwrap();
    let tally = found.false_triangles;
    assert!(tally.near.triangles + tally.clear.triangles >= count);
    assert_eq!(tally.wrong_pair, Tally::default());
    let missing = found.pairs.iter().find(|p| (p.back, p.front) == (2, 1)).unwrap();
    assert!(missing.in_truth && missing.triangles == 0);
    assert!(missing.truth_to_mesh.all.is_none() && missing.mesh_to_truth.all.is_none());
    assert!(missing.truth_area > 0.0);
    let junctions = found.junctions.unwrap();
    assert!(junctions.all.mesh_to_truth.is_none() && junctions.truth_length > 0.0);
}

#[test]
fn a_fan_on_a_true_junction_circle_has_a_junction_distance_of_the_chords_only() {
    let phantom = phantom(SceneName::SphereOnCylinder, 1.0);
    let truth = phantom.truth();
    let piece = truth.junctions().next().unwrap();
    let n: u32 = 400;
    let mut positions = vec![truth.ball().0];
    let (mut triangles, mut pairs) = (Vec::new(), Vec::new());
    for k in 0..n {
        positions.push(piece.curve.at(piece.low + (piece.high - piece.low) * f64::from(k) / f64::from(n)));
        // Three sheets through the same edge: only the edge itself counts here.
        for own in [pair(2, 0), pair(2, 1), pair(1, 0)] {
            triangles.push([0, k + 1, (k + 1) % n + 1]);
            pairs.push(own);
        }
    }
    let mesh = mesh_of(&phantom, positions, triangles, pairs);
    let rim: Vec<[u32; 2]> = junctions::edges(&mesh).junction.into_iter().filter(|e| e[0] > 0).collect();
    assert_eq!(rim.len(), n as usize);
    let found = compare(&mesh, &phantom, None, &CompareOptions::default(), &Execution::default()).unwrap();
    let junctions = found.junctions.unwrap();
    assert!(junctions.all.truth_to_mesh.unwrap().mm.max < 2e-3);
    assert!(junctions.all.mesh_to_truth.unwrap().mm.max > 1.0, "the spokes are not on the circle");
}

/// The faces between lattice cubes of different materials: rough, but with the right topology.
fn blocks(phantom: &Phantom) -> InterfaceMesh {
    let n = 48_u32;
    let spacing = phantom.geometry().voxel_edge();
    let at = |i: [u32; 3]| phantom.truth().material_at(spacing * DVec3::from(i.map(f64::from)));
    let id = |i: [u32; 3]| (i[2] * (n + 1) + i[1]) * (n + 1) + i[0];
    let mut index = std::collections::BTreeMap::new();
    let (mut positions, mut triangles, mut pairs) = (Vec::new(), Vec::new(), Vec::new());
    for (axis, i) in (0..3).flat_map(|a| (0..n.pow(3)).map(move |i| (a, [i % n, i / n % n, i / n / n]))) {
        let mut next = i;
        next[axis] += 1;
        if next[axis] == n {
            continue;
        }
        let Some(pair) = Pair::new(at(i), at(next)) else { continue };
        // The cube of voxel i reaches from corner i to corner i + 1.
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut ring = [next; 4];
        ring[1][u] += 1;
        ring[2][u] += 1;
        ring[2][v] += 1;
        ring[3][v] += 1;
        if pair.back() != at(i) {
            ring.reverse();
        }
        let corners = ring.map(|c| {
            *index.entry(id(c)).or_insert_with(|| {
                positions.push(spacing * (DVec3::from(c.map(f64::from)) - 0.5));
                positions.len() as u32 - 1
            })
        });
        triangles.extend([[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]]);
        pairs.extend([pair; 2]);
    }
    mesh_of(phantom, positions, triangles, pairs)
}

#[test]
fn the_blocks_of_every_scene_have_its_topology_volumes_and_junctions() {
    for scene in SceneName::ALL {
        let phantom = phantom(scene, 1.0);
        let mesh = blocks(&phantom);
        let options = CompareOptions { step: 1.0, ..CompareOptions::default() };
        let found = compare(&mesh, &phantom, None, &options, &Execution::default()).unwrap();
        for material in &found.materials {
            assert_eq!(material.topology, material.expected, "{scene:?} {}", material.name);
            if let Some(error) = material.volume_error_percent {
                // A ball of two voxels' radius has 33 of them: counting them is no measure of its volume.
                let limit = if scene == SceneName::Pores && material.id == 2 { 6.0 } else { 2.0 };
                assert!(error.abs() < limit, "{scene:?} {} {error}", material.name);
            }
        }
        for pair in &found.pairs {
            assert!(pair.in_truth && pair.triangles > 0, "{scene:?} {pair:?}");
            for split in [pair.mesh_to_truth, pair.truth_to_mesh] {
                let all = split.all.unwrap();
                assert!(all.voxels.max < 1.5 && all.voxels.rms < 0.5, "{scene:?} {pair:?}");
                assert!(all.voxels.signed_mean.abs() < 0.1, "{scene:?} {pair:?}");
            }
        }
        if let Some(junctions) = &found.junctions
            && scene.materials().len() > 2
            && scene != SceneName::Pores
        {
            assert!(junctions.all.mesh_to_truth.unwrap().voxels.rms < 1.0, "{scene:?} {junctions:?}");
            assert!(junctions.all.truth_to_mesh.unwrap().voxels.max < 2.0, "{scene:?} {junctions:?}");
        }
        assert_eq!(found.false_triangles, FalseTriangles::default());
        if let Some(junctions) = &found.junctions {
            assert_eq!(junctions.points.truth, phantom.truth().junction_points().len());
            for points in [junctions.points, junctions.kinks] {
                assert_eq!(points.missed, 0, "{scene:?} {points:?}");
                assert!(points.distances.is_none_or(|d| d.voxels.max < 1.8), "{scene:?} {points:?}");
            }
            // Three materials make no junction point, so a curve's vertex stands for each kink.
            assert_eq!(junctions.kinks.by_curve, junctions.kinks.truth, "{scene:?}");
        }
        if let Some(thin) = found.thickness {
            assert!(thin.present_percent > 99.0 && thin.error.unwrap().voxels.signed_mean.abs() < 0.2);
        }
        assert_eq!(
            found.spheres.len(),
            [0, 1, 6][usize::from(scene == SceneName::Sphere) + 2 * usize::from(scene == SceneName::Pores)]
        );
        for sphere in &found.spheres {
            let fit = sphere.fit.unwrap();
            assert!(
                sphere.parts == 1 && fit.radius_error.abs() < 0.3 && fit.centre_error < 0.4,
                "{sphere:?}"
            );
        }
    }
}

#[test]
fn threads_do_not_change_a_figure() {
    for scene in [SceneName::FourMaterials, SceneName::ThinLayer, SceneName::Fillet] {
        let phantom = phantom(scene, 0.7);
        let mesh = blocks(&phantom);
        let sigmas: Vec<f32> = (0..mesh.positions().len()).map(|v| 0.1 + 0.01 * (v % 7) as f32).collect();
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let options = CompareOptions { step: 1.0, ..CompareOptions::default() };
            let found = pool.install(|| {
                compare(&mesh, &phantom, Some(&sigmas), &options, &Execution::default()).unwrap()
            });
            serde_json::to_string(&found).unwrap()
        };
        assert_eq!(run(1), run(3), "{scene:?}");
    }
}

#[test]
fn junction_curves_that_are_off_by_a_known_shift_are_measured_so_by_kind_and_at_their_kinks() {
    let options =
        PhantomOptions { scene: SceneName::Wedge, size: [64; 3], angle: 30.0, ..PhantomOptions::default() };
    let phantom = Phantom::new(&options).unwrap();
    let truth = phantom.truth();
    let kinks = truth.junction_kinks();
    // The rectangle moved along its normal.
    let middle = kinks.iter().sum::<DVec3>() / kinks.len() as f64;
    let shift = 0.2 * (kinks[0] - middle).cross(kinks[1] - middle).normalize();
    let mut positions = vec![middle + shift];
    let (mut triangles, mut pairs) = (Vec::new(), Vec::new());
    for piece in truth.junctions() {
        let n: u32 = 40;
        let first = positions.len() as u32;
        for k in 0..=n {
            let t = piece.low + (piece.high - piece.low) * f64::from(k) / f64::from(n);
            positions.push(piece.curve.at(t) + shift);
        }
        for k in first..first + n {
            for own in [pair(2, 0), pair(2, 1), pair(1, 0)] {
                triangles.push([0, k, k + 1]);
                pairs.push(own);
            }
        }
    }
    let mesh = mesh_of(&phantom, positions, triangles, pairs);
    let found = compare(&mesh, &phantom, None, &CompareOptions::default(), &Execution::default()).unwrap();
    let junctions = found.junctions.unwrap();
    for curves in [junctions.plain, junctions.narrow] {
        let figures = curves.truth_to_mesh.unwrap().voxels;
        assert!((figures.rms - 0.2).abs() < 1e-9 && (figures.max - 0.2).abs() < 1e-9, "{figures:?}");
    }
    assert_eq!(junctions.tight, CurveDistances::default());
    let lengths = [junctions.plain, junctions.narrow].map(|c| c.truth_to_mesh.unwrap().measure);
    assert!((lengths[1] / lengths[0] - 1.6 / 1.4).abs() < 1e-9, "the long sides are narrow");
    let kinks = junctions.kinks;
    assert_eq!((kinks.truth, kinks.missed, kinks.by_curve), (4, 0, 4));
    for distances in [kinks.distances, kinks.to_curve] {
        assert!((distances.unwrap().voxels.max - 0.2).abs() < 1e-9);
    }
    assert_eq!(junctions.points, PointComparison::default());
}

#[test]
fn a_plate_too_thick_by_a_known_amount_is_measured_so_and_a_missing_one_is_absent() {
    let options = PhantomOptions {
        scene: SceneName::ThinPlate,
        size: [64; 3],
        thickness: 3.0,
        rotation: [0.0; 3],
        ..PhantomOptions::default()
    };
    let phantom = Phantom::new(&options).unwrap();
    let centre = phantom.truth().ball().0;
    let half = DVec3::new(24.0, 24.0, 1.6);
    let (positions, triangles) = cuboid(centre - half, centre + half);
    let pairs = vec![pair(1, 0); triangles.len()];
    let mesh = mesh_of(&phantom, positions, triangles, pairs);
    let measure = |mesh: &InterfaceMesh| {
        let found = compare(mesh, &phantom, None, &CompareOptions::default(), &Execution::default());
        found.unwrap().thickness.unwrap()
    };
    let thin = measure(&mesh);
    let error = thin.error.unwrap().voxels;
    assert!((thin.present_percent - 100.0).abs() < 1e-9 && (thin.exact - 3.0).abs() < 1e-12);
    assert!((error.signed_mean - 0.2).abs() < 1e-9 && (error.max - 0.2).abs() < 1e-9);
    let empty = mesh_of(&phantom, vec![], vec![], vec![]);
    let missing = measure(&empty);
    assert!(missing.present_percent < 1e-9 && missing.error.is_none());
}

#[test]
fn a_sharp_box_in_the_place_of_a_rounded_one_is_seen() {
    let options = PhantomOptions {
        scene: SceneName::Fillet,
        size: [64; 3],
        fillet: 4.0,
        rotation: [0.0; 3],
        ..PhantomOptions::default()
    };
    let phantom = Phantom::new(&options).unwrap();
    let centre = phantom.truth().ball().0;
    // The object's box is 48 voxels wide.
    let half = 24.0 * DVec3::new(1.0, 0.85, 0.9);
    let (positions, triangles) = cuboid(centre - half, centre + half);
    let pairs = vec![pair(1, 0); triangles.len()];
    let mesh = mesh_of(&phantom, positions, triangles, pairs);
    let found = compare(&mesh, &phantom, None, &CompareOptions::default(), &Execution::default()).unwrap();
    let [fillet] = &found.fillets[..] else { panic!("{:?}", found.fillets) };
    let error = fillet.to_mesh.unwrap().voxels;
    // To the nearer face from the middle of the rounding: r (1 - 1 / sqrt 2), where it peaks between two samples.
    let most = 4.0 * (1.0 - 0.5_f64.sqrt());
    assert!((fillet.radius - 4.0).abs() < 1e-9 && (fillet.length - 8.0 * half.z).abs() < 1e-9);
    assert!(error.max <= most + 1e-9 && error.max > most - 0.2, "{error:?}");
    // An upright edge of the box is r (sqrt 2 - 1) from the curved edges at its ends, and stray beyond two voxels of them.
    let stray = found.edges[0].stray_crease_length;
    let end = (4.0 - (4.0 * (2.0_f64.sqrt() - 1.0)).powi(2)).sqrt();
    assert!((stray - 8.0 * (half.z - end)).abs() < 2.0, "{stray}");
    assert!(found.edges[0].right.off_ends.is_some() && found.edges[0].oblique == EdgeSplit::default());
}

/// A box, two triangles a side.
fn cuboid(low: DVec3, high: DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let corner = |k: u32| {
        let pick = |a: usize| if k >> a & 1 == 1 { high[a] } else { low[a] };
        DVec3::new(pick(0), pick(1), pick(2))
    };
    let sides: [[u32; 4]; 6] =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = sides.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    ((0..8).map(corner).collect(), triangles)
}

#[test]
fn a_box_has_sharp_edges_and_one_that_is_too_small_misses_them_by_the_diagonal() {
    let options = PhantomOptions {
        scene: SceneName::Cube,
        size: [48; 3],
        spacing: [0.5; 3],
        extent: Some([30.0, 24.0, 20.0]),
        rotation: [0.0; 3],
        shift: [0.0; 3],
        ..PhantomOptions::default()
    };
    let phantom = Phantom::new(&options).unwrap();
    let (centre, half) = (phantom.truth().ball().0, 0.25 * DVec3::new(30.0, 24.0, 20.0));
    for inset in [0.0, 0.2] {
        let (positions, triangles) = cuboid(centre - half + inset, centre + half - inset);
        let pairs = vec![pair(1, 0); triangles.len()];
        let mesh = mesh_of(&phantom, positions, triangles, pairs);
        let found =
            compare(&mesh, &phantom, None, &CompareOptions::default(), &Execution::default()).unwrap();
        let [edges] = &found.edges[..] else { panic!("{:?}", found.edges) };
        assert!((edges.truth_length - 8.0 * half.element_sum()).abs() < 1e-9);
        assert!(
            (edges.crease_length - (edges.truth_length - 24.0 * inset)).abs() < 1e-9,
            "diagonals do not fold"
        );
        let diagonal = 2.0_f64.sqrt() * inset;
        for distances in [edges.to_surface_clear, edges.to_mesh_edge_clear] {
            let figures = distances.unwrap();
            assert!((figures.mm.rms - diagonal).abs() < 1e-9 && (figures.mm.max - diagonal).abs() < 1e-9);
            assert!((figures.voxels.p95 - 2.0 * diagonal).abs() < 1e-9);
        }
        let all = edges.to_surface.unwrap().measure;
        assert!((all - edges.truth_length).abs() < 1e-9);
        // Clear of eight corners by six voxels of half a millimetre each way.
        assert!((edges.to_surface_clear.unwrap().measure - (all - 24.0 * 3.0)).abs() < 0.5 * 24.0);
        let back = edges.crease_to_edge.unwrap().mm;
        assert!((back.signed_mean - diagonal).abs() < 1e-9);
        assert!((back.max - diagonal).abs() < 1e-9);
    }
}
