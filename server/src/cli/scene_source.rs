//! SCENE of the command line: a file, or a built-in scene by name.

use std::{path::PathBuf, str::FromStr, sync::Arc, time::Instant};

use lumicast_engine::scene::{Scene, SceneError, samples};

use super::CliError;
use crate::assets::{AssetLimits, load_scene};

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SceneSource {
    /// A glTF or OBJ file.
    File(PathBuf),
    /// `builtin:cornell-box`.
    CornellBox,
    /// `builtin:boxes`.
    Boxes,
}

impl FromStr for SceneSource {
    type Err = String;

    fn from_str(value: &str) -> Result<SceneSource, String> {
        match value.strip_prefix("builtin:") {
            None => Ok(SceneSource::File(value.into())),
            Some("cornell-box") => Ok(SceneSource::CornellBox),
            Some("boxes") => Ok(SceneSource::Boxes),
            Some(name) => Err(format!(
                "there is no built-in scene {name:?}: there are builtin:cornell-box and builtin:boxes"
            )),
        }
    }
}

impl std::fmt::Display for SceneSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            SceneSource::File(path) => write!(f, "{}", path.display()),
            SceneSource::CornellBox => f.write_str("builtin:cornell-box"),
            SceneSource::Boxes => f.write_str("builtin:boxes"),
        }
    }
}

/// A scene and how long reading it took.
#[derive(Clone, Debug)]
pub struct LoadedScene {
    /// The scene.
    pub scene: Arc<Scene>,
    /// Seconds spent on reading, decoding and checking.
    pub load_seconds: f64,
}

impl SceneSource {
    /// Reads the scene.
    pub fn load(&self) -> Result<LoadedScene, CliError> {
        let start = Instant::now();
        let scene = match self {
            SceneSource::File(path) => load_scene(path, &AssetLimits::default())?,
            SceneSource::CornellBox => built_in(samples::cornell_box())?,
            SceneSource::Boxes => built_in(samples::boxes())?,
        };
        Ok(LoadedScene { scene: Arc::new(scene), load_seconds: start.elapsed().as_secs_f64() })
    }
}

fn built_in(scene: Result<Scene, SceneError>) -> Result<Scene, CliError> {
    scene.map_err(|error| CliError::Usage(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Built-in scenes are named; everything else is a path.
    #[test]
    fn sources_are_files_or_named_scenes() {
        assert_eq!("builtin:cornell-box".parse(), Ok(SceneSource::CornellBox));
        assert_eq!("builtin:boxes".parse(), Ok(SceneSource::Boxes));
        assert_eq!("a/b.glb".parse(), Ok(SceneSource::File("a/b.glb".into())));
        assert!("builtin:sponza".parse::<SceneSource>().unwrap_err().contains("builtin:cornell-box"));
    }
}
