//! Interfaces located by local models ([`Accuracy::Full`]) against the published rules, on phantoms with exact
//! geometry.
//!
//! Small grids, fixed seeds, blur sigma 1.15 voxels. Bounds are about one and a half times what was seen when
//! they were set; figures, with `--nocapture`; `docs/locate.md` has those of larger grids.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests are tests; figures, with --nocapture

use interfacet::execution::Execution;
use interfacet::mesh::{CheckOptions, InterfaceMesh, check};
use interfacet::phantom::compare::{CompareOptions, Comparison, Distances, compare};
use interfacet::phantom::{Noise, Phantom, PhantomOptions, SceneName};
use interfacet::pipeline::{Accuracy, DualMethod, Method, PipelineOptions, extract};
use interfacet::volume::MemorySource;

const DUAL: Method = Method::Dual(DualMethod {
    tolerance: interfacet::pipeline::Tolerance::Auto,
    placement: interfacet::contour::dual::Placement::Clamped,
    octree_only: false,
    normals: interfacet::contour::NormalRule::Auto,
});

/// A phantom and its volume.
struct Scene {
    phantom: Phantom,
    source: MemorySource,
}

impl Scene {
    fn new(scene: SceneName, size: usize) -> Self {
        Self::of(PhantomOptions { scene, size: [size; 3], ..PhantomOptions::default() })
    }

    fn of(options: PhantomOptions) -> Self {
        let phantom = Phantom::new(&options).unwrap();
        let samples = phantom.rasterise(&Execution::default()).unwrap();
        let source = MemorySource::new(phantom.geometry().clone(), samples).unwrap();
        Self { phantom, source }
    }

    /// The mesh, which must have no defect.
    fn mesh(&self, accuracy: Accuracy, method: Method) -> InterfaceMesh {
        let execution = Execution::default();
        let options = PipelineOptions { accuracy, method, ..PipelineOptions::default() };
        let mesh = extract(&self.source, &options, &execution).unwrap().mesh;
        let defects = check(&mesh, &CheckOptions::default(), &execution).unwrap();
        let what = format!("{} {accuracy:?} {method:?}", self.phantom.options().scene.name());
        assert!(defects.is_empty() && defects.self_intersections_checked, "{what}: {:?}", defects.by_kind());
        mesh
    }

    fn compare(&self, mesh: &InterfaceMesh) -> Comparison {
        let execution = Execution::default();
        compare(mesh, &self.phantom, mesh.sigmas(), &CompareOptions::default(), &execution).unwrap()
    }

    /// Compared with the truth: full accuracy, then as published; and full accuracy by dual contouring. No mesh may have a defect.
    fn all(&self) -> [Comparison; 3] {
        let ways =
            [(Accuracy::Full, Method::Marching), (Accuracy::Paper, Method::Marching), (Accuracy::Full, DUAL)];
        ways.map(|(accuracy, method)| self.compare(&self.mesh(accuracy, method)))
    }

    /// The first two of them; dual's mesh is looked at for defects alone.
    fn both(&self) -> [Comparison; 2] {
        self.mesh(Accuracy::Full, DUAL);
        [Accuracy::Full, Accuracy::Paper].map(|a| self.compare(&self.mesh(a, Method::Marching)))
    }
}

/// Signed errors of the vertices, voxels.
fn errors(found: &Comparison) -> Vec<f64> {
    found.vertex_errors.iter().filter(|e| e.is_finite()).map(|e| e / found.voxel_mm).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// The RMS of distances taken together, each with what it stands for.
fn total(parts: impl Iterator<Item = Option<Distances>>) -> f64 {
    let (sum, weight) =
        parts.flatten().fold((0.0, 0.0), |(s, w), d| (s + d.measure * d.voxels.rms.powi(2), w + d.measure));
    assert!(weight > 0.0);
    (sum / weight).sqrt()
}

/// RMS, of all pairs, within three voxels of a junction, both ways.
fn near_junctions(found: &Comparison) -> f64 {
    let both = |p: &interfacet::phantom::compare::PairComparison| {
        [p.mesh_to_truth.close.near_junction, p.truth_to_mesh.close.near_junction]
    };
    total(found.pairs.iter().flat_map(both))
}

#[test]
fn a_ball_has_its_radius_and_true_sigmas() {
    let scene = Scene::new(SceneName::Sphere, 56);
    let [full, paper, dual] = scene.all();
    let [full_rms, paper_rms] = [&full, &paper].map(|c| rms(&errors(c)));
    let [full_radius, paper_radius] = [&full, &paper].map(|c| c.spheres[0].fit.unwrap().radius_error);
    println!("ball: RMS {full_rms} paper {paper_rms}, radius {full_radius} paper {paper_radius}");
    let all = full.coverage[0].all.unwrap();
    println!("sigmas: {all:?}, without {}", full.coverage[0].without);
    assert!(full_rms < 0.02, "{full_rms}");
    assert!(full_radius.abs() < 0.01, "{full_radius}");
    // The bias of the half-value surface: s^2 / r, r being 21.
    assert!(paper_rms > 0.05 && paper_radius < -0.05, "{paper_rms} {paper_radius}");
    let without = full.coverage[0].without as f64 / full.vertex_errors.len() as f64;
    assert!(without < 0.02, "{without}");
    assert!((all.within_1 - 68.0).abs() < 8.0, "{all:?}");
    assert!((all.within_2 - 95.0).abs() < 5.0, "{all:?}");
    // Vertices that stand for much of the face lie beside it by what they state, all alike.
    let all = dual.coverage[0].all.unwrap();
    println!("sigmas, dual: {all:?}");
    assert!(all.within_1 > 45.0 && all.within_1 < 85.0 && all.within_2 > 90.0, "{all:?}");
}

#[test]
fn a_cupped_and_noisy_ball_is_as_good_but_for_the_noise() {
    let scene = Scene::of(PhantomOptions {
        scene: SceneName::Sphere,
        size: [56; 3],
        cupping: 0.1,
        noise: Noise::Percent(2.0),
        ..PhantomOptions::default()
    });
    let [full, paper] = scene.both();
    let [full_rms, paper_rms] = [&full, &paper].map(|c| rms(&errors(c)));
    println!("cupped ball: RMS {full_rms} paper {paper_rms}");
    assert!(full_rms < 0.03 && full_rms < 0.6 * paper_rms, "{full_rms} {paper_rms}");
}

#[test]
fn junctions_of_a_press_fit_ring_are_found() {
    // The ring's wall must be thick enough that patches find each of its faces alone: smaller rings are less good.
    let options = PhantomOptions { size: [80; 3], fill: 0.85, ..PhantomOptions::default() };
    let scene = Scene::of(options);
    let found = scene.all();
    let near = found.each_ref().map(near_junctions);
    let curve = found.each_ref().map(|c| {
        let all = c.junctions.as_ref().unwrap().all;
        total([all.mesh_to_truth, all.truth_to_mesh].into_iter())
    });
    println!("ring: near junctions {near:?}, curves {curve:?}");
    assert!(near[0] < 0.035 && near[1] > 5.0 * near[0], "{near:?}");
    assert!(curve[0] < 0.14 && curve[1] > 5.0 * curve[0], "{curve:?}");
    // Dual contouring simplifies, to a tenth of a voxel; curves less.
    assert!(near[2] < 0.05 && curve[2] < 0.15, "{near:?} {curve:?}");
}

#[test]
fn edges_of_a_cube_are_sharp_up_to_its_corners() {
    let scene = Scene::new(SceneName::Cube, 64);
    let [full, paper] = scene.both().map(|c| {
        let edges = &c.edges[0];
        let ends = edges.right.at_ends.unwrap().voxels;
        (
            [edges.right.off_ends, edges.right.at_ends, edges.to_surface_clear]
                .map(|d| total([d].into_iter())),
            ends.max,
        )
    });
    println!("cube: edges farther than 3, within 3 and farther than 6 from corners {full:?} paper {paper:?}");
    assert!(full.0[0] < 0.06 && full.0[1] < 0.12 && full.0[2] < 0.06 && full.1 < 0.6, "{full:?}");
    assert!(paper.0.iter().all(|rms| *rms > 0.6), "{paper:?}");
}

#[test]
fn ends_of_junction_curves_are_where_planes_meet() {
    let scene = Scene::of(PhantomOptions {
        scene: SceneName::CubeInCube,
        size: [80; 3],
        fill: 0.85,
        ..PhantomOptions::default()
    });
    let [full, paper] = scene.both().map(|c| {
        let all = c.junctions.as_ref().unwrap();
        (all.kinks.distances.unwrap().voxels.max, all.kinks.missed, near_junctions(&c))
    });
    println!("cube in cube: corners of the iron's rim {full:?} paper {paper:?}");
    assert!(full.0 < 0.1 && full.1 == 0 && full.2 < 0.1, "{full:?}");
    assert!(paper.0 > 1.0, "{paper:?}");
}

#[test]
fn corners_are_the_same_in_slabs() {
    let scene = Scene::new(SceneName::FourMaterials, 64);
    let options = PipelineOptions { accuracy: Accuracy::Full, ..PipelineOptions::default() };
    let mesh = |execution: Execution| extract(&scene.source, &options, &execution).unwrap().mesh;
    let whole = mesh(Execution::default());
    for slices in [5, 17] {
        let slabs = mesh(Execution::default().with_slab(slices));
        assert_eq!(whole.triangles(), slabs.triangles(), "{slices}");
        let bits = |m: &InterfaceMesh| {
            m.positions().iter().map(|p| p.to_array().map(f64::to_bits)).collect::<Vec<_>>()
        };
        assert!(bits(&whole) == bits(&slabs), "{slices}");
    }
}

#[test]
fn a_point_of_four_materials_is_found() {
    let scene = Scene::of(PhantomOptions {
        scene: SceneName::FourMaterials,
        size: [80; 3],
        fill: 0.85,
        ..PhantomOptions::default()
    });
    let [full, paper, dual] = scene.all().map(|c| {
        let points = c.junctions.as_ref().unwrap().points;
        (points.distances.map(|d| d.voxels.max), points.missed)
    });
    println!("four materials: point {full:?} paper {paper:?} dual {dual:?}");
    // The cell whose labels show all four need not be the one that holds the point.
    assert!(full.0.is_some_and(|off| off < 0.5) && full.1 == 0, "{full:?}");
    assert!(dual.0.is_some_and(|off| off < 0.5) && dual.1 == 0, "{dual:?}");
    assert!(paper.0.is_none_or(|off| off > 1.0), "{paper:?}");
}

#[test]
fn rounded_edges_stay_round() {
    let scene = Scene::of(PhantomOptions {
        scene: SceneName::Fillet,
        size: [64; 3],
        fillet: 3.0,
        ..PhantomOptions::default()
    });
    let [full, paper] = scene.both().map(|c| {
        println!("folds away from edges: {} mm", c.edges.iter().map(|e| e.stray_crease_length).sum::<f64>());
        let [fillet] = c.fillets[..] else { panic!("{:?}", c.fillets) };
        fillet.to_mesh.unwrap().voxels
    });
    println!("fillet: {full:?} paper {paper:?}");
    // An edge in its place would be 1.2 off.
    assert!(full.rms < 0.22 && full.rms < paper.rms, "{full:?} {paper:?}");
    assert!(full.max < 0.5, "{full:?} {paper:?}");
}
