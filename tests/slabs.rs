//! The same result, byte for byte, for one slab or many, of any thickness, with any number of threads.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::path::Path;

use common::{assert_same, shared};
use interfacet::classify::ClassifyError;
use interfacet::contour::NormalRule;
use interfacet::contour::dual::Placement;
use interfacet::grid::VoxelBox;
use interfacet::mesh::{MeshMaterial, MeshMerger, MeshPiece};
use interfacet::pipeline::{
    Accuracy, DualMethod, IsoValue, MeshSink, Method, PipelineError, SinkError, Threshold, Tolerance,
    extract_into,
};
use interfacet::volume::{Denoise, SampleType, VolumeError};
use interfacet::{
    Border, Execution, Extraction, Geometry, MaterialChoice, MemorySource, NamedGrey, PipelineOptions,
    Samples, VolumeSource, extract,
};
use proptest::prelude::*;

/// A volume as in a file: nothing is in memory but what was asked for.
struct Strict(MemorySource);

impl VolumeSource for Strict {
    fn geometry(&self) -> &Geometry {
        self.0.geometry()
    }

    fn sample_type(&self) -> SampleType {
        self.0.sample_type()
    }

    fn cheap_partial_reads(&self) -> bool {
        true
    }

    fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
        self.0.read(part)
    }
}

/// Puts pieces of at most so many triangles together.
struct Collect(MeshMerger, Vec<MeshMaterial>, usize);

impl MeshSink for Collect {
    fn begin(&mut self, _: &Geometry, materials: &[MeshMaterial]) -> Result<(), SinkError> {
        self.1 = materials.to_vec();
        Ok(())
    }

    fn add(&mut self, piece: MeshPiece) -> Result<(), SinkError> {
        Ok(self.0.add(piece)?)
    }

    fn piece(&self) -> Option<usize> {
        Some(self.2)
    }
}

/// How to cut the work.
#[derive(Debug, Clone, Copy)]
struct Cut {
    slices: usize,
    threads: usize,
    /// Triangles of a piece.
    piece: usize,
    /// Whether labels may go to a scratch file.
    scratch: bool,
}

type Outcome = Result<Extraction, PipelineError>;

fn in_slabs(source: &Strict, options: &PipelineOptions, cut: Cut) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(cut.threads).build().unwrap();
    let execution = Execution::default().with_slab(cut.slices);
    let mut sink = Collect(MeshMerger::default(), Vec::new(), cut.piece);
    let scratch: Option<&Path> = cut.scratch.then(|| folder.path());
    let findings = pool.install(|| extract_into(source, options, &execution, scratch, &mut sink))?;
    Ok(Extraction { findings, mesh: sink.0.finish(sink.1)? })
}

/// Extracts a volume at once and as `cut` says; both must end alike. Returns how.
fn same(geometry: &Geometry, samples: &Samples, options: &PipelineOptions, cut: Cut) -> Outcome {
    let source = MemorySource::new(geometry.clone(), samples.clone()).unwrap();
    let whole = extract(&source, options, &Execution::default());
    let slabs = in_slabs(&Strict(source), options, cut);
    match (&whole, &slabs) {
        (Ok(a), Ok(b)) => {
            let bits = |e: &Extraction| {
                e.mesh.positions().iter().map(|p| p.to_array().map(f64::to_bits)).collect::<Vec<_>>()
            };
            assert_eq!(bits(a), bits(b), "{cut:?}");
            assert!(a.mesh == b.mesh, "{cut:?}");
            let (a, b) = (&a.findings, &b.findings);
            assert_eq!(a.geometry, b.geometry);
            assert_eq!(a.materials, b.materials);
            assert_eq!(a.rejected, b.rejected);
            assert_eq!(a.denoise, b.denoise);
            assert_eq!(a.iso, b.iso);
            assert_eq!(a.blur, b.blur);
            assert_eq!(a.classification, b.classification);
            assert_eq!(a.voxels, b.voxels);
            assert_eq!(a.dual, b.dual);
        }
        (Err(a), Err(b)) => assert_eq!(format!("{a:?}"), format!("{b:?}"), "{cut:?}"),
        (a, b) => panic!("{:?} but {:?} with {cut:?}", a.as_ref().err(), b.as_ref().err()),
    }
    whole
}

/// Pseudo-random, the same everywhere.
fn mix(seed: u64, i: usize) -> u64 {
    let h = (seed ^ i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
    (h ^ h >> 32).wrapping_mul(0xD6E8_FEB8_6659_FD93) >> 24
}

/// Labels of a block or ball (place and size in shares of the volume) after another, the later over the
/// earlier, in a volume of 0.
fn lumps(size: [usize; 3], parts: &[([f64; 3], f64, bool, u8)]) -> Vec<u8> {
    let extent = *size.iter().max().unwrap() as f64;
    let at = |i: usize| [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])];
    let label = |i: usize| {
        let inside = parts.iter().rev().find(|(place, radius, ball, _)| {
            let d: [f64; 3] = std::array::from_fn(|a| (at(i)[a] as f64 - place[a] * size[a] as f64).abs());
            let far = if *ball {
                d.iter().map(|d| d * d).sum::<f64>().sqrt()
            } else {
                d.into_iter().fold(0.0, f64::max)
            };
            far <= radius * extent
        });
        inside.map_or(0, |part| part.3)
    };
    (0..size.iter().product()).map(label).collect()
}

/// Averages each voxel with its neighbours along every axis, `times` over.
fn softened(mut grey: Vec<f64>, size: [usize; 3], times: usize) -> Vec<f64> {
    let steps = [1, size[0], size[0] * size[1]];
    for axis in (0..3).cycle().take(3 * times) {
        let mean = |i: usize| {
            let x = i / steps[axis] % size[axis];
            let below = if x > 0 { grey[i - steps[axis]] } else { grey[i] };
            let above = if x + 1 < size[axis] { grey[i + steps[axis]] } else { grey[i] };
            (below + 2.0 * grey[i] + above) / 4.0
        };
        grey = (0..grey.len()).map(mean).collect();
    }
    grey
}

const GREYS: [f64; 4] = [20.0, 90.0, 140.0, 220.0];

/// Grey values 0 to 255 as samples of a type, and how grey values become those samples.
fn samples(grey: &[f64], sample: SampleType) -> (Samples, fn(f64) -> f64) {
    let values = |to: fn(f64) -> f64| grey.iter().map(|&g| to(g)).collect::<Vec<f64>>();
    let (u16, i16, f32) = (|g| 200.0 * g, |g| 100.0 * g - 9000.0, |g| 0.013 * g - 1.1);
    match sample {
        SampleType::U8 => (Samples::U8(grey.iter().map(|&g| g as u8).collect()), |g| g),
        SampleType::U16 => (Samples::U16(values(u16).into_iter().map(|v| v as u16).collect()), u16),
        SampleType::I16 => (Samples::I16(values(i16).into_iter().map(|v| v as i16).collect()), i16),
        SampleType::F32 => (Samples::F32(values(f32).into_iter().map(|v| v as f32).collect()), f32),
    }
}

const TYPES: [SampleType; 4] = [SampleType::U8, SampleType::U16, SampleType::I16, SampleType::F32];

fn some_type() -> impl Strategy<Value = SampleType> {
    (0..4usize).prop_map(|i| TYPES[i])
}

/// None in most cases, so that the others are looked at as they are.
fn some_filter() -> impl Strategy<Value = Option<Denoise>> {
    let filters = ["bilateral", "median", "nlm:search=1.5", "gaussian:sigma=0.6", "mean"];
    (0..12usize).prop_map(move |i| Some(filters.get(i)?.parse().unwrap()))
}

fn some_parts() -> impl Strategy<Value = Vec<([f64; 3], f64, bool, u8)>> {
    prop::collection::vec(
        ([0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64], 0.08..0.45f64, any::<bool>(), 0..4u8),
        2..7,
    )
}

fn some_cut() -> impl Strategy<Value = Cut> {
    (1..34usize, 1..4usize, 1..3000usize, any::<bool>()).prop_map(|(slices, threads, piece, scratch)| Cut {
        slices,
        threads,
        piece,
        scratch,
    })
}

/// Both ways to make a surface; dual with any of its options.
fn some_method() -> impl Strategy<Value = Method> {
    let tolerance = prop_oneof![
        Just(Tolerance::Auto),
        (-0.2..1.5f64).prop_map(Tolerance::Voxels),
        (0.0..0.4f64).prop_map(Tolerance::Millimetres),
        (-0.5..8.0f64).prop_map(Tolerance::Phi),
        (1..4000u64).prop_map(Tolerance::Triangles),
    ];
    let placement = prop_oneof![Just(Placement::Clamped), Just(Placement::Paper)];
    let normals = prop_oneof![
        Just(NormalRule::Auto),
        Just(NormalRule::Gradient),
        Just(NormalRule::Smoothed),
        Just(NormalRule::Sided),
    ];
    let dual = (tolerance, placement, any::<bool>(), normals);
    let dual = dual.prop_map(|(tolerance, placement, octree_only, normals)| DualMethod {
        tolerance,
        placement,
        octree_only,
        normals,
    });
    prop_oneof![Just(Method::Marching), dual.prop_map(Method::Dual)]
}

fn border(open: bool) -> Border {
    if open { Border::Open } else { Border::Closed }
}

fn given(to: fn(f64) -> f64) -> MaterialChoice {
    let named = |(i, grey): (usize, &f64)| NamedGrey { name: format!("m{i}"), grey: to(*grey) };
    MaterialChoice::Given(GREYS.iter().enumerate().map(named).collect())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]
    #[test]
    fn grey_volumes_give_the_same_in_slabs(
        size in [6..70usize, 6..24usize, 5..34usize],
        thick in 0.4..2.5f64,
        parts in some_parts(),
        soft in 0..4usize,
        noise in 0.0..8.0f64,
        sample in some_type(),
        find in 0..6usize,
        denoise in some_filter(),
        method in some_method(),
        accuracy in prop_oneof![Just(Accuracy::Paper), Just(Accuracy::Full)],
        radius in prop::option::of(0.9..2.6f64),
        open: bool,
        seed: u64,
        cut in some_cut(),
    ) {
        let geometry = Geometry::axis_aligned(size, [0.3, 0.3, 0.3 * thick]).unwrap();
        let grey = lumps(size, &parts).into_iter().map(|label| GREYS[usize::from(label)]).collect();
        let mut grey = softened(grey, size, soft);
        for (i, g) in grey.iter_mut().enumerate() {
            *g += noise * (mix(seed, i) % 1000) as f64 / 1000.0;
        }
        let (samples, to) = samples(&grey, sample);
        let materials = match find {
            0 => MaterialChoice::default(),
            1 => MaterialChoice::Find { count: Some(3), names: Vec::new() },
            2 => MaterialChoice::Threshold(Threshold::default()),
            3 => MaterialChoice::Threshold(Threshold { iso: IsoValue::Given(to(110.5)), names: Vec::new() }),
            _ => given(to),
        };
        let options = PipelineOptions {
            materials,
            radius,
            border: border(open),
            denoise,
            method,
            accuracy,
        };
        let _ = same(&geometry, &samples, &options, cut);
    }

    #[test]
    fn label_volumes_give_the_same_in_slabs(
        size in [1..70usize, 1..24usize, 1..34usize],
        parts in some_parts(),
        sparse in prop::option::of(3..40u64),
        sample in some_type(),
        method in some_method(),
        open: bool,
        seed: u64,
        cut in some_cut(),
    ) {
        let geometry = Geometry::axis_aligned(size, [0.3, 0.2, 0.5]).unwrap();
        let labels = lumps(size, &parts).into_iter().enumerate().map(|(i, label)| {
            let other = sparse.is_some_and(|n| mix(seed, i).is_multiple_of(n));
            [0.0, 3.0, 70.0, 200.0, 255.0][if other { 4 } else { usize::from(label) }]
        });
        let (samples, _) = samples(&labels.collect::<Vec<_>>(), sample);
        let options = PipelineOptions { materials: MaterialChoice::Labels, border: border(open), method, ..PipelineOptions::default() };
        let _ = same(&geometry, &samples, &options, cut);
    }
}

/// Columns of three materials in a fourth, with so wide a blur that much must be thinned and settled.
fn columns(size: [usize; 3], seed: u64) -> Vec<u8> {
    let grey = (0..size.iter().product()).map(|i| {
        let p = [i % size[0], i / size[0] % size[1], i / (size[0] * size[1])].map(|c| c / 7);
        GREYS[(mix(seed, p[0] + 50 * p[1] + 2500 * (p[2] / 2)) % 4) as usize]
    });
    softened(grey.collect(), size, 1).into_iter().map(|g| g as u8).collect()
}

#[test]
fn long_thinning_and_settling_are_the_same_in_slabs() {
    let size = [40, 36, 44];
    let geometry = Geometry::axis_aligned(size, [1.0; 3]).unwrap();
    let (mut long, mut settled) = (0, 0);
    for seed in 1..7 {
        let samples = Samples::U8(columns(size, seed));
        for (radius, slices) in [(2.0, 1), (2.5, 6), (3.0, 17)] {
            let cut = Cut { slices, threads: 2, piece: 1000, scratch: seed % 2 == 0 };
            let options = PipelineOptions {
                materials: given(|g| g),
                radius: Some(radius),
                ..PipelineOptions::default()
            };
            if let Ok(Extraction { findings, .. }) = same(&geometry, &samples, &options, cut) {
                let counts = findings.classification.unwrap();
                long += usize::from(counts.thinning_rounds > 8);
                settled += usize::from(counts.settled > 0);
            }
        }
    }
    assert!(long >= 3 && settled >= 3, "{long} runs of more than one sweep, {settled} with settling");
}

#[test]
fn runs_that_must_fail_fail_alike_in_slabs() {
    let size = [24, 20, 22];
    let geometry = Geometry::axis_aligned(size, [1.0; 3]).unwrap();
    let voxels = 0..size.iter().product();
    let fails = |samples: &Samples, options: &PipelineOptions| {
        let mut error = None;
        for (slices, scratch) in [(1, false), (5, true), (21, false)] {
            let cut = Cut { slices, threads: 2, piece: 500, scratch };
            error = same(&geometry, samples, options, cut).err();
        }
        error.unwrap()
    };
    let accuracy = Accuracy::Paper;
    let materials = given(|g| g);
    let options = PipelineOptions { materials, radius: Some(2.0), accuracy, ..PipelineOptions::default() };
    let noise = voxels.clone().map(|i| GREYS[(mix(3, i) % 4) as usize] as u8).collect();
    let error = fails(&Samples::U8(noise), &options);
    assert!(matches!(error, PipelineError::Classify(ClassifyError::NoCore { .. })), "{error}");
    let specks = voxels
        .clone()
        .map(|i| if mix(5, i).is_multiple_of(300) { GREYS[1 + i % 3] as u8 } else { 20 })
        .collect();
    let error = fails(&Samples::U8(specks), &options);
    assert!(matches!(error, PipelineError::NoInterface { .. }), "{error}");
    let absent = voxels.clone().map(|i| if i % 24 < 12 { 20 } else { 90 }).collect();
    let error = fails(&Samples::U8(absent), &options);
    assert!(matches!(error, PipelineError::Find(_)), "{error}");
    let error = fails(&Samples::U8(vec![7; size.iter().product()]), &PipelineOptions::default());
    assert!(matches!(error, PipelineError::Find(_)), "{error}");
    let labels = PipelineOptions { materials: MaterialChoice::Labels, ..PipelineOptions::default() };
    let error = fails(&Samples::I16(vec![7; size.iter().product()]), &labels);
    assert!(matches!(error, PipelineError::Classify(ClassifyError::OneLabel { .. })), "{error}");
    let many = Samples::I16(voxels.map(|i| (i % 300) as i16).collect());
    let error = fails(&many, &labels);
    assert!(matches!(error, PipelineError::Classify(ClassifyError::TooManyLabels { .. })), "{error}");
}

/// A volume that cannot be read.
struct Unreadable(Geometry);

impl VolumeSource for Unreadable {
    fn geometry(&self) -> &Geometry {
        &self.0
    }

    fn sample_type(&self) -> SampleType {
        SampleType::U16
    }

    fn cheap_partial_reads(&self) -> bool {
        true
    }

    fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
        panic!("{part:?} was read")
    }
}

#[test]
fn too_little_memory_is_refused_before_anything_is_read() {
    for (size, memory) in [([9, 8, 7], 1 << 20), ([2000, 2000, 2000], 90 << 20), ([30000, 30000, 3], 1 << 30)]
    {
        let source = Unreadable(Geometry::axis_aligned(size, [1.0; 3]).unwrap());
        let execution = Execution::default().with_memory(memory).with_slab(4);
        let mut sink = Collect(MeshMerger::default(), Vec::new(), 100);
        let error =
            extract_into(&source, &PipelineOptions::default(), &execution, None, &mut sink).unwrap_err();
        let PipelineError::Memory { budget, needed, size: said } = error else { panic!("{error}") };
        assert!(budget == memory && needed > memory && said == size, "{needed}");
        assert!(sink.1.is_empty());
    }
}

#[test]
fn a_filtered_volume_and_one_grey_value_are_the_same_in_slabs() {
    let ring = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/press_fit_ring.mha");
    let ways: [&[&str]; 4] =
        [&[], &["--slab", "1"], &["--slab", "19", "--threads", "1"], &["--memory", "600MiB"]];
    assert_same(ring, &["--denoise", "bilateral", "--check", "topology"], &ways);
    assert_same(ring, &["--threshold", "otsu-mode", "--denoise", "nlm:search=1", "--border", "open"], &ways);
    assert_same(ring, &["--iso", "160", "--roi", "5:60,:,11:70"], &ways);
}

#[test]
fn an_engine_is_the_same_in_slabs() {
    let Some(input) = shared("engine/engine.mha") else { return };
    let paper = ["--iso", "106", "--roi", ":,:,0:100", "--check", "topology"];
    assert_same(&input, &paper, &[&[], &["--slab", "7", "--threads", "1"]]);
    assert_same(&input, &[], &[&[], &["--slab", "7", "--threads", "1"], &["--slab", "40"]]);
}

/// Whole, in thin slabs and in thick ones, with one thread to three, and with little memory.
const DUAL_WAYS: [&[&str]; 6] = [
    &[],
    &["--slab", "7", "--threads", "1"],
    &["--slab", "7", "--threads", "3"],
    &["--slab", "40", "--threads", "2"],
    &["--memory", "228MiB", "--threads", "1"],
    &["--memory", "4GiB", "--threads", "3"],
];

#[test]
fn a_dual_surface_is_the_same_in_slabs() {
    let ring = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/press_fit_ring.mha");
    let dual = ["--method", "dual"];
    let with = |more: &[&'static str]| [&dual[..], more].concat();
    assert_same(ring, &with(&[]), &DUAL_WAYS);
    assert_same(ring, &with(&["--iso", "60", "--tolerance", "0.1mm", "--border", "open"]), &DUAL_WAYS);
    let cropped = with(&["--roi", "5:60,:,11:70", "--target-triangles", "3000", "--check", "topology"]);
    assert_same(ring, &cropped, &DUAL_WAYS[..4]);
    assert_same(ring, &with(&["--denoise", "mean", "--phi", "1.5", "--qef", "paper"]), &DUAL_WAYS[..4]);
}

#[test]
fn a_dual_surface_of_labels_is_the_same_in_slabs() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("labels.raw");
    let size = [70, 45, 81];
    let parts = [
        ([0.4, 0.5, 0.5], 0.35, true, 1),
        ([0.6, 0.4, 0.4], 0.2, false, 2),
        ([0.5, 0.9, 0.8], 0.25, true, 3),
        ([0.1, 0.2, 0.9], 0.15, false, 2),
    ];
    std::fs::write(&input, lumps(size, &parts)).unwrap();
    let labels = ["--size", "70,45,81", "--type", "u8", "--labels", "--method", "dual"];
    let input = input.to_str().unwrap();
    assert_same(input, &labels, &DUAL_WAYS);
    assert_same(
        input,
        &[&labels[..], &["--tolerance", "-1", "--check", "topology"]].concat(),
        &DUAL_WAYS[..4],
    );
    if let Some(weave) = shared("weave/small_weave_tag.tif") {
        let cropped = ["--labels", "--method", "dual", "--roi", "10:90,0:70,20:80", "--check", "topology"];
        assert_same(&weave, &cropped, &DUAL_WAYS[..4]);
    }
}

#[test]
fn a_dual_engine_is_the_same_in_slabs() {
    let Some(input) = shared("engine/engine.mha") else { return };
    let cropped = ["--method", "dual", "--roi", "40:200,40:220,1:80", "--check", "topology"];
    assert_same(&input, &cropped, &[DUAL_WAYS[0], DUAL_WAYS[2], DUAL_WAYS[3]]);
    let paper = ["--method", "dual", "--iso", "106", "--roi", ":,:,0:100", "--check", "topology"];
    assert_same(&input, &paper, &[DUAL_WAYS[0], DUAL_WAYS[1], DUAL_WAYS[4]]);
}

#[test]
fn compressed_and_stacked_files_are_the_same_in_slabs() {
    let ring = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/press_fit_ring.mha");
    let ways: [&[&str]; 4] =
        [&[], &["--slab", "1"], &["--slab", "19", "--threads", "1"], &["--slab", "50", "--memory", "600MiB"]];
    assert_same(ring, &[], &ways);
    assert_same(ring, &["--roi", "5:60,:,11:70", "--border", "open"], &ways);
    for (name, options) in [
        ("teapot/teapot.nrrd", &["--roi", "60:200,80:200,50:110"][..]),
        ("tooth/tooth.nrrd", &["--check", "topology"]),
        ("switch/slices", &["--spacing", "0.092", "--roi", "20:140,30:140,100:160"]),
        ("weave/small_weave_tag.tif", &["--labels", "--roi", "10:90,0:70,20:80", "--check", "topology"]),
    ] {
        if let Some(input) = shared(name) {
            assert_same(&input, options, &ways[..3]);
        }
    }
}
