//! Results appear whole or not at all: written aside, then put in place by a rename.
//!
//! Guarantee: whatever goes wrong, the final path holds either what it held before or the finished
//! result, and nothing else is left behind (unless the process is killed: then a hidden
//! `.interfacet-*` entry may remain beside it). Not guaranteed: that replacing an existing *folder*
//! is one step; between its two renames the old one exists under a hidden name.

use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempDir};

use super::ExportError;

/// The file by which an output folder is known as an earlier result of this tool.
pub const RESULT_MARK: &str = "report.json";

const PREFIX: &str = ".interfacet-";

/// Writes the file `path` through `write`, aside in the same folder, and renames it into place once
/// it is complete and on disk. If anything fails, the temporary file is removed and an earlier file
/// at `path` stays as it was.
///
/// # Errors
/// [`ExportError`] naming `path`; errors of `write` as they are.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), ExportError> {
    let folder = parent(path)?;
    let failed = |source| ExportError::writing(path, source);
    let mut builder = Builder::new();
    builder.prefix(PREFIX).suffix(".tmp");
    // Without this the result would be readable by its owner only, unlike any other file.
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let aside = builder.tempfile_in(&folder).map_err(failed)?;
    let (file, aside) = aside.into_parts();
    let mut out = BufWriter::with_capacity(1 << 20, file);
    write(&mut out).map_err(failed)?;
    let file = out.into_inner().map_err(|e| failed(e.into_error()))?;
    file.sync_all().map_err(failed)?;
    drop(file);
    aside.persist(path).map_err(|e| failed(e.error))
}

/// The folder that will hold `path`.
fn parent(path: &Path) -> Result<PathBuf, ExportError> {
    let folder = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p.to_owned(),
        _ => PathBuf::from("."),
    };
    if folder.is_dir() { Ok(folder) } else { Err(ExportError::NoFolder { path: path.to_owned(), folder }) }
}

/// An output folder in the making: a hidden folder beside the final one. [`StagedFolder::commit`]
/// puts it in place; dropped without that, it is removed with all it holds.
#[derive(Debug)]
pub struct StagedFolder {
    aside: TempDir,
    target: PathBuf,
}

impl StagedFolder {
    /// Prepares the folder `target`. Made before the work starts, it finds out at once whether
    /// the result can be written there. An existing folder is accepted, to be replaced as a whole,
    /// if it is empty or holds an earlier result (a file [`RESULT_MARK`]).
    ///
    /// # Errors
    /// [`ExportError`] if there is something else at `target` or its parent is not writable.
    pub fn create(target: &Path) -> Result<Self, ExportError> {
        // A trailing slash or "." would make the parent the folder itself.
        let target: PathBuf = target.components().collect();
        let folder = parent(&target)?;
        check_replaceable(&target)?;
        let mut builder = Builder::new();
        builder.prefix(PREFIX);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(fs::Permissions::from_mode(0o777));
        }
        let aside = builder.tempdir_in(folder).map_err(|e| ExportError::writing(&target, e))?;
        Ok(Self { aside, target })
    }

    /// The folder to write into.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.aside.path()
    }

    /// Puts the folder in place of what is at the final path.
    ///
    /// # Errors
    /// [`ExportError`] if what is there now may not be replaced or the rename fails; what was there
    /// before stays.
    pub fn commit(self) -> Result<(), ExportError> {
        let Self { aside, target } = self;
        let failed = |source| ExportError::writing(&target, source);
        check_replaceable(&target)?;
        if !target.exists() {
            fs::rename(aside.path(), &target).map_err(failed)?;
            let _moved_away = aside.keep();
            return Ok(());
        }
        // The old folder steps aside first, so that it can come back if the second rename fails.
        let old = Builder::new().prefix(PREFIX).tempdir_in(parent(&target)?).map_err(failed)?;
        let kept = old.path().join("old");
        fs::rename(&target, &kept).map_err(failed)?;
        if let Err(source) = fs::rename(aside.path(), &target) {
            if fs::rename(&kept, &target).is_err() {
                // Never delete an earlier result that could not be put back.
                let _stays = old.keep();
            }
            return Err(failed(source));
        }
        let _moved_away = aside.keep();
        Ok(())
    }
}

/// Whether a result may be put at `target`.
fn check_replaceable(target: &Path) -> Result<(), ExportError> {
    let path = || target.to_owned();
    if fs::symlink_metadata(target).is_err() {
        return Ok(());
    }
    if !target.is_dir() {
        return Err(ExportError::NotAFolder { path: path() });
    }
    let mut entries = fs::read_dir(target).map_err(|e| ExportError::writing(target, e))?;
    if entries.next().is_none() || target.join(RESULT_MARK).is_file() {
        Ok(())
    } else {
        Err(ExportError::FolderInUse { path: path() })
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn entries(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_appears_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.ply");
        write_atomically(&path, |out| out.write_all(b"first")).unwrap();
        let error = write_atomically(&path, |out| {
            out.write_all(b"second")?;
            Err(io::ErrorKind::StorageFull.into())
        })
        .unwrap_err();
        assert!(matches!(error, ExportError::DiskFull { .. }) && error.to_string().contains("mesh.ply"));
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(entries(folder.path()), ["mesh.ply"]);
        let missing = folder.path().join("no/such/mesh.ply");
        assert!(matches!(write_atomically(&missing, |_| Ok(())), Err(ExportError::NoFolder { .. })));
    }

    #[test]
    fn a_folder_is_put_in_place_by_commit_only() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("out");
        let staged = StagedFolder::create(&target).unwrap();
        fs::write(staged.path().join(RESULT_MARK), "1").unwrap();
        drop(staged);
        assert!(entries(folder.path()).is_empty());
        for round in ["1", "2"] {
            // The second round replaces the first one's result, extra files and all.
            let staged = StagedFolder::create(&target.join("")).unwrap();
            fs::write(staged.path().join(RESULT_MARK), round).unwrap();
            fs::write(staged.path().join(round), "").unwrap();
            assert!(!target.join(round).exists());
            staged.commit().unwrap();
            assert_eq!(entries(&target), [round, RESULT_MARK]);
            assert_eq!(entries(folder.path()), ["out"]);
        }
    }

    #[test]
    fn only_empty_folders_and_earlier_results_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("photos");
        fs::create_dir(&target).unwrap();
        let staged = StagedFolder::create(&target).unwrap();
        // Filled by someone else meanwhile: refused, and left alone.
        fs::write(target.join("cat.jpg"), "").unwrap();
        assert!(matches!(staged.commit(), Err(ExportError::FolderInUse { .. })));
        let error = StagedFolder::create(&target).unwrap_err();
        assert!(
            error.to_string().contains("photos") && error.to_string().contains("empty folder"),
            "{error}"
        );
        assert_eq!(entries(&target), ["cat.jpg"]);
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        assert!(matches!(StagedFolder::create(&file), Err(ExportError::NotAFolder { .. })));
        assert!(matches!(
            StagedFolder::create(&folder.path().join("no/such")),
            Err(ExportError::NoFolder { .. })
        ));
        assert_eq!(entries(folder.path()), ["file", "photos"]);
    }
}
