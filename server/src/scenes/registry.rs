//! The list of scenes: making, restoring, finding, deleting, stopping.

use super::desk::Desk;
use super::history::{History, Keys};
use super::painter::Painter;
use super::{Board, Scene, Snapshot, Workshop, lock};
use crate::assets::{self, AssetError, AssetLimits, BuiltinScene};
use crate::convert;
use crate::store::{Base, SceneStore, StoreError, Stored};
use crate::telemetry::SceneFigures;
use lumicast_engine::effects::{EffectPlan, Inventory};
use lumicast_engine::scene::{self as engine_scene, SceneError};
use lumicast_engine::transport::World;
use lumicast_protocol::{Convergence, EventEntry, Problem, ProblemKind, SceneId, SceneList};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Condvar, Mutex, PoisonError, RwLock, mpsc};
use std::thread::JoinHandle;
use tokio::sync::{broadcast, watch};

/// Why a scene could not be made or restored.
#[derive(Debug, thiserror::Error)]
pub enum CreateError {
    /// The file is no scene.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// The graphics card that was asked for cannot be used.
    #[error("backend gpu: {0}")]
    Gpu(#[from] lumicast_engine::gpu::GpuError),
    /// The scene breaks a limit.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The store refused.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The id is taken.
    #[error("there is a scene \"{0}\" already")]
    Taken(SceneId),
    /// Too many scenes.
    #[error("there are {0} scenes, the most this server takes")]
    TooMany(usize),
    /// There is no built-in scene of that name.
    #[error("there is no built-in scene {0:?}: there are {names}", names = BuiltinScene::names())]
    UnknownBuiltin(String),
    /// A batch of the log no longer applies.
    #[error("scene {id:?}: revision {revision} of its log can no longer be applied: {reason}")]
    Replay {
        /// The scene.
        id: SceneId,
        /// The batch.
        revision: u64,
        /// Why.
        reason: String,
    },
    /// The system gives no threads.
    #[error("threads could not be started: {0}")]
    Threads(String),
}

impl CreateError {
    /// As HTTP tells it.
    pub fn problem(&self) -> Problem {
        let kind = match self {
            CreateError::Asset(_) | CreateError::Scene(_) => ProblemKind::ValueRefused,
            CreateError::UnknownBuiltin(_) => ProblemKind::NotFound,
            CreateError::Taken(_) => ProblemKind::Conflict,
            CreateError::TooMany(_) => ProblemKind::TooMany,
            CreateError::Store(_) | CreateError::Gpu(_) | CreateError::Threads(_) => ProblemKind::Unavailable,
            CreateError::Replay { .. } => ProblemKind::Internal,
        };
        Problem::new(kind, self.to_string())
    }
}

/// Where a new scene comes from.
#[derive(Debug)]
pub enum Origin {
    /// Built into the program.
    Builtin(String),
    /// A whole `.glb` in memory.
    Glb(Vec<u8>),
    /// A scene file.
    File(PathBuf),
}

#[derive(Debug)]
struct Entry {
    scene: Arc<Scene>,
    threads: Vec<JoinHandle<()>>,
}

/// All scenes of a server.
#[derive(Debug)]
pub struct Scenes {
    workshop: Arc<Workshop>,
    entries: RwLock<BTreeMap<SceneId, Entry>>,
    /// One scene is made or deleted at a time: loading is parallel inside, and two at once would need twice the memory.
    making: Mutex<()>,
}

impl Scenes {
    /// An empty list.
    pub fn new(workshop: Arc<Workshop>) -> Scenes {
        Scenes { workshop, entries: RwLock::default(), making: Mutex::new(()) }
    }

    /// What all scenes share.
    pub fn workshop(&self) -> &Arc<Workshop> {
        &self.workshop
    }

    /// The scene of that id.
    pub fn get(&self, id: &str) -> Option<Arc<Scene>> {
        self.read().get(id).map(|entry| entry.scene.clone())
    }

    /// All of them, by id.
    pub fn all(&self) -> Vec<Arc<Scene>> {
        self.read().values().map(|entry| entry.scene.clone()).collect()
    }

    /// For `GET /v1/scenes`.
    pub fn list(&self) -> SceneList {
        SceneList { scenes: self.all().iter().map(|scene| scene.summary()).collect() }
    }

    /// For `/metrics`.
    pub fn figures(&self) -> Vec<SceneFigures> {
        let figures = |scene: &Arc<Scene>| SceneFigures {
            id: scene.id().to_string(),
            revision: scene.revision(),
            viewers: scene.viewer_count(),
            error: scene.error(),
        };
        self.all().iter().map(figures).collect()
    }

    fn read(&self) -> std::sync::RwLockReadGuard<'_, BTreeMap<SceneId, Entry>> {
        self.entries.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes a scene at revision 1. Blocks for as long as loading takes.
    pub fn create(&self, id: SceneId, name: &str, origin: Origin) -> Result<Arc<Scene>, CreateError> {
        let _making = lock(&self.making);
        self.room_for(&id)?;
        let (scene, base) = self.load(origin, &self.workshop.config.asset_limits())?;
        let snapshot = self.prepare(scene, 1);
        let store = match &self.workshop.store {
            Some(store) => Some(store.create(&id, name, &base)?),
            None => None,
        };
        let (keys_max, history) = self.fresh_history();
        self.start(id, name, snapshot, store, Keys::new(keys_max), history)
    }

    /// Restores every scene of the store.
    pub fn restore(&self) -> Result<(), CreateError> {
        let _making = lock(&self.making);
        let Some(store) = &self.workshop.store else { return Ok(()) };
        for id in store.scenes()? {
            self.room_for(&id)?;
            let (scene_store, stored) = store.load(&id)?;
            self.replay(id, scene_store, stored)?;
        }
        Ok(())
    }

    fn replay(&self, id: SceneId, store: SceneStore, stored: Stored) -> Result<(), CreateError> {
        let Stored { name, base, base_revision, keys: kept, records, warning } = stored;
        if let Some(warning) = warning {
            tracing::warn!(scene = %id, "{warning}");
        }
        let origin = match base {
            Base::Builtin(name) => Origin::Builtin(name),
            Base::Glb(bytes) => Origin::Glb(bytes),
        };
        // What was accepted under larger limits stays accepted.
        let assets = AssetLimits::none();
        let (mut scene, _) = self.load(origin, &assets)?;
        let (keys_max, mut history) = self.fresh_history();
        let mut keys = Keys::new(keys_max);
        for kept in kept {
            keys.insert(kept.key, kept.digest, kept.revision);
        }
        let limits = convert::EditLimits { scene: assets.scene, assets, edits_per_batch: usize::MAX };
        let revision = base_revision + records.len() as u64;
        for record in records {
            let applied = convert::apply(&scene, &record.edits, &limits).map_err(|problem| {
                CreateError::Replay { id: id.clone(), revision: record.revision, reason: problem.detail }
            })?;
            scene = applied.scene;
            if let (Some(key), Some(digest)) = (record.idempotency_key, record.digest) {
                keys.insert(key, digest, record.revision);
            }
            let bytes = serde_json::to_vec(&record.edits).map_or(0, |json| json.len() as u64);
            let entry = EventEntry {
                revision: record.revision,
                seconds_since_epoch: record.seconds_since_epoch,
                edits: record.edits,
            };
            history.push(Arc::new(entry), bytes);
        }
        let snapshot = self.prepare(scene, revision);
        self.start(id, &name, snapshot, Some(store), keys, history)?;
        Ok(())
    }

    fn room_for(&self, id: &SceneId) -> Result<(), CreateError> {
        let entries = self.read();
        if entries.contains_key(id) {
            return Err(CreateError::Taken(id.clone()));
        }
        match entries.len() >= self.workshop.config.scenes as usize {
            true => Err(CreateError::TooMany(entries.len())),
            false => Ok(()),
        }
    }

    fn load(&self, origin: Origin, limits: &AssetLimits) -> Result<(engine_scene::Scene, Base), CreateError> {
        match origin {
            Origin::Builtin(name) => match BuiltinScene::named(&name) {
                Some(scene) => Ok((scene.load()?, Base::Builtin(name))),
                None => Err(CreateError::UnknownBuiltin(name)),
            },
            Origin::Glb(bytes) => Ok((assets::load_glb(&bytes, limits)?, Base::Glb(bytes))),
            Origin::File(path) => {
                let scene = assets::load_scene(&path, limits)?;
                // Without a store the base is never looked at.
                let base = match self.workshop.is_durable() {
                    true => Base::Glb(assets::export_glb(&scene)?),
                    false => Base::Glb(Vec::new()),
                };
                Ok((scene, base))
            }
        }
    }

    fn prepare(&self, scene: engine_scene::Scene, revision: u64) -> Snapshot {
        let world = self.workshop.building_pool.install(|| World::prepare(Arc::new(scene)));
        let plan = Arc::new(EffectPlan::of(world.scene()));
        Snapshot { revision, light_revision: revision, world: Arc::new(world), plan }
    }

    fn fresh_history(&self) -> (usize, History) {
        let config = &self.workshop.config;
        (config.idempotency_keys as usize, History::new(config.event_log as usize, config.event_log_bytes))
    }

    fn start(
        &self,
        id: SceneId,
        name: &str,
        snapshot: Snapshot,
        store: Option<SceneStore>,
        keys: Keys,
        history: History,
    ) -> Result<Arc<Scene>, CreateError> {
        let config = &self.workshop.config;
        let (desk, jobs) = mpsc::sync_channel(config.edit_queue as usize);
        let scene = Arc::new(Scene {
            id: id.clone(),
            name: name.into(),
            durable: store.is_some(),
            workshop: self.workshop.clone(),
            revision: watch::Sender::new(snapshot.revision),
            closed: watch::Sender::new(false),
            snapshot: RwLock::new(Arc::new(snapshot)),
            history: Mutex::new(history),
            // Few: an event may be megabytes, and who lags behind by that many is told to read the log.
            events: broadcast::Sender::new(64),
            desk,
            board: Mutex::new(Board::default()),
            wake: Condvar::new(),
            cancel: AtomicBool::new(false),
            interruptible: AtomicBool::new(false),
            last_curve: Mutex::new(Convergence::default()),
            described: Mutex::new(None),
        });
        let inventory = Inventory::of(scene.snapshot().world.scene());
        let desk = Desk { scene: scene.clone(), store, keys, inventory, fold_at_bytes: config.log_bytes };
        let painter = Painter::new(scene.clone());
        let threads = vec![
            spawn("edit", &scene, move || desk.run(&jobs))?,
            spawn("paint", &scene, move || painter.run())?,
        ];
        let entry = Entry { scene: scene.clone(), threads };
        self.entries.write().unwrap_or_else(PoisonError::into_inner).insert(id, entry);
        Ok(scene)
    }

    /// Deletes a scene, from the store too; false where there is none. Blocks until its threads have ended.
    pub fn remove(&self, id: &SceneId) -> Result<bool, StoreError> {
        let _making = lock(&self.making);
        let removed = self.entries.write().unwrap_or_else(PoisonError::into_inner).remove(id);
        let Some(entry) = removed else { return Ok(false) };
        end(entry);
        if let Some(store) = &self.workshop.store {
            store.remove(id)?;
        }
        Ok(true)
    }

    /// Ends every scene's threads after the edits they have queued. Blocks until then.
    pub fn stop(&self) {
        let _making = lock(&self.making);
        let entries = std::mem::take(&mut *self.entries.write().unwrap_or_else(PoisonError::into_inner));
        for entry in entries.values() {
            entry.scene.close();
        }
        for entry in entries.into_values() {
            end(entry);
        }
    }
}

fn spawn(
    what: &'static str,
    scene: &Arc<Scene>,
    work: impl FnOnce() + Send + 'static,
) -> Result<JoinHandle<()>, CreateError> {
    let scene = scene.clone();
    let name = format!("{what} {}", scene.id());
    let guarded = move || {
        // What the thread held goes with it, and what others share is plain data that a panic leaves whole.
        if std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).is_err() {
            tracing::error!(scene = %scene.id(), "the {what} thread has panicked; the scene is closed");
            scene.fail();
        }
    };
    let builder = std::thread::Builder::new().name(name);
    builder.spawn(guarded).map_err(|error| CreateError::Threads(error.to_string()))
}

fn end(entry: Entry) {
    entry.scene.close();
    for thread in entry.threads {
        // It catches its own panics.
        let _ = thread.join();
    }
}
