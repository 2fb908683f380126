//! `lumicast serve`: settings, scenes, the listener, and the end.

use super::output::print_line;
use super::scene_source::SceneSource;
use crate::config::Config;
use crate::http::{self, Service, id_of_name};
use crate::scenes::{CreateError, Origin, Scenes, Workshop};
use crate::{shutdown, telemetry};
use clap::Args;
use std::error::Error;
use std::io::ErrorKind;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;

/// Arguments of `lumicast serve`.
#[derive(Debug, Args)]
pub(super) struct ServeArgs {
    /// Scenes: .glb, .gltf or .obj files, builtin:cornell-box or builtin:boxes. None: the built-in Cornell box.
    scenes: Vec<SceneSource>,
    /// Address and port; port 0 takes a free one. [default: 127.0.0.1:7171]
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<String>,
    /// Folder that keeps scenes and edits. Without it they are gone when the server stops.
    #[arg(long, value_name = "DIR")]
    data: Option<String>,
    /// What draws pictures: cpu, gpu, or auto: a graphics card where there is one. [default: auto]
    #[arg(long)]
    backend: Option<String>,
    /// Settings as TOML; deploy/lumicast.toml lists all.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Rendering threads; 0: one per core. [default: 0]
    #[arg(long, value_name = "N")]
    threads: Option<String>,
    /// Any setting, e.g. --set viewers_per_scene=8.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Prints the settings in force, with their descriptions, and ends.
    #[arg(long)]
    print_config: bool,
}

impl ServeArgs {
    /// Serves until asked to stop.
    pub(super) fn run(self) -> Result<(), Box<dyn Error>> {
        let config = self.config()?;
        if self.print_config {
            return Ok(print_line(config.to_toml().trim_end())?);
        }
        telemetry::init_logging(&config.log, &config.log_format)?;
        let runtime = tokio::runtime::Builder::new_multi_thread()
            // Two: they only pass messages on; rendering has threads of its own.
            .worker_threads(2)
            .thread_name("tokio")
            .enable_all()
            .build()?;
        runtime.block_on(self.serve(config))
    }

    fn config(&self) -> Result<Config, Box<dyn Error>> {
        let named = [
            ("listen", &self.listen),
            ("data", &self.data),
            ("backend", &self.backend),
            ("threads", &self.threads),
        ];
        let mut flags: Vec<(String, String, String)> = named
            .into_iter()
            .filter_map(|(key, value)| Some((key.into(), value.clone()?, format!("flag --{key}"))))
            .collect();
        for pair in &self.set {
            let (key, value) =
                pair.split_once('=').ok_or_else(|| format!("flag --set {pair:?}: write key=value"))?;
            flags.push((key.trim().into(), value.into(), format!("flag --set {key}")));
        }
        Ok(Config::load(self.config.as_deref(), std::env::vars_os(), &flags)?)
    }

    async fn serve(self, config: Config) -> Result<(), Box<dyn Error>> {
        // A mistyped command looks like a file: say so before anything else. (A data folder may hold a scene whose file is
        // gone by now.)
        let must_exist = self.scenes.iter().filter(|_| config.data.is_empty());
        let is_missing = |scene: &&SceneSource| matches!(scene, SceneSource::File(file) if !file.exists());
        if let Some(missing) = must_exist.into_iter().find(is_missing) {
            return Err(format!("{missing}: there is no such file, and no such command (see --help)").into());
        }
        if let Some((first, second, id)) = same_id(&self.scenes) {
            return Err(format!(
                "{first} and {second} would both be the scene {id:?}: rename one of the files, or post it as a .glb with an id \
                 of its own, POST /v1/scenes?id=…"
            )
            .into());
        }
        // First the port: who starts a second server by mistake learns it before a minute of loading.
        let listener = TcpListener::bind(&config.listen).await.map_err(|error| {
            format!("cannot listen on {}: {error}{}", config.listen, advice_on(error.kind()))
        })?;
        let address = listener.local_addr()?;
        let stop_after = Duration::from_secs(config.shutdown_seconds.into());
        let workshop = Arc::new(Workshop::open(config)?);
        let scenes = Arc::new(Scenes::new(workshop.clone()));
        let (stopper, stopping) = shutdown::stop_signal();
        let service = Service::new(scenes.clone(), stopping);
        let ready = service.ready.clone();
        let server = tokio::spawn(http::serve(listener, service));
        let loading = tokio::task::spawn_blocking({
            let (scenes, files) = (scenes.clone(), self.scenes);
            move || load_all(&scenes, &files)
        });
        tokio::select! {
            loaded = loading => {
                loaded??;
                ready.store(true, SeqCst);
                // A server that nobody reads serves all the same.
                if let Err(error) = print_line(&greeting(address, &scenes)) {
                    tracing::warn!(%error, "nobody was told where to look");
                }
                shutdown::asked_to_stop().await?;
            }
            asked = shutdown::asked_to_stop() => asked?,
        }
        eprintln!("stopping");
        stopper.stop();
        // Edits first, so that who waits for an answer gets it before its connection ends.
        let ended = tokio::task::spawn_blocking({
            let scenes = scenes.clone();
            move || scenes.stop()
        });
        ended.await?;
        server.await?;
        let deadline = Instant::now() + stop_after;
        while workshop.metrics.viewers.value() > 0 && Instant::now() < deadline {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        Ok(())
    }
}

/// Restores the store, then loads the files it does not hold yet.
fn load_all(scenes: &Scenes, sources: &[SceneSource]) -> Result<(), CreateError> {
    let started = Instant::now();
    scenes.restore()?;
    for source in sources {
        let (name, id) = name_of(source);
        if let Some(scene) = scenes.get(&id) {
            tracing::info!(
                scene = %id, revision = scene.revision(),
                "restored from the data folder with its edits; its file, if it has one, was not read again"
            );
            continue;
        }
        let origin = match source {
            SceneSource::File(file) => Origin::File(file.clone()),
            SceneSource::Builtin(scene) => Origin::Builtin(scene.name().into()),
        };
        scenes.create(id, &name, origin)?;
    }
    if sources.is_empty() && scenes.all().is_empty() {
        let id = id_of_name("cornell-box");
        scenes.create(id, "Cornell box", Origin::Builtin("cornell-box".into()))?;
    }
    tracing::info!(seconds = started.elapsed().as_secs_f64(), "scenes loaded");
    Ok(())
}

/// The first two that would be one scene, and its id.
fn same_id(sources: &[SceneSource]) -> Option<(&SceneSource, &SceneSource, String)> {
    let ids: Vec<_> = sources.iter().map(|source| name_of(source).1).collect();
    let twin = |place: usize| ids[..place].iter().position(|id| *id == ids[place]);
    let (second, first) = (0..ids.len()).find_map(|place| Some((place, twin(place)?)))?;
    Some((&sources[first], &sources[second], ids[first].to_string()))
}

/// Name and id of a scene: a file's stem, or the built-in scene's own.
fn name_of(source: &SceneSource) -> (String, lumicast_protocol::SceneId) {
    let stem = match source {
        SceneSource::File(file) => file.file_stem().unwrap_or_default().to_string_lossy(),
        SceneSource::Builtin(scene) => scene.name().into(),
    };
    // Names go to logs and to viewers: no control characters, not endless.
    let name: String = stem.chars().filter(|c| !c.is_control()).take(64).collect();
    let id = id_of_name(&name);
    (name, id)
}

/// Where to look, a line each.
fn greeting(address: SocketAddr, scenes: &Scenes) -> String {
    let list = scenes.list().scenes;
    let mut lines = vec![format!("Lumicast {} at http://{address}/", env!("CARGO_PKG_VERSION"))];
    lines.extend(list.iter().map(|scene| {
        format!("  {:<20} revision {:<5} {} triangles", scene.id.as_str(), scene.revision, scene.triangles)
    }));
    lines.push(format!("  In a browser       http://{address}/"));
    lines.push(format!("  The viewer         lumicast-viewer http://{address}"));
    if let Some(scene) = list.first() {
        lines.push(format!(
            "  A picture          curl -o picture.png 'http://{address}/v1/scenes/{}/frame?time=2'",
            scene.id
        ));
        lines.push(format!(
            "  An edit            curl -H 'content-type: application/json' -d '[{{\"op\":\"set_environment\",\"kind\":\"constant\",\"radiance\":[0.2,0.3,0.5]}}]' http://{address}/v1/scenes/{}/edits",
            scene.id
        ));
    }
    if !scenes.workshop().is_durable() {
        lines.push("  Edits live in memory and end with this process; --data DIR keeps them.".into());
    }
    if !address.ip().is_loopback() {
        lines.push(
            "  Listening beyond this machine, without password: anybody who reaches it can edit.".into(),
        );
    }
    lines.join("\n")
}

/// What to do where it cannot be listened.
fn advice_on(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::AddrInUse => {
            ": end the program that listens there, or choose another port with --listen, such as 0 for any that is free"
        }
        ErrorKind::InvalidInput => ": expected HOST:PORT, such as 127.0.0.1:7171",
        ErrorKind::AddrNotAvailable => {
            ": this machine has no such address; 127.0.0.1 is for its own programs, 0.0.0.0 for all"
        }
        ErrorKind::PermissionDenied => ": ports below 1024 are often for the system alone",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Who may not listen somewhere is told what to do, and by the system's own kinds of errors.
    #[tokio::test]
    async fn who_cannot_listen_is_advised() {
        let taken = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = taken.local_addr().unwrap().to_string();
        for (address, advice) in [(address.as_str(), "another port"), ("7171", "HOST:PORT")] {
            let error = TcpListener::bind(address).await.unwrap_err();
            assert!(advice_on(error.kind()).contains(advice), "{address}: {error:?}");
        }
    }

    /// Files of one stem in two folders, a file named like a built-in scene, and names that become one id are told apart from others.
    #[test]
    fn two_scenes_of_one_id_are_found() {
        let found = |words: &[&str]| {
            let sources: Vec<SceneSource> = words.iter().map(|word| word.parse().unwrap()).collect();
            same_id(&sources).map(|(first, second, id)| (first.to_string(), second.to_string(), id))
        };
        let all = |first: &str, second: &str, id: &str| Some((first.into(), second.into(), id.into()));
        assert_eq!(found(&["a/room.glb", "b/hall.glb", "builtin:boxes"]), None);
        assert_eq!(found(&["a/room.glb", "x.glb", "b/room.obj"]), all("a/room.glb", "b/room.obj", "room"));
        assert_eq!(found(&["builtin:boxes", "boxes.glb"]), all("builtin:boxes", "boxes.glb", "boxes"));
        assert_eq!(found(&["my room.glb", "my-room.glb"]), all("my room.glb", "my-room.glb", "my-room"));
    }

    /// Built-in scenes keep their names, and load.
    #[test]
    fn built_in_scenes_are_scenes_by_their_names() {
        for scene in crate::assets::BuiltinScene::ALL {
            let (name, id) = name_of(&SceneSource::Builtin(scene));
            assert_eq!((name.as_str(), id.as_str()), (scene.name(), scene.name()));
            assert!(scene.load().unwrap().instanced_triangle_count() > 0);
        }
    }
}
