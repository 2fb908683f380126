//! Who draws next, where what is drawn is looked up in what was learnt.
//!
//! What is measured of the picture (`measuring.rs`) also tells what a path-traced sample costs and how noisy it is, which with the noise of
//! the looked-up film says what one more sample of either kind would take off the error of the blend ([`Picture`]): with e² the squared
//! error of the looked-up film and v / n that of n path-traced samples, the blend's inverse is 1/e² + n/v.

use super::{
    measuring::{DECIDED_GROWTH, Measuring},
    noises::{FilmNoise, looked_up_share},
    remaining::noise_gain,
};
use crate::film::{Film, MeasuredError, Picture};

/// Share of the noise of records that is surely left where their light is shown: some four answer for each pixel.
const LIGHT_NOISE_SURE: f64 = 0.25;
/// Path-traced passes from which on a further one takes off more than the mean of those before it did.
const TRACED_TELLING: f64 = 8.0;
/// Share of the work that path tracing may have while more is learnt, however much better it is: the rest costs it a twentieth of its error,
/// and without, what is learnt of a picture of a few pixels was never known.
const TRACED_SHARE_MAX: f64 = 0.9;
/// Times as much as path tracing would have left, from which on no round of photons goes before it: trees in the sun were off by 6.0 % for 4.5
/// after 15 s where all did.
const FAR_BEHIND: f64 = 2.0;
/// Share of its noise in the error of a picture below which more samples of it change nothing.
const NOISE_NEGLIGIBLE: f64 = 0.02;

/// Whose turn it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Turn {
    /// The film drawn with what was learnt.
    LookedUp,
    /// The path-traced film.
    Traced,
}

/// What a picture took by what it went into: seconds, or rays where no clock may decide. A pass that looks light up takes longer than its
/// rays say, and so does learning: among leaves in the sun a path-traced pass took two thirds of the time of one that looks up.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Work {
    /// All of it, learning included.
    pub(super) all: f64,
    pub(super) looked_up: f64,
    pub(super) traced: f64,
    /// Of the error.
    pub(super) measured: f64,
}

/// Passes of one film, and what was spent on them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Spent {
    pub(super) passes: u32,
    pub(super) rays: u64,
    /// As [`Work`] counts it.
    pub(super) work: f64,
}

/// A pass of a film.
#[derive(Clone, Copy, Debug)]
struct PassCost {
    rays: f64,
    /// As [`Work`] counts it.
    work: f64,
}

impl Spent {
    fn of_a_pass(self) -> PassCost {
        let passes = f64::from(self.passes.max(1));
        PassCost { rays: self.rays as f64 / passes, work: self.work / passes }
    }
}

impl PassCost {
    /// What is divided by.
    fn some_work(self) -> f64 {
        self.work.max(f64::MIN_POSITIVE)
    }
}

/// What a picture of looked-up light is short of, as relMSE.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shortfall {
    /// What further samples take off.
    pub(super) noise: f64,
    /// What only knowing the light better takes off.
    pub(super) floor: f64,
    /// What it surely takes off: the measure may have met the few pixels that are wrong.
    pub(super) sure_floor: f64,
    /// What learning surely takes off, whatever of it the measure has met; see [`Outlook::light_noise`].
    pub(super) light_noise: f64,
}

impl Shortfall {
    /// Work on learning for each on drawing with which both take off as much: noise and what is not known both fall about as
    /// one over the work that went into them. More than half of it goes into learning as far as that surely is the larger error, and where it
    /// only seems to be, by the root of how much larger: the measure meets few of the pixels that are wrong, and by halves Sponza's records
    /// were a fifth made after 10 s where pictures had more samples than any of them needed.
    pub(super) fn learning_share(&self) -> f64 {
        let noise = self.noise.max(f64::MIN_POSITIVE);
        let share = self.floor.max(self.light_noise) / noise;
        let sure_share = self.sure_floor.max(self.light_noise) / noise;
        let most = sure_share.max(share.sqrt()).max(1.0);
        share.min(most)
    }
}

/// Shares of the noise of both films that are not in their worst pixels.
///
/// A lamp mirrored in wet ground, or a caustic, is rarely met and a thousand times as bright as what is around. Both films have such specks
/// alike, by chance one many more than the other, and one of them can be all of its noise: path tracing seems the better of the two then, since
/// by such noise there is nothing to learn, and had nearly all of 5 s of a street at night: off by 22 % without the worst pixels for 16 by records,
/// with specks as before.
#[derive(Clone, Copy, Debug)]
struct Unspeckled {
    looked_up: f64,
    traced: f64,
}

impl Unspeckled {
    /// All pixels count.
    const ALL: Unspeckled = Unspeckled { looked_up: 1.0, traced: 1.0 };

    /// Of the noise of a film.
    fn share(noise: &MeasuredError) -> f64 {
        let trimmed = noise.trimmed.filter(|trimmed| *trimmed < noise.rel_mse);
        trimmed.map_or(1.0, |trimmed| trimmed / noise.rel_mse)
    }
}

/// What was last found of the films.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outlook {
    /// Samples a pixel of both when it was found.
    samples: u32,
    /// Of the looked-up picture, and relMSE that its film had by chance before some of it was taken off.
    noise: FilmNoise,
    film_noise: f64,
    /// relMSE of all of it, and the lower end of its interval. What is not noise no sample lowers, but for what was blurred because of
    /// noise: to take that for what is not known learns more and sooner, and pictures are better for it (cornell-glossy at 2 s: 6.5 % for
    /// 8.4 with a quarter of the noise taken off counted as noise).
    error: f64,
    sure_error: f64,
    /// relMSE that the picture surely has by chance in what is looked up: no more than all of it.
    light_noise: f64,
    /// relMSE of a single path-traced pass, and how many there are.
    variance: f64,
    traced_passes: u32,
    unspeckled: Unspeckled,
    /// Of either film.
    looked_up: PassCost,
    traced: PassCost,
}

impl Outlook {
    /// `None` while too little is known.
    ///
    /// - `picture`, `traced`: of looked-up light, and path-traced
    /// - `light_noise`: of what is looked up; see [`crate::technique::SecondaryLight::noise`]
    /// - `work_a_ray`: of measuring
    pub(super) fn of(
        (picture, spent, light_noise): (&Picture<'_>, Spent, f64),
        traced: Option<(&Film, Spent)>,
        (measuring, work_a_ray): (&mut Measuring, f64),
    ) -> Option<Outlook> {
        let cost = measuring.cost()?;
        let film = picture.film();
        let (noise, passes) = film.noise()?;
        measuring.note_noise(noise.interval_95[0], passes);
        let film_noise = noise.rel_mse;
        let looked_up_share = looked_up_share(film);
        let by_gauge = measuring.error_of(picture, film)?;
        let by_tracing =
            traced.and_then(|(traced, _)| picture.clone().blended(traced).measured_error_of_film());
        let measured = by_tracing.map_or(by_gauge, |error| by_gauge.surer(error));
        let (error, [sure_error, _]) = (measured.rel_mse, measured.interval_95);
        let pixel_count = film.size().pixel_count() as f64;
        let has_passes = |(_, spent): &(&Film, Spent)| spent.passes > 0;
        let traced_pass = traced.filter(has_passes).map_or_else(
            || {
                let rays = cost.rays * pixel_count;
                PassCost { rays, work: work_a_ray * rays }
            },
            |(_, spent)| spent.of_a_pass(),
        );
        // Passes are spread better over what there is to see than samples drawn one by one: their own noise is known best, once there are
        // some. That of two, weighed by what they show, was ten times what it became in dark corners between seats.
        let known = traced.and_then(|(film, _)| film.noise());
        let telling = known.filter(|(_, passes)| f64::from(*passes) >= TRACED_TELLING);
        let variance = telling.map_or(cost.variance, |(noise, passes)| noise.rel_mse * f64::from(passes));
        let unspeckled = Unspeckled {
            looked_up: Unspeckled::share(&noise),
            // The few pixels that are measured mostly have none.
            traced: telling.map_or(1.0, |(noise, _)| Unspeckled::share(&noise)),
        };
        measuring.choose_pixels_or_samples(&picture.radiance(), film.size());
        Some(Outlook {
            samples: spent.passes + traced.map_or(0, |(_, spent)| spent.passes),
            noise: FilmNoise::of(film, (picture.noise_left() * film_noise, passes), looked_up_share),
            film_noise,
            error,
            sure_error,
            light_noise: (LIGHT_NOISE_SURE * looked_up_share * light_noise).min(error),
            variance,
            traced_passes: traced.map_or(0, |(_, spent)| spent.passes),
            unspeckled,
            looked_up: spent.of_a_pass(),
            traced: traced_pass,
        })
    }

    /// What the film of looked-up light is short of.
    pub(super) fn shortfall(&self) -> Shortfall {
        self.shortfall_beside(self.noise.now())
    }

    /// Work on learning for each on drawing. What is drawn meanwhile is replaced when more is known, so that noise counts as if all passes had been
    /// drawn with what is known now, and what there is beyond as what is not known.
    pub(super) fn learning_share(&self) -> f64 {
        self.shortfall_beside(self.noise.had_all_been_fresh()).learning_share()
    }

    fn shortfall_beside(&self, noise: f64) -> Shortfall {
        Shortfall {
            noise,
            floor: (self.error - noise).max(0.0),
            sure_floor: (self.sure_error - noise).max(0.0),
            light_noise: self.light_noise,
        }
    }

    /// The films as they were when it was found.
    pub(super) fn films(&self) -> Films {
        Films { looked_up: self.noise.passes(), traced: f64::from(self.traced_passes) }
    }

    /// It is old.
    pub(super) fn is_due(&self, samples: u32) -> bool {
        f64::from(samples) > (1.0 + DECIDED_GROWTH) * f64::from(self.samples)
    }

    /// Further samples of the looked-up film would change next to nothing.
    pub(super) fn is_at_its_floor(&self) -> bool {
        self.film_noise < NOISE_NEGLIGIBLE * self.film_noise.max(self.error)
    }

    /// Path tracing is the better of the two by all pixels, and without the worst.
    fn is_agreed(&self, is_for_tracing: impl Fn(Unspeckled) -> bool) -> bool {
        [Unspeckled::ALL, self.unspeckled].into_iter().all(is_for_tracing)
    }

    /// Whose next pass takes more off the error of the blend for the work that it is.
    pub(super) fn turn(&self) -> Turn {
        let noise = [self.noise.now(), self.noise.fall_after(0.0)];
        if self.falls_more_by_tracing(1.0, noise, 1.0) { Turn::Traced } else { Turn::LookedUp }
    }

    /// A path-traced pass takes more off the error of the blend than one of looked-up light, for the work that it is.
    ///
    /// - `unlearnt`: as for [`Films::error`]
    /// - `noise`: of the film of looked-up light, relMSE, and what a pass takes off that
    /// - `worth`: what a path-traced pass is worth, in those that there were when it was found
    fn falls_more_by_tracing(&self, unlearnt: f64, [noise, fall]: [f64; 2], worth: f64) -> bool {
        self.is_agreed(|share_of| {
            // The few pixels that are measured mostly have no speck: beside all noise nothing would be left of what is not known.
            let floor = unlearnt * self.shortfall_beside(self.noise.now() * share_of.looked_up).floor;
            let own = (floor + noise * share_of.looked_up).max(f64::MIN_POSITIVE);
            let by_looking_up = fall * share_of.looked_up / own / own / self.looked_up.some_work();
            let variance = self.variance * share_of.traced;
            let by_tracing = worth / (variance * self.traced.work).max(f64::MIN_POSITIVE);
            by_tracing >= by_looking_up
        })
    }

    /// While more is learnt, path tracing is due: it would have left less, with all the work so far, than the film of what is learnt so far has
    /// left with as much, and it has not had its share. What is learnt makes the picture better by nobody knows how much, so that this is
    /// half of the work, and more by as many times as path tracing surely is better; but learning comes to its end. What is measured beside a speck
    /// may be another one: as long as more is learnt only what is beyond all noise counts as not known.
    pub(super) fn is_for_tracing(&self, done: &Work) -> bool {
        let Shortfall { floor, sure_floor, .. } = self.shortfall();
        let left_of_all = self.left_by_tracing(done.all);
        // Had it all been drawn with what is learnt by now.
        let noise_of_all =
            self.noise.had_all_been_fresh() * (done.looked_up / done.all.max(f64::MIN_POSITIVE)).min(1.0);
        self.is_agreed(|share_of| {
            let left = left_of_all * share_of.traced;
            let noise = noise_of_all * share_of.looked_up;
            let sure = sure_floor + noise;
            let share = (sure / (sure + left)).clamp(0.5, TRACED_SHARE_MAX);
            floor + noise > left && done.traced < share * done.all
        })
    }

    /// Path tracing is surely so far ahead that a round of photons, which would have to go first to end in time, may rather not.
    ///
    /// - `done`: so far
    pub(super) fn is_far_behind(&self, done: &Work) -> bool {
        self.shortfall().sure_floor > FAR_BEHIND * self.left_by_tracing(done.all)
    }

    /// relMSE that path tracing would have left with all the work so far.
    ///
    /// - `work`: so far, as [`Work`] counts it
    fn left_by_tracing(&self, work: f64) -> f64 {
        let traced = work / self.traced.some_work();
        let passes = Films { traced, ..self.films() }.traced_alike(self);
        self.variance / passes.max(f64::MIN_POSITIVE)
    }
}

/// Passes of two films, as they may come to be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Films {
    looked_up: f64,
    traced: f64,
}

impl Films {
    /// Of both.
    pub(super) fn passes(&self) -> f64 {
        self.looked_up + self.traced
    }

    /// relMSE of the blend.
    ///
    /// - `unlearnt`: share of what only knowing the light better takes off that is left
    pub(super) fn error(&self, outlook: &Outlook, unlearnt: f64) -> f64 {
        let own = self.own_error(outlook, unlearnt).max(f64::MIN_POSITIVE);
        1.0 / (1.0 / own + self.traced_alike(outlook) / outlook.variance.max(f64::MIN_POSITIVE))
    }

    fn own_error(&self, outlook: &Outlook, unlearnt: f64) -> f64 {
        unlearnt * outlook.shortfall().floor + self.noise(outlook)
    }

    /// Of the film of looked-up light.
    fn noise(&self, outlook: &Outlook) -> f64 {
        outlook.noise.after(self.more(outlook))
    }

    /// Looked-up passes beyond those that there were when it was found.
    fn more(&self, outlook: &Outlook) -> f64 {
        self.looked_up - outlook.noise.passes()
    }

    /// Path-traced passes of which each is worth as much as those that there were when it was found.
    fn traced_alike(&self, outlook: &Outlook) -> f64 {
        let found = f64::from(outlook.traced_passes).max(TRACED_TELLING);
        found * noise_gain(self.traced / found)
    }

    /// Goes on by so many shares more of the passes of both, as while light is learnt.
    pub(super) fn go_on(&mut self, share: f64) {
        self.looked_up *= 1.0 + share;
        self.traced *= 1.0 + share;
    }

    /// Goes on by passes of whichever film takes more off for the work that it is, or of looked-up light alone; returns the rays.
    ///
    /// - `share`: of the passes there are, at least one
    /// - `unlearnt`: as for [`Films::error`]
    pub(super) fn advance(&mut self, outlook: &Outlook, share: f64, traces: bool, unlearnt: f64) -> f64 {
        let passes = (share * self.passes()).max(1.0);
        let noise = [self.noise(outlook), outlook.noise.fall_after(self.more(outlook))];
        let worth = self.traced_alike(outlook).max(1.0) / self.traced.max(1.0);
        if traces && outlook.falls_more_by_tracing(unlearnt, noise, worth) {
            self.traced += passes;
            passes * outlook.traced.rays.max(1.0)
        } else {
            self.looked_up += passes;
            passes * outlook.looked_up.rays.max(1.0)
        }
    }
}

#[cfg(test)]
impl Outlook {
    /// After 64 passes of looked-up light and none of path tracing, both of 10⁵ rays.
    ///
    /// - `variance`: of a path-traced pass
    pub(super) fn after_64_passes(noise: f64, floor: f64, variance: f64) -> Outlook {
        Outlook {
            samples: 64,
            noise: FilmNoise::after_64_passes(noise),
            film_noise: noise,
            error: noise + floor,
            sure_error: noise + floor,
            light_noise: 0.0,
            variance,
            traced_passes: 0,
            unspeckled: Unspeckled::ALL,
            looked_up: PassCost { rays: 1e5, work: 1e5 },
            traced: PassCost { rays: 1e5, work: 1e5 },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share(noise: f64, floor: f64, sure_floor: f64) -> f64 {
        Shortfall { noise, floor, sure_floor, light_noise: 0.0 }.learning_share()
    }

    /// What is known of records says how much there is to learn where the measure has not met it.
    #[test]
    fn known_noise_of_records_is_learnt_away() {
        let of = |light_noise| Shortfall { noise: 1e-3, floor: 1e-4, sure_floor: 0.0, light_noise };
        assert!((of(0.0).learning_share() - 0.1).abs() < 1e-12);
        assert!((of(3e-3).learning_share() - 3.0).abs() < 1e-12);
    }

    /// What is not known is learnt as far as it is the larger error; more than half of the work goes into it as far as that is sure, and by
    /// the root where it only seems so.
    #[test]
    fn more_than_half_is_learning_where_it_pays() {
        assert_eq!(share(1e-2, 1e-3, 0.0), 0.1);
        assert_eq!(share(1e-2, 1.0, 0.0), 10.0);
        assert!((share(1e-2, 9e-2, 0.0) - 3.0).abs() < 1e-12);
        assert!((share(1e-2, 9e-2, 5e-2) - 5.0).abs() < 1e-12);
        assert_eq!(share(1e-2, 0.0, 0.0), 0.0);
        assert_eq!(share(0.0, 0.0, 0.0), 0.0);
        assert!(share(0.0, 1.0, 1.0) > 1e100);
    }

    /// Path tracing would have done better where what samples do not lower is more than it would have left: also right after what is looked
    /// up was replaced, when the noise of what came since is large and most samples are from before.
    #[test]
    fn tracing_is_weighed_against_what_samples_do_not_lower() {
        let outlook = Outlook {
            samples: 19,
            noise: FilmNoise::after_two_fresh(0.038, 17.0),
            film_noise: 0.1,
            error: 0.045,
            sure_error: 0.022,
            light_noise: 0.0,
            variance: 0.31,
            traced_passes: 2,
            unspeckled: Unspeckled::ALL,
            looked_up: PassCost { rays: 8e4, work: 8e4 },
            traced: PassCost { rays: 1e5, work: 1e5 },
        };
        // 32 passes would leave 0.009.
        let done = |all| Work { all, ..Work::default() };
        assert!(outlook.is_for_tracing(&done(3.2e6)));
        assert!(!outlook.is_for_tracing(&done(4e5)), "four passes");
        let noisy = Outlook { error: 0.012, ..outlook };
        assert!(!noisy.is_for_tracing(&done(3.2e6)), "noise, half of it");
        // What looking up has left with all the work counts.
        let looked_up = |share: f64| Work { looked_up: share * 3.2e6, ..done(3.2e6) };
        assert!(noisy.is_for_tracing(&looked_up(1.0)) && !noisy.is_for_tracing(&looked_up(0.2)));
        assert_eq!(outlook.turn(), Turn::Traced);
        assert_eq!(Outlook { error: 0.005, ..outlook }.turn(), Turn::LookedUp);
        // Noise of the few samples of what is looked up now, beside path tracing that is better than what is known from all.
        let fresh = |noise: f64| Outlook {
            noise: FilmNoise::after_two_fresh(noise, 257.0),
            error: 0.0065,
            sure_error: 0.003,
            variance: 4.4,
            ..outlook
        };
        assert_eq!(fresh(0.03).turn(), Turn::LookedUp);
        assert_eq!(fresh(1e-4).turn(), Turn::Traced);
        // By what passes take, whatever rays they have.
        let slow = PassCost { work: 1e8, ..outlook.traced };
        assert_eq!(Outlook { traced: slow, ..outlook }.turn(), Turn::LookedUp);
        assert!(!Outlook { traced: slow, ..outlook }.is_for_tracing(&done(3.2e6)));
    }

    /// While more is learnt, path tracing has half of the work where both are as good, and three quarters where it surely is three times better.
    #[test]
    fn tracing_gets_as_much_as_it_is_ahead_by() {
        let done = |traced: f64| Work { all: 1e6, traced: traced * 1e6, ..Work::default() };
        // Ten passes of 10⁵, of which the first eight count as one over their number.
        let left = 1.0 / (8.0 * noise_gain(10.0 / 8.0));
        for (lead, sure, share) in [(1.01, 1.0, 0.5), (3.0, 1.0, 0.75), (3.0, 0.3, 0.5), (1e9, 1.0, 0.9)] {
            let outlook = Outlook::after_64_passes(1e-9, lead * left, 1.0);
            let outlook = Outlook { sure_error: sure * outlook.error, ..outlook };
            assert!(outlook.is_for_tracing(&done(share - 0.01)), "{lead}");
            assert!(!outlook.is_for_tracing(&done(share + 0.01)), "{lead}");
        }
        assert!(!Outlook::after_64_passes(1e-9, 0.99 * left, 1.0).is_for_tracing(&done(0.0)));
    }

    /// Specks that the films have by chance do not make path tracing the better of the two: it is where it is so with them and without.
    #[test]
    fn specks_do_not_make_tracing_better() {
        let done = Work { all: 1e6, looked_up: 1e6, ..Work::default() };
        let draws = |outlook: &Outlook| {
            let is_traced = outlook.turn() == Turn::Traced;
            let mut films = outlook.films();
            films.advance(outlook, 0.1, true, 1.0);
            assert_eq!(films.traced > outlook.films().traced, is_traced);
            [is_traced, outlook.is_for_tracing(&done)]
        };
        // The pixels that are measured have none. Of the noise of all they are nearly all in the one film, and half in the other.
        let of = |looked_up, traced| Outlook {
            unspeckled: Unspeckled { looked_up, traced },
            error: 0.05,
            sure_error: 0.05,
            ..Outlook::after_64_passes(5.0, 0.0, 8.0)
        };
        assert_eq!(draws(&of(1.0, 1.0)), [true; 2]);
        assert_eq!(draws(&of(0.01, 0.5)), [false; 2]);
        assert_eq!(draws(&of(0.5, 0.01)), [true; 2]);
        // What is not noise is left without specks, also where they are more than all that was measured.
        let hidden = Outlook { error: 0.4, sure_error: 0.4, ..of(0.01, 0.5) };
        assert_eq!(hidden.turn(), Turn::Traced);
        let biased = Outlook { error: 15.0, sure_error: 15.0, ..of(0.01, 0.5) };
        assert_eq!(draws(&biased), [true; 2]);
        let noisy = Outlook { variance: 1e9, ..of(0.5, 0.01) };
        assert_eq!(draws(&noisy), [false; 2]);
        // All of it is specks.
        assert_eq!(draws(&of(0.0, 0.0)), [true, false]);
    }

    /// The share of a film's noise that is not in its worst thousandth; all of it where that is not known.
    #[test]
    fn noise_without_specks_is_no_more_than_all() {
        let of = |rel_mse, trimmed| {
            Unspeckled::share(&MeasuredError { rel_mse, interval_95: [0.0, 1.0], trimmed })
        };
        assert_eq!([of(4.0, Some(1.0)), of(4.0, None), of(0.0, Some(0.0))], [0.25, 1.0, 1.0]);
        assert_eq!([of(1.0, Some(1.5)), of(1.0, Some(0.0))], [1.0, 0.0]);
    }
}
