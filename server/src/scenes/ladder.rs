//! How large a picture is drawn: as large as a pass's time allows while things move, full size once they rest.
//!
//! Rungs are divisors 1, 2, 4, 8, 16 of the asked size. What a pass takes is measured, so the choice follows the machine, the scene and the load
//! without any setting. Two sizes tell it: cards take their time to begin with anything, and for larger pictures little more.

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

/// Where half the width takes more than this share of the time, beginning is what takes it: a coarser picture would come hardly sooner.
const SAVED_SHARE_MAX: f64 = 0.75;

/// A picture that had to become coarser while things move becomes no finer for so long: what a pass takes wavers with the view, and a
/// size that goes up and down with it is worse to look at than a small one.
const FINER_PAUSE: Duration = Duration::from_secs(2);

/// Width and height in pixels.
pub(super) type Size = [u16; 2];

/// Passes whose samples differ by no more than so many times are of one size.
const SAME_SIZE: f64 = 1.5;
/// Share of what a sample takes now that each further one is taken to cost, at least, as times are of chance.
const SLOPE_MIN: f64 = 0.1;

/// What passes of about one size took, the newest counting most.
#[derive(Debug, Clone, Copy)]
struct Passes {
    samples: f64,
    /// Of one sample.
    seconds_each: f64,
}

impl Passes {
    fn seconds(self) -> f64 {
        self.samples * self.seconds_each
    }
}

/// The running speed of a scene's pictures, and what follows from it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Speed {
    newest: Passes,
    /// Of another size, before those.
    before: Option<Passes>,
    is_measured: bool,
    /// Of steps that have brought nothing yet: cards bring all samples of a pass with its last.
    pending_seconds: f64,
}

impl Default for Speed {
    fn default() -> Speed {
        Speed::of_rate(FIRST_GUESS)
    }
}

impl Speed {
    fn of_rate(samples_per_second: f64) -> Speed {
        let newest = Passes { samples: samples_per_second, seconds_each: 1.0 / samples_per_second };
        Speed { newest, before: None, is_measured: false, pending_seconds: 0.0 }
    }

    /// Takes in a pass, or a step of one. One of under a millisecond says more about the clock than about speed.
    pub(super) fn measure(&mut self, samples: u64, seconds: f64) {
        if samples == 0 {
            self.pending_seconds += seconds;
            return;
        }
        let seconds = seconds + std::mem::take(&mut self.pending_seconds);
        if seconds <= 1e-3 {
            return;
        }
        let samples = samples as f64;
        let rate = samples / seconds;
        let of_newest = 1.0 / self.newest.seconds_each;
        let times = samples / self.newest.samples;
        let is_other = !(1.0 / SAME_SIZE..=SAME_SIZE).contains(&times);
        if is_other && self.is_measured {
            self.before = Some(self.newest);
            self.newest = Passes { samples, seconds_each: seconds / samples };
        } else {
            let rate = of_newest + NEWEST_SHARE * (rate - of_newest);
            self.newest = Passes { samples, seconds_each: 1.0 / rate };
        }
        self.is_measured = true;
    }

    /// Pixel samples a second, of passes of the size that was drawn last.
    pub(super) fn samples_per_second(&self) -> f64 {
        1.0 / self.newest.seconds_each
    }

    /// How long one pass of a picture takes: by what each sample took more in the larger of two sizes, where two were drawn, and by what each
    /// took else.
    pub(super) fn pass_seconds(&self, size: Size) -> f64 {
        let samples = f64::from(size[0]) * f64::from(size[1]);
        let newest = self.newest;
        let slope = self.before.map_or(newest.seconds_each, |before| {
            let slope = (newest.seconds() - before.seconds()) / (newest.samples - before.samples);
            slope.clamp(SLOPE_MIN * newest.seconds_each, newest.seconds_each)
        });
        newest.seconds() + slope * (samples - newest.samples)
    }

    /// The divisor for a picture that must be there within `budget_seconds`.
    ///
    /// A finer one than the `last` is taken only with time to spare, so that the size does not flicker between two
    /// rungs while the speed wavers; and none is given up for one that takes about as long.
    pub(super) fn divisor_within(&self, full: Size, budget_seconds: f64, last: u32) -> u32 {
        let fits = |divisor: &u32| {
            let allowed = if *divisor < last { TIME_TO_SPARE * budget_seconds } else { budget_seconds };
            let seconds = self.pass_seconds(scaled(full, *divisor));
            let of_next = self.pass_seconds(scaled(full, divisor * 2));
            seconds <= allowed || of_next > SAVED_SHARE_MAX * seconds
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
            let speed = Speed::of_rate(samples_per_second);
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
        let barely = Speed::of_rate(320.0 * 180.0 / 0.04);
        assert_eq!(barely.divisor_within(full, 0.04, 2), 2);
        assert_eq!(barely.divisor_within(full, 0.04, 4), 4);
        let easily = Speed::of_rate(320.0 * 180.0 / 0.02);
        assert_eq!(easily.divisor_within(full, 0.04, 4), 2);
    }

    /// A speed that wavers by a factor of eight makes the picture larger once in two seconds at most; another size that is asked for is
    /// another picture.
    #[test]
    fn a_size_does_not_waver_with_the_speed() {
        let (full, mut rung, start) = ([640, 360], QuickRung::default(), Instant::now());
        let [slow, fast] = [0.04, 0.005].map(|seconds| Speed::of_rate(160.0 * 90.0 / seconds));
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
            let speed = Speed::of_rate(samples_per_second);
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
        // A pass in steps, of which the last brings all its samples.
        for seconds in [0.2, 0.2, 0.1] {
            speed.measure(if seconds < 0.15 { 1_000_000 } else { 0 }, seconds);
        }
        assert!((speed.samples_per_second() / 2e6 - 1.0).abs() < 1e-3);
    }

    /// Where passes take their time to begin and little for each pixel, two sizes tell what a third takes; where each pixel takes as long, one
    /// does; chance neither makes pixels free nor dearer than those that were drawn.
    #[test]
    fn two_sizes_tell_what_a_third_takes() {
        let told = |fixed: f64, each: f64| {
            let mut speed = Speed::default();
            for samples in [8_000, 32_000, 128_000] {
                for _ in 0..12 {
                    speed.measure(samples, fixed + each * samples as f64);
                }
            }
            let large = speed.pass_seconds([1920, 1080]);
            large / (fixed + each * 1920.0 * 1080.0)
        };
        for (fixed, each) in [(0.0, 1e-7), (0.01, 1e-8), (0.03, 1e-7)] {
            assert!((told(fixed, each) - 1.0).abs() < 0.02, "{fixed} {each}: {}", told(fixed, each));
        }
        let mut speed = Speed::default();
        for (samples, seconds) in [(100, 0.02), (100, 0.02), (400, 0.01), (1_600, 1.0)] {
            speed.measure(samples, seconds);
        }
        assert!((speed.pass_seconds([1600, 2]) - 2.0).abs() < 1e-6, "no dearer than before");
        for _ in 0..20 {
            speed.measure(1_600, 1.0);
        }
        speed.measure(6_400, 0.9);
        assert!((speed.pass_seconds([6400, 2]) - (0.9 + 0.09)).abs() < 1e-3, "and not free");
        assert!(speed.pass_seconds([1, 1]) > 0.0);
    }

    /// Where a pass takes 35 ms to begin with, a picture that may take 30 is no sooner there for being tiny: it grows as far as that costs little.
    #[test]
    fn pictures_shrink_no_further_than_that_saves_time() {
        let (full, mut speed, mut divisor) = ([640, 360], Speed::default(), 8);
        for _ in 0..12 {
            let samples: u32 = scaled(full, divisor).map(u32::from).iter().product();
            speed.measure(samples.into(), 0.035 + 1e-7 * f64::from(samples));
            divisor = speed.divisor_within(full, 0.03, divisor);
        }
        assert_eq!(divisor, 2, "58, 41, 36 and 35 ms");
    }

    #[test]
    fn a_scaled_size_never_vanishes() {
        assert_eq!(scaled([1, 3], 16), [1, 1]);
        assert_eq!(scaled([641, 361], 2), [321, 181]);
    }
}
