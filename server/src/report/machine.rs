//! What figures were measured on.

use serde::Serialize;

/// This machine, as far as the system tells.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Machine {
    /// Name of the processor.
    pub processor: String,
    /// Threads at work where a table does not say one.
    pub threads: usize,
    /// Operating system and architecture.
    pub system: String,
}

impl Machine {
    /// This one.
    pub(super) fn this() -> Machine {
        let facts = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let name = facts.lines().find_map(|line| line.strip_prefix("model name"));
        let name = name.map(|rest| rest.trim_start_matches([' ', '\t', ':']).trim());
        Machine {
            processor: name.filter(|name| !name.is_empty()).unwrap_or("unknown processor").into(),
            threads: rayon::current_num_threads(),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        }
    }
}

/// A word of warning when others keep the machine busy, where the system tells.
pub(super) fn busy() -> Option<String> {
    let facts = std::fs::read_to_string("/proc/loadavg").ok()?;
    let load: f64 = facts.split_whitespace().next()?.parse().ok()?;
    let threads = rayon::current_num_threads();
    // A quarter of one thread is what a quiet machine has left of its last minute.
    (load > 0.25).then(|| {
        format!(
            "When the run began, {load} others were at work on this machine's {threads} threads (mean of a minute): times may \
             be too long, and differ from row to row by more than the figures say."
        )
    })
}

impl std::fmt::Display for Machine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, {} threads, {}", self.processor, self.threads, self.system)
    }
}
