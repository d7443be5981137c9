//! The passes by grey value and neighbourhood on some slices: alpha, core, pair.

use std::ops::Range;

use super::alpha::alpha;
use super::ball::Ball;
use super::bit_planes::BitPlanes;
use super::pair::{core, junction, pair};
use crate::material::MaterialTable;
use crate::volume::{Sample, Slab};

/// The three passes with their balls, ready for any slices.
#[derive(Debug, Clone)]
pub struct Passes<'a> {
    materials: &'a MaterialTable,
    /// Voxels per axis of the volume.
    size: [usize; 3],
    core: Ball,
    pair: Ball,
}

/// What the passes leave of some slices.
#[derive(Debug, Clone)]
pub struct Decided {
    /// The voxels of each material so far.
    pub b: BitPlanes,
    /// The voxels of none: junction.
    pub junction: BitPlanes,
    /// Voxels of each class by grey value alone.
    pub alpha: Vec<u64>,
    /// Core voxels of each material.
    pub core: Vec<u64>,
}

impl<'a> Passes<'a> {
    /// For a volume of `size` voxels and blur radius `radius` (R, in voxels per axis).
    #[must_use]
    pub fn new(size: [usize; 3], materials: &'a MaterialTable, radius: [f64; 3]) -> Self {
        let [core, pair] = balls(radius);
        Self { materials, size, core, pair }
    }

    /// How many slices of samples the passes read beyond those that they decide.
    #[must_use]
    pub fn halo(&self) -> usize {
        slices_read(&self.core, &self.pair)
    }

    /// The slices of samples (unpadded) that the padded slices `slices` need.
    #[must_use]
    pub fn needs(&self, slices: &Range<usize>) -> Range<usize> {
        let padded = self.around(slices, self.halo());
        padded.start - 1..padded.end - 1
    }

    /// Decides the voxels of the padded slices `slices`; the slab must hold [`Passes::needs`].
    #[must_use]
    pub fn decide<S: Sample>(&self, slab: Slab<'_, S>, slices: Range<usize>) -> Decided {
        self.decide_and(slab, slices, |_| {})
    }

    /// [`Passes::decide`], with a `look` at the core voxels of the slices and of at least one on both sides, as
    /// far as there are voxels.
    #[must_use]
    pub(super) fn decide_and<S: Sample>(
        &self,
        slab: Slab<'_, S>,
        slices: Range<usize>,
        look: impl FnOnce(&BitPlanes),
    ) -> Decided {
        let alpha = alpha(slab, self.materials, self.around(&slices, self.halo()));
        let certain = core(&alpha, &self.core, self.around(&slices, self.pair.reach()[2]));
        // With balls of single voxels nothing beyond the slices is known.
        if self.pair.reach()[2] > 0 {
            look(&certain);
        }
        let b = pair(slab, &certain, &alpha, &self.pair, self.materials, slices.clone());
        let junction = junction(&b);
        let (alpha, core) = (alpha.counts_in(slices.clone()), certain.counts_in(slices));
        Decided { b, junction, alpha, core }
    }

    /// Padded slices with `halo` more on both sides, as far as there are voxels.
    pub(super) fn around(&self, slices: &Range<usize>, halo: usize) -> Range<usize> {
        slices.start.saturating_sub(halo).max(1)..(slices.end + halo).min(self.size[2] + 1)
    }
}

/// How many slices of samples the passes with blur radius `radius` (R, in voxels per axis) read beyond
/// those that they decide.
#[must_use]
pub fn halo(radius: [f64; 3]) -> usize {
    let [core, pair] = balls(radius);
    slices_read(&core, &pair)
}

/// The balls of the core pass (R) and of the pair pass (2R).
fn balls(radius: [f64; 3]) -> [Ball; 2] {
    [Ball::new(radius), Ball::new(radius.map(|r| 2.0 * r))]
}

fn slices_read(core: &Ball, pair: &Ball) -> usize {
    core.reach()[2] + pair.reach()[2]
}
