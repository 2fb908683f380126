//! One viewer, as its session and the render thread share it: what it wants to see, and the newest picture for it.
//!
//! There is no queue: a new camera replaces the one before, a new picture replaces the one that was not sent yet. So a
//! viewer that stalls holds one picture and costs nothing else.

use crate::convert;
use lumicast_engine::effects::EffectChoices;
use lumicast_engine::render::Indirect;
use lumicast_protocol::{Accuracy, CameraRequest, ConvergencePoint, FrameHeader, Quality, Stats, Technique};
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// Points of the convergence curve kept per film: enough for a plot.
const CURVE_POINTS_MAX: usize = 256;

/// A picture for a viewer, packed; frame number and age are added when it is sent.
#[derive(Debug, Clone)]
pub(super) struct Picture {
    /// Everything but frame number and age.
    pub header: FrameHeader,
    /// The packed picture.
    pub payload: Vec<u8>,
    /// When the camera message it shows was received.
    pub camera_received: Instant,
    /// Which of the viewer's camera messages it shows, by count.
    pub camera_count: u64,
}

/// What a viewer wants drawn.
#[derive(Debug, Clone)]
pub(super) struct Wish {
    /// The last camera message.
    pub(super) camera: CameraRequest,
    /// How many there were: stamps may repeat.
    pub(super) camera_count: u64,
    /// When it came.
    pub(super) received: Instant,
    pub(super) quality: Quality,
    /// How many quality messages there were.
    pub(super) quality_count: u64,
    /// 0: none; only the bound on samples ends the picture.
    pub(super) target_error: f64,
    pub(super) indirect: Indirect,
    pub(super) technique: Technique,
    pub(super) bounces_max: Option<u32>,
    pub(super) irradiance_accuracy: f32,
    pub(super) effects: EffectChoices,
}

#[derive(Debug)]
struct State {
    camera: Option<(CameraRequest, Instant)>,
    camera_count: u64,
    quality: Quality,
    quality_count: u64,
    accuracy: Accuracy,
    indirect: Indirect,
    technique: Technique,
    /// Frame numbers sent and not acknowledged, growing.
    in_flight: VecDeque<u64>,
    frames_sent: u64,
    frames_skipped: u64,
    pending: Option<Picture>,
    /// Count of the last camera message that a sent frame showed.
    camera_count_sent: u64,
    stats: Option<Stats>,
    curve: Vec<ConvergencePoint>,
    problem: Option<lumicast_protocol::Problem>,
}

/// One connected viewer.
#[derive(Debug)]
pub struct Viewer {
    id: u64,
    in_flight_max: usize,
    state: Mutex<State>,
    /// Rung when there may be something to send.
    news: Notify,
}

impl Viewer {
    pub(super) fn new(id: u64, in_flight_max: usize) -> Viewer {
        let state = State {
            camera: None,
            camera_count: 0,
            quality: Quality::default(),
            quality_count: 0,
            accuracy: Accuracy::default(),
            indirect: Indirect::Auto,
            technique: Technique::Auto,
            in_flight: VecDeque::new(),
            frames_sent: 0,
            frames_skipped: 0,
            pending: None,
            camera_count_sent: 0,
            stats: None,
            curve: Vec::new(),
            problem: None,
        };
        Viewer { id, in_flight_max, state: Mutex::new(state), news: Notify::new() }
    }

    /// Number of the connection.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// A panic elsewhere leaves this plain data whole, so a poisoned lock is taken as it is.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    pub(super) fn set_camera(&self, camera: CameraRequest) {
        let mut state = self.state();
        state.camera = Some((camera, Instant::now()));
        state.camera_count += 1;
    }

    pub(super) fn set_quality(&self, quality: Quality) {
        let mut state = self.state();
        state.quality = quality;
        state.quality_count += 1;
    }

    pub(super) fn set_accuracy(&self, accuracy: Accuracy, indirect: Indirect, technique: Technique) {
        let mut state = self.state();
        (state.accuracy, state.indirect, state.technique) = (accuracy, indirect, technique);
    }

    /// Takes note that the client has used this frame and those before it. `Err` for a frame never sent.
    pub(super) fn acknowledge(&self, frame: u64) -> Result<(), u64> {
        let mut state = self.state();
        if frame == 0 || frame > state.frames_sent {
            return Err(state.frames_sent);
        }
        while state.in_flight.front().is_some_and(|first| *first <= frame) {
            state.in_flight.pop_front();
        }
        drop(state);
        self.news.notify_one();
        Ok(())
    }

    /// Waits until [`Viewer::take_picture`] or [`Viewer::take_problem`] may have something.
    pub async fn news(&self) {
        self.news.notified().await;
    }

    /// The newest picture, if there is one and room for it: a whole binary message with its latency if it is the first
    /// of its camera message. The caller sends it.
    pub fn take_picture(&self) -> Option<Outgoing> {
        let mut state = self.state();
        if state.in_flight.len() >= self.in_flight_max {
            return None;
        }
        let mut picture = state.pending.take()?;
        let first = picture.camera_count > state.camera_count_sent;
        let age = picture.camera_received.elapsed();
        state.frames_sent += 1;
        picture.header.frame = state.frames_sent;
        picture.header.first_from_stamp = first;
        picture.header.age_us = u32::try_from(age.as_micros()).unwrap_or(u32::MAX);
        // Fails only for a header that contradicts its payload, which the packing does not make.
        let message = picture.header.message(&picture.payload).ok()?;
        state.camera_count_sent = picture.camera_count;
        let frame = state.frames_sent;
        state.in_flight.push_back(frame);
        if let Some(stats) = &mut state.stats {
            stats.frames_sent = frame;
        }
        Some(Outgoing { message, first_from_camera: first.then_some(age) })
    }

    /// What the render thread could not do for this viewer, once.
    pub fn take_problem(&self) -> Option<lumicast_protocol::Problem> {
        self.state().problem.take()
    }

    /// How its picture is doing; `None` before the first pass.
    pub fn stats(&self) -> Option<Stats> {
        let state = self.state();
        let mut stats = state.stats.clone()?;
        stats.frames_sent = state.frames_sent;
        stats.frames_skipped = state.frames_skipped;
        stats.in_flight = u32::try_from(state.in_flight.len()).unwrap_or(u32::MAX);
        Some(stats)
    }

    /// The error over time of its present film.
    pub fn curve(&self) -> Vec<ConvergencePoint> {
        self.state().curve.clone()
    }

    pub(super) fn wish(&self) -> Option<Wish> {
        let state = self.state();
        let (camera, received) = state.camera.clone()?;
        Some(Wish {
            camera,
            camera_count: state.camera_count,
            received,
            quality: state.quality,
            quality_count: state.quality_count,
            target_error: state.accuracy.target().map_or(0.0, f64::from),
            indirect: state.indirect,
            technique: state.technique,
            bounces_max: state.accuracy.bounces,
            irradiance_accuracy: state.accuracy.irradiance_accuracy,
            effects: convert::effect_choices(state.accuracy.effects),
        })
    }

    /// Which camera message the picture shows that waits while no room is in flight; `None` when one more could go out.
    pub(super) fn stalled_with(&self) -> Option<u64> {
        let state = self.state();
        let full = state.in_flight.len() >= self.in_flight_max;
        state.pending.as_ref().filter(|_| full).map(|picture| picture.camera_count)
    }

    /// Puts the newest picture in place; true if it replaced one that was never sent.
    pub(super) fn offer(&self, picture: Picture) -> bool {
        let mut state = self.state();
        let replaced = state.pending.replace(picture).is_some();
        state.frames_skipped += u64::from(replaced);
        drop(state);
        self.news.notify_one();
        replaced
    }

    pub(super) fn set_stats(&self, stats: Stats) {
        self.state().stats = Some(stats);
    }

    pub(super) fn set_problem(&self, problem: lumicast_protocol::Problem) {
        self.state().problem = Some(problem);
        self.news.notify_one();
    }

    pub(super) fn restart_curve(&self) {
        self.state().curve.clear();
    }

    /// Adds a point; beyond the limit every second one goes, so that the curve always spans the whole time.
    pub(super) fn push_point(&self, point: ConvergencePoint) {
        let mut state = self.state();
        if state.curve.len() >= CURVE_POINTS_MAX {
            let mut index = 0;
            state.curve.retain(|_| {
                index += 1;
                index % 2 == 1
            });
        }
        state.curve.push(point);
    }
}

/// A binary message to send.
#[derive(Debug)]
pub struct Outgoing {
    /// Header and payload.
    pub message: Vec<u8>,
    /// Time since the camera message, for the first picture that shows it.
    pub first_from_camera: Option<Duration>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumicast_protocol::{PayloadCodec, PayloadKind};

    fn picture(camera_count: u64) -> Picture {
        let header = FrameHeader {
            kind: PayloadKind::Frame,
            codec: PayloadCodec::Jpeg,
            converged: false,
            first_from_stamp: false,
            revision: 1,
            frame: 0,
            camera_stamp: camera_count,
            size: [1, 1],
            full_size: [1, 1],
            offset: [0, 0],
            error: None,
            samples: 1,
            age_us: 0,
        };
        Picture { header, payload: vec![0], camera_received: Instant::now(), camera_count }
    }

    fn taken(viewer: &Viewer) -> Option<FrameHeader> {
        viewer.take_picture().map(|out| FrameHeader::decode(&out.message).unwrap().0)
    }

    #[test]
    fn two_frames_are_in_flight_at_most_and_the_newest_waits() {
        let viewer = Viewer::new(1, 2);
        for count in 1..=2 {
            viewer.offer(picture(count));
            assert_eq!(taken(&viewer).unwrap().frame, count);
        }
        assert!(!viewer.offer(picture(3)));
        assert!(viewer.offer(picture(4)));
        assert!(taken(&viewer).is_none());
        assert_eq!(viewer.stalled_with(), Some(4));
        viewer.acknowledge(2).unwrap();
        let header = taken(&viewer).unwrap();
        assert_eq!((header.frame, header.camera_stamp, header.first_from_stamp), (3, 4, true));
        assert_eq!(viewer.stalled_with(), None);
    }

    #[test]
    fn an_acknowledgement_of_what_was_never_sent_is_refused() {
        let viewer = Viewer::new(1, 2);
        assert!(viewer.acknowledge(1).is_err());
        viewer.offer(picture(1));
        taken(&viewer).unwrap();
        assert!(viewer.acknowledge(0).is_err() && viewer.acknowledge(2).is_err());
        viewer.acknowledge(1).unwrap();
        viewer.acknowledge(1).unwrap();
    }

    #[test]
    fn only_the_first_frame_of_a_camera_message_is_marked() {
        let viewer = Viewer::new(1, 2);
        viewer.offer(picture(1));
        assert!(taken(&viewer).unwrap().first_from_stamp);
        viewer.offer(picture(1));
        assert!(!taken(&viewer).unwrap().first_from_stamp);
    }
}
