//! First pictures after a camera has moved, which take their caustics from a sketch, on a card.

use std::time::Duration;

use super::{known_light::with_known, *};
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
    size: PictureSize,
}

impl First {
    fn new() -> First {
        let world = Arc::new(World::prepare(Arc::new(samples::cornell_box().unwrap())));
        let settings = RenderSettings { indirect: Indirect::Irradiance, ..RenderSettings::default() };
        let plan = EffectPlan::of(world.scene());
        let sketch = Arc::new(settings.sketch(&world, &plan).unwrap());
        First { world, settings, sketch, size: size(96, 72) }
    }

    fn on(&self, gpu: &Arc<Gpu>) -> Arc<GpuScene> {
        Arc::new(GpuScene::new(Arc::clone(gpu), self.world.clone()))
    }

    fn view(&self) -> View {
        View::new(&self.world, &self.world.scene().default_view(), self.size)
    }

    /// On `scene`, or by the CPU.
    fn begun(&self, scene: Option<Arc<GpuScene>>) -> Rendering {
        let plan = EffectPlan::of(self.world.scene());
        let view = self.world.scene().default_view();
        let mut rendering =
            Rendering::with((self.world.clone(), &plan), view, self.size, self.settings, None);
        if let Some(scene) = scene {
            rendering.draw_on(scene);
        }
        rendering.begin_with(self.sketch.clone());
        rendering
    }

    /// By `gpu`, or the CPU.
    fn drawn(&self, gpu: Option<&Arc<Gpu>>) -> Rendering {
        let mut rendering = self.begun(gpu.map(|gpu| self.on(gpu)));
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

/// A first pass that is cut between two slices goes on with what was counted, and one whose device is lost there counts anew; both keep what
/// was drawn, and end with the same bits.
#[test]
fn first_pictures_outlive_cuts_and_losses() {
    // Of several slices, however they grow.
    let first = First { size: size(192, 144), ..First::new() };
    let pixel_count = first.size.pixel_count() as u64;
    for is_lost in [false, true] {
        // What it compiles with the first slice takes so long that the cut falls into that.
        let Some(gpu) = open().map(Arc::new) else { return };
        let mut cut = first.begun(Some(first.on(&gpu)));
        assert!(!cut.step(&AtomicBool::new(true)).complete);
        let mut path_count = 0;
        let mut after = Duration::from_millis(5);
        while path_count == 0 {
            let cancel = AtomicBool::new(false);
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    std::thread::park_timeout(after);
                    cancel.store(true, Ordering::Relaxed);
                });
                path_count += cut.step(&cancel).counts.paths;
            });
            after *= 2;
        }
        assert!(path_count < pixel_count, "all {path_count} paths were drawn before it was cut");
        if is_lost {
            gpu.session().unwrap().lose_for_test();
        }
        let mut is_complete = false;
        while !is_complete {
            let progress = cut.step(&AtomicBool::new(false));
            (is_complete, path_count) = (progress.complete, path_count + progress.counts.paths);
        }
        // A pass begins anew with another light: had the sketch been counted as another, paths would have been drawn twice.
        assert_eq!(path_count, pixel_count, "each path once");
        assert_eq!((cut.gpu_passes(), cut.gpu_failure()), (1, None));
        assert_eq!(gpu.session().unwrap().generation(), u64::from(is_lost));
        // This one and the picture's: what its camera sees is gone.
        assert_eq!(Arc::strong_count(&first.sketch), 2);
        assert_same_bits(first.drawn(Some(&gpu)).film(), cut.film());
    }
}

/// That a card counts a sketch says nothing of whether it draws: losses count on until a pass is finished.
#[test]
fn counting_a_sketch_excuses_no_losses() {
    let Some(gpu) = shared() else { return };
    let first = First::new();
    let scene = first.on(&gpu);
    scene.losses.store(LOSSES_MAX, Ordering::Relaxed);
    assert_eq!(scene.is_fit(&first.sketch.for_card(&first.view()).unwrap()), Ok(true));
    assert_eq!(scene.losses.load(Ordering::Relaxed), LOSSES_MAX);
    let mut rendering = first.begun(Some(scene.clone()));
    assert!(rendering.step(&AtomicBool::new(false)).complete && rendering.gpu_passes() == 1);
    assert_eq!(scene.losses.load(Ordering::Relaxed), 0);
}

/// Where a sketch has no room on the card, neither alone nor beside the paths, or not even the scene has, the CPU draws the first picture, and
/// nothing has failed: the card is tried for later ones.
#[test]
fn first_pictures_without_room_for_the_sketch_are_drawn_on_the_cpu() {
    // A device of its own, whose bytes are those of this test.
    let Some(gpu) = open().map(Arc::new) else { return };
    // Of no more paths than places are made ready for.
    let first = First { size: size(64, 60), ..First::new() };
    let by_cpu = first.drawn(None);
    // Photons alone take more.
    let spare = 100_000;
    let scene = first.on(&gpu);
    scene.make_ready_to_sketch().unwrap();
    let of_scene = scene.bytes();
    scene.make_ready(Shading::default()).unwrap();
    let with_paths = scene.bytes();
    assert!(with_paths > of_scene + 2 * spare);
    for bytes_max in [of_scene + spare, with_paths + spare, 1 << 16] {
        let small = GpuOptions { adapter: AdapterChoice::Any, bytes_max, ..GpuOptions::default() };
        let small = open_with(&small).map(Arc::new).unwrap();
        let scene = first.on(&small);
        let sketch = first.sketch.for_card(&first.view()).unwrap();
        let fits_alone = scene.is_fit(&sketch) == Ok(true);
        assert_eq!(fits_alone, bytes_max == with_paths + spare, "{bytes_max} bytes");
        let mut rendering = first.begun(Some(scene));
        while !rendering.step(&AtomicBool::new(false)).complete {}
        let on_card = (rendering.gpu_passes(), rendering.gpu_failure(), rendering.is_on_gpu());
        assert_eq!(on_card, (0, None, true), "{bytes_max} bytes");
        assert_same_bits(by_cpu.film(), rendering.film());
    }
}

/// Light that others look up stays on the card where a sketch has no room beside it: as it is counted, and as it is drawn with.
#[test]
fn sketches_drive_no_light_of_others_off_the_card() {
    let options = |bytes_max| GpuOptions { adapter: AdapterChoice::Any, bytes_max, ..GpuOptions::default() };
    let Some(gpu) = open_with(&options(u64::MAX)).map(Arc::new) else { return };
    let known = with_known(samples::cornell_box().unwrap(), None);
    let bytes_with = |gpu| {
        let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&known.world)));
        known.on_card(&scene, 0);
        (scene.bytes(), scene)
    };
    let (alone, _) = bytes_with(gpu);
    // Room for samples on their way back, and not for photons.
    let room = known.size.pixel_count() as u64 * SAMPLE_BYTES + 1_000;
    let (bytes, scene) = bytes_with(Arc::new(open_with(&options(alone + room)).unwrap()));
    assert_eq!(bytes, alone);
    let sketch = CausticSketch::of(&known.world, &CausticSettings::for_sketch(None, 3));
    let view = View::new(&known.world, &known.camera, known.size);
    let sketched = Shot { focused: Arc::new(sketch).for_card(&view), ..known.clone() };
    let counted = scene.is_fit(sketched.focused.as_ref().unwrap());
    assert!(matches!(counted, Err(GpuError::LightTooLarge { .. })), "{counted:?}");
    assert_eq!(scene.bytes(), alone);
    let mut tracer = sketched.tracer(&scene);
    let progress = step(&mut tracer, &sketched, &mut Film::new(known.size), false);
    assert_eq!((progress, tracer.failure(), tracer.refuses_sketches()), (Progress::default(), None, true));
    assert_eq!(scene.bytes(), alone);
}

/// What is drawn of a scene without caustics compiles nothing that counts sketches.
#[test]
fn scenes_without_caustics_compile_nothing_for_sketches() {
    let counting = |gpu: &Gpu| {
        let compiled = gpu.session().unwrap().compiled();
        assert!(compiled.contains(&"path/turn"), "{compiled:?}");
        compiled.iter().filter(|step| step.starts_with("caustics/")).count()
    };
    let [Some(gpu), Some(other)] = [open(), open()].map(|gpu| gpu.map(Arc::new)) else { return };
    let first = First::new();
    first.drawn(Some(&gpu));
    assert_eq!(counting(&gpu), 6);
    let world = Arc::new(World::prepare(Arc::new(samples::boxes().unwrap())));
    let plan = EffectPlan::of(world.scene());
    assert!(first.settings.sketch(&world, &plan).is_none());
    let without = First { world, ..first };
    let mut without = without.begun(Some(without.on(&other)));
    assert!(!without.takes_sketch());
    assert!(without.step(&AtomicBool::new(false)).complete && without.gpu_passes() == 1);
    assert_eq!(counting(&other), 0);
}

/// Seen from so near that its photons say too little, a sketch is not used on a card either.
#[test]
fn first_pictures_from_near_find_photons_of_their_own_on_a_card() {
    let Some(gpu) = shared() else { return };
    let first = First::new();
    let few = CausticSettings { photons_max: 7, ..CausticSettings::for_sketch(None, 0) };
    let sketch = Arc::new(CausticSketch::of(&first.world, &few));
    assert!(sketch.seen_by(&first.view()).is_none());
    let [card, cpu] =
        [Some(&gpu), None].map(|gpu| First { sketch: sketch.clone(), ..First::new() }.drawn(gpu));
    assert_eq!(card.gpu_passes(), 1);
    assert!(card.caustics().photons_emitted > 0);
    assert_alike(cpu.film(), card.film());
}
