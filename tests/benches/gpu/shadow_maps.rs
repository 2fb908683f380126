//! Maps of shadows: drawn by the card, and by rays on the CPU.

use std::error::Error;

use lumicast_engine::technique::path::GpuScene;

use crate::{
    figures::{Figure, SceneFigures, Unit},
    median, warmed,
};

/// Share of the texels that may see something else: small triangles have many edges near texels' middles.
const DIFFERING_MAX: f64 = 0.02;

/// Milliseconds of either; nothing where no light has a map.
pub(crate) fn measure(
    scene: &GpuScene,
    rounds: usize,
    figures: &mut SceneFigures<'_>,
) -> Result<(), Box<dyn Error>> {
    let (mut of_card, mut of_cpu, mut texels) = (Vec::new(), Vec::new(), 0);
    for round in 0..=rounds {
        let Some(drawn) = warmed(scene.gpu(), || Ok(scene.compare_shadow_maps()?))? else { return Ok(()) };
        if drawn.differing as f64 > DIFFERING_MAX * drawn.texels as f64 {
            let message = format!("{} of {} texels see something else", drawn.differing, drawn.texels);
            return Err(message.into());
        }
        // The first round compiles.
        if round > 0 {
            of_card.push(1e3 * drawn.card_seconds);
            of_cpu.push(1e3 * drawn.ray_seconds);
        }
        texels = drawn.texels;
    }
    let name = format!("maps of shadows, {:.1} M texels (CPU: rays)", texels as f64 * 1e-6);
    let figure = Figure::new(name, Unit::Milliseconds, median(of_card));
    figures.push(Figure { cpu: Some(median(of_cpu)), ..figure });
    Ok(())
}
