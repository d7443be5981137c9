//! Classification slab by slab: the same labels and counts as [`classify`](super::classify), in the
//! memory of one slab.
//!
//! The first sweep decides each slice once (alpha, core, pair) and takes `steps` steps of thinning
//! in every slab, with as many slices of halo. Further sweeps visit only slabs with undecided voxels. A
//! sweep takes the same steps everywhere, so the changes of each step, added up over the slabs' cores, say
//! when the whole volume was at rest and a [`Step::Settle`] is due: `docs/scale.md`.

use std::collections::VecDeque;
use std::ops::Range;
use std::path::PathBuf;

use super::alpha::count_densest_kept;
use super::bit_planes::BitPlanes;
use super::error::ClassifyError;
use super::label_store::LabelStore;
use super::label_volume::LabelVolume;
use super::pair::junction;
use super::passes::Passes;
use super::thinning::{Step, Thinned, Thinning};
use super::{ClassifyCounts, check_radius, classify};
use crate::execution::Execution;
use crate::material::MaterialTable;
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
    /// Counts for the report.
    pub counts: ClassifyCounts,
}

/// What is known of a slab after a sweep.
#[derive(Debug, Clone, Default)]
struct Record {
    undecided: u64,
    labelled: Vec<u64>,
    densest_kept: u64,
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
        return Ok(Classified { store, counts: whole.counts });
    }
    let store = match &plan.scratch {
        Some(folder) => LabelStore::in_file(size, materials.count(), folder)?,
        None => LabelStore::in_memory(size, materials.count()),
    };
    let passes = Passes::new(size, materials, radius);
    let steps = plan.steps.max(1);
    let records = vec![Record::default(); slabs.len()];
    let mut sweeps = Sweeps { materials, passes, store, slabs, steps, records, execution };
    let (mut counts, mut at_rest) = sweeps.first(window, radius)?;
    while sweeps.undecided() > 0 {
        let next = if at_rest { Step::Settle } else { Step::Thin };
        at_rest = sweeps.further(window, next, radius, &mut counts)?;
    }
    for (i, labelled) in counts.labelled.iter_mut().enumerate() {
        *labelled = sweeps.records.iter().map(|r| r.labelled[i]).sum();
    }
    counts.densest_kept = sweeps.records.iter().map(|r| r.densest_kept).sum();
    Ok(Classified { store: sweeps.store, counts })
}

/// Its name as a stage.
pub(super) const STAGE: &str = "classifying voxels";

struct Sweeps<'a> {
    materials: &'a MaterialTable,
    passes: Passes<'a>,
    store: LabelStore,
    slabs: Vec<Range<usize>>,
    steps: usize,
    records: Vec<Record>,
    execution: &'a Execution,
}

impl Sweeps<'_> {
    fn undecided(&self) -> u64 {
        self.records.iter().map(|r| r.undecided).sum()
    }

    /// The first sweep: all passes, and steps of thinning. Returns the counts, and whether thinning came to
    /// rest in the whole volume.
    fn first<S: Sample>(
        &mut self,
        window: &mut SampleWindow<'_, S>,
        radius: [f64; 3],
    ) -> Result<(ClassifyCounts, bool), ClassifyError> {
        let Self { materials, passes, store, slabs, steps, records, execution } = self;
        let (n, size) = (materials.count(), window.size());
        let mut counts = ClassifyCounts::zero(n);
        let mut changed = vec![0; *steps];
        // Decided slices, before any step of thinning: the later ones are the next slab's halo.
        let mut fresh = BitPlanes::window(size, n, 1..1);
        let stage = execution.stage(STAGE, size[2] as u64);
        let thickness = slabs.first().map_or(1, Range::len);
        let mut records = records.iter_mut();
        window.sweep(thickness, *steps + passes.halo(), |slab, core| {
            let core = core.start + 1..core.end + 1;
            let wide = passes.around(&core, *steps);
            let new = fresh.slices().end.max(wide.start)..wide.end;
            fresh = std::mem::replace(&mut fresh, BitPlanes::window(size, n, 1..1)).moved(wide);
            if !new.is_empty() {
                let decided = passes.decide(slab, new.clone());
                add(&mut counts.alpha, &decided.alpha);
                add(&mut counts.core, &decided.core);
                add(&mut counts.pair, &decided.b.counts());
                fresh.set_slices(new.start, decided.b.slice_data(new));
            }
            execution.check()?;
            let mut b = fresh.clone();
            let undecided = junction(&b);
            counts.junction += undecided.counts_in(core.clone())[0];
            let mut thinning = Thinning::new(slab, &mut b, undecided.clone(), materials);
            for changed in &mut changed {
                if thinning.at_rest() {
                    break;
                }
                *changed += thinning.step(Step::Thin, &core);
            }
            if let Some(record) = records.next() {
                *record = Record {
                    undecided: thinning.open_in(&core),
                    labelled: b.counts_in(core.clone()),
                    densest_kept: count_densest_kept(slab, &b, materials, core.clone()),
                };
            }
            stage.advance(core.len() as u64);
            let labels = LabelVolume::from_planes(&b.moved(core.clone()));
            store.write(&labels, &undecided.moved(core))
        })?;
        if counts.core.iter().all(|&c| c == 0) {
            return Err(ClassifyError::NoCore { radius });
        }
        counts.thinning_rounds = changed.iter().filter(|&&c| c > 0).count();
        Ok((counts, changed.contains(&0)))
    }

    /// A further sweep over the slabs with undecided voxels, beginning with `next`; returns whether thinning
    /// came to rest in it.
    fn further<S: Sample>(
        &mut self,
        window: &mut SampleWindow<'_, S>,
        next: Step,
        radius: [f64; 3],
        counts: &mut ClassifyCounts,
    ) -> Result<bool, ClassifyError> {
        let mut changed = vec![0; self.steps];
        // Slabs that this sweep has changed, kept back while a later slab has them in its halo.
        let mut done: VecDeque<(LabelVolume, BitPlanes)> = VecDeque::new();
        let stage = self.execution.stage("finishing junctions", self.slabs.len() as u64);
        for (core, record) in self.slabs.iter().zip(&mut self.records) {
            stage.advance(1);
            if record.undecided == 0 {
                continue;
            }
            self.execution.check()?;
            let wide = self.passes.around(core, self.steps);
            while let Some((labels, flags)) =
                done.pop_front_if(|(labels, _)| labels.codes().voxel_slices().end <= wide.start)
            {
                self.store.write(&labels, &flags)?;
            }
            window.hold(wide.start - 1..wide.end - 1)?;
            let slab = window.slab();
            let (labels, flags) = self.store.read(wide.clone())?;
            let (mut b, undecided) = labels.to_planes(wide);
            let mut own_flags = BitPlanes::window(b.size(), 1, core.clone());
            own_flags.set_slices(core.start, flags.slice_data(core.clone()));
            let mut thinning = Thinning::new(slab, &mut b, undecided, self.materials);
            for (k, changed) in changed.iter_mut().enumerate() {
                if thinning.at_rest() {
                    break;
                }
                *changed += thinning.step(if k == 0 { next } else { Step::Thin }, core);
            }
            *record = Record {
                undecided: thinning.open_in(core),
                labelled: b.counts_in(core.clone()),
                densest_kept: count_densest_kept(slab, &b, self.materials, core.clone()),
            };
            done.push_back((LabelVolume::from_planes(&b.moved(core.clone())), own_flags));
        }
        for (labels, flags) in done {
            self.store.write(&labels, &flags)?;
        }
        let mut thinned = Thinned::default();
        let thinning = if next == Step::Settle {
            if changed[0] == 0 {
                return Err(ClassifyError::NoCore { radius });
            }
            thinned.settling_rounds = 1;
            thinned.settled = changed[0];
            &changed[1..]
        } else {
            &changed[..]
        };
        thinned.rounds = thinning.iter().filter(|&&c| c > 0).count();
        counts.add_thinned(&thinned);
        Ok(thinning.contains(&0))
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
