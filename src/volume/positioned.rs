//! Reads at a position of a file, without moving a shared cursor: safe from many threads at once.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use super::VolumeError;

/// An open file and its length when it was opened.
#[derive(Debug)]
pub(crate) struct PositionedFile {
    path: PathBuf,
    file: File,
    len: u64,
}

impl PositionedFile {
    /// Opens a file for reading.
    pub(crate) fn open(path: &Path) -> Result<Self, VolumeError> {
        // Before it is opened: a pipe would make us wait, forever perhaps.
        let meta = std::fs::metadata(path).map_err(|error| io_error(path, error))?;
        if meta.is_dir() {
            return Err(io_error(path, io::Error::other("this is a folder, not a file")));
        }
        if !meta.is_file() {
            let what = "this is no regular file (a pipe or a device): save its content to a file first";
            return Err(io_error(path, io::Error::other(what)));
        }
        let file = File::open(path).map_err(|error| io_error(path, error))?;
        let meta = file.metadata().map_err(|error| io_error(path, error))?;
        Ok(Self { path: path.to_owned(), file, len: meta.len() })
    }

    /// A scratch file without a name, made in `folder`.
    pub(crate) fn scratch(file: File, folder: &Path) -> Result<Self, VolumeError> {
        let len = file.metadata().map_err(|error| io_error(folder, error))?.len();
        Ok(Self { path: folder.to_owned(), file, len })
    }

    /// Where the file is.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes in the file when it was opened.
    pub(crate) fn len(&self) -> u64 {
        self.len
    }

    /// Fills `buffer` from `position` on; returns fewer bytes only at the end of the file.
    pub(crate) fn read_up_to(&self, position: u64, buffer: &mut [u8]) -> io::Result<usize> {
        let mut done = 0;
        while done < buffer.len() {
            match read_some(&self.file, &mut buffer[done..], position + done as u64) {
                Ok(0) => break,
                Ok(n) => done += n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(done)
    }

    /// Fills `buffer` from `position` on.
    pub(crate) fn read_exact(&self, position: u64, buffer: &mut [u8]) -> Result<(), VolumeError> {
        let got = self.read_up_to(position, buffer).map_err(|error| io_error(&self.path, error))?;
        if got < buffer.len() {
            let (needed, got) = (position + buffer.len() as u64, position + got as u64);
            return Err(VolumeError::Truncated { path: self.path.clone(), needed, got });
        }
        Ok(())
    }

    /// At most `limit` bytes from the file's start.
    pub(crate) fn start(&self, limit: usize) -> Result<Vec<u8>, VolumeError> {
        let limit = self.len.min(limit as u64) as usize;
        let mut bytes = vec![0; limit];
        let got = self.read_up_to(0, &mut bytes).map_err(|error| io_error(&self.path, error))?;
        bytes.truncate(got);
        Ok(bytes)
    }

    /// A reader with its own cursor, from `position` on.
    pub(crate) fn reader(&self, position: u64) -> Cursor<'_> {
        Cursor { file: self, position }
    }
}

/// A cursor of its own over a shared file.
pub(crate) struct Cursor<'a> {
    file: &'a PositionedFile,
    position: u64,
}

impl io::Read for Cursor<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let got = self.file.read_up_to(self.position, buffer)?;
        self.position += got as u64;
        Ok(got)
    }
}

/// An error of the file system, with the path.
pub(crate) fn io_error(path: &Path, error: io::Error) -> VolumeError {
    VolumeError::Io { path: path.to_owned(), error }
}

#[cfg(unix)]
fn read_some(file: &File, buffer: &mut [u8], position: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buffer, position)
}

#[cfg(windows)]
fn read_some(file: &File, buffer: &mut [u8], position: u64) -> io::Result<usize> {
    // Moves the cursor as well, but nobody here relies on the cursor.
    std::os::windows::fs::FileExt::seek_read(file, buffer, position)
}
