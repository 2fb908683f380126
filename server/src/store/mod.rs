//! The durable scene store of `--data DIR`: what was acknowledged survives a kill or a power cut.
//!
//! One folder per scene: `scene.json` (what it starts from and which log belongs to it), the base as a file (unless it
//! is built in), and an append-only log of edit batches (`log.rs`). A batch is on disk (fsync) before it is answered.
//! When the log has grown large it is folded: the scene as it is becomes the new base beside a new empty log, and
//! one rename of `scene.json` switches over; a crash before or after it leaves a whole store.
//! Blocking I/O throughout: called from scene threads, never from tokio's. Knows the protocol's edits, not the engine.

mod log;

use lumicast_protocol::{Edit, SceneId};
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

pub use log::{Encoded, Log};

/// What failed, on which file.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The system refused.
    #[error("{action} {path}: {source}")]
    Io {
        /// What was being done.
        action: &'static str,
        /// To what.
        path: String,
        /// What the system said.
        source: io::Error,
    },
    /// Another server has the folder.
    #[error("{path} is in use by another server: stop it or choose another --data folder")]
    InUse {
        /// The folder.
        path: String,
    },
    /// A file holds what no server of this version writes.
    #[error("{path} is damaged: {reason}. Restore it from a copy, or move it away to start anew")]
    Damaged {
        /// The file.
        path: String,
        /// Where and why.
        reason: String,
    },
    /// A scene of that name is kept already.
    #[error("{path} holds a scene already: it is restored at the start, and DELETE removes it")]
    Exists {
        /// The folder.
        path: String,
    },
    /// An earlier write failed half-way and could not be undone.
    #[error("{path} could not be repaired after a failed write; the scene takes no edits until a restart")]
    Poisoned {
        /// The file.
        path: String,
    },
}

/// Adds to an I/O error what was being done to what.
fn failed(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> StoreError {
    let path = path.display().to_string();
    move |source| StoreError::Io { action, path, source }
}

/// What a scene starts from.
#[derive(Debug, Clone, PartialEq)]
pub enum Base {
    /// A scene built into the program, by name.
    Builtin(String),
    /// A whole `.glb`.
    Glb(Vec<u8>),
}

/// A batch in the log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The revision it made.
    pub revision: u64,
    /// When it was accepted.
    pub seconds_since_epoch: f64,
    /// Key under which a repetition is recognised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub idempotency_key: Option<String>,
    /// Digest of the batch as it was received, beside its key.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub digest: Option<u64>,
    /// As they were sent.
    pub edits: Vec<Edit>,
}

/// An idempotency key from before the last fold: enough to answer a repetition.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptKey {
    /// The key.
    pub key: String,
    /// Digest of its batch.
    pub digest: u64,
    /// The revision it made.
    pub revision: u64,
}

/// A scene as read at start.
#[derive(Debug)]
pub struct Stored {
    /// For people.
    pub name: String,
    /// What it starts from.
    pub base: Base,
    /// Revision of the base.
    pub base_revision: u64,
    /// Keys from before the base.
    pub keys: Vec<KeptKey>,
    /// What came after it, in order.
    pub records: Vec<Record>,
    /// Said once at start: a torn tail that was cut.
    pub warning: Option<String>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Meta {
    format: u32,
    id: SceneId,
    name: String,
    base: MetaBase,
    base_revision: u64,
    log: String,
    #[serde(default)]
    keys: Vec<KeptKey>,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum MetaBase {
    Builtin(String),
    File(String),
}

const FORMAT: u32 = 1;
const META: &str = "scene.json";

/// The folder of all scenes, locked for this process.
#[derive(Debug)]
pub struct Store {
    root: PathBuf,
    /// Held for its lock.
    _lock: File,
}

impl Store {
    /// Opens or makes the folder; refuses one that another server uses.
    pub fn open(dir: &Path) -> Result<Store, StoreError> {
        let root = dir.join("scenes");
        fs::create_dir_all(&root).map_err(failed("make the folder", &root))?;
        let lock_path = dir.join("lock");
        let lock = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&lock_path)
            .map_err(failed("open", &lock_path))?;
        match lock.try_lock() {
            Ok(()) => Ok(Store { root, _lock: lock }),
            Err(fs::TryLockError::WouldBlock) => Err(StoreError::InUse { path: dir.display().to_string() }),
            Err(fs::TryLockError::Error(source)) => Err(failed("lock", &lock_path)(source)),
        }
    }

    /// Ids of the scenes in it, sorted.
    pub fn scenes(&self) -> Result<Vec<SceneId>, StoreError> {
        let mut ids = Vec::new();
        for entry in fs::read_dir(&self.root).map_err(failed("read", &self.root))? {
            let entry = entry.map_err(failed("read", &self.root))?;
            // A folder without scene.json is a scene whose making was cut short: nothing was acknowledged.
            if entry.path().join(META).is_file()
                && let Some(id) = entry.file_name().to_str().and_then(|name| SceneId::new(name).ok())
            {
                ids.push(id);
            }
        }
        ids.sort();
        Ok(ids)
    }

    /// Writes a new scene at revision 1.
    pub fn create(&self, id: &SceneId, name: &str, base: &Base) -> Result<SceneStore, StoreError> {
        let dir = self.root.join(id.as_str());
        if dir.join(META).exists() {
            return Err(StoreError::Exists { path: dir.display().to_string() });
        }
        // What a creation that was cut off left behind.
        if dir.exists() {
            fs::remove_dir_all(&dir).map_err(failed("clear", &dir))?;
        }
        fs::create_dir_all(&dir).map_err(failed("make the folder", &dir))?;
        let (log, meta) = write_generation(&dir, id, name, base, 1, Vec::new())?;
        sync_dir(&self.root)?;
        Ok(SceneStore { dir, id: id.clone(), name: name.into(), files: files_of(&meta), log })
    }

    /// Reads a scene back.
    pub fn load(&self, id: &SceneId) -> Result<(SceneStore, Stored), StoreError> {
        let dir = self.root.join(id.as_str());
        let path = dir.join(META);
        let text = fs::read(&path).map_err(failed("read", &path))?;
        let damaged = |reason: String| StoreError::Damaged { path: path.display().to_string(), reason };
        let meta: Meta = serde_json::from_slice(&text).map_err(|error| damaged(error.to_string()))?;
        if meta.format != FORMAT {
            return Err(damaged(format!("format {}; this version reads {FORMAT}", meta.format)));
        }
        let base = match &meta.base {
            MetaBase::Builtin(name) => Base::Builtin(name.clone()),
            MetaBase::File(name) => {
                let path = dir.join(name);
                Base::Glb(fs::read(&path).map_err(failed("read", &path))?)
            }
        };
        let (log, records, warning) = Log::open(&dir.join(&meta.log))?;
        let next = meta.base_revision + 1;
        if let Some((expected, record)) = (next..).zip(&records).find(|(n, record)| record.revision != *n) {
            let reason = format!("it holds revision {} where {expected} belongs", record.revision);
            return Err(StoreError::Damaged { path: dir.join(&meta.log).display().to_string(), reason });
        }
        let files = files_of(&meta);
        let Meta { name, base_revision, keys, .. } = meta;
        let store = SceneStore { dir, id: id.clone(), name: name.clone(), files, log };
        Ok((store, Stored { name, base, base_revision, keys, records, warning }))
    }

    /// Forgets a scene. Its `scene.json` goes first, so that a crash between leaves no half scene.
    pub fn remove(&self, id: &SceneId) -> Result<(), StoreError> {
        let dir = self.root.join(id.as_str());
        let meta = dir.join(META);
        fs::remove_file(&meta).map_err(failed("remove", &meta))?;
        sync_dir(&dir)?;
        fs::remove_dir_all(&dir).map_err(failed("remove", &dir))
    }
}

/// One scene's folder, open for appending.
#[derive(Debug)]
pub struct SceneStore {
    dir: PathBuf,
    id: SceneId,
    name: String,
    /// Files of the present generation, beside `scene.json`.
    files: Vec<String>,
    log: Log,
}

impl SceneStore {
    /// Puts a batch on disk; returns once it is there. After an error nothing of it remains.
    pub fn append(&mut self, batch: &Encoded) -> Result<(), StoreError> {
        self.log.append(batch)
    }

    /// Bytes of the log.
    pub fn log_bytes(&self) -> u64 {
        self.log.bytes()
    }

    /// Makes `base` the new start at `revision`, with an empty log.
    pub fn fold(&mut self, base: &Base, revision: u64, keys: Vec<KeptKey>) -> Result<(), StoreError> {
        let (log, meta) = write_generation(&self.dir, &self.id, &self.name, base, revision, keys)?;
        self.log = log;
        for file in std::mem::replace(&mut self.files, files_of(&meta)) {
            if !self.files.contains(&file) {
                // What stays behind costs space only; the next fold of a later revision leaves it alone too.
                let _ = fs::remove_file(self.dir.join(file));
            }
        }
        Ok(())
    }
}

fn files_of(meta: &Meta) -> Vec<String> {
    match &meta.base {
        MetaBase::Builtin(_) => vec![meta.log.clone()],
        MetaBase::File(file) => vec![meta.log.clone(), file.clone()],
    }
}

/// Base and log under names of this revision, then `scene.json` by rename.
fn write_generation(
    dir: &Path,
    id: &SceneId,
    name: &str,
    base: &Base,
    base_revision: u64,
    keys: Vec<KeptKey>,
) -> Result<(Log, Meta), StoreError> {
    let base = match base {
        Base::Builtin(name) => MetaBase::Builtin(name.clone()),
        Base::Glb(bytes) => {
            let file = format!("base-{base_revision}.glb");
            write_synced(&dir.join(&file), bytes)?;
            MetaBase::File(file)
        }
    };
    let log_name = format!("edits-{base_revision}.log");
    let mut log = Log::create(&dir.join(&log_name))?;
    let meta =
        Meta { format: FORMAT, id: id.clone(), name: name.into(), base, base_revision, log: log_name, keys };
    let json = serde_json::to_vec_pretty(&meta).map_err(io::Error::other);
    let temporary = dir.join("scene.json.new");
    write_synced(&temporary, &json.map_err(failed("write", &temporary))?)?;
    sync_dir(dir)?;
    fs::rename(&temporary, dir.join(META)).map_err(failed("put in place", &dir.join(META)))?;
    if let Err(error) = sync_dir(dir) {
        // The new generation is in place, but perhaps not for good: no edit may be acknowledged on either.
        tracing::error!(%error, "the scene takes no edits until a restart");
        log.poison();
    }
    Ok((log, meta))
}

fn write_synced(path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
    let mut file = File::create(path).map_err(failed("make", path))?;
    file.write_all(bytes).map_err(failed("write", path))?;
    file.sync_all().map_err(failed("sync", path))
}

/// Puts the names in a folder on disk; elsewhere than on Unix a folder cannot be opened for that.
fn sync_dir(dir: &Path) -> Result<(), StoreError> {
    if cfg!(unix) {
        File::open(dir).and_then(|dir| dir.sync_all()).map_err(failed("sync", dir))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
