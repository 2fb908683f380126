//! Laws of import and export, on small files made here, and on the shared scenes where they are at hand.

mod export;
mod glb;
mod gltf;
mod gltf_materials;
mod hostile;
mod obj;
mod shared;

use std::path::PathBuf;

use lumicast_engine::scene::Scene;

use super::{AssetError, AssetLimits, load_scene};

/// A file in a folder of its own, gone at the end of the test.
pub(in crate::assets::tests) struct OnDisk {
    pub(in crate::assets::tests) folder: tempfile::TempDir,
    pub(in crate::assets::tests) path: PathBuf,
}

impl OnDisk {
    pub(in crate::assets::tests) fn new(name: &str, bytes: &[u8]) -> OnDisk {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("writing a test file");
        OnDisk { folder, path }
    }

    /// Adds a file beside the first.
    pub(in crate::assets::tests) fn with(self, name: &str, bytes: &[u8]) -> OnDisk {
        std::fs::write(self.folder.path().join(name), bytes).expect("writing a test file");
        self
    }

    pub(in crate::assets::tests) fn load(&self) -> Result<Scene, AssetError> {
        load_scene(&self.path, &AssetLimits::default())
    }
}

/// Loads bytes as a file called `name`.
pub(in crate::assets::tests) fn load(name: &str, bytes: &[u8]) -> Result<Scene, AssetError> {
    OnDisk::new(name, bytes).load()
}

/// Messages of a scene's warnings.
pub(in crate::assets::tests) fn warnings(scene: &Scene) -> Vec<String> {
    scene.warnings().iter().map(|warning| format!("{}: {}", warning.object, warning.message)).collect()
}

/// Asserts that one warning holds all of `parts`, and that there is no other.
#[track_caller]
pub(in crate::assets::tests) fn warns(scene: &Scene, parts: &[&str]) {
    let warnings = warnings(scene);
    let [warning] = &warnings[..] else { panic!("expected one warning with {parts:?}, got {warnings:?}") };
    assert!(parts.iter().all(|part| warning.contains(part)), "{warning:?} lacks some of {parts:?}");
}
