//! Which labels a segmented volume holds, found slab by slab.

use std::ops::Range;

use rayon::prelude::*;

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
        let found = rows
            .fold(Vec::new, |found, row| {
                // Adding zero makes the two zeros of a float volume one label.
                let runs = row.chunk_by(|a, b| a == b).map(|run| (run[0].to_f32() + 0.0, run.len() as u64));
                runs.fold(found, insert)
            })
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
    match found.binary_search_by(|l| l.0.total_cmp(&label)) {
        Ok(at) => found[at].1 += voxels,
        // One more than the limit is enough to refuse.
        Err(at) if found.len() <= MaterialId::MAX_COUNT => found.insert(at, (label, voxels)),
        Err(_) => {}
    }
    found
}
