//! Scenes to draw.

use std::{error::Error, sync::Arc};

use lumicast::cli::scene_source::SceneSource;
use lumicast_engine::{scene::CameraView, transport::World};

/// A scene, ready to be drawn on the CPU.
pub(crate) struct Subject {
    pub(crate) name: String,
    pub(crate) world: Arc<World>,
    pub(crate) view: CameraView,
}

/// Those that are named, or all there are; each is read when its turn comes.
pub(crate) fn wanted(named: &[String]) -> impl Iterator<Item = Result<Subject, Box<dyn Error>>> {
    let named = if named.is_empty() { all() } else { named.to_vec() };
    named.into_iter().map(|name| Subject::named(&name))
}

fn all() -> Vec<String> {
    let mut all = vec!["builtin:cornell-box".to_string()];
    let Some(folder) = lumicast_tests::shared_folder() else {
        eprintln!("SKIPPED the shared scenes: no ../shared beside the project");
        return all;
    };
    for file in ["sponza.glb", "sibenik.glb", "dragon-room.glb", "cornell-glass.glb"] {
        let path = folder.join("scenes").join(file);
        if path.is_file() {
            all.push(path.display().to_string());
        } else {
            eprintln!("SKIPPED {file}: not among the shared scenes");
        }
    }
    all
}

impl Subject {
    fn named(name: &str) -> Result<Subject, Box<dyn Error>> {
        let (source, camera) = match name.rsplit_once(':') {
            Some((file, camera)) if file != "builtin" => (file, Some(camera)),
            _ => (name, None),
        };
        let scene = source.parse::<SceneSource>()?.load()?.scene;
        let view = match (scene.camera_view(camera), camera) {
            (Some(view), _) => view,
            (None, Some(camera)) => return Err(format!("{source}: no camera {camera}").into()),
            (None, None) => scene.default_view(),
        };
        let name = name.rsplit('/').next().unwrap_or(name).to_string();
        Ok(Subject { name, world: Arc::new(World::prepare(scene)), view })
    }
}
