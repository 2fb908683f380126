//! Whole-system tests, laws and benches.
//!
//! What they share: where to find scenes that are not part of the repository.

use std::path::{Path, PathBuf};

/// The folder of shared scenes and references, when it stands beside the project (or where `LUMICAST_SHARED` says).
pub fn shared_folder() -> Option<PathBuf> {
    if let Some(folder) = std::env::var_os("LUMICAST_SHARED") {
        return Some(PathBuf::from(folder)).filter(|folder| folder.join("scenes").is_dir());
    }
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .map(|ancestor| ancestor.join("shared"))
        .find(|folder| folder.join("scenes").is_dir())
}
