//! The shared scenes: each is owned by an edit thread, which orders its edits and makes its revisions, and drawn by a
//! render thread, which goes round its viewers. Neither is ever a tokio thread.
//!
//! `desk.rs` is the edit thread, `painter.rs` the render thread with the film of every viewer (`viewer_film.rs`) and what
//! is known of the light (`lighting.rs`), `viewer.rs` what a session shares with it, `frames.rs` packs pictures,
//! `ladder.rs` chooses their size, `request.rs` are single pictures for HTTP. [`Scene`] is the handle
//! that HTTP and WebSocket hold; [`Scenes`] is the list of all. An edit publishes a new [`Snapshot`]; who draws holds
//! the snapshot he began with, so that nobody waits for anybody.

mod alarm;
mod card;
mod desk;
mod foretold;
mod frames;
mod history;
mod ladder;
mod lighting;
mod memory;
mod painter;
mod registry;
mod request;
mod viewer;
mod viewer_film;

use crate::config::Config;
use crate::convert;
use crate::store::Store;
use crate::telemetry::Metrics;
use history::History;
use lumicast_engine::effects::EffectPlan;
use lumicast_engine::scene::{Id, SceneError};
use lumicast_engine::transport::World;
use lumicast_protocol::{
    Accuracy, CameraRequest, Convergence, Edit, EditReply, EventEntry, EventLog, Problem, ProblemKind,
    Quality, SceneDescription, SceneId, SceneSummary, View,
};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::SeqCst};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, RwLock, mpsc};
use std::time::Instant;
use tokio::sync::{broadcast, oneshot, watch};

pub use card::Card;
pub use registry::{CreateError, Origin, Scenes};
pub use request::{DoneBy, PictureFormat, PictureRequest, RequestedPicture, Until};
pub use viewer::{Outgoing, Viewer};

/// What every scene of a server shares.
#[derive(Debug)]
pub struct Workshop {
    /// Settings.
    pub config: Config,
    /// Numbers for the operator.
    pub metrics: Metrics,
    /// Draws pictures, for all scenes, where there is one.
    pub card: Card,
    /// Draws pictures, for all scenes.
    drawing_pool: rayon::ThreadPool,
    /// Builds trees after edits. Apart from the drawing pool, so that an edit need not wait for a pass to end.
    building_pool: rayon::ThreadPool,
    /// Where scenes are kept, if anywhere.
    store: Option<Store>,
    /// Numbers the connections.
    viewer_ids: AtomicU64,
}

impl Workshop {
    /// Starts the pools and opens the store that the settings name.
    pub fn open(config: Config) -> Result<Workshop, CreateError> {
        let pool = |name: &'static str| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(config.thread_count())
                .thread_name(move |index| format!("{name}-{index}"))
                .build()
                .map_err(|error| CreateError::Threads(error.to_string()))
        };
        let store = match config.data.as_str() {
            "" => None,
            data => Some(Store::open(&PathBuf::from(data))?),
        };
        Ok(Workshop {
            card: Card::open(&config)?,
            drawing_pool: pool("draw")?,
            building_pool: pool("build")?,
            store,
            metrics: Metrics::default(),
            viewer_ids: AtomicU64::new(1),
            config,
        })
    }

    /// Whether scenes outlive the server.
    pub fn is_durable(&self) -> bool {
        self.store.is_some()
    }

    fn edit_limits(&self) -> convert::EditLimits {
        convert::EditLimits {
            scene: self.config.scene_limits(),
            assets: self.config.asset_limits(),
            edits_per_batch: self.config.edits_per_batch as usize,
        }
    }
}

/// A scene at one revision, ready to be drawn.
#[derive(Debug)]
pub struct Snapshot {
    /// 1, 2, 3 …
    pub revision: u64,
    /// The last revision that changed what light does; later ones changed only cameras.
    pub light_revision: u64,
    /// Scene and trees.
    pub world: Arc<World>,
    /// What the scene calls for.
    pub plan: Arc<EffectPlan>,
}

/// A batch on its way to the edit thread.
#[derive(Debug)]
struct EditJob {
    edits: Vec<Edit>,
    if_match: Option<u64>,
    idempotency_key: Option<String>,
    queued: Instant,
    reply: oneshot::Sender<Result<EditReply, Problem>>,
}

/// What wakes the edit thread.
#[derive(Debug)]
enum DeskMessage {
    Edit(EditJob),
    Stop,
}

/// What the render thread looks at when it is woken.
#[derive(Debug, Default)]
struct Board {
    viewers: Vec<Arc<Viewer>>,
    requests: VecDeque<request::Job>,
    requests_open: usize,
    /// What edits changed of the light since the render thread last looked.
    light_changes: lighting::LightChanges,
    /// Something changed since the render thread last looked.
    news: bool,
    /// Some of it is of a camera, a wish or an edit: what is being refined gives way.
    urgent: bool,
    closing: bool,
}

/// One scene, as everybody else holds it.
#[derive(Debug)]
pub struct Scene {
    id: SceneId,
    name: String,
    durable: bool,
    workshop: Arc<Workshop>,
    snapshot: RwLock<Arc<Snapshot>>,
    /// The newest revision, for sessions to wait on; closed when the scene goes.
    revision: watch::Sender<u64>,
    closed: watch::Sender<bool>,
    history: Mutex<History>,
    events: broadcast::Sender<Arc<EventEntry>>,
    desk: mpsc::SyncSender<DeskMessage>,
    board: Mutex<Board>,
    wake: Condvar,
    /// Cuts the present pass short, if it may be.
    cancel: AtomicBool,
    /// Whether the present pass may be cut short by news.
    interruptible: AtomicBool,
    /// The error over time of the viewer that left last.
    last_curve: Mutex<Convergence>,
    /// The description of one revision: every viewer asks for the same one after an edit.
    described: Mutex<Option<Arc<SceneDescription>>>,
}

/// A panic elsewhere leaves these plain data whole, so a poisoned lock is taken as it is.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A camera that the scene does not have; tells those that it has.
fn no_camera<'a>(name: &str, known: impl Iterator<Item = &'a Id>) -> Problem {
    let unknown = SceneError::unknown("camera", "camera", name, known);
    Problem::new(ProblemKind::NotFound, unknown.to_string()).at_field("camera")
}

impl Scene {
    /// Its id.
    pub fn id(&self) -> &SceneId {
        &self.id
    }

    /// The newest state.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        self.snapshot.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The newest revision.
    pub fn revision(&self) -> u64 {
        self.snapshot().revision
    }

    /// Changes with every revision.
    pub fn watch_revision(&self) -> watch::Receiver<u64> {
        self.revision.subscribe()
    }

    /// Becomes true when the scene is deleted or the server stops.
    pub fn watch_closed(&self) -> watch::Receiver<bool> {
        self.closed.subscribe()
    }

    /// One line for the list.
    pub fn summary(&self) -> SceneSummary {
        let snapshot = self.snapshot();
        SceneSummary {
            id: self.id.clone(),
            name: self.name.clone(),
            revision: snapshot.revision,
            durable: self.durable,
            triangles: snapshot.world.scene().instanced_triangle_count(),
            viewers: self.viewer_count(),
        }
    }

    /// The whole scene but geometry and texels.
    pub fn description(&self) -> Arc<SceneDescription> {
        let snapshot = self.snapshot();
        let mut described = lock(&self.described);
        if let Some(description) = described.as_ref().filter(|d| d.revision == snapshot.revision) {
            return description.clone();
        }
        let scene = snapshot.world.scene();
        let fresh = Arc::new(convert::describe(scene, &self.id, &self.name, snapshot.revision, self.durable));
        *described = Some(fresh.clone());
        fresh
    }

    /// Queues a batch. The answer comes once it is on disk and pictures of it can be drawn.
    ///
    /// Batches are applied in the order of these calls. Returns a problem at once when the queue is full.
    pub fn submit(
        &self,
        edits: Vec<Edit>,
        if_match: Option<u64>,
        idempotency_key: Option<String>,
    ) -> Result<oneshot::Receiver<Result<EditReply, Problem>>, Problem> {
        let (reply, answer) = oneshot::channel();
        let job = EditJob { edits, if_match, idempotency_key, queued: Instant::now(), reply };
        match self.desk.try_send(DeskMessage::Edit(job)) {
            Ok(()) => {
                self.workshop.metrics.edit_queue.add(1);
                Ok(answer)
            }
            Err(mpsc::TrySendError::Full(_)) => Err(Problem::new(
                ProblemKind::Unavailable,
                format!(
                    "{} batches wait for scene {:?} already; try again",
                    self.workshop.config.edit_queue, &*self.id
                ),
            )),
            Err(mpsc::TrySendError::Disconnected(_)) => Err(self.gone()),
        }
    }

    /// [`Scene::submit`] and its answer.
    pub async fn edit(
        &self,
        edits: Vec<Edit>,
        if_match: Option<u64>,
        idempotency_key: Option<String>,
    ) -> Result<EditReply, Problem> {
        let answer = self.submit(edits, if_match, idempotency_key)?;
        answer.await.unwrap_or_else(|_| Err(self.gone()))
    }

    /// The problem of a scene that is being closed.
    pub fn gone(&self) -> Problem {
        Problem::new(ProblemKind::Unavailable, format!("scene {:?} is closing", &*self.id))
    }

    /// The batches after `since`.
    pub fn edits_since(&self, since: u64) -> Result<EventLog, Problem> {
        let history = lock(&self.history);
        // Revision and history change together under the history's lock, so the two agree.
        let revision = self.revision();
        let Some(entries) = history.since(since, revision) else {
            let first = revision - history.len() as u64;
            return Err(Problem::new(
                ProblemKind::NotFound,
                format!("the edits after revision {since} are no longer kept, only those after {first}: read the scene anew"),
            )
            .at_revision(revision));
        };
        Ok(EventLog { revision, entries: entries.iter().map(|entry| EventEntry::clone(entry)).collect() })
    }

    /// The batches to come; who lags too far behind is told so and dropped.
    pub fn events(&self) -> Result<broadcast::Receiver<Arc<EventEntry>>, Problem> {
        let limit = self.workshop.config.event_listeners as usize;
        if self.events.receiver_count() >= limit {
            let detail = format!("{limit} listeners follow the events of scene {:?} already", &*self.id);
            return Err(Problem::new(ProblemKind::TooMany, detail));
        }
        Ok(self.events.subscribe())
    }

    /// How the picture of a viewer (`None`: of the one that watches longest, or the last that left) converged.
    pub fn convergence(&self, viewer: Option<u64>) -> Result<Convergence, Problem> {
        let board = lock(&self.board);
        match viewer {
            Some(id) => match board.viewers.iter().find(|viewer| viewer.id() == id) {
                Some(viewer) => Ok(Convergence { points: viewer.curve() }),
                None => Err(Problem::new(ProblemKind::NotFound, format!("viewer {id} is not connected"))),
            },
            None => match board.viewers.first() {
                Some(viewer) => Ok(Convergence { points: viewer.curve() }),
                None => Ok(lock(&self.last_curve).clone()),
            },
        }
    }

    /// Which parts of the renderer it needs.
    pub fn effects(&self) -> lumicast_protocol::Effects {
        let snapshot = self.snapshot();
        convert::effects(&snapshot.plan, snapshot.revision)
    }

    /// Viewers connected.
    pub fn viewer_count(&self) -> u32 {
        u32::try_from(lock(&self.board).viewers.len()).unwrap_or(u32::MAX)
    }

    /// Largest measured error of its viewers' pictures, √relMSE as a fraction; `None` while none is measured.
    pub fn error(&self) -> Option<f64> {
        let viewers = lock(&self.board).viewers.clone();
        let errors = viewers.iter().filter_map(|viewer| viewer.stats()?.error);
        errors.reduce(f32::max).map(f64::from)
    }

    /// A new viewer; it gets pictures once it has a camera. [`Scene::leave`] lets it go.
    pub fn join(&self) -> Result<Arc<Viewer>, Problem> {
        let config = &self.workshop.config;
        let mut board = lock(&self.board);
        if board.closing {
            return Err(self.gone());
        }
        if board.viewers.len() >= config.viewers_per_scene as usize {
            let detail =
                format!("scene {:?} has {} viewers, the most it takes", &*self.id, board.viewers.len());
            return Err(Problem::new(ProblemKind::TooMany, detail));
        }
        let id = self.workshop.viewer_ids.fetch_add(1, SeqCst);
        let viewer = Arc::new(Viewer::new(id, config.frames_in_flight as usize));
        board.viewers.push(viewer.clone());
        self.workshop.metrics.viewers.add(1);
        Ok(viewer)
    }

    /// Forgets a viewer and its film.
    pub fn leave(&self, viewer: &Viewer) {
        let mut board = lock(&self.board);
        let before = board.viewers.len();
        board.viewers.retain(|other| other.id() != viewer.id());
        let left = before - board.viewers.len();
        board.news = true;
        drop(board);
        self.workshop.metrics.viewers.add(-(left as i64));
        lock(&self.last_curve).points = viewer.curve();
        self.wake.notify_one();
    }

    /// The picture a viewer wants from now on.
    pub fn set_camera(&self, viewer: &Viewer, camera: CameraRequest) -> Result<(), Problem> {
        match &camera.view {
            View::Pose(pose) => {
                convert::view_of_pose(pose)?;
            }
            View::Camera(name) => {
                let snapshot = self.snapshot();
                let cameras = snapshot.world.scene().cameras();
                if !cameras.contains_key(name.as_str()) {
                    return Err(no_camera(name, cameras.keys()));
                }
            }
        }
        viewer.set_camera(camera);
        self.tell_painter(News::Urgent);
        Ok(())
    }

    /// How pictures are to be sent from now on.
    pub fn set_quality(&self, viewer: &Viewer, quality: Quality) {
        viewer.set_quality(quality);
        self.tell_painter(News::Urgent);
    }

    /// How exact pictures are to become.
    pub fn set_accuracy(&self, viewer: &Viewer, accuracy: Accuracy) -> Result<(), Problem> {
        let (indirect, technique) = convert::indirect(accuracy.technique)?;
        viewer.set_accuracy(accuracy, indirect, technique);
        self.tell_painter(News::Urgent);
        Ok(())
    }

    /// A viewer has used this frame.
    pub fn acknowledge(&self, viewer: &Viewer, frame: u64) -> Result<(), Problem> {
        viewer.acknowledge(frame).map_err(|sent| {
            let detail = format!("frame {frame} was acknowledged, but {sent} were sent");
            Problem::new(ProblemKind::ValueRefused, detail).at_field("frame")
        })?;
        self.tell_painter(News::Patient);
        Ok(())
    }

    fn tell_painter(&self, news: News) {
        let is_urgent = matches!(news, News::Urgent);
        {
            let mut board = lock(&self.board);
            board.news = true;
            board.urgent |= is_urgent;
        }
        if is_urgent && self.interruptible.load(SeqCst) {
            self.cancel.store(true, SeqCst);
        }
        self.wake.notify_one();
    }

    /// Ends both threads; who holds a handle sees `closed` and refusals from here on.
    fn close(&self) {
        self.stop_drawing();
        // The edit thread finishes what is queued before it. A full queue empties, a dead thread needs no message.
        let _ = self.desk.send(DeskMessage::Stop);
        self.closed.send_replace(true);
    }

    fn stop_drawing(&self) {
        let mut board = lock(&self.board);
        board.closing = true;
        // Who waits for these pictures learns by their end that they will not come.
        board.requests.clear();
        drop(board);
        self.cancel.store(true, SeqCst);
        self.wake.notify_one();
    }

    /// A thread of this scene has panicked: nobody shall wait for it. The other scenes go on.
    fn fail(&self) {
        self.stop_drawing();
        self.closed.send_replace(true);
    }
}

/// Whether news cut the present pass short.
#[derive(Debug, Clone, Copy)]
enum News {
    Urgent,
    Patient,
}
