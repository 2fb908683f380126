//! Cuts a pass of the render thread short at a time.

use super::{Scene, lock};
use std::sync::atomic::Ordering::SeqCst;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A thread that sleeps until then.
#[derive(Debug)]
pub(super) struct Alarm {
    shared: Arc<(Mutex<Setting>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Setting {
    at: Option<Instant>,
    stopped: bool,
}

impl Alarm {
    pub(super) fn start(scene: Arc<Scene>) -> Alarm {
        let shared = Arc::new((Mutex::new(Setting::default()), Condvar::new()));
        let watched = shared.clone();
        let work = move || {
            let (setting, changed) = &*watched;
            let mut setting = lock(setting);
            while !setting.stopped {
                let wait = setting.at.map(|at| at.saturating_duration_since(Instant::now()));
                setting = match wait {
                    Some(Duration::ZERO) => {
                        // Under the lock: once `set` has returned, an older alarm rings no more.
                        setting.at = None;
                        scene.cancel.store(true, SeqCst);
                        setting
                    }
                    Some(wait) => {
                        changed.wait_timeout(setting, wait).unwrap_or_else(PoisonError::into_inner).0
                    }
                    None => changed.wait(setting).unwrap_or_else(PoisonError::into_inner),
                };
            }
        };
        let thread = std::thread::Builder::new().name("alarm".into()).spawn(work);
        // Without it passes run to their end: slower to react, not wrong.
        let thread =
            thread.inspect_err(|error| tracing::error!(%error, "no thread for cutting passes short"));
        Alarm { shared, thread: thread.ok() }
    }

    pub(super) fn set(&self, at: Option<Instant>) {
        let (setting, changed) = &*self.shared;
        let mut setting = lock(setting);
        let unchanged = setting.at == at;
        setting.at = at;
        drop(setting);
        if !unchanged {
            changed.notify_one();
        }
    }
}

impl Drop for Alarm {
    fn drop(&mut self) {
        let (setting, changed) = &*self.shared;
        lock(setting).stopped = true;
        changed.notify_one();
        if let Some(thread) = self.thread.take() {
            // It cannot panic.
            let _ = thread.join();
        }
    }
}
