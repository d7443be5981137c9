//! Grey values: the [`VolumeSource`] trait, its readers, and samples in memory.
//!
//! [`open()`] reads MetaImage, NRRD, TIFF (multi-page files and folders of slices) and headerless
//! samples. All readers hold to the same rules: a header is checked against the file before memory
//! is taken, memory grows only with data that is really there, what is not read is refused by name,
//! and no sample that is not finite ever comes out.
//!
//! Volumes larger than memory are read through a [`SampleWindow`], some slices at a time, by positioned
//! reads: as lazy as a memory map, which would need `unsafe` code and crash where a file shrinks meanwhile.
//! A compressed stream is decompressed once in each pass.

mod collect;
#[cfg(test)]
mod conformance;
mod denoise;
mod error;
mod finite;
mod header;
pub(crate) mod kernel;
mod metaimage;
mod nrrd;
mod open;
mod positioned;
mod raw;
mod region;
mod respaced;
mod samples;
mod slab;
mod slices;
mod source;
mod stream;
mod tiff;
mod window;

pub use collect::Endian;
pub use denoise::{BILATERAL_GREY, Denoise, DenoiseError, Denoised, Length, MAX_REACH, NLM_GREY};
pub use error::VolumeError;
pub use finite::check_finite;
pub use open::{OpenOptions, open};
pub use raw::RawLayout;
pub use region::RegionOfInterest;
pub use respaced::Respaced;
pub use samples::{Sample, SampleType, Samples};
pub use slab::{Greys, Slab};
pub use slices::SliceReader;
pub use source::{MemorySource, VolumeSource};
pub use window::{SampleWindow, sweep_bytes};
