//! First pictures after a camera has moved, which take their caustics from a sketch, on a card.

use super::*;
use crate::{
    effects::EffectPlan,
    gpu::{AdapterChoice, GpuOptions, tests::open_with},
    render::{Indirect, RenderSettings, Rendering},
    scene::samples,
    technique::caustics::{CausticSettings, CausticSketch},
};

/// The built-in scene with a sketch of its caustics.
struct First {
    world: Arc<World>,
    settings: RenderSettings,
    sketch: Arc<CausticSketch>,
}

impl First {
    fn new() -> First {
        let world = Arc::new(World::prepare(Arc::new(samples::cornell_box().unwrap())));
        let settings = RenderSettings { indirect: Indirect::Irradiance, ..RenderSettings::default() };
        let plan = EffectPlan::of(world.scene());
        let sketch = Arc::new(settings.sketch(&world, &plan).unwrap());
        First { world, settings, sketch }
    }

    /// By `gpu`, or the CPU.
    fn begun(&self, gpu: Option<&Arc<Gpu>>) -> Rendering {
        let plan = EffectPlan::of(self.world.scene());
        let view = self.world.scene().default_view();
        let mut rendering =
            Rendering::with((self.world.clone(), &plan), view, size(96, 72), self.settings, None);
        if let Some(gpu) = gpu {
            rendering.draw_on(Arc::new(GpuScene::new(Arc::clone(gpu), self.world.clone())));
        }
        rendering.begin_with(self.sketch.clone());
        rendering
    }

    fn drawn(&self, gpu: Option<&Arc<Gpu>>) -> Rendering {
        let mut rendering = self.begun(gpu);
        assert!(rendering.step(&AtomicBool::new(false)).complete);
        rendering
    }
}

/// A picture on a card shows the sketch in its first pass, drawn there, as the CPU draws it; and nothing of it in the next.
#[test]
fn first_pictures_on_a_card_show_the_sketch() {
    let Some(gpu) = shared() else { return };
    let first = First::new();
    let never = AtomicBool::new(false);
    let (mut card, mut cpu) = (first.drawn(Some(&gpu)), first.drawn(None));
    assert_eq!(
        (card.gpu_passes(), card.caustics().photons_emitted),
        (1, 0),
        "drawn on the card, with the sketch"
    );
    assert_alike(cpu.film(), card.film());
    let mean = |rendering: &Rendering| {
        rendering.film().layer(PathClass::Caustic).iter().map(|rgb| rgb.luminance()).sum::<f32>()
    };
    assert!(mean(&cpu) > 0.0);
    assert!((mean(&card) / mean(&cpu) - 1.0).abs() < 1e-3, "{} for {}", mean(&card), mean(&cpu));
    for rendering in [&mut card, &mut cpu] {
        assert!(rendering.step(&never).complete);
    }
    assert_eq!(card.gpu_passes(), 2);
    assert!(card.caustics().photons_emitted > 0, "photons of its own");
    assert_alike(cpu.film(), card.film());
}

/// A first pass that is cut goes on with what was counted, one whose device is lost counts anew, to the same bits.
#[test]
fn first_pictures_outlive_cuts_and_losses() {
    let Some(gpu) = open().map(Arc::new) else { return };
    let first = First::new();
    let undisturbed = first.drawn(Some(&gpu));
    let [never, at_once] = [false, true].map(AtomicBool::new);
    let mut cut = first.begun(Some(&gpu));
    assert!(!cut.step(&at_once).complete);
    assert!(cut.step(&never).complete);
    assert_same_bits(undisturbed.film(), cut.film());
    let mut lost = first.begun(Some(&gpu));
    assert!(!lost.step(&at_once).complete);
    gpu.session().unwrap().lose_for_test();
    while !lost.step(&never).complete {}
    assert_eq!((lost.gpu_passes(), lost.gpu_failure()), (1, None));
    assert_same_bits(undisturbed.film(), lost.film());
}

/// Where a sketch has no room on the card, or not even the scene, the CPU draws the first picture, and later ones are tried there; where it has
/// none beside the paths, the card gives up.
#[test]
fn first_pictures_without_room_for_the_sketch_are_drawn_on_the_cpu() {
    let Some(gpu) = shared() else { return };
    let first = First::new();
    let by_cpu = first.drawn(None);
    // Photons alone take more.
    let spare = 100_000;
    let scene = GpuScene::new(Arc::clone(&gpu), first.world.clone());
    scene.make_ready_to_sketch().unwrap();
    let of_scene = scene.bytes();
    scene.make_ready(Shading::default()).unwrap();
    let with_paths = scene.bytes();
    assert!(with_paths > of_scene + 2 * spare);
    for (bytes_max, stays) in [(of_scene + spare, true), (with_paths + spare, false), (1 << 16, true)] {
        let small = GpuOptions { adapter: AdapterChoice::Any, bytes_max, ..GpuOptions::default() };
        let small = open_with(&small).map(Arc::new).unwrap();
        let mut rendering = first.begun(Some(&small));
        while !rendering.step(&AtomicBool::new(false)).complete {}
        assert_eq!((rendering.gpu_passes(), rendering.is_on_gpu()), (0, stays), "{bytes_max} bytes");
        assert_same_bits(by_cpu.film(), rendering.film());
    }
}

/// Seen from so near that its photons say too little, a sketch is not used on a card either.
#[test]
fn first_pictures_from_near_find_photons_of_their_own_on_a_card() {
    let Some(gpu) = shared() else { return };
    let first = First::new();
    let few = CausticSettings { photons_max: 7, ..CausticSettings::for_sketch(None, 0) };
    let sketch = Arc::new(CausticSketch::of(&first.world, &few));
    let view = View::new(&first.world, &first.world.scene().default_view(), size(96, 72));
    assert!(sketch.seen_by(&view).is_none());
    let [card, cpu] = [Some(&gpu), None].map(|gpu| {
        let First { world, settings, .. } = First::new();
        First { world, settings, sketch: sketch.clone() }.drawn(gpu)
    });
    assert_eq!(card.gpu_passes(), 1);
    assert!(card.caustics().photons_emitted > 0);
    assert_alike(cpu.film(), card.film());
}
