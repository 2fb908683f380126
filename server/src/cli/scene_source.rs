//! SCENE of the command line: a file, or a built-in scene by name.

use std::{path::PathBuf, str::FromStr, sync::Arc, time::Instant};

use lumicast_engine::scene::Scene;

use super::CliError;
use crate::assets::{AssetLimits, BuiltinScene, load_scene};

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SceneSource {
    /// A glTF or OBJ file.
    File(PathBuf),
    /// `builtin:NAME`.
    Builtin(BuiltinScene),
}

impl FromStr for SceneSource {
    type Err = String;

    fn from_str(value: &str) -> Result<SceneSource, String> {
        match value.strip_prefix("builtin:") {
            None => Ok(SceneSource::File(value.into())),
            Some(name) => BuiltinScene::named(name).map(SceneSource::Builtin).ok_or_else(|| {
                let known = BuiltinScene::ALL.map(|scene| format!("builtin:{}", scene.name()));
                format!("there is no {value:?}: there are {}", known.join(" and "))
            }),
        }
    }
}

impl std::fmt::Display for SceneSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            SceneSource::File(path) => write!(f, "{}", path.display()),
            SceneSource::Builtin(scene) => write!(f, "builtin:{}", scene.name()),
        }
    }
}

/// Warnings of a scene that are shown beside its picture; `lumicast info` shows all.
const WARNINGS_SHOWN: usize = 5;

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
            SceneSource::Builtin(scene) => {
                scene.load().map_err(|error| CliError::Usage(error.to_string()))?
            }
        };
        Ok(LoadedScene { scene: Arc::new(scene), load_seconds: start.elapsed().as_secs_f64() })
    }

    /// The first few warnings of a scene from here, a line each, and where the rest is to be found.
    pub fn warnings_of(&self, scene: &Scene) -> Vec<String> {
        let warnings = scene.warnings();
        let shown = warnings.iter().take(WARNINGS_SHOWN);
        let mut lines: Vec<String> =
            shown.map(|warning| format!("{}: {}", warning.object, warning.message)).collect();
        if let more @ 1.. = warnings.len().saturating_sub(WARNINGS_SHOWN) {
            lines.push(format!("and {more} more of the scene, which `lumicast info {self}` shows"));
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use lumicast_engine::scene::{SceneBuilder, SceneLimits};

    use super::*;

    /// A few warnings are shown, and of more how many they are and where.
    #[test]
    fn few_warnings_are_shown_and_the_rest_is_counted() {
        let source = SceneSource::File("hall.glb".into());
        for count in [0, 1, WARNINGS_SHOWN, WARNINGS_SHOWN + 1, 40] {
            let mut builder = SceneBuilder::new(SceneLimits::default());
            (0..count).for_each(|number| builder.warn(format!("mesh {number}"), "is odd"));
            let lines = source.warnings_of(&builder.finish().0);
            let expected: Vec<String> =
                (0..count.min(WARNINGS_SHOWN)).map(|number| format!("mesh {number}: is odd")).collect();
            assert_eq!(lines[..expected.len()], expected);
            let more = count - expected.len();
            let rest = format!("and {more} more of the scene, which `lumicast info hall.glb` shows");
            assert_eq!(lines[expected.len()..], vec![rest; usize::from(more > 0)]);
        }
    }

    /// Built-in scenes are named; everything else is a path.
    #[test]
    fn sources_are_files_or_named_scenes() {
        for scene in BuiltinScene::ALL {
            assert_eq!(format!("builtin:{}", scene.name()).parse(), Ok(SceneSource::Builtin(scene)));
        }
        assert_eq!("a/b.glb".parse(), Ok(SceneSource::File("a/b.glb".into())));
        assert!(
            "builtin:sponza"
                .parse::<SceneSource>()
                .unwrap_err()
                .contains("builtin:cornell-box and builtin:boxes")
        );
    }
}
