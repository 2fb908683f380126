//! Durations as people write them.

use std::{str::FromStr, time::Duration};

/// A number with one of the units ms, s, m, h; seconds without.
pub(crate) fn parse_duration(value: &str) -> Result<Duration, String> {
    let number_end = value.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(value.len());
    let (number, unit) = value.split_at(number_end);
    let unit_seconds = match unit {
        "ms" => 1e-3,
        "s" | "" => 1.0,
        "m" => 60.0,
        "h" => 3600.0,
        _ => return Err(format!("unit {unit:?}: choose ms, s, m or h")),
    };
    let seconds = f64::from_str(number).map_err(|_| format!("{number:?} is not a number"))? * unit_seconds;
    // A year: longer waits are slips of the keyboard, and far longer ones do not fit a Duration.
    let duration = (0.0..=366.0 * 86400.0).contains(&seconds).then(|| Duration::from_secs_f64(seconds));
    // So short that it is none in nanoseconds is none.
    duration
        .filter(|duration| !duration.is_zero())
        .ok_or_else(|| "must be above zero and at most a year".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is written is what is meant; what cannot be meant is refused.
    #[test]
    fn durations_are_read_in_their_units() {
        let millis = |value| parse_duration(value).map(|duration| duration.as_millis()).ok();
        assert_eq!(millis("10s"), Some(10_000));
        assert_eq!(millis("2.5"), Some(2500));
        assert_eq!(
            (millis("500ms"), millis("2m"), millis("1h")),
            (Some(500), Some(120_000), Some(3_600_000))
        );
        for bad in ["", "0s", "-1s", "10d", "s", "1e300h", "nan", "inf", "1e-12s"] {
            assert!(parse_duration(bad).is_err(), "{bad}");
        }
    }
}
