use super::*;
use crate::config::Config;
use crate::scenes::lighting::Lighting;
use crate::scenes::request::{Job, PictureFormat, PictureRequest, Until};
use crate::scenes::{Snapshot, Workshop};
use lumicast_engine::effects::EffectPlan;
use lumicast_engine::film::{PictureSize, ToneMap};
use lumicast_engine::render::Indirect;
use lumicast_engine::scene::samples;
use lumicast_engine::transport::World;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// What draws pictures of the built-in box.
struct Studio {
    workshop: Arc<Workshop>,
    world: Arc<World>,
    lighting: Lighting,
    drawings: Vec<Drawing>,
    count: u64,
}

impl Studio {
    fn open() -> Studio {
        let world = World::prepare(Arc::new(samples::cornell_box().unwrap()));
        let config = Config { photons: 64_000, ..Config::default() };
        Studio {
            workshop: Arc::new(Workshop::open(config).unwrap()),
            world: Arc::new(world),
            lighting: Lighting::default(),
            drawings: Vec::new(),
            count: 0,
        }
    }

    fn begin(&mut self, camera: &str, seconds: u64, light_revision: u64) {
        let scene = self.world.scene();
        let plan = Arc::new(EffectPlan::of(scene));
        let world = self.world.clone();
        let snapshot = Arc::new(Snapshot { revision: light_revision, light_revision, world, plan });
        let until = Until { error: None, time: Duration::from_secs(seconds) };
        let request = PictureRequest {
            camera: None,
            size: None,
            format: PictureFormat::Png,
            technique: Indirect::Auto,
            until,
            tone_map: ToneMap::default(),
            exposure_ev: 0.0,
        };
        let job = Job {
            view: scene.camera_view(Some(camera)).unwrap(),
            size: PictureSize::new(16, 16).unwrap(),
            request,
            snapshot: snapshot.clone(),
            reply: tokio::sync::oneshot::channel().0,
        };
        self.count += 1;
        let others = (self.drawings.as_mut_slice(), self.count);
        let drawing = Drawing::begin(job, (&mut self.lighting, &snapshot), others, &self.workshop);
        self.drawings.push(drawing);
    }

    /// A step of one of them, as painters do it.
    fn turn_of(&mut self, index: usize) {
        let mut drawing = self.drawings.remove(index);
        drawing.take_turn(&mut self.drawings);
        self.workshop.drawing_pool.install(|| drawing.rendering.step(&AtomicBool::new(false)));
        self.drawings.insert(index, drawing);
    }

    fn end(&mut self, index: usize) -> Drawing {
        let mut drawing = self.drawings.remove(index);
        drawing.leave(&mut self.drawings);
        drawing
    }

    /// Those that have what they learn with.
    fn holders(&self) -> Vec<usize> {
        let holds = |index: &usize| self.drawings[*index].rendering.illumination().is_some();
        (0..self.drawings.len()).filter(holds).collect()
    }

    fn learners(&self) -> Vec<u64> {
        self.drawings.iter().filter_map(|drawing| Some(drawing.learns?.learner)).collect()
    }
}

/// Pictures of one light learn with one learner, which whoever has his turn holds, and whoever stays goes on
/// with when others are done; the last keeps it.
#[test]
fn pictures_at_once_have_one_learner() {
    let mut studio = Studio::open();
    for camera in ["main", "corner", "main"] {
        studio.begin(camera, 100, 1);
    }
    studio.begin("main", 100, 2);
    studio.begin("main", 1, 1);
    assert_eq!(studio.learners(), [1, 1, 1, 4, 1]);
    assert_eq!(studio.workshop.metrics.pictures_joined.value(), 3);
    assert_eq!(studio.holders(), [3, 4]);
    studio.end(4);
    studio.end(3);
    assert_eq!(studio.holders(), [0]);
    let (mut turns, mut lit_at) = (0, [None; 3]);
    while lit_at.contains(&None) {
        for index in [0, 1, 2] {
            studio.turn_of(index);
            assert_eq!(studio.holders(), [index]);
            let lit_at: &mut Option<u32> = &mut lit_at[index];
            if studio.drawings[index].rendering.looks_up() {
                *lit_at = lit_at.or(Some(turns));
            }
            turns += 1;
        }
        assert!(turns < 30_000, "{lit_at:?}");
    }
    // Whatever becomes known in the turn of one, the others show in their next.
    let all = lit_at.map(Option::unwrap);
    assert!(all.iter().max().unwrap() - all.iter().min().unwrap() <= 2, "{all:?}");
    // Who holds it goes, then one who does not.
    studio.turn_of(0);
    let mut first = studio.end(0);
    assert!(first.rendering.give_learner().is_none() && studio.holders() == [0]);
    studio.turn_of(1);
    studio.end(0);
    assert_eq!(studio.holders(), [0]);
    for _ in 0..30_000 {
        if studio.drawings[0].rendering.knows_its_light() {
            break;
        }
        studio.turn_of(0);
    }
    let mut last = studio.end(0);
    let learner = last.rendering.give_learner().unwrap();
    assert!(learner.knows_light_of_now() && last.rendering.passes() > 0);
}

/// One that comes while others learn begins with what they know by then.
#[test]
fn who_joins_shows_what_is_known() {
    let mut studio = Studio::open();
    studio.begin("main", 100, 1);
    for _ in 0..30_000 {
        if studio.drawings[0].rendering.looks_up() {
            break;
        }
        studio.turn_of(0);
    }
    studio.begin("corner", 100, 1);
    assert!(studio.drawings[1].rendering.looks_up() && studio.holders() == [1]);
    studio.end(1);
    assert_eq!(studio.holders(), [0], "who stays has it again");
}
