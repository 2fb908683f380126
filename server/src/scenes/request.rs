//! Single pictures for `GET frame`: drawn by the render thread in turn with the viewers, each with a film of its own, by the best
//! chain there is or a technique that is named. They learn of the light by themselves, or together with others that are drawn at once (`request/shared.rs`), in the
//! time they have, and go on with what the scene keeps of it from the last who looked; what they know in the end is kept in turn.

mod shared;

use self::shared::Learns;
use super::lighting::{LightKey, Lighting, illumination_of};
use super::memory::CountedMemory;
use super::{Scene, Snapshot, Workshop, lock, no_camera};
use crate::images::{self, EncodeError, ExrLayers, JpegQuality, PictureFacts};
use lumicast_engine::film::{Display, MeasuredError, PictureSize};
use lumicast_engine::render::{Indirect, Learner, Learning, RenderSettings, Rendering};
use lumicast_engine::scene::CameraView;
use lumicast_engine::transport::World;
use lumicast_protocol::{Problem, ProblemKind};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// Share of the longest time after which nothing more is learnt, so that what is known by then is seen by some samples.
const LEARNING_SHARE: f64 = 0.9;

/// File format of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureFormat {
    /// Linear radiance, no tone map.
    Exr,
    /// 8-bit sRGB, lossless.
    Png,
    /// 8-bit sRGB.
    Jpeg,
}

/// When a picture is done: whatever comes first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Until {
    /// At this √relMSE, as a fraction.
    pub error: Option<f64>,
    /// After this time.
    pub time: Duration,
}

/// Why a picture was done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DoneBy {
    /// It has the error asked for.
    Error,
    /// The time was over.
    Time,
    /// It has as many samples as the server allows.
    Samples,
}

impl DoneBy {
    /// As in the header of the answer.
    pub fn name(self) -> &'static str {
        match self {
            DoneBy::Error => "error",
            DoneBy::Time => "time",
            DoneBy::Samples => "samples",
        }
    }
}

/// A picture to draw.
#[derive(Debug, Clone)]
pub struct PictureRequest {
    /// The scene's camera; `None`: the first, or a view of the whole scene.
    pub camera: Option<String>,
    /// Pixels; `None`: 640 wide, as high as the camera was composed for.
    pub size: Option<PictureSize>,
    /// File format.
    pub format: PictureFormat,
    /// Of indirect light.
    pub technique: Indirect,
    /// When it is done.
    pub until: Until,
    /// Tone map and exposure; not for EXR.
    pub tone_map: lumicast_engine::film::ToneMap,
    /// Stops.
    pub exposure_ev: f32,
}

/// A finished picture.
#[derive(Debug)]
pub struct RequestedPicture {
    /// The file.
    pub bytes: Vec<u8>,
    /// Revision of the scene it shows.
    pub revision: u64,
    /// Per pixel.
    pub samples: u32,
    /// How good it is, where that was measured.
    pub measured: Option<MeasuredError>,
    /// Spent on it.
    pub seconds: f64,
    /// What ended it.
    pub done_by: DoneBy,
}

/// A request on its way to the render thread.
#[derive(Debug)]
pub(super) struct Job {
    view: CameraView,
    size: PictureSize,
    request: PictureRequest,
    snapshot: Arc<Snapshot>,
    reply: oneshot::Sender<Result<RequestedPicture, EncodeError>>,
}

/// A request being drawn.
#[derive(Debug)]
pub(super) struct Drawing {
    job: Job,
    /// That no other being drawn has: what learners know its view by.
    number: u64,
    /// How its light is learnt, if at all.
    learns: Option<Learns>,
    pub(super) rendering: Rendering,
    pub(super) memory: CountedMemory,
    started: Instant,
    /// Passes at which the error is measured next: measuring walks the whole film.
    measure_at: u32,
    samples_max: u32,
    deadline: Instant,
    done_by: Option<DoneBy>,
    seed: u64,
}

impl Scene {
    /// Draws one picture of the scene as it is now. Dropping the future gives it up.
    pub async fn draw(&self, request: PictureRequest) -> Result<RequestedPicture, Problem> {
        let config = &self.workshop.config;
        let snapshot = self.snapshot();
        let scene = snapshot.world.scene();
        let view = match scene.camera_view(request.camera.as_deref()) {
            Some(view) => view,
            None if request.camera.is_none() => scene.default_view(),
            None => {
                let name = request.camera.unwrap_or_default();
                return Err(no_camera(&name, scene.cameras().keys()));
            }
        };
        let size = match request.size {
            Some(size) => size,
            None => {
                let cameras = scene.cameras();
                let camera = match &request.camera {
                    Some(name) => cameras.get(name.as_str()),
                    None => cameras.values().next(),
                };
                let aspect = camera.and_then(|camera| camera.aspect).unwrap_or(16.0 / 9.0);
                let height = (640.0 / aspect).round().clamp(1.0, f64::from(config.picture_height));
                // Both are in range by the clamp.
                PictureSize::new(640, height as u32)
                    .map_err(|error| Problem::new(ProblemKind::ValueRefused, error.to_string()))?
            }
        };
        let (reply, answer) = oneshot::channel();
        let job = Job { view, size, request, snapshot, reply };
        {
            let mut board = lock(&self.board);
            if board.closing {
                return Err(self.gone());
            }
            if board.requests_open >= config.frame_requests as usize {
                let detail = format!(
                    "{} pictures are being drawn already, as many as `frame_requests` of the settings allows; try again",
                    board.requests_open
                );
                return Err(Problem::new(ProblemKind::Unavailable, detail));
            }
            board.requests_open += 1;
            board.requests.push_back(job);
            board.news = true;
        }
        self.wake.notify_one();
        match answer.await {
            Ok(Ok(picture)) => Ok(picture),
            Ok(Err(error)) => Err(Problem::new(ProblemKind::Internal, error.to_string())),
            Err(_) => Err(self.gone()),
        }
    }
}

impl Drawing {
    /// - `now`: the scene that `lighting` was brought to last
    /// - `others`: that are being drawn
    /// - `number`: that none of them has
    pub(super) fn begin(
        job: Job,
        (lighting, now): (&mut Lighting, &Snapshot),
        (others, number): (&mut [Drawing], u64),
        workshop: &Arc<Workshop>,
    ) -> Drawing {
        let config = &workshop.config;
        let seconds = job.request.until.time.min(Duration::from_secs_f64(config.frame_seconds_max));
        let started = Instant::now();
        let learns_until = started + seconds.mul_f64(LEARNING_SHARE);
        let settings = RenderSettings {
            indirect: job.request.technique,
            seed: config.seed,
            learning: Learning::Alongside { until: Some(learns_until) },
            measuring: config.measuring(),
            keeps_noise: config.keep_noise,
            backend: workshop.card.backend(),
            ..RenderSettings::default()
        };
        let plan = &job.snapshot.plan;
        let bytes = settings.picture_bytes(plan, job.size.pixel_count());
        let light_revision = job.snapshot.light_revision;
        let mut learns = settings.learns(plan).map(|learnt| Learns {
            light: LightKey { learnt, bounces_max: settings.bounces_max },
            light_revision,
            until: learns_until,
            learner: number,
        });
        let world = job.snapshot.world.clone();
        let seen = (job.view, job.size);
        let joined = learns.as_mut().and_then(|learns| Drawing::learner_of_others(learns, others));
        let is_of_now = light_revision == now.light_revision;
        let alone = learns.filter(|_| is_of_now && joined.is_none());
        let kept = alone.and_then(|learns| lighting.hand_over(learns.light, workshop));
        workshop.metrics.pictures.one();
        workshop.metrics.pictures_joined.add(u64::from(joined.is_some()));
        workshop.metrics.pictures_lit.add(u64::from(kept.is_some()));
        let mut rendering = match (joined, kept, learns) {
            (Some(learner), _, _) => {
                Rendering::learning_with((world, plan), (learner, number), seen, settings)
            }
            (_, Some(learner), _) => Rendering::learning_on((world, plan), (learner, number), seen, settings),
            (_, _, Some(Learns { light, .. })) => {
                let learner = Learner::new(light.learnt, &settings, illumination_of(&settings, workshop));
                Rendering::learning_on((world, plan), (learner, number), seen, settings)
            }
            (_, _, None) => Rendering::with((world, plan), job.view, job.size, settings, None),
        };
        rendering.aim_at(job.request.until.error);
        Drawing {
            number,
            learns,
            rendering,
            memory: CountedMemory::of_film(workshop, bytes),
            started,
            measure_at: 2,
            samples_max: config.samples_max,
            deadline: started + seconds,
            done_by: None,
            seed: config.seed,
            job,
        }
    }

    /// What it learnt of its light, if that is the light of the scene as it is now.
    pub(super) fn give_light(&mut self, now: &Snapshot) -> Option<(LightKey, (Learner, Arc<World>))> {
        let is_of_now = self.job.snapshot.light_revision == now.light_revision;
        let light = self.learns.filter(|_| is_of_now)?.light;
        Some((light, (self.rendering.give_learner()?, self.job.snapshot.world.clone())))
    }

    /// When it is to be done at the latest.
    pub(super) fn is_due_at(&self) -> Instant {
        self.deadline
    }

    /// Whether nobody waits for it any more.
    pub(super) fn is_given_up(&self) -> bool {
        self.job.reply.is_closed()
    }

    /// Latest end of the next pass; none before the first pass is whole.
    pub(super) fn deadline(&self) -> Option<Instant> {
        (self.rendering.passes() > 0).then_some(self.deadline)
    }

    /// Whether it is as good as was asked for.
    pub(super) fn is_done(&mut self) -> bool {
        self.done_by = self.done_by.or_else(|| self.ends_by());
        self.done_by.is_some()
    }

    fn ends_by(&mut self) -> Option<DoneBy> {
        let passes = self.rendering.passes();
        if passes == 0 {
            return None;
        }
        if passes >= self.measure_at {
            self.measure_at = passes + passes.div_ceil(4);
            if let (Some(target), Some(measured)) =
                (self.job.request.until.error, self.rendering.measured_error())
                // Eight passes: four in each half, the least that says something about the spread.
                && passes >= 8 && measured.reaches(target) && self.rendering.confirms(target)
            {
                return Some(DoneBy::Error);
            }
        }
        if passes >= self.samples_max {
            return Some(DoneBy::Samples);
        }
        (Instant::now() >= self.deadline).then_some(DoneBy::Time)
    }

    /// Packs and answers; takes up to a second for a large EXR, so not on the render thread.
    pub(super) fn finish(self) {
        let Drawing { job, rendering, started, seed, done_by, memory: _memory, .. } = self;
        let picture = rendering.picture();
        let measured = rendering.measured_error();
        let request = &job.request;
        let shown = || Display::new(request.tone_map, request.exposure_ev).show_all(&picture.radiance());
        let seconds = started.elapsed().as_secs_f64();
        let bytes = match request.format {
            PictureFormat::Png => images::png_small(&shown(), job.size),
            PictureFormat::Jpeg => images::jpeg(&shown(), job.size, JpegQuality::FILE),
            PictureFormat::Exr => {
                let facts = PictureFacts {
                    revision: job.snapshot.revision,
                    seed,
                    samples_per_pixel: rendering.passes(),
                    technique: rendering.technique_name(&picture),
                    error: measured.map(|measured| measured.error()),
                    error_ci: measured.map(|measured| measured.error_interval_95()),
                    seconds: Some(seconds),
                };
                images::encode_exr(&picture, ExrLayers::Plain, &facts)
            }
        };
        let (revision, samples) = (job.snapshot.revision, rendering.passes());
        // Given up ones are not answered.
        let done_by = done_by.unwrap_or(DoneBy::Time);
        // Who asked may have gone in the meantime.
        let picture = |bytes| RequestedPicture { bytes, revision, samples, measured, seconds, done_by };
        let _ = job.reply.send(bytes.map(picture));
    }
}
