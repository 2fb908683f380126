//! Pictures by the engine, for laws that hold of the whole of them.

use std::sync::{Arc, atomic::AtomicBool};

use lumicast_engine::{
    film::PictureSize,
    math::{Rgb, RunningStatistics},
    render::{IlluminationSettings, Indirect, RenderSettings, Rendering},
    transport::{PathClass, World},
};

/// Pictures of each kind, with seeds of their own: they say how far a mean may be off.
const PICTURES: u64 = 4;
const SIDE: u32 = 32;
/// What photons and records may be off by in the mean of a layer, in shares of the mean of the picture and of the layer.
const BIAS_MAX: [f64; 2] = [0.004, 0.04];

/// The light of these pictures is learnt by so many photons of as many as users have: learning it is most of their time, and fewer
/// only make it coarser, and make pictures of different seeds differ by more. `LUMICAST_NIGHTLY=1` takes all.
const PHOTONS_SHARE: u32 = 4;

/// A square picture of the scene's first camera, or of all of it: `side` × `side` pixels, `passes` samples each.
pub fn picture(world: &Arc<World>, side: u32, settings: RenderSettings, passes: u32) -> Rendering {
    let scene = world.scene();
    let view = scene.camera_view(None).unwrap_or_else(|| scene.default_view());
    let size = PictureSize::new(side, side).expect("a size");
    let mut light = IlluminationSettings::of(&settings);
    if std::env::var_os("LUMICAST_NIGHTLY").is_none() {
        light.photons.emitted_count /= PHOTONS_SHARE;
        light.octree.photon_count /= PHOTONS_SHARE;
    }
    let mut rendering = Rendering::learning_by((world.clone(), light), view, size, settings);
    while rendering.passes() < passes || !rendering.is_whole() {
        rendering.step(&AtomicBool::new(false));
    }
    rendering
}

/// Mean over pixels and channels.
pub fn mean(layer: &[Rgb]) -> f64 {
    layer.iter().map(|colour| f64::from(colour.mean())).sum::<f64>() / layer.len() as f64
}

/// What comparing found.
#[derive(Debug)]
pub struct Compared {
    /// Every layer that is off, in words.
    pub failures: Vec<String>,
    /// Share of caustics in the path-traced picture.
    pub caustic_share: f64,
}

/// Holds every layer of small pictures by a technique against the path tracer's, in the mean over the picture: no more off
/// than noise and what photons and records may be biased by.
pub fn compare_layers(name: &str, world: &Arc<World>, indirect: Indirect, passes: u32) -> Compared {
    let [path, found] = [Indirect::Path, indirect].map(|indirect| layers(world, indirect, passes));
    let whole: f64 = path.iter().map(RunningStatistics::mean).sum();
    let mut failures = Vec::new();
    for class in PathClass::ALL {
        let [expected, found] = [&path, &found].map(|layers| layers[class as usize]);
        let noise = expected.standard_error().hypot(found.standard_error());
        // Four pictures know their own spread to a third: six deviations.
        let allowed = BIAS_MAX[0] * whole + BIAS_MAX[1] * expected.mean() + 6.0 * noise;
        let off = found.mean() - expected.mean();
        if off.abs() > allowed || off.is_nan() {
            failures.push(format!(
                "{name}, {}: {:.4} for {:.4} ± {noise:.4} of {whole:.4}",
                class.name(),
                found.mean(),
                expected.mean(),
            ));
        }
    }
    Compared { failures, caustic_share: path[PathClass::Caustic as usize].mean() / whole }
}

/// Mean of every layer over pictures, none of which lost a sample.
fn layers(world: &Arc<World>, indirect: Indirect, passes: u32) -> [RunningStatistics; PathClass::COUNT] {
    let mut of_layers = [RunningStatistics::default(); PathClass::COUNT];
    for seed in 0..PICTURES {
        let rendering =
            picture(world, SIDE, RenderSettings { indirect, seed, ..RenderSettings::default() }, passes);
        assert_eq!(rendering.dropped_samples(), 0);
        for class in PathClass::ALL {
            of_layers[class as usize].add(mean(&rendering.film().layer(class)));
        }
    }
    of_layers
}
