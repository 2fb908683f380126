//! Maps of shadows: what lights see, drawn beside rays; what they tell, beside their twin and beside rays; and whom they tell it.

mod twin;

use std::f32::consts::FRAC_1_PI;

use glam::DMat3;

use super::{
    super::{
        first_shown::ShownAs,
        shadow_maps::{GpuShadowPlane, MapSides, ShadowPlanes, Shadowing, Shadows},
    },
    known_light::{ALL_STEPS, with_records},
    textures::masked,
    *,
};
use crate::{
    accel::Ray,
    film::{Display, ToneMap},
    gpu::{
        AdapterChoice, GpuOptions,
        tests::{assert_same_layout, open_with},
    },
    scene::{Projection, SceneBuilder, SceneLimits, samples},
    technique::path::{closed_forms::id, tests::transformed},
    transport::{GpuLight, PathClasses, ShadowRay},
};

/// Small ones: what is tested is how, not how finely.
const SIDES: MapSides = MapSides { directional: 256, spot: 192, point: 64 };
/// Texels about as large as pixels are there.
const COARSE: MapSides = MapSides { directional: 128, spot: 128, point: 128 };
/// Share of texels that may see something else than the ray through their middle: cards move corners to multiples of 1/256 of a pixel. Of
/// 217,000 in these tests two did on a software adapter.
const ELSEWHERE_MAX: f64 = 1e-3;

const GREY: Rgb = Rgb::new(0.7, 0.6, 0.5);
const SUN: LightKind = LightKind::Directional { irradiance: Rgb::new(3.0, 2.5, 2.0) };
const POINT: LightKind = LightKind::Point { intensity: Rgb::new(20.0, 18.0, 15.0) };

fn spot(outer_angle_rad: f32) -> LightKind {
    LightKind::Spot { intensity: Rgb::splat(30.0), inner_angle_rad: 0.5 * outer_angle_rad, outer_angle_rad }
}

/// A floor, a wall, a ball, a bar that nothing holds and a leaning sheet; no light, and nothing that shines.
fn things() -> Stage {
    let mut stage = Stage::default();
    let grey = stage.material("grey", Material::lambert(GREY)).unwrap();
    let floor = SQUARE.map(|c| DVec3::new(2.0 * c.x, -1.0, -2.0 * c.y));
    let wall = SQUARE.map(|c| 2.0 * c - 2.0 * DVec3::Z);
    let bar = SQUARE.map(|c| DVec3::new(1.2 * c.x - 0.2, 0.08 * c.y + 0.9, 0.3));
    for (name, corners) in [("floor", floor), ("wall", wall), ("bar", bar)] {
        placed(&mut stage, name, quad(corners, &grey));
    }
    let turn = DAffine3::from_mat3_translation(
        DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(0.5),
        DVec3::new(1.0, -0.4, 0.4),
    );
    stage.place("sheet", quad(SQUARE.map(|c| 0.4 * c), &grey), turn).unwrap();
    placed(&mut stage, "ball", samples::sphere(DVec3::new(-0.6, -0.4, 0.1), 0.6, 24, &grey));
    let view = CameraView::look_at(DVec3::new(0.3, 0.9, 4.2), DVec3::new(0.0, -0.3, 0.0), DVec3::Y, 0.7);
    stage.camera("main", view, 4.0 / 3.0).unwrap();
    stage
}

/// The same, lit by one light.
fn lit(kind: LightKind) -> Scene {
    let mut stage = things();
    lit_by(&mut stage, "light", DVec3::new(1.1, 2.2, 1.3), DVec3::new(-0.45, -1.0, -0.6), kind);
    stage.finish()
}

/// The same, lit by two suns, a point light and two spots.
fn lit_by_many() -> Scene {
    let mut stage = things();
    for (name, kind, x) in [
        ("sun", SUN, 1.1),
        ("point", POINT, -1.3),
        ("spot", spot(0.7), 0.2),
        ("broad", spot(1.4), 1.5),
        ("moon", SUN, -0.8),
    ] {
        lit_by(&mut stage, name, DVec3::new(x, 2.2, 1.3), DVec3::new(-0.4 * x, -1.0, -0.6), kind);
    }
    stage.finish()
}

/// The same in the sun behind a pane, of which it sees all but the floor's edges by way of that.
fn behind_a_pane() -> Scene {
    let mut stage = things();
    let clear = Material { transmission: 1.0, roughness: 0.0, base_color: Rgb::WHITE, ..Material::default() };
    let clear = stage.material("clear", clear).unwrap();
    let pane = samples::cuboid(DVec3::new(-1.0, 1.8, -1.0), DVec3::new(2.0, 1.82, 1.5), &clear);
    placed(&mut stage, "pane", pane);
    lit_by(&mut stage, "light", DVec3::ZERO, DVec3::new(-0.45, -1.0, -0.6), SUN);
    stage.finish()
}

fn each_kind() -> [(&'static str, Scene); 4] {
    [("sun", lit(SUN)), ("spot", lit(spot(0.7))), ("broad spot", lit(spot(1.5))), ("point", lit(POINT))]
}

fn on_card(gpu: &Arc<Gpu>, shot: &Shot) -> Arc<GpuScene> {
    Arc::new(GpuScene::new(Arc::clone(gpu), Arc::clone(&shot.world)))
}

/// Planes of maps of such sides, which the scene asks from now on, and all their texels as the card has drawn them.
fn drawn(scene: &GpuScene, sides: MapSides) -> (ShadowPlanes, Vec<f32>) {
    let lights = scene.world.upload().appearance.lights;
    let mut held = scene.ready().unwrap();
    let ready = held.as_mut().unwrap();
    let shadowing = Shadowing::of(&scene.world, &lights, sides, u64::MAX).unwrap();
    ready.shadowing = Some(shadowing);
    ready.draw_maps(&scene.world).unwrap();
    let shadowing = ready.shadowing.as_ref().unwrap();
    let nearnesses = &shadowing.maps().unwrap().nearnesses;
    let bytes = ready.session.read(nearnesses, 0..nearnesses.byte_count()).unwrap();
    (shadowing.planes.clone(), bytemuck::pod_collect_to_vec(&bytes))
}

/// Texels see what a ray through their middle meets, as near; through holes of masks too.
#[test]
fn maps_see_what_rays_meet() {
    let Some(gpu) = shared() else { return };
    let mut sieves = SceneBuilder::from_scene(&masked(), SceneLimits::default());
    let direction = DVec3::new(-0.2, -0.8, -0.7).normalize();
    sieves.add_light(id("sun"), Light { parent: None, position: DVec3::ZERO, direction, kind: SUN }).unwrap();
    let sieves = sieves.finish().0;
    for (name, scene) in each_kind().into_iter().chain([("sun through sieves", sieves)]) {
        let shot = shot(scene);
        let (maps, card) = drawn(&on_card(&gpu, &shot), SIDES);
        let rays = maps.by_rays(&shot.world);
        assert_eq!((card.len(), rays.len()), (maps.texel_count as usize, maps.texel_count as usize));
        assert!(card.iter().all(|nearness| (0.0..=1.0).contains(nearness)), "{name}");
        let elsewhere = maps.differing(&card, &rays);
        let seen = rays.iter().filter(|nearness| **nearness > 0.0).count();
        eprintln!("{name}: {elsewhere} of {} texels see something else, {seen} see anything", rays.len());
        assert!(seen > 2000, "{name}: {seen} of {}", rays.len());
        assert!(elsewhere as f64 <= ELSEWHERE_MAX * rays.len() as f64, "{name}: {elsewhere}");
    }
}

/// A pass of direct light whose shadows maps tell.
fn by_maps(shot: &Shot, scene: &Arc<GpuScene>) -> Pass {
    let mut tracer = shot.tracer(scene);
    let mut running = shot.begin(&mut tracer, 0);
    running.begun.shadows = Shadows::ByMaps;
    tracer.slice = SLICE_MIN;
    while running.traced() < shot.size.pixel_count() {
        tracer.trace_slice(&mut running, shot.size.pixel_count(), None).unwrap();
    }
    tracer.take_rest(&mut running).unwrap();
    let samples = tracer.samples.iter().map(GpuPixelSample::unpacked).collect();
    Pass { samples, counts: running.counts }
}

/// Direct light alone, whose only light is no lamp.
fn of_direct(scene: Scene, size: PictureSize) -> Shot {
    Shot { size, settings: PathSettings::all(Some(1), 1), ..shot(scene) }
}

/// What the only light sends to each pixel's sample: where that is and its normal, the shadow ray, and what arrives of it unless that is hidden;
/// `None` where nothing is met.
fn shadow_rays(shot: &Shot) -> Vec<Option<([Vec3; 2], ShadowRay, f32)>> {
    let view = View::new(&shot.world, &shot.camera, shot.size);
    let lights = shot.world.upload().appearance.lights;
    let light = lights.iter().find(|light| light.kind != GpuLight::TRIANGLE).unwrap();
    let at = Vec3::from(light.position);
    let width = shot.size.width();
    let of_pixel = |pixel: u32| {
        let sampler = PixelSampler::new(shot.settings.seed, 0, pixel, 0);
        let ray = primary_ray(&view, pixel % width, pixel / width, &sampler);
        let surface = shot.world.surface(&shot.world.closest_hit(&ray)?, ray.direction);
        let point = surface.point;
        let wi = if light.kind == GpuLight::DIRECTIONAL { -at } else { (at - point.position).normalize() };
        let origin = point.origin_towards(wi);
        let t_max = if light.kind == GpuLight::DIRECTIONAL { f32::INFINITY } else { (at - origin).length() };
        let ray = Ray { t_max, left: point.on, ..Ray::new(origin, wi) };
        let sent = Rgb::from(light.intensity)
            * match light.kind {
                GpuLight::DIRECTIONAL => 1.0,
                kind => {
                    let range = light.cos_inner - light.cos_outer;
                    let within = (-wi.dot(light.axis.into()) - light.cos_outer) / range;
                    let share = if kind == GpuLight::SPOT { within.clamp(0.0, 1.0).powi(2) } else { 1.0 };
                    share / (at - point.position).length_squared()
                }
            };
        let reflected = GREY * sent * (wi.dot(surface.frame.n).max(0.0) * FRAC_1_PI);
        Some(([origin, point.n_geo], ShadowRay { ray, light: None }, reflected.mean()))
    };
    (0..shot.size.pixel_count() as u32).map(of_pixel).collect()
}

/// Each sample's light is the share that the twin finds of what arrives without shadows, on the same map; rays are traced where that asks for one,
/// and counted.
#[test]
fn maps_tell_what_their_twin_tells() {
    let Some(gpu) = shared() else { return };
    let flat = |mut shot: Shot| {
        shot.camera.projection = Projection::Orthographic { half_height_m: 1.6 };
        shot
    };
    let shots = each_kind().map(|(name, scene)| (name, of_direct(scene, size(97, 71))));
    let from_far = ("sun, parallel rays to the eye", flat(of_direct(lit(SUN), size(97, 71))));
    for (name, shot) in shots.into_iter().chain([from_far]) {
        let scene = on_card(&gpu, &shot);
        let (maps, nearnesses) = drawn(&scene, COARSE);
        let card = by_maps(&shot, &scene);
        let by_rays = shot.on_card(&scene, 0);
        let view = View::new(&shot.world, &shot.camera, shot.size);
        let light = maps.of_lights.iter().position(|[_, count]| *count > 0).unwrap();
        let (mut others, mut asked, mut partly, mut compared) = (0, 0, 0, 0);
        for (pixel, rays) in shadow_rays(&shot).into_iter().enumerate() {
            let Some(([p, n], shadow, unhidden)) = rays else { continue };
            let away = if view.is_perspective { p.distance(view.origin) } else { 1.0 };
            let pixel_m = 2.0 * view.half_size[0] / shot.size.width() as f32 * away;
            let told = maps.lit_share(&nearnesses, light, [p, n], pixel_m);
            let is_lit = !shot.world.is_occluded(&shadow);
            let card = card.samples[pixel].radiance[PathClass::Direct as usize].mean();
            asked += usize::from(told.is_none());
            partly += usize::from(told.is_some_and(|share| share > 0.0 && share < 1.0));
            if unhidden > 0.0 {
                let share = told.unwrap_or(f32::from(u8::from(is_lit)));
                compared += 1;
                others += usize::from((card / unhidden - share).abs() > 2e-3);
            }
        }
        eprintln!("{name}: {others} of {compared} others, {partly} in part, {asked} asked for rays");
        assert!(compared > 3000 && partly > 20, "{name}: {compared} {partly}");
        assert!(others as f64 <= OTHERS_MAX * compared as f64, "{name}: {others} of {compared}");
        // Those whose light is black send none.
        assert!(card.counts.shadow_rays <= asked as u64 + 10, "{name}: {:?} for {asked}", card.counts);
        assert!(card.counts.shadow_rays * 3 < by_rays.counts.shadow_rays, "{name}: {:?}", card.counts);
    }
}

/// What maps tell is what rays tell but along edges, at any scale and wherever the scene lies.
#[test]
fn shadows_by_maps_are_those_by_rays_but_for_edges() {
    let Some(gpu) = shared() else { return };
    for (name, scene) in each_kind().into_iter().chain([("many", lit_by_many()), ("pane", behind_a_pane())]) {
        for (scale, offset) in [(1.0, 0.0), (1e-4, 0.0), (1e4, 0.0), (1.0, 1e5)] {
            let place =
                DAffine3::from_scale(DVec3::splat(scale)) * DAffine3::from_translation(DVec3::splat(offset));
            let mut shot = of_direct(transformed(&scene, place, scale), size(120, 90));
            if name == "pane" {
                let traced = PathClasses::SEEN_AND_DIRECT;
                shot.settings = PathSettings { traced, ..PathSettings::all(Some(3), 1) };
            }
            let scene = on_card(&gpu, &shot);
            let [maps, rays] = [by_maps(&shot, &scene), shot.on_card(&scene, 0)]
                .map(|pass| pass.samples.iter().map(|sample| sample.total().mean()).collect::<Vec<f32>>());
            let sum = |image: &[f32]| image.iter().map(|value| f64::from(*value)).sum::<f64>();
            let (light, apart) = (sum(&maps) / sum(&rays) - 1.0, |(a, b): &(&f32, &f32)| off(**a, **b, 1e-6));
            let others = maps.iter().zip(&rays).filter(|pair| apart(pair) > 0.1).count();
            eprintln!("{name} × {scale:e} at {offset:e}: {others} of {}, light {light:+.4}", maps.len());
            assert!(
                others * 100 < maps.len(),
                "{name} × {scale:e} at {offset:e}: {others} of {}",
                maps.len()
            );
            assert!(light.abs() < 0.002, "{name} × {scale:e} at {offset:e}: {light}");
        }
    }
}

/// A floor that nothing stands on is lit all over, to its very edge, whatever way the light falls: along axes, and from a light on its rim.
#[test]
fn a_bare_floor_is_lit_to_its_edge() {
    let Some(gpu) = shared() else { return };
    let slanted = DVec3::new(0.8, -0.5, 0.3);
    for (name, kind, at, direction) in [
        ("slanted", SUN, DVec3::ZERO, slanted),
        ("back", SUN, DVec3::ZERO, DVec3::new(-0.9, -0.2, 0.1)),
        ("straight", SUN, DVec3::ZERO, DVec3::NEG_Y),
        ("point", POINT, DVec3::new(2.0, 0.5, 2.0), DVec3::NEG_Y),
        ("spot", spot(1.0), DVec3::new(-1.0, 1.0, 0.5), slanted),
    ] {
        let mut stage = Stage::default();
        let grey = stage.material("grey", Material::lambert(GREY)).unwrap();
        let floor = SQUARE.map(|c| DVec3::new(2.0 * c.x, 0.0, -2.0 * c.y));
        placed(&mut stage, "floor", quad(floor, &grey));
        lit_by(&mut stage, "light", at, direction, kind);
        let view = CameraView::look_at(DVec3::new(0.3, 3.5, 4.2), DVec3::ZERO, DVec3::Y, 0.9);
        stage.camera("main", view, 4.0 / 3.0).unwrap();
        let shot = of_direct(stage.finish(), size(120, 90));
        let scene = on_card(&gpu, &shot);
        drawn(&scene, COARSE);
        let [maps, rays] = [by_maps(&shot, &scene), shot.on_card(&scene, 0)];
        assert!(maps.counts.shadow_rays * 2 < rays.counts.shadow_rays, "{name}: {:?}", maps.counts);
        for (maps, rays) in maps.samples.iter().zip(&rays.samples) {
            assert_eq!(maps.radiance, rays.radiance, "{name}");
        }
    }
}

/// The strongest lights have maps, as far as there is room; lamps have none, and scenes of lamps no plane.
#[test]
fn strong_lights_come_first_and_lamps_have_none() {
    let mut stage = room();
    for (name, kind) in [("weak", spot(0.4)), ("point", POINT), ("sun", SUN)] {
        lit_by(&mut stage, name, DVec3::Y, DVec3::NEG_Y, kind);
    }
    let world = World::prepare(Arc::new(stage.finish()));
    let lights = world.upload().appearance.lights;
    let bytes = |sides: [u32; 3]| 4 * sides.map(|side| u64::from(side * side)).into_iter().sum::<u64>();
    let [sun, point, weak] = [bytes([256, 0, 0]), 6 * bytes([64, 0, 0]), bytes([192, 0, 0])];
    let planes = |bytes_max: u64| ShadowPlanes::of(&world, &lights, SIDES, bytes_max);
    let kinds = |maps: &ShadowPlanes| -> Vec<u32> {
        let has = |number: &usize| maps.of_lights[*number][1] > 0;
        (0..lights.len()).filter(has).map(|number| lights[number].kind).collect()
    };
    assert_eq!((planes(0), planes(point - 1)), (None, None));
    let all = planes(u64::MAX).unwrap();
    let mut found = kinds(&all);
    found.sort_unstable();
    assert_eq!((found, all.planes.len()), (vec![1, 2, 3], 8));
    assert_eq!(u64::from(all.texel_count) * 4, sun + point + weak);
    assert!(planes(sun + point + weak).is_some_and(|maps| maps == all));
    let fewer = planes(sun + point + weak - 1).unwrap();
    assert_eq!(fewer.planes.len(), 7, "the weakest goes first");
    // Each texel is one plane's.
    let mut next = 0;
    for plane in &all.planes {
        assert_eq!(plane.first_texel, next);
        next += plane.side * plane.side;
    }
    let lamps = World::prepare(Arc::new(samples::cornell_box().unwrap()));
    assert_eq!(ShadowPlanes::of(&lamps, &lamps.upload().appearance.lights, SIDES, u64::MAX), None);
    let nothing = World::prepare(Arc::new(Stage::default().finish()));
    assert_eq!(ShadowPlanes::of(&nothing, &lights, SIDES, u64::MAX), None);
}

/// First pictures ask maps from the second of a scene on, if light is looked up; what they told goes with the next pass, and rays tell all that
/// stays.
#[test]
fn who_moves_asks_maps_and_who_stays_rays() {
    let Some(gpu) = shared() else { return };
    let known = with_records(lit(SUN), ALL_STEPS, true);
    let traced = Shot { known: None, ..known.clone() };
    let display = Arc::new(Display::new(ToneMap::AgX, 0.0));
    let shadow_rays = |scene: &Arc<GpuScene>, shot: &Shot, shown: bool| {
        let mut tracer = shot.tracer(scene);
        tracer.tell_first_shadows(Shadows::ByMaps);
        tracer.show_first_as(shown.then(|| ShownAs { display: Arc::clone(&display), denoises: true }));
        let mut film = Film::new(shot.size);
        let counts = step(&mut tracer, shot, &mut film, false).counts;
        assert_eq!(tracer.take_shown().is_some(), shown);
        assert!(step(&mut tracer, shot, &mut film, false).complete);
        (counts.shadow_rays, film)
    };
    let scene = on_card(&gpu, &known);
    let (by_rays, of_rays) = shadow_rays(&scene, &known, false);
    assert_eq!(shadow_rays(&scene, &known, true).0, by_rays, "the first by rays");
    let (by_maps, film) = shadow_rays(&scene, &known, true);
    assert!(by_maps * 3 < 2 * by_rays, "{by_maps} for {by_rays}");
    // The second pass of that film is all that it holds of scattered light.
    let mut alone = Film::new(known.size);
    let mut tracer = known.tracer(&scene);
    assert!(step(&mut tracer, &known, &mut alone, false).complete);
    alone.outdate(&[PathClass::Direct, PathClass::Caustic, PathClass::Indirect], Outdated::Wrong);
    assert!(step(&mut tracer, &known, &mut alone, false).complete);
    for class in PathClass::ALL {
        assert_eq!(film.layer(class), alone.layer(class), "{}", class.name());
    }
    assert!(
        film.layer(PathClass::Direct) != of_rays.layer(PathClass::Direct),
        "both passes of those by rays"
    );
    // Where no light has a map, nothing is forgotten.
    let lamps = with_records(room().finish(), ALL_STEPS, true);
    let scene = on_card(&gpu, &lamps);
    let films = [(); 3].map(|()| shadow_rays(&scene, &lamps, true).1);
    assert_same_bits(&films[0], &films[2]);
    assert_same_bits(&shadow_rays(&scene, &lamps, false).1, &films[2]);
    let scene = on_card(&gpu, &traced);
    let all: Vec<u64> = (0..3).map(|_| shadow_rays(&scene, &traced, true).0).collect();
    assert!(all.iter().all(|rays| *rays == all[0]), "path tracing traces all: {all:?}");
}

/// Where maps have no room, or none are wanted, rays tell all, and the picture is drawn there nevertheless.
#[test]
fn without_room_for_maps_rays_tell_all() {
    let shot = with_records(lit(SUN), ALL_STEPS, true);
    let on = |options: GpuOptions| {
        let gpu = open_with(&GpuOptions { adapter: AdapterChoice::Any, ..options }).map(Arc::new)?;
        Some((on_card(&gpu, &shot), gpu))
    };
    let Some((whole, _gpu)) = on(GpuOptions::default()) else { return };
    let by_rays = shot.on_card(&whole, 0).counts.shadow_rays;
    let without = whole.bytes();
    let with = by_maps(&shot, &whole).counts.shadow_rays;
    assert!(with < by_rays && whole.bytes() > without + (16 << 20), "{} for {without}", whole.bytes());
    let (none_wanted, _gpu) = on(GpuOptions { shadow_map_bytes_max: 0, ..GpuOptions::default() }).unwrap();
    assert_eq!(by_maps(&shot, &none_wanted).counts.shadow_rays, by_rays);
    let (no_room, _gpu) = on(GpuOptions { bytes_max: without + 1_000_000, ..GpuOptions::default() }).unwrap();
    assert_eq!(by_maps(&shot, &no_room).counts.shadow_rays, by_rays);
    assert!(no_room.bytes() > 0 && no_room.bytes() <= without + 1_000_000, "the scene stays");
    whole.gpu.session().unwrap().lose_for_test();
    assert_eq!(by_maps(&shot, &whole).counts.shadow_rays, with);
}

/// Planes lie in WGSL as in Rust.
#[test]
fn shadow_planes_lie_alike_in_rust_and_wgsl() {
    let sources = [
        lumicast_shaders::SHADOW_MAP.source(lumicast_shaders::PROOF_CONSTANTS),
        lumicast_shaders::SHADOWS_ASK.source(lumicast_shaders::PROOF_CONSTANTS),
    ];
    for source in &sources {
        assert_same_layout!(
            source,
            "ShadowPlane",
            GpuShadowPlane {
                origin,
                half_width,
                right,
                half_height,
                up,
                reach_m,
                back,
                is_perspective,
                first_texel,
                side,
                padding_0,
                padding_1,
            }
        );
    }
}
