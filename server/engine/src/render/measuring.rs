//! The measure of a picture of looked-up light: how much of the work it takes, and where and how long it looks.
//!
//! A [`Gauge`] path-traces some pixels, those where error is expected more likely than others. More samples go to the pixels there are or to
//! further pixels, by which of the two leaves less doubt; near the error that is asked for it takes more than its share.

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::hidden::HiddenHalves;
use crate::{
    film::{BLACK_PASSES, Film, Lacking, MeasuredError, Picture, PictureSize, lacking, measure_at},
    math::Rgb,
    technique::{
        Counts, Guide, View,
        path::{Gauge, PathSettings, SampleCost},
    },
    transport::{PathClass, World},
};

/// Share of rays for each share of the time: rays of measuring go farther than most.
const RAYS_FOR_TIME: f64 = 0.6;
/// Share of the time for measuring a picture that may soon be as good as asked for.
const NEAR_SHARE: MeasuringShare = MeasuringShare(20);
/// Samples of each half of a gauge's pixels before it is believed.
const SAMPLES_BELIEVED: u32 = 16;
/// The next decision falls due when the picture has this share of samples more than at the last: deciding looks at all pixels.
pub(super) const DECIDED_GROWTH: f64 = 0.125;
/// More pixels instead of more samples for those there are, once their errors differ by more than by what is not known of each, but
/// never with fewer samples than the first of these, nor fewer pixels with more than the last.
const SAMPLES_ENOUGH: [u32; 2] = [32, 16_384];
/// Pixels below which their spread is not believed, and more are taken, or half of all there are: on bunny-room a hundredth of the pixels
/// hold half of the squared error, and 132 that had met none of those looked as if they needed only more samples.
const PIXELS_ENOUGH: usize = 512;
/// The same where what is not known of each hides all error, once they have [`SAMPLES_NARROW`]: their mean's noise falls as one over samples,
/// and only as one over the root of pixels.
const PIXELS_LEAST: usize = 128;
/// Samples of either half up to which fewer pixels will do there: with 128 from the start, told errors of fourteen scenes after 4 s were 1.28
/// times the true ones in the mean, 1.03 so.
const SAMPLES_NARROW: u32 = 512;
/// Pixels that must agree that a picture is as good as asked for, or half of all there are, taken after it first seemed so: a
/// picture is looked at again and again, and the first look that says so is more often than not a lucky one.
const FRESH_PIXELS: usize = 128;
/// How much worse than told a picture is taken for by pixels that do not tell its error from nothing.
const UNKNOWN_FACTOR: f64 = 1.3;
/// Share of noise in where error is expected. With two thirds of it the relative variance of the mean was about the least on each of
/// three scenes (bunny-room, dragon-room, cornell-box), a fifth of that of pixels drawn evenly.
const NOISE_SHARE: f32 = 2.0 / 3.0;
/// Share of the noise that a picture's two halves tell that is surely in its error. Samples of both together are spread better than
/// those of either: in corners of boxes, after some twenty passes, that noise was 1.3 to 1.4 times all of the error.
const NOISE_SURE: f64 = 0.4;

/// Share of the time that measuring a looked-up picture takes, in whole percent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct MeasuringShare(u8);

impl MeasuringShare {
    /// Least and most, percent: below, nothing would be known of a picture; above, nothing be left for drawing it.
    pub const PERCENTS: std::ops::RangeInclusive<u8> = 1..=50;

    /// `None` outside of [`MeasuringShare::PERCENTS`].
    pub fn of_percent(percent: u8) -> Option<MeasuringShare> {
        Self::PERCENTS.contains(&percent).then_some(MeasuringShare(percent))
    }

    /// As a share of all rays.
    pub(super) fn of_rays(self) -> f64 {
        RAYS_FOR_TIME * 0.01 * f64::from(self.0)
    }
}

impl Default for MeasuringShare {
    /// 5 %.
    fn default() -> MeasuringShare {
        MeasuringShare(5)
    }
}

/// Measures one picture.
#[derive(Debug)]
pub(super) struct Measuring {
    gauge: Gauge,
    share: MeasuringShare,
    /// Rays that had been spent when the picture came near what is asked for, if it has: to find out whether it is there is part of
    /// the job.
    near_since: Option<u64>,
    /// Rays that were due beside its share while pictures before were near.
    near_rays: u64,
    rays: u64,
    /// Rays that it may take beside its share, because its doubt is all that keeps a picture from being done.
    granted: u64,
    samples_enough: u32,
    /// The first of the sets of pixels that were taken after the picture first seemed as good as asked for.
    fresh_from: Option<usize>,
    /// Where error is expected, and the film's passes when it was found.
    expected: (u32, Vec<f32>),
    /// relMSE that the looked-up film had by its noise when that was last found, at the lower end, times the square of its passes: well
    /// spread samples take off more than one over their number, never more than this. Nothing while that is not known.
    sure_noise: f64,
    /// What path tracing cannot find.
    pub(super) hidden: Option<HiddenHalves>,
}

impl Measuring {
    pub(super) fn new(
        settings: PathSettings,
        size: PictureSize,
        share: MeasuringShare,
        hidden: Option<HiddenHalves>,
    ) -> Measuring {
        Measuring {
            gauge: Gauge::new(settings, size),
            share,
            near_since: None,
            near_rays: 0,
            rays: 0,
            granted: 0,
            samples_enough: SAMPLES_ENOUGH[0],
            fresh_from: None,
            expected: (0, Vec::new()),
            sure_noise: 0.0,
            hidden,
        }
    }

    /// Pixels are traced as a card draws from now on: by the noise of the one it is judged what the other is worth.
    #[cfg(feature = "gpu")]
    pub(super) fn go_without_openings(&mut self) {
        self.gauge.go_without_openings();
    }

    /// What a path-traced sample costs and how noisy it is; `None` while too little is known.
    pub(super) fn cost(&self) -> Option<SampleCost> {
        self.gauge.cost()
    }

    /// Traced so far.
    pub(super) fn rays(&self) -> u64 {
        self.rays
    }

    /// The looked-up film surely has this noise, as relMSE, over so many passes.
    pub(super) fn note_noise(&mut self, rel_mse: f64, passes: u32) {
        self.sure_noise = rel_mse * f64::from(passes).powi(2);
    }

    /// Lets it take so many more rays than its share.
    pub(super) fn grant(&mut self, rays: u64) {
        self.granted += rays;
    }

    /// Whether further samples go to the pixels there are, or to more of them.
    pub(super) fn choose_pixels_or_samples(&mut self, image: &[Rgb], size: PictureSize) {
        let [least, most] = SAMPLES_ENOUGH;
        let pixels = self.gauge.pixels();
        let lacks_fresh = self.lacks_fresh_pixels(size);
        if !lacks_fresh {
            self.gauge.trace_from(0);
        }
        let lacking = lacking(image, size, &pixels);
        // Not by whether the mean is low: pixels that read low by chance would be taken again, and those that read high kept.
        if lacking != Lacking::Pixels && !lacks_fresh {
            let mean = image.iter().map(|colour| f64::from(colour.mean())).sum::<f64>() / image.len() as f64;
            self.gauge.concentrate(0.01 * mean * mean);
        }
        let enough = |pixels_enough: usize| pixels.len() >= pixels_enough.min(size.pixel_count() / 2);
        let is_wide = lacks_fresh
            || match lacking {
                Lacking::Pixels => true,
                Lacking::Samples => self.gauge.samples_max() >= SAMPLES_NARROW && !enough(PIXELS_LEAST),
                Lacking::Both => !enough(PIXELS_ENOUGH),
            };
        self.samples_enough = if is_wide { self.gauge.samples_max().clamp(least, most) } else { most };
    }

    /// The picture seems as good as asked for: from now on pixels are taken that had no say in that.
    pub(super) fn take_fresh_pixels(&mut self) {
        if self.fresh_from.is_none() {
            let [least, most] = SAMPLES_ENOUGH;
            self.fresh_from = Some(self.gauge.set_count());
            self.gauge.trace_from(self.gauge.set_count());
            self.samples_enough = self.gauge.samples_max().clamp(least, most);
        }
    }

    /// Something else is asked for.
    pub(super) fn forget_fresh_pixels(&mut self) {
        self.fresh_from = None;
        self.gauge.trace_from(0);
    }

    fn lacks_fresh_pixels(&self, size: PictureSize) -> bool {
        let lacks = |first: usize| self.gauge.pixels_since(first).len() < fresh_pixels(size);
        !self.gauge.is_full() && self.fresh_from.is_some_and(lacks)
    }

    /// Rays until it is found out by fresh pixels whether the picture is as good as asked for, once it seems so: about, for they may also
    /// say that it is not.
    ///
    /// - `rays_spent`: on all so far
    pub(super) fn rays_to_agree(&self, size: PictureSize, rays_spent: f64) -> f64 {
        let of_sample = self.gauge.cost().map_or(0.0, |cost| cost.rays);
        let known = self.fresh_from.map_or(0, |first| self.gauge.pixels_since(first).len());
        let samples = 2 * self.gauge.samples_max() as usize * fresh_pixels(size).saturating_sub(known);
        // As much is drawn meanwhile, and it is looked at when the picture is decided on again.
        (2.0 * of_sample * samples as f64).max(0.5 * DECIDED_GROWTH * rays_spent)
    }

    /// Fresh pixels find the picture as good as asked for. A gauge that takes no more of them has so many that no look at all of
    /// them is a lucky one.
    pub(super) fn fresh_pixels_agree(&self, picture: &Picture<'_>, target: f64) -> bool {
        let Some(first) = self.fresh_from else { return false };
        if self.gauge.is_full() {
            return true;
        }
        let fresh = self.gauge.pixels_since(first);
        !self.lacks_fresh_pixels(picture.size())
            && measure_at(&picture.radiance(), picture.size(), &fresh, 0.0).is_some_and(|found| {
                // What is hardly more than nothing by chance is told as little: that is no agreement.
                let is_known = found.interval_95[0] > 0.0;
                found.error() * if is_known { 1.0 } else { UNKNOWN_FACTOR } <= target
            })
    }

    /// What it was granted and has not taken is taken back.
    pub(super) fn forget_grants(&mut self, rays_spent: u64) {
        self.granted = self.granted.min(self.rays.saturating_sub(self.of_share(rays_spent)));
    }

    /// It has not taken what it may.
    pub(super) fn is_owed(&self, rays_spent: u64) -> bool {
        self.rays < self.due(rays_spent)
    }

    fn due(&self, rays_spent: u64) -> u64 {
        self.of_share(rays_spent) + self.granted
    }

    fn of_share(&self, rays_spent: u64) -> u64 {
        (self.share.of_rays() * rays_spent as f64) as u64 + self.near_rays + self.of_nearness(rays_spent)
    }

    /// What is due beside its share since the picture came near.
    fn of_nearness(&self, rays_spent: u64) -> u64 {
        let more = (NEAR_SHARE.of_rays() - self.share.of_rays()).max(0.0);
        self.near_since.map_or(0, |since| (more * rays_spent.saturating_sub(since) as f64) as u64)
    }

    /// From now on the picture is, or is not, one that may soon be as good as asked for.
    pub(super) fn set_near(&mut self, is_near: bool, rays_spent: u64) {
        if !is_near {
            self.near_rays += self.of_nearness(rays_spent);
            self.near_since = None;
        } else if self.near_since.is_none() {
            self.near_since = Some(rays_spent);
        }
    }

    /// Share of the rays that it takes at present.
    pub(super) fn share_of_rays(&self) -> f64 {
        let share = self.share.of_rays();
        if self.near_since.is_some() { share.max(NEAR_SHARE.of_rays()) } else { share }
    }

    /// Measures until its share of `rays_spent`, and what it was granted, is used up.
    ///
    /// - `film`: of looked-up light
    pub(super) fn keep_up(
        &mut self,
        (world, view, guide): (&World, &View, Option<&Guide>),
        film: &Film,
        rays_spent: u64,
        cancel: &AtomicBool,
    ) -> Counts {
        let mut all = Counts::default();
        let due = self.due(rays_spent);
        let is_due = |rays: u64| rays < due;
        while is_due(self.rays) {
            if let Some(hidden) = self.hidden.as_mut().filter(|hidden| hidden.is_due()) {
                let progress = hidden.renew(world, cancel);
                self.rays += progress.counts.all_rays();
                all += progress.counts;
                if !progress.complete {
                    return all;
                }
                continue;
            }
            // Looked for anew when the film has twice the passes: it takes a look at every pixel.
            if self.expected.1.is_empty() || film.passes_min() >= 2 * self.expected.0 {
                self.expected = (film.passes_min(), expected_error(film));
            }
            let maps = self.hidden.as_ref().map_or([None, None], HiddenHalves::maps);
            let expected = &self.expected.1;
            let counts = self.gauge.step((world, view), self.samples_enough, expected, maps, guide, cancel);
            if counts == Counts::default() {
                return all;
            }
            if let Some(hidden) = &mut self.hidden {
                hidden.measured(counts.all_rays());
            }
            self.rays += counts.all_rays();
            all += counts;
        }
        all
    }

    /// Measures as long as another did, choosing between more pixels and more samples as often as that would while a picture is drawn.
    pub(super) fn repeat(
        &mut self,
        other: &Measuring,
        of: (&World, &View, Option<&Guide>),
        (film, image): (&Film, &[Rgb]),
    ) {
        let never = AtomicBool::new(false);
        self.sure_noise = other.sure_noise;
        while self.rays < other.rays {
            let next = (self.rays as f64 * (1.0 + DECIDED_GROWTH)) as u64 + 1;
            self.granted = next.min(other.rays);
            if self.keep_up(of, film, 0, &never) == Counts::default() {
                break;
            }
            self.choose_pixels_or_samples(image, film.size());
        }
    }

    /// relMSE that a picture surely has: its noise, as far as nothing else is in it than looked-up light. It is known from all of its
    /// pixels, and much better than few of them tell.
    fn least_of(&self, picture: &Picture<'_>, film: &Film) -> f64 {
        let is_blend = picture.traced_share() > 0.0;
        if is_blend {
            0.0
        } else {
            NOISE_SURE * picture.noise_left() * self.sure_noise / f64::from(film.passes_min().max(1)).powi(2)
        }
    }

    /// Its pixels have the samples that it takes to believe them.
    pub(super) fn is_believed(&self) -> bool {
        self.gauge.samples() >= SAMPLES_BELIEVED
    }

    /// The error of a picture of the view; `None` while too little is known.
    ///
    /// - `film`: the looked-up film in it
    pub(super) fn error_of(&self, picture: &Picture<'_>, film: &Film) -> Option<MeasuredError> {
        if !self.is_believed() {
            return None;
        }
        let radiance = picture.radiance();
        // Nothing is seen, and nothing found where there might be something.
        if radiance.iter().all(|colour| colour.is_black()) {
            let is_black = self.gauge.is_black() && film.passes_min() >= BLACK_PASSES;
            return is_black.then_some(MeasuredError::NONE);
        }
        let least = self.least_of(picture, film);
        let error = measure_at(&radiance, picture.size(), &self.gauge.pixels(), least)?;
        // No difference at any of the pixels says nothing of the others, unless none of them has any noise.
        let says_nothing =
            error.interval_95 == [0.0; 2] && film.noise().is_none_or(|(noise, _)| noise.rel_mse > 0.0);
        (!says_nothing).then_some(error)
    }
}

/// Fresh pixels that are asked: a mean of fewer than two has no spread.
fn fresh_pixels(size: PictureSize) -> usize {
    FRESH_PIXELS.min(size.pixel_count() / 2).max(2)
}

/// Where a film of looked-up light may be wrong or is hard to know, as a chance for each pixel: by its noise, and where there are
/// caustics, whose shapes are blurred, and at edges, in corners and beneath things, where what is known of the light changes
/// within less than it resolves.
///
/// Both are relative to what is shown, as the error is, and smoothed: of few samples the variance is itself hardly known. Each has
/// a fixed part of the chance, however large it is: when one says nothing of where the error is, the other's part of the pixels is
/// still drawn well. And of edges it is told how sharp they are, not how much brighter the other side is: beside a
/// bright wall what is black, and has no error, would else be drawn more often than all the rest.
fn expected_error(film: &Film) -> Vec<f32> {
    let shown: Vec<f32> = film.radiance().iter().map(|colour| colour.luminance()).collect();
    let mean = shown.iter().sum::<f32>() / shown.len() as f32;
    let floor = 0.01 * mean * mean;
    let (caustics, variance) = (film.layer(PathClass::Caustic), film.variance());
    // What its samples spread by is what path tracing will not know of it, too.
    let spread = 1.0 + film.passes_min() as f32 / SAMPLES_ENOUGH[0] as f32;
    let width = film.size().width() as usize;
    let relative = |index: usize, value: f32| {
        let scale = shown[index].powi(2) + floor;
        let relative = value / scale;
        if relative >= 0.0 { relative.min(f32::MAX / shown.len() as f32) } else { 0.0 }
    };
    let noise = (0..shown.len()).map(|index| relative(index, spread * variance[index])).collect();
    let shapes = (0..shown.len())
        .map(|index| {
            relative(index, caustics[index].luminance().powi(2)) + sharpness(&shown, width, index, floor)
        })
        .collect();
    let [noise, shapes] = [noise, shapes].map(|expected: Vec<f32>| {
        let smooth = smoothed(&expected, width);
        let sum: f32 = smooth.iter().sum();
        smooth.into_iter().map(move |value| if sum > 0.0 { value / sum } else { 0.0 })
    });
    noise.zip(shapes).map(|(noise, shape)| NOISE_SHARE * noise + (1.0 - NOISE_SHARE) * shape).collect()
}

/// Mean squared difference of a pixel's luminance from those next to it, each over the sum of the two's squares; nothing where the
/// pixel is black.
fn sharpness(shown: &[f32], width: usize, index: usize, floor: f32) -> f32 {
    let own = f64::from(shown[index]);
    if own <= 0.0 {
        return 0.0;
    }
    let others = around(index, width, shown.len() / width, [[0, 1], [2, 1], [1, 0], [1, 2]]);
    let squares = others.map(|other| {
        let other = f64::from(shown[other]);
        (other - own).powi(2) / (other * other + own * own + f64::from(floor))
    });
    let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
    (sum / f64::max(count, 1.0)) as f32
}

/// Half of each pixel's value, and half of the mean of the 3 × 3 pixels around.
fn smoothed(values: &[f32], width: usize) -> Vec<f32> {
    let square: [[usize; 2]; 9] = std::array::from_fn(|place| [place % 3, place / 3]);
    (0..values.len())
        .into_par_iter()
        .map(|index| {
            let near = around(index, width, values.len() / width, square);
            let (sum, count) = near.fold((0.0, 0.0), |(sum, count), near| (sum + values[near], count + 1.0));
            0.5 * (values[index] + sum / count)
        })
        .collect()
}

/// Pixels at some steps from one, columns and rows, each one too many; without those beyond the border.
fn around<const N: usize>(
    index: usize,
    width: usize,
    height: usize,
    steps: [[usize; 2]; N],
) -> impl Iterator<Item = usize> {
    let (x, y) = (index % width, index / width);
    let at = move |[across, down]: [usize; 2]| {
        let (x, y) = ((x + across).checked_sub(1)?, (y + down).checked_sub(1)?);
        (x < width && y < height).then_some(y * width + x)
    };
    steps.into_iter().filter_map(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shares that would leave nothing known, or nothing drawn, are refused.
    #[test]
    fn the_share_of_measuring_is_bounded() {
        assert_eq!([0, 51, 255].map(MeasuringShare::of_percent), [None; 3]);
        assert_eq!(MeasuringShare::of_percent(5), Some(MeasuringShare::default()));
        assert!((MeasuringShare::default().of_rays() - 0.03).abs() < 1e-12);
    }

    /// Measuring takes its share of the time, and a fifth once the picture may soon be good enough.
    #[test]
    fn measuring_takes_more_near_the_target() {
        let size = PictureSize::new(8, 8).unwrap();
        let of = |percent| {
            let share = MeasuringShare::of_percent(percent).unwrap();
            Measuring::new(PathSettings::all(None, 0), size, share, None)
        };
        for (percent, near) in [(5, 120_000), (50, 300_000)] {
            let mut measuring = of(percent);
            let usual = u64::from(percent) * 6_000;
            assert_eq!(measuring.due(1_000_000), usual);
            measuring.set_near(true, 1_000_000);
            assert_eq!(measuring.due(1_000_000), usual, "only from now on");
            assert_eq!(measuring.due(2_000_000), usual + near);
            measuring.set_near(true, 1_500_000);
            measuring.set_near(false, 2_000_000);
            assert_eq!(measuring.due(3_000_000), 2 * usual + near, "what was taken is not held against it");
        }
    }

    /// A pixel at an edge is expected to be wrong, on either side; evenly lit ones and black ones are not.
    #[test]
    fn edges_are_where_error_is_expected() {
        let shown = [1.0, 1.0, 0.1, 0.1, 1.0, 1.0, 0.1, 0.1];
        let of = |index| sharpness(&shown, 4, index, 0.0);
        assert_eq!((of(0), of(3)), (0.0, 0.0));
        assert!(of(1) > 0.1 && (of(1) - of(2)).abs() < 1e-6);
        assert_eq!(sharpness(&[1.0], 1, 0, 0.0), 0.0);
        // Black beside bright.
        assert!(sharpness(&[1.0, 0.0], 2, 1, 0.0) == 0.0 && sharpness(&[1.0, 0.0], 2, 0, 0.0) == 1.0);
        assert_eq!(smoothed(&[9.0, 0.0, 0.0, 0.0], 4), [0.5 * 13.5, 1.5, 0.0, 0.0]);
    }
}
