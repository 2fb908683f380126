//! Durations as people write them.

use std::{str::FromStr, time::Duration};

/// A number with one of the units ms, s, m, h; seconds without.
pub(crate) fn parse_duration(value: &str) -> Result<Duration, String> {
    // By their ends, since numbers may have letters of their own (1e-3).
    let units = [("ms", 1e-3), ("s", 1.0), ("m", 60.0), ("h", 3600.0), ("", 1.0)];
    let of_unit = |(unit, seconds): (&str, f64)| Some((value.strip_suffix(unit)?, seconds));
    let (number, unit_seconds) = units.into_iter().find_map(of_unit).unwrap_or((value, 1.0));
    let seconds = f64::from_str(number)
        .map_err(|_| format!("{number:?} is not a number; units are ms, s, m and h"))?
        * unit_seconds;
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
        assert_eq!((millis("2.5"), millis("5e-1"), millis("1e1s")), (Some(2500), Some(500), Some(10_000)));
        assert_eq!(
            (millis("500ms"), millis("2m"), millis("1h")),
            (Some(500), Some(120_000), Some(3_600_000))
        );
        for bad in
            ["", "0s", "-0", "-1s", "10d", "10 d", "s", "1e300h", "9000h", "nan", "inf", "1e-12s", "1e-9ms"]
        {
            assert!(parse_duration(bad).is_err(), "{bad}");
        }
    }
}
