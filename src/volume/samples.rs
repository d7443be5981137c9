//! Samples in memory: one of four number types, x fastest.

use serde::{Deserialize, Serialize};

use super::VolumeError;
use super::collect::reserve;

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
pub trait Sample: Copy + Send + Sync + PartialOrd + Default + 'static {
    /// This type, by name.
    const TYPE: SampleType;
    /// How many values the type has, if few enough to count each one; 0 otherwise.
    const LEVELS: usize;

    /// The value as `f32`.
    fn to_f32(self) -> f32;

    /// The value's place among all values of the type, in ascending order: below [`Sample::LEVELS`],
    /// 0 if that is 0.
    fn level(self) -> usize;

    /// The value at a place, the opposite of [`Sample::level`].
    fn at_level(level: usize) -> Self;

    /// Samples of a type known only when the program runs.
    fn wrap(samples: Vec<Self>) -> Samples;

    /// The samples, if they are of this type.
    fn unwrap(samples: Samples) -> Option<Vec<Self>>;

    /// The samples, if they are of this type.
    fn view(samples: &Samples) -> Option<&[Self]>;
}

macro_rules! sample {
    ($type:ident, $name:ident, $levels:expr, $value:ident => $level:expr, $at:ident => $back:expr) => {
        impl Sample for $type {
            const TYPE: SampleType = SampleType::$name;
            const LEVELS: usize = $levels;

            fn to_f32(self) -> f32 {
                self as f32
            }

            fn level(self) -> usize {
                let $value = self;
                $level
            }

            fn at_level($at: usize) -> Self {
                $back
            }

            fn wrap(samples: Vec<Self>) -> Samples {
                Samples::$name(samples)
            }

            fn unwrap(samples: Samples) -> Option<Vec<Self>> {
                if let Samples::$name(values) = samples { Some(values) } else { None }
            }

            fn view(samples: &Samples) -> Option<&[Self]> {
                if let Samples::$name(values) = samples { Some(values) } else { None }
            }
        }
    };
}

sample!(u8, U8, 1 << 8, v => usize::from(v), i => i as u8);
sample!(u16, U16, 1 << 16, v => usize::from(v), i => i as u16);
sample!(i16, I16, 1 << 16, v => usize::from(v.wrapping_add(i16::MIN) as u16), i => (i as u16 as i16).wrapping_add(i16::MIN));
sample!(f32, F32, 0, _v => 0, _i => 0.0);

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

/// Runs `$body` with the type `$S` bound to the number type that a [`SampleType`] names.
#[macro_export]
macro_rules! with_sample_type {
    ($sample:expr, $S:ident => $body:expr) => {
        match $sample {
            $crate::volume::SampleType::U8 => {
                type $S = u8;
                $body
            }
            $crate::volume::SampleType::U16 => {
                type $S = u16;
                $body
            }
            $crate::volume::SampleType::I16 => {
                type $S = i16;
                $body
            }
            $crate::volume::SampleType::F32 => {
                type $S = f32;
                $body
            }
        }
    };
}

impl Samples {
    /// No samples, of type `sample`.
    #[must_use]
    pub fn none(sample: SampleType) -> Self {
        match sample {
            SampleType::U8 => Self::U8(Vec::new()),
            SampleType::U16 => Self::U16(Vec::new()),
            SampleType::I16 => Self::I16(Vec::new()),
            SampleType::F32 => Self::F32(Vec::new()),
        }
    }

    /// Adds `more` behind these samples.
    ///
    /// # Errors
    /// [`VolumeError::Type`] if they are of another type, [`VolumeError::Memory`] if there is no room.
    pub fn append(&mut self, more: Self) -> Result<(), VolumeError> {
        fn join<T: Copy>(v: &mut Vec<T>, more: Vec<T>) -> Result<(), VolumeError> {
            if v.capacity() == 0 {
                *v = more;
                return Ok(());
            }
            reserve(v, v.len().saturating_add(more.len()))?;
            v.extend_from_slice(&more);
            Ok(())
        }
        match (self, more) {
            (Self::U8(v), Self::U8(more)) => join(v, more),
            (Self::U16(v), Self::U16(more)) => join(v, more),
            (Self::I16(v), Self::I16(more)) => join(v, more),
            (Self::F32(v), Self::F32(more)) => join(v, more),
            (v, more) => Err(VolumeError::Type { wanted: v.sample_type(), actual: more.sample_type() }),
        }
    }

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
