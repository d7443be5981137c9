//! From bytes to samples: rows of a box, pushed as they arrive, become typed samples.
//!
//! Memory grows with the bytes that really arrived, never from a header's numbers alone; a caller
//! that has already checked the length of an uncompressed file may reserve at once.

use bytemuck::Pod;
use serde::{Deserialize, Serialize};

use super::finite::check_finite;
use super::{SampleType, Samples, VolumeError};
use crate::grid::VoxelBox;

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

/// Collects the rows of one box, in order.
pub(crate) struct Collector {
    samples: Samples,
    /// Samples of the whole box.
    needed: usize,
    part: VoxelBox,
}

impl Collector {
    /// An empty collector for the samples of `part`.
    pub(crate) fn new(sample: SampleType, part: &VoxelBox) -> Self {
        let samples = match sample {
            SampleType::U8 => Samples::U8(Vec::new()),
            SampleType::U16 => Samples::U16(Vec::new()),
            SampleType::I16 => Samples::I16(Vec::new()),
            SampleType::F32 => Samples::F32(Vec::new()),
        };
        Self { samples, needed: part.size().iter().product(), part: *part }
    }

    /// Makes room for the whole box at once. Only for callers that know the bytes to be there.
    pub(crate) fn reserve_all(&mut self) -> Result<(), VolumeError> {
        let needed = self.needed;
        match &mut self.samples {
            Samples::U8(v) => reserve(v, needed),
            Samples::U16(v) => reserve(v, needed),
            Samples::I16(v) => reserve(v, needed),
            Samples::F32(v) => reserve(v, needed),
        }
    }

    /// Appends whole samples, given in byte order `endian`.
    pub(crate) fn push(&mut self, bytes: &[u8], endian: Endian) -> Result<(), VolumeError> {
        let swap = endian != Endian::NATIVE;
        match &mut self.samples {
            Samples::U8(v) => append(v, bytes, false, self.needed),
            Samples::U16(v) => append(v, bytes, swap, self.needed),
            Samples::I16(v) => append(v, bytes, swap, self.needed),
            Samples::F32(v) => append(v, bytes, swap, self.needed),
        }
    }

    /// The samples, once all rows of the box were pushed.
    pub(crate) fn finish(self) -> Result<Samples, VolumeError> {
        debug_assert_eq!(self.samples.len(), self.needed, "a reader left rows out");
        check_finite(&self.samples, &self.part)?;
        Ok(self.samples)
    }
}

fn reserve<T>(v: &mut Vec<T>, total: usize) -> Result<(), VolumeError> {
    v.try_reserve_exact(total.saturating_sub(v.len()))
        .map_err(|_| VolumeError::Memory { bytes: total.saturating_mul(size_of::<T>()) })
}

fn append<T: SwapBytes>(v: &mut Vec<T>, bytes: &[u8], swap: bool, needed: usize) -> Result<(), VolumeError> {
    let start = v.len();
    let end = start + bytes.len() / size_of::<T>();
    if end > v.capacity() {
        // Twice as much each time, but not beyond what the box will need in the end.
        reserve(v, end.max((2 * v.capacity()).min(needed)))?;
    }
    v.resize(end, T::zeroed());
    bytemuck::cast_slice_mut::<T, u8>(&mut v[start..])
        .copy_from_slice(&bytes[..(end - start) * size_of::<T>()]);
    if swap {
        v[start..].iter_mut().for_each(|x| *x = x.swapped());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_byte_orders_give_the_same_samples() {
        let part = VoxelBox::whole([2, 1, 1]);
        let collect = |sample, endian, bytes: &[u8]| {
            let mut c = Collector::new(sample, &part);
            c.push(bytes, endian).unwrap();
            c.finish().unwrap()
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
