//! What a scan itself says about a mesh: the mesh's materials, blurred as the scan is, against its grey values.
//!
//! [`residual()`] needs no ground truth. The *model* of a voxel is what a scanner of the stated blur would see of the
//! mesh: the exact share of each material in every cell of a finer grid (`coverage`), times that material's
//! grey value there, convolved with a Gaussian per axis and averaged over the voxel. Measured less model is the
//! *residual*: noise and whatever the levels and the blur do not explain where the surface is right, and
//! up to half of the contrast where it is off. A plane that is off by a share of sigma leaves at most 0.4 of that share
//! of the contrast.
//!
//! Guaranteed: the same figures for any number of threads, and memory for some slices of the volume besides the mesh
//! and three numbers for each of its triangles. Not guaranteed: a small residual does not prove a surface
//! right that blur cannot tell from another (two errors that cancel in the blur), and where the blur or
//! the levels are wrong, the residual is theirs, before and after alike.

mod by_slice;
mod coverage;
mod grey;
mod near;
mod residual;
mod statistics;

pub use residual::{LevelChoice, Residual, ResidualError, ResidualOptions, residual};
pub use statistics::{DeepResidual, Figures, PairResidual};
