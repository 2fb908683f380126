//! Whole files or none: bytes go to a temporary neighbour, to the disk, and only then under their name.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

/// A file that could not be written. What stood under its name before still stands there.
#[derive(Debug, thiserror::Error)]
#[error("writing {}: {step}: {source}", path.display())]
pub struct FileError {
    /// The file.
    pub path: PathBuf,
    /// What was being done.
    pub step: String,
    /// Why it failed.
    #[source]
    pub source: io::Error,
}

/// Writes `bytes` to `path`, atomically: readers see the old content or all of the new, also after a crash.
///
/// The temporary neighbour is called `.NAME.PID-N.part` and is removed on any failure.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    write_through(path, bytes, |temporary| OpenOptions::new().write(true).create_new(true).open(temporary))
}

/// `write_file` with the way a file is opened as a parameter, for tests that put a full disk there.
fn write_through(
    path: &Path,
    bytes: &[u8],
    open: impl Fn(&Path) -> io::Result<File>,
) -> Result<(), FileError> {
    let fail = |step: String| move |source| FileError { path: path.to_path_buf(), step, source };
    let (folder, temporary) = neighbour_of(path).map_err(fail("choosing a temporary name".into()))?;
    let file = open(&temporary).map_err(fail(format!("creating {}", temporary.display())))?;
    // From here on the temporary file exists; dropped before the rename, it goes.
    let mut guard = Temporary { path: &temporary, keep: false };
    let stored = store(file, bytes);
    stored.map_err(fail(format!("storing {} bytes in {}", bytes.len(), temporary.display())))?;
    fs::rename(&temporary, path).map_err(fail(format!("giving {} its final name", temporary.display())))?;
    guard.keep = true;
    // The rename itself lasts once the folder is on disk. Some file systems refuse that, and then have
    // nothing better to offer: the file is whole either way.
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
    Ok(())
}

fn store(mut file: File, bytes: &[u8]) -> io::Result<()> {
    file.write_all(bytes)?;
    file.sync_all()
}

/// The folder of `path` and a name in it that nobody else uses.
fn neighbour_of(path: &Path) -> io::Result<(PathBuf, PathBuf)> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().ok_or_else(|| io::Error::other("the path names no file"))?;
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
        _ => PathBuf::from("."),
    };
    let mut temporary = std::ffi::OsString::from(".");
    temporary.push(name);
    temporary.push(format!(".{}-{}.part", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed)));
    let temporary = folder.join(temporary);
    Ok((folder, temporary))
}

struct Temporary<'a> {
    path: &'a Path,
    keep: bool,
}

impl Drop for Temporary<'_> {
    fn drop(&mut self) {
        if !self.keep {
            // Nothing more can be done when this fails; the error on its way up names the file.
            let _ = fs::remove_file(self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names_in(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    /// A written file holds the bytes and stands alone; writing again replaces it.
    #[test]
    fn files_are_written_and_replaced_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        for bytes in [&b"first"[..], b"second and longer", b""] {
            write_file(&path, bytes).unwrap();
            assert_eq!(fs::read(&path).unwrap(), bytes);
            assert_eq!(names_in(folder.path()), ["a.bin"]);
        }
    }

    /// On a full disk the old file stays, no temporary file does, and the error says what, where and why.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        write_file(&path, b"old").unwrap();
        let full_disk = |temporary: &Path| {
            File::create_new(temporary)?;
            // Every write to this device fails as on a full disk.
            OpenOptions::new().write(true).open("/dev/full")
        };
        let message = write_through(&path, b"new", full_disk).unwrap_err().to_string();
        assert!(message.contains("a.bin") && message.contains("storing 3 bytes"), "{message}");
        assert!(message.contains("No space left"), "{message}");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names_in(folder.path()), ["a.bin"]);
    }

    /// A path that cannot be is refused by name and leaves nothing behind.
    #[test]
    fn impossible_paths_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("no-such-folder/a.bin");
        assert!(write_file(&missing, b"x").unwrap_err().to_string().contains("no-such-folder"));
        // A folder stands where the file should go: the rename fails after the bytes were stored.
        let taken = folder.path().join("taken");
        fs::create_dir(&taken).unwrap();
        assert!(write_file(&taken, b"x").unwrap_err().to_string().contains("final name"));
        assert_eq!(names_in(folder.path()), ["taken"]);
        assert!(write_file(Path::new("/"), b"x").is_err());
    }
}
