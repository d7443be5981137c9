//! How thick slabs may be, and how large pieces of mesh, within a budget of memory.
//!
//! Bytes are added up from what each pass holds at its peak. The parts that follow the surface cannot be
//! known before; a piece of mesh is bounded by its number of triangles, except that it has one layer
//! of cells at least.

use std::path::{Path, PathBuf};

use super::PipelineError;
use crate::classify::{LabelStore, LabelVolume, SlabPlan};
use crate::material::{QUALITY_HALO, survey_bytes};
use crate::volume::{Denoised, SampleType, sweep_bytes};

/// One part in so many of the budget is left to the allocator.
const ALLOCATOR_SHARE: u64 = 8;
/// The program, its tables, threads and buffers of files.
const BASE: u64 = 48 << 20;
/// Bytes that a triangle of a piece takes while it is made: vertices and triangle in lattice units.
const MADE: u64 = 24;
/// Bytes that a triangle of a piece takes while it is checked, measured, split and written.
const USED: u64 = 240;
/// Triangles of a piece where memory is no matter: enough to keep many threads busy.
const PIECE: usize = 1 << 19;
/// Pieces are not made smaller than this: each costs some layers looked at twice.
const SMALLEST_PIECE: usize = 1 << 15;

/// What a run may hold at a time.
#[derive(Debug, Clone)]
pub(super) struct MemoryPlan {
    budget: Option<u64>,
    size: [usize; 3],
    sample: SampleType,
    /// Slices of a slab at most.
    most: usize,
    /// Slices that contouring reads on each side of a slab.
    reach: usize,
    /// Bytes for what is always there.
    base: u64,
    /// Triangles of a piece of mesh at most, if it has more than one layer.
    pub(super) piece: usize,
}

impl MemoryPlan {
    /// For a volume of `size` voxels of type `sample`, contouring that reads `reach` slices on each side of a
    /// slab, a budget in bytes and slabs of at most `slab` slices.
    pub(super) fn new(
        size: [usize; 3],
        sample: SampleType,
        reach: usize,
        budget: Option<u64>,
        slab: Option<usize>,
    ) -> Self {
        let most = slab.unwrap_or(size[2]).clamp(1, size[2]);
        // What the allocator keeps back of memory that was given back.
        let budget = budget.map(|bytes| bytes - bytes / ALLOCATOR_SHARE);
        let mut plan = Self { budget, size, sample, most, reach, base: BASE, piece: PIECE };
        while budget.is_some_and(|budget| plan.pieces() > budget / 4) && plan.piece > SMALLEST_PIECE {
            plan.piece /= 2;
        }
        plan
    }

    /// For a volume that takes `bytes` to read, beside what is read.
    pub(super) fn reading(self, bytes: u64) -> Self {
        Self { base: self.base + bytes, ..self }
    }

    /// Bytes for the pieces under way. A piece has a layer at least, and the layers at the volume's first and
    /// last slice may have two triangles for each voxel of it, where material meets the border.
    fn pieces(&self) -> u64 {
        let layer = 2 * self.size[0] as u64 * self.size[1] as u64;
        (self.piece as u64).max(layer) * USED + self.piece as u64 * MADE * rayon::current_num_threads() as u64
    }

    /// Refuses a budget that is certainly too small, for about `materials` materials, passes with `halo`
    /// slices, and a sink that takes `sink` bytes. What is said to be needed is enough for all stages.
    pub(super) fn check(&mut self, materials: usize, halo: usize, sink: u64) -> Result<(), PipelineError> {
        loop {
            let plan = self.slabs(materials, halo, Some(Path::new("")));
            let thin = SlabPlan { slices: 1, steps: SlabPlan::STEPS, scratch: Some(PathBuf::new()) };
            let contouring = self.contouring(materials, plan.as_ref().unwrap_or(&thin));
            let stages =
                [self.thickest(|_| self.base + sink), self.survey(), plan.map(|p| p.slices), contouring];
            let needed = |error: &PipelineError| match error {
                PipelineError::Memory { needed, .. } => *needed,
                _ => u64::MAX,
            };
            match stages.into_iter().filter_map(Result::err).max_by_key(needed) {
                None => return Ok(()),
                Some(_) if self.piece > SMALLEST_PIECE => self.piece /= 2,
                Some(error) => return Err(error),
            }
        }
    }

    /// Slices of a slab while materials and blur are looked for.
    pub(super) fn survey(&self) -> Result<usize, PipelineError> {
        let kept = survey_bytes(self.size, self.sample);
        self.thickest(|slices| self.base + kept + sweep_bytes(self.size, self.sample, slices, QUALITY_HALO))
    }

    /// How to cut the volume for classification, whose passes read `halo` slices on each side. Labels go to
    /// a scratch file in `scratch`, if one is given and memory cannot hold them.
    pub(super) fn slabs(
        &self,
        materials: usize,
        halo: usize,
        scratch: Option<&Path>,
    ) -> Result<SlabPlan, PipelineError> {
        let whole = SlabPlan::whole(self.size);
        let depth = self.size[2];
        let labels = LabelStore::bytes(self.size, materials);
        let n = materials as u64;
        // All at once: alpha, core and pair planes while deciding; samples stay for contouring.
        let samples = sweep_bytes(self.size, self.sample, depth, 0);
        let decided = self.planes(3 * n + 1, depth);
        let all = self.base + samples + decided.max(labels + self.pieces());
        if self.most == depth && self.fits(all) {
            return Ok(whole);
        }
        // Labels in memory are worth it while they leave most of it to slabs, and many steps a sweep while
        // there is room for their halo.
        let in_memory = SlabPlan { slices: 1, steps: 1, scratch: None };
        let small = self.budget.is_some_and(|budget| labels <= budget / 4)
            && self.contouring(materials, &in_memory).is_ok();
        let places: &[bool] = match scratch {
            None => &[true],
            Some(_) if small => &[true, false],
            Some(_) => &[false],
        };
        let mut refused = None;
        for steps in [SlabPlan::STEPS, 4, 2, 1] {
            for &kept in places {
                let bytes = |slices: usize| {
                    let reach = (slices + 2 * (halo + steps)).min(depth);
                    let samples = sweep_bytes(self.size, self.sample, slices, halo + steps);
                    let store = if kept { labels } else { 0 };
                    self.base + store + samples + self.planes(4 * n + 4, reach)
                };
                match self.thickest(bytes) {
                    Ok(slices) => {
                        let scratch = if kept { None } else { scratch.map(Path::to_owned) };
                        return Ok(SlabPlan { slices: slices.min(depth.div_ceil(2)), steps, scratch });
                    }
                    Err(error) => refused = Some(error),
                }
            }
        }
        Err(refused.unwrap_or(PipelineError::Memory { budget: 0, needed: labels, size: self.size }))
    }

    /// Slices of a slab while the surface is extracted, for a volume classified by `plan`.
    pub(super) fn contouring(&self, materials: usize, plan: &SlabPlan) -> Result<usize, PipelineError> {
        if plan.slices >= self.size[2] {
            return Ok(self.size[2]);
        }
        let labels = LabelStore::bytes(self.size, materials);
        let kept = if plan.scratch.is_none() { labels } else { 0 };
        let bits = u64::from(usize::BITS - materials.leading_zeros()) + 1;
        self.thickest(|slices| {
            let samples = sweep_bytes(self.size, self.sample, slices, self.reach);
            self.base + kept + samples + self.planes(bits, slices + 2 * self.reach) + self.pieces()
        })
    }

    /// Bytes of `slices` slices of bit planes.
    fn planes(&self, count: u64, slices: usize) -> u64 {
        let one = LabelVolume::undecided(self.size, 1, 1..2).codes().bytes() as u64;
        one * count * slices as u64
    }

    /// Whether the whole volume can stay in memory for all of a run with usual materials and blur.
    pub(super) fn holds_all(&self) -> bool {
        self.slabs(4, 0, None).is_ok_and(|plan| plan.slices >= self.size[2])
    }

    fn fits(&self, bytes: u64) -> bool {
        self.budget.is_none_or(|budget| bytes <= budget)
    }

    /// Whether the whole volume, filtered, is kept in memory, and how many slices of it are filtered at a
    /// time. This plan is that of the run on the filtered volume.
    pub(super) fn denoising(&self, denoised: &Denoised<'_>) -> Result<(bool, usize), PipelineError> {
        let most = denoised.slices_at_a_time();
        let whole = sweep_bytes(self.size, self.sample, self.size[2], 0);
        let in_memory = self.thickest_to(most, |slices| self.base + whole + denoised.bytes(slices));
        match in_memory {
            Ok(slices) if self.holds_all() => Ok((true, slices)),
            _ => Ok((false, self.thickest_to(most, |slices| self.base + denoised.bytes(slices))?)),
        }
    }

    /// The thickest slab for which `bytes` fits the budget.
    fn thickest(&self, bytes: impl Fn(usize) -> u64) -> Result<usize, PipelineError> {
        self.thickest_to(self.most, bytes)
    }

    /// The most slices, up to `most`, for which `bytes` fits the budget.
    fn thickest_to(&self, most: usize, bytes: impl Fn(usize) -> u64) -> Result<usize, PipelineError> {
        if self.fits(bytes(most)) {
            return Ok(most);
        }
        if !self.fits(bytes(1)) {
            let whole = |bytes: u64| bytes + bytes / (ALLOCATOR_SHARE - 1);
            let (budget, needed) = (whole(self.budget.unwrap_or(u64::MAX / 2)), whole(bytes(1)) + 1);
            return Err(PipelineError::Memory { budget, needed, size: self.size });
        }
        let (mut good, mut bad) = (1, most);
        while bad - good > 1 {
            let middle = good.midpoint(bad);
            if self.fits(bytes(middle)) {
                good = middle;
            } else {
                bad = middle;
            }
        }
        Ok(good)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_memory_means_thicker_slabs_up_to_all() {
        let size = [1024; 3];
        let plan = |mib: u64| MemoryPlan::new(size, SampleType::U16, 1, Some(mib << 20), None);
        let slices = |mib| {
            let plan = plan(mib);
            plan.slabs(3, 12, Some(Path::new("."))).map(|slabs| (slabs.slices, slabs.scratch.is_some()))
        };
        let thin = slices(700).unwrap();
        let thick = slices(1024).unwrap();
        assert!(thin.0 >= 1 && thin.0 < thick.0 && thin.1, "{thin:?} {thick:?}");
        assert_eq!(slices(16 << 10).unwrap(), (1024, false));
        assert_eq!(MemoryPlan::new(size, SampleType::U16, 1, None, None).survey().unwrap(), 1024);
    }

    #[test]
    fn the_memory_said_to_be_needed_is_enough() {
        for (size, sample) in [
            ([1024; 3], SampleType::U16),
            ([64, 64, 40], SampleType::U8),
            ([3000, 2500, 4], SampleType::F32),
            ([12, 9000, 700], SampleType::I16),
        ] {
            for (halo, sink, reach) in [(3, 0, 1), (18, 80 << 20, 5)] {
                for allowed in [0, 60 << 20, 100 << 20] {
                    let plan = |bytes| MemoryPlan::new(size, sample, reach, Some(bytes), None);
                    let check = |bytes| plan(bytes).check(4, halo, sink);
                    let Err(PipelineError::Memory { budget, needed, .. }) = check(allowed) else { continue };
                    assert!(budget == allowed && needed > budget);
                    assert!(check(needed).is_ok(), "{size:?} {halo} {sink}: {needed} is not enough");
                }
            }
        }
    }
}
