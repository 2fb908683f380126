//! Which light the films of a scene show: learns of it between two slices of drawing, and brings what becomes known into them.

use super::Painter;
use crate::scenes::lighting::{Gaze, LightKey};
use crate::scenes::viewer::Viewer;
use crate::scenes::viewer_film::{Layer, ViewerFilm};
use crate::scenes::{Snapshot, lock};
use lumicast_engine::film::{Outdated, PictureSize};
use lumicast_engine::render::ToLearn;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// While things move: as long as drawing took, at most as long as a pass may then, and at least so long, as steps are.
const LEARNING_MOVING_LEAST: f64 = 0.01;
/// … of which so large a share is not cut short by what comes meanwhile.
const LEARNING_SURE: f64 = 0.5;
/// Slice of learning about the light between two slices of drawing, at least and at most …
const LEARNING_LEAST: f64 = 0.04;
const LEARNING_SECONDS: f64 = 0.2;
/// … and over the time that was spent on drawing since the last, for one viewer alone: a small picture takes a tenth of a slice for a
/// sample of each pixel …
const LEARNING_FOR_DRAWING: f64 = 2.0;
/// … less while his picture is not yet shown as large as he asked for, …
const LEARNING_FOR_CLIMBING: f64 = 0.5;
/// … and as much for those who look without what is learnt, or have to share with others.
const LEARNING_FOR_OTHERS: f64 = 1.0;

impl Painter {
    /// Brings what is known of the light to the present scene, and into the films that show it.
    pub(super) fn follow_light(&mut self, viewers: &[Arc<Viewer>], snapshot: &Snapshot) {
        let mut wanted: HashMap<LightKey, Vec<Gaze>> = HashMap::new();
        for viewer in viewers {
            let Some(wish) = viewer.wish() else { continue };
            if let Some(film) = self.films.get_mut(&viewer.id()) {
                film.wake_for(&wish);
            }
            let key = self.key_of(&wish, snapshot, self.films.get(&viewer.id()));
            let size = PictureSize::new(key.full[0].into(), key.full[1].into());
            if let (Some(light), Ok(size)) = (key.light, size) {
                let irradiance_accuracy = wish.irradiance_accuracy;
                let gaze = Gaze { viewer: viewer.id(), camera: key.view, size, irradiance_accuracy };
                wanted.entry(light).or_default().push(gaze);
            }
        }
        let mut changes = std::mem::take(&mut lock(&self.scene.board).light_changes);
        self.lighting.follow(snapshot, &mut changes, &wanted, &self.scene.workshop);
        // What came in the meantime lies behind what is left.
        let board = &mut lock(&self.scene.board);
        std::mem::swap(&mut board.light_changes, &mut changes);
        board.light_changes.append(changes);
        for film in self.films.values_mut() {
            let Some(light) = film.key.light else { continue };
            let generation = self.lighting.generation(light);
            let epoch = self.lighting.epoch(light);
            let is_same_scene = film.light_epoch == epoch;
            if film.light_generation == generation || (film.rests_at.is_some() && is_same_scene) {
                continue;
            }
            let known = self.lighting.known(light);
            (film.light_generation, film.light_epoch, film.rests_at) = (generation, epoch, None);
            let shows_none = |layer: &Layer| !layer.rendering.looks_up();
            if known.is_none() && film.layer.iter().chain(&film.climb).all(shows_none) {
                // Path-traced, of the scene as it is.
                continue;
            }
            let outdated = if is_same_scene { Outdated::Rough } else { Outdated::Wrong };
            (film.measured, film.told_early) = (None, false);
            film.offer_at_passes = 0;
            film.relit_at_passes = film.layer.as_ref().map_or(0, |layer| layer.rendering.passes());
            if outdated == Outdated::Wrong {
                // Of a pass that was cut, some is of the light before.
                let lit = film.layer.as_ref().map_or([0; 2], |layer| layer.rendering.lit_passes());
                film.mixed_until_passes = (lit[0] < lit[1]).then_some(lit[1]);
                film.climb = None;
            }
            for layer in film.layer.iter_mut().chain(&mut film.climb) {
                layer.rendering.relight(known.clone(), outdated);
            }
        }
    }

    /// Learns of the light for a slice of time; true when it did anything.
    pub(super) fn learn(&mut self, is_moving: bool) -> bool {
        let most_moving = self.scene.workshop.config.moving_pass_ms * 1e-3;
        let ratio = match self.films.values().next() {
            Some(film) if self.films.len() == 1 && self.drawings.is_empty() && film.is_lit_by_the_scene() => {
                if film.climbs() {
                    LEARNING_FOR_CLIMBING
                } else {
                    LEARNING_FOR_DRAWING
                }
            }
            _ => LEARNING_FOR_OTHERS,
        };
        let slice = if is_moving {
            self.drawn_seconds.max(LEARNING_MOVING_LEAST).min(most_moving)
        } else {
            (ratio * self.drawn_seconds).clamp(LEARNING_LEAST, LEARNING_SECONDS)
        };
        // Where news never ends it has come by now, and nothing would be learnt.
        let least =
            Instant::now() + Duration::from_secs_f64(if is_moving { LEARNING_SURE * slice } else { 0.0 });
        let scene = &self.scene;
        let is_news = || Instant::now() >= least && lock(&scene.board).urgent;
        self.lighting.learn(Duration::from_secs_f64(slice), &scene.workshop, is_news)
    }

    /// All is known of its light, and it is drawn with that.
    pub(super) fn is_lit(&self, film: &ViewerFilm) -> bool {
        film.key.light.is_none_or(|light| {
            self.lighting.is_complete(light) && film.light_generation == self.lighting.generation(light)
        })
    }

    /// What is still to be learnt of its light, or to be drawn with.
    pub(super) fn to_learn(&self, film: &ViewerFilm) -> ToLearn {
        match film.key.light {
            Some(light) if !self.is_lit(film) => match self.lighting.to_learn(light) {
                ToLearn::Nothing => ToLearn::Records,
                more => more,
            },
            _ => ToLearn::Nothing,
        }
    }
}
