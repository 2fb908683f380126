//! The render thread of a scene: goes round its viewers and draws for the one that needs it most.
//!
//! A viewer whose camera, size or scene changed comes first and gets a quick pass at a size that fits the time; then its
//! picture climbs to full size and is refined, until its error is reached; then it rests and costs nothing. Refining
//! gives way to news, between tiles, and goes on where it stopped. While one viewer keeps moving, the others get slices
//! of time in between. All films live here; a stalled viewer's is left alone.

mod lit;
mod pictures;

use super::alarm::Alarm;
use super::card::SceneOnCard;
use super::foretold::Look;
use super::frames;
use super::ladder::{DIVISOR_MAX, Size, Speed, rungs, scaled};
use super::lighting::{LightKey, Lighting};
use super::memory::CountedMemory;
use super::request::{Drawing, Job};
use super::viewer::{Picture, Viewer, Wish};
use super::viewer_film::{Aim, FilmKey, Layer, Rest, Shown, Task, ViewerFilm, next_offer_after};
use super::{Scene, Snapshot, lock};
use crate::convert;
use lumicast_engine::film::PictureSize;
use lumicast_engine::render::{Learning, RenderSettings, Rendering};
use lumicast_engine::technique::caustics::CausticSketch;
use lumicast_protocol::{FrameHeader, PayloadCodec, PayloadKind, Problem, ProblemKind, View};
use std::collections::HashMap;
use std::sync::atomic::Ordering::SeqCst;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

/// Slice of a viewer that refines while others wait: long against the cost of a switch, short for the eye.
const SLICE_SECONDS: f64 = 0.1;
/// While the scene is on its way to the card, who rests looks whether it has come, or is still wanted.
const CARD_SECONDS: Duration = Duration::from_secs(1);
/// Share of the time between two changes that the first pass after the second may take, and so many times as long as while things move at
/// most: changes that come one by one are not to make the picture small each time.
const PASS_OF_PAUSE: f64 = 0.4;
const PASS_ALONE_MAX: f64 = 3.0;
/// A quick pass is cut at this multiple of its budget while things move and tried again smaller, now that the speed is known.
const OVERRUN: f64 = 5.0;

/// Draws for one scene.
#[derive(Debug)]
pub(super) struct Painter {
    scene: Arc<Scene>,
    films: HashMap<u64, ViewerFilm>,
    drawings: Vec<Drawing>,
    /// That were begun so far.
    drawing_count: u64,
    /// The next slice for any of them goes to who is due first.
    is_first_due_next: bool,
    /// Drawings that have yet to begin.
    jobs: Vec<Job>,
    /// What is known of the scene's light.
    lighting: Lighting,
    /// The scene on the graphics card.
    on_card: SceneOnCard,
    /// Its caustics for first pictures, by the bound on bounces, with the light revision that they are of: as many as viewers
    /// ask for.
    sketches: HashMap<Option<u32>, (u64, Arc<CausticSketch>)>,
    speed: Speed,
    /// Of quick passes alone: small pictures keep all cores busy less well than large ones.
    quick_speed: Speed,
    /// Who had the last slice, in the round of viewers and drawings.
    turn: usize,
    /// Time spent on drawing in the last round.
    drawn_seconds: f64,
    /// A quick pass of this viewer was drawn while others waited to refine: they are next, whatever news there is.
    slice_owed: Option<u64>,
    alarm: Alarm,
}

/// How a pass may end early.
#[derive(Debug, Clone, Copy)]
struct Cut {
    interruptible: bool,
    after: Option<Duration>,
}

impl Painter {
    pub(super) fn new(scene: Arc<Scene>) -> Painter {
        let alarm = Alarm::start(scene.clone());
        Painter {
            scene,
            films: HashMap::new(),
            drawings: Vec::new(),
            drawing_count: 0,
            is_first_due_next: false,
            jobs: Vec::new(),
            lighting: Lighting::default(),
            on_card: SceneOnCard::default(),
            sketches: HashMap::new(),
            speed: Speed::default(),
            quick_speed: Speed::default(),
            turn: 0,
            drawn_seconds: 0.0,
            slice_owed: None,
            alarm,
        }
    }

    /// Draws until the scene closes.
    pub(super) fn run(mut self) {
        while let Some(viewers) = self.look_at_board() {
            self.films.retain(|id, _| viewers.iter().any(|viewer| viewer.id() == *id));
            self.sketches.retain(|bounces_max, _| {
                self.films.values().any(|film| film.key.bounces_max == *bounces_max)
            });
            let snapshot = self.scene.snapshot();
            let settled = self.settle_drawings();
            let is_looked_at = !(viewers.is_empty() && self.drawings.is_empty() && self.jobs.is_empty());
            self.on_card.follow(&snapshot, &self.scene.workshop, is_looked_at);
            self.follow_light(&viewers, &snapshot);
            self.answer(settled, &snapshot);
            self.begin_drawings(&snapshot);
            let tasks: Vec<(Arc<Viewer>, Option<Wish>, Task)> = viewers
                .into_iter()
                .map(|viewer| {
                    let wish = viewer.wish();
                    let task = match &wish {
                        Some(wish) => self.task_of(&viewer, wish, &snapshot),
                        None => Task::Nothing,
                    };
                    (viewer, wish, task)
                })
                .collect();
            let is_moving = tasks.iter().any(|(_, _, task)| *task == Task::Start);
            // Whoever moves sees first what he moved to: what is learnt before that is late for him, and after it for the next picture.
            let start = Instant::now();
            let has_drawn = self.work_one_round(&tasks, &snapshot);
            self.drawn_seconds = start.elapsed().as_secs_f64();
            let has_learnt = self.learn(is_moving);
            if !has_drawn && !has_learnt {
                let later = tasks.iter().filter_map(|(_, _, task)| match task {
                    Task::Later(at) => Some(*at),
                    _ => None,
                });
                let look_again = self.on_card.is_coming().then(|| Instant::now() + CARD_SECONDS);
                let lighting = &self.lighting;
                let for_light = lighting.weighs_at().into_iter().chain(lighting.expires_at());
                self.rest_until(later.chain(look_again).chain(for_light).min());
            }
        }
    }

    /// Takes new requests and the list of viewers; `None` when the scene closes.
    fn look_at_board(&mut self) -> Option<Vec<Arc<Viewer>>> {
        let mut board = lock(&self.scene.board);
        board.news = false;
        board.urgent = false;
        if board.closing {
            return None;
        }
        self.jobs.extend(std::mem::take(&mut board.requests));
        Some(board.viewers.clone())
    }

    fn rest_until(&self, later: Option<Instant>) {
        let mut board = lock(&self.scene.board);
        while !board.news && !board.closing {
            match later.map(|at| at.saturating_duration_since(Instant::now())) {
                Some(Duration::ZERO) => return,
                Some(wait) => {
                    board =
                        self.scene.wake.wait_timeout(board, wait).unwrap_or_else(PoisonError::into_inner).0;
                }
                None => board = self.scene.wake.wait(board).unwrap_or_else(PoisonError::into_inner),
            }
        }
    }

    fn task_of(&self, viewer: &Viewer, wish: &Wish, snapshot: &Snapshot) -> Task {
        // A stalled viewer holds the newest picture it asked for: there is nothing to add until it acknowledges.
        if viewer.stalled_with() == Some(wish.camera_count) {
            return Task::Nothing;
        }
        let film = self.films.get(&viewer.id());
        let interval = self.interval_of(wish);
        let earliest =
            |film: &ViewerFilm| film.shown.map(|shown| shown.at + interval).filter(|at| *at > Instant::now());
        let Some(film) = film else { return Task::Start };
        let task = match (&film.layer, film.key == self.key_of(wish, snapshot, Some(film))) {
            (Some(layer), true) => {
                let samples_max = self.scene.workshop.config.samples_max;
                let is_lit = self.is_lit(film);
                film.next(layer, wish, snapshot, Rest { samples_max, is_lit })
            }
            _ => Task::Start,
        };
        match (task, earliest(film)) {
            (Task::Start | Task::Resend, Some(at)) => Task::Later(at),
            (task, _) => task,
        }
    }

    /// Between two pictures of a viewer, at least.
    fn interval_of(&self, wish: &Wish) -> Duration {
        let rate = wish.quality.frames_per_second_max.min(self.scene.workshop.config.frames_per_second);
        // At most a day, for rates near zero.
        Duration::from_secs_f64((1.0 / f64::from(rate)).min(86_400.0))
    }

    fn key_of(&self, wish: &Wish, snapshot: &Snapshot, film: Option<&ViewerFilm>) -> FilmKey {
        let scene = snapshot.world.scene();
        let view = match &wish.camera.view {
            // The session has looked at it already.
            View::Pose(pose) => convert::view_of_pose(pose).ok(),
            View::Camera(name) => scene.camera_view(Some(name.as_str())),
        };
        // Who watches through a camera that was removed keeps the last pose.
        let view = view.or(film.map(|film| film.key.view)).unwrap_or_else(|| scene.default_view());
        let settings = self.settings_of(wish);
        let light_of = |learnt| LightKey { learnt, bounces_max: wish.bounces_max };
        FilmKey {
            view,
            full: wish.camera.size,
            indirect: wish.indirect,
            bounces_max: wish.bounces_max,
            effects: wish.effects,
            light: settings.learns(&snapshot.plan).map(light_of),
            light_revision: snapshot.light_revision,
        }
    }

    fn settings_of(&self, wish: &Wish) -> RenderSettings {
        RenderSettings {
            indirect: wish.indirect,
            bounces_max: wish.bounces_max,
            seed: self.scene.workshop.config.seed,
            learning: Learning::Alongside { until: None },
            effects: wish.effects,
            measuring: self.scene.workshop.config.measuring(),
            keeps_noise: self.scene.workshop.config.keep_noise,
            backend: self.scene.workshop.card.backend(),
        }
    }

    /// Does the most urgent piece of work; false if there was none.
    fn work_one_round(&mut self, tasks: &[(Arc<Viewer>, Option<Wish>, Task)], snapshot: &Snapshot) -> bool {
        let mut worked = false;
        for (viewer, wish, task) in tasks {
            if let (Some(wish), Task::Resend) = (wish, task) {
                self.with_film(viewer, |painter, film| painter.offer(viewer, film, wish, snapshot));
                worked = true;
            }
        }
        let mut refining: Vec<usize> =
            (0..tasks.len()).filter(|index| tasks[*index].2 == Task::Refine).collect();
        let is_other = |index: &usize| Some(tasks[*index].0.id()) != self.slice_owed;
        let is_owed =
            self.slice_owed.is_some() && (refining.iter().any(is_other) || !self.drawings.is_empty());
        if is_owed {
            refining.retain(is_other);
        }
        let waiting = refining.len() + self.drawings.len();
        let starting = tasks.iter().filter(|(_, _, task)| *task == Task::Start);
        let active = waiting + starting.clone().count();
        // Who was shown something longest ago, or never.
        let first = starting.min_by_key(|(viewer, _, _)| {
            self.films.get(&viewer.id()).and_then(|film| film.shown).map(|shown| shown.at)
        });
        let moving = first.is_some();
        if let Some((viewer, Some(wish), _)) = first
            && !is_owed
        {
            self.start(viewer, wish, snapshot, active);
            self.slice_owed = (waiting > 0).then(|| viewer.id());
            return true;
        }
        self.slice_owed = None;
        if waiting == 0 {
            return worked;
        }
        let cut = if moving || is_owed {
            // The slice of those who wait while another one moves: news may not take it away, nor may that his next camera is not looked at yet.
            Cut { interruptible: false, after: Some(self.quick_pass(active.max(2))) }
        } else {
            // A slice even for one alone: other scenes share the drawing pool, and a step goes on where it stopped.
            Cut { interruptible: true, after: Some(Duration::from_secs_f64(SLICE_SECONDS)) }
        };
        self.turn = (self.turn + 1) % waiting;
        match refining.get(self.turn) {
            Some(index) => {
                if let (viewer, Some(wish), _) = &tasks[*index] {
                    self.with_film(viewer, |painter, film| {
                        painter.refine(viewer, film, wish, snapshot, cut);
                    });
                }
            }
            None => {
                let index = self.drawing_of_turn(self.turn - refining.len());
                self.draw(index, cut);
            }
        }
        true
    }

    /// Time for a quick pass when so many share the machine.
    fn quick_pass(&self, active: usize) -> Duration {
        // 8 ms at least: below, packing and sending would cost more than drawing.
        let milliseconds = self.scene.workshop.config.moving_pass_ms / active.max(1) as f64;
        Duration::from_secs_f64(milliseconds.max(8.0) * 1e-3)
    }

    /// Takes a viewer's film out of the list while something is done with it.
    fn with_film(&mut self, viewer: &Viewer, work: impl FnOnce(&mut Painter, &mut ViewerFilm)) {
        if let Some(mut film) = self.films.remove(&viewer.id()) {
            work(self, &mut film);
            self.films.insert(viewer.id(), film);
        }
    }

    /// The first pass after a change of camera, size or scene.
    fn start(&mut self, viewer: &Viewer, wish: &Wish, snapshot: &Snapshot, active: usize) {
        let mut film = match self.films.remove(&viewer.id()) {
            Some(film) => film,
            None => ViewerFilm::new(self.key_of(wish, snapshot, None), self.speed),
        };
        let key = self.key_of(wish, snapshot, Some(&film));
        // The first of a viewer comes as soon as any.
        let pause = film.layer.as_ref().map_or(Duration::ZERO, |_| film.started.elapsed());
        if film.key != key || film.layer.is_none() {
            film.restart(key);
            viewer.restart_curve();
        }
        let moving = self.quick_pass(active);
        let budget = pause.mul_f64(PASS_OF_PAUSE).clamp(moving, moving.mul_f64(PASS_ALONE_MAX));
        let now = Instant::now();
        let fitting = film.quick_rung.next(&self.quick_speed, key.full, budget.as_secs_f64(), now);
        film.divisor_min = self.finest_divisor(wish, snapshot, key.full);
        film.light_generation = key.light.map_or(0, |light| self.lighting.generation(light));
        film.light_epoch = key.light.map_or(0, |light| self.lighting.epoch(light));
        // A pass that was cut may have seen only the fast part of the picture: the next one is smaller in any case.
        let divisor = (fitting << film.overruns).clamp(film.divisor_min, DIVISOR_MAX);
        match self.layer(&film, snapshot, wish, divisor) {
            Ok(mut layer) => {
                let after = (divisor < DIVISOR_MAX).then(|| moving.mul_f64(OVERRUN));
                if layer.rendering.takes_sketch()
                    && let Some(sketch) = self.sketch(snapshot, &self.settings_of(wish))
                {
                    layer.rendering.begin_with(sketch);
                }
                if frames::codec(wish.quality.codec, false) != PayloadCodec::Float {
                    self.on_card.draw(&mut layer.rendering, &self.scene.workshop);
                    layer.rendering.show_first_as(film.packer.display(&wish.quality));
                }
                // Without the sketch, which takes as long for a picture of any size.
                let (before, started) = (layer.rendering.sample_count(), Instant::now());
                let complete =
                    self.pass(&mut layer.rendering, &mut film, Cut { interruptible: false, after });
                let samples = layer.rendering.sample_count() - before;
                film.quick_rung.take(divisor, now);
                if complete {
                    film.overruns = 0;
                    film.layer = Some(layer);
                    self.offer(viewer, &mut film, wish, snapshot);
                } else {
                    // 4: sixteenfold, the whole ladder.
                    film.overruns = (film.overruns + 1).min(4);
                }
                // With showing and packing it, which large pictures take long for.
                self.quick_speed.measure(samples, started.elapsed().as_secs_f64());
            }
            Err(problem) => viewer.set_problem(problem),
        }
        self.films.insert(viewer.id(), film);
    }

    /// The finest divisor whose film fits into the memory that all films may take.
    fn finest_divisor(&self, wish: &Wish, snapshot: &Snapshot, full: Size) -> u32 {
        let config = &self.scene.workshop.config;
        let taken = self.scene.workshop.metrics.film_bytes.value();
        let limit = i64::try_from(config.film_bytes).unwrap_or(i64::MAX);
        let settings = self.settings_of(wish);
        let fits = |divisor: &u32| {
            let [width, height] = scaled(full, *divisor).map(usize::from);
            let bytes = settings.picture_bytes(&snapshot.plan, width * height);
            taken.saturating_add(i64::try_from(bytes).unwrap_or(i64::MAX)) <= limit
        };
        rungs(1).find(fits).unwrap_or(DIVISOR_MAX)
    }

    /// The caustics of first pictures, followed once for all cameras that look at a scene.
    fn sketch(&mut self, snapshot: &Snapshot, settings: &RenderSettings) -> Option<Arc<CausticSketch>> {
        let revision = snapshot.light_revision;
        self.sketches.retain(|_, (of, _)| *of == revision);
        if let Some((_, sketch)) = self.sketches.get(&settings.bounces_max) {
            return Some(sketch.clone());
        }
        let workshop = &self.scene.workshop;
        let sketch = workshop
            .drawing_pool
            .install(|| settings.sketch(&snapshot.world, &snapshot.plan))
            .map(Arc::new)?;
        workshop.metrics.rays.add(sketch.rays());
        self.sketches.insert(settings.bounces_max, (revision, sketch.clone()));
        Some(sketch)
    }

    fn layer(
        &self,
        film: &ViewerFilm,
        snapshot: &Snapshot,
        wish: &Wish,
        divisor: u32,
    ) -> Result<Layer, Problem> {
        let size = scaled(film.key.full, divisor);
        let picture = PictureSize::new(size[0].into(), size[1].into())
            .map_err(|error| Problem::new(ProblemKind::ValueRefused, error.to_string()))?;
        let settings = self.settings_of(wish);
        let bytes = settings.picture_bytes(&snapshot.plan, picture.pixel_count());
        let known = film.key.light.and_then(|light| self.lighting.known(light));
        let rendering = Rendering::with(
            (snapshot.world.clone(), &snapshot.plan),
            film.key.view,
            picture,
            settings,
            known,
        );
        Ok(Layer { rendering, divisor, size, _memory: CountedMemory::of_film(&self.scene.workshop, bytes) })
    }

    /// One more pass of the present film, or of the next rung's.
    fn refine(&mut self, viewer: &Viewer, film: &mut ViewerFilm, wish: &Wish, snapshot: &Snapshot, cut: Cut) {
        let Some(mut layer) = film.layer.take() else { return };
        // Others may have taken memory since the first pass.
        film.divisor_min =
            film.divisor_min.max(self.finest_divisor(wish, snapshot, film.key.full)).min(layer.divisor);
        if layer.divisor > film.divisor_min {
            let divisor = film.climb.take().map_or_else(
                || {
                    let above = self.speed.divisor_above(film.key.full, layer.divisor);
                    self.layer(film, snapshot, wish, above.max(film.divisor_min))
                },
                Ok,
            );
            film.layer = Some(layer);
            let Ok(mut next) = divisor else { return };
            if self.pass(&mut next.rendering, film, cut) {
                film.layer = Some(next);
                (film.offer_at_passes, film.relit_at_passes, film.mixed_until_passes) = (0, 0, None);
                if film.may_show(self.interval_of(wish)) {
                    self.offer(viewer, film, wish, snapshot);
                }
            } else {
                film.climb = Some(next);
            }
            return;
        }
        // A picture does not rest before all is known of its light: until then there is nothing to find out.
        let is_decided = wish.target_error > 0.0 && self.is_lit(film);
        layer.rendering.aim_at(is_decided.then_some(wish.target_error));
        let complete = self.pass(&mut layer.rendering, film, cut);
        let is_due = film.is_due(&layer, complete);
        let may_show = film.may_show(self.interval_of(wish));
        if is_due && !may_show && layer.rendering.passes() >= film.offer_at_passes {
            // Whoever wants few pictures rests as early as others.
            film.measured = self.scene.workshop.drawing_pool.install(|| layer.rendering.measured_error());
            film.offer_at_passes = next_offer_after(layer.rendering.passes());
        }
        film.layer = Some(layer);
        if is_due && may_show {
            film.told_early |= !complete;
            self.offer(viewer, film, wish, snapshot);
        }
    }

    /// A pass of a viewer's film; true if it is whole.
    fn pass(&mut self, rendering: &mut Rendering, film: &mut ViewerFilm, cut: Cut) -> bool {
        let before = rendering.counts();
        let (complete, samples, seconds) = self.step(rendering, cut);
        film.speed.measure(samples, seconds);
        if seconds > 1e-3 {
            let counts = rendering.counts();
            let rays = (counts - before).all_rays();
            film.rays_per_second = rays as f64 / seconds;
        }
        complete
    }

    /// A pass of any film: whether it is whole, samples drawn, seconds.
    fn step(&mut self, rendering: &mut Rendering, cut: Cut) -> (bool, u64, f64) {
        self.scene.cancel.store(false, SeqCst);
        self.scene.interruptible.store(cut.interruptible, SeqCst);
        // Urgent news that came before the line above saw nothing to interrupt: look at it first. An acknowledgement of one
        // viewer's picture takes no slice from another.
        let board = lock(&self.scene.board);
        if board.closing || (cut.interruptible && board.urgent) {
            return (false, 0, 0.0);
        }
        drop(board);
        self.on_card.draw(rendering, &self.scene.workshop);
        let metrics = &self.scene.workshop.metrics;
        let (samples_before, counts_before) = (rendering.sample_count(), rendering.counts());
        let gpu_passes_before = rendering.gpu_passes();
        let started = Instant::now();
        self.alarm.set(cut.after.map(|after| started + after));
        let scene = &self.scene;
        let progress = scene.workshop.drawing_pool.install(|| rendering.step(&scene.cancel));
        self.on_card.note(rendering, &scene.workshop);
        self.alarm.set(None);
        self.scene.interruptible.store(false, SeqCst);
        let seconds = started.elapsed().as_secs_f64();
        let samples = rendering.sample_count() - samples_before;
        let counts = rendering.counts();
        if progress.complete { &metrics.passes } else { &metrics.steps_cut }.one();
        metrics.passes_gpu.add(rendering.gpu_passes() - gpu_passes_before);
        metrics.samples.add(samples);
        metrics.rays.add((counts - counts_before).all_rays());
        metrics.render_us.add((seconds * 1e6) as u64);
        self.speed.measure(samples, seconds);
        (progress.complete, samples, seconds)
    }

    /// Packs the present picture and puts it where the session finds it.
    fn offer(&mut self, viewer: &Viewer, film: &mut ViewerFilm, wish: &Wish, snapshot: &Snapshot) {
        let Some(layer) = &film.layer else { return };
        let rendering = &layer.rendering;
        let passes = rendering.passes();
        let pool = &self.scene.workshop.drawing_pool;
        let picture = pool.install(|| rendering.picture());
        film.measured = pool.install(|| rendering.measured_error_of(&picture));
        let rest = Rest { samples_max: self.scene.workshop.config.samples_max, is_lit: self.is_lit(film) };
        let converged = film.has_converged(layer, wish, rest);
        if film.climbs() {
            film.foretold.pause();
        } else {
            let seconds = film.started.elapsed().as_secs_f64();
            if !converged && film.shown.is_some_and(|shown| shown.converged) {
                film.foretold.wake(seconds);
            }
            let look = Look {
                layer,
                measured: film.measured,
                seconds,
                to_learn: self.to_learn(film),
                samples_max: film.samples_max(layer, rest),
                target: wish.target_error,
            };
            let came_true = film.foretold.look(look);
            let metrics = &self.scene.workshop.metrics;
            metrics.forecasts_judged.add(came_true.judged);
            metrics.forecasts_right.add(came_true.right);
            metrics.forecasts_decided.add(came_true.decided);
            metrics.forecasts_held.add(came_true.held);
        }
        let aim = Aim { error: wish.target_error, irradiance_accuracy: wish.irradiance_accuracy };
        film.rests_at = (converged && film.is_lit_by_the_scene()).then_some(aim);
        let codec = frames::codec(wish.quality.codec, converged);
        film.offer_at_passes = next_offer_after(passes);
        // Even if packing fails: it would fail again at once.
        film.shown = Some(Shown {
            camera_count: wish.camera_count,
            quality_count: wish.quality_count,
            revision: snapshot.revision,
            converged,
            at: Instant::now(),
        });
        let packer = &mut film.packer;
        let packed = self.scene.workshop.drawing_pool.install(|| {
            let are_shown = wish.quality.show_records && codec != PayloadCodec::Float;
            let marked = if are_shown { rendering.places_seen() } else { Vec::new() };
            let packed = frames::Packed { picture: &picture, shown: rendering.shown_by_card() };
            packer.pack(packed, &wish.quality, codec, &marked)
        });
        let payload = match packed {
            Ok(payload) => payload,
            Err(error) => {
                viewer.set_problem(Problem::new(ProblemKind::Internal, error.to_string()));
                return;
            }
        };
        let error = film.measured.map(|measured| measured.error() as f32).filter(|e| e.is_finite());
        let header = FrameHeader {
            kind: PayloadKind::Frame,
            codec,
            converged,
            first_from_stamp: false,
            revision: snapshot.revision,
            frame: 0,
            camera_stamp: wish.camera.stamp,
            size: layer.size,
            full_size: film.key.full,
            offset: [0, 0],
            error,
            samples: passes,
            age_us: 0,
        };
        viewer.set_stats(film.stats(layer, wish, snapshot.revision));
        viewer.push_point(film.point(layer, wish, snapshot.revision));
        let (camera_received, camera_count) = (wish.received, wish.camera_count);
        if viewer.offer(Picture { header, payload, camera_received, camera_count }) {
            self.scene.workshop.metrics.frames_skipped.one();
        }
    }
}
