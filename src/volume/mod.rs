//! Grey values: the [`VolumeSource`] trait, its readers, and samples in memory.

mod samples;
mod source;

pub use samples::{Sample, SampleType, Samples};
pub use source::{MemorySource, VolumeError, VolumeSource};
