//! What was measured: a table for people, JSON for everything else.

use std::process::Command;

use lumicast_engine::{film::PictureSize, gpu::AdapterReport};
use serde_json::{Value, json};

/// What figures count in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unit {
    MillionRaysPerSecond,
    MillionPathsPerSecond,
    Milliseconds,
    Seconds,
    Bytes,
    Percent,
}

impl Unit {
    fn name(self) -> &'static str {
        match self {
            Unit::MillionRaysPerSecond => "M rays/s",
            Unit::MillionPathsPerSecond => "M paths/s",
            Unit::Milliseconds => "ms",
            Unit::Seconds => "s",
            Unit::Bytes => "bytes",
            Unit::Percent => "%",
        }
    }

    /// How many times as fast the card is.
    fn speed(self, gpu: f64, cpu: f64) -> f64 {
        match self {
            Unit::MillionRaysPerSecond | Unit::MillionPathsPerSecond => gpu / cpu,
            _ => cpu / gpu,
        }
    }

    fn text(self, value: f64) -> String {
        match self {
            Unit::Bytes => format!("{value:.0}"),
            Unit::Percent => format!("{value:.1}"),
            // Three digits, whether it is a slow driver or a fast card.
            _ if value.abs() >= 100.0 => format!("{value:.0}"),
            _ if value.abs() >= 10.0 => format!("{value:.1}"),
            _ => format!("{value:.2}"),
        }
    }
}

/// The same work on both.
#[derive(Clone, Debug)]
pub(crate) struct Figure {
    pub(crate) pass: String,
    pub(crate) unit: Unit,
    /// On the device's clock.
    pub(crate) gpu_device: Option<f64>,
    /// By the clock on the wall, with submission and waiting.
    pub(crate) gpu_wall: Option<f64>,
    pub(crate) cpu: Option<f64>,
}

impl Figure {
    /// Of the card, by the clock on the wall; nothing else measured yet.
    pub(crate) fn new(pass: impl Into<String>, unit: Unit, gpu_wall: f64) -> Figure {
        Figure { pass: pass.into(), unit, gpu_device: None, gpu_wall: Some(gpu_wall), cpu: None }
    }

    /// By the clock on the wall, as the CPU has no other.
    fn speed(&self) -> Option<f64> {
        Some(self.unit.speed(self.gpu_wall?, self.cpu?))
    }

    /// Backend, clock, value.
    fn values(&self) -> impl Iterator<Item = (&'static str, &'static str, f64)> {
        [("gpu", "device", self.gpu_device), ("gpu", "wall", self.gpu_wall), ("cpu", "wall", self.cpu)]
            .into_iter()
            .filter_map(|(backend, clock, value)| Some((backend, clock, value?)))
    }
}

/// All of them.
pub(crate) struct Figures {
    about: Value,
    /// With the name of the scene.
    all: Vec<(String, Figure)>,
}

impl Figures {
    pub(crate) fn new(adapter: &AdapterReport, size: PictureSize, rounds: usize) -> Figures {
        let about = json!({
            "machine": {
                "cpu": cpu_name(),
                "threads": rayon::current_num_threads(),
                "os": std::env::consts::OS,
                "arch": std::env::consts::ARCH,
            },
            "adapter": {
                "name": adapter.name,
                "driver": adapter.driver,
                "api": adapter.api,
                "kind": adapter.kind.to_string(),
            },
            "version": env!("CARGO_PKG_VERSION"),
            "rustc": rustc_version(),
            "size": [size.width(), size.height()],
            "rounds": rounds,
        });
        Figures { about, all: Vec::new() }
    }

    /// Those of one scene.
    pub(crate) fn of(&mut self, scene: &str) -> SceneFigures<'_> {
        SceneFigures { scene: scene.to_string(), figures: self }
    }

    pub(crate) fn print(&self) {
        println!("| scene | pass | unit | gpu, its clock | gpu, wall | cpu | gpu is × as fast |");
        println!("| --- | --- | --- | ---: | ---: | ---: | ---: |");
        for (scene, figure) in &self.all {
            let text = |value: Option<f64>| value.map_or("–".into(), |value| figure.unit.text(value));
            println!(
                "| {scene} | {} | {} | {} | {} | {} | {} |",
                figure.pass,
                figure.unit.name(),
                text(figure.gpu_device),
                text(figure.gpu_wall),
                text(figure.cpu),
                figure.speed().map_or("–".into(), |speed| format!("{speed:.2}")),
            );
        }
    }

    pub(crate) fn json(&self) -> Result<String, serde_json::Error> {
        let mut rows = Vec::new();
        for (scene, figure) in &self.all {
            rows.extend(figure.values().map(|(backend, clock, value)| {
                json!({"scene": scene, "pass": figure.pass, "backend": backend, "clock": clock, "value": value,
                    "unit": figure.unit.name()})
            }));
        }
        let mut all = self.about.clone();
        all["rows"] = Value::Array(rows);
        serde_json::to_string_pretty(&all)
    }
}

/// Figures of one scene.
pub(crate) struct SceneFigures<'a> {
    scene: String,
    figures: &'a mut Figures,
}

impl SceneFigures<'_> {
    pub(crate) fn push(&mut self, figure: Figure) {
        self.figures.all.push((self.scene.clone(), figure));
    }
}

/// As Linux names it; empty elsewhere.
fn cpu_name() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("model name"));
    line.map_or_else(String::new, |line| line.trim_start_matches([' ', '\t', ':']).to_string())
}

fn rustc_version() -> String {
    let output = Command::new("rustc").arg("--version").output();
    output.map_or_else(|_| String::new(), |output| String::from_utf8_lossy(&output.stdout).trim().to_string())
}
