//! What the statistics panel shows: frames a second, latencies, bytes, and how the error fell. Bounded rings; times in
//! seconds of the caller's clock.

use lumicast_protocol::{Stats, Technique};
use std::collections::VecDeque;

/// Frames and bytes are counted over this long: shorter flickers, longer lags behind.
const RATE_WINDOW_S: f64 = 2.0;
/// More than any server sends in the window.
const RATE_ENTRIES_MAX: usize = 1024;
/// Latencies that percentiles are taken of: at 30 moves a second the last 8 seconds of moving.
const LATENCIES_MAX: usize = 256;
/// A new point must lie this factor to the right of the last: 1 % is a fifth of a pixel on a plot of 300 pixels and
/// eight decades, and keeps a series of a year under 3,000 points.
const POINT_SPACING: f64 = 1.01;
/// Hard end of a series, for servers whose seconds jump.
const POINTS_MAX: usize = 4096;
/// A series worth keeping for comparison has at least this many points.
const WORTH_KEEPING: usize = 8;

/// Frames and bytes that came lately.
#[derive(Debug, Clone, Default)]
pub struct Rate {
    entries: VecDeque<(f64, usize)>,
}

impl Rate {
    pub(super) fn add(&mut self, now_s: f64, bytes: usize) {
        self.entries.push_back((now_s, bytes));
        if self.entries.len() > RATE_ENTRIES_MAX {
            self.entries.pop_front();
        }
    }

    fn lately(&self, now_s: f64) -> impl Iterator<Item = usize> {
        self.entries.iter().filter(move |(at, _)| now_s - at < RATE_WINDOW_S).map(|(_, bytes)| *bytes)
    }

    /// A second, over the last two.
    pub fn frames_per_second(&self, now_s: f64) -> f64 {
        self.lately(now_s).count() as f64 / RATE_WINDOW_S
    }

    /// A second, over the last two.
    pub fn bytes_per_second(&self, now_s: f64) -> f64 {
        self.lately(now_s).sum::<usize>() as f64 / RATE_WINDOW_S
    }
}

/// The latest latencies, in seconds.
#[derive(Debug, Clone, Default)]
pub struct Latencies {
    seconds: VecDeque<f64>,
}

impl Latencies {
    pub(super) fn add(&mut self, seconds: f64) {
        self.seconds.push_back(seconds.max(0.0));
        if self.seconds.len() > LATENCIES_MAX {
            self.seconds.pop_front();
        }
    }

    /// The newest.
    pub fn last_s(&self) -> Option<f64> {
        self.seconds.back().copied()
    }

    /// The smallest value that at least `fraction` of them do not exceed (nearest rank).
    pub fn percentile_s(&self, fraction: f64) -> Option<f64> {
        let mut sorted: Vec<f64> = self.seconds.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let rank = (fraction * sorted.len() as f64).ceil() as usize;
        sorted.get(rank.saturating_sub(1)).copied()
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.seconds.len()
    }
}

/// A measured error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Since the film restarted.
    pub seconds: f64,
    /// √relMSE as a fraction.
    pub error: f32,
    /// 95 % interval.
    pub error_ci: Option<[f32; 2]>,
}

/// How the error of one film fell.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Series {
    /// By time.
    pub points: Vec<Point>,
    /// What it was rendered with.
    pub technique: Technique,
}

/// Error over time of the picture now, and of the last one that lasted.
#[derive(Debug, Clone, Default)]
pub struct ErrorHistory {
    /// The film that is converging.
    pub now: Series,
    /// The one before, if it was worth keeping.
    pub before: Option<Series>,
    film: Option<(u64, u64, Technique)>,
    seconds: f64,
}

impl ErrorHistory {
    pub(super) fn add(&mut self, stats: &Stats) {
        let film = (stats.revision, stats.camera_stamp, stats.technique);
        let restarted = self.film.is_some_and(|before| before != film) || stats.seconds < self.seconds;
        if restarted {
            let ended = std::mem::take(&mut self.now);
            if ended.points.len() >= WORTH_KEEPING {
                self.before = Some(ended);
            }
        }
        (self.film, self.seconds, self.now.technique) = (Some(film), stats.seconds, stats.technique);
        let Some(error) = stats.error.filter(|error| error.is_finite() && *error > 0.0) else { return };
        let usable = stats.seconds.is_finite() && stats.seconds > 0.0;
        let point = Point {
            seconds: stats.seconds,
            error,
            error_ci: stats.error_ci.filter(|ci| ci.iter().all(|bound| bound.is_finite())),
        };
        let points = &mut self.now.points;
        let count = points.len();
        match points.last_mut() {
            _ if !usable => {}
            // The newest is always there; it takes the place of one that is too near.
            Some(last) if point.seconds < last.seconds * POINT_SPACING => {
                *last = Point { seconds: last.seconds, ..point };
            }
            _ if count < POINTS_MAX => points.push(point),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumicast_protocol::ForecastRecord;

    pub(crate) fn stats(seconds: f64, error: Option<f32>, camera_stamp: u64) -> Stats {
        Stats {
            revision: 1,
            camera_stamp,
            samples: 4,
            error,
            error_ci: error.map(|e| [e * 0.9, e * 1.1]),
            seconds,
            rays_per_second: 1e6,
            samples_per_second: 1e5,
            frames_sent: 1,
            frames_skipped: 0,
            in_flight: 1,
            technique: Technique::Path,
            film_size: [64, 36],
            scale: 1.0,
            forecast: Vec::new(),
            forecast_record: ForecastRecord::default(),
        }
    }

    #[test]
    fn percentiles_are_of_the_nearest_rank() {
        let mut latencies = Latencies::default();
        assert_eq!(latencies.percentile_s(0.5), None);
        (1..=100).for_each(|ms| latencies.add(f64::from(ms)));
        assert_eq!(latencies.percentile_s(0.5), Some(50.0));
        assert_eq!(latencies.percentile_s(0.95), Some(95.0));
        assert_eq!(latencies.percentile_s(1.0), Some(100.0));
        assert_eq!(latencies.last_s(), Some(100.0));
    }

    #[test]
    fn rates_count_the_last_two_seconds_only() {
        let mut rate = Rate::default();
        (0..100).for_each(|i| rate.add(f64::from(i) * 0.1, 1000));
        assert_eq!(rate.frames_per_second(9.95), 10.0);
        assert_eq!(rate.bytes_per_second(9.95), 10_000.0);
        assert_eq!(rate.frames_per_second(100.0), 0.0);
    }

    #[test]
    fn every_history_has_an_end() {
        let (mut rate, mut latencies, mut errors) =
            (Rate::default(), Latencies::default(), ErrorHistory::default());
        for i in 0..100_000u32 {
            rate.add(0.0, 1);
            latencies.add(1.0);
            // Far apart, as a server that lies would say them.
            errors.add(&stats(f64::from(i) * 1e9 + 1.0, Some(0.1), 1));
        }
        assert!(rate.entries.len() <= RATE_ENTRIES_MAX);
        assert!(latencies.seconds.len() <= LATENCIES_MAX);
        assert!(errors.now.points.len() <= POINTS_MAX);
    }

    #[test]
    fn a_restarted_film_starts_a_new_series_and_a_long_one_is_kept() {
        let mut errors = ErrorHistory::default();
        for i in 1..=20 {
            errors.add(&stats(f64::from(i) * 0.1, Some(1.0 / i as f32), 1));
        }
        assert_eq!(errors.now.points.len(), 20);
        errors.add(&stats(0.1, Some(0.9), 2));
        assert_eq!(errors.now.points.len(), 1);
        assert_eq!(errors.before.as_ref().unwrap().points.len(), 20);
        // A camera that moves makes many films of one point: the long one stays.
        (3..50).for_each(|stamp| errors.add(&stats(0.1, Some(0.9), stamp)));
        assert_eq!(errors.before.as_ref().unwrap().points.len(), 20);
        errors.add(&stats(f64::NAN, Some(f32::NAN), 50));
        assert!(errors.now.points.is_empty());
    }
}
