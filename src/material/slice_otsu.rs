//! One grey value for a volume of two materials: the mode of its slices' Otsu thresholds.
//!
//! After Li et al. (2022) §2.2, eq. 1 and the steps below it: the threshold of each slice is the one that
//! maximises the variance between the two classes (Otsu 1979), and the most frequent of these is the iso
//! value. What the paper leaves open:
//!
//! - *Bins.* 8- and 16-bit values are counted each, `f32` in 65536 bins between the volume's smallest and
//!   largest value.
//! - *Where between two bins.* Material is what is *at or above* the iso value, so a threshold that parts
//!   T from T + 1 is T + 1/2; where several part alike, as bins between the classes are empty, it is the
//!   middle of them. (The paper's T itself would be the lowest of these, less half a grey value.)
//! - *Slices without two classes.* Otsu splits anything, also noise. A slice has two classes if the means
//!   of its classes are at least [`CONTRAST_SHARE`] as far apart as those of the whole volume's histogram;
//!   others have no say.
//! - *The mode.* Thresholds of more than 8 bits hardly ever agree to the last bit. The mode is the
//!   median of the thresholds in the window that holds most of them, as wide as a 256th of the distance
//!   between the volume's class means, or a bin if that is wider: for 8 bits it is the mode as written.
//!   Of windows that hold equally many the one nearest to the median of all thresholds counts.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::counts::{GreyCounts, range};
use super::find::FindError;
use crate::volume::{Sample, SampleWindow, Slab, VolumeError};

/// Least distance of a slice's class means, as a share of that of the whole volume. Noise of standard
/// deviation s is split into halves 1.6 s apart, so empty slices are known as such where the contrast is
/// more than 3.2 times the noise; below that no threshold makes sense.
pub const CONTRAST_SHARE: f64 = 0.5;

/// The window of the mode is this part of the distance between the class means.
const WINDOWS: f64 = 256.0;

/// An iso value found from the slices of a volume.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OtsuMode {
    /// The iso value: a grey value.
    pub grey: f64,
    /// Slices of the volume.
    pub slices: u64,
    /// Slices with two classes of grey values, which have a threshold.
    pub with_two_classes: u64,
    /// Those among them whose threshold agrees with the iso value to within the window.
    pub agreeing: u64,
    /// Width of that window in grey values.
    pub window: f64,
}

/// How Otsu's method splits a histogram.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Split {
    threshold: f64,
    means: [f64; 2],
}

impl Split {
    fn contrast(&self) -> f64 {
        self.means[1] - self.means[0]
    }
}

/// The Otsu thresholds of a volume's slices and of the whole; see the module's header.
#[derive(Debug, Clone, PartialEq)]
pub struct SliceThresholds {
    slices: Vec<Option<Split>>,
    whole: Option<Split>,
    /// Some grey value, and the distance between neighbouring bins.
    low: f32,
    step: f64,
}

impl SliceThresholds {
    /// Reads a volume by slabs of `thickness` slices in one pass (two for `f32`, whose range must be known
    /// first).
    ///
    /// # Errors
    /// [`VolumeError`] if the volume cannot be read.
    pub fn read<S: Sample>(window: &mut SampleWindow<'_, S>, thickness: usize) -> Result<Self, VolumeError> {
        let mut ends = [f32::INFINITY, f32::NEG_INFINITY];
        if S::LEVELS == 0 {
            window.sweep(thickness, 0, |slab, core| {
                let [low, high] = range(slab, core);
                ends = [ends[0].min(low), ends[1].max(high)];
                Ok::<_, VolumeError>(())
            })?;
        }
        let empty = GreyCounts::new::<S>(ends);
        let (mut whole, mut slices) = (empty.clone(), Vec::with_capacity(window.size()[2]));
        window.sweep(thickness, 0, |slab, core| {
            whole.add(slab, core.clone());
            slices.par_extend(core.into_par_iter().map(|z| split(&slice(&empty, slab, z..z + 1))));
            Ok::<_, VolumeError>(())
        })?;
        Ok(Self { slices, whole: split(&whole), low: whole.low, step: whole.bin_width() })
    }

    /// The mode of the slices' thresholds.
    ///
    /// # Errors
    /// [`FindError::Constant`] for a volume of one grey value, [`FindError::NoTwoClasses`] if no slice has
    /// two classes.
    pub fn mode(&self) -> Result<OtsuMode, FindError> {
        let whole = self.whole.ok_or(FindError::Constant { value: self.low })?;
        let wanted = CONTRAST_SHARE * whole.contrast();
        let splits = self.slices.iter().flatten().filter(|split| split.contrast() >= wanted);
        let mut thresholds: Vec<f64> = splits.map(|split| split.threshold).collect();
        thresholds.sort_by(f64::total_cmp);
        let slices = self.slices.len();
        let &median = thresholds.get(thresholds.len() / 2).ok_or(FindError::NoTwoClasses { slices })?;
        // Of half a bin at least: thresholds of 8 bits lie half a bin apart where bins are empty.
        let window = (whole.contrast() / WINDOWS).max(0.5 * self.step);
        let held = |first: usize| {
            let end = thresholds.partition_point(|t| *t < thresholds[first] + window);
            &thresholds[first..end]
        };
        let distance = |held: &[f64]| (held[held.len() / 2] - median).abs();
        let best = (0..thresholds.len())
            .map(held)
            .max_by(|a, b| a.len().cmp(&b.len()).then(distance(b).total_cmp(&distance(a))))
            .unwrap_or(&thresholds);
        Ok(OtsuMode {
            grey: best[best.len() / 2],
            slices: slices as u64,
            with_two_classes: thresholds.len() as u64,
            agreeing: best.len() as u64,
            window,
        })
    }
}

fn slice<S: Sample>(empty: &GreyCounts, slab: Slab<'_, S>, z: Range<usize>) -> GreyCounts {
    let mut counts = empty.clone();
    counts.add(slab, z);
    counts
}

/// Otsu's split of all that was counted (Li et al. eq. 1 and steps 1 to 4, with counts in place of
/// shares); `None` if there is one grey value only.
fn split(counts: &GreyCounts) -> Option<Split> {
    // About some grey value of the volume, as grey values may lie far from 0.
    let base = f64::from(counts.low);
    let values = || counts.iter().filter(|(_, count)| *count > 0).map(|(v, n)| (v - base, n as f64));
    let (total, sum) = values().fold((0.0, 0.0), |(total, sum), (v, n)| (total + n, sum + n * v));
    let (mut below, mut below_sum) = (0.0, 0.0);
    let (mut best, mut most) = (None, f64::NEG_INFINITY);
    for ((v, n), (next, _)) in values().zip(values().skip(1)) {
        below += n;
        below_sum += n * v;
        let above = total - below;
        let means = [below_sum / below, (sum - below_sum) / above];
        let variance = below * above * (means[1] - means[0]).powi(2);
        if variance > most {
            most = variance;
            best = Some(Split { threshold: base + 0.5 * (v + next), means: means.map(|m| base + m) });
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::execution::Execution;
    use crate::grid::Geometry;
    use crate::material::Histogram;
    use crate::volume::{MemorySource, Samples};

    const SIDE: usize = 40;

    /// A number between 0 and 1 that looks random.
    fn random(i: usize) -> f64 {
        let mut x = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        x = (x ^ x >> 31).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        ((x ^ x >> 29) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Slices of grey values around 50 and, for a share of the voxels, around 150, noise from -15 to 15.
    fn slices(shares: &[f64]) -> Vec<f64> {
        let value = |z: usize, i: usize| {
            let n = z * SIDE * SIDE + i;
            let bright = random(3 * n) < shares[z];
            let noise = 5.0 * (random(3 * n + 1) + random(3 * n + 2) + random(7 * n) - 1.5);
            if bright { 150.0 + 2.0 * noise } else { 50.0 + noise }
        };
        (0..shares.len()).flat_map(|z| (0..SIDE * SIDE).map(move |i| value(z, i))).collect()
    }

    fn mode_of(samples: Samples, thickness: usize) -> Result<OtsuMode, FindError> {
        let depth = samples.len() / (SIDE * SIDE);
        let geometry = Geometry::axis_aligned([SIDE, SIDE, depth], [1.0; 3]).unwrap();
        let (sample, source) = (samples.sample_type(), MemorySource::new(geometry, samples).unwrap());
        let execution = Execution::default();
        crate::with_sample_type!(sample, S => {
            let mut window = SampleWindow::<S>::new(&source, &execution).unwrap();
            SliceThresholds::read(&mut window, thickness).unwrap().mode()
        })
    }

    #[test]
    fn empty_and_full_slices_do_not_spoil_the_mode() {
        let shares = [0.0, 0.0, 0.3, 0.4, 0.0, 0.5, 0.35, 1.0, 1.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let grey = slices(&shares);
        let types = [
            (1.0, Samples::U8(grey.iter().map(|v| v.round() as u8).collect())),
            (200.0, Samples::U16(grey.iter().map(|v| (200.0 * v) as u16).collect())),
            (100.0, Samples::I16(grey.iter().map(|v| (100.0 * v - 9000.0) as i16).collect())),
            (0.01, Samples::F32(grey.iter().map(|v| (0.01 * v) as f32).collect())),
        ];
        for (scale, samples) in types {
            let offset = if matches!(samples, Samples::I16(_)) { -9000.0 } else { 0.0 };
            let found = mode_of(samples.clone(), 16).unwrap();
            assert!((85.0..115.0).contains(&((found.grey - offset) / scale)), "{found:?}");
            assert_eq!((found.slices, found.with_two_classes), (16, 5), "{found:?}");
            assert!(found.agreeing >= 1);
            for thickness in [1, 5] {
                assert_eq!(mode_of(samples.clone(), thickness).unwrap(), found);
            }
        }
        // Without the rule most slices would have their say: those of noise only lie near 50 and 150.
        let noise = mode_of(Samples::F32(slices(&[0.0; 3]).iter().map(|v| *v as f32).collect()), 3).unwrap();
        assert!((noise.grey - 50.0).abs() < 5.0, "{noise:?}");
    }

    #[test]
    fn the_most_frequent_threshold_wins_and_says_how_often_it_was_seen() {
        // Two grey values in each slice: the threshold lies halfway.
        let tops = [100u8, 104, 120, 120, 124, 120, 90, 20];
        let samples: Vec<u8> = tops
            .iter()
            .flat_map(|&top| (0..SIDE * SIDE).map(move |i| if i % 3 == 0 { top } else { 20 }))
            .collect();
        let found = mode_of(Samples::U8(samples), 8).unwrap();
        assert!((found.grey - 70.0).abs() < 1e-12, "{found:?}");
        assert_eq!((found.slices, found.with_two_classes, found.agreeing), (8, 7, 3));
    }

    #[test]
    fn a_slice_is_split_as_the_histogram_of_the_module_would_split_it() {
        let samples: Vec<u8> = slices(&[0.3]).iter().map(|v| v.round() as u8).collect();
        let mut histogram = Histogram::new(-0.5, 255.5, 256);
        samples.iter().for_each(|v| histogram.counts[usize::from(*v)] += 1.0);
        let means = histogram.otsu_means(2);
        let mut counts = GreyCounts::new::<u8>([0.0; 2]);
        counts.add(Slab::whole(&samples, [SIDE, SIDE, 1]), 0..1);
        let found = split(&counts).unwrap();
        assert!((found.means[0] - means[0]).abs() < 1e-9 && (found.means[1] - means[1]).abs() < 1e-9);
    }

    #[test]
    fn volumes_without_two_classes_are_refused() {
        let flat = mode_of(Samples::U16(vec![7; SIDE * SIDE * 2]), 2).unwrap_err();
        assert_eq!(flat, FindError::Constant { value: 7.0 });
        let steps: Vec<f32> = (0..3).flat_map(|z| [z as f32; SIDE * SIDE]).collect();
        assert_eq!(mode_of(Samples::F32(steps), 2).unwrap_err(), FindError::NoTwoClasses { slices: 3 });
    }
}
