//! What it takes to bring a scene to the card, before its first pixel.

use std::{error::Error, sync::Arc, time::Instant};

use glam::DVec3;
use lumicast_engine::{
    gpu::{Gpu, GpuTrees},
    math::Rgb,
    scene::{Id, Light, LightKind, SceneBuilder, SceneLimits},
    technique::path::{Asked, GpuScene, Shading},
    transport::World,
};

use crate::{
    figures::{Figure, SceneFigures, Unit},
    median,
    subject::Subject,
};

const BY_OCTREE: Shading = Shading { asked: Some(Asked::Octree), is_focused: false };

/// Packing counts, waiting for the card too. Shaders are compiled once: their seconds are those of the first time.
pub(crate) fn measure(
    subject: &Subject,
    gpu: &Arc<Gpu>,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let world = &subject.world;
    let session = gpu.session()?;
    let first = GpuScene::new(gpu.clone(), world.clone());
    first.make_ready(BY_OCTREE)?;
    let shader_seconds = first.shader_seconds();
    let relit = relit(world, first, rounds)?;

    let (mut trees, mut all) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        let start = Instant::now();
        let on_card = GpuTrees::new(&session, &world.accel().upload())?;
        session.batch("bytes that were sent")?.submit()?.wait()?;
        trees.push(1e3 * start.elapsed().as_secs_f64());
        drop(on_card);

        let start = Instant::now();
        let scene = GpuScene::new(gpu.clone(), world.clone());
        scene.make_ready(BY_OCTREE)?;
        all.push(1e3 * (start.elapsed().as_secs_f64() - scene.shader_seconds()));
    }
    let tree_bytes = world.accel().upload().bytes() as f64;
    let all_bytes = tree_bytes + world.upload().bytes() as f64;
    figures.push(Figure::new("trees: pack and upload", Unit::Milliseconds, median(trees)));
    figures.push(Figure::new("trees", Unit::Bytes, tree_bytes));
    figures.push(Figure::new("scene with trees: pack and upload", Unit::Milliseconds, median(all)));
    figures.push(Figure::new("scene with trees", Unit::Bytes, all_bytes));
    figures.push(Figure::new("another light on a scene: pack and upload", Unit::Milliseconds, median(relit)));
    figures.push(Figure::new("shaders: compile", Unit::Seconds, shader_seconds));
    Ok(())
}

/// Milliseconds that the scene takes to follow edits of its light, and to be ready to draw.
fn relit(world: &Arc<World>, on_card: GpuScene, rounds: usize) -> Result<Vec<f64>, Box<dyn Error>> {
    let under = |strength: f32| -> Result<Arc<World>, Box<dyn Error>> {
        let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
        let kind = LightKind::Point { intensity: Rgb::splat(strength) };
        let point = Light { parent: None, position: DVec3::Y, direction: DVec3::NEG_Y, kind };
        builder.add_light(Id::new("one more").ok_or("no name for a light")?, point)?;
        let (scene, change) = builder.finish();
        Ok(Arc::new(world.update(Arc::new(scene), &change)))
    };
    let worlds = [under(0.1)?, under(0.2)?];
    let follow = |before: &GpuScene, round: usize| before.followed(&worlds[round % 2], 0.0);
    let mut scene = follow(&on_card, 1)?.ok_or("the scene does not follow its light")?;
    let mut milliseconds = Vec::new();
    for round in 0..rounds {
        let start = Instant::now();
        scene = follow(&scene, round)?.ok_or("the scene does not follow its light")?;
        scene.make_ready(BY_OCTREE)?;
        milliseconds.push(1e3 * start.elapsed().as_secs_f64());
    }
    Ok(milliseconds)
}
