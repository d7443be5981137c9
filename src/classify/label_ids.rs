//! Which labels a segmented volume holds, found slab by slab.

use std::ops::Range;

use rayon::prelude::*;

use super::bit_planes::WORD;
use super::error::ClassifyError;
use crate::grid::MaterialId;
use crate::volume::{Sample, Slab};

/// Counts the labels of a volume.
#[derive(Debug, Clone, Default)]
pub struct LabelIds {
    /// Labels, ascending, and their voxels.
    found: Vec<(f32, u64)>,
}

/// The labels of a volume: the one at position i is material i.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownLabels {
    labels: Vec<f64>,
    voxels: Vec<u64>,
}

impl LabelIds {
    /// Adds the slices `core` of a slab.
    ///
    /// # Errors
    /// [`ClassifyError::TooManyLabels`].
    pub fn add<S: Sample>(&mut self, slab: Slab<'_, S>, core: Range<usize>) -> Result<(), ClassifyError> {
        let ys = 0..slab.size()[1];
        let rows = core.into_par_iter().flat_map_iter(|z| ys.clone().map(move |y| slab.row(y, z)));
        let arch = pulp::Arch::new();
        let found = rows
            .fold(Tally::default, |tally, row| arch.dispatch(|| tally.with_row(row)))
            .map(Tally::finish)
            .reduce(Vec::new, |a, b| b.into_iter().fold(a, insert));
        self.found = found.into_iter().fold(std::mem::take(&mut self.found), insert);
        let limit = MaterialId::MAX_COUNT;
        if self.found.len() > limit { Err(ClassifyError::TooManyLabels { limit }) } else { Ok(()) }
    }

    /// The labels, once all slices were added.
    ///
    /// # Errors
    /// [`ClassifyError::OneLabel`].
    pub fn finish(self) -> Result<KnownLabels, ClassifyError> {
        let labels: Vec<f64> = self.found.iter().map(|l| f64::from(l.0)).collect();
        if let [label] = labels[..] {
            return Err(ClassifyError::OneLabel { label });
        }
        Ok(KnownLabels { labels, voxels: self.found.into_iter().map(|l| l.1).collect() })
    }
}

/// Counts labels, those seen first 64 voxels at a time.
struct Tally<S> {
    seen: Vec<(S, u64)>,
    others: Vec<(f32, u64)>,
}

impl<S> Default for Tally<S> {
    fn default() -> Self {
        Self { seen: Vec::new(), others: Vec::new() }
    }
}

impl<S: Sample> Tally<S> {
    #[inline(always)]
    fn with_row(mut self, row: &[S]) -> Self {
        let (blocks, rest) = row.as_chunks::<WORD>();
        for block in blocks {
            let mut counts = [0u8; SEEN];
            for (count, (label, _)) in counts.iter_mut().zip(&self.seen) {
                *count = block.iter().map(|v| u8::from(v == label)).sum();
            }
            if counts.iter().sum::<u8>() == WORD as u8 {
                self.seen.iter_mut().zip(counts).for_each(|((_, sum), count)| *sum += u64::from(count));
            } else {
                self.add_runs(block);
            }
        }
        self.add_runs(rest);
        self
    }

    fn add_runs(&mut self, samples: &[S]) {
        for run in samples.chunk_by(|a, b| a == b) {
            note(&mut self.seen, run[0], 0);
            self.others = insert(std::mem::take(&mut self.others), (run[0].to_f32(), run.len() as u64));
        }
    }

    fn finish(self) -> Vec<(f32, u64)> {
        let seen = self.seen.into_iter().filter(|(_, n)| *n != 0).map(|(label, n)| (label.to_f32(), n));
        seen.fold(self.others, insert)
    }
}

/// Most labels that are looked for in 64 voxels at once; with more, runs are looked at one by one.
const SEEN: usize = 8;

/// Adds a label to those to be looked for, if there is room.
pub(super) fn note<S: Sample, T>(seen: &mut Vec<(S, T)>, label: S, value: T) {
    if seen.len() < SEEN && seen.iter().all(|(known, _)| *known != label) {
        seen.push((label, value));
    }
}

impl KnownLabels {
    /// The labels, ascending.
    #[must_use]
    pub fn labels(&self) -> &[f64] {
        &self.labels
    }

    /// Voxels of each.
    #[must_use]
    pub fn voxels(&self) -> &[u64] {
        &self.voxels
    }

    /// The material of a label; 0 for one that is not known.
    #[must_use]
    pub(super) fn id(&self, label: f32) -> u8 {
        let at = self.labels.partition_point(|&l| l < f64::from(label));
        if at < self.labels.len() { at as u8 } else { 0 }
    }
}

fn insert(mut found: Vec<(f32, u64)>, (label, voxels): (f32, u64)) -> Vec<(f32, u64)> {
    // Makes the two zeros of a float volume one label.
    let label = label + 0.0;
    match found.binary_search_by(|l| l.0.total_cmp(&label)) {
        Ok(at) => found[at].1 += voxels,
        // One more than the limit is enough to refuse.
        Err(at) if found.len() <= MaterialId::MAX_COUNT => found.insert(at, (label, voxels)),
        Err(_) => {}
    }
    found
}
