//! How much noise a volume has, before anything else is known of it.
//!
//! Second differences `v(i - 2) - 2 v(i) + v(i + 2)` along rows and columns of slices cancel whatever varies
//! slowly; noise of standard deviation s that does not depend on its neighbours leaves √6 s in them. Their
//! median absolute value over 0.6745 is a robust estimate of that (Donoho and Johnstone 1994), which edges
//! disturb little. Differences over one voxel, or the mask of Immerkær (1996), which looks at the finest
//! detail only, would find far too little: reconstruction and smoothing make the noise of neighbouring
//! voxels alike (on the engine by a factor of 1.5, and of 9 for the mask in 3-D). Between slices it is often
//! more alike still, so z is left out.
//!
//! Two classes of grey values by Otsu's threshold are looked at separately, where all five voxels are of the
//! same class and no value is more than 3 standard deviations (by the median) from the class's median, as those
//! of blurred edges are; the noisier class counts: air is often clipped at the lowest grey value and shows no
//! noise then.

use super::histogram::Histogram;
use crate::execution::Execution;
use crate::grid::VoxelBox;
use crate::volume::{SampleType, Samples, VolumeError, VolumeSource};

/// Slices looked at, evenly spaced, and points in each at most, on a grid.
const SLICES: usize = 64;
const POINTS: usize = 1 << 14;
/// Voxels between those that are compared.
const STEP: usize = 2;
/// What is farther than this many standard deviations from its class's median is not looked at.
const USUAL: f64 = 3.0;
/// Bins of the histogram for Otsu's threshold.
const BINS: usize = 256;
/// A class of fewer points, or of less than this share of them, has no say.
const MIN_POINTS: usize = 100;
const MIN_SHARE: f64 = 0.01;

/// A voxel and its neighbours along x and y: itself, left, right, below, above.
type Cross = [f32; 5];

/// The standard deviation of the noise of a volume, in grey values; of 8- and 16-bit samples at least that
/// of rounding, of others at least a millionth of the range, so that it is never 0. Reads at most 64 slices.
///
/// # Errors
/// [`VolumeError`] if the volume cannot be read.
pub fn read_noise(source: &dyn VolumeSource, execution: &Execution) -> Result<f64, VolumeError> {
    let crosses = read(source, execution)?;
    // Whole numbers stand for what was rounded to them.
    let rounding = if source.sample_type() == SampleType::F32 { 0.0 } else { 1.0 };
    let range = crosses
        .iter()
        .flatten()
        .fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], v| [low.min(*v), high.max(*v)]);
    let [low, high] = range.map(f64::from);
    let least = (rounding / 12.0_f64.sqrt()).max(1e-6 * (high - low)).max(f64::from(f32::MIN_POSITIVE));
    if low >= high {
        return Ok(least);
    }
    let mut histogram = Histogram::new(low, high, BINS);
    for cross in &crosses {
        let bin = histogram.bin(f64::from(cross[0]));
        histogram.counts[bin] += 1.0;
    }
    let threshold = (histogram.otsu_means(2).iter().sum::<f64>() * 0.5) as f32;
    let mut classes = [Vec::new(), Vec::new()];
    for cross in &crosses {
        let above = cross.iter().filter(|v| **v >= threshold).count();
        if let Some(class) = [0, 5].iter().position(|n| *n == above) {
            classes[class].push(*cross);
        }
    }
    let enough = (MIN_SHARE * crosses.len() as f64).max(MIN_POINTS as f64);
    let found = classes.iter().filter(|class| class.len() as f64 >= enough);
    let noise = match found.filter_map(|class| deviation(&inside(class, rounding), rounding)).reduce(f64::max)
    {
        Some(noise) => noise,
        // A volume too small or too busy for classes.
        None => deviation(&crosses, rounding).unwrap_or(0.0),
    };
    Ok(noise.max(least))
}

/// Those of a class whose values are all usual in it, which blurred edges are not.
fn inside(class: &[Cross], rounding: f64) -> Vec<Cross> {
    let middle = |values: &mut Vec<f64>| {
        values.sort_unstable_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    };
    let median = middle(&mut class.iter().map(|cross| f64::from(cross[0])).collect());
    let distance = |v: f32| (f64::from(v) - median).abs();
    let spread = middle(&mut class.iter().map(|cross| distance(cross[0])).collect());
    let most = (USUAL / 0.6745 * spread).max(rounding);
    class.iter().filter(|cross| cross.iter().all(|v| distance(*v) <= most)).copied().collect()
}

fn differences(&[own, left, right, below, above]: &Cross) -> [f64; 2] {
    [[left, right], [below, above]].map(|[a, b]| (f64::from(a) - 2.0 * f64::from(own) + f64::from(b)).abs())
}

/// The standard deviation that the median of absolute second differences tells of; values stand for all
/// those within half of `rounding`.
fn deviation(crosses: &[Cross], rounding: f64) -> Option<f64> {
    let mut differences: Vec<f64> = crosses.iter().flat_map(differences).collect();
    let half = differences.len() / 2;
    if half == 0 {
        return None;
    }
    differences.sort_unstable_by(f64::total_cmp);
    let median = differences[half];
    let same = |d: &f64| (*d - median).abs() < 0.5 * rounding;
    let first = differences.partition_point(|d| *d < median && !same(d));
    let count = differences[first..].iter().take_while(|d| same(d)).count().max(1);
    // 0 stands for half as much: the differences have lost their sign.
    let low = (median - 0.5 * rounding).max(0.0);
    let share = (half - first) as f64 / count as f64;
    let median = if rounding > 0.0 { low + share * (median + 0.5 * rounding - low) } else { median };
    Some(median / (0.6745 * 6.0_f64.sqrt()))
}

fn read(source: &dyn VolumeSource, execution: &Execution) -> Result<Vec<Cross>, VolumeError> {
    let [width, height, depth] = source.geometry().size();
    let mut reader = source.slices(&VoxelBox::whole([width, height, depth]))?;
    let inside = |n: usize| n.saturating_sub(2 * STEP);
    let stride =
        (1..).find(|s| inside(width).div_ceil(*s) * inside(height).div_ceil(*s) <= POINTS).unwrap_or(1);
    let count = depth.min(SLICES);
    let mut out = Vec::new();
    for i in 0..count {
        // The middles of as many equal parts.
        let z = (2 * i + 1) * depth / (2 * count);
        let mut slice = Samples::none(source.sample_type());
        reader.read(z..z + 1, &mut slice, execution)?;
        for y in (STEP..height.saturating_sub(STEP)).step_by(stride) {
            for x in (STEP..width.saturating_sub(STEP)).step_by(stride) {
                let at = |x: usize, y: usize| slice.get(y * width + x);
                out.push([at(x, y), at(x - STEP, y), at(x + STEP, y), at(x, y - STEP), at(x, y + STEP)]);
            }
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;
    use crate::grid::Geometry;
    use crate::volume::MemorySource;

    /// A sum of twelve uniform numbers is Gaussian enough.
    fn gaussian(random: &mut rand_chacha::ChaCha8Rng) -> f64 {
        (0..12).map(|_| f64::from(random.next_u32()) / f64::from(u32::MAX)).sum::<f64>() - 6.0
    }

    /// A ball, soft at its edge, in air: noise of the two differs.
    fn ball(sigmas: [f64; 2]) -> (Geometry, Vec<f64>) {
        let size = [60, 50, 40];
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let values = (0..size.iter().product()).map(|i: usize| {
            let p = [i % 60, i / 60 % 50, i / 3000].map(|c| c as f64);
            let d = ((p[0] - 30.0).powi(2) + (p[1] - 25.0).powi(2) + (p[2] - 20.0).powi(2)).sqrt();
            let inside = ((17.0 - d) / 2.0).clamp(0.0, 1.0);
            50.0 + 120.0 * inside + gaussian(&mut random) * (sigmas[0] + inside * (sigmas[1] - sigmas[0]))
        });
        (Geometry::axis_aligned(size, [0.1; 3]).unwrap(), values.collect())
    }

    fn noise(geometry: &Geometry, samples: Samples) -> f64 {
        let source = MemorySource::new(geometry.clone(), samples).unwrap();
        read_noise(&source, &Execution::default()).unwrap()
    }

    #[test]
    fn known_noise_is_found_in_every_number_type() {
        for sigmas in [[3.0, 3.0], [8.0, 8.0], [1.0, 6.0], [5.0, 2.0]] {
            let (geometry, values) = ball(sigmas);
            let true_noise = sigmas[0].max(sigmas[1]);
            let close = |found: f64, scale: f64| {
                assert!((found / scale / true_noise - 1.0).abs() < 0.1, "{sigmas:?}: {found} / {scale}");
            };
            close(noise(&geometry, Samples::F32(values.iter().map(|v| *v as f32).collect())), 1.0);
            close(noise(&geometry, Samples::U8(values.iter().map(|v| v.round() as u8).collect())), 1.0);
            close(noise(&geometry, Samples::U16(values.iter().map(|v| (200.0 * v) as u16).collect())), 200.0);
            close(
                noise(&geometry, Samples::I16(values.iter().map(|v| (90.0 * v - 9000.0) as i16).collect())),
                90.0,
            );
        }
    }

    #[test]
    fn noise_below_rounding_and_clipped_air_are_told() {
        let (geometry, values) = ball([0.4, 0.4]);
        let found = noise(&geometry, Samples::U8(values.iter().map(|v| v.round() as u8).collect()));
        assert!((0.288..0.6).contains(&found), "{found}");
        let (geometry, values) = ball([4.0, 4.0]);
        let clipped = values.iter().map(|v| (v - 80.0).max(0.0).round() as u8).collect();
        let found = noise(&geometry, Samples::U8(clipped));
        assert!((found / 4.0 - 1.0).abs() < 0.1, "{found}");
    }

    #[test]
    fn volumes_without_noise_or_room_have_the_least() {
        let geometry = Geometry::axis_aligned([3, 9, 2], [1.0; 3]).unwrap();
        let least = 1.0 / 12.0_f64.sqrt();
        assert!((noise(&geometry, Samples::U8(vec![4; 54])) - least).abs() < 1e-12);
        assert!(noise(&geometry, Samples::F32((0..54).map(|i| i as f32).collect())) > 0.0);
    }
}
