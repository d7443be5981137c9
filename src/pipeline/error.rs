//! Why a volume did not become a mesh.

use thiserror::Error;

use super::SinkError;
use crate::classify::ClassifyError;
use crate::contour::ContourError;
use crate::execution::Cancelled;
use crate::material::{FindError, MaterialTableError};
use crate::mesh::MeshError;
use crate::volume::{DenoiseError, VolumeError};

/// Why a volume did not become a mesh.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PipelineError {
    /// It could not be read.
    #[error(transparent)]
    Volume(#[from] VolumeError),
    /// No materials were found.
    #[error(transparent)]
    Find(#[from] FindError),
    /// The materials given are not usable.
    #[error(transparent)]
    Materials(#[from] MaterialTableError),
    /// It could not be classified.
    #[error(transparent)]
    Classify(#[from] ClassifyError),
    /// The surface could not be extracted.
    #[error(transparent)]
    Contour(#[from] ContourError),
    /// The filter against noise is not usable.
    #[error(transparent)]
    Denoise(#[from] DenoiseError),
    /// A filter against noise, for labels.
    #[error(
        "labels have no noise that could be filtered: leave out --denoise, or --labels if these are grey values"
    )]
    DenoiseLabels,
    /// All voxels became one material.
    #[error(
        "every voxel was given to the material '{material}', so there is no interface; check the materials' grey values (`interfacet info` shows the histogram), or try a smaller --radius"
    )]
    NoInterface {
        /// Its name.
        material: String,
    },
    /// A tolerance that is no number.
    #[error(
        "the tolerance {value} is not a finite number; give --tolerance in voxels (0.1) or in mm (0.02mm), or --phi in square voxels"
    )]
    Tolerance {
        /// What was given.
        value: f64,
    },
    /// The surface makes no mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The memory budget holds not even one slice and what it takes to work on it.
    #[error(
        "the memory budget of {} is too small: this volume of {size:?} voxels needs at least {} (--memory)",
        bytesize::ByteSize(*budget), bytesize::ByteSize(*needed)
    )]
    Memory {
        /// Bytes allowed.
        budget: u64,
        /// Bytes that the smallest slab needs.
        needed: u64,
        /// Voxels per axis.
        size: [usize; 3],
    },
    /// There would be more vertices than can be numbered.
    #[error(
        "the surface would have about {vertices} vertices; {limit} is the most that 32-bit numbers in PLY can name. Take a part of the volume with --roi, or check the materials' grey values"
    )]
    TooManyVertices {
        /// As estimated.
        vertices: u64,
        /// The most there may be.
        limit: u64,
    },
    /// What was to be done with the surface failed.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}
