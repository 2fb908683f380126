//! Scenes that nobody should send and somebody will, drawn from seeds.
//!
//! A case is a small room (`rooms.rs`) to which one to four hostilities are done (`geometry.rs`, `light.rs`, `material.rs`,
//! `eye.rs`); `check.rs` draws it by every technique. Cases run side by side, each on a thread of its own. How many, and which, the
//! head of the suite says. A case that fails is named with all that is wrong with it; once mended it goes to `found.rs`.

mod case;
mod check;
mod eye;
mod geometry;
mod hostility;
mod light;
mod material;
mod rooms;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

pub(crate) use self::case::Case;
pub(crate) use self::check::{Checked, check, on_threads};
use crate::drawing::{TECHNIQUES, name, techniques};

/// Cases of a run by default, a minute and a half on two cores, and with `LUMICAST_NIGHTLY=1`.
const CASES: [u64; 2] = [60, 500];
/// A case that takes as long hangs: it draws some twenty pictures at most, each of which gives up by itself.
const PATIENCE: Duration = Duration::from_secs(600);
/// Failures after which a run ends: more say no more.
const FAILURES_MAX: usize = 20;

/// The seeds of a run.
fn asked() -> std::ops::Range<u64> {
    let first = std::env::var("LUMICAST_STABILITY_SEED")
        .ok()
        .map(|seed| seed.parse().expect("LUMICAST_STABILITY_SEED: a number"));
    let count = match std::env::var("LUMICAST_STABILITY_CASES").as_deref() {
        Ok("forever") => u64::MAX,
        Ok(count) => count.parse().expect("LUMICAST_STABILITY_CASES: a number or `forever`"),
        Err(_) if first.is_some() => 1,
        Err(_) => CASES[usize::from(std::env::var_os("LUMICAST_NIGHTLY").is_some())],
    };
    let first = first.unwrap_or(0u64);
    first..first.saturating_add(count)
}

/// What workers say.
enum News {
    Begun(u64),
    Ended(u64, Duration, Result<Box<[Checked; TECHNIQUES.len()]>, String>),
}

#[test]
fn hostile_scenes_leave_every_technique_sound() {
    let asked = asked();
    let (next, is_over) = (Arc::new(AtomicU64::new(asked.start)), Arc::new(AtomicBool::new(false)));
    let (tell, hear) = mpsc::channel();
    let threads = std::thread::available_parallelism().map_or(2, usize::from);
    for _ in 0..threads {
        let (tell, next, is_over, end) = (tell.clone(), next.clone(), is_over.clone(), asked.end);
        // Left alone, not joined: one that hangs must not keep the run from saying so.
        std::thread::spawn(move || {
            on_threads(1, || {
                while !is_over.load(Ordering::Relaxed) {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= end || tell.send(News::Begun(seed)).is_err() {
                        return;
                    }
                    let start = Instant::now();
                    let checked = check(&Case::of(seed)).map(Box::new);
                    if tell.send(News::Ended(seed, start.elapsed(), checked)).is_err() {
                        return;
                    }
                }
            });
        });
    }
    drop(tell);
    let tally = listen(&hear, &is_over);
    println!("{tally}");
    assert!(
        tally.failures.is_empty(),
        "{} cases failed\n{}",
        tally.failures.len(),
        tally.failures.join("\n")
    );
    assert!(tally.checked.iter().all(|checked| checked.drawn > 0), "nothing was drawn");
}

/// Hears of every case until there are no more, or until one hangs or too many fail.
fn listen(hear: &mpsc::Receiver<News>, is_over: &AtomicBool) -> Tally {
    let mut tally = Tally::default();
    let mut running: Vec<(u64, Instant)> = Vec::new();
    loop {
        match hear.recv_timeout(Duration::from_secs(1)) {
            Ok(News::Begun(seed)) => running.push((seed, Instant::now())),
            Ok(News::Ended(seed, taken, checked)) => {
                running.retain(|(running, _)| *running != seed);
                tally.take(seed, taken, checked.map(|checked| *checked));
            }
            Err(mpsc::RecvTimeoutError::Timeout) => {}
            Err(mpsc::RecvTimeoutError::Disconnected) => return tally,
        }
        if let Some((seed, _)) = running.iter().find(|(_, begun)| begun.elapsed() > PATIENCE) {
            tally.failures.push(format!("{}\n    hangs", Case::of(*seed).described()));
            return tally;
        }
        if tally.failures.len() >= FAILURES_MAX {
            is_over.store(true, Ordering::Relaxed);
        }
    }
}

/// What a run has found so far.
#[derive(Debug, Default)]
struct Tally {
    cases: u64,
    seconds: f64,
    slowest: (f64, u64),
    checked: [Checked; TECHNIQUES.len()],
    failures: Vec<String>,
}

impl Tally {
    fn take(&mut self, seed: u64, taken: Duration, checked: Result<[Checked; TECHNIQUES.len()], String>) {
        self.cases += 1;
        self.seconds += taken.as_secs_f64();
        if taken.as_secs_f64() > self.slowest.0 {
            self.slowest = (taken.as_secs_f64(), seed);
        }
        match checked {
            Ok(checked) => self.checked.iter_mut().zip(checked).for_each(|(sum, one)| *sum += one),
            Err(error) => {
                let failure = format!("{}\n    {error}", Case::of(seed).described());
                // At once: a run without end says nothing at its end.
                println!("FAILED {failure}");
                self.failures.push(failure);
            }
        }
        if self.cases.is_multiple_of(500) {
            println!("{self}");
        }
    }
}

impl std::fmt::Display for Tally {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (slowest, seed) = self.slowest;
        let (cases, failed) = (self.cases, self.failures.len());
        let mean = self.seconds / cases.max(1) as f64;
        writeln!(
            f,
            "{cases} hostile scenes, {failed} failed; {mean:.2} s each, {slowest:.1} s at most (seed {seed})"
        )?;
        writeln!(
            f,
            "{:<12} {:>6} {:>6} {:>8} {:>9} {:>8} {:>9} {:>6}",
            "technique", "drawn", "dark", "bounded", "measured", "threads", "compared", "again"
        )?;
        for (checked, technique) in self.checked.iter().zip(techniques()) {
            writeln!(
                f,
                "{:<12} {:>6} {:>6} {:>8} {:>9} {:>8} {:>9} {:>6}",
                name(technique),
                checked.drawn,
                checked.dark,
                checked.bounded,
                checked.measured,
                checked.threaded,
                checked.compared,
                checked.again
            )?;
        }
        Ok(())
    }
}
