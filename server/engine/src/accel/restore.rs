//! Restores a worn top tree in the background while the old one answers.

use std::sync::{Arc, Mutex, OnceLock, PoisonError, Weak};

use super::{instance::Instance, top::TopTree};

/// A top tree, and the better one that takes its place once it is built. Both give the same answers, to the last bit.
#[derive(Debug)]
pub(super) struct Top {
    built: TopTree,
    better: OnceLock<TopTree>,
}

impl Top {
    pub(super) fn new(built: TopTree) -> Top {
        Top { built, better: OnceLock::new() }
    }

    /// True once the better tree is there.
    #[cfg(test)]
    pub(super) fn is_restored(&self) -> bool {
        self.better.get().is_some()
    }

    /// Bytes of both.
    pub(super) fn bytes(&self) -> usize {
        self.built.bytes() + self.better.get().map_or(0, TopTree::bytes)
    }

    /// The best there is now. To be asked once per walk: the next answer may be another tree.
    #[inline(always)]
    pub(super) fn tree(&self) -> &TopTree {
        self.better.get().unwrap_or(&self.built)
    }
}

/// Builds one tree at a time, for the newest edit that asked: shared by all states of a scene.
#[derive(Debug, Default)]
pub(super) struct Restorer {
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    is_running: bool,
    /// The newest wish; older ones that were not begun are forgotten.
    wanted: Option<(Weak<Top>, Vec<Arc<Instance>>)>,
}

impl Restorer {
    /// Has a better tree built for `top` by one thread of its own, so that edits do not wait for it. A tree that nobody holds
    /// any more is skipped; where no thread is to be had, the worn tree stays.
    pub(super) fn restore(self: &Arc<Self>, top: &Arc<Top>, instances: &[Arc<Instance>]) {
        let mut state = self.lock();
        state.wanted = Some((Arc::downgrade(top), instances.to_vec()));
        if !state.is_running {
            let restorer = self.clone();
            let thread = std::thread::Builder::new().name("restorer".into());
            state.is_running = thread.spawn(move || restorer.run_alone()).is_ok();
        }
    }

    /// Parallel parts of the build stay on this thread, away from the pools that draw and edit.
    fn run_alone(&self) {
        match rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build() {
            Ok(pool) => pool.install(|| self.run()),
            Err(_) => self.run(),
        }
    }

    fn run(&self) {
        while let Some((top, instances)) = self.next() {
            if let Some(top) = top.upgrade() {
                // Set by nobody else: each wish is run once.
                let _ = top.better.set(TopTree::build(&instances));
            }
        }
    }

    fn next(&self) -> Option<(Weak<Top>, Vec<Arc<Instance>>)> {
        let mut state = self.lock();
        let next = state.wanted.take();
        state.is_running = next.is_some();
        next
    }

    /// A panic while it was held leaves nothing half done: the state is two plain fields.
    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
