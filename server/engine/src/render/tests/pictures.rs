//! Pictures: by every technique all of the light is in them, and they say how far they are from it.

use std::{
    sync::atomic::{AtomicI64, Ordering},
    time::{Duration, Instant},
};

use super::*;
use crate::{
    film::{Denoising, Film, Outdated, Picture},
    scene::CameraView,
    technique::{Card, ScatteredLight, SecondaryLight},
    transport::Surface,
};

/// Direct light by sampling and the rest by the octree add up to what the furnace holds, E / (1 − ρ), and a scene without
/// surface is dark and done.
#[test]
fn pictures_by_the_octree_show_all_the_light() {
    let world = Arc::new(world_of(samples::furnace(0.6, 0.5).unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let size = PictureSize::new(48, 48).unwrap();
    let settings = RenderSettings { indirect: Indirect::Octree, ..RenderSettings::default() };
    let picture = |world: &Arc<World>, view| {
        let mut rendering = Rendering::new(world.clone(), view, size, settings);
        while rendering.passes() < 8 {
            rendering.step(&AtomicBool::new(false));
        }
        assert!(rendering.knows_its_light());
        rendering.picture().radiance()
    };
    let radiance = picture(&world, view);
    let mean = radiance.iter().map(|rgb| rgb.mean()).sum::<f32>() / radiance.len() as f32;
    // 600,000 photons in maps and 18,432 samples: a few tenths of a percent.
    assert!((mean / 1.25 - 1.0).abs() < 0.01, "{mean}");
    let empty = Arc::new(world_of(Scene::default()));
    let dark = picture(&empty, empty.scene().default_view());
    assert!(dark.iter().all(|rgb| rgb.is_black()));
}

/// Direct light by sampling and the rest by records add up to what the furnace holds; with bounds on scatterings to the first
/// terms of its series.
#[test]
fn pictures_by_irradiance_records_show_all_the_light() {
    let world = Arc::new(world_of(samples::furnace(0.6, 0.5).unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let size = PictureSize::new(32, 32).unwrap();
    let series = |bounces: i32| 0.5 * (1.0 - 0.6f32.powi(bounces + 1)) / (1.0 - 0.6);
    for (bounces_max, expected) in
        [(None, 1.25), (Some(1), series(1)), (Some(2), series(2)), (Some(3), series(3))]
    {
        let settings =
            RenderSettings { indirect: Indirect::Irradiance, bounces_max, ..RenderSettings::default() };
        let mut rendering = Rendering::new(world.clone(), view, size, settings);
        while rendering.passes() < 8 {
            rendering.step(&AtomicBool::new(false));
        }
        assert!(rendering.knows_its_light());
        assert_eq!(rendering.records().count > 0, bounces_max != Some(1));
        let radiance = rendering.picture().radiance();
        let mean = radiance.iter().map(|rgb| rgb.mean()).sum::<f32>() / radiance.len() as f32;
        assert!((mean / expected - 1.0).abs() < 0.01, "{bounces_max:?}: {mean} for {expected}");
    }
}

/// The same bytes by records, whatever the number of threads.
#[test]
fn records_do_not_depend_on_threads() {
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let size = PictureSize::new(24, 24).unwrap();
    let settings =
        RenderSettings { indirect: Indirect::Irradiance, bounces_max: Some(2), ..RenderSettings::default() };
    let picture = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut rendering = Rendering::new(world.clone(), view, size, settings);
            while rendering.passes() < 2 {
                rendering.step(&AtomicBool::new(false));
            }
            rendering.film().radiance()
        })
    };
    assert_eq!(picture(1), picture(2));
}

/// An edit that moves render space's origin leaves nothing of what was known around the old one.
#[test]
fn a_new_origin_makes_old_light_unknown() {
    let world = world_of(samples::cornell_box().unwrap());
    let mut illumination = Illumination::new(settings(3_000, 4));
    let never = AtomicBool::new(false);
    while illumination.stage() != Stage::Complete {
        illumination.step(&world, &never);
    }
    let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
    let far = DAffine3::from_translation(DVec3::new(5e4, 0.0, 0.0));
    builder.set_transform("tall block", far).unwrap();
    let (scene, change) = builder.finish();
    let after = world.update(Arc::new(scene), &change);
    assert_ne!(world.accel().origin_in_world(), after.accel().origin_in_world());
    let generation = illumination.generation();
    illumination.apply(&Edit { before: &world, after: &after, change: &change });
    assert!(illumination.known().is_none() && illumination.generation() > generation);
}

/// The whole chain shows all the light, says how far it is from it, path tracing takes part once the rest is as good as it
/// gets, and nothing of it depends on the number of threads.
#[test]
fn the_best_there_is_shows_all_the_light_and_measures_itself() {
    let world = Arc::new(world_of(samples::boxes().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let size = PictureSize::new(24, 24).unwrap();
    let never = AtomicBool::new(false);
    let draw = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let learning = Learning::InStep;
        let settings = RenderSettings {
            indirect: Indirect::Auto,
            bounces_max: Some(3),
            learning,
            seed: 3,
            ..RenderSettings::default()
        };
        pool.install(|| {
            let mut rendering = Rendering::new(world.clone(), view, size, settings);
            let mut techniques = Vec::new();
            while !rendering.knows_its_light() || rendering.picture().traced_share() < 0.05 {
                rendering.step(&never);
                assert!(rendering.passes() < 20_000);
                if rendering.is_whole() && rendering.passes() > 0 {
                    techniques.push(rendering.technique_name(&rendering.picture()));
                }
            }
            techniques.dedup();
            (rendering.picture().radiance(), rendering.measured_error().unwrap(), techniques)
        })
    };
    let (radiance, error, techniques) = draw(1);
    assert_eq!(techniques[0], "octree");
    assert!(techniques.contains(&"irradiance") && techniques.last() == Some(&"irradiance+path"));
    let settings = RenderSettings { bounces_max: Some(3), seed: 4, ..RenderSettings::default() };
    let mut reference = Rendering::new(world.clone(), view, size, settings);
    while reference.passes() < 2048 {
        reference.step(&never);
    }
    let truth = compare(&radiance, &reference.picture().radiance()).unwrap();
    let noise = reference.measured_error().unwrap().rel_mse;
    let true_error = (truth.rel_mse - noise).max(0.0);
    // One picture, stopped at a moment that was not chosen blindly: how often intervals hold the truth has a test of its own.
    let [low, high] = error.interval_95;
    let is_near = low / 2.0 < truth.rel_mse && 2.0 * high > true_error;
    assert!(truth.bias.abs() < 0.02 && is_near && high.sqrt() < 0.1, "{error:?} {truth:?}");
    assert_eq!(draw(2), (radiance, error, techniques));
}

/// Where only doubt is left of whether a picture has the error asked for, measuring takes as much work as drawing, so it ends
/// sooner, and the same whatever the number of threads.
#[test]
fn doubt_of_an_error_is_settled_by_measuring() {
    let world = Arc::new(world_of(samples::boxes().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let size = PictureSize::new(48, 32).unwrap();
    // Its records cannot do better than 0.0098 (against 40,000 samples of path tracing).
    const TARGET: f64 = 0.015;
    let draw = |target: Option<f64>, seed: u64, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (indirect, learning) = (Indirect::Irradiance, Learning::InStep);
        let settings = RenderSettings { indirect, learning, seed, ..RenderSettings::default() };
        pool.install(|| {
            let mut rendering = Rendering::new(world.clone(), view, size, settings);
            rendering.aim_at(target);
            let is_done = |rendering: &Rendering| {
                let measured = rendering.measured_error();
                rendering.knows_its_light()
                    && measured.is_some_and(|measured| measured.reaches(TARGET))
                    && (target.is_none() || rendering.confirms(TARGET))
            };
            while rendering.passes() < 2 || !rendering.is_whole() || !is_done(&rendering) {
                rendering.step(&AtomicBool::new(false));
                assert!(rendering.passes() < 20_000);
            }
            (rendering.passes(), rendering.counts(), rendering.picture().radiance())
        })
    };
    let drawn = [1, 2].map(|seed| [Some(TARGET), None].map(|target| draw(target, seed, 1)));
    // Of two pictures: one may seem good enough by a lucky look, long before it surely is.
    let [aimed, blind] = [0, 1].map(|which| {
        let passes = drawn.iter().map(|drawn| drawn[which].0).sum::<u32>();
        (passes, drawn.iter().map(|drawn| drawn[which].1.all_rays()).sum::<u64>())
    });
    assert!(2 * aimed.0 < blind.0, "{} samples for {}", aimed.0, blind.0);
    assert!(aimed.1 < blind.1, "{} rays for {}", aimed.1, blind.1);
    assert_eq!(draw(Some(TARGET), 1, 3), drawn[0][0]);
}

/// A picture that is found as good as asked for is so once other pixels, taken since then, say the same; what was said of one error
/// says nothing of another.
#[test]
fn a_lucky_look_ends_no_picture() {
    let world = Arc::new(world_of(samples::boxes().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let size = PictureSize::new(48, 32).unwrap();
    const TARGET: f64 = 0.05;
    let (indirect, learning) = (Indirect::Irradiance, Learning::InStep);
    let settings = RenderSettings { indirect, learning, seed: 2, ..RenderSettings::default() };
    let mut rendering = Rendering::new(world.clone(), view, size, settings);
    rendering.aim_at(Some(TARGET));
    let step_until = |rendering: &mut Rendering, is_over: &dyn Fn(&Rendering) -> bool| {
        while !is_over(rendering) {
            rendering.step(&AtomicBool::new(false));
            assert!(rendering.passes() < 5_000);
        }
    };
    let reaches =
        |rendering: &Rendering| rendering.measured_error().is_some_and(|measured| measured.reaches(TARGET));
    step_until(&mut rendering, &reaches);
    assert!(!rendering.confirms(TARGET), "no pixel was taken since");
    let rays = rendering.counts().all_rays();
    step_until(&mut rendering, &|rendering| rendering.confirms(TARGET));
    assert!(reaches(&rendering) && rendering.counts().all_rays() > rays);
    rendering.aim_at(Some(0.5 * TARGET));
    assert!(!rendering.confirms(0.5 * TARGET) && !rendering.confirms(TARGET));
}

/// Where a lit scene's camera sees nothing, a picture is right after some samples, and done.
#[test]
fn a_look_at_nothing_ends() {
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let out = DVec3::new(0.0, 1.0, 50.0);
    let view = CameraView::look_at(out, out + DVec3::Z, DVec3::Y, 0.7);
    for indirect in [Indirect::Octree, Indirect::Irradiance, Indirect::Auto] {
        let settings = RenderSettings { indirect, learning: Learning::InStep, ..RenderSettings::default() };
        let size = PictureSize::new(16, 16).unwrap();
        let mut rendering = Rendering::new(world.clone(), view, size, settings);
        rendering.aim_at(Some(0.02));
        while !rendering.confirms(0.02) {
            rendering.step(&AtomicBool::new(false));
            assert!(rendering.passes() < 256, "{indirect:?}");
        }
        assert!(rendering.measured_error().unwrap().reaches(0.02), "{indirect:?}");
    }
}

/// With one bounce nothing is learnt, and the best there is is the path tracer.
#[test]
fn one_bounce_needs_no_chain() {
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let size = PictureSize::new(16, 16).unwrap();
    let picture = |indirect| {
        let settings = RenderSettings { indirect, bounces_max: Some(1), ..RenderSettings::default() };
        let mut rendering = Rendering::new(world.clone(), view, size, settings);
        (0..4).for_each(|_| {
            rendering.step(&AtomicBool::new(false));
        });
        assert_eq!((rendering.technique_name(&rendering.picture()), rendering.passes()), ("path", 4));
        rendering.picture().radiance()
    };
    for indirect in [Indirect::Auto, Indirect::Octree, Indirect::Irradiance] {
        assert_eq!(picture(indirect), picture(Indirect::Path), "{indirect:?}");
    }
}

/// A sketch of the caustics shows in the first pass, and nothing of it is left after the next.
#[test]
fn a_sketch_of_caustics_is_for_the_first_pass_alone() {
    let scene = samples::cornell_box().unwrap();
    let view = scene.default_view();
    let world = Arc::new(world_of(scene));
    let plan = EffectPlan::of(world.scene());
    let settings = RenderSettings { indirect: Indirect::Irradiance, ..RenderSettings::default() };
    let size = PictureSize::new(256, 192).unwrap();
    let never = AtomicBool::new(false);
    let mut brighter = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
    let lamp = world.scene().materials().iter().find(|(_, material)| !material.emission.is_black());
    let (id, material) = lamp.unwrap();
    let emission = material.emission * 100.0;
    brighter.set_material(id.clone(), Material { emission, ..Material::clone(material) }).unwrap();
    let brighter = world_of(brighter.finish().0);
    let pictures = [None, Some(&*world), Some(&brighter)].map(|sketched| {
        let mut rendering = Rendering::with((world.clone(), &plan), view, size, settings, None);
        if let Some(sketched) = sketched {
            rendering.begin_with(Arc::new(settings.sketch(sketched, &plan).unwrap()));
        }
        assert!(rendering.step(&never).complete);
        let first = rendering.film().layer(PathClass::Caustic);
        (0..2).for_each(|_| assert!(rendering.step(&never).complete));
        (first, rendering.film().layer(PathClass::Caustic))
    });
    // Cut short, it goes on with the same sketch.
    let mut cut = Rendering::with((world.clone(), &plan), view, size, settings, None);
    let sketch = Arc::new(settings.sketch(&world, &plan).unwrap());
    cut.begin_with(sketch.clone());
    assert!(!cut.step(&AtomicBool::new(true)).complete);
    cut.begin_with(sketch);
    assert!(cut.step(&never).complete && !cut.takes_sketch());
    assert!(cut.film().layer(PathClass::Caustic) == pictures[1].0);
    let mean = |layer: &[Rgb]| layer.iter().map(|value| value.luminance()).sum::<f32>() / layer.len() as f32;
    let [photons, sketch, bright] = pictures.each_ref().map(|(first, _)| mean(first));
    assert!((sketch / photons - 1.0).abs() < 0.15, "{sketch} sketched, {photons} by photons of its own");
    assert!((bright / sketch / 100.0 - 1.0).abs() < 0.01, "{bright} for {sketch}");
    assert!(pictures[1].1 == pictures[2].1);
    assert!((mean(&pictures[1].1) / mean(&pictures[0].1) - 1.0).abs() < 0.1);
}

/// Before anything is known, whoever watches sees all the light there is, path-traced; a single picture begins with light that comes
/// straight from lamps, and so does one with a bound that leaves nothing else.
#[test]
fn who_watches_sees_light_that_is_not_known_yet() {
    let world = Arc::new(world_of(samples::furnace(0.5, 0.25).unwrap()));
    let plan = EffectPlan::of(world.scene());
    let radiance = |indirect, learning, bounces_max| {
        let settings = RenderSettings { indirect, learning, bounces_max, ..RenderSettings::default() };
        let size = PictureSize::new(32, 32).unwrap();
        let view = world.scene().camera_view(None).unwrap();
        let mut rendering = Rendering::with((world.clone(), &plan), view, size, settings, None);
        assert!(rendering.step(&AtomicBool::new(false)).complete && !rendering.looks_up());
        let radiance = rendering.picture().radiance();
        radiance.iter().map(|value| value.luminance()).sum::<f32>() / radiance.len() as f32
    };
    let soon = Learning::Alongside { until: Some(Instant::now() + Duration::from_secs(1)) };
    let watching = Learning::Alongside { until: None };
    for indirect in [Indirect::Octree, Indirect::Irradiance] {
        // A closed room of emission 0.25 and albedo 1/2: 0.25 · (1 + 1/2 + 1/4 + …).
        let all = radiance(indirect, watching, None);
        assert!((all / 0.5 - 1.0).abs() < 0.01, "{indirect:?}: {all}");
        for (learning, bounces_max) in [(soon, None), (Learning::InStep, None), (watching, Some(1))] {
            let straight = radiance(indirect, learning, bounces_max);
            assert!((straight / 0.375 - 1.0).abs() < 0.01, "{indirect:?}, {learning:?}: {straight}");
        }
        let emitted = radiance(indirect, watching, Some(0));
        assert!((emitted / 0.25 - 1.0).abs() < 0.01, "{indirect:?}: {emitted}");
        // What no picture shows is not learnt.
        for (bounces, learns) in [(0, false), (1, false), (2, true)] {
            let settings =
                RenderSettings { indirect, bounces_max: Some(bounces), ..RenderSettings::default() };
            assert_eq!(settings.learns(&plan).is_some(), learns, "{indirect:?}, {bounces}");
        }
    }
}

/// Where everything is path-traced until something is known, no sketch is followed or shown.
#[test]
fn chains_take_no_sketch_before_anything_is_known() {
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let plan = EffectPlan::of(world.scene());
    let takes = |indirect| {
        let settings = RenderSettings { indirect, ..RenderSettings::default() };
        let size = PictureSize::new(8, 8).unwrap();
        Rendering::with((world.clone(), &plan), world.scene().default_view(), size, settings, None)
            .takes_sketch()
    };
    assert!(takes(Indirect::Irradiance) && takes(Indirect::Octree));
    assert!(!takes(Indirect::Auto) && !takes(Indirect::Path) && !takes(Indirect::None));
}

/// Caustics that were path-traced before anything was known, and are far noisier than those by photons, hardly count once these come.
#[test]
fn path_traced_caustics_give_way_to_photons() {
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let plan = EffectPlan::of(world.scene());
    let learning = Learning::Alongside { until: None };
    let settings = RenderSettings { indirect: Indirect::Octree, learning, ..RenderSettings::default() };
    let mut of = IlluminationSettings::of(&settings);
    of.photons.emitted_count = 64_000;
    let mut learner = Learner::new(Learnt::Octree, &settings, of);
    let never = AtomicBool::new(false);
    while learner.known().is_none() {
        learner.step(&world, &never);
    }
    let known = learner.known().cloned();
    let drawn = |known: Option<Arc<dyn SecondaryLight>>| {
        let size = PictureSize::new(48, 36).unwrap();
        let view = world.scene().default_view();
        Rendering::with((world.clone(), &plan), view, size, settings, known)
    };
    let until = |rendering: &mut Rendering, passes: u32| {
        while rendering.passes() < passes {
            rendering.step(&never);
        }
        rendering.film().layer(PathClass::Caustic)
    };
    let truth = until(&mut drawn(known.clone()), 64);
    let off = |layer: &[Rgb]| {
        let squares = layer.iter().zip(&truth).map(|(a, b)| (a.luminance() - b.luminance()).powi(2));
        squares.sum::<f32>().sqrt()
    };
    let mut rendering = drawn(None);
    let traced = off(&until(&mut rendering, 16));
    rendering.relight(known, Outdated::Rough);
    let relit = off(&until(&mut rendering, 22));
    // Two samples' worth of eight stay of what were sixteen of 22.
    assert!(relit < 0.5 * traced, "{relit} of {traced}");
}

/// What is known of the light of a scene before an edit shows no caustics in one that has nothing to focus light any more.
#[test]
fn known_light_brings_no_caustics_where_nothing_focuses() {
    let glassy = samples::cornell_box().unwrap();
    let view = glassy.default_view();
    let mut matt = SceneBuilder::from_scene(&glassy, SceneLimits::default());
    for (id, material) in glassy.materials() {
        let lambert = Material {
            metallic: 0.0,
            roughness: 1.0,
            specular: 0.0,
            transmission: 0.0,
            ..Material::clone(material)
        };
        matt.set_material(id.clone(), lambert).unwrap();
    }
    let matt = Arc::new(world_of(matt.finish().0));
    let plan = EffectPlan::of(matt.scene());
    let settings = RenderSettings { indirect: Indirect::Octree, ..RenderSettings::default() };
    let size = PictureSize::new(48, 32).unwrap();
    let never = AtomicBool::new(false);
    let before = Caches::complete(self::settings(30_000, 5), &world_of(glassy));
    let known = before.products.secondary.clone().unwrap();
    let mut rendering = Rendering::with((matt, &plan), view, size, settings, Some(known));
    rendering.step(&never);
    assert!(rendering.film().layer(PathClass::Indirect).iter().any(|value| value.g > 0.0));
    assert!(rendering.film().layer(PathClass::Caustic).iter().all(|value| value.is_black()));
}

/// Light that asks for a pause once it was looked up so many times.
#[derive(Debug)]
struct Pausing {
    light: Arc<dyn SecondaryLight>,
    left: AtomicI64,
    pause: AtomicBool,
}

impl SecondaryLight for Pausing {
    fn card(&self) -> &'static Card {
        self.light.card()
    }

    fn scattered(&self, surface: &Surface, wo: Vec3, draw: Option<[f32; 3]>) -> ScatteredLight {
        if self.left.fetch_sub(1, Ordering::Relaxed) <= 0 {
            self.pause.store(true, Ordering::Relaxed);
        }
        self.light.scattered(surface, wo, draw)
    }

    fn has_caustics(&self) -> bool {
        self.light.has_caustics()
    }
}

/// Who looks at a large picture slice by slice learns its error before the second sample of every pixel is there, and gets the same
/// picture as without pauses.
#[test]
fn errors_are_known_before_the_second_pass_ends() {
    let world = Arc::new(world_of(samples::boxes().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let plan = EffectPlan::of(world.scene());
    let settings = RenderSettings { indirect: Indirect::Octree, ..RenderSettings::default() };
    let light = Caches::complete(self::settings(30_000, 5), &world).products.secondary.clone().unwrap();
    let light = Arc::new(Pausing { light, left: AtomicI64::new(i64::MAX), pause: AtomicBool::new(false) });
    let size = PictureSize::new(480, 360).unwrap();
    let picture = || Rendering::with((world.clone(), &plan), view, size, settings, Some(light.clone()));
    let mut sliced = picture();
    assert!(sliced.step(&light.pause).complete && !sliced.is_measured());
    let mut slices = 0;
    while sliced.passes() < 2 {
        light.left.store(8_000, Ordering::Relaxed);
        light.pause.store(false, Ordering::Relaxed);
        sliced.step(&light.pause);
        slices += 1;
        assert!(sliced.is_measured() || slices < 4, "{slices} slices");
        assert!(slices < 100, "no end of it");
    }
    assert!(slices > 5 && sliced.measured_error().is_some(), "{slices} slices");
    light.left.store(i64::MAX, Ordering::Relaxed);
    light.pause.store(false, Ordering::Relaxed);
    let mut whole = picture();
    (0..2).for_each(|_| assert!(whole.step(&light.pause).complete));
    assert!(whole.picture().radiance() == sliced.picture().radiance());
}

/// What takes noise off is of the film as it is, whatever was drawn, cut short or replaced since; it is off where that is asked for, and
/// what is asked to be path-traced never has it.
#[test]
fn noise_is_taken_off_the_film_as_it_is() {
    let world = Arc::new(world_of(samples::cornell_box().unwrap()));
    let view = world.scene().camera_view(None).unwrap();
    let plan = EffectPlan::of(world.scene());
    let size = PictureSize::new(96, 96).unwrap();
    let lights = [5, 6].map(|seed| {
        let light =
            Caches::complete(self::settings(10_000, seed), &world).products.secondary.clone().unwrap();
        Arc::new(Pausing { light, left: AtomicI64::new(i64::MAX), pause: AtomicBool::new(false) })
    });
    // One thread ends at the end of the tile in which it is asked to, however fast it is.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let draw = |indirect: Indirect, keeps_noise: bool| {
        let settings = RenderSettings { indirect, keeps_noise, ..RenderSettings::default() };
        let known = |light: &Arc<Pausing>| -> Arc<dyn SecondaryLight> { light.clone() };
        let mut rendering =
            Rendering::with((world.clone(), &plan), view, size, settings, Some(known(&lights[0])));
        let (mut steps, mut cut) = (0, 0);
        while rendering.film().passes_min() < 4 {
            let is_relit = steps == 7;
            let light = &lights[usize::from(steps >= 7)];
            if is_relit && indirect != Indirect::Path {
                rendering.relight(Some(known(light)), Outdated::Wrong);
            }
            light.left.store(if steps % 3 == 2 { i64::MAX } else { 600 }, Ordering::Relaxed);
            light.pause.store(false, Ordering::Relaxed);
            pool.install(|| rendering.step(&light.pause));
            steps += 1;
            assert!(steps < 100, "no end of it");
            cut += usize::from(rendering.film().passes_min() != rendering.film().passes_max());
            let film = Picture::of(rendering.film());
            let afresh = film.clone().denoised(&Denoising::default());
            let expected = if keeps_noise || indirect == Indirect::Path { film } else { afresh };
            assert_eq!(rendering.own_picture().radiance(), expected.radiance(), "{indirect:?}, step {steps}");
        }
        assert!(indirect == Indirect::Path || steps > 7 && cut > 3, "{cut} of {steps} steps cut");
        // What the mirror block and the glass ball show is kept for the filter alone.
        let keeps_beyond = rendering.film().bytes() > Film::new(size).bytes();
        assert_eq!(keeps_beyond, indirect != Indirect::Path && !keeps_noise, "{indirect:?}");
        rendering.picture().radiance()
    };
    assert_eq!(draw(Indirect::Path, false), draw(Indirect::Path, true));
    assert!(draw(Indirect::Octree, false) != draw(Indirect::Octree, true));
}

/// Pictures are charged for taking noise off where it is taken off, and for what mirrors and glass show where there are any.
#[test]
fn what_mirrors_show_is_charged_where_there_are_mirrors() {
    let of_scene = |scene: Scene, indirect, keeps_noise| {
        let settings = RenderSettings { indirect, keeps_noise, ..RenderSettings::default() };
        settings.picture_bytes(&EffectPlan::of(&scene), 1000)
    };
    let (mirrors, matt) = (samples::cornell_box().unwrap(), samples::furnace(0.5, 0.25).unwrap());
    for (scene, beyond) in [(mirrors, Film::BYTES_BEYOND), (matt, 0)] {
        for indirect in [Indirect::Octree, Indirect::Auto] {
            let [with, without] = [false, true].map(|keeps| of_scene(scene.clone(), indirect, keeps));
            assert_eq!(with - without, 1000 * (Denoising::BYTES_PER_PIXEL + beyond), "{indirect:?}");
        }
        assert_eq!(of_scene(scene.clone(), Indirect::Path, false), of_scene(scene, Indirect::Path, true));
    }
}
