//! Why a volume cannot be classified.

use thiserror::Error;

use crate::execution::Cancelled;
use crate::volume::VolumeError;

/// Why a volume cannot be classified.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ClassifyError {
    /// No voxel is surrounded by its own material.
    #[error(
        "no voxel is surrounded by its own material within the blur radius of {radius:.2?} voxels, so nothing is certain; give a smaller --radius, or check the materials' grey values"
    )]
    NoCore {
        /// Radius of the core sphere, voxels per axis.
        radius: [f64; 3],
    },
    /// The blur radius is not usable.
    #[error(
        "the blur radius {radius:.2?} is not usable: every value must be above 0 and at most {limit} voxels; 2 or 3 is usual (--radius)"
    )]
    Radius {
        /// As given, voxels per axis.
        radius: [f64; 3],
        /// The largest radius.
        limit: f64,
    },
    /// A label volume with too many labels.
    #[error(
        "the label volume has more than {limit} different labels, which is the most there may be; merge some, or leave out --labels if it holds grey values"
    )]
    TooManyLabels {
        /// How many there may be.
        limit: usize,
    },
    /// A label volume with a single label.
    #[error(
        "every voxel has the label {label}; an interface needs at least 2 labels; leave out --labels if the volume holds grey values, or take another part with --roi"
    )]
    OneLabel {
        /// The label.
        label: f64,
    },
    /// Bricks that are not of one volume, or not all of those needed.
    #[error(
        "the bricks given do not hold slice {slice} of the padded volume, or are of different volumes; give the brick and its neighbours, all from the same run"
    )]
    Bricks {
        /// A padded slice that is missing, or the first one of a brick that does not fit.
        slice: usize,
    },
    /// The volume could not be read.
    #[error(transparent)]
    Volume(#[from] VolumeError),
    /// The scratch file for labels failed.
    #[error(
        "cannot keep labels aside in a scratch file beside the result: {source}; make room there, choose another --out, or allow more --memory"
    )]
    Scratch {
        /// What the system says.
        source: std::io::Error,
    },
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}
