//! Bricks: runs of slices that are classified apart, in one process or in many.
//!
//! [`Passes::decide`](super::Passes::decide) and [`Brick::new`] begin a brick. Then all bricks take the steps of
//! a [`Sweep`], each with slices of its neighbours as they were before, and report what changed. A
//! [`Schedule`] adds that up and says what the next sweep is. So the steps are those of the uncut volume:
//! `docs/scale.md`.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::alpha::count_densest_kept;
use super::bit_planes::BitPlanes;
use super::error::ClassifyError;
use super::label_volume::LabelVolume;
use super::passes::Decided;
use super::thinning::{Step, Thinned, Thinning};
use crate::material::MaterialTable;
use crate::volume::{Sample, Slab};

/// Steps of thinning that all bricks take before they look at each other again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sweep {
    first: Step,
    steps: usize,
}

impl Sweep {
    /// The steps, in order.
    pub fn steps(&self) -> impl Iterator<Item = Step> {
        let first = self.first;
        (0..self.steps).map(move |k| if k == 0 { first } else { Step::Thin })
    }

    /// Slices of its neighbours that a brick needs on each side.
    #[must_use]
    pub fn halo(&self) -> usize {
        self.steps
    }

    /// The padded slices that a brick of the padded slices `core` needs, in a volume of `depth` slices.
    #[must_use]
    pub fn needs(&self, core: &Range<usize>, depth: usize) -> Range<usize> {
        core.start.saturating_sub(self.steps).max(1)..core.end.saturating_add(self.steps).min(depth + 1)
    }
}

/// What a brick is like after a sweep, and what the sweep changed in it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SweepReport {
    /// Voxels that got a material, by step.
    pub changed: Vec<u64>,
    /// Voxels that have no material yet.
    pub undecided: u64,
    /// Voxels of each material.
    pub labelled: Vec<u64>,
    /// Voxels that have the densest material both by grey value alone and now.
    pub densest_kept: u64,
}

/// Says which steps the bricks of a volume take.
#[derive(Debug, Clone)]
pub struct Schedule {
    sweep: Sweep,
    radius: [f64; 3],
    done: Thinned,
}

impl Schedule {
    /// For sweeps of `steps` steps (at least 1); `radius` (voxels per axis) goes into messages.
    #[must_use]
    pub fn new(steps: usize, radius: [f64; 3]) -> Self {
        let sweep = Sweep { first: Step::Thin, steps: steps.max(1) };
        Self { sweep, radius, done: Thinned::default() }
    }

    /// The sweep that is due.
    #[must_use]
    pub fn sweep(&self) -> Sweep {
        self.sweep
    }

    /// Adds the sweep that was due: `changed` are the voxels changed in each step, summed over all
    /// bricks, `undecided` those left. `true` if another sweep is due; bricks without undecided
    /// voxels need not take part in it.
    ///
    /// # Errors
    /// [`ClassifyError::NoCore`] if settling changed nothing.
    pub fn add(&mut self, changed: &[u64], undecided: u64) -> Result<bool, ClassifyError> {
        let mut thinning = changed;
        if let (Step::Settle, Some((&settled, rest))) = (self.sweep.first, changed.split_first()) {
            if settled == 0 {
                return Err(ClassifyError::NoCore { radius: self.radius });
            }
            self.done.settling_rounds += 1;
            self.done.settled += settled;
            thinning = rest;
        }
        self.done.rounds += thinning.iter().filter(|&&c| c > 0).count();
        // The whole volume was at rest: only settling can go on.
        self.sweep.first = if thinning.contains(&0) { Step::Settle } else { Step::Thin };
        Ok(undecided > 0)
    }

    /// What thinning did so far.
    #[must_use]
    pub fn thinned(&self) -> Thinned {
        self.done
    }
}

/// Labels of a run of slices as far as they are decided, and the voxels that were junction before
/// thinning. All there is to keep of a brick between sweeps; it can be sent to another process.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Brick {
    labels: LabelVolume,
    junction: BitPlanes,
}

impl Brick {
    /// The brick of the slices that the passes decided.
    #[must_use]
    pub fn new(decided: &Decided) -> Self {
        Self::of(&decided.b, decided.junction.clone())
    }

    pub(super) fn of(b: &BitPlanes, junction: BitPlanes) -> Self {
        Self { labels: LabelVolume::from_planes(b), junction }
    }

    /// A brick as it was kept.
    pub(super) fn stored(labels: LabelVolume, junction: BitPlanes) -> Self {
        Self { labels, junction }
    }

    /// The padded slices of voxels that it holds.
    #[must_use]
    pub fn slices(&self) -> Range<usize> {
        self.labels.codes().voxel_slices()
    }

    /// The material of each voxel; `OUTSIDE` stands for voxels without.
    #[must_use]
    pub fn labels(&self) -> &LabelVolume {
        &self.labels
    }

    /// The voxels that were junction before thinning.
    #[must_use]
    pub fn junction(&self) -> &BitPlanes {
        &self.junction
    }

    /// The padded slices `slices` out of bricks of one volume; those of `OUTSIDE` are made.
    ///
    /// # Errors
    /// [`ClassifyError::Bricks`] names a slice that no brick holds, or that of another volume.
    pub fn join<'a>(
        bricks: impl IntoIterator<Item = &'a Self>,
        slices: Range<usize>,
    ) -> Result<Self, ClassifyError> {
        let mut joined: Option<Self> = None;
        let mut missing: Vec<usize> = slices.clone().collect();
        for brick in bricks {
            let (size, n) = (brick.labels.size(), brick.labels.materials());
            let first = brick.slices().start;
            let all = joined.get_or_insert_with(|| Self {
                labels: LabelVolume::undecided(size, n, slices.clone()),
                junction: BitPlanes::window(size, 1, slices.clone()),
            });
            let same = all.labels.size() == size && all.labels.materials() == n;
            if !same || brick.junction.size() != size || brick.junction.voxel_slices() != brick.slices() {
                return Err(ClassifyError::Bricks { slice: first });
            }
            let part = first.max(slices.start)..brick.slices().end.min(slices.end);
            if part.is_empty() {
                continue;
            }
            missing.retain(|z| !part.contains(z));
            all.labels.set_slices(&brick.labels, part.clone());
            all.junction.set_slices(part.start, brick.junction.slice_data(part));
        }
        let voxels = joined.as_ref().map_or(slices, Self::slices);
        match (missing.into_iter().find(|z| voxels.contains(z)), joined) {
            (None, Some(joined)) => Ok(joined),
            (slice, _) => Err(ClassifyError::Bricks { slice: slice.unwrap_or(voxels.start) }),
        }
    }

    /// Takes the steps of a sweep in the padded slices `core`. This brick and the slab must hold the
    /// slices that [`Sweep::needs`].
    ///
    /// # Panics
    /// If they hold less.
    #[must_use]
    pub fn thin<S: Sample>(
        &self,
        slab: Slab<'_, S>,
        materials: &MaterialTable,
        sweep: Sweep,
        core: &Range<usize>,
    ) -> (Self, SweepReport) {
        thin_stored((&self.labels, &self.junction), slab, materials, sweep, core)
    }
}

/// [`Brick::thin`] on labels and junction flags wherever they are kept.
pub(super) fn thin_stored<S: Sample>(
    (labels, flags): (&LabelVolume, &BitPlanes),
    slab: Slab<'_, S>,
    materials: &MaterialTable,
    sweep: Sweep,
    core: &Range<usize>,
) -> (Brick, SweepReport) {
    let (mut b, open) = labels.to_planes(sweep.needs(core, labels.size()[2]));
    let mut junction = BitPlanes::window(labels.size(), 1, core.clone());
    junction.set_slices(core.start, flags.slice_data(core.clone()));
    let report = thin_planes(slab, &mut b, open, materials, sweep, core);
    (Brick::of(&b.moved(core.clone()), junction), report)
}

/// Takes the steps of a sweep in planes `b` of materials and the voxels `open` that are in none of them.
pub(super) fn thin_planes<S: Sample>(
    slab: Slab<'_, S>,
    b: &mut BitPlanes,
    open: BitPlanes,
    materials: &MaterialTable,
    sweep: Sweep,
    core: &Range<usize>,
) -> SweepReport {
    let mut thinning = Thinning::new(slab, b, open, materials);
    let mut changed = vec![0; sweep.steps];
    for (step, changed) in sweep.steps().zip(&mut changed) {
        if thinning.at_rest() {
            break;
        }
        *changed = thinning.step(step, core);
    }
    SweepReport {
        changed,
        undecided: thinning.open_in(core),
        labelled: b.counts_in(core.clone()),
        densest_kept: count_densest_kept(slab, b, materials, core.clone()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn brick(size: [usize; 3], slices: Range<usize>) -> Brick {
        let mut b = BitPlanes::window(size, 2, slices.clone());
        b.fill_slices(|z, mut slice| slice.row(z % 2, 1)[0] = 2);
        Brick::of(&b, BitPlanes::window(size, 1, slices))
    }

    #[test]
    fn bricks_are_joined_only_if_they_belong_together() {
        let size = [1, 1, 6];
        let whole = brick(size, 1..7);
        let parts = [brick(size, 1..3), brick(size, 3..4), brick(size, 4..7)];
        let joined = Brick::join(&parts, 0..8).unwrap();
        assert_eq!(joined.labels, whole.labels);
        assert_eq!(
            Brick::join([&joined], 2..5).unwrap(),
            Brick::join([&parts[2], &parts[1], &whole], 2..5).unwrap()
        );
        let slice = |bricks: &[Brick], slices| match Brick::join(bricks, slices) {
            Err(ClassifyError::Bricks { slice }) => slice,
            other => panic!("{other:?}"),
        };
        assert_eq!(slice(&parts[..2], 2..6), 4);
        assert_eq!(slice(&[], 2..6), 2);
        assert_eq!(slice(&[brick([2, 1, 6], 1..2), brick(size, 2..7)], 1..7), 2);
    }

    #[test]
    fn a_schedule_takes_the_steps_of_the_uncut_volume() {
        let mut schedule = Schedule::new(2, [2.0; 3]);
        assert_eq!(schedule.sweep().steps().collect::<Vec<_>>(), [Step::Thin; 2]);
        assert!(schedule.add(&[5, 4], 3).unwrap());
        assert_eq!(schedule.sweep().steps().collect::<Vec<_>>(), [Step::Thin; 2]);
        assert!(schedule.add(&[1, 0], 2).unwrap());
        assert_eq!(schedule.sweep().steps().collect::<Vec<_>>(), [Step::Settle, Step::Thin]);
        assert!(schedule.add(&[1, 1], 1).unwrap());
        assert_eq!(schedule.sweep().steps().next(), Some(Step::Thin));
        assert!(!schedule.clone().add(&[1, 0], 0).unwrap());
        assert_eq!(schedule.thinned(), Thinned { rounds: 4, settling_rounds: 1, settled: 1 });
        assert!(schedule.add(&[0, 0], 1).unwrap());
        assert!(matches!(schedule.add(&[0, 0], 1), Err(ClassifyError::NoCore { .. })));
    }
}
