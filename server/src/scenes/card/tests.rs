//! A scene that stays on the card, leaves it and comes back.

use super::*;
use glam::{DAffine3, DVec3};
use lumicast_engine::effects::EffectPlan;
use lumicast_engine::film::PictureSize;
use lumicast_engine::math::Rgb;
use lumicast_engine::render::RenderSettings;
use lumicast_engine::scene::{Id, Material, SceneBuilder, SceneLimits, samples};

fn snapshot_of(world: Arc<World>, revision: u64) -> Snapshot {
    let plan = Arc::new(EffectPlan::of(world.scene()));
    Snapshot { revision, light_revision: revision, world, plan }
}

fn edited(before: &Snapshot, edit: impl FnOnce(&mut SceneBuilder)) -> Snapshot {
    let mut builder = SceneBuilder::from_scene(before.world.scene(), SceneLimits::default());
    edit(&mut builder);
    let (scene, change) = builder.finish();
    snapshot_of(Arc::new(before.world.update(Arc::new(scene), &change)), before.revision + 1)
}

fn picture_of(snapshot: &Snapshot) -> Rendering {
    let view = snapshot.world.scene().default_view();
    let size = PictureSize::new(8, 8).unwrap();
    let settings = RenderSettings { backend: Backend::Gpu, ..RenderSettings::default() };
    Rendering::with((snapshot.world.clone(), &snapshot.plan), view, size, settings, None)
}

/// While a lamp or a thing is dragged a small scene stays on the card, and pictures of it as it is now are drawn there at once, those of
/// before on the CPU; where steps are to be compiled anew all leave.
#[test]
fn scenes_stay_on_the_card_while_they_are_edited() {
    let workshop = match Workshop::open(Config { backend: "gpu".into(), ..Config::default() }) {
        Ok(workshop) => workshop,
        Err(error) => {
            let is_required = std::env::var("LUMICAST_GPU").as_deref() == Ok("required");
            assert!(!is_required, "LUMICAST_GPU=required, and {error}");
            eprintln!("SKIPPED: {error}");
            return;
        }
    };
    // However busy the machine is.
    let mut on_card = SceneOnCard::default();
    on_card.followed_seconds = 3600.0;
    let is_drawn_on = |on_card: &SceneOnCard, picture: &mut Rendering| {
        on_card.draw(picture, &workshop);
        picture.gpu_scene().is_some()
    };
    let world = World::prepare(Arc::new(samples::cornell_box().unwrap()));
    let mut now = snapshot_of(Arc::new(world), 1);
    let start = Instant::now();
    while !matches!(on_card.stage, Stage::Ready) {
        assert!(start.elapsed() < Duration::from_secs(120), "{on_card:?}");
        on_card.follow(&now, &workshop, true);
        std::thread::yield_now();
    }
    let mut picture = picture_of(&now);
    assert!(is_drawn_on(&on_card, &mut picture));
    for step in 1..5 {
        let lamp = Material::emitter(Rgb::splat(10.0 * step as f32));
        now = edited(&now, |builder| builder.set_material(Id::new("lamp").unwrap(), lamp).unwrap());
        if step > 2 {
            let moved = DAffine3::from_translation(DVec3::new(0.02 * f64::from(step), 0.0, 0.0));
            now = edited(&now, |builder| builder.set_transform("glass ball", moved).unwrap());
        }
        on_card.follow(&now, &workshop, true);
        assert!(!is_drawn_on(&on_card, &mut picture), "it is of the scene before");
        picture = picture_of(&now);
        assert!(is_drawn_on(&on_card, &mut picture), "step {step}");
    }
    let masked = Material { alpha_cutoff: Some(0.5), ..Material::lambert(Rgb::WHITE) };
    now = edited(&now, |builder| builder.set_material(Id::new("green").unwrap(), masked).unwrap());
    on_card.follow(&now, &workshop, true);
    assert!(!is_drawn_on(&on_card, &mut picture) && !is_drawn_on(&on_card, &mut picture_of(&now)));
    assert!(on_card.scene.is_none());
}
