//! Which labels a segmented volume holds, found slab by slab.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::ops::Range;

use rayon::prelude::*;

use super::error::ClassifyError;
use crate::grid::MaterialId;
use crate::volume::{Sample, Slab};

/// Counts the labels of a volume.
#[derive(Debug, Clone, Default)]
pub struct LabelIds {
    voxels: BTreeMap<Label, u64>,
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
        let found = core.into_par_iter().map(|z| slice_labels(slab, z));
        let merged = found.try_reduce(BTreeMap::new, |a, b| {
            let (mut most, least) = if a.len() < b.len() { (b, a) } else { (a, b) };
            least.into_iter().for_each(|(label, n)| *most.entry(label).or_insert(0) += n);
            checked(most)
        })?;
        merged.into_iter().for_each(|(label, n)| *self.voxels.entry(label).or_insert(0) += n);
        self.voxels = checked(std::mem::take(&mut self.voxels))?;
        Ok(())
    }

    /// The labels, once all slices were added.
    ///
    /// # Errors
    /// [`ClassifyError::OneLabel`].
    pub fn finish(self) -> Result<KnownLabels, ClassifyError> {
        let labels: Vec<f64> = self.voxels.keys().map(|l| f64::from(l.0)).collect();
        if let [label] = labels[..] {
            return Err(ClassifyError::OneLabel { label });
        }
        Ok(KnownLabels { labels, voxels: self.voxels.into_values().collect() })
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

fn checked(voxels: BTreeMap<Label, u64>) -> Result<BTreeMap<Label, u64>, ClassifyError> {
    let limit = MaterialId::MAX_COUNT;
    if voxels.len() > limit { Err(ClassifyError::TooManyLabels { limit }) } else { Ok(voxels) }
}

fn slice_labels<S: Sample>(slab: Slab<'_, S>, z: usize) -> Result<BTreeMap<Label, u64>, ClassifyError> {
    let mut voxels = BTreeMap::new();
    for y in 0..slab.size()[1] {
        for run in slab.row(y, z).chunk_by(|a, b| a == b) {
            if let Some(label) = run.first() {
                // Adding zero makes the two zeros of a float volume one label.
                *voxels.entry(Label(label.to_f32() + 0.0)).or_insert(0) += run.len() as u64;
            }
        }
        voxels = checked(voxels)?;
    }
    Ok(voxels)
}

/// A label as a key: ordered by value.
#[derive(Debug, Clone, Copy)]
struct Label(f32);

impl PartialEq for Label {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Label {}
impl PartialOrd for Label {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Label {
    fn cmp(&self, other: &Self) -> Ordering {
        self.0.total_cmp(&other.0)
    }
}
