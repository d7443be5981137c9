//! The labelled volume that contouring reads: a material per voxel, `OUTSIDE` around it.
//!
//! Labels are kept bit-sliced: with n materials and `OUTSIDE` as code n, code bit p of every voxel
//! is plane p. Three materials take two bits per voxel, and 64 neighbours are compared at a time.
//! It may hold some slices of the volume only, under the numbers they have in it.

use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::alpha::{at_least_word, pack};
use super::bit_planes::{BitPlanes, WORD};
use super::error::ClassifyError;
use super::label_ids::{KnownLabels, LabelIds, note};
use crate::grid::MaterialId;
use crate::volume::{Sample, Slab};

/// A material for each voxel of a volume; see the module's header.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Unchecked")]
pub struct LabelVolume {
    materials: usize,
    size: [usize; 3],
    codes: BitPlanes,
}

/// See [`LabelVolume::word_from`].
#[derive(Debug, Clone, Copy)]
pub struct WordOfLabels<'a> {
    labels: &'a LabelVolume,
    planes: [u64; 8],
}

impl WordOfLabels<'_> {
    /// The material of the point `k` places after the first, of less than [`WORD`].
    #[must_use]
    #[inline]
    pub fn at(&self, k: usize) -> MaterialId {
        let planes = self.planes.iter().enumerate().take(self.labels.codes.count());
        let code = planes.fold(0, |code, (p, bits)| code | ((bits >> k & 1) as u8) << p);
        self.labels.material_of_code(code)
    }
}

/// Labels as they come from outside.
#[derive(Deserialize)]
struct Unchecked {
    materials: usize,
    size: [usize; 3],
    codes: BitPlanes,
}

impl TryFrom<Unchecked> for LabelVolume {
    type Error = &'static str;

    fn try_from(labels: Unchecked) -> Result<Self, Self::Error> {
        let Unchecked { materials, size, codes } = labels;
        if materials <= MaterialId::MAX_COUNT && codes.count() == code_bits(materials) && codes.size() == size
        {
            return Ok(Self { materials, size, codes });
        }
        Err("damaged labels: their numbers contradict each other")
    }
}

/// Bits of a code: those of the number of materials, which stands for `OUTSIDE`.
fn code_bits(materials: usize) -> usize {
    (usize::BITS - materials.leading_zeros()) as usize
}

impl LabelVolume {
    /// From one plane per material. A voxel in none of them, not decided yet, gets the code of
    /// `OUTSIDE`. Holds the slices that they hold, and `OUTSIDE` beyond them where the volume ends.
    #[must_use]
    pub fn from_planes(b: &BitPlanes) -> Self {
        let size = b.size();
        let mut out = Self::all_outside(size, b.count(), Self::with_ends(b.voxel_slices(), size));
        let bits = out.codes.count();
        out.codes.fill_slices(|z, mut slice| {
            for y in 1..=size[1] {
                for w in 0..b.words() {
                    let decided = (0..b.count()).fold(0, |any, i| any | b.row(i, y, z)[w]);
                    for p in 0..bits {
                        let members = (0..b.count()).filter(|i| i >> p & 1 == 1);
                        let inside = members.fold(0, |any, i| any | b.row(i, y, z)[w]);
                        let word = &mut slice.row(p, y)[w];
                        *word = (*word & !decided) | inside;
                    }
                }
            }
        });
        out
    }

    /// The same labels with the padded slices `slices` only: those that are held are kept, others are
    /// code 0.
    #[must_use]
    pub fn window(&self, slices: Range<usize>) -> Self {
        Self { codes: self.codes.clone().moved(slices), ..*self }
    }

    /// Two materials: 1 where the grey value is at least `threshold`, else 0. Holds the slices of the
    /// slab, and `OUTSIDE` beyond them where the volume ends.
    #[must_use]
    pub fn from_threshold<S: Sample>(slab: Slab<'_, S>, threshold: f32) -> Self {
        let held = slab.slices();
        Self::of_threshold(slab, threshold, Self::with_ends(held.start + 1..held.end + 1, slab.size()))
    }

    /// The labels of [`from_threshold`](Self::from_threshold) in the padded slices `slices`; the slab must
    /// hold those among them that are not `OUTSIDE`.
    #[must_use]
    pub fn of_threshold<S: Sample>(slab: Slab<'_, S>, threshold: f32, slices: Range<usize>) -> Self {
        let size = slab.size();
        let mut out = Self::all_outside(size, 2, slices);
        let voxels: Vec<u64> = (0..out.codes.words()).map(|w| out.codes.voxel_mask(w)).collect();
        out.codes.fill_slices(|z, mut slice| {
            for y in 1..=size[1] {
                let samples = slab.row(y - 1, z - 1);
                for (w, mask) in voxels.iter().enumerate() {
                    slice.row(0, y)[w] = at_least_word(samples, w, threshold);
                    slice.row(1, y)[w] &= !mask;
                }
            }
        });
        out
    }

    /// From a volume that is already segmented. Returns the labels that occur, ascending: the label
    /// at position i became material i.
    ///
    /// # Errors
    /// [`ClassifyError::TooManyLabels`] or [`ClassifyError::OneLabel`].
    pub fn from_labels<S: Sample>(
        samples: &[S],
        size: [usize; 3],
    ) -> Result<(Self, Vec<f64>), ClassifyError> {
        let slab = Slab::whole(samples, size);
        let mut ids = LabelIds::default();
        ids.add(slab, 0..size[2])?;
        let known = ids.finish()?;
        Ok((Self::of_known(slab, &known, 0..size[2] + 2), known.labels().to_vec()))
    }

    /// The labels of the padded slices `slices` of a volume that is already segmented; the slab must hold
    /// those among them that are not `OUTSIDE`.
    #[must_use]
    pub fn of_known<S: Sample>(slab: Slab<'_, S>, known: &KnownLabels, slices: Range<usize>) -> Self {
        let size = slab.size();
        let mut out = Self::all_outside(size, known.labels().len(), slices);
        let bits = out.codes.count();
        let masks: Vec<u64> = (0..out.codes.words()).map(|w| out.codes.voxel_mask(w)).collect();
        let arch = pulp::Arch::new();
        out.codes.fill_slices(|z, mut slice| {
            let mut coder = Coder { known, seen: Vec::new() };
            for y in 1..=size[1] {
                let row = slab.row(y - 1, z - 1);
                arch.dispatch(|| {
                    for (w, &voxels) in masks.iter().enumerate() {
                        // Padded point p is sample p - 1; the first voxel of the first word is bit 1.
                        let block = if w == 0 {
                            block_of(row, 1)
                        } else {
                            block_of(&row[(w * WORD - 1).min(row.len())..], 0)
                        };
                        let codes = coder.codes(&block);
                        for p in 0..bits {
                            let word = &mut slice.row(p, y)[w];
                            *word = *word & !voxels | bits_of(&codes, p) & voxels;
                        }
                    }
                });
            }
        });
        out
    }

    /// Slices of voxels, and the slices of `OUTSIDE` beside them where the volume ends.
    fn with_ends(slices: Range<usize>, size: [usize; 3]) -> Range<usize> {
        let start = if slices.start == 1 { 0 } else { slices.start };
        start..if slices.end == size[2] + 1 { size[2] + 2 } else { slices.end }
    }

    /// Labels of the padded slices `slices` of which none is known yet: all have the code of `OUTSIDE`.
    #[must_use]
    pub fn undecided(size: [usize; 3], materials: usize, slices: Range<usize>) -> Self {
        Self::all_outside(size, materials, slices)
    }

    /// Takes over the padded slices `slices` of `other`, a part of the same volume.
    ///
    /// # Panics
    /// If one of the two does not hold them.
    pub fn set_slices(&mut self, other: &Self, slices: Range<usize>) {
        self.codes.set_slices(slices.start, other.codes.slice_data(slices));
    }

    /// The words of all code planes of a slice, to be changed.
    pub(super) fn slice_mut(&mut self, z: usize) -> &mut [u64] {
        self.codes.slice_mut(z)
    }

    /// The inverse of [`LabelVolume::from_planes`] for the padded slices `slices`: one plane per
    /// material, and one of the voxels that are not decided.
    ///
    /// # Panics
    /// If the slices are not held.
    #[must_use]
    pub fn to_planes(&self, slices: Range<usize>) -> (BitPlanes, BitPlanes) {
        let n = self.materials;
        let mut b = BitPlanes::window(self.size, n, slices.clone());
        let mut open = BitPlanes::window(self.size, 1, slices);
        let member = |code: usize, y: usize, z: usize, w: usize| {
            (0..self.codes.count()).fold(self.codes.voxel_mask(w), |m, p| {
                let word = self.codes.row(p, y, z)[w];
                m & if code >> p & 1 == 1 { word } else { !word }
            })
        };
        let words = self.codes.words();
        b.fill_slices(|z, mut slice| {
            for y in 1..=self.size[1] {
                for i in 0..n {
                    (0..words).for_each(|w| slice.row(i, y)[w] = member(i, y, z, w));
                }
            }
        });
        open.fill_slices(|z, mut slice| {
            for y in 1..=self.size[1] {
                (0..words).for_each(|w| slice.row(0, y)[w] = member(n, y, z, w));
            }
        });
        (b, open)
    }

    fn all_outside(size: [usize; 3], materials: usize, slices: Range<usize>) -> Self {
        let bits = code_bits(materials);
        let mut codes = BitPlanes::window(size, bits, slices);
        let padded = codes.padded();
        // Bits beyond the padded row stay zero in every plane: code 0 on both sides of any comparison
        // made there.
        let ends = (0..codes.words()).map(|w| padded[0] - w * WORD);
        let row: Vec<u64> = ends.map(|end| u64::MAX >> WORD.saturating_sub(end)).collect();
        codes.fill_all_slices(|_, mut slice| {
            for p in (0..bits).filter(|p| materials >> p & 1 == 1) {
                (0..padded[1]).for_each(|y| slice.row(p, y).copy_from_slice(&row));
            }
        });
        Self { materials, size, codes }
    }

    /// Gives the voxel at a point of the padded lattice another material.
    ///
    /// # Panics
    /// If its slice is not held.
    pub fn set(&mut self, [x, y, z]: [usize; 3], material: MaterialId) {
        for p in 0..self.codes.count() {
            let word = &mut self.codes.row_mut(p, y, z)[x / WORD];
            let bit = 1 << (x % WORD);
            *word = if material.0 >> p & 1 == 1 { *word | bit } else { *word & !bit };
        }
    }

    /// Voxels per axis of the whole volume.
    #[must_use]
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Number of materials; it is also the code of `OUTSIDE`.
    #[must_use]
    pub fn materials(&self) -> usize {
        self.materials
    }

    /// The code planes, lowest bit first.
    #[must_use]
    pub fn codes(&self) -> &BitPlanes {
        &self.codes
    }

    /// The material of a code.
    #[must_use]
    #[inline]
    pub fn material_of_code(&self, code: u8) -> MaterialId {
        if usize::from(code) == self.materials { MaterialId::OUTSIDE } else { MaterialId(code) }
    }

    /// The material at a point of the padded lattice.
    #[must_use]
    #[inline]
    pub fn at(&self, [x, y, z]: [usize; 3]) -> MaterialId {
        self.material_of_code(self.codes.code(x, y, z))
    }

    /// The materials of the [`WORD`] points of a row of the padded lattice from this one on.
    #[must_use]
    #[inline]
    pub fn word_from(&self, [x, y, z]: [usize; 3]) -> WordOfLabels<'_> {
        let mut planes = [0; 8];
        for (p, bits) in planes.iter_mut().enumerate().take(self.codes.count()) {
            *bits = self.codes.bits_from(p, x, y, z);
        }
        WordOfLabels { labels: self, planes }
    }

    /// Voxels of each material in the slices that are held.
    #[must_use]
    pub fn counts(&self) -> Vec<u64> {
        let n = self.materials;
        let zero = || vec![0u64; n];
        self.codes
            .voxel_slices()
            .into_par_iter()
            .fold(zero, |mut sum, z| {
                for y in 1..=self.size[1] {
                    for w in 0..self.codes.words() {
                        let mask = self.codes.voxel_mask(w);
                        for (code, s) in sum.iter_mut().enumerate() {
                            let members = (0..self.codes.count()).fold(mask, |m, p| {
                                let word = self.codes.row(p, y, z)[w];
                                m & if code >> p & 1 == 1 { word } else { !word }
                            });
                            *s += u64::from(members.count_ones());
                        }
                    }
                }
                sum
            })
            .reduce(zero, |a, b| a.iter().zip(&b).map(|(a, b)| a + b).collect())
    }
}

/// Finds the codes of samples, 64 at a time.
struct Coder<'a, S> {
    known: &'a KnownLabels,
    /// Some of the labels that occurred, and their codes.
    seen: Vec<(S, u8)>,
}

impl<S: Sample> Coder<'_, S> {
    #[inline(always)]
    fn codes(&mut self, block: &[S; WORD]) -> [u8; WORD] {
        let mut codes = [0u8; WORD];
        let mut found = [0u8; WORD];
        for &(label, code) in &self.seen {
            for ((out, found), v) in codes.iter_mut().zip(&mut found).zip(block) {
                let same = u8::from(*v == label).wrapping_neg();
                *out |= same & code;
                *found |= same;
            }
        }
        if found.iter().fold(u8::MAX, |all, f| all & f) == 0 {
            self.by_runs(block, &mut codes);
        }
        codes
    }

    fn by_runs(&mut self, block: &[S; WORD], codes: &mut [u8; WORD]) {
        let mut rest = &mut codes[..];
        for run in block.chunk_by(|a, b| a == b) {
            let (label, code) = (run[0], self.known.id(run[0].to_f32()));
            rest.split_off_mut(..run.len()).unwrap_or_default().fill(code);
            note(&mut self.seen, label, code);
        }
    }
}

/// Samples from bit `from` of a word on, as many as there are; what stands elsewhere does not matter.
#[inline(always)]
fn block_of<S: Sample>(samples: &[S], from: usize) -> [S; WORD] {
    if from == 0
        && let Some(block) = samples.first_chunk()
    {
        return *block;
    }
    let n = samples.len().min(WORD - from);
    let mut block = [samples.first().copied().unwrap_or_default(); WORD];
    block[from..from + n].copy_from_slice(&samples[..n]);
    block
}

/// Bit `p` of 64 bytes.
#[inline(always)]
fn bits_of(bytes: &[u8; WORD], p: usize) -> u64 {
    pack(&bytes.map(|byte| byte >> p & 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_with_gaps_become_dense_and_are_surrounded_by_outside() {
        let size = [67, 2, 2];
        let samples: Vec<u16> = (0..268).map(|i| [3u16, 70, 900][i * 5 % 3]).collect();
        let (volume, labels) = LabelVolume::from_labels(&samples, size).unwrap();
        assert_eq!(labels, [3.0, 70.0, 900.0]);
        for z in 0..4 {
            for y in 0..4 {
                for x in 0..69 {
                    let inside = (1..=67).contains(&x) && (1..=2).contains(&y) && (1..=2).contains(&z);
                    let expected = if inside {
                        let v = samples[((z - 1) * 2 + y - 1) * 67 + x - 1];
                        MaterialId([3u16, 70, 900].iter().position(|&l| l == v).unwrap() as u8)
                    } else {
                        MaterialId::OUTSIDE
                    };
                    assert_eq!(volume.at([x, y, z]), expected);
                }
            }
        }
        let counts = volume.counts();
        assert_eq!(counts.iter().sum::<u64>(), 268);
        let zeros = LabelVolume::from_labels(&[0.0f32, -0.0, 1.0, -0.0], [4, 1, 1]).unwrap();
        assert_eq!(zeros.1, [0.0, 1.0]);
        assert!(matches!(LabelVolume::from_labels(&[5u8; 8], [2; 3]), Err(ClassifyError::OneLabel { .. })));
        let many: Vec<u16> = (0..300).collect();
        assert!(matches!(
            LabelVolume::from_labels(&many, [300, 1, 1]),
            Err(ClassifyError::TooManyLabels { .. })
        ));
    }
}
