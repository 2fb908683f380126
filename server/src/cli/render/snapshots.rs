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
    /// Snapshots into `folder`, which is made when it is missing; those that an index there names are removed.
    pub(super) fn new(folder: &Path) -> Result<Snapshots, CliError> {
        fs::create_dir_all(folder).map_err(|source| CliError::System {
            doing: format!("creating the folder {} for snapshots", folder.display()),
            source,
        })?;
        remove_old(folder).map_err(|source| CliError::System {
            doing: format!("removing the snapshots of before from {}", folder.display()),
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

    /// Writes the film if one is due. Several that were missed are one, but for those at which the film was as it is: while it
    /// learns of the light the picture stays.
    pub(super) fn take_if_due(
        &mut self,
        rendering: &Rendering,
        facts: &PictureFacts,
        seconds: f64,
    ) -> Result<(), CliError> {
        let is_as_it_was = rendering.sample_count() == self.samples_at_last;
        let mut is_due = false;
        while self.next_seconds() <= seconds {
            if is_as_it_was {
                self.write(rendering, facts, self.next_seconds())?;
            }
            is_due = true;
            self.passed += 1;
        }
        if is_due && !is_as_it_was { self.write(rendering, facts, seconds) } else { Ok(()) }
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
        self.write(rendering, facts, seconds)
    }

    fn write(&mut self, rendering: &Rendering, facts: &PictureFacts, seconds: f64) -> Result<(), CliError> {
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

/// Removes the pictures that an index in the folder names, and the index: beside the new ones they would look like part of them.
fn remove_old(folder: &Path) -> std::io::Result<()> {
    // Other programs keep indices as well: every entry has what ours have.
    #[derive(serde::Deserialize)]
    struct Named {
        file: String,
        #[serde(rename = "seconds")]
        _seconds: f64,
        #[serde(rename = "technique")]
        _technique: String,
    }
    let index = folder.join("index.json");
    let Ok(json) = fs::read(&index) else { return Ok(()) };
    // Somebody else's index is left to be written over.
    let Ok(named) = serde_json::from_slice::<Vec<Named>>(&json) else { return Ok(()) };
    let is_ours = |file: &str| {
        file.strip_suffix(".exr")
            .is_some_and(|number| number.len() >= 4 && number.bytes().all(|digit| digit.is_ascii_digit()))
    };
    for Named { file, .. } in named.iter().filter(|named| is_ours(&named.file)) {
        match fs::remove_file(folder.join(file)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    fs::remove_file(&index)
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

    /// A folder that is used again loses the pictures its index names, and nothing else.
    #[test]
    fn old_snapshots_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        for name in ["0001.exr", "0002.exr", "0009.exr", "mine.exr", "notes.txt"] {
            put(name, "x");
        }
        let entries = ["0001.exr", "0002.exr", "0003.exr", "mine.exr", "../notes.txt", "notes.txt"];
        let entry = |file: &&str| {
            format!(r#"{{"seconds":1,"file":"{file}","error":null,"error_ci":null,"technique":"path"}}"#)
        };
        let json: Vec<String> = entries.iter().map(entry).collect();
        put("index.json", &format!("[{}]", json.join(",")));
        Snapshots::new(folder.path()).unwrap();
        let mut left: Vec<String> = fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        left.sort();
        assert_eq!(left, ["0009.exr", "mine.exr", "notes.txt"]);
        for foreign in ["not ours", r#"[{"file":"0009.exr"}]"#] {
            put("index.json", foreign);
            Snapshots::new(folder.path()).unwrap();
            assert!(folder.path().join("index.json").exists() && folder.path().join("0009.exr").exists());
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

    /// Snapshots that were missed while samples came are one, others are the picture of their moment; the last is not written twice;
    /// the index says exactly what is there.
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
        snapshots.take_if_due(&rendering, &facts(None), 2.5).unwrap();
        rendering.step(&never);
        snapshots.take_if_due(&rendering, &facts(Some(0.125)), 5.0).unwrap();
        snapshots.take(&rendering, &facts(Some(0.125)), 6.5).unwrap();
        let path = folder.path().join("new/folder/index.json");
        let index: serde_json::Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
        let expected = serde_json::json!([
            {"seconds": 0.7, "file": "0001.exr", "error": null, "error_ci": null, "technique": "path"},
            {"seconds": 1.0, "file": "0002.exr", "error": null, "error_ci": null, "technique": "path"},
            {"seconds": 2.0, "file": "0003.exr", "error": null, "error_ci": null, "technique": "path"},
            {"seconds": 5.0, "file": "0004.exr", "error": 0.125, "error_ci": [0.0625, 0.25],
             "technique": "path"},
        ]);
        assert_eq!(index, expected);
        assert_eq!(fs::read_dir(folder.path().join("new/folder")).unwrap().count(), 5);
    }
}
