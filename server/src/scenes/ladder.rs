//! How large a picture is drawn: as large as a pass's time allows while things move, full size once they rest.
//!
//! Rungs are divisors 1, 2, 4, 8, 16 of the asked size. The speed is measured, in pixel samples a second, so the
//! choice follows the machine, the scene and the load without any setting.

use std::time::{Duration, Instant};

/// Smaller than a sixteenth is no picture any more: a slower machine is shown that.
pub(super) const DIVISOR_MAX: u32 = 16;
/// A pass of full size this short is drawn at once when the camera rests; a longer one is led up to rung by rung, so
/// that there is something new to see at least four times a second.
const LEAP_SECONDS: f64 = 0.25;
/// Before anything was measured: low, so that the first picture comes quickly on any machine.
const FIRST_GUESS: f64 = 250_000.0;
/// Share of the newest measurement in the running speed: follows a change within three passes.
const NEWEST_SHARE: f64 = 0.4;

/// Share of the budget that a finer rung may take: between rungs lies a factor of four, so this leaves room on both sides.
const TIME_TO_SPARE: f64 = 0.6;

/// A picture that had to become coarser while things move becomes no finer for so long: what a pass takes wavers with the view, and a
/// size that goes up and down with it is worse to look at than a small one.
const FINER_PAUSE: Duration = Duration::from_secs(2);

/// Width and height in pixels.
pub(super) type Size = [u16; 2];

/// The running speed of a scene's pictures, and what follows from it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Speed {
    samples_per_second: f64,
}

impl Default for Speed {
    fn default() -> Speed {
        Speed { samples_per_second: FIRST_GUESS }
    }
}

impl Speed {
    /// Takes in a pass. One of under a millisecond says more about the clock than about speed.
    pub(super) fn measure(&mut self, samples: u64, seconds: f64) {
        if samples > 0 && seconds > 1e-3 {
            let newest = samples as f64 / seconds;
            self.samples_per_second += NEWEST_SHARE * (newest - self.samples_per_second);
        }
    }

    /// Pixel samples a second.
    pub(super) fn samples_per_second(&self) -> f64 {
        self.samples_per_second
    }

    /// How long one pass of a picture takes.
    pub(super) fn pass_seconds(&self, size: Size) -> f64 {
        f64::from(size[0]) * f64::from(size[1]) / self.samples_per_second
    }

    /// The divisor for a picture that must be there within `budget_seconds`.
    ///
    /// A finer one than the `last` is taken only with time to spare, so that the size does not flicker between two
    /// rungs while the speed wavers.
    pub(super) fn divisor_within(&self, full: Size, budget_seconds: f64, last: u32) -> u32 {
        let fits = |divisor: &u32| {
            let allowed = if *divisor < last { TIME_TO_SPARE * budget_seconds } else { budget_seconds };
            self.pass_seconds(scaled(full, *divisor)) <= allowed
        };
        rungs(1).find(fits).unwrap_or(DIVISOR_MAX)
    }

    /// The next divisor on the way to full size.
    pub(super) fn divisor_above(&self, full: Size, divisor: u32) -> u32 {
        if self.pass_seconds(full) <= LEAP_SECONDS { 1 } else { (divisor / 2).max(1) }
    }
}

/// The rung of one viewer's passes while things move.
#[derive(Debug, Clone, Copy)]
pub(super) struct QuickRung {
    /// Of which size.
    full: Size,
    divisor: u32,
    /// When it became coarser last.
    coarsened: Option<Instant>,
}

impl Default for QuickRung {
    fn default() -> QuickRung {
        QuickRung { full: [0, 0], divisor: DIVISOR_MAX, coarsened: None }
    }
}

impl QuickRung {
    /// The divisor of the next pass.
    ///
    /// - `budget_seconds`: that the pass may take
    pub(super) fn next(&mut self, speed: &Speed, full: Size, budget_seconds: f64, now: Instant) -> u32 {
        if std::mem::replace(&mut self.full, full) != full {
            self.coarsened = None;
        }
        let fitting = speed.divisor_within(full, budget_seconds, self.divisor);
        let stays = self.coarsened.is_some_and(|at| now.saturating_duration_since(at) < FINER_PAUSE);
        if stays { fitting.max(self.divisor) } else { fitting }
    }

    /// Takes note of what was drawn.
    pub(super) fn take(&mut self, divisor: u32, now: Instant) {
        if divisor > self.divisor {
            self.coarsened = Some(now);
        }
        self.divisor = divisor;
    }
}

/// Divisors from `first` on, coarser and coarser.
pub(super) fn rungs(first: u32) -> impl Iterator<Item = u32> {
    std::iter::successors(Some(first), |divisor| Some(divisor * 2))
        .take_while(|divisor| *divisor <= DIVISOR_MAX)
}

/// The asked size divided, rounded up, at least one pixel.
pub(super) fn scaled(full: Size, divisor: u32) -> Size {
    // A quotient of a u16 is a u16.
    full.map(|side| u32::from(side).div_ceil(divisor).max(1) as u16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pass_fits_its_budget_wherever_a_rung_does() {
        for samples_per_second in [1e5, 1e6, 1e7, 1e9] {
            let speed = Speed { samples_per_second };
            for full in [[1, 1], [640, 360], [1920, 1080], [4096, 4096]] {
                let divisor = speed.divisor_within(full, 0.04, 1);
                let fits = speed.pass_seconds(scaled(full, divisor)) <= 0.04;
                assert!(fits || divisor == DIVISOR_MAX);
                // One rung larger would not have fitted.
                let larger = speed.pass_seconds(scaled(full, divisor / 2 + divisor % 2));
                assert!(divisor == 1 || larger > 0.04);
            }
        }
    }

    #[test]
    fn a_finer_rung_needs_time_to_spare() {
        let full = [640, 360];
        // A half-size pass in exactly the budget, then in half of it.
        let barely = Speed { samples_per_second: 320.0 * 180.0 / 0.04 };
        assert_eq!(barely.divisor_within(full, 0.04, 2), 2);
        assert_eq!(barely.divisor_within(full, 0.04, 4), 4);
        let easily = Speed { samples_per_second: 320.0 * 180.0 / 0.02 };
        assert_eq!(easily.divisor_within(full, 0.04, 4), 2);
    }

    /// A speed that wavers by a factor of eight makes the picture larger once in two seconds at most; another size that is asked for is
    /// another picture.
    #[test]
    fn a_size_does_not_waver_with_the_speed() {
        let (full, mut rung, start) = ([640, 360], QuickRung::default(), Instant::now());
        let [slow, fast] = [0.04, 0.005].map(|seconds| Speed { samples_per_second: 160.0 * 90.0 / seconds });
        let mut changes = 0;
        for pass in 0..200u32 {
            let now = start + pass * Duration::from_millis(50);
            let speed = if pass % 3 == 0 { slow } else { fast };
            let before = rung.divisor;
            let divisor = rung.next(&speed, full, 0.04, now);
            assert!(speed.pass_seconds(scaled(full, divisor)) <= 0.04);
            rung.take(divisor, now);
            changes += u32::from(divisor != before);
        }
        // 10 s: larger, and smaller again, every two.
        assert!(changes > 2 && changes <= 12, "{changes} changes");
        rung.take(DIVISOR_MAX, start);
        assert_eq!(rung.next(&fast, full, 0.04, start), DIVISOR_MAX);
        assert_eq!(rung.next(&fast, [160, 90], 0.04, start), 1);
    }

    #[test]
    fn climbing_ends_at_full_size() {
        for samples_per_second in [1e5, 1e7] {
            let speed = Speed { samples_per_second };
            let mut divisor = DIVISOR_MAX;
            for _ in 0..5 {
                divisor = speed.divisor_above([1920, 1080], divisor);
            }
            assert_eq!(divisor, 1);
        }
    }

    #[test]
    fn the_speed_follows_what_is_measured() {
        let mut speed = Speed::default();
        for _ in 0..20 {
            speed.measure(1_000_000, 0.5);
        }
        assert!((speed.samples_per_second() / 2e6 - 1.0).abs() < 1e-3);
        speed.measure(100, 1e-6);
        assert!((speed.samples_per_second() / 2e6 - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_scaled_size_never_vanishes() {
        assert_eq!(scaled([1, 3], 16), [1, 1]);
        assert_eq!(scaled([641, 361], 2), [321, 181]);
    }
}
