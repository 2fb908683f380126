//! Stopping: one signal that every task can wait for, set off by SIGINT, SIGTERM or a test.

use tokio::sync::watch;

/// Sets off the stop; see [`Stopping`].
#[derive(Debug)]
pub struct Stopper(watch::Sender<bool>);

/// Waits for the stop. Cloned into every task.
#[derive(Debug, Clone)]
pub struct Stopping(watch::Receiver<bool>);

/// A stop that has not been set off.
pub fn stop_signal() -> (Stopper, Stopping) {
    let (sender, receiver) = watch::channel(false);
    (Stopper(sender), Stopping(receiver))
}

impl Stopper {
    /// Sets it off; again does nothing.
    pub fn stop(&self) {
        self.0.send_replace(true);
    }

    /// One more that waits.
    pub fn stopping(&self) -> Stopping {
        Stopping(self.0.subscribe())
    }
}

impl Stopping {
    /// Returns once it has been set off (or nobody is left who could).
    pub async fn wait(&mut self) {
        // An error means that the stopper is gone, which is as good as stopped.
        let _ = self.0.wait_for(|stopped| *stopped).await;
    }

    /// Whether it has been set off.
    pub fn is_set(&self) -> bool {
        *self.0.borrow()
    }
}

/// Returns at the first SIGINT (Ctrl-C) or SIGTERM.
pub async fn asked_to_stop() -> std::io::Result<()> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let mut terminate = signal(SignalKind::terminate())?;
        tokio::select! {
            interrupt = tokio::signal::ctrl_c() => interrupt,
            _ = terminate.recv() => Ok(()),
        }
    }
    #[cfg(not(unix))]
    tokio::signal::ctrl_c().await
}
