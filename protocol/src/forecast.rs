//! How good pictures are to become, by name, and when they will be how good.

use std::fmt;

use serde::{Deserialize, Serialize};

/// How exact a picture is to become, for those who do not care for numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Preset {
    /// Good enough to move about.
    #[serde(rename = "10%")]
    Ten,
    /// Good enough to place things.
    #[serde(rename = "5%")]
    Five,
    /// Good enough to judge light.
    #[serde(rename = "2%")]
    Two,
    /// Good enough to measure in.
    #[serde(rename = "1%")]
    One,
    /// As good as it becomes within the server's bound on samples.
    #[serde(rename = "converged")]
    Converged,
}

impl Preset {
    /// Every one, coarse to fine.
    pub const ALL: [Self; 5] = [Self::Ten, Self::Five, Self::Two, Self::One, Self::Converged];

    /// As in JSON and queries.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ten => "10%",
            Self::Five => "5%",
            Self::Two => "2%",
            Self::One => "1%",
            Self::Converged => "converged",
        }
    }

    /// √relMSE as a fraction; nothing for `converged`, which no error ends.
    pub fn error(self) -> Option<f32> {
        match self {
            Self::Ten => Some(0.1),
            Self::Five => Some(0.05),
            Self::Two => Some(0.02),
            Self::One => Some(0.01),
            Self::Converged => None,
        }
    }

    /// The errors of all presets and `own`, coarse to fine, each once.
    pub fn errors_with(own: Option<f64>) -> Vec<f64> {
        // To four digits, as they are written: single precision has others.
        let exact = |error: f32| (f64::from(error) * 1e4).round() / 1e4;
        let mut errors: Vec<f64> = Self::ALL.iter().filter_map(|preset| preset.error().map(exact)).collect();
        errors.extend(own.filter(|own| errors.iter().all(|error| (error - own).abs() > 1e-6)));
        errors.sort_unstable_by(|a, b| b.total_cmp(a));
        errors
    }
}

/// When the picture will have an error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// √relMSE as a fraction: 0.01 = 1 %.
    pub error: f32,
    /// What is known of it.
    pub when: ForecastWhen,
    /// With `in`: from now on. With `reached`: since the film restarted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// With `in`: four of five times at least between these, seconds from now on, where the error is known badly or light is still learnt. Left out
    /// where the time in all is known to a quarter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub between: Option<[f64; 2]>,
    /// With `out_of_reach`: the technique's own error, √relMSE as a fraction. With `beyond_samples`: samples a pixel that it
    /// would take.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub figure: Option<f64>,
}

/// What is known of when an error will be reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ForecastWhen {
    /// It has been.
    Reached,
    /// In `seconds`.
    In,
    /// Never by this technique: its own error is larger.
    OutOfReach,
    /// The picture rests before, by the server's bound on samples.
    BeyondSamples,
    /// Too little is known yet.
    Unknown,
}

/// How often forecasts came true.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ForecastRecord {
    /// Forecasts made after a tenth of the time that it took, whose error was reached since, and those whose time went by.
    pub judged: u64,
    /// Those of them that named the time within a quarter of it.
    pub right: u64,
    /// Those of all judged of which it is known whether it came between the times that were told, or within a quarter where none were.
    #[serde(default)]
    pub decided: u64,
    /// Those of them for which it did.
    #[serde(default)]
    pub held: u64,
}

impl fmt::Display for Forecast {
    /// Without its error: "in about 4 s", and "in about 4 s (2 to 9 s)" where the time is not known to a quarter.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.when, self.seconds, self.figure) {
            (ForecastWhen::Reached, Some(seconds), _) => write!(f, "since {}", About(seconds)),
            (ForecastWhen::In, Some(seconds), _) => {
                match seconds < SOON {
                    true => f.write_str("at any moment")?,
                    false => write!(f, "in about {}", About(seconds))?,
                }
                self.between.map_or(Ok(()), |between| write!(f, " ({})", Between(between)))
            }
            (ForecastWhen::OutOfReach, _, Some(error)) => {
                write!(f, "never: the technique's own error is {:.1} %", 100.0 * error)
            }
            (ForecastWhen::BeyondSamples, _, Some(samples)) => {
                write!(f, "not before it ends: that would take {samples:.0} samples a pixel")
            }
            _ => f.write_str("not known yet"),
        }
    }
}

/// Seconds that nobody waits for.
const SOON: f64 = 0.05;
/// A time that is less than this share of another is as good as now beside it.
const NOW: f64 = 0.1;

/// A time to two figures at most, as one says it.
struct About(f64);

impl About {
    /// In its unit, with how many digits behind the point, and the unit.
    fn parts(&self) -> (f64, usize, &'static str) {
        match self.0 {
            s if s < 0.95 => (s, 1, "s"),
            s if s < 99.5 => (s, 0, "s"),
            s if s < 99.5 * 60.0 => (s / 60.0, 0, "min"),
            s if s < 99.5 * 3600.0 => (s / 3600.0, 0, "h"),
            s => (s / 86_400.0, 0, "days"),
        }
    }
}

impl fmt::Display for About {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (figure, digits, unit) = self.parts();
        write!(f, "{figure:.digits$} {unit}")
    }
}

/// Two times, the unit told once if it is the same: "3 to 12 s"; "up to 12 s" where the first is as good as now.
struct Between([f64; 2]);

impl fmt::Display for Between {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [least, most] = self.0;
        if !(least >= NOW * most && least >= SOON) {
            return write!(f, "up to {}", About(most));
        }
        let ((figure, digits, unit), (_, _, unit_of_most)) = (About(least).parts(), About(most).parts());
        if unit == unit_of_most {
            write!(f, "{figure:.digits$} to {}", About(most))
        } else {
            write!(f, "{} to {}", About(least), About(most))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forecasts_are_told_in_words() {
        let of = |when, seconds, figure| {
            Forecast { error: 0.02, when, seconds, between: None, figure }.to_string()
        };
        assert_eq!(of(ForecastWhen::Reached, Some(0.42), None), "since 0.4 s");
        assert_eq!(of(ForecastWhen::In, Some(3.7), None), "in about 4 s");
        assert_eq!(of(ForecastWhen::In, Some(1200.0), None), "in about 20 min");
        assert_eq!(of(ForecastWhen::In, Some(1e6), None), "in about 12 days");
        assert_eq!(of(ForecastWhen::In, Some(0.0), None), "at any moment");
        let never = of(ForecastWhen::OutOfReach, None, Some(0.061));
        assert_eq!(never, "never: the technique's own error is 6.1 %");
        let beyond = of(ForecastWhen::BeyondSamples, None, Some(2.5e5));
        assert_eq!(beyond, "not before it ends: that would take 250000 samples a pixel");
        assert_eq!(of(ForecastWhen::Unknown, None, None), "not known yet");
    }

    /// What is known badly is told as what it is.
    #[test]
    fn times_that_are_known_badly_are_told_apart() {
        let of = |seconds, between| {
            let when = ForecastWhen::In;
            Forecast { error: 0.02, when, seconds: Some(seconds), between: Some(between), figure: None }
                .to_string()
        };
        assert_eq!(of(6.0, [3.0, 12.0]), "in about 6 s (3 to 12 s)");
        assert_eq!(of(1.0, [0.0, 12.0]), "in about 1 s (up to 12 s)");
        assert_eq!(of(1.0, [0.5, 2.0]), "in about 1 s (0.5 to 2 s)");
        assert_eq!(of(90.0, [40.0, 190.0]), "in about 90 s (40 s to 3 min)");
        assert_eq!(of(5e5, [2e5, 1e6]), "in about 6 days (56 h to 12 days)");
        assert_eq!(of(0.04, [0.03, 0.4]), "at any moment (up to 0.4 s)");
    }

    /// The error asked for stands among the presets, once.
    #[test]
    fn a_target_stands_among_the_presets_once() {
        assert_eq!(Preset::errors_with(None), [0.1, 0.05, 0.02, 0.01]);
        assert_eq!(Preset::errors_with(Some(f64::from(0.02f32))), [0.1, 0.05, 0.02, 0.01]);
        assert_eq!(Preset::errors_with(Some(0.03)), [0.1, 0.05, 0.03, 0.02, 0.01]);
    }

    #[test]
    fn presets_are_written_by_their_names() {
        for preset in Preset::ALL {
            let json = serde_json::to_string(&preset).unwrap();
            assert_eq!(json, format!("\"{}\"", preset.name()));
        }
    }
}
