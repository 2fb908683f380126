//! `--snapshots`: the picture over time, for plots of error against seconds.

use std::{
    fs,
    path::{Path, PathBuf},
};

use lumicast_engine::render::Rendering;
use serde::Serialize;

use super::super::CliError;
use crate::images::{ExrLayers, PictureFacts, encode_exr, write_file};

/// One line of `index.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Entry {
    seconds: f64,
    file: String,
    /// Null below two samples per pixel and for black pictures.
    error: Option<f64>,
    error_ci: Option<[f64; 2]>,
    technique: &'static str,
}

/// Snapshots in a folder. `index.json` is replaced whole after every picture, so it is right at any time.
#[derive(Debug)]
pub(super) struct Snapshots {
    folder: PathBuf,
    entries: Vec<Entry>,
    /// Snapshots of the schedule that are over, written or not.
    passed: u32,
    samples_at_last: u64,
}

impl Snapshots {
    /// Snapshots into `folder`, which is made when it is missing.
    pub(super) fn new(folder: &Path) -> Result<Snapshots, CliError> {
        fs::create_dir_all(folder).map_err(|source| CliError::System {
            doing: format!("creating the folder {} for snapshots", folder.display()),
            source,
        })?;
        Ok(Snapshots { folder: folder.to_path_buf(), entries: Vec::new(), passed: 0, samples_at_last: 0 })
    }

    /// Number of pictures written.
    pub(super) fn count(&self) -> usize {
        self.entries.len()
    }

    /// When the next one is due, seconds since the scene was loaded.
    pub(super) fn next_seconds(&self) -> f64 {
        scheduled_seconds(self.passed)
    }

    /// Writes the film if one is due; several that were missed are one.
    pub(super) fn take_if_due(
        &mut self,
        rendering: &Rendering,
        facts: &PictureFacts,
        seconds: f64,
    ) -> Result<(), CliError> {
        if seconds < self.next_seconds() {
            return Ok(());
        }
        while self.next_seconds() <= seconds {
            self.passed += 1;
        }
        self.take(rendering, facts, seconds)
    }

    /// Writes the film unless it is the one written last.
    pub(super) fn take(
        &mut self,
        rendering: &Rendering,
        facts: &PictureFacts,
        seconds: f64,
    ) -> Result<(), CliError> {
        if rendering.sample_count() == self.samples_at_last {
            return Ok(());
        }
        self.samples_at_last = rendering.sample_count();
        let file = format!("{:04}.exr", self.entries.len() + 1);
        let facts = PictureFacts { seconds: Some(seconds), ..facts.clone() };
        write_file(&self.folder.join(&file), &encode_exr(&rendering.picture(), ExrLayers::Plain, &facts)?)?;
        let PictureFacts { error, error_ci, technique, .. } = facts;
        self.entries.push(Entry { seconds, file, error, error_ci, technique });
        let mut index = serde_json::to_vec_pretty(&self.entries)
            .map_err(|error| CliError::System { doing: "writing index.json".into(), source: error.into() })?;
        index.push(b'\n');
        Ok(write_file(&self.folder.join("index.json"), &index)?)
    }
}

/// 0.1, 0.2, 0.5, 1, 2, 5 …
fn scheduled_seconds(index: u32) -> f64 {
    let steps = [0.1, 0.2, 0.5];
    steps[index as usize % 3] * 10f64.powi((index / 3) as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumicast_engine::{film::PictureSize, render::RenderSettings, scene::samples, transport::World};
    use std::sync::{Arc, atomic::AtomicBool};

    fn facts(error: Option<f64>) -> PictureFacts {
        let error_ci = error.map(|error| [error / 2.0, error * 2.0]);
        PictureFacts {
            revision: 1,
            seed: 0,
            samples_per_pixel: 1,
            technique: "path",
            error,
            error_ci,
            seconds: None,
        }
    }

    /// The schedule is the contract's.
    #[test]
    fn snapshots_are_due_at_one_two_five() {
        let seconds: Vec<f64> = (0..8).map(scheduled_seconds).collect();
        for (ours, contract) in seconds.iter().zip([0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0]) {
            assert!((ours / contract - 1.0).abs() < 1e-12);
        }
    }

    /// Missed snapshots are one; nothing is written twice; the index says exactly what is there.
    #[test]
    fn the_index_lists_what_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let mut snapshots = Snapshots::new(&folder.path().join("new/folder")).unwrap();
        let world = Arc::new(World::prepare(Arc::new(samples::cornell_box().unwrap())));
        let (view, size) = (world.scene().default_view(), PictureSize::new(4, 4).unwrap());
        let mut rendering = Rendering::new(world, view, size, RenderSettings::default());
        let never = AtomicBool::new(false);
        rendering.step(&never);
        snapshots.take_if_due(&rendering, &facts(None), 0.05).unwrap();
        assert_eq!(snapshots.count(), 0);
        snapshots.take_if_due(&rendering, &facts(None), 0.7).unwrap();
        snapshots.take_if_due(&rendering, &facts(None), 0.9).unwrap();
        rendering.step(&never);
        snapshots.take_if_due(&rendering, &facts(Some(0.125)), 1.0).unwrap();
        snapshots.take(&rendering, &facts(Some(0.125)), 1.5).unwrap();
        let path = folder.path().join("new/folder/index.json");
        let index: serde_json::Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
        let expected = serde_json::json!([
            {"seconds": 0.7, "file": "0001.exr", "error": null, "error_ci": null, "technique": "path"},
            {"seconds": 1.0, "file": "0002.exr", "error": 0.125, "error_ci": [0.0625, 0.25],
             "technique": "path"},
        ]);
        assert_eq!(index, expected);
        assert_eq!(fs::read_dir(folder.path().join("new/folder")).unwrap().count(), 3);
    }
}
