//! An alarm that ends the running pass when a time limit or a snapshot is due.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{self, RecvTimeoutError, Sender},
    },
    thread,
    time::{Duration, Instant},
};

use super::super::CliError;

/// Sets a flag at given times. Its thread ends when it is dropped.
#[derive(Debug)]
pub(super) struct Alarm {
    times: Sender<Instant>,
}

impl Alarm {
    /// An alarm that sets `cancel`.
    pub(super) fn new(cancel: Arc<AtomicBool>) -> Result<Alarm, CliError> {
        let (times, incoming) = mpsc::channel::<Instant>();
        let wait = move || {
            let mut next: Option<Instant> = None;
            loop {
                // Without a time to wait for, an hour is as good as for ever: then it looks again.
                let pause =
                    next.map_or(Duration::from_secs(3600), |at| at.saturating_duration_since(Instant::now()));
                match incoming.recv_timeout(pause) {
                    Ok(at) => next = Some(at),
                    Err(RecvTimeoutError::Disconnected) => return,
                    Err(RecvTimeoutError::Timeout) => {
                        if next.take().is_some() {
                            cancel.store(true, Ordering::SeqCst);
                        }
                    }
                }
            }
        };
        thread::Builder::new()
            .name("alarm".into())
            .spawn(wait)
            .map_err(|source| CliError::System { doing: "starting the alarm thread".into(), source })?;
        Ok(Alarm { times })
    }

    /// Goes off at `at` instead of any earlier setting.
    pub(super) fn set(&self, at: Instant) {
        // The thread lives as long as this sender.
        let _ = self.times.send(at);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// It goes off at the last time that was set, and not before.
    #[test]
    fn it_goes_off_once_due() {
        let cancel = Arc::new(AtomicBool::new(false));
        let alarm = Alarm::new(cancel.clone()).unwrap();
        alarm.set(Instant::now() + Duration::from_secs(3600));
        assert!(!cancel.load(Ordering::SeqCst));
        alarm.set(Instant::now());
        while !cancel.load(Ordering::SeqCst) {
            thread::yield_now();
        }
    }
}
