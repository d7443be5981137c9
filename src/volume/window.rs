//! [`SampleWindow`]: a run of whole slices in memory that moves up through a volume.
//!
//! Moving drops slices below and reads those above; none is read twice in one pass, and what stays is
//! copied only once as much was dropped, so that a pass costs no more than a few copies of the volume
//! whatever the window. A window that holds the whole volume keeps it: later passes read nothing. A
//! volume that is in memory already is not copied at all.

use std::mem::take;
use std::ops::Range;

use super::collect::reserve;
use super::slices::SliceReader;
use super::{Sample, SampleType, Samples, Slab, VolumeError, VolumeSource};
use crate::execution::Execution;
use crate::grid::VoxelBox;

/// Some slices of a volume whose samples are of type `S`.
pub struct SampleWindow<'a, S> {
    source: &'a dyn VolumeSource,
    execution: &'a Execution,
    size: [usize; 3],
    /// All samples, of a volume that is in memory.
    memory: Option<&'a [S]>,
    reader: Option<Box<dyn SliceReader + 'a>>,
    /// The slices that were dropped but take memory still, then those held.
    samples: Vec<S>,
    /// Samples of dropped slices at the front.
    dropped: usize,
    held: Range<usize>,
    /// Slices read before they were asked for, behind those held.
    ahead: Vec<S>,
}

impl<'a, S: Sample> SampleWindow<'a, S> {
    /// A window on `source` that holds no slice yet; reading stops once `execution` is cancelled.
    ///
    /// # Errors
    /// [`VolumeError::Type`] if the volume has samples of another type.
    pub fn new(source: &'a dyn VolumeSource, execution: &'a Execution) -> Result<Self, VolumeError> {
        let actual = source.sample_type();
        if actual != S::TYPE {
            return Err(VolumeError::Type { wanted: S::TYPE, actual });
        }
        let memory = source.in_memory().and_then(S::view);
        let size = source.geometry().size();
        let held = if memory.is_some() { 0..size[2] } else { 0..0 };
        let (samples, ahead) = (Vec::new(), Vec::new());
        Ok(Self { source, execution, size, memory, reader: None, samples, dropped: 0, held, ahead })
    }

    /// Voxels per axis of the whole volume.
    #[must_use]
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// The execution that stops this window's reading.
    #[must_use]
    pub fn execution(&self) -> &'a Execution {
        self.execution
    }

    /// Sees to it that the slices `slices` are held. Slices below them are dropped if others must be
    /// read; slices held already are not read again. Going back to dropped ones begins a new pass.
    ///
    /// # Errors
    /// [`VolumeError::Box`] for no slices or slices beyond the volume, [`VolumeError::Memory`] if there
    /// is no room for them, [`VolumeError::Cancelled`]; otherwise whatever went wrong while reading.
    /// After an error no slice is held.
    pub fn hold(&mut self, slices: Range<usize>) -> Result<(), VolumeError> {
        let [width, height, depth] = self.size;
        if slices.is_empty() || slices.end > depth {
            let part = VoxelBox { low: [0, 0, slices.start], high: [width, height, slices.end] };
            return Err(VolumeError::Box { part, size: self.size });
        }
        if slices.start >= self.held.start && slices.end <= self.held.end {
            return Ok(());
        }
        self.move_to(slices).inspect_err(|_| self.clear())
    }

    /// The slices that are held.
    #[must_use]
    pub fn slab(&self) -> Slab<'_, S> {
        let samples = self.memory.unwrap_or(&self.samples[self.dropped..]);
        Slab::new(samples, self.size, self.held.start)
    }

    /// One pass over the volume: calls `work` with each run of `thickness` slices in turn, its *core*,
    /// and with a slab that holds the core and `halo` slices on both sides of it, as far as there are
    /// any. The next slices are read meanwhile.
    ///
    /// # Errors
    /// As [`SampleWindow::hold`], and those of `work`, which end the pass.
    pub fn sweep<E: From<VolumeError> + Send>(
        &mut self,
        thickness: usize,
        halo: usize,
        mut work: impl FnMut(Slab<'_, S>, Range<usize>) -> Result<(), E> + Send,
    ) -> Result<(), E> {
        let depth = self.size[2];
        let thickness = thickness.clamp(1, depth);
        let reach = |start: usize| start.saturating_sub(halo)..(start + thickness + halo).min(depth);
        for start in (0..depth).step_by(thickness) {
            self.hold(reach(start))?;
            self.execution.check().map_err(VolumeError::from)?;
            let core = start..(start + thickness).min(depth);
            let missing = self.held.end..reach(start + thickness).end;
            if start + thickness >= depth || missing.is_empty() {
                work(self.slab(), core)?;
                continue;
            }
            let (mut reader, mut ahead) = (self.reader.take(), S::wrap(take(&mut self.ahead)));
            let (slab, execution) = (self.slab(), self.execution);
            // A reader is there, since the slices held are not all and were read by it.
            let (worked, read) = rayon::join(
                || work(slab, core),
                || reader.as_mut().map_or(Ok(()), |r| r.read(missing, &mut ahead, execution)),
            );
            worked?;
            if let Err(error) = read {
                self.clear();
                return Err(error.into());
            }
            self.reader = reader;
            self.ahead = S::unwrap(ahead).unwrap_or_default();
        }
        self.ahead = Vec::new();
        Ok(())
    }

    /// Bytes that a [`sweep`](SampleWindow::sweep) of a volume of `size` voxels takes at most.
    #[must_use]
    pub fn sweep_bytes(size: [usize; 3], thickness: usize, halo: usize) -> u64 {
        sweep_bytes(size, S::TYPE, thickness, halo)
    }

    fn clear(&mut self) {
        (self.held, self.dropped) = (0..0, 0);
        (self.samples, self.ahead) = (Vec::new(), Vec::new());
        self.reader = None;
    }

    fn move_to(&mut self, slices: Range<usize>) -> Result<(), VolumeError> {
        let slice = self.size[0] * self.size[1];
        if (self.held.start..=self.held.end).contains(&slices.start) {
            self.dropped += (slices.start - self.held.start) * slice;
            self.held.start = slices.start;
        } else {
            // A new pass may need less room.
            (self.samples, self.ahead) = (Vec::new(), Vec::new());
            (self.held, self.dropped) = (slices.start..slices.start, 0);
        }
        let kept = self.samples.len() - self.dropped;
        if self.dropped >= kept {
            self.samples.copy_within(self.dropped.., 0);
            self.samples.truncate(kept);
            self.dropped = 0;
        }
        if !self.ahead.is_empty() {
            let read = self.ahead.len() / slice;
            let total = self.samples.len() + self.ahead.len();
            reserve(&mut self.samples, total)?;
            self.samples.extend_from_slice(&self.ahead);
            self.ahead.clear();
            self.held.end += read;
        }
        if self.held.end >= slices.end {
            return Ok(());
        }
        let mut reader = match self.reader.take() {
            Some(reader) => reader,
            None => self.source.slices(&VoxelBox::whole(self.size))?,
        };
        let mut samples: Samples = S::wrap(take(&mut self.samples));
        reader.read(self.held.end..slices.end, &mut samples, self.execution)?;
        let actual = samples.sample_type();
        self.samples = S::unwrap(samples).ok_or(VolumeError::Type { wanted: S::TYPE, actual })?;
        self.reader = Some(reader);
        self.held.end = slices.end;
        Ok(())
    }
}

/// Bytes that a [`SampleWindow::sweep`] over a volume of `size` voxels of type `sample` takes at most:
/// the core, the halo, dropped slices that still take memory, and the slices read ahead.
#[must_use]
pub fn sweep_bytes(size: [usize; 3], sample: SampleType, thickness: usize, halo: usize) -> u64 {
    let [width, height, depth] = size.map(|n| n as u64);
    let (thickness, halo) = ((thickness as u64).clamp(1, depth), halo as u64);
    let window = thickness.saturating_add(halo.saturating_mul(4)).min(depth);
    let ahead = if thickness < depth { thickness } else { 0 };
    (width * height).saturating_mul(window + ahead).saturating_mul(sample.bytes() as u64)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use proptest::prelude::*;

    use super::*;
    use crate::grid::Geometry;
    use crate::volume::MemorySource;

    const SIZE: [usize; 3] = [3, 2, 17];

    /// A volume behind a file's interface, which counts the slices read.
    struct Counted {
        inner: MemorySource,
        slices: AtomicUsize,
    }

    impl Counted {
        fn new() -> Self {
            let geometry = Geometry::axis_aligned(SIZE, [1.0; 3]).unwrap();
            let samples = Samples::U16((0..102).collect());
            Self { inner: MemorySource::new(geometry, samples).unwrap(), slices: AtomicUsize::new(0) }
        }
    }

    impl VolumeSource for Counted {
        fn geometry(&self) -> &Geometry {
            self.inner.geometry()
        }
        fn sample_type(&self) -> SampleType {
            SampleType::U16
        }
        fn cheap_partial_reads(&self) -> bool {
            false
        }
        fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
            self.slices.fetch_add(part.size()[2], Ordering::Relaxed);
            self.inner.read(part)
        }
    }

    fn check(slab: Slab<'_, u16>, slices: Range<usize>) {
        for z in slices {
            for y in 0..2 {
                let first = (z * 2 + y) as u16 * 3;
                assert_eq!(slab.row(y, z), [first, first + 1, first + 2]);
            }
        }
    }

    proptest! {
        #[test]
        fn a_window_holds_what_was_asked_for(moves in prop::collection::vec((0..17usize, 1..17usize), 1..20)) {
            let (source, execution) = (Counted::new(), Execution::default());
            let mut window = SampleWindow::<u16>::new(&source, &execution).unwrap();
            for (start, count) in moves {
                let slices = start..(start + count).min(17);
                window.hold(slices.clone()).unwrap();
                check(window.slab(), slices);
            }
        }

        #[test]
        fn a_sweep_reads_each_slice_once_and_takes_no_more_memory_than_it_says(
            thickness in 1..20usize,
            halo in 0..9usize,
        ) {
            let (source, execution) = (Counted::new(), Execution::default());
            let mut window = SampleWindow::<u16>::new(&source, &execution).unwrap();
            for pass in 1..3 {
                let (mut next, mut most) = (0, 0);
                window.sweep(thickness, halo, |slab, core| {
                    assert_eq!(core.start, next);
                    next = core.end;
                    most = most.max(slab.slices().len());
                    check(slab, core.start.saturating_sub(halo)..(core.end + halo).min(17));
                    Ok::<_, VolumeError>(())
                }).unwrap();
                assert_eq!(next, 17);
                let all = most == 17;
                prop_assert_eq!(source.slices.load(Ordering::Relaxed), if all { 17 } else { 17 * pass });
                let bytes = 2 * (window.samples.capacity() + window.ahead.capacity()) as u64;
                prop_assert!(bytes <= SampleWindow::<u16>::sweep_bytes(SIZE, thickness, halo));
            }
        }
    }

    #[test]
    fn a_volume_in_memory_is_not_copied_and_wrong_types_and_slices_are_refused() {
        let (source, execution) = (Counted::new(), Execution::default());
        let mut window = SampleWindow::<u16>::new(&source.inner, &execution).unwrap();
        window.hold(3..9).unwrap();
        check(window.slab(), 0..17);
        assert_eq!(window.samples.capacity(), 0);
        assert!(matches!(SampleWindow::<u8>::new(&source, &execution), Err(VolumeError::Type { .. })));
        let mut window = SampleWindow::<u16>::new(&source, &execution).unwrap();
        for slices in [3..3, 0..18, 20..21] {
            assert!(matches!(window.hold(slices), Err(VolumeError::Box { .. })));
        }
        execution.cancel_flag().store(true, Ordering::Relaxed);
        assert!(matches!(window.hold(0..3), Err(VolumeError::Cancelled(_))));
    }
}
