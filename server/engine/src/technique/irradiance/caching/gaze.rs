//! Who looks, and how far the walk over what he sees has come.

use crate::{film::PictureSize, scene::CameraView, technique::irradiance::walk::Walk};

/// A view whose pixels are to have records.
#[derive(Debug)]
pub(super) struct Gaze {
    pub(super) key: u64,
    pub(super) camera: CameraView,
    pub(super) size: PictureSize,
    pub(super) walk: Walk,
    /// What the cache's `shrunk_count` was when the walk began.
    pub(super) shrunk_before: u64,
    pub(super) walks_again: u32,
    /// All pixels have records.
    pub(super) is_covered: bool,
}

impl Gaze {
    /// - `shrunk_before`: of the cache when it begins
    pub(super) fn new(key: u64, camera: &CameraView, size: PictureSize, shrunk_before: u64) -> Gaze {
        let (camera, walk) = (*camera, Walk::over(size));
        Gaze { key, camera, size, walk, shrunk_before, walks_again: 0, is_covered: false }
    }

    pub(super) fn begin(&mut self, shrunk_before: u64) {
        self.walk = Walk::over(self.size);
        self.shrunk_before = shrunk_before;
        self.walks_again = 0;
        self.is_covered = false;
    }

    /// Walks over every pixel once more.
    pub(super) fn walk_again(&mut self, shrunk_before: u64) {
        self.walk = Walk::over_all(self.size);
        self.shrunk_before = shrunk_before;
        self.walks_again += 1;
        self.is_covered = false;
    }
}
