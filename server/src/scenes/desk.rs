//! The edit thread of a scene: one batch after the other becomes a revision, or a problem and nothing else.
//!
//! Order within a batch: known key → `If-Match` → applied to a copy → trees → on disk → published → answered. What can
//! fail comes before the disk, and the disk before anybody sees it.

use super::history::{Keys, digest};
use super::{DeskMessage, EditJob, News, Scene, Snapshot, lock};
use crate::assets;
use crate::convert;
use crate::store::{Base, Encoded, Record, SceneStore};
use lumicast_engine::effects::Inventory;
use lumicast_engine::scene::SceneChange;
use lumicast_protocol::{Edit, EditReply, EventEntry, Problem, ProblemKind, SceneDescription};
use serde_json::Value;
use std::sync::atomic::Ordering::SeqCst;
use std::sync::{Arc, PoisonError, mpsc};
use std::time::{SystemTime, UNIX_EPOCH};

/// What only the edit thread holds.
#[derive(Debug)]
pub(super) struct Desk {
    pub(super) scene: Arc<Scene>,
    pub(super) store: Option<SceneStore>,
    pub(super) keys: Keys,
    /// Of the present scene.
    pub(super) inventory: Inventory,
    /// Log length at which folding is tried next; grows when it was not possible.
    pub(super) fold_at_bytes: u64,
}

impl Desk {
    /// Works until told to stop.
    pub(super) fn run(mut self, jobs: &mpsc::Receiver<DeskMessage>) {
        while let Ok(DeskMessage::Edit(job)) = jobs.recv() {
            let metrics = &self.scene.workshop.metrics;
            metrics.edit_queue.add(-1);
            let EditJob { edits, if_match, idempotency_key, queued, reply } = job;
            let answer = self.take(edits, if_match, idempotency_key);
            let metrics = &self.scene.workshop.metrics;
            metrics.edit_latency.record(queued.elapsed());
            match &answer {
                Ok(_) => metrics.edits_accepted.one(),
                Err(_) => metrics.edits_refused.one(),
            }
            // Who asked may have gone; the batch counts all the same.
            let _ = reply.send(answer);
            self.fold_if_long();
        }
    }

    fn take(
        &mut self,
        edits: Vec<Edit>,
        if_match: Option<u64>,
        idempotency_key: Option<String>,
    ) -> Result<EditReply, Problem> {
        let before = self.scene.snapshot();
        let digest = idempotency_key.as_ref().map(|_| digest(&edits));
        if let Some((known, revision)) = idempotency_key.as_ref().and_then(|key| self.keys.get(key)) {
            return match digest == Some(known) {
                true => Ok(EditReply { revision }),
                false => Err(Problem::new(
                    ProblemKind::Conflict,
                    format!("this idempotency key belongs to another batch, which made revision {revision}"),
                )
                .at_field("idempotency_key")),
            };
        }
        if let Some(asked) = if_match.filter(|asked| *asked != before.revision) {
            let detail = format!(
                "the scene is at revision {}, the edit asked for {asked}: read the scene again",
                before.revision
            );
            return Err(Problem::new(ProblemKind::RevisionMoved, detail).at_revision(before.revision));
        }
        let revision = before.revision + 1;
        let limits = self.scene.workshop.edit_limits();
        let refusal = |problem: Problem| problem.at_revision(before.revision);
        if self.store.is_some() {
            // JSON has no infinity: a number too large for f32 would be kept as null and come back as "leave it". So what
            // is to be kept is judged as it was sent.
            convert::apply(before.world.scene(), &edits, &limits).map_err(refusal)?;
        }
        let batch = self.batch(revision, edits, idempotency_key.clone(), digest)?;
        let applied =
            convert::apply(before.world.scene(), &batch.record().edits, &limits).map_err(refusal)?;
        let light_revision =
            if applied.change.leaves_light_alone() { before.light_revision } else { revision };
        // Passes that draw the old scene give way: nobody will see them.
        if self.scene.interruptible.load(SeqCst) {
            self.scene.cancel.store(true, SeqCst);
        }
        let scene = Arc::new(applied.scene);
        let world = self.scene.workshop.building_pool.install(|| before.world.update(scene, &applied.change));
        self.record(&batch, idempotency_key.zip(digest))?;
        let change = applied.change;
        self.inventory.follow(before.world.scene(), world.scene(), &change);
        let plan = Arc::new(self.inventory.plan());
        let snapshot = Snapshot { revision, light_revision, world: Arc::new(world), plan };
        self.publish(snapshot, change, batch);
        Ok(EditReply { revision })
    }

    /// The batch as it will be kept.
    fn batch(
        &self,
        revision: u64,
        edits: Vec<Edit>,
        idempotency_key: Option<String>,
        digest: Option<u64>,
    ) -> Result<Batch, Problem> {
        let seconds_since_epoch =
            SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
        let record = Record { revision, seconds_since_epoch, idempotency_key, digest, edits };
        match self.store {
            None => Ok(Batch::InMemory(record)),
            Some(_) => match Encoded::new(&record) {
                Ok(encoded) => Ok(Batch::ForDisk(encoded)),
                Err(error) => {
                    Err(Problem::new(ProblemKind::TooLarge, format!("the batch cannot be kept: {error}")))
                }
            },
        }
    }

    /// Puts the batch on disk, where scenes are kept.
    fn record(&mut self, batch: &Batch, key: Option<(String, u64)>) -> Result<(), Problem> {
        let revision = batch.record().revision;
        if let (Some(store), Batch::ForDisk(encoded)) = (&mut self.store, batch) {
            store.append(encoded).map_err(|error| {
                tracing::error!(scene = %self.scene.id, %error, "an edit could not be kept");
                Problem::new(ProblemKind::Unavailable, format!("the edit could not be put on disk: {error}"))
            })?;
        }
        if let Some((key, digest)) = key {
            self.keys.insert(key, digest, revision);
        }
        Ok(())
    }

    /// Lets everybody see what was recorded.
    fn publish(&self, snapshot: Snapshot, change: SceneChange, batch: Batch) {
        let revision = snapshot.revision;
        let bytes = batch.len_bytes();
        let Record { seconds_since_epoch, edits, .. } = batch.into_record();
        let entry = Arc::new(EventEntry { revision, seconds_since_epoch, edits });
        // Before the scene itself: whoever sees that scene must find what led to it.
        lock(&self.scene.board).light_changes.push(revision, change);
        {
            let mut history = lock(&self.scene.history);
            *self.scene.snapshot.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(snapshot);
            history.push(entry.clone(), bytes);
        }
        self.scene.revision.send_replace(revision);
        // Without listeners the event goes nowhere, as it should.
        let _ = self.scene.events.send(entry);
        self.scene.tell_painter(News::Urgent);
    }

    /// Folds a long log into a new base, if the scene comes back from its file as it went in.
    fn fold_if_long(&mut self) {
        let Some(store) = &mut self.store else { return };
        if store.log_bytes() < self.fold_at_bytes {
            return;
        }
        let snapshot = self.scene.snapshot();
        let described = self.scene.description();
        let limits = self.scene.workshop.config.asset_limits();
        let folded = assets::export_glb(snapshot.world.scene()).ok().and_then(|glb| {
            let back = assets::load_glb(&glb, &limits).ok()?;
            let again = convert::describe(&back, &self.scene.id, &self.scene.name, snapshot.revision, true);
            is_alike(&again, &described).then_some(glb)
        });
        let result = match folded {
            Some(glb) => store
                .fold(&Base::Glb(glb), snapshot.revision, self.keys.to_kept())
                .map_err(|error| error.to_string()),
            None => Err("the scene holds something that a GLB file does not".to_string()),
        };
        match result {
            Ok(()) => self.fold_at_bytes = self.scene.workshop.config.log_bytes,
            Err(reason) => {
                // The log stays as it is, whole and valid; it is tried again when it has doubled.
                tracing::warn!(scene = %self.scene.id, reason, "the log was not folded");
                self.fold_at_bytes = store.log_bytes().saturating_mul(2);
            }
        }
    }
}

/// A batch on its way to a revision.
enum Batch {
    InMemory(Record),
    ForDisk(Encoded),
}

impl Batch {
    fn record(&self) -> &Record {
        match self {
            Batch::InMemory(record) => record,
            Batch::ForDisk(encoded) => &encoded.record,
        }
    }

    fn into_record(self) -> Record {
        match self {
            Batch::InMemory(record) => record,
            Batch::ForDisk(encoded) => encoded.record,
        }
    }

    /// Its length as JSON, about, for the bound of what is kept in memory.
    fn len_bytes(&self) -> u64 {
        match self {
            Batch::InMemory(record) => serde_json::to_vec(&record.edits).map_or(0, |json| json.len() as u64),
            Batch::ForDisk(encoded) => encoded.len_bytes(),
        }
    }
}

/// Whether two descriptions tell the same scene: all the same things, numbers to a part in 100,000. Vertices go through
/// single precision about another centre, so bounds may differ in their last digits; what this must find is a thing
/// that a GLB file cannot hold.
fn is_alike(a: &SceneDescription, b: &SceneDescription) -> bool {
    fn alike(a: &Value, b: &Value) -> bool {
        match (a, b) {
            (Value::Number(a), Value::Number(b)) => {
                let (a, b) = (a.as_f64().unwrap_or(f64::NAN), b.as_f64().unwrap_or(f64::NAN));
                (a - b).abs() <= 1e-5 * a.abs().max(b.abs()).max(1.0)
            }
            (Value::Array(a), Value::Array(b)) => {
                a.len() == b.len() && a.iter().zip(b).all(|(a, b)| alike(a, b))
            }
            (Value::Object(a), Value::Object(b)) => {
                a.len() == b.len() && a.iter().all(|(key, a)| b.get(key).is_some_and(|b| alike(a, b)))
            }
            (a, b) => a == b,
        }
    }
    match (serde_json::to_value(a), serde_json::to_value(b)) {
        (Ok(a), Ok(b)) => alike(&a, &b),
        _ => false,
    }
}
