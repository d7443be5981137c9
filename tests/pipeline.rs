//! What the pipeline decides by itself, and what it says about it.

use std::path::Path;
use std::process::Command;

use interfacet::contour::Border;
use interfacet::{
    Execution, Extraction, Geometry, MaterialChoice, MemorySource, NamedGrey, PipelineOptions, Samples,
    extract,
};

const SIZE: usize = 48;

/// A soft-edged cube of grey 100 in air of grey 0, with single bright voxels of grey 250 inside.
fn specked_cube() -> MemorySource {
    let samples = (0..SIZE.pow(3)).map(|i| {
        let p = [i % SIZE, i / SIZE % SIZE, i / (SIZE * SIZE)];
        let depth = p.map(|c| 14.0 - (c as f64 - 24.0).abs()).into_iter().fold(f64::INFINITY, f64::min);
        let grey = 100.0 / (1.0 + (-1.5 * depth).exp());
        let speck = depth > 4.0 && (i * 7919) % 101 == 0;
        if speck { 250 } else { grey as u8 }
    });
    let geometry = Geometry::axis_aligned([SIZE; 3], [1.0; 3]).expect("geometry");
    MemorySource::new(geometry, Samples::U8(samples.collect())).expect("volume")
}

fn given(materials: &[(&str, f64)]) -> PipelineOptions {
    let named = |&(name, grey): &(&str, f64)| NamedGrey { name: name.into(), grey };
    let materials = MaterialChoice::Given(materials.iter().map(named).collect());
    PipelineOptions { materials, ..PipelineOptions::default() }
}

fn run(options: &PipelineOptions) -> Extraction {
    extract(&specked_cube(), options, &Execution::default()).expect("an extraction")
}

#[test]
fn a_lowered_radius_that_gains_nothing_is_taken_back() {
    // The specks are the densest material, and single voxels are never kept.
    let extraction = run(&given(&[("air", 0.0), ("plastic", 100.0), ("speck", 250.0)]));
    let counts = extraction.findings.classification.expect("counts");
    assert!(counts.densest_kept_share() < 0.5, "{counts:?}");
    let blur = extraction.findings.blur.expect("blur");
    assert_eq!(blur.lowered_from, None, "{blur:?}");
    assert_eq!(extraction.findings.voxels[2], 0);
}

fn interfacet(arguments: &[&str]) -> (bool, serde_json::Value) {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out");
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/press_fit_ring.mha");
    let status = Command::new(env!("CARGO_BIN_EXE_interfacet"))
        .args(["extract", "-q", "--check", "topology", "--out"])
        .arg(&out)
        .arg(&fixture)
        .args(arguments)
        .status()
        .expect("runs");
    let report = std::fs::read_to_string(out.join("report.json")).expect("a report");
    let mut report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
    let files: Vec<String> = std::fs::read_dir(out.join("materials"))
        .expect("materials")
        .map(|e| e.expect("entry").file_name().to_string_lossy().into_owned())
        .collect();
    report["files"] = files.into();
    (status.success(), report)
}

#[test]
fn a_material_that_nothing_became_is_named_and_gets_no_file() {
    let (good, report) =
        interfacet(&["--material=air=25", "--material=al=72", "--material=ghost=150", "--material=fe=248"]);
    assert!(good);
    let warnings = report["warnings"].to_string();
    assert!(warnings.contains("no voxel became ghost"), "{warnings}");
    let files = report["files"].to_string();
    assert!(files.contains("1_al.stl") && files.contains("3_fe.ply") && !files.contains("ghost"), "{files}");
}

#[test]
fn an_open_border_is_no_defect_and_is_counted() {
    let options = PipelineOptions { border: Border::Open, ..PipelineOptions::default() };
    assert_eq!(serde_json::to_value(&options).expect("JSON")["border"], "open");
    let (good, report) = interfacet(&["--roi", "0:36,:,:", "--border", "open"]);
    assert!(good);
    assert_eq!(report["unexpected_defects"], 0);
    let boundary = &report["non_manifold_edges"]["boundary_edges"];
    assert!(boundary.as_u64() > Some(100), "{boundary}");
    let (good, report) = interfacet(&["--roi", "0:36,:,:"]);
    assert!(good && report["defect_count"] == 0 && report["non_manifold_edges"]["boundary_edges"] == 0);
}
