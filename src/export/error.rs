//! [`ExportError`]: why a file could not be written or read, with its path and what to do.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::execution::Cancelled;
use crate::mesh::MeshError;

/// Why a file could not be written or read. Every variant but `Cancelled` names the path.
#[derive(Debug, Error)]
pub enum ExportError {
    /// The disk is full, or a quota is used up.
    #[error(
        "cannot write {}: no space is left there; free some or choose a folder on another disk. Nothing was left behind",
        path.display()
    )]
    DiskFull {
        /// The file or folder.
        path: PathBuf,
    },
    /// Writing is not allowed there.
    #[error("cannot write {}: permission denied; choose a folder you may write to", path.display())]
    NotWritable {
        /// The file or folder.
        path: PathBuf,
    },
    /// A folder on which a file system is mounted.
    #[error("cannot put the result at {}: it is a mount point and cannot be replaced; choose a folder inside it", path.display())]
    MountPoint {
        /// The folder.
        path: PathBuf,
    },
    /// The folder for the result does not exist.
    #[error("cannot write {}: there is no folder {}; create it first, or choose another", path.display(), folder.display())]
    NoFolder {
        /// The file or folder to be written.
        path: PathBuf,
        /// The folder that is missing.
        folder: PathBuf,
    },
    /// A limit on the size of a file.
    #[error(
        "cannot write {}: the file is too large for the disk, or for the limit that the shell sets (ulimit -f); choose a folder on another disk, or raise the limit. Nothing was left behind",
        path.display()
    )]
    FileTooLarge {
        /// The file or folder.
        path: PathBuf,
    },
    /// Writing failed otherwise.
    #[error("cannot write {}: {source}; choose another folder, or another name", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The output folder holds something else than an earlier result.
    #[error(
        "the output folder {} holds files that are not an earlier result (no {}); choose a new or an empty folder, or delete it",
        path.display(),
        super::RESULT_MARK
    )]
    FolderInUse {
        /// The folder.
        path: PathBuf,
    },
    /// The output folder's path is taken by something that is not a folder.
    #[error("{} exists and is not a folder; choose another output folder", path.display())]
    NotAFolder {
        /// The path.
        path: PathBuf,
    },
    /// A mesh that the format cannot hold.
    #[error("cannot write {}: {what}", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// What is too large, with number and limit.
        what: String,
    },
    /// Pieces of a mesh that do not go together. No fault of a user: of a program that makes pieces.
    #[error("cannot write {}: {what}", path.display())]
    Pieces {
        /// The file.
        path: PathBuf,
        /// What does not fit.
        what: String,
    },
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// A file could not be opened or read.
    #[error("cannot read {}: {source}; check the path and whether you may read it", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A file in no known format.
    #[error("{} is not a mesh that can be read: {what}; PLY (ascii, binary) and STL (ascii, binary) can", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// What was found instead.
        what: String,
    },
    /// A file that breaks its format's rules.
    #[error("{} is not a usable {format} file: {what}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The format it claims.
        format: &'static str,
        /// What is wrong, and where.
        what: String,
    },
    /// A file that is well formed but holds no valid mesh.
    #[error("{} holds no usable mesh: {source}", path.display())]
    Mesh {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: MeshError,
    },
}

impl ExportError {
    /// The error that fits a failed write to `path`.
    pub(crate) fn writing(path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => Self::DiskFull { path },
            io::ErrorKind::FileTooLarge => Self::FileTooLarge { path },
            io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => Self::NotWritable { path },
            // `tempfile` adds the name it made up, which tells nobody anything.
            kind => match source.to_string().split_once(" at path ") {
                Some((said, _)) => Self::Write { path, source: io::Error::new(kind, said) },
                None => Self::Write { path, source },
            },
        }
    }

    /// A malformed file.
    pub(crate) fn malformed(path: &Path, format: &'static str, what: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), format, what: what.into() }
    }
}
