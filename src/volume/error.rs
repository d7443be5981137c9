//! Why a volume cannot be read: one variant per failure, with the value, the limit and what to do.
//!
//! Each message is complete by itself: what the system or the geometry said stands in it, and is not
//! given as a source once more.

use std::fmt;
use std::path::PathBuf;

use thiserror::Error;

use super::SampleType;
use crate::execution::Cancelled;
use crate::grid::{GeometryError, VoxelBox};

/// The formats that [`super::open()`] knows, as shown to a user.
pub(crate) const KNOWN_FORMATS: &str = "MetaImage (.mha, .mhd), NRRD (.nrrd, .nhdr), TIFF (a multi-page .tif or \
     .tiff, or a folder of numbered slices), and headerless samples when their size and type are given";

/// Why a volume cannot be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum VolumeError {
    /// The file system refused, or a compressed stream is damaged.
    #[error("cannot read {}: {error}{}", path.display(), remedy(error))]
    Io {
        /// What was to be read.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// Header values that make no geometry.
    #[error("{}: {error}", path.display())]
    Geometry {
        /// The file whose header it is.
        path: PathBuf,
        /// What is wrong with it.
        error: GeometryError,
    },
    /// A box that is empty or reaches beyond the volume.
    #[error("the box {box_low:?} to {box_high:?} is not inside the volume of {size:?} voxels: every range must \
             hold at least one voxel and end at the size at most", box_low = .part.low, box_high = .part.high)]
    Box {
        /// The box asked for.
        part: VoxelBox,
        /// Voxels per axis of the volume.
        size: [usize; 3],
    },
    /// Fewer or more samples than the size says.
    #[error("{got} samples for a volume of {size:?} voxels, which needs {needed}")]
    Length {
        /// Samples given.
        got: usize,
        /// Voxels per axis.
        size: [usize; 3],
        /// Samples needed.
        needed: usize,
    },
    /// The file is of no known format.
    #[error("{}: the format is not known. Known are {KNOWN_FORMATS}{}", path.display(), hint(*.headerless))]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// Whether its name says that it holds nothing but samples.
        headerless: bool,
    },
    /// A layout of headerless samples was given for a file that has a header.
    #[error("{}: this is a {format} file, whose header says size, type, byte order and offset; leave them out", path.display())]
    LayoutNotNeeded {
        /// The file.
        path: PathBuf,
        /// Its format.
        format: &'static str,
    },
    /// The file uses something that is not read.
    #[error("{}: {feature} is not supported; supported: {supported}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What it uses.
        feature: String,
        /// What it could use instead.
        supported: &'static str,
    },
    /// A header field that is needed is not there.
    #[error("{}: the header has no field `{field}`, which is needed: {why}", path.display())]
    MissingField {
        /// The file.
        path: PathBuf,
        /// The field's name in this format.
        field: &'static str,
        /// What for.
        why: &'static str,
    },
    /// A header field has a value that makes no sense.
    #[error("{}: the header field `{field}` is `{value}`, but {expected} is expected", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// The field's name in this format.
        field: String,
        /// Its value (shortened).
        value: String,
        /// What would be right.
        expected: String,
    },
    /// The file is not what its name or first bytes promise.
    #[error("{}: not a readable {format} file: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The format it should have.
        format: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// Fewer bytes than the header asks for.
    #[error("{}: {needed} bytes of samples are needed but {got} are there: the file is cut off, or its size or type is wrong", path.display())]
    Truncated {
        /// The file with the samples.
        path: PathBuf,
        /// Bytes of samples that size and type ask for.
        needed: u64,
        /// Bytes there (for a compressed file: that there can be at most, or that came out).
        got: u64,
    },
    /// More bytes than the header asks for.
    #[error(
        "{}: size and type ask for {needed} bytes of samples, but {extra} or more bytes follow them: one of \
         the two is wrong, or the samples begin elsewhere than the header says",
        path.display()
    )]
    Excess {
        /// The file with the samples.
        path: PathBuf,
        /// Bytes of samples that size and type ask for.
        needed: u64,
        /// Bytes beyond them (at least).
        extra: u64,
    },
    /// A folder without slices.
    #[error("{}: no TIFF slices (.tif, .tiff) are in this folder; give a folder of numbered slices, or a volume file", folder.display())]
    NoSlices {
        /// The folder.
        folder: PathBuf,
    },
    /// Numbered slices with a gap.
    #[error("{}: slice number {missing} is missing between {before} and {after}: add it, or move the slices of one \
             side of the gap to another folder", folder.display())]
    MissingSlice {
        /// The folder.
        folder: PathBuf,
        /// The (first) number missing.
        missing: u64,
        /// The slice before the gap.
        before: String,
        /// The slice after the gap.
        after: String,
    },
    /// Names that do not count one series of slices.
    #[error("{}: {one} and {other} do not belong to one series of slices: {reason}. Keep one series per folder, with \
             names that differ in one number only", folder.display())]
    MixedSeries {
        /// The folder.
        folder: PathBuf,
        /// A slice.
        one: String,
        /// Another slice.
        other: String,
        /// How their names clash.
        reason: &'static str,
    },
    /// Two slices of different size or type.
    #[error("{one} is a slice of {} but {other} of {}: all slices of a volume must be alike", shape(*.one_size, *.one_type), shape(*.other_size, *.other_type))]
    UnequalSlices {
        /// The first slice.
        one: String,
        /// Its width and height.
        one_size: [usize; 2],
        /// Its number type.
        one_type: SampleType,
        /// The slice that differs.
        other: String,
        /// Its width and height.
        other_size: [usize; 2],
        /// Its number type.
        other_type: SampleType,
    },
    /// Samples that are no numbers.
    #[error(
        "{count} samples are not finite, the first is {value} at voxel {first:?}: replace them (by the value of \
             air, say) before extraction, no surface can be placed next to them"
    )]
    NotFinite {
        /// How many, among the samples read.
        count: usize,
        /// Index of the first one in the volume.
        first: [usize; 3],
        /// Its value.
        value: f32,
    },
    /// The memory for the samples is not there.
    #[error(
        "{bytes} bytes of memory for the samples are not available: take a part of the volume (a region of \
             interest), or a machine with more memory"
    )]
    Memory {
        /// Bytes asked for.
        bytes: usize,
    },
    /// Samples wanted as another number type than they have: a mistake of the program.
    #[error("the samples are of type {actual}, but were asked for as {wanted}")]
    Type {
        /// The type asked for.
        wanted: SampleType,
        /// The type that they have.
        actual: SampleType,
    },
    /// Stopped from outside, between two reads.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// What to do about an error of the system.
fn remedy(error: &std::io::Error) -> &'static str {
    match error.kind() {
        std::io::ErrorKind::NotFound => "; check the path",
        std::io::ErrorKind::PermissionDenied => "; ask for the right to read it, or copy it",
        _ => "",
    }
}

fn hint(headerless: bool) -> &'static str {
    if headerless { ". This looks like headerless samples: give --size X,Y,Z and --type" } else { "" }
}

fn shape([width, height]: [usize; 2], sample: SampleType) -> String {
    format!("{width} x {height} {sample}")
}

impl fmt::Display for SampleType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::U8 => "u8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::F32 => "f32",
        })
    }
}
