//! The progress bar, on terminals only.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use lumicast_engine::render::Rendering;

use super::{forecast::Outlook, stop::StopRule};

/// Steps of the bar: finer than a terminal is wide.
const STEPS: u64 = 1000;
/// Between two messages: people do not read faster.
const PAUSE: Duration = Duration::from_millis(200);

/// Shows samples, error, rays per second and what is expected on standard error; nothing when that is no terminal.
#[derive(Debug)]
pub(super) struct Progress {
    bar: ProgressBar,
    rule: StopRule,
    shown_at: Option<Instant>,
}

impl Progress {
    /// A bar that fills up towards `rule`.
    pub(super) fn new(rule: StopRule) -> Progress {
        let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
        // The template is a constant; were it wrong, the bar would look plain.
        if let Ok(style) = ProgressStyle::with_template("{bar:24} {msg}") {
            bar.set_style(style);
        }
        Progress { bar, rule, shown_at: None }
    }

    /// Shows how far `rendering` is after `seconds`.
    pub(super) fn show(&mut self, rendering: &Rendering, outlook: &Outlook, seconds: f64) {
        if self.bar.is_hidden() || self.shown_at.is_some_and(|at| at.elapsed() < PAUSE) {
            return;
        }
        self.shown_at = Some(Instant::now());
        let error = outlook.measured().map(|error| error.error());
        let done = done_share(&self.rule, rendering.passes(), seconds, error);
        let counts = rendering.counts();
        let rays_per_second = counts.all_rays() as f64 / seconds.max(1e-9);
        let error = error.map_or("–".into(), |error| format!("{:.2} %", error * 100.0));
        let left = outlook.words().map(|words| format!(", {words}")).unwrap_or_default();
        self.bar.set_position((done * STEPS as f64) as u64);
        self.bar.set_message(format!(
            "{}, error {error}, {:.2} M rays/s, {seconds:.0} s{left}",
            samples_of(rendering.passes()),
            rays_per_second / 1e6
        ));
    }

    /// Takes the bar away.
    pub(super) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

fn samples_of(passes: u32) -> String {
    format!("{passes} {}", if passes == 1 { "sample" } else { "samples" })
}

/// Share of the work done: of the bound that is nearest. The error falls with the root of the samples, so the
/// share of the way to an error is (target / error)².
fn done_share(rule: &StopRule, samples: u32, seconds: f64, error: Option<f64>) -> f64 {
    let of_samples = rule.samples.map(|bound| f64::from(samples) / f64::from(bound));
    let of_time = rule.time.map(|bound| seconds / bound.as_secs_f64());
    let of_error = rule.error.and_then(|bound| Some((bound / error?).powi(2)));
    [of_samples, of_time, of_error].into_iter().flatten().fold(0.0, f64::max).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bound that is nearest says how much is done; half the error is four times the work.
    #[test]
    fn the_nearest_bound_says_how_much_is_done() {
        let rule = StopRule { samples: Some(100), time: Some(Duration::from_secs(10)), error: Some(0.01) };
        assert_eq!(done_share(&rule, 10, 0.0, None), 0.1);
        assert_eq!(done_share(&rule, 10, 5.0, None), 0.5);
        assert_eq!(done_share(&rule, 10, 1.0, Some(0.02)), 0.25);
        assert_eq!(done_share(&rule, 1000, 1.0, Some(0.0)), 1.0);
    }
}
