//! Lattices that are stretched, turned, mirrored or far away: the mesh is closed, outward, without
//! defects, of the right volume, and still so when read back from its file.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use glam::{DMat3, DVec3, EulerRot};
use interfacet::execution::Execution;
use interfacet::export::{PlyOptions, ReadOptions, read_mesh, write_ply};
use interfacet::grid::Geometry;
use interfacet::mesh::{CheckOptions, MeshReport, check};
use interfacet::pipeline::{MaterialChoice, PipelineOptions, extract, extract_into};
use interfacet::report::{InputReport, ResultWriter, RunReport};
use interfacet::volume::{MemorySource, Samples, VolumeSource};
use tempfile::TempDir;
use wild::{Wild, lumps, mesh};

mod wild;

const SIZE: [usize; 3] = [14, 12, 13];

/// Index axes in the world: along it, permuted and mirrored, turned, turned and mirrored, skewed.
fn directions() -> Vec<[[f64; 3]; 3]> {
    let turn = DMat3::from_euler(EulerRot::XYZ, 0.3, -1.1, 2.0);
    let mirrored = turn * DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
    vec![
        DMat3::IDENTITY.to_cols_array_2d(),
        [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        turn.to_cols_array_2d(),
        mirrored.to_cols_array_2d(),
        [[1.0, 0.0, 0.0], [0.4, 1.0, 0.0], [0.1, -0.3, 1.0]],
    ]
}

/// Extracts a block of lumps of five labels into a new folder; returns it with the check of the mesh
/// in memory and the report.
fn extraction(geometry: &Geometry) -> (TempDir, MeshReport, RunReport) {
    let samples = Samples::U8(lumps(SIZE, 5, 1, 7));
    let source = MemorySource::new(geometry.clone(), samples).unwrap();
    let options = PipelineOptions { materials: MaterialChoice::Labels, ..PipelineOptions::default() };
    let execution = Execution::default();
    let mesh = extract(&source, &options, &execution).unwrap().mesh;
    let mesh = MeshReport::new(&mesh, &CheckOptions::default(), &execution).unwrap();
    let input = InputReport {
        path: "block".into(),
        sample_type: source.sample_type(),
        geometry: geometry.clone(),
        voxels: geometry.voxels() as u64,
        notes: Vec::new(),
    };
    let folder = tempfile::tempdir().unwrap();
    let mut result = ResultWriter::new(folder.path(), CheckOptions::default(), &execution);
    let findings = extract_into(&source, &options, &execution, None, &mut result).unwrap();
    let report = result.finish(input, options, &findings).unwrap();
    (folder, mesh, report)
}

fn volumes(report: &MeshReport) -> Vec<f64> {
    report.measures.shells.iter().map(|s| s.volume.unwrap()).collect()
}

#[test]
fn any_lattice_gives_a_sound_mesh_and_a_sound_file() {
    let (_, unit, _) = extraction(&Geometry::axis_aligned(SIZE, [1.0; 3]).unwrap());
    let mut places: Vec<([f64; 3], [f64; 3])> = vec![([1.0; 3], [0.0; 3]), ([0.013, 0.2, 1.7], [0.0; 3])];
    places.push(([0.05, 0.06, 0.09], [-310.0, 1204.0, 77.7]));
    // Just near enough for `float`: its step is a thousandth of a voxel, less than that of a
    // crossing's margin.
    places.push(([1.0, 1.2, 0.9], [7000.0, -7100.0, 7300.0]));
    for (i, direction) in directions().into_iter().enumerate() {
        for (k, &(spacing, origin)) in places.iter().enumerate() {
            let what = format!("direction {i}, place {k}");
            let geometry = Geometry::new(SIZE, spacing, origin, direction).unwrap();
            let (folder, mesh, report) = extraction(&geometry);
            assert_eq!(report.defect_count, 0, "{what}: {:?}", mesh.defects.by_kind());
            for (volume, unit) in volumes(&mesh).into_iter().zip(volumes(&unit)) {
                let expected = unit * geometry.voxel_volume();
                // Places are rounded in memory as they are in the file.
                let most = if geometry.fits_single() { 1e-3 } else { 1e-9 };
                assert!((volume - expected).abs() < most * expected, "{what}: {volume}, {expected}");
            }
            let back = read_mesh(&folder.path().join("assembly.ply"), &ReadOptions::default()).unwrap();
            let back = MeshReport::new(&back, &CheckOptions::default(), &Execution::default()).unwrap();
            assert!(back.defects.is_empty(), "{what}, read back: {:?}", back.defects.by_kind());
            for (volume, expected) in volumes(&back).into_iter().zip(volumes(&mesh)) {
                assert!((volume - expected).abs() < 1e-12 * expected, "{what}: {volume}, {expected}");
            }
        }
    }
}

/// Crossings as close to voxels as they may be, written with the coarsest step that `float` is
/// allowed: rounding must not make triangles meet.
#[test]
fn rounding_to_float_brings_no_defects() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wild.ply");
    let execution = Execution::default();
    for (i, direction) in directions().into_iter().take(3).enumerate() {
        for seed in 0..4 {
            let origin = [8000.0, -8200.0, 8300.0];
            let geometry = Geometry::new(SIZE, [1.0, 1.3, 1.1], origin, direction).unwrap();
            assert!(geometry.is_along_axes());
            let wild = Wild { seed, cell: [usize::MAX; 3], bits: 0 };
            let mesh = mesh(&lumps(SIZE, 2 + 2 * seed, (seed % 2) as usize, seed), &geometry, &wild);
            write_ply(&path, &mesh, PlyOptions::for_mesh(&mesh, 1.0)).unwrap();
            assert!(std::fs::read(&path).unwrap().windows(16).any(|w| w == b"property float x"));
            let back = read_mesh(&path, &ReadOptions::default()).unwrap();
            let found = check(&back, &CheckOptions::default(), &execution).unwrap();
            assert!(found.is_empty(), "direction {i}, seed {seed}: {:?}", found.by_kind());
        }
    }
}

/// STL holds no more than `f32`; where that makes vertices one, the report says so.
#[test]
fn a_far_origin_is_reported_where_stl_cannot_hold_it() {
    let warned = |origin: f64| {
        let geometry = Geometry::axis_aligned(SIZE, [0.1; 3]).unwrap();
        let geometry = Geometry::new(SIZE, geometry.spacing(), [origin; 3], geometry.direction()).unwrap();
        let (_, _, report) = extraction(&geometry);
        report.warnings.iter().any(|w| w.contains("STL"))
    };
    assert!(!warned(0.0));
    assert!(!warned(1000.0));
    assert!(warned(3.0e6));
}
