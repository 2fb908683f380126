//! What the server tells its operator: log lines (tracing) and numbers (Prometheus text at `/metrics`).
//!
//! The numbers live in one [`Metrics`] per server, plain atomics that any thread may count on; nothing global, so that
//! several servers run in one test process. Written out by hand: a dozen lines of text format need no library.

use std::fmt::Write;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};
use tracing_subscriber::EnvFilter;

/// Starts logging to standard error; a second call changes nothing.
///
/// - `filter`: EnvFilter syntax, such as `info` or `lumicast=debug`
/// - `format`: `text` or `json`
pub fn init_logging(filter: &str, format: &str) -> Result<(), String> {
    let filter = EnvFilter::try_new(filter).map_err(|error| format!("setting \"log\": {error}"))?;
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    // An error here means that logging was set up already, by a test or a program around us.
    let _ = match format {
        "json" => builder.json().try_init(),
        _ => builder.with_target(false).try_init(),
    };
    Ok(())
}

/// A number that only grows.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// One more.
    pub fn one(&self) {
        self.add(1);
    }

    /// That many more.
    pub fn add(&self, count: u64) {
        self.0.fetch_add(count, Relaxed);
    }

    /// How many so far.
    pub fn value(&self) -> u64 {
        self.0.load(Relaxed)
    }
}

/// A number that goes up and down.
#[derive(Debug, Default)]
pub struct Gauge(AtomicI64);

impl Gauge {
    /// Up or down by that much.
    pub fn add(&self, change: i64) {
        self.0.fetch_add(change, Relaxed);
    }

    /// Up by that much, unless it were above `limit` then; true if it is.
    pub fn add_within(&self, change: i64, limit: i64) -> bool {
        let sum = |value: i64| Some(value.saturating_add(change)).filter(|sum| *sum <= limit);
        self.0.fetch_update(Relaxed, Relaxed, sum).is_ok()
    }

    /// Where it is.
    pub fn value(&self) -> i64 {
        self.0.load(Relaxed)
    }
}

/// Bounds of the latency buckets in seconds: from a frame on the local network to a picture nobody waits for.
const BOUNDS: [f64; 12] = [0.005, 0.01, 0.02, 0.04, 0.07, 0.1, 0.2, 0.3, 0.5, 1.0, 3.0, 10.0];

/// How durations are spread.
#[derive(Debug, Default)]
pub struct Latency {
    buckets: [AtomicU64; BOUNDS.len()],
    count: AtomicU64,
    sum_us: AtomicU64,
}

impl Latency {
    /// Counts one duration.
    pub fn record(&self, duration: Duration) {
        let seconds = duration.as_secs_f64();
        for (bucket, _) in self.buckets.iter().zip(BOUNDS).filter(|(_, bound)| seconds <= *bound) {
            bucket.fetch_add(1, Relaxed);
        }
        self.count.fetch_add(1, Relaxed);
        self.sum_us.fetch_add(u64::try_from(duration.as_micros()).unwrap_or(u64::MAX), Relaxed);
    }

    /// How many so far.
    pub fn count(&self) -> u64 {
        self.count.load(Relaxed)
    }
}

/// Everything that is counted.
#[derive(Debug)]
#[allow(missing_docs, reason = "each is described where it is written out, below")]
pub struct Metrics {
    started: Instant,
    pub http_requests: Counter,
    pub http_problems: Counter,
    pub connections: Gauge,
    pub viewers: Gauge,
    pub messages_received: Counter,
    pub messages_refused: Counter,
    pub frames_sent: Counter,
    pub frames_skipped: Counter,
    pub frame_bytes_sent: Counter,
    pub frame_latency: Latency,
    pub edits_accepted: Counter,
    pub edits_refused: Counter,
    pub edit_queue: Gauge,
    pub edit_latency: Latency,
    pub passes: Counter,
    pub steps_cut: Counter,
    /// Of the whole ones, those that a graphics card drew.
    pub passes_gpu: Counter,
    pub rays: Counter,
    /// Photons traced again to see whether their light is still as kept.
    pub photons_probed: Counter,
    /// Groups of photons of which one went another way although no edit told of a change.
    pub photon_groups_diverged: Counter,
    pub samples: Counter,
    pub render_us: Counter,
    /// Single pictures begun, and those begun with light that the scene knew.
    pub pictures: Counter,
    pub pictures_lit: Counter,
    /// Single pictures that learnt of the light together with others.
    pub pictures_joined: Counter,
    /// Forecasts of errors that were reached since, those that named the time within a quarter of it, those of which it is known whether it
    /// came between the times that were told, and those for which it did.
    pub forecasts_judged: Counter,
    pub forecasts_right: Counter,
    pub forecasts_decided: Counter,
    pub forecasts_held: Counter,
    pub film_bytes: Gauge,
    /// Bytes of light that scenes keep with nobody looking.
    pub kept_light_bytes: Gauge,
}

impl Default for Metrics {
    fn default() -> Metrics {
        Metrics {
            started: Instant::now(),
            http_requests: Counter::default(),
            http_problems: Counter::default(),
            connections: Gauge::default(),
            viewers: Gauge::default(),
            messages_received: Counter::default(),
            messages_refused: Counter::default(),
            frames_sent: Counter::default(),
            frames_skipped: Counter::default(),
            frame_bytes_sent: Counter::default(),
            frame_latency: Latency::default(),
            edits_accepted: Counter::default(),
            edits_refused: Counter::default(),
            edit_queue: Gauge::default(),
            edit_latency: Latency::default(),
            passes: Counter::default(),
            steps_cut: Counter::default(),
            passes_gpu: Counter::default(),
            rays: Counter::default(),
            photons_probed: Counter::default(),
            photon_groups_diverged: Counter::default(),
            samples: Counter::default(),
            render_us: Counter::default(),
            pictures: Counter::default(),
            pictures_lit: Counter::default(),
            pictures_joined: Counter::default(),
            forecasts_judged: Counter::default(),
            forecasts_right: Counter::default(),
            forecasts_decided: Counter::default(),
            forecasts_held: Counter::default(),
            film_bytes: Gauge::default(),
            kept_light_bytes: Gauge::default(),
        }
    }
}

/// One scene's line in the metrics.
#[derive(Debug, Clone)]
pub struct SceneFigures {
    /// Label.
    pub id: String,
    /// Its revision.
    pub revision: u64,
    /// Viewers connected.
    pub viewers: u32,
    /// Largest measured error of its viewers' pictures, √relMSE as a fraction; nothing while none is measured.
    pub error: Option<f64>,
}

impl Metrics {
    /// Everything in Prometheus' text format, version 0.0.4.
    pub fn to_prometheus(&self, scenes: &[SceneFigures]) -> String {
        let mut out = String::new();
        let counters = [
            ("http_requests_total", "HTTP requests received", &self.http_requests),
            ("http_problems_total", "HTTP requests answered with a problem", &self.http_problems),
            ("messages_received_total", "WebSocket messages from clients", &self.messages_received),
            ("messages_refused_total", "WebSocket messages answered with an error", &self.messages_refused),
            ("frames_sent_total", "Pictures sent to viewers", &self.frames_sent),
            ("frames_skipped_total", "Pictures replaced before they could be sent", &self.frames_skipped),
            ("frame_bytes_sent_total", "Bytes of pictures sent, headers included", &self.frame_bytes_sent),
            ("edits_accepted_total", "Batches that made a revision", &self.edits_accepted),
            ("edits_refused_total", "Batches refused", &self.edits_refused),
            ("passes_total", "Rendering passes finished", &self.passes),
            (
                "steps_cut_total",
                "Steps that ended within a pass, by news or with their slice; the next goes on there",
                &self.steps_cut,
            ),
            ("passes_gpu_total", "Rendering passes that a graphics card finished", &self.passes_gpu),
            ("rays_total", "Rays traced", &self.rays),
            ("photons_probed_total", "Photons traced again to check the light", &self.photons_probed),
            (
                "photon_groups_diverged_total",
                "Groups of photons whose light changed without an edit",
                &self.photon_groups_diverged,
            ),
            ("samples_total", "Pixel samples drawn", &self.samples),
            ("pictures_total", "Single pictures begun", &self.pictures),
            (
                "pictures_lit_total",
                "Single pictures begun with light that the scene knew already",
                &self.pictures_lit,
            ),
            (
                "pictures_joined_total",
                "Single pictures that learn of the light together with one that was being drawn",
                &self.pictures_joined,
            ),
            (
                "forecasts_judged_total",
                "Forecasts whose error was reached or whose time went by",
                &self.forecasts_judged,
            ),
            (
                "forecasts_right_total",
                "Forecasts that named the time within a quarter of it",
                &self.forecasts_right,
            ),
            (
                "forecasts_decided_total",
                "Forecasts of which it is known whether it came between the times that were told",
                &self.forecasts_decided,
            ),
            (
                "forecasts_held_total",
                "Forecasts for which it came between the times that were told",
                &self.forecasts_held,
            ),
        ];
        for (name, help, counter) in counters {
            single(&mut out, name, "counter", help, counter.value() as f64);
        }
        let gauges = [
            ("connections", "TCP connections open", &self.connections),
            ("viewers", "WebSocket viewers connected", &self.viewers),
            ("edit_queue", "Batches waiting for a scene", &self.edit_queue),
            ("film_bytes", "Memory of all films", &self.film_bytes),
            (
                "kept_light_bytes",
                "Memory of light that scenes keep with nobody looking",
                &self.kept_light_bytes,
            ),
        ];
        for (name, help, gauge) in gauges {
            single(&mut out, name, "gauge", help, gauge.value() as f64);
        }
        let render_seconds = self.render_us.value() as f64 * 1e-6;
        single(&mut out, "render_seconds_total", "counter", "Time spent rendering", render_seconds);
        let uptime = self.started.elapsed().as_secs_f64();
        single(&mut out, "uptime_seconds", "gauge", "Time since the start", uptime);
        let frame_help = "From receiving a camera message to sending the first frame drawn from it";
        histogram(&mut out, "frame_latency_seconds", frame_help, &self.frame_latency);
        let edit_help = "From queueing a batch to its answer";
        histogram(&mut out, "edit_latency_seconds", edit_help, &self.edit_latency);
        per_scene(&mut out, "scene_revision", "Revision of each scene", scenes, |scene| {
            Some(scene.revision as f64)
        });
        per_scene(&mut out, "scene_viewers", "Viewers of each scene", scenes, |scene| {
            Some(scene.viewers.into())
        });
        let help = "Largest measured error of a scene's viewers, √relMSE as a fraction";
        per_scene(&mut out, "scene_error", help, scenes, |scene| scene.error);
        out
    }
}

// Writing to a String cannot fail, so the results below are dropped.

fn head(out: &mut String, name: &str, kind: &str, help: &str) {
    let _ = writeln!(out, "# HELP lumicast_{name} {help}\n# TYPE lumicast_{name} {kind}");
}

fn single(out: &mut String, name: &str, kind: &str, help: &str, value: f64) {
    head(out, name, kind, help);
    let _ = writeln!(out, "lumicast_{name} {value}");
}

fn histogram(out: &mut String, name: &str, help: &str, latency: &Latency) {
    head(out, name, "histogram", help);
    for (bucket, bound) in latency.buckets.iter().zip(BOUNDS) {
        let _ = writeln!(out, "lumicast_{name}_bucket{{le=\"{bound}\"}} {}", bucket.load(Relaxed));
    }
    let count = latency.count();
    let _ = writeln!(out, "lumicast_{name}_bucket{{le=\"+Inf\"}} {count}");
    let _ = writeln!(out, "lumicast_{name}_sum {}", latency.sum_us.load(Relaxed) as f64 * 1e-6);
    let _ = writeln!(out, "lumicast_{name}_count {count}");
}

fn per_scene(
    out: &mut String,
    name: &str,
    help: &str,
    scenes: &[SceneFigures],
    value: impl Fn(&SceneFigures) -> Option<f64>,
) {
    head(out, name, "gauge", help);
    for (scene, value) in scenes.iter().filter_map(|scene| Some((scene, value(scene)?))) {
        // A scene's id holds no quotes and no backslashes.
        let _ = writeln!(out, "lumicast_{name}{{scene=\"{}\"}} {value}", scene.id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_format_has_a_type_for_every_sample_and_growing_buckets() {
        let metrics = Metrics::default();
        metrics.frame_latency.record(Duration::from_millis(15));
        metrics.frame_latency.record(Duration::from_secs(60));
        let text = metrics.to_prometheus(&[
            SceneFigures { id: "box".into(), revision: 3, viewers: 1, error: Some(0.05) },
            SceneFigures { id: "dark".into(), revision: 1, viewers: 0, error: None },
        ]);
        assert!(text.contains("lumicast_scene_revision{scene=\"box\"} 3"));
        assert!(text.contains("lumicast_scene_error{scene=\"box\"} 0.05"));
        assert!(!text.contains("lumicast_scene_error{scene=\"dark\"}"));
        assert!(text.contains("lumicast_frame_latency_seconds_bucket{le=\"0.01\"} 0"));
        assert!(text.contains("lumicast_frame_latency_seconds_bucket{le=\"0.02\"} 1"));
        assert!(text.contains("lumicast_frame_latency_seconds_bucket{le=\"+Inf\"} 2"));
        let typed: Vec<&str> =
            text.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split(' ').next()).collect();
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            assert!(typed.iter().any(|name| line.starts_with(name)), "{line}");
        }
    }
}
