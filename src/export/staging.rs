//! Results appear whole or not at all: written aside, then put in place by a rename.
//!
//! Guarantee: whatever goes wrong, the final path holds either what it held before or the finished
//! result, and nothing else is left behind (unless the process is killed: then a hidden
//! `.interfacet-*` entry may remain beside it). A program that must end at once, whatever its other
//! threads are at, keeps the guarantee by [`abandon_unfinished`]. Not guaranteed: that replacing an
//! existing *folder* is one step; between its two renames the old one exists under a hidden name.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, BufWriter, Read};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::Duration;

use tempfile::{Builder, TempDir, TempPath};

use super::ExportError;

/// The file by which an output folder is known as an earlier result of this tool.
pub const RESULT_MARK: &str = "report.json";

const PREFIX: &str = ".interfacet-";

/// What this process has aside and not in place yet. Whoever makes such an entry or puts it in place
/// holds the lock meanwhile, so that nothing can slip past [`abandon_unfinished`].
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An entry of [`UNFINISHED`]; dropped, it is taken off the list.
#[derive(Debug)]
struct Listed(PathBuf);

impl Listed {
    /// Makes an entry and lists it, in one step.
    fn make<T>(make: impl FnOnce() -> io::Result<T>, path: impl Fn(&T) -> &Path) -> io::Result<(T, Self)> {
        let mut all = unfinished();
        let made = make()?;
        let path = path(&made).to_owned();
        all.insert(path.clone());
        Ok((made, Self(path)))
    }
}

impl Drop for Listed {
    fn drop(&mut self) {
        unfinished().remove(&self.0);
    }
}

/// While it lives, nothing new is begun or put in place; see [`abandon_unfinished`].
#[must_use]
pub struct Abandoned {
    _held: Option<MutexGuard<'static, BTreeSet<PathBuf>>>,
}

/// Removes all that this process has under way through [`write_atomically`] and [`StagedFolder`], and
/// lets nothing be begun or put in place while the returned value lives. For a program that is about
/// to exit although its other threads have not stopped, as after an interrupt; it takes at most about
/// a second, even if another thread hangs in a call to the file system.
pub fn abandon_unfinished() -> Abandoned {
    const TRIES: usize = 10;
    const PAUSE: Duration = Duration::from_millis(20);
    let mut held = None;
    for _ in 0..TRIES {
        match UNFINISHED.try_lock() {
            Ok(all) => held = Some(all),
            Err(TryLockError::Poisoned(all)) => held = Some(all.into_inner()),
            Err(TryLockError::WouldBlock) => {}
        }
        let Some(all) = &mut held else {
            std::thread::sleep(PAUSE);
            continue;
        };
        all.retain(|path| {
            let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
            // Something may have been written into a folder while it was being emptied.
            removed.is_err_and(|e| e.kind() != io::ErrorKind::NotFound)
        });
        if all.is_empty() {
            break;
        }
        std::thread::sleep(PAUSE);
    }
    Abandoned { _held: held }
}

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
    let failed = |source| ExportError::writing(path, source);
    let (staged, file) = StagedFile::create(path)?;
    let mut out = BufWriter::with_capacity(1 << 20, file);
    write(&mut out).map_err(failed)?;
    let file = out.into_inner().map_err(|e| failed(e.into_error()))?;
    staged.commit(file)
}

/// A file in the making, beside its final path. [`StagedFile::commit`] puts it in place; dropped
/// without that, it is removed.
#[derive(Debug)]
pub(super) struct StagedFile {
    // Before `listed`: it must be gone from the disk before it is gone from the list.
    aside: TempPath,
    listed: Listed,
    target: PathBuf,
}

impl StagedFile {
    /// Begins the file `target`; what is to be in it goes into the file returned.
    pub(super) fn create(target: &Path) -> Result<(Self, File), ExportError> {
        let folder = parent(target)?;
        let mut builder = Builder::new();
        builder.prefix(PREFIX).suffix(".tmp");
        // Without this the result would be readable by its owner only, unlike any other file.
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(fs::Permissions::from_mode(0o666));
        }
        let (aside, listed) = Listed::make(|| builder.tempfile_in(&folder), |file| file.path())
            .map_err(|e| ExportError::writing(target, e))?;
        let (file, aside) = aside.into_parts();
        Ok((Self { aside, listed, target: target.to_owned() }, file))
    }

    /// A file without a name in the same folder, gone when it is closed.
    pub(super) fn scratch(&self) -> Result<File, ExportError> {
        let folder = parent(&self.target)?;
        tempfile::tempfile_in(folder).map_err(|e| ExportError::writing(&self.target, e))
    }

    /// The final path.
    pub(super) fn target(&self) -> &Path {
        &self.target
    }

    /// Puts the file in place once it is on disk.
    pub(super) fn commit(self, file: File) -> Result<(), ExportError> {
        let Self { aside, listed, target } = self;
        file.sync_all().map_err(|e| ExportError::writing(&target, e))?;
        drop(file);
        let mut all = unfinished();
        let placed = aside.persist(&target).map_err(|e| ExportError::writing(&target, e.error));
        if placed.is_ok() {
            all.remove(&listed.0);
        }
        drop(all);
        placed
    }
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
    // Before `listed`: it must be gone from the disk before it is gone from the list.
    aside: TempDir,
    listed: Listed,
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
        // A trailing slash, "." or ".." would make the parent the folder itself; of a link, the folder
        // it leads to is to be replaced.
        let target: PathBuf = match fs::canonicalize(target) {
            Ok(path) if path.is_dir() => path,
            _ => target.components().collect(),
        };
        let folder = parent(&target)?;
        check_replaceable(&target)?;
        let mut builder = Builder::new();
        builder.prefix(PREFIX);
        #[cfg(unix)]
        {
            use std::os::unix::fs::{MetadataExt, PermissionsExt};
            let device = |path: &Path| fs::metadata(path).map(|m| m.dev()).ok();
            if target.is_dir() && device(&target) != device(&folder) {
                return Err(ExportError::MountPoint { path: target });
            }
            builder.permissions(fs::Permissions::from_mode(0o777));
        }
        let (aside, listed) = Listed::make(|| builder.tempdir_in(folder), TempDir::path)
            .map_err(|e| ExportError::writing(&target, e))?;
        Ok(Self { aside, listed, target })
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
        let Self { target, listed, aside } = self;
        let failed = |source| ExportError::writing(&target, source);
        check_replaceable(&target)?;
        let mut all = unfinished();
        if !target.exists() {
            if let Err(source) = fs::rename(aside.path(), &target) {
                drop(all);
                return Err(failed(source));
            }
            all.remove(&listed.0);
            drop(all);
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
        // The new one is in place; from here on it is the old one that must not stay behind.
        all.remove(&listed.0);
        all.insert(old.path().to_owned());
        drop(all);
        let _moved_away = aside.keep();
        let _removed_after_old = Listed(old.path().to_owned());
        drop(old);
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
    if entries.next().is_none() || is_result(target) {
        Ok(())
    } else {
        Err(ExportError::FolderInUse { path: path() })
    }
}

/// Whether the folder holds a report of this tool. Others write files called report.json too, and a
/// folder taken for an earlier result is deleted.
fn is_result(folder: &Path) -> bool {
    let mut start = Vec::new();
    let read = File::open(folder.join(RESULT_MARK)).and_then(|file| file.take(256).read_to_end(&mut start));
    let text: String = String::from_utf8_lossy(&start).split_whitespace().collect();
    read.is_ok() && text.starts_with("{\"tool\":\"interfacet")
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
        let report = |round: &str| format!("{{\n  \"tool\": \"interfacet {round}\",\n");
        for round in ["1", "2"] {
            // The second round replaces the first one's result, extra files and all.
            let staged = StagedFolder::create(&target.join("")).unwrap();
            fs::write(staged.path().join(RESULT_MARK), report(round)).unwrap();
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
        // A report of another tool makes it no result of ours.
        fs::write(target.join(RESULT_MARK), "{\"tool\": \"camera\"}").unwrap();
        assert!(matches!(StagedFolder::create(&target), Err(ExportError::FolderInUse { .. })));
        assert_eq!(entries(&target), ["cat.jpg", RESULT_MARK]);
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
