//! [`GreyCounts`]: how often each grey value occurs, counted one slab at a time.

use std::ops::Range;

use rayon::prelude::*;

use super::histogram::Histogram;
use crate::volume::{Sample, Slab};

/// Bins for types whose values are too many to count each.
const FINE: usize = 1 << 16;

/// Counts of grey values: one per value of an 8- or 16-bit type, one per 65536th of the range of `f32`.
#[derive(Debug, Clone, PartialEq)]
pub struct GreyCounts {
    /// The smallest grey value.
    pub low: f32,
    /// The largest grey value.
    pub high: f32,
    /// The value that `counts` begins with.
    first: f64,
    /// The range of values of a bin; 0 if all values are the same.
    width: f64,
    /// Whether a bin stands for one value, and not for the range above it.
    exact: bool,
    counts: Vec<u64>,
    sum: f64,
    squares: f64,
}

impl GreyCounts {
    /// Nothing counted yet. `range` holds all values to come; it matters only for types with too many
    /// values to count each.
    pub(super) fn new<S: Sample>([low, high]: [f32; 2]) -> Self {
        let exact = S::LEVELS > 0;
        let bins = if exact { S::LEVELS } else { FINE };
        let first = if exact { S::at_level(0).to_f32() } else { low };
        let width = if exact { 1.0 } else { (f64::from(high) - f64::from(low)) / FINE as f64 };
        let (low, high) = if exact { (f32::INFINITY, f32::NEG_INFINITY) } else { (low, high) };
        let (first, counts) = (f64::from(first), vec![0; bins]);
        Self { low, high, first, width, exact, counts, sum: 0.0, squares: 0.0 }
    }

    /// Counts the samples of the slices `core`.
    pub(super) fn add<S: Sample>(&mut self, slab: Slab<'_, S>, core: Range<usize>) {
        let rows = rows(slab, core);
        let (low, range) = (self.first, f64::from(self.high) - self.first);
        let scale = if range > 0.0 { FINE as f64 / range } else { 0.0 };
        let bins = self.counts.len();
        // Few tables: each must be cleared and added up.
        let share = rows.len().div_ceil(rayon::current_num_threads()).max(1);
        let tables: Vec<Vec<u32>> = rows
            .par_chunks(share)
            .map(|rows| {
                let mut counts = vec![0u32; bins];
                for &v in rows.iter().copied().flatten() {
                    let bin = if S::LEVELS > 0 {
                        v.level()
                    } else {
                        (((f64::from(v.to_f32()) - low) * scale).max(0.0) as usize).min(FINE - 1)
                    };
                    counts[bin] += 1;
                }
                counts
            })
            .collect();
        for table in &tables {
            self.counts.iter_mut().zip(table).for_each(|(total, part)| *total += u64::from(*part));
        }
        if S::LEVELS > 0 {
            self.update_range();
        } else {
            self.add_sums(&rows);
        }
    }

    /// Sums of differences to the middle of the range: no cancellation for far offsets. Row after row in
    /// order, so that slabs and threads do not matter.
    fn add_sums<S: Sample>(&mut self, rows: &[&[S]]) {
        let middle = self.middle();
        let sums: Vec<[f64; 2]> = rows
            .par_iter()
            .map(|row| {
                row.iter()
                    .map(|v| f64::from(v.to_f32()) - middle)
                    .fold([0.0; 2], |[s, q], d| [s + d, q + d * d])
            })
            .collect();
        for [sum, squares] in sums {
            self.sum += sum;
            self.squares += squares;
        }
    }

    fn update_range(&mut self) {
        let value = |i: Option<usize>| i.map(|i| (self.first + i as f64) as f32);
        let low = value(self.counts.iter().position(|&c| c > 0));
        let high = value(self.counts.iter().rposition(|&c| c > 0));
        (self.low, self.high) = (low.unwrap_or(self.low), high.unwrap_or(self.high));
    }

    fn middle(&self) -> f64 {
        if self.exact { 0.0 } else { 0.5 * (f64::from(self.low) + f64::from(self.high)) }
    }

    /// Values counted.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// The counted values (for `f32`: the middles of ranges) and how often they occur, in ascending
    /// order, from the smallest to the largest that occurs.
    pub fn iter(&self) -> impl Iterator<Item = (f64, u64)> + Clone {
        let first = self.counts.iter().position(|&c| c > 0).unwrap_or(0);
        let end = self.counts.iter().rposition(|&c| c > 0).map_or(0, |last| last + 1);
        let shift = if self.exact { 0.0 } else { 0.5 * self.width };
        (first..end).map(move |i| (self.first + i as f64 * self.width + shift, self.counts[i]))
    }

    /// The distance between neighbouring values that are told apart.
    pub(super) fn bin_width(&self) -> f64 {
        self.width
    }

    /// Mean and standard deviation.
    #[must_use]
    pub fn mean_and_deviation(&self) -> (f64, f64) {
        let n = self.total().max(1) as f64;
        if self.exact {
            let mean = self.iter().map(|(v, c)| v * c as f64).sum::<f64>() / n;
            let squares: f64 = self.iter().map(|(v, c)| (v - mean).powi(2) * c as f64).sum();
            return (mean, (squares / n).sqrt());
        }
        let mean = self.sum / n;
        (self.middle() + mean, (self.squares / n - mean * mean).max(0.0).sqrt())
    }

    /// The histogram between the smallest and the largest value; `bins` must divide 65536. `None` if all
    /// values are the same.
    #[must_use]
    pub fn histogram(&self, bins: usize) -> Option<Histogram> {
        let (low, high) = (f64::from(self.low), f64::from(self.high));
        if !(low.is_finite() && high.is_finite() && low < high) {
            return None;
        }
        let scale = bins as f64 / (high - low);
        let mut histogram = Histogram::new(low, high, bins);
        for (i, &count) in self.counts.iter().enumerate().filter(|(_, c)| **c > 0) {
            let bin = if self.exact {
                let value = self.first + i as f64;
                (((value - low) * scale).max(0.0) as usize).min(bins - 1)
            } else {
                // A power of two finer: the same bin as if counted in `bins` at once.
                i / (FINE / bins)
            };
            histogram.counts[bin] += count as f64;
        }
        Some(histogram)
    }
}

/// Smallest and largest value of the slices `core`.
pub(super) fn range<S: Sample>(slab: Slab<'_, S>, core: Range<usize>) -> [f32; 2] {
    let none = [f32::INFINITY, f32::NEG_INFINITY];
    rows(slab, core)
        .par_iter()
        .map(|row| {
            row.iter().fold(none, |[low, high], v| {
                let v = v.to_f32();
                [if v < low { v } else { low }, if v > high { v } else { high }]
            })
        })
        .reduce(|| none, |a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

/// The rows of the slices `core`.
pub(super) fn rows<S: Sample>(slab: Slab<'_, S>, core: Range<usize>) -> Vec<&[S]> {
    core.flat_map(|z| (0..slab.size()[1]).map(move |y| slab.row(y, z))).collect()
}
