//! What it takes to bring a scene to the card, before its first pixel.

use std::{error::Error, sync::Arc, time::Instant};

use lumicast_engine::{
    gpu::{Gpu, GpuTrees},
    technique::path::{Asked, GpuScene, Shading},
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
    drop(first);

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
    figures.push(Figure::new("shaders: compile", Unit::Seconds, shader_seconds));
    Ok(())
}
