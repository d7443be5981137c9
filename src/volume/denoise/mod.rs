//! Filters that take noise out of a volume before anything is looked for in it (Li et al. 2022, §2.1).
//!
//! [`Denoise`] says which filter and with what parameters; [`Denoised`] is a volume seen through it: a
//! [`VolumeSource`](super::VolumeSource) of `f32` samples, so that nothing is rounded away, which filters what is read of it. A
//! filtered value depends on the voxels around it only, computed in a fixed order: slabs and threads
//! change no bit. What the filters are good for: `docs/preprocessing.md`.

mod bilateral;
mod denoised;
mod filter;
mod gaussian;
mod keep;
mod kernel;
mod mean;
mod median;
mod nlm;
mod options;
mod rows;
mod separable;
#[cfg(test)]
mod tests;

pub use denoised::Denoised;
pub use options::{BILATERAL_GREY, Denoise, DenoiseError, Length, MAX_REACH, NLM_GREY};
