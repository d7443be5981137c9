//! What the pipeline decides by itself, and what it says about it.

use std::path::Path;
use std::process::Command;

use interfacet::contour::Border;
use interfacet::pipeline::{IsoValue, Threshold};
use interfacet::volume::Denoise;
use interfacet::{
    Execution, Extraction, Geometry, MaterialChoice, MemorySource, NamedGrey, PipelineOptions, Samples,
    VolumeSource, extract,
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
        .args(["extract", "-q", "--accuracy", "paper", "--check", "topology", "--out"])
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

/// Pseudo-random, the same everywhere. Multiples of a constant would not do: those of neighbouring voxels depend
/// on each other, and the filters and the search for noise take them for something else.
fn mix(i: u64) -> u64 {
    let h = (i + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let h = (h ^ h >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let h = (h ^ h >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    h ^ h >> 31
}

/// Slices of a cylinder of grey 160 in air of grey 40 with noise; the first and last third are empty.
fn cylinder() -> MemorySource {
    let samples = (0..SIZE.pow(3)).map(|i| {
        let p = [i % SIZE, i / SIZE % SIZE, i / (SIZE * SIZE)];
        let radius = (p[0] as f64 - 23.4).hypot(p[1] as f64 - 24.1);
        let inside = if (16..32).contains(&p[2]) { (14.5 - radius).clamp(0.0, 1.0) } else { 0.0 };
        let noise: u64 = (0..4).map(|k| mix(i as u64 * 4 + k) >> 59).sum();
        (40.0 + 120.0 * inside + 0.5 * noise as f64 - 31.0) as f32
    });
    let geometry = Geometry::axis_aligned([SIZE; 3], [0.2; 3]).expect("geometry");
    MemorySource::new(geometry, Samples::F32(samples.collect())).expect("volume")
}

#[test]
fn one_grey_value_makes_two_materials() {
    let threshold =
        |iso| MaterialChoice::Threshold(Threshold { iso, names: vec!["air".into(), "steel".into()] });
    let run = |iso| {
        let options = PipelineOptions { materials: threshold(iso), ..PipelineOptions::default() };
        extract(&cylinder(), &options, &Execution::default()).expect("an extraction")
    };
    let found = run(IsoValue::OtsuMode);
    let iso = found.findings.iso.clone().expect("an iso value");
    let mode = iso.otsu_mode.clone().expect("how it was found");
    assert_eq!((mode.slices, mode.with_two_classes), (48, 16));
    assert!((80.0..120.0).contains(&iso.grey) && mode.agreeing >= 2, "{iso:?} {mode:?}");
    let given = run(IsoValue::Given(iso.grey));
    assert_eq!(given.findings.iso.as_ref().map(|iso| (iso.grey, &iso.otsu_mode)), Some((iso.grey, &None)));
    assert!(given.mesh == found.mesh);
    let materials = given.findings.materials.materials();
    assert_eq!(materials[1].name, "steel");
    let counted =
        cylinder().in_memory().map(|s| (0..s.len()).filter(|i| s.get(*i) >= iso.grey as f32).count());
    assert_eq!(Some(given.findings.voxels[1] as usize), counted);
    assert_eq!(given.findings.voxels.iter().sum::<u64>(), SIZE.pow(3) as u64);
    assert!(
        (materials[0].mean - 40.0).abs() < 2.0 && (materials[1].mean - 160.0).abs() < 4.0,
        "{materials:?}"
    );
}

#[test]
fn the_filter_comes_first_and_its_noise_is_told() {
    let filter: Denoise = "bilateral".parse().expect("a filter");
    let options = PipelineOptions { denoise: Some(filter), ..PipelineOptions::default() };
    let run = |options: &PipelineOptions| {
        extract(&cylinder(), options, &Execution::default()).expect("an extraction").findings
    };
    let (raw, clean) = (run(&PipelineOptions::default()), run(&options));
    let found = clean.denoise.expect("what was done");
    let noise = |m: &interfacet::material::Material| m.sigma.expect("noise");
    let (before, after) = (&raw.materials.materials()[0], &clean.materials.materials()[0]);
    assert!((found.noise_before / noise(before) - 1.0).abs() < 0.15, "{found:?} {before:?}");
    assert!(found.noise_after < 0.5 * found.noise_before && noise(after) < 0.5 * noise(before), "{found:?}");
    assert_eq!(found.used, filter.with_noise(found.noise_before));
    assert_eq!(clean.costs.stages[0].stage, "denoise");
    assert_eq!(raw.denoise, None);
}
