//! Slabs must find what the plain look at the whole volume ([`reference`]) finds, to the last bit.

use std::path::Path;

use proptest::prelude::*;

use super::*;
use crate::execution::Execution;
use crate::grid::{Geometry, VoxelBox};
use crate::volume::{
    MemorySource, OpenOptions, Sample, SampleType, SampleWindow, Samples, Slab, VolumeError, VolumeSource,
    open,
};

/// Whatever is found must be the same to the last bit, by any slabs.
fn agree<S: Sample>(source: &dyn VolumeSource, count: Option<usize>, thicknesses: &[usize]) {
    let geometry = source.geometry();
    let size = geometry.size();
    let samples = S::unwrap(source.read_all().unwrap()).unwrap();
    let text = |found: &Result<Found, FindError>| format!("{found:?}");
    let wanted = reference::find_materials(&samples, size, count);
    let greys = [0.2, 0.5].map(|q| {
        let mut sorted: Vec<f32> = samples.iter().map(|v| v.to_f32()).collect();
        sorted.sort_by(f32::total_cmp);
        f64::from(sorted[(q * sorted.len() as f64) as usize])
    });
    let given = MaterialTable::new([("a", greys[0]), ("b", greys[1] + 1.0)]).unwrap();
    let measured = reference::measure_statistics(&samples, size, given.clone());
    let table = wanted.as_ref().map_or(&measured, |found| &found.table).clone();
    let slab = Slab::whole(&samples, size);
    assert_eq!(text(&find_materials(slab, count)), text(&wanted));
    let quality = ScanQuality::of(slab, geometry, &table);
    let execution = Execution::default();
    let mut first: Option<(GreyCounts, u64)> = None;
    for &thickness in thicknesses {
        let mut window = SampleWindow::<S>::new(source, &execution).unwrap();
        let survey = Survey::read(&mut window, Some(&given), thickness).unwrap();
        assert_eq!(text(&survey.find_materials(count)), text(&wanted), "{thickness}");
        assert_eq!(format!("{:?}", survey.measure_statistics(given.clone())), format!("{measured:?}"));
        let seen = (survey.counts().clone(), survey.crossings(&table));
        assert_eq!(first.get_or_insert_with(|| seen.clone()), &seen, "{thickness}");
        assert_eq!(
            ScanQuality::read(&mut window, geometry, &table, thickness).unwrap(),
            quality,
            "{thickness}"
        );
    }
}

/// Another source, whose samples are not in memory as far as a window can see.
struct Hidden(MemorySource);

impl VolumeSource for Hidden {
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

/// Balls of three greys with soft borders and noise.
fn balls(size: [usize; 3], seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(1);
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / 16_777_216.0
    };
    let balls: Vec<([f32; 3], f32, f32)> = (0..4)
        .map(|i| (size.map(|n| random() * n as f32), 4.0 + 8.0 * random(), [90.0, 210.0][i % 2]))
        .collect();
    (0..size.iter().product::<usize>())
        .map(|i| {
            let p = [i % size[0], i / size[0] % size[1], i / size[0] / size[1]];
            let grey = balls.iter().fold(20.0, |grey, (centre, radius, inside)| {
                let d = (0..3).map(|a| (p[a] as f32 - centre[a]).powi(2)).sum::<f32>().sqrt() - radius;
                grey + (inside - grey) / (1.0 + (1.4 * d).exp())
            });
            grey + 4.0 * random()
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn slabs_find_what_the_whole_volume_shows(
        size in [3..40usize, 3..40usize, 3..40usize],
        seed in 0..1000u64,
        thickness in 1..40usize,
        count in prop::option::of(2..5usize),
    ) {
        let geometry = Geometry::axis_aligned(size, [0.4, 0.4, 0.5]).unwrap();
        let greys = balls(size, seed);
        let source = |samples| Hidden(MemorySource::new(geometry.clone(), samples).unwrap());
        let all = [1, thickness, size[2]];
        agree::<u8>(&source(Samples::U8(greys.iter().map(|v| *v as u8).collect())), count, &all);
        agree::<i16>(&source(Samples::I16(greys.iter().map(|v| (*v * 120.0) as i16 - 9000).collect())), count, &all);
        agree::<u16>(&source(Samples::U16(greys.iter().map(|v| (*v * 250.0) as u16).collect())), count, &all);
        agree::<f32>(&source(Samples::F32(greys)), count, &all);
    }
}

#[test]
#[allow(clippy::print_stderr)] // a skip is said aloud
fn slabs_find_the_materials_of_the_engine() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/engine/engine.mha");
    if !path.exists() {
        eprintln!("SKIPPED: {} is not there", path.display());
        return;
    }
    let engine = open(&path, &OpenOptions::default()).unwrap();
    agree::<u8>(engine.as_ref(), None, &[17]);
}

#[test]
fn crossings_are_about_as_many_as_counted() {
    let size = [90, 80, 70];
    let greys = balls(size, 5);
    let table = MaterialTable::new([("air", 20.0), ("a", 90.0), ("b", 210.0)]).unwrap();
    let slab = Slab::whole(&greys, size);
    let class = |voxel| [55.0, 150.0].iter().filter(|t| slab.grey(voxel) >= **t).count();
    let mut counted = 0;
    for z in 0..69 {
        for y in 0..79 {
            for x in 0..89 {
                let own = class([x, y, z]);
                counted += [[x + 1, y, z], [x, y + 1, z], [x, y, z + 1]]
                    .iter()
                    .filter(|v| class(**v) != own)
                    .count();
            }
        }
    }
    let estimated = Survey::of(slab, None).unwrap().crossings(&table) as f64;
    assert!((estimated / counted as f64 - 1.0).abs() < 0.1, "{estimated} {counted}");
}

#[test]
fn a_survey_takes_no_more_memory_than_it_says_however_large_the_volume() {
    for size in [[500, 700, 231], [30_000, 30_000, 30_000], [3, 30_000, 30_000], [1500, 1500, 3]] {
        for sample in [SampleType::U8, SampleType::U16, SampleType::F32] {
            assert!(
                survey_bytes(size, sample) < 330_000_000,
                "{size:?} {sample}: {}",
                survey_bytes(size, sample)
            );
        }
    }
    assert!(survey_bytes([3000; 3], SampleType::F32) < 165_000_000);
}
