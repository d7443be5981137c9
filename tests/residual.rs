//! The residual between a mesh's blurred model and the scan (`interfacet::inspect`).

use glam::{DMat3, DVec3};

use interfacet::execution::Execution;
use interfacet::inspect::{LevelChoice, Residual, ResidualError, ResidualOptions, residual};
use interfacet::mesh::{InterfaceMesh, MeshMaterial};
use interfacet::phantom::{Noise, Phantom, PhantomOptions, SceneName};
use interfacet::volume::MemorySource;
use interfacet::{MaterialId, Pair, VertexKind};

const EXTENT: [f64; 3] = [17.0, 13.0, 15.0];
const SIZE: usize = 40;
const TURN: f64 = 25.0;

fn phantom(cupping: f64) -> Phantom {
    let options = PhantomOptions {
        scene: SceneName::Cube,
        size: [SIZE; 3],
        spacing: [0.5, 0.5, 0.7],
        extent: Some(EXTENT),
        rotation: [0.0, 0.0, TURN],
        sigma: 1.1,
        noise: Noise::Percent(1.0),
        cupping,
        ..PhantomOptions::default()
    };
    Phantom::new(&options).expect("a phantom")
}

fn source(phantom: &Phantom) -> MemorySource {
    let samples = phantom.rasterise(&Execution::default()).expect("a volume");
    MemorySource::new(phantom.geometry().clone(), samples).expect("a volume")
}

/// The block itself, moved by some voxels.
fn block(phantom: &Phantom, moved: DVec3) -> InterfaceMesh {
    let spacing = DVec3::from(phantom.geometry().spacing());
    let middle = DVec3::splat(0.5 * (SIZE as f64 - 1.0)) + DVec3::from(phantom.options().shift) + moved;
    let centre = phantom.geometry().world(middle);
    let half = 0.5 * DVec3::from(EXTENT) * spacing;
    let turn = DMat3::from_rotation_z(TURN.to_radians());
    let corner = |i: usize| {
        centre + turn * DVec3::from([0, 1, 2].map(|a| if i >> a & 1 == 1 { half[a] } else { -half[a] }))
    };
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles: Vec<[u32; 3]> =
        quads.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let pair = Pair::new(MaterialId(1), MaterialId(0)).expect("a pair");
    let materials = phantom.materials().materials().iter();
    let materials =
        materials.map(|m| MeshMaterial { id: m.id, name: m.name.clone(), mean: m.mean }).collect();
    let pairs = vec![pair; triangles.len()];
    InterfaceMesh::new(
        (0..8).map(corner).collect(),
        vec![VertexKind::Interface; 8],
        triangles,
        pairs,
        materials,
    )
    .expect("a mesh")
}

fn options(phantom: &Phantom) -> ResidualOptions {
    // What a report states: the averaging over a voxel is in it.
    let spacing = phantom.geometry().spacing();
    let sigma = phantom.sigma_mm();
    ResidualOptions::new([0, 1, 2].map(|a| (sigma[a].powi(2) + spacing[a].powi(2) / 12.0).sqrt()))
}

fn of(phantom: &Phantom, moved: DVec3, options: &ResidualOptions) -> Residual {
    residual(&block(phantom, moved), &source(phantom), options, &Execution::default()).expect("a residual")
}

#[test]
fn the_truth_leaves_noise_alone_and_a_wrong_surface_more() {
    let phantom = phantom(0.0);
    let noise = phantom.noise_sigma();
    for levels in [LevelChoice::Table, LevelChoice::Local] {
        let options = ResidualOptions { levels, ..options(&phantom) };
        let truth = of(&phantom, DVec3::ZERO, &options);
        assert_eq!(truth.pairs.len(), 1);
        let figures = truth.pairs[0].all.expect("voxels");
        assert!(figures.voxels > 2000, "{figures:?}");
        assert!((figures.rms / noise - 1.0).abs() < 0.05, "{levels:?}: noise {noise}, {figures:?}");
        assert!(figures.mean.abs() < 0.1 * noise, "{figures:?}");
        // The median of a normal distribution's absolute value.
        assert!((figures.median / (0.6745 * noise) - 1.0).abs() < 0.06, "{figures:?}");
        assert!(truth.deep.iter().all(|d| d.voxels > 100 && (d.rms / noise - 1.0).abs() < 0.1), "{truth:?}");
        // A fifth of a voxel along x.
        let wrong = of(&phantom, DVec3::new(0.2, 0.0, 0.0), &options);
        let off = wrong.pairs[0].all.expect("voxels").rms;
        assert!(off > 2.0 * noise, "noise {noise}, moved {off}");
    }
}

#[test]
fn local_levels_follow_cupping() {
    let phantom = phantom(0.1);
    let rms = |levels| {
        let options = ResidualOptions { levels, ..options(&phantom) };
        of(&phantom, DVec3::ZERO, &options).pairs[0].all.expect("voxels").rms
    };
    let (table, local) = (rms(LevelChoice::Table), rms(LevelChoice::Local));
    assert!(local < 0.6 * table, "table {table}, local {local}, noise {}", phantom.noise_sigma());
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let phantom = phantom(0.0);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| of(&phantom, DVec3::ZERO, &options(&phantom)))
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let phantom = phantom(0.0);
    let (source, good) = (source(&phantom), options(&phantom));
    let run = |mesh: &InterfaceMesh, options: &ResidualOptions| {
        residual(mesh, &source, options, &Execution::default()).expect_err("refused").to_string()
    };
    let mesh = block(&phantom, DVec3::ZERO);
    let message = run(&mesh, &ResidualOptions { sigma_mm: [0.5, 0.0, 0.5], ..good });
    assert!(message.contains("sigma is 0") && message.contains("--sigma"), "{message}");
    let message = run(&mesh, &ResidualOptions { fine: 1, ..good });
    assert!(message.contains("fine is 1, but it must be 2 to 8"), "{message}");
    let message = run(&block(&phantom, DVec3::new(0.0, 20.0, 0.0)), &good);
    assert!(message.contains("another volume") && message.contains("--spacing"), "{message}");
    // Shares are summed along x: a hole in a face along x would change none of them.
    let across = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.positions()[v as usize]);
        (b - a).cross(c - a).x.abs()
    };
    let all = mesh.triangles().iter().enumerate();
    let largest = all.max_by(|a, b| across(a.1).total_cmp(&across(b.1))).map_or(0, |found| found.0);
    let (mut triangles, mut pairs) = (mesh.triangles().to_vec(), mesh.pairs().to_vec());
    triangles.remove(largest);
    pairs.remove(largest);
    let open = InterfaceMesh::new(
        mesh.positions().to_vec(),
        mesh.kinds().to_vec(),
        triangles,
        pairs,
        mesh.materials().to_vec(),
    );
    let message = run(&open.expect("a mesh"), &good);
    assert!(message.contains("material 1 is not closed"), "{message}");
    assert!(matches!(
        residual(
            &InterfaceMesh::new(vec![], vec![], vec![], vec![], mesh.materials().to_vec()).expect("a mesh"),
            &source,
            &good,
            &Execution::default()
        ),
        Err(ResidualError::Empty)
    ));
}
