//! Samples in memory: one of four number types, x fastest.

use serde::{Deserialize, Serialize};

/// The number type of a volume's samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SampleType {
    /// 8-bit unsigned.
    U8,
    /// 16-bit unsigned.
    U16,
    /// 16-bit signed.
    I16,
    /// 32-bit floating point.
    F32,
}

impl SampleType {
    /// Bytes per sample.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::F32 => 4,
        }
    }
}

/// A number type that voxels may have. Every value converts to `f32` without loss.
pub trait Sample: Copy + Send + Sync + PartialOrd + 'static {
    /// The value as `f32`.
    fn to_f32(self) -> f32;
}

impl Sample for u8 {
    fn to_f32(self) -> f32 {
        f32::from(self)
    }
}
impl Sample for u16 {
    fn to_f32(self) -> f32 {
        f32::from(self)
    }
}
impl Sample for i16 {
    fn to_f32(self) -> f32 {
        f32::from(self)
    }
}
impl Sample for f32 {
    fn to_f32(self) -> f32 {
        self
    }
}

/// The samples of a box of voxels, x fastest, then y, then z.
#[derive(Debug, Clone, PartialEq)]
pub enum Samples {
    /// 8-bit unsigned.
    U8(Vec<u8>),
    /// 16-bit unsigned.
    U16(Vec<u16>),
    /// 16-bit signed.
    I16(Vec<i16>),
    /// 32-bit floating point.
    F32(Vec<f32>),
}

/// Runs `$body` with `$v` bound to the typed vector inside `$samples`.
#[macro_export]
macro_rules! with_samples {
    ($samples:expr, $v:ident => $body:expr) => {
        match $samples {
            $crate::volume::Samples::U8($v) => $body,
            $crate::volume::Samples::U16($v) => $body,
            $crate::volume::Samples::I16($v) => $body,
            $crate::volume::Samples::F32($v) => $body,
        }
    };
}

impl Samples {
    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        with_samples!(self, v => v.len())
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Their number type.
    #[must_use]
    pub fn sample_type(&self) -> SampleType {
        match self {
            Self::U8(_) => SampleType::U8,
            Self::U16(_) => SampleType::U16,
            Self::I16(_) => SampleType::I16,
            Self::F32(_) => SampleType::F32,
        }
    }

    /// The value at position `i` (x fastest).
    ///
    /// # Panics
    /// If `i` is not below [`Samples::len`].
    #[must_use]
    pub fn get(&self, i: usize) -> f32 {
        with_samples!(self, v => v[i].to_f32())
    }
}
