//! Classification slab by slab: the same labels and counts as [`classify`], in the
//! memory of one slab.
//!
//! The first sweep decides each slice once (alpha, core, pair) and takes `steps` steps of thinning
//! in every slab, with as many slices of halo. Further sweeps visit only slabs with undecided voxels. A
//! sweep takes the same steps everywhere, so the changes of each step, added up over the slabs' cores, say
//! when the whole volume was at rest and a [`Step::Settle`](super::Step::Settle) is due: `docs/scale.md`.

use std::collections::VecDeque;
use std::ops::Range;
use std::path::PathBuf;

use super::bit_planes::BitPlanes;
use super::bricks::{Brick, Schedule, SweepReport, thin_planes, thin_stored};
use super::error::ClassifyError;
use super::interior::add_interior;
use super::label_store::LabelStore;
use super::pair::junction;
use super::passes::Passes;
use super::{ClassifyCounts, check_radius, classify};
use crate::execution::Execution;
use crate::material::{LevelSums, MaterialTable};
use crate::volume::{Sample, SampleWindow};

/// How to cut a volume.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SlabPlan {
    /// Slices of a slab, without halo; at least 1.
    pub slices: usize,
    /// Steps of thinning per sweep, and slices of halo for them; at least 1.
    pub steps: usize,
    /// A folder for the labels' scratch file; `None`: labels stay in memory.
    pub scratch: Option<PathBuf>,
}

impl SlabPlan {
    /// Steps per sweep when nothing else is asked for: thinning of the scans tried is at rest after 4 to 5.
    pub const STEPS: usize = 8;

    /// The whole volume as one slab.
    #[must_use]
    pub fn whole(size: [usize; 3]) -> Self {
        Self { slices: size[2], steps: Self::STEPS, scratch: None }
    }

    /// The padded slices of each slab of a volume of `size` voxels.
    #[must_use]
    pub fn slabs(&self, size: [usize; 3]) -> Vec<Range<usize>> {
        let thickness = self.slices.max(1);
        (1..=size[2]).step_by(thickness).map(|z| z..(z + thickness).min(size[2] + 1)).collect()
    }
}

/// A classified volume whose labels may be too many for memory.
#[derive(Debug)]
pub struct Classified {
    /// The material of every voxel, and the voxels that were junction before thinning.
    pub store: LabelStore,
    /// Sums over the voxels well inside of each material.
    pub levels: LevelSums,
    /// Counts for the report.
    pub counts: ClassifyCounts,
}

/// Classifies a volume slab by slab, with blur radius `radius` (R, in voxels per axis).
///
/// # Errors
/// As [`classify`]; [`ClassifyError::Volume`] if a slab cannot be read, [`ClassifyError::Scratch`] if labels
/// cannot be put aside.
pub fn classify_slabs<S: Sample>(
    window: &mut SampleWindow<'_, S>,
    materials: &MaterialTable,
    radius: [f64; 3],
    plan: &SlabPlan,
    execution: &Execution,
) -> Result<Classified, ClassifyError> {
    check_radius(radius)?;
    let size = window.size();
    let slabs = plan.slabs(size);
    if slabs.len() == 1 {
        window.hold(0..size[2])?;
        let whole = classify(window.slab(), materials, radius, execution)?;
        let store = LabelStore::of(whole.labels, whole.junction);
        return Ok(Classified { store, levels: whole.levels, counts: whole.counts });
    }
    let store = match &plan.scratch {
        Some(folder) => LabelStore::in_file(size, materials.count(), folder)?,
        None => LabelStore::in_memory(size, materials.count()),
    };
    let passes = Passes::new(size, materials, radius);
    let schedule = Schedule::new(plan.steps, radius);
    let records = vec![SweepReport::default(); slabs.len()];
    let levels = LevelSums::new(size, materials.count());
    let mut sweeps = Sweeps { materials, passes, store, levels, slabs, schedule, records, execution };
    let mut counts = sweeps.first(window, radius)?;
    while sweeps.schedule.add(&sweeps.changed(), sweeps.undecided())? {
        sweeps.further(window)?;
    }
    counts.add_thinned(&sweeps.schedule.thinned());
    for (i, labelled) in counts.labelled.iter_mut().enumerate() {
        *labelled = sweeps.records.iter().map(|r| r.labelled[i]).sum();
    }
    counts.densest_kept = sweeps.records.iter().map(|r| r.densest_kept).sum();
    Ok(Classified { store: sweeps.store, levels: sweeps.levels, counts })
}

/// Its name as a stage.
pub(super) const STAGE: &str = "classifying voxels";

struct Sweeps<'a> {
    materials: &'a MaterialTable,
    passes: Passes<'a>,
    store: LabelStore,
    levels: LevelSums,
    slabs: Vec<Range<usize>>,
    schedule: Schedule,
    /// Each slab after its last sweep.
    records: Vec<SweepReport>,
    execution: &'a Execution,
}

impl Sweeps<'_> {
    fn undecided(&self) -> u64 {
        self.records.iter().map(|r| r.undecided).sum()
    }

    /// The changes of each step of the last sweep in all slabs.
    fn changed(&self) -> Vec<u64> {
        let mut changed = vec![0; self.schedule.sweep().halo()];
        self.records.iter().for_each(|r| add(&mut changed, &r.changed));
        changed
    }

    /// The first sweep: all passes, and steps of thinning. Returns the counts so far.
    fn first<S: Sample>(
        &mut self,
        window: &mut SampleWindow<'_, S>,
        radius: [f64; 3],
    ) -> Result<ClassifyCounts, ClassifyError> {
        let Self { materials, passes, store, levels, slabs, schedule, records, execution } = self;
        let (n, size) = (materials.count(), window.size());
        let mut counts = ClassifyCounts::zero(n);
        let sweep = schedule.sweep();
        // Decided slices, before any step of thinning: the later ones are the next slab's halo.
        let mut fresh = BitPlanes::window(size, n, 1..1);
        let stage = execution.stage(STAGE, size[2] as u64);
        let thickness = slabs.first().map_or(1, Range::len);
        let mut records = records.iter_mut();
        window.sweep(thickness, sweep.halo() + passes.halo(), |slab, core| {
            let core = core.start + 1..core.end + 1;
            let wide = sweep.needs(&core, size[2]);
            let new = fresh.slices().end.max(wide.start)..wide.end;
            fresh = std::mem::replace(&mut fresh, BitPlanes::window(size, n, 1..1)).moved(wide);
            if !new.is_empty() {
                let decided = passes.decide_and(slab, new.clone(), |core| {
                    add_interior(levels, slab, core, new.clone());
                });
                add(&mut counts.alpha, &decided.alpha);
                add(&mut counts.core, &decided.core);
                add(&mut counts.pair, &decided.b.counts());
                fresh.set_slices(new.start, decided.b.slice_data(new));
            }
            execution.check()?;
            let mut b = fresh.clone();
            let undecided = junction(&b);
            counts.junction += undecided.counts_in(core.clone())[0];
            let report = thin_planes(slab, &mut b, undecided.clone(), materials, sweep, &core);
            if let Some(record) = records.next() {
                *record = report;
            }
            stage.advance(core.len() as u64);
            store.write(&Brick::of(&b.moved(core.clone()), undecided.moved(core)))
        })?;
        if counts.core.iter().all(|&c| c == 0) {
            return Err(ClassifyError::NoCore { radius });
        }
        Ok(counts)
    }

    /// The sweep that is due, over the slabs with undecided voxels.
    fn further<S: Sample>(&mut self, window: &mut SampleWindow<'_, S>) -> Result<(), ClassifyError> {
        let sweep = self.schedule.sweep();
        let depth = window.size()[2];
        // Slabs that this sweep has changed, kept back while a later slab has them in its halo.
        let mut done: VecDeque<Brick> = VecDeque::new();
        let stage = self.execution.stage("finishing junctions", self.slabs.len() as u64);
        for (core, record) in self.slabs.iter().zip(&mut self.records) {
            stage.advance(1);
            if record.undecided == 0 {
                record.changed.clear();
                continue;
            }
            self.execution.check()?;
            let wide = sweep.needs(core, depth);
            while let Some(brick) = done.pop_front_if(|brick| brick.slices().end <= wide.start) {
                self.store.write(&brick)?;
            }
            window.hold(wide.start - 1..wide.end - 1)?;
            let (labels, flags) = self.store.read(wide)?;
            let (brick, report) = thin_stored((&labels, &flags), window.slab(), self.materials, sweep, core);
            *record = report;
            done.push_back(brick);
        }
        done.iter().try_for_each(|brick| self.store.write(brick))
    }
}

fn add(sum: &mut [u64], part: &[u64]) {
    sum.iter_mut().zip(part).for_each(|(s, p)| *s += p);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Geometry, VoxelBox};
    use crate::volume::{MemorySource, SampleType, Samples, Slab, VolumeError, VolumeSource};
    use proptest::prelude::*;

    /// A volume as in a file: nothing is in memory but what was asked for.
    struct Strict(MemorySource);

    impl VolumeSource for Strict {
        fn geometry(&self) -> &Geometry {
            self.0.geometry()
        }

        fn sample_type(&self) -> SampleType {
            self.0.sample_type()
        }

        fn cheap_partial_reads(&self) -> bool {
            true
        }

        fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
            self.0.read(part)
        }
    }

    /// Blocks of random materials, with a little noise and soft edges.
    fn blocks(size: [usize; 3], block: usize, seeds: &[u8], greys: &[u8]) -> Vec<u8> {
        let material = |p: [usize; 3]| {
            let [x, y, z] = p.map(|c| c / block);
            greys[usize::from(seeds[(x * 7 + y * 5 + z * 11) % seeds.len()]) % greys.len()]
        };
        let at = |x: usize, y: usize, z: usize| {
            let clamp = |p: [isize; 3]| -> [usize; 3] {
                std::array::from_fn(|a| p[a].clamp(0, size[a] as isize - 1) as usize)
            };
            let near = [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
            let sum: usize = near
                .iter()
                .map(|d: &[isize; 3]| {
                    let p = [x as isize + d[0], y as isize + d[1], z as isize + d[2]];
                    usize::from(material(clamp(p)))
                })
                .sum();
            (sum / near.len()) as u8
        };
        let mut out = Vec::new();
        for z in 0..size[2] {
            for y in 0..size[1] {
                out.extend((0..size[0]).map(|x| at(x, y, z)));
            }
        }
        out
    }

    fn same(
        samples: &[u8],
        size: [usize; 3],
        radius: f64,
        plan: &SlabPlan,
    ) -> Option<(ClassifyCounts, ClassifyCounts)> {
        let table = MaterialTable::new([("air", 20.0), ("al", 90.0), ("fe", 140.0), ("pb", 220.0)]).unwrap();
        let execution = Execution::default();
        let whole = classify(Slab::whole(samples, size), &table, [radius; 3], &execution);
        let geometry = Geometry::axis_aligned(size, [1.0; 3]).unwrap();
        let source = Strict(MemorySource::new(geometry, Samples::U8(samples.to_vec())).unwrap());
        let mut window = SampleWindow::<u8>::new(&source, &execution).unwrap();
        let slabs = classify_slabs(&mut window, &table, [radius; 3], plan, &execution);
        let (whole, mut slabs) = match (whole, slabs) {
            (Ok(whole), Ok(slabs)) => (whole, slabs),
            (Err(ClassifyError::NoCore { .. }), Err(ClassifyError::NoCore { .. })) => return None,
            (whole, slabs) => panic!("{:?} but {:?}", whole.err(), slabs.err()),
        };
        let (labels, junction) = slabs.store.read(0..size[2] + 2).unwrap();
        assert_eq!(*labels, whole.labels);
        for z in 1..=size[2] {
            assert_eq!(junction.slice_data(z..z + 1), whole.junction.slice_data(z..z + 1));
        }
        assert_eq!(slabs.levels, whole.levels);
        Some((whole.counts, slabs.counts))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn slabs_of_any_thickness_give_the_labels_of_the_whole(
            size in [4usize..70, 3usize..14, 3usize..24],
            block in 2usize..7,
            seeds in proptest::collection::vec(0u8..4, 3..40),
            radius in 0.9f64..2.2,
            (slices, steps) in (1usize..9, 1usize..6),
            on_disk in any::<bool>(),
        ) {
            let samples = blocks(size, block, &seeds, &[20, 90, 140, 220]);
            let folder = tempfile::tempdir().unwrap();
            let scratch = on_disk.then(|| folder.path().to_owned());
            if let Some((whole, slabs)) = same(&samples, size, radius, &SlabPlan { slices, steps, scratch }) {
                prop_assert_eq!(whole, slabs);
            }
        }
    }

    #[test]
    fn voxels_that_must_be_settled_are_settled_alike() {
        let size = [40, 36, 30];
        let mut seen = 0;
        for seed in 1..8u64 {
            let mut state = seed;
            let mut next = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 60) as u8
            };
            let seeds: Vec<u8> = (0..101).map(|_| next()).collect();
            let samples = blocks(size, 5, &seeds, &[20, 90, 140, 220]);
            for (radius, steps) in [(1.5, 1), (1.5, 3), (2.0, 2)] {
                let plan = SlabPlan { slices: 4, steps, scratch: None };
                if let Some((whole, slabs)) = same(&samples, size, radius, &plan) {
                    assert_eq!(whole, slabs);
                    seen += usize::from(whole.settled > 0 && whole.thinning_rounds > steps);
                }
            }
        }
        assert!(seen >= 5, "only {seen} runs needed settling and more than one sweep");
    }
}
