//! The folder of a scene file: the only place from which files that it refers to are read.

use std::{
    fs::File,
    io::{self, Read},
    path::{Component, Path, PathBuf},
};

use super::error::{AssetError, Bound};

/// A scene's folder with the bytes that may still be taken from it.
#[derive(Debug)]
pub(in crate::assets) struct Folder {
    /// Canonical; `None` where the scene came without a folder.
    root: Option<PathBuf>,
    bytes_max: u64,
    bytes_taken: u64,
}

impl Folder {
    /// For bytes that came over the network: nothing can be read beside them.
    pub(in crate::assets) fn none(bytes_max: u64) -> Folder {
        Folder { root: None, bytes_max, bytes_taken: 0 }
    }

    /// The folder that holds `file`.
    pub(in crate::assets) fn of_file(file: &Path, bytes_max: u64) -> Result<Folder, AssetError> {
        let read_error = |source| AssetError::Read { file: String::new(), source };
        let file = file.canonicalize().map_err(read_error)?;
        Ok(Folder { root: file.parent().map(Path::to_path_buf), bytes_max, bytes_taken: 0 })
    }

    /// Counts bytes that do not come from a file (decoded data URIs) against the same bound.
    pub(in crate::assets) fn take_bytes(&mut self, object: &str, bytes: u64) -> Result<(), AssetError> {
        let taken = self.bytes_taken.saturating_add(bytes);
        self.bound().check(object, taken)?;
        self.bytes_taken = taken;
        Ok(())
    }

    /// Reads the file at the relative, already percent-decoded address `uri`, asked for by `object`.
    pub(in crate::assets) fn read(&mut self, object: &str, uri: &str) -> Result<Vec<u8>, AssetError> {
        let short = || uri.chars().take(200).collect::<String>();
        let refuse = |problem: &str| AssetError::Uri {
            file: String::new(),
            object: object.into(),
            uri: short(),
            problem: problem.into(),
        };
        let missing =
            |source| AssetError::Missing { file: String::new(), object: object.into(), uri: short(), source };
        let path = relative(uri).map_err(refuse)?;
        let Some(root) = &self.root else {
            return Err(refuse("names a file, but the scene came without a folder: use .glb or data URIs"));
        };
        let path = root.join(path).canonicalize().map_err(missing)?;
        if !path.starts_with(root) {
            return Err(refuse("leads out of the scene's folder through a link: copy the file there"));
        }
        let bytes = match read_file(&path, self.bytes_max - self.bytes_taken, "file_side_bytes") {
            Err(AssetError::Read { source, .. }) => return Err(missing(source)),
            other => other?,
        };
        self.bytes_taken += bytes.len() as u64;
        Ok(bytes)
    }

    fn bound(&self) -> Bound {
        Bound { what: "bytes beside the scene file", limit: self.bytes_max, setting: "file_side_bytes" }
    }
}

/// Checks that an address stays below where it starts, on every operating system alike.
fn relative(uri: &str) -> Result<PathBuf, &'static str> {
    let outside = "is not inside the scene's folder: put the file beside the scene and name it relatively";
    // A colon before any slash is a scheme (`http:`, `file:`) or a drive; backslashes separate on Windows.
    let first = uri.split(['/', '\\']).next().unwrap_or_default();
    if uri.is_empty() || uri.contains('\0') {
        return Err("names no file");
    }
    if first.contains(':') {
        return Err("has a scheme or a drive, but only data URIs and files in the scene's folder are read");
    }
    if uri.starts_with(['/', '\\']) || uri.split(['/', '\\']).any(|part| part == "..") {
        return Err(outside);
    }
    let path = PathBuf::from(uri);
    let stays = |part| matches!(part, Component::Normal(_) | Component::CurDir);
    if path.components().all(stays) { Ok(path) } else { Err(outside) }
}

/// Reads a regular file of at most `bytes_max`. Pipes and devices, which may never end, are refused.
pub(in crate::assets) fn read_file(
    path: &Path,
    bytes_max: u64,
    setting: &'static str,
) -> Result<Vec<u8>, AssetError> {
    let read_error = |source| AssetError::Read { file: String::new(), source };
    // Opening a pipe would wait for its writer, so the kind is asked for first.
    if !path.metadata().map_err(read_error)?.is_file() {
        return Err(read_error(io::Error::other("it is not a regular file")));
    }
    let file = File::open(path).map_err(read_error)?;
    let length = file.metadata().map_err(read_error)?.len();
    let bound = Bound { what: "bytes", limit: bytes_max, setting };
    let object = path.file_name().unwrap_or_default().to_string_lossy();
    bound.check(object.as_ref(), length)?;
    let mut bytes = Vec::with_capacity(length as usize);
    // One byte more than allowed shows a file that grew meanwhile.
    file.take(bytes_max.saturating_add(1)).read_to_end(&mut bytes).map_err(read_error)?;
    bound.check(object.as_ref(), bytes.len() as u64)?;
    Ok(bytes)
}
