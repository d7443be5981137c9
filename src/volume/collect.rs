//! From bytes to samples: rows of a box, pushed as they arrive, become typed samples.
//!
//! Memory grows with the bytes that really arrived, never from a header's numbers alone; a caller
//! that has already checked the length of an uncompressed file may reserve at once.

use bytemuck::Pod;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::finite::check_values;
use super::{SampleType, Samples, VolumeError};
use crate::grid::VoxelBox;
use crate::with_samples;

/// Order of the bytes of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Endian {
    /// Least significant byte first: most files of today.
    #[default]
    Little,
    /// Most significant byte first.
    Big,
}

impl Endian {
    /// The order of this machine.
    pub(crate) const NATIVE: Self = if cfg!(target_endian = "little") { Self::Little } else { Self::Big };
}

trait SwapBytes: Pod {
    fn swapped(self) -> Self;
}

impl SwapBytes for u8 {
    fn swapped(self) -> Self {
        self
    }
}
impl SwapBytes for u16 {
    fn swapped(self) -> Self {
        self.swap_bytes()
    }
}
impl SwapBytes for i16 {
    fn swapped(self) -> Self {
        self.swap_bytes()
    }
}
impl SwapBytes for f32 {
    fn swapped(self) -> Self {
        Self::from_bits(self.to_bits().swap_bytes())
    }
}

/// Collects the rows of one box, in order, behind samples that are there already.
pub(crate) struct Collector<'a> {
    samples: &'a mut Samples,
    /// Samples that were there before.
    start: usize,
    /// Samples there will be in the end.
    end: usize,
    part: VoxelBox,
}

impl<'a> Collector<'a> {
    /// Collects the samples of `part`, of type `sample`, behind those of `out`.
    pub(crate) fn new(
        sample: SampleType,
        part: &VoxelBox,
        out: &'a mut Samples,
    ) -> Result<Self, VolumeError> {
        if out.sample_type() != sample {
            return Err(VolumeError::Type { wanted: out.sample_type(), actual: sample });
        }
        let start = out.len();
        let end = start.saturating_add(part.size().iter().product());
        Ok(Self { samples: out, start, end, part: *part })
    }

    /// Makes room for the whole box at once. Only for callers that know the bytes to be there.
    pub(crate) fn reserve_all(&mut self) -> Result<(), VolumeError> {
        let end = self.end;
        with_samples!(self.samples, v => reserve(v, end))
    }

    /// Appends whole samples, given in byte order `endian`.
    pub(crate) fn push(&mut self, bytes: &[u8], endian: Endian) -> Result<(), VolumeError> {
        let (swap, end) = (endian != Endian::NATIVE, self.end);
        with_samples!(self.samples, v => append(v, bytes, swap, end))
    }

    /// Lets `read(position, bytes)` fill the samples of the whole box, which `position` counts in
    /// bytes from its first one, a block at a time from all threads. Only for callers that know the
    /// bytes to be there.
    pub(crate) fn fill(
        &mut self,
        endian: Endian,
        read: impl Fn(u64, &mut [u8]) -> Result<(), VolumeError> + Sync,
    ) -> Result<(), VolumeError> {
        let (swap, end) = (endian != Endian::NATIVE, self.end);
        with_samples!(self.samples, v => fill(v, end, swap, &read))
    }

    /// Checks the samples, once all rows of the box were pushed.
    pub(crate) fn finish(self) -> Result<(), VolumeError> {
        debug_assert_eq!(self.samples.len(), self.end, "a reader left rows out");
        match &*self.samples {
            Samples::F32(values) => check_values(&values[self.start..], &self.part),
            _ => Ok(()),
        }
    }
}

/// Makes room for `total` samples.
pub(super) fn reserve<T>(v: &mut Vec<T>, total: usize) -> Result<(), VolumeError> {
    v.try_reserve_exact(total.saturating_sub(v.len()))
        .map_err(|_| VolumeError::Memory { bytes: total.saturating_mul(size_of::<T>()) })
}

fn append<T: SwapBytes>(v: &mut Vec<T>, bytes: &[u8], swap: bool, total: usize) -> Result<(), VolumeError> {
    let start = v.len();
    let end = start + bytes.len() / size_of::<T>();
    if end > v.capacity() {
        // Twice as much each time, but not beyond what the box will need in the end.
        reserve(v, end.max((2 * v.capacity()).min(total)))?;
    }
    v.resize(end, T::zeroed());
    bytemuck::cast_slice_mut::<T, u8>(&mut v[start..])
        .copy_from_slice(&bytes[..(end - start) * size_of::<T>()]);
    if swap {
        v[start..].iter_mut().for_each(|x| *x = x.swapped());
    }
    Ok(())
}

fn fill<T: SwapBytes + Send>(
    v: &mut Vec<T>,
    end: usize,
    swap: bool,
    read: &(impl Fn(u64, &mut [u8]) -> Result<(), VolumeError> + Sync),
) -> Result<(), VolumeError> {
    /// Bytes read at a time: enough to make system calls cheap.
    const BLOCK: usize = 1 << 20;
    let start = v.len();
    if v.capacity() == 0 {
        // The system hands out zeroed pages only when they are touched, which all threads then do.
        let zeroed = bytemuck::allocation::try_zeroed_slice_box(end);
        *v = zeroed.map_err(|()| VolumeError::Memory { bytes: end.saturating_mul(size_of::<T>()) })?.into();
    } else {
        reserve(v, end)?;
        v.resize(end, T::zeroed());
    }
    v[start..].par_chunks_mut(BLOCK / size_of::<T>()).enumerate().try_for_each(|(i, block)| {
        read((i * BLOCK) as u64, bytemuck::cast_slice_mut(block))?;
        if swap {
            block.iter_mut().for_each(|x| *x = x.swapped());
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_byte_orders_give_the_same_samples() {
        let part = VoxelBox::whole([2, 1, 1]);
        let collect = |sample, endian, bytes: &[u8]| {
            let mut out = Samples::none(sample);
            let mut c = Collector::new(sample, &part, &mut out).unwrap();
            c.push(bytes, endian).unwrap();
            c.finish().unwrap();
            out
        };
        assert_eq!(collect(SampleType::U8, Endian::Big, &[1, 2]), Samples::U8(vec![1, 2]));
        let little = collect(SampleType::I16, Endian::Little, &[0xfe, 0xff, 1, 2]);
        assert_eq!(little, Samples::I16(vec![-2, 513]));
        assert_eq!(collect(SampleType::I16, Endian::Big, &[0xff, 0xfe, 2, 1]), little);
        let (a, b) = (1.5_f32, -3.25e7_f32);
        let big = [a.to_be_bytes(), b.to_be_bytes()].concat();
        assert_eq!(collect(SampleType::F32, Endian::Big, &big), Samples::F32(vec![a, b]));
    }
}
