//! [`Denoised`]: a volume seen through a filter.

use std::ops::Range;

use rayon::prelude::*;

use super::filter::Filter;
use super::options::{Denoise, DenoiseError};
use crate::execution::Execution;
use crate::grid::{Geometry, VoxelBox};
use crate::volume::collect::reserve;
use crate::volume::slices::slices_of;
use crate::volume::source::{check_box, crop};
use crate::volume::{
    Sample, SampleType, Samples, Slab, SliceReader, VolumeError, VolumeSource, check_finite,
};
use crate::with_samples;

/// Voxels that are filtered at a time, about, if there is memory for them.
const AT_A_TIME: usize = 1 << 22;

/// Another volume with its noise filtered as it is read, in `f32`. What is read twice is filtered twice:
/// [`Denoised::in_memory`] and [`Denoised::in_file`] keep the filtered volume.
pub struct Denoised<'a> {
    source: &'a dyn VolumeSource,
    denoise: Denoise,
    filter: Filter,
    slices: usize,
}

impl<'a> Denoised<'a> {
    /// `source` seen through `denoise`, whose grey parameter must be known (see [`Denoise::with_noise`]).
    ///
    /// # Errors
    /// [`DenoiseError`] for parameters that make no sense in this volume.
    pub fn new(source: &'a dyn VolumeSource, denoise: Denoise) -> Result<Self, DenoiseError> {
        let filter = Filter::new(&denoise, source.geometry())?;
        let [width, height, depth] = source.geometry().size();
        let slices = AT_A_TIME.div_ceil(width * height).clamp(1, depth);
        Ok(Self { source, denoise, filter, slices })
    }

    /// The same, but for `slices` slices that are filtered at a time.
    #[must_use]
    pub fn with_slices(mut self, slices: usize) -> Self {
        self.slices = slices.max(1);
        self
    }

    /// How many slices are filtered at a time: if not set, some million voxels.
    #[must_use]
    pub fn slices_at_a_time(&self) -> usize {
        self.slices
    }

    /// The filter and its parameters.
    #[must_use]
    pub fn denoise(&self) -> &Denoise {
        &self.denoise
    }

    /// Bytes that it takes to read slices in order, `slices` of them at a time, beside those that are
    /// returned.
    #[must_use]
    pub fn bytes(&self, slices: usize) -> u64 {
        let [width, height, depth] = self.source.geometry().size().map(|n| n as u64);
        let (slices, reach) = ((slices as u64).clamp(1, depth), self.filter.reach()[2] as u64);
        let held = slices + 2 * reach;
        // Held and its copies; as it was read; filtered; what each thread works on.
        let threads = rayon::current_num_threads() as u64;
        let all = (1 + self.filter.copies()) * held + held + slices + threads.min(slices);
        all.saturating_mul(width * height).saturating_mul(size_of::<f32>() as u64)
    }

    /// A box and all that its filtered values depend on.
    fn grown(&self, part: &VoxelBox) -> VoxelBox {
        let (reach, size) = (self.filter.reach(), self.source.geometry().size());
        VoxelBox {
            low: [0, 1, 2].map(|a| part.low[a].saturating_sub(reach[a])),
            high: [0, 1, 2].map(|a| (part.high[a] + reach[a]).min(size[a])),
        }
    }
}

impl VolumeSource for Denoised<'_> {
    fn geometry(&self) -> &Geometry {
        self.source.geometry()
    }

    fn sample_type(&self) -> SampleType {
        SampleType::F32
    }

    fn cheap_partial_reads(&self) -> bool {
        self.source.cheap_partial_reads()
    }

    fn read(&self, part: &VoxelBox) -> Result<Samples, VolumeError> {
        let mut out = Samples::none(SampleType::F32);
        self.append(part, &mut out, &Execution::default())?;
        Ok(out)
    }

    fn append(&self, part: &VoxelBox, out: &mut Samples, execution: &Execution) -> Result<(), VolumeError> {
        self.slices(part)?.read(0..part.size()[2], out, execution)
    }

    fn slices(&self, frame: &VoxelBox) -> Result<Box<dyn SliceReader + '_>, VolumeError> {
        check_box(frame, self.source.geometry().size())?;
        let grown = self.grown(frame);
        let reader = self.source.slices(&grown)?;
        Ok(Box::new(Filtered { volume: self, frame: *frame, grown, reader, held: Vec::new(), first: 0 }))
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = self.source.notes();
        notes.push(format!("noise was filtered: {}", self.denoise));
        notes
    }
}

/// Filters slices as they are read.
struct Filtered<'a> {
    volume: &'a Denoised<'a>,
    frame: VoxelBox,
    /// The frame and what its values depend on.
    grown: VoxelBox,
    /// Reads the grown frame.
    reader: Box<dyn SliceReader + 'a>,
    /// Slices of the grown frame as they were read, from `first` on.
    held: Vec<f32>,
    first: usize,
}

impl Filtered<'_> {
    /// Sees to it that the slices `slices` of the grown frame are held and none below them.
    fn hold(&mut self, slices: Range<usize>, execution: &Execution) -> Result<(), VolumeError> {
        let [width, height, _] = self.grown.size();
        let slice = width * height;
        let end = self.first + self.held.len() / slice;
        if (self.first..=end).contains(&slices.start) {
            self.held.drain(..(slices.start - self.first) * slice);
        } else {
            self.held.clear();
        }
        self.first = slices.start;
        let missing = self.first + self.held.len() / slice..slices.end;
        if missing.is_empty() {
            return Ok(());
        }
        let mut read = Samples::none(self.volume.source.sample_type());
        self.reader.read(missing, &mut read, execution)?;
        let total = self.held.len() + read.len();
        reserve(&mut self.held, total)?;
        with_samples!(&read, v => self.held.par_extend(v.par_iter().map(|v| v.to_f32())));
        Ok(())
    }

    /// The slices `slices` of the grown frame, filtered, and cut to the frame.
    fn filtered(&mut self, slices: Range<usize>, execution: &Execution) -> Result<Vec<f32>, VolumeError> {
        let (size, reach) = (self.grown.size(), self.volume.filter.reach()[2]);
        self.hold(slices.start.saturating_sub(reach)..(slices.end + reach).min(size[2]), execution)
            .inspect_err(|_| self.held.clear())?;
        let mut out = Vec::new();
        reserve(&mut out, slices.len() * size[0] * size[1])?;
        out.resize(slices.len() * size[0] * size[1], 0.0);
        let held = Slab::new(&self.held, size, self.first);
        self.volume.filter.apply(held, slices.start, &mut out, execution)?;
        if self.grown.size()[..2] == self.frame.size()[..2] {
            return Ok(out);
        }
        let low = [0, 1].map(|a| self.frame.low[a] - self.grown.low[a]);
        let high = [0, 1].map(|a| low[a] + self.frame.size()[a]);
        let cut = VoxelBox { low: [low[0], low[1], 0], high: [high[0], high[1], slices.len()] };
        Ok(crop(&out, [size[0], size[1], slices.len()], &cut))
    }
}

impl SliceReader for Filtered<'_> {
    fn read(
        &mut self,
        slices: Range<usize>,
        out: &mut Samples,
        execution: &Execution,
    ) -> Result<(), VolumeError> {
        slices_of(&self.frame, slices.clone())?;
        let below = self.frame.low[2] - self.grown.low[2];
        for start in slices.clone().step_by(self.volume.slices) {
            execution.check()?;
            let end = (start + self.volume.slices).min(slices.end);
            let filtered = Samples::F32(self.filtered(start + below..end + below, execution)?);
            // Values near the end of what f32 can hold may leave it.
            check_finite(&filtered, &slices_of(&self.frame, start..end)?)?;
            out.append(filtered)?;
        }
        Ok(())
    }
}
