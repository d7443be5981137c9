//! Filters against what their definitions say, voxel by voxel; slabs, boxes and threads; what they do to
//! edges and noise.

use std::sync::atomic::Ordering;

use proptest::prelude::*;
use rand::{Rng, SeedableRng};

use super::*;
use crate::execution::Execution;
use crate::grid::{Geometry, VoxelBox};
use crate::volume::{MemorySource, SampleType, Samples, VolumeError, VolumeSource};

fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut uniform = || f64::from(random.next_u32()) / f64::from(u32::MAX);
    (0..count).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect()
}

fn volume(size: [usize; 3], spacing: [f64; 3], samples: Samples) -> MemorySource {
    MemorySource::new(Geometry::axis_aligned(size, spacing).unwrap(), samples).unwrap()
}

fn filtered(source: &dyn VolumeSource, denoise: Denoise) -> Vec<f32> {
    let Samples::F32(values) = Denoised::new(source, denoise).unwrap().read_all().unwrap() else { panic!() };
    values
}

/// A filter by its definition, in double precision: every voxel with every other one.
fn naive(source: &MemorySource, denoise: &Denoise) -> Vec<f64> {
    let (geometry, samples) = (source.geometry(), source.in_memory().unwrap());
    let ([nx, ny, nz], spacing) = (geometry.size(), geometry.spacing());
    let places = || (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])));
    let grey = |[x, y, z]: [usize; 3]| f64::from(samples.get((z * ny + y) * nx + x));
    let apart = |p: [usize; 3], q: [usize; 3]| [0, 1, 2].map(|a| (q[a] as f64 - p[a] as f64) * spacing[a]);
    let square = |d: [f64; 3]| d.iter().map(|c| c * c).sum::<f64>();
    let mm = |length: Length| length.mm(geometry) + 1e-7;
    let mean = |p: [usize; 3], weight: &dyn Fn([usize; 3]) -> f64| {
        let sums = places().fold([0.0, 0.0], |[w, s], q| [w + weight(q), s + weight(q) * grey(q)]);
        assert!(sums[0] > 0.0, "{p:?}");
        sums[1] / sums[0]
    };
    let nearest = |p: [usize; 3], by: [isize; 3]| {
        [0, 1, 2].map(|a| p[a].saturating_add_signed(by[a]).min([nx, ny, nz][a] - 1))
    };
    let one = |p: [usize; 3]| match *denoise {
        Denoise::Mean { radius } => mean(p, &|q| {
            if apart(p, q).iter().all(|d| d.abs() <= mm(radius)) { 1.0 } else { 0.0 }
        }),
        Denoise::Gaussian { sigma } => mean(p, &|q| {
            let d = apart(p, q);
            let inside = d.iter().all(|d| d.abs() <= 3.0 * mm(sigma));
            if inside { (-0.5 * square(d) / mm(sigma).powi(2)).exp() } else { 0.0 }
        }),
        Denoise::Median { radius } => {
            let mut values: Vec<f64> =
                places().filter(|q| square(apart(p, *q)).sqrt() <= mm(radius)).map(grey).collect();
            values.sort_by(f64::total_cmp);
            0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
        }
        Denoise::Bilateral { sigma, grey: range } => mean(p, &|q| {
            let d = square(apart(p, q));
            if d.sqrt() > 2.5 * mm(sigma) {
                return 0.0;
            }
            let difference = (grey(q) - grey(p)) / range.unwrap();
            (-0.5 * d / mm(sigma).powi(2)).exp()
                * kernel::falling((0.5 * difference * difference) as f32) as f64
        }),
        Denoise::Nlm { search, patch, grey: range } => {
            let reach = kernel::reach(patch.mm(geometry), spacing).map(|n| n as isize);
            mean(p, &|q| {
                if square(apart(p, q)).sqrt() > mm(search) {
                    return 0.0;
                }
                let (mut sum, mut count) = (0.0, 0.0);
                for z in -reach[2]..=reach[2] {
                    for y in -reach[1]..=reach[1] {
                        for x in -reach[0]..=reach[0] {
                            sum += (grey(nearest(p, [x, y, z])) - grey(nearest(q, [x, y, z]))).powi(2);
                            count += 1.0;
                        }
                    }
                }
                kernel::falling((sum / count / range.unwrap().powi(2)) as f32) as f64
            })
        }
    };
    places().map(one).collect()
}

fn some_filter() -> impl Strategy<Value = Denoise> {
    let length = || (0.9..2.2f64).prop_map(Length::Voxels);
    let short = || (0.4..0.85f64).prop_map(Length::Voxels);
    let grey = || (5.0..60.0f64).prop_map(Some);
    prop_oneof![
        length().prop_map(|radius| Denoise::Mean { radius }),
        short().prop_map(|sigma| Denoise::Gaussian { sigma }),
        length().prop_map(|radius| Denoise::Median { radius }),
        (short(), grey()).prop_map(|(sigma, grey)| Denoise::Bilateral { sigma, grey }),
        (length(), 0.3..2.1f64, grey()).prop_map(|(search, patch, grey)| Denoise::Nlm {
            search,
            patch: Length::Voxels(patch),
            grey
        }),
    ]
}

fn samples(size: [usize; 3], sample: u8, seed: u64) -> Samples {
    let values = noise(size.iter().product(), seed);
    match sample {
        0 => Samples::U8(values.iter().map(|v| (100.0 + 20.0 * v) as u8).collect()),
        1 => Samples::U16(values.iter().map(|v| (60000.0 + 20.0 * v) as u16).collect()),
        2 => Samples::I16(values.iter().map(|v| (-20.0 + 20.0 * v) as i16).collect()),
        _ => Samples::F32(values.iter().map(|v| (20.0 * v) as f32).collect()),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn filters_are_what_their_definitions_say(
        size in [1..24usize, 1..8usize, 1..7usize],
        spacing in [0.05..0.15f64, 0.05..0.15f64, 0.05..0.3f64],
        filter in some_filter(),
        sample in 0..4u8,
        seed: u64,
    ) {
        let source = volume(size, spacing, samples(size, sample, seed));
        prop_assume!(filter.check(source.geometry()).is_ok());
        let expected = naive(&source, &filter);
        for (found, expected) in filtered(&source, filter).iter().zip(&expected) {
            let error = (f64::from(*found) - expected).abs();
            // Single precision: some eight roundings at full scale (60,000 was 0.0204 off, 0.0200 were allowed).
            prop_assert!(error < 2e-3 + 5e-7 * expected.abs(), "{filter}: {found} for {expected}");
        }
    }

    #[test]
    fn slabs_boxes_and_threads_change_no_bit(
        size in [1..40usize, 1..12usize, 1..20usize],
        thick in 0.5..2.0f64,
        filter in some_filter(),
        sample in 0..4u8,
        slices in 1..7usize,
        threads in 1..4usize,
        cut in prop::array::uniform3((0.0..1.0f64, 0.0..1.0f64)),
        seed: u64,
    ) {
        let source = volume(size, [0.1, 0.1, 0.1 * thick], samples(size, sample, seed));
        prop_assume!(filter.check(source.geometry()).is_ok());
        let whole = filtered(&source, filter);
        let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let slabs = Denoised::new(&source, filter).unwrap().with_slices(slices);
        let execution = Execution::default();
        let folder = tempfile::tempdir().unwrap();
        let (memory, file, again) = pool.install(|| {
            let stage = execution.stage("test", 0);
            let memory = slabs.in_memory(&execution, &stage).unwrap();
            let file = slabs.in_file(folder.path(), &execution, &stage).unwrap();
            (memory.read_all().unwrap(), file.read_all().unwrap(), slabs.read_all().unwrap())
        });
        for found in [memory, file, again] {
            let Samples::F32(found) = found else { panic!() };
            prop_assert_eq!(bits(&found), bits(&whole));
        }
        let low = [0, 1, 2].map(|a| (cut[a].0 * size[a] as f64) as usize);
        let part = VoxelBox {
            low,
            high: [0, 1, 2].map(|a| low[a] + 1 + (cut[a].1 * (size[a] - low[a]) as f64) as usize).map(|n| n),
        };
        let part = VoxelBox { high: [0, 1, 2].map(|a| part.high[a].min(size[a])), ..part };
        let whole = MemorySource::new(source.geometry().clone(), Samples::F32(whole)).unwrap();
        let (Samples::F32(a), Samples::F32(b)) = (whole.read(&part).unwrap(), slabs.read(&part).unwrap()) else { panic!() };
        prop_assert_eq!(bits(&a), bits(&b));
    }
}

const EDGE: f64 = 15.3;

/// A step of 100 grey values at x = 15.3, sharp but for the voxel it goes through, and noise of 5.
fn step(seed: u64) -> MemorySource {
    let size = [32, 20, 20];
    let noise = noise(32 * 20 * 20, seed);
    let value = |i: usize| 50.0 + 100.0 * ((i % 32) as f64 + 0.5 - EDGE).clamp(0.0, 1.0) + 5.0 * noise[i];
    volume(size, [0.1; 3], Samples::F32((0..noise.len()).map(|i| value(i) as f32).collect()))
}

/// Standard deviation far from the edge, and the width of the edge: voxels from 60 to 140 in the mean of
/// all rows.
fn noise_and_width(values: &[f32]) -> (f64, f64) {
    let mean = |x: usize| {
        let column: Vec<f64> = values.chunks(32).map(|row| f64::from(row[x])).collect();
        let mean = column.iter().sum::<f64>() / column.len() as f64;
        (mean, column.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / column.len() as f64)
    };
    let noise = (4..10).chain(22..28).map(|x| mean(x).1).sum::<f64>() / 12.0;
    let profile: Vec<f64> = (0..32).map(|x| mean(x).0).collect();
    let at = |grey: f64| {
        let x = profile.iter().position(|v| *v >= grey).unwrap();
        x as f64 - (profile[x] - grey) / (profile[x] - profile[x - 1])
    };
    (noise.sqrt(), at(140.0) - at(60.0))
}

#[test]
fn noise_goes_and_edges_stay_with_bilateral_median_and_nlm_only() {
    let source = step(3);
    let Some(Samples::F32(raw)) = source.in_memory() else { panic!() };
    let (before, sharp) = noise_and_width(raw);
    assert!((before - 5.0).abs() < 0.1 && sharp < 1.5, "{before} {sharp}");
    for (filter, most_noise, keeps) in [
        ("bilateral", 1.4, true),
        ("median", 1.9, true),
        ("nlm", 1.9, true),
        ("gaussian", 1.1, false),
        ("mean", 1.1, false),
    ] {
        let filter = filter.parse::<Denoise>().unwrap().with_noise(5.0);
        let (after, width) = noise_and_width(&filtered(&source, filter));
        println!("{filter}: noise {after:.2}, edge {width:.2} of {sharp:.2} voxels");
        assert!(after < most_noise, "{filter}: {after}");
        let kept = width < sharp + 0.25;
        assert_eq!(kept, keeps, "{filter}: the edge is {width} wide, was {sharp}");
        assert!(keeps || width > sharp + 0.5, "{filter}: {width}");
    }
}

#[test]
fn constant_volumes_stay_as_they_are() {
    for grey in [0.0, -1234.5, 65535.0] {
        let source = volume([9, 8, 7], [0.1, 0.1, 0.2], Samples::F32(vec![grey; 504]));
        for filter in ["bilateral", "median", "nlm", "gaussian", "mean"] {
            let filter = filter.parse::<Denoise>().unwrap().with_noise(1.0);
            let out = filtered(&source, filter);
            assert!(out.iter().all(|v| (v - grey).abs() <= 2e-7 * grey.abs()), "{filter}: {out:?}");
        }
    }
}

#[test]
fn parameters_that_make_no_sense_here_are_refused_with_the_limit() {
    let geometry = Geometry::axis_aligned([50; 3], [0.1, 0.1, 0.4]).unwrap();
    let refused = |text: &str| text.parse::<Denoise>().unwrap().check(&geometry).unwrap_err();
    assert!(matches!(refused("median:radius=1.75mm"), DenoiseError::Reach { parameter: "radius", .. }));
    assert!(
        refused("bilateral:sigma=1mm").to_string().contains("25 voxels"),
        "{}",
        refused("bilateral:sigma=1mm")
    );
    assert!(matches!(refused("nlm:search=1mm,patch=0.7mm"), DenoiseError::Reach { .. }));
    assert!(matches!(refused("mean:radius=1e300mm"), DenoiseError::Reach { .. }));
    assert!(matches!(refused("mean:radius=0.09mm"), DenoiseError::Idle { .. }));
    assert!("mean:radius=1.6mm".parse::<Denoise>().unwrap().check(&geometry).is_ok());
    let nan = Denoise::Bilateral { sigma: Length::Mm(0.1), grey: Some(f64::NAN) };
    assert!(matches!(nan.check(&geometry), Err(DenoiseError::Grey { filter: "bilateral", .. })));
}

/// A volume with a sample that is not a number, as no reader would yield it.
struct Damaged(Geometry);

impl VolumeSource for Damaged {
    fn geometry(&self) -> &Geometry {
        &self.0
    }
    fn sample_type(&self) -> SampleType {
        SampleType::F32
    }
    fn cheap_partial_reads(&self) -> bool {
        true
    }
    fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
        let mut values = vec![1.0; part.size().iter().product()];
        values[0] = f32::NAN;
        Ok(Samples::F32(values))
    }
}

#[test]
fn what_is_not_finite_never_comes_out_and_filtering_stops_when_told() {
    let damaged = Damaged(Geometry::axis_aligned([8; 3], [1.0; 3]).unwrap());
    let denoised = Denoised::new(&damaged, "mean".parse().unwrap()).unwrap();
    assert!(matches!(denoised.read_all(), Err(VolumeError::NotFinite { .. })));
    let huge = volume([4; 3], [1.0; 3], Samples::F32(vec![f32::MAX; 64]));
    let denoised = Denoised::new(&huge, "mean".parse().unwrap()).unwrap();
    assert!(matches!(denoised.read_all(), Err(VolumeError::NotFinite { .. })));
    let (source, execution) = (step(1), Execution::default());
    execution.cancel_flag().store(true, Ordering::Relaxed);
    for filter in ["bilateral", "median", "nlm", "gaussian", "mean"] {
        let denoised = Denoised::new(&source, filter.parse::<Denoise>().unwrap().with_noise(1.0)).unwrap();
        let outcome = denoised.in_memory(&execution, &execution.stage("test", 0));
        assert!(matches!(outcome, Err(VolumeError::Cancelled(_))), "{filter}");
    }
}

#[test]
fn a_filtered_volume_says_so_and_tells_what_it_takes() {
    let source = step(2);
    let denoised = Denoised::new(&source, "mean:radius=2".parse().unwrap()).unwrap();
    assert_eq!(denoised.notes(), ["noise was filtered: mean:radius=2"]);
    assert_eq!(denoised.sample_type(), SampleType::F32);
    assert!(denoised.bytes(4) >= 4 * 32 * 20 * (8 + 4) && denoised.bytes(8) > denoised.bytes(4));
}
