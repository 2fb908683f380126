//! How far a picture is from the truth, how that is found out, and what is left to do until it is as good as asked for.

use std::sync::atomic::AtomicBool;

use super::{
    Indirect, Remaining, RenderSettings, Rendering, ToLearn, all_paths,
    chain::{Outlook, Spent, Work},
    hidden::{HiddenFor, HiddenHalves, HiddenLight},
    measuring::Measuring,
    own_picture,
    remaining::{self, Way},
};
use crate::{
    film::{MeasuredError, Picture},
    technique::{Progress, path::PathSettings},
};

/// An error that is measured this many times that asked for may in truth be that already, where it is known badly.
pub(super) const DOUBTED: f64 = 1.25;

/// An error that is measured this many times that asked for comes near it: measuring may then take more than its usual share of
/// the time ([`Rendering::aim_at`]), so that enough is known by the time the picture is good enough.
const NEAR: f64 = 2.0;

impl Rendering {
    /// The error of the picture, measured; `None` while it is unknown. Of path tracing, by what the two halves of its film
    /// differ; of looked-up light, by path tracing some pixels, or, once that knows better, by the path-traced film in it.
    /// Takes some tenths of a microsecond a pixel: ask a few times a second, not for every frame.
    pub fn measured_error(&self) -> Option<MeasuredError> {
        self.measured_error_of(&self.picture())
    }

    /// The same, of what [`Rendering::picture`] returned.
    pub fn measured_error_of(&self, picture: &Picture<'_>) -> Option<MeasuredError> {
        let Some(measuring) = &self.measuring else { return self.film.measured_error() };
        let by_either = [measuring.error_of(picture, &self.film), picture.measured_error()];
        by_either.into_iter().flatten().reduce(MeasuredError::surer)
    }

    /// The error of the picture as it would have been measured with other random numbers, at pixels and by as many rays as it was; `None`
    /// where its light is not looked up, and while it is unknown. Its pixels are drawn by what the picture now shows, where those before were
    /// drawn by what it showed then, and a path-traced film beside it has no say. For finding out how far such measures can be trusted.
    ///
    /// - `seed`: other than that of the picture
    pub fn measured_afresh(&self, seed: u64) -> Option<MeasuredError> {
        let measuring = self.measuring.as_ref()?;
        let all = all_paths(&self.settings);
        let settings = PathSettings { seed, knows_openings: self.is_guided(), ..all };
        let hidden = measuring.hidden.as_ref().map(|_| {
            let settings = RenderSettings { seed, ..self.settings };
            HiddenHalves::new(HiddenLight::new(&settings, (self.view, self.size()), HiddenFor::Measure))
        });
        let mut afresh = Measuring::new(settings, self.size(), self.settings.measuring, hidden);
        let image = self.own_picture().radiance();
        let guide = self.technique.guide().filter(|_| self.is_guided());
        afresh.repeat(measuring, (&self.world, &self.view, guide), (&self.film, &image));
        afresh.error_of(&self.picture(), &self.film)
    }

    /// What is left to do until the picture has an error (√relMSE); `None` where that cannot be told.
    ///
    /// - `measured`: its error now
    /// - `to_learn`: what others still learn of its light
    pub fn remaining(&self, measured: &MeasuredError, target: f64, to_learn: ToLearn) -> Option<Remaining> {
        let rays = self.spent_rays() as f64;
        let passes = f64::from(self.passes());
        let is_aimed_at = self.target.is_some_and(|own| (own - target).abs() < 1e-6);
        // What is asked for is there once other pixels say so too.
        let to_agree = match &self.measuring {
            Some(measuring) if is_aimed_at && !self.is_confirmed => {
                measuring.rays_to_agree(self.size(), rays)
            }
            _ => 0.0,
        };
        if measured.reaches(target) {
            let more = Remaining::Work { rays: to_agree, passes: passes * to_agree / rays.max(1.0) };
            return Some(if to_agree > 0.0 { more } else { Remaining::Nothing });
        }
        let to_learn = self.still_to_learn(to_learn);
        if to_learn == ToLearn::Nothing && self.is_at_its_best() {
            return Some(Remaining::OutOfReach { error: measured.error() });
        }
        if to_learn == ToLearn::Rounds {
            return None;
        }
        match &self.outlook {
            Some(outlook) => {
                let measuring_share = match &self.measuring {
                    Some(measuring) => measuring.share_of_rays(),
                    None => self.settings.measuring.of_rays(),
                };
                let traces = self.settings.indirect == Indirect::Auto;
                // What others learn is older than this picture; and what no path tracing takes on only learning can take off.
                let since = self.records_since.filter(|_| traces).map_or(rays, |since| since as f64);
                let way = Way {
                    outlook,
                    measured,
                    target,
                    rays,
                    measuring_share,
                    is_aimed_at,
                    to_agree,
                    traces,
                    learnt_since: (to_learn != ToLearn::Nothing).then_some(since),
                };
                way.remaining()
            }
            // Path tracing, and what is not known yet of looked-up light.
            None => remaining::as_noise(measured, target, rays, passes),
        }
    }

    /// What is still to be learnt of its light.
    ///
    /// - `by_others`: what others still learn of it
    pub(super) fn still_to_learn(&self, by_others: ToLearn) -> ToLearn {
        match &self.learner {
            // What does not end in time brings nothing more.
            Some(_) if self.is_late() => ToLearn::Nothing,
            Some(learner) => learner.to_learn(),
            None => by_others,
        }
    }

    /// The picture is to have this error (√relMSE), if any: whether it has is then found out with more than the usual share.
    pub fn aim_at(&mut self, target: Option<f64>) {
        if self.target != target {
            let spent = self.spent_rays();
            (self.target, self.is_doubted, self.is_confirmed) = (target, false, false);
            if let Some(measuring) = &mut self.measuring {
                measuring.forget_fresh_pixels();
                measuring.set_near(false, spent);
                measuring.forget_grants(spent);
            }
        }
    }

    /// Whether the picture surely has the error that it was last found to have reached: where that is measured at few pixels, others,
    /// taken since then, say so too. That is found out of the error that it is to have ([`Rendering::aim_at`]), and of no other.
    pub fn confirms(&self, target: f64) -> bool {
        self.measuring.is_none() || self.is_confirmed && self.target == Some(target)
    }

    /// Neither learning nor samples will make the error that is left noticeably smaller: it is the technique's own.
    pub fn is_at_its_best(&self) -> bool {
        let is_biased = matches!(self.settings.indirect, Indirect::Octree | Indirect::Irradiance);
        let is_cut = self.learner.as_ref().is_some_and(|learner| learner.is_cut());
        is_biased
            && !is_cut
            && self.knows_its_light()
            && self.outlook.is_some_and(|outlook| outlook.is_at_its_floor())
    }

    /// Light is looked up in what was learnt, and the error measured against path tracing of some pixels.
    pub fn is_looked_up(&self) -> bool {
        self.measuring.is_some()
    }

    /// Enough is measured for an error to be told, as far as that is asked of some pixels: [`Rendering::measured_error`] costs more.
    pub fn is_measured(&self) -> bool {
        self.measuring.as_ref().is_some_and(Measuring::is_believed)
    }

    /// Traces the pixels that tell the error as far as the rest of the work allows.
    pub(super) fn keep_measuring_up(&mut self, cancel: &AtomicBool) {
        let begun = self.begin();
        let is_guided = self.is_guided();
        let Some(measuring) = &mut self.measuring else { return };
        let guide = self.technique.guide().filter(|_| is_guided);
        let of = (&*self.world, &self.view, guide);
        let counts = measuring.keep_up(of, &self.film, begun.spent_rays, cancel);
        self.counts += counts;
        #[cfg(feature = "gpu")]
        self.note_cpu_work(counts.all_rays(), begun.start);
        let work = self.work_since(&begun);
        self.done.all += work;
        self.done.measured += work;
    }

    /// Keeps the measure of the error up with the rest of the work, and what comes next with that.
    pub(super) fn measure(&mut self, cancel: &AtomicBool) {
        self.keep_measuring_up(cancel);
        let makes_records =
            self.learner.as_ref().is_some_and(|learner| learner.to_learn() == ToLearn::Records);
        self.records_since = makes_records.then(|| self.records_since.unwrap_or_else(|| self.spent_rays()));
        let denoising = self.denoises();
        let Some(measuring) = &mut self.measuring else { return };
        let Work { looked_up, traced, measured, .. } = self.done;
        let looked_up = Spent { passes: self.film.passes_min(), rays: self.looked_up_rays, work: looked_up };
        let traced = self.traced.as_ref().map(|film| {
            let spent = Spent { passes: film.passes_min(), rays: self.traced_rays, work: traced };
            (film, spent)
        });
        let work_a_ray = measured / measuring.rays().max(1) as f64;
        let samples = looked_up.passes + traced.map_or(0, |(_, spent)| spent.passes);
        if self.outlook.is_none_or(|outlook| outlook.is_due(samples)) {
            let picture = own_picture(&self.film, denoising.as_ref());
            let light_noise = self.technique.secondary().map_or(0.0, |known| known.noise());
            self.outlook = Outlook::of((&picture, looked_up, light_noise), traced, (measuring, work_a_ray));
            self.share_found = self.outlook.map(|outlook| outlook.learning_share()).or(self.share_found);
            let measured = self.measured_error();
            self.confirm(measured.as_ref());
            let is_near = |target| measured.is_some_and(|measured| measured.error() <= NEAR * target);
            let is_near = self.target.is_some_and(is_near);
            self.is_doubted = self.is_doubtful(measured.as_ref());
            let spent = self.spent_rays();
            self.measuring.iter_mut().for_each(|measuring| measuring.set_near(is_near, spent));
            if let Some(measuring) = self.measuring.as_mut().filter(|_| !self.is_doubted) {
                measuring.forget_grants(spent);
            }
        }
    }

    /// Measures a picture that is done after its first pass, by the share of all work that is due to measuring: whoever waits for a first picture to
    /// be drawn on waits for nothing else.
    pub fn measure_first(&mut self, cancel: &AtomicBool) {
        self.measure(cancel);
    }

    /// Finds out whether the picture has the error asked for, where it seems so. What its own path-traced film says, which is a
    /// mean over all pixels, counts at once.
    fn confirm(&mut self, measured: Option<&MeasuredError>) {
        self.is_confirmed = false;
        let reached = self.target.filter(|target| measured.is_some_and(|measured| measured.reaches(*target)));
        let (Some(target), Some(measuring)) = (reached, &mut self.measuring) else { return };
        measuring.take_fresh_pixels();
        let picture = self.picture();
        // Where the picture and all that was found are black, there is nothing that other pixels could say.
        let is_right = measured == Some(&MeasuredError::NONE);
        let by_film = picture.measured_error().is_some_and(|measured| measured.reaches(target));
        let agree = |measuring: &Measuring| measuring.fresh_pixels_agree(&picture, target);
        self.is_confirmed = is_right || by_film || self.measuring.as_ref().is_some_and(agree);
    }

    /// Measures on where that was cut short before it had as much work as drawing; `None` when it has had that.
    pub(super) fn settle_doubt(&mut self, cancel: &AtomicBool) -> Option<Progress> {
        let spent = self.spent_rays();
        self.measuring.as_ref().filter(|measuring| self.is_doubted && measuring.is_owed(spent))?;
        let before = self.counts;
        self.measure(cancel);
        let counts = self.counts - before;
        (counts.all_rays() > 0).then_some(Progress { counts, complete: false })
    }

    /// The picture may be as good as asked for, and only the measure is too uncertain to say so: then measuring gets as much work
    /// as drawing.
    fn is_doubtful(&self, measured: Option<&MeasuredError>) -> bool {
        let Some(target) = self.target.filter(|_| self.knows_its_light()) else { return false };
        let is_settled = |measured: &MeasuredError| measured.reaches(target) && self.is_confirmed;
        measured.is_some_and(|measured| measured.error() <= DOUBTED * target && !is_settled(measured))
    }
}
