//! Signals during a rendering: the pass ends between two tiles, and the picture is what it is by then.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU8, Ordering},
    },
    time::{Duration, Instant},
};

use super::super::CliError;

/// Watches for SIGINT and SIGTERM from its making on.
///
/// Until then, while the scene is read, signals end the process as they always do: nothing has been written.
#[derive(Clone, Debug)]
pub(super) struct Interrupt {
    /// Ends the pass that runs; also set for other reasons.
    cancel: Arc<AtomicBool>,
    /// Number of the signal that came; 0 before.
    signal: Arc<AtomicU8>,
    /// Held while a file is written: the process does not end meanwhile.
    writing: Arc<Mutex<()>>,
}

/// Signals that come within this of the first are the same wish: `timeout`, and whoever passes Ctrl-C on that the terminal sends as well, send two.
const ONE_WISH: Duration = Duration::from_millis(500);

const SIGINT: u8 = 2;
const SIGTERM: u8 = 15;

impl Interrupt {
    /// Begins to watch. A signal sets `cancel`; a second one ends the process at once, or once the file is whole that is being written.
    pub(super) fn watch(cancel: Arc<AtomicBool>) -> Result<Interrupt, CliError> {
        let interrupt = Interrupt { cancel, signal: Arc::default(), writing: Arc::default() };
        let watching = interrupt.clone();
        let system = |source| CliError::System { doing: "watching for signals".into(), source };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build().map_err(system)?;
        let mut signals = {
            // Signals are registered with the runtime that is entered.
            let _entered = runtime.enter();
            Signals::new().map_err(system)?
        };
        std::thread::Builder::new()
            .name("signals".into())
            .spawn(move || {
                runtime.block_on(async {
                    watching.note(signals.next().await);
                    let first = Instant::now();
                    let mut second = signals.next().await;
                    while first.elapsed() < ONE_WISH {
                        second = signals.next().await;
                    }
                    watching.undisturbed(|| std::process::exit(128 + i32::from(second)))
                })
            })
            .map_err(system)?;
        Ok(interrupt)
    }

    fn note(&self, signal: u8) {
        self.signal.store(signal, Ordering::SeqCst);
        self.cancel.store(true, Ordering::SeqCst);
    }

    /// Does what writes a file, which no second signal leaves half done.
    pub(super) fn undisturbed<T>(&self, write: impl FnOnce() -> T) -> T {
        // It guards nothing that could be broken.
        let _held = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        write()
    }

    /// The signal that came: name and number.
    pub(super) fn came(&self) -> Option<(&'static str, u8)> {
        match self.signal.load(Ordering::SeqCst) {
            SIGINT => Some(("SIGINT", SIGINT)),
            SIGTERM => Some(("SIGTERM", SIGTERM)),
            _ => None,
        }
    }
}

#[cfg(unix)]
struct Signals {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    fn new() -> std::io::Result<Signals> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Signals {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
        })
    }

    async fn next(&mut self) -> u8 {
        tokio::select! {
            _ = self.interrupt.recv() => SIGINT,
            _ = self.terminate.recv() => SIGTERM,
        }
    }
}

#[cfg(not(unix))]
struct Signals;

#[cfg(not(unix))]
impl Signals {
    fn new() -> std::io::Result<Signals> {
        Ok(Signals)
    }

    async fn next(&mut self) -> u8 {
        let _ = tokio::signal::ctrl_c().await;
        SIGINT
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A signal ends the pass and is remembered by name.
    #[test]
    fn a_signal_cancels_and_is_named() {
        let interrupt = Interrupt { cancel: Arc::default(), signal: Arc::default(), writing: Arc::default() };
        assert_eq!(interrupt.came(), None);
        interrupt.note(SIGTERM);
        assert_eq!(interrupt.came(), Some(("SIGTERM", 15)));
        assert!(interrupt.cancel.load(Ordering::SeqCst));
    }
}
