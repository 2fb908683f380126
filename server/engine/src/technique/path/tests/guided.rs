//! Laws of paths that photons say where to go.

use std::sync::{Arc, atomic::AtomicBool};

use glam::{DAffine3, DVec3, Vec3};

use super::in_white_surroundings;
use crate::{
    film::PictureSize,
    math::{Rgb, RunningStatistics, sobol::PixelSampler, warp},
    scene::{
        CameraView, Environment, Id, Light, LightKind, Material, Scene, SceneBuilder, SceneLimits, Texels,
        Texture, samples,
    },
    technique::{
        Flight, Guide, PhotonProduct, Products, Step, Technique,
        path::{Counts, PathSettings, Tracer, View, cpu::primary_ray},
        photons::{PhotonSettings, PhotonTracing},
    },
    transport::{PathClass, World},
};

const SIDE: u32 = 12;

/// Means over the picture by class, of `passes` samples a pixel each, and the rays of all.
fn seen(world: &World, guide: Option<&Guide>, runs: u32, passes: u32) -> (Vec<RunningStatistics>, Counts) {
    seen_as(PathSettings::all(None, 3), world, guide, runs, passes)
}

fn seen_as(
    settings: PathSettings,
    world: &World,
    guide: Option<&Guide>,
    runs: u32,
    passes: u32,
) -> (Vec<RunningStatistics>, Counts) {
    let view = world.scene().camera_view(None).unwrap();
    let view = View::new(world, &view, PictureSize::new(SIDE, SIDE).unwrap());
    let tracer = Tracer { view: Some(&view), guide, ..Tracer::of(world, settings) };
    // Compared with each other are independent ones.
    let seed = u64::from(guide.is_some()) + 2 * u64::from(settings.knows_openings);
    let mut counts = Counts::default();
    let mut found = vec![RunningStatistics::default(); PathClass::ALL.len() + 1];
    for run in 0..runs {
        let mut sums = [0.0; PathClass::ALL.len() + 1];
        for (pixel, index) in (0..SIDE * SIDE).flat_map(|pixel| (0..passes).map(move |index| (pixel, index)))
        {
            let sampler = PixelSampler::new(seed, run, pixel, index);
            let ray = primary_ray(&view, pixel % SIDE, pixel / SIDE, &sampler);
            let sample = tracer.sample_pixel(&ray, world.closest_hit(&ray), &sampler, &mut counts);
            let classes = sample.radiance.map(|radiance| f64::from(radiance.mean()));
            sums.iter_mut().zip(classes).for_each(|(sum, radiance)| *sum += radiance);
            sums[PathClass::ALL.len()] += classes.iter().sum::<f64>();
        }
        let samples = f64::from(SIDE * SIDE * passes);
        found.iter_mut().zip(sums).for_each(|(found, sum)| found.add(sum / samples));
    }
    (found, counts)
}

/// Both see the same light of every class: four standard errors are met by chance once in a thousand of the twenty means compared here.
fn assert_same(guided: &[RunningStatistics], plain: &[RunningStatistics], what: &str) {
    for (guided, plain) in guided.iter().zip(plain) {
        let error = guided.standard_error().hypot(plain.standard_error());
        let off = (guided.mean() - plain.mean()).abs();
        assert!(off < 4.0 * error + 1e-6, "{what}: {} for {} ± {error}", guided.mean(), plain.mean());
    }
}

fn traced(scene: Scene) -> (World, Arc<PhotonProduct>) {
    let world = World::prepare(Arc::new(scene));
    let mut photons =
        PhotonTracing::new(PhotonSettings { emitted_count: 100_000, ..PhotonSettings::default() });
    let (mut products, never) = (Products::default(), AtomicBool::new(false));
    let mut step = Step { world: &world, products: &mut products, canvas: None, cancel: &never };
    while !photons.is_complete() {
        photons.step(&mut step);
    }
    (world, Arc::clone(photons.product()))
}

/// A box whose only lamp throws a narrow cone at a corner.
fn lit_corner() -> Scene {
    let mut stage = samples::Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.7))).unwrap();
    let walls = samples::cuboid(DVec3::splat(-2.0), DVec3::splat(2.0), &white);
    // Turned inside out.
    stage.place("room", walls, DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0))).unwrap();
    let position = DVec3::splat(0.5);
    let direction = (DVec3::splat(-1.9) - position).normalize();
    let kind = LightKind::Spot { intensity: Rgb::splat(50.0), inner_angle_rad: 0.1, outer_angle_rad: 0.15 };
    stage.light("lamp", Light { parent: None, position, direction, kind }).unwrap();
    let view = CameraView::look_at(DVec3::new(-1.8, 0.0, 1.8), DVec3::new(2.0, 0.0, -1.0), DVec3::Y, 1.2);
    stage.camera("view", view, 1.0).unwrap();
    stage.finish()
}

/// Whatever photons say, right or wrong, every class of light keeps its mean: seen by light sampling, by chance and by both.
#[test]
fn guidance_takes_nothing_of_the_truth() {
    let (world, right) = traced(samples::cornell_box().unwrap());
    let (plain, _) = seen(&world, None, 40, 16);
    let (guided, _) = seen(&world, right.guide(), 40, 16);
    assert_same(&guided, &plain, "right");
    let (_, wrong) = traced(lit_corner());
    let (misled, _) = seen(&world, wrong.guide(), 40, 16);
    assert_same(&misled, &plain, "of another scene");
}

/// In a room with a window, paths that know where the sky shows see the same light of every class, and of what falls straight from the sky
/// with less noise, though much of the picture is outside. So do guided ones, those that meet a tilted glossy box under a picture of a sky,
/// and all of them with a pane in the window.
#[test]
fn a_sky_is_found_through_windows_without_loss() {
    let room_of = |scene: Scene, change: &dyn Fn(&mut SceneBuilder)| {
        let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
        builder.remove_light("sun").unwrap();
        change(&mut builder);
        traced(builder.finish().0)
    };
    let glossy = |builder: &mut SceneBuilder| {
        let tilted = DAffine3::from_rotation_x(0.6) * DAffine3::from_rotation_y(0.4);
        builder.set_transform("box", tilted).unwrap();
        let material = Material { roughness: 0.3, metallic: 0.5, ..Material::lambert(Rgb::splat(0.7)) };
        builder.set_material(Id::new("wall").unwrap(), material).unwrap();
        let texels = (0..16 * 8).map(|texel| {
            let brightness = if texel % 16 == 3 { 8.0 } else { 0.2 + 0.01 * texel as f32 };
            [0.8 * brightness, brightness, 1.2 * brightness, 1.0]
        });
        let texture = Texture { width: 16, height: 8, texels: Texels::Rgba32F(texels.collect()) };
        let id = Id::new("sky").unwrap();
        builder.add_texture(id.clone(), texture).unwrap();
        let sky = Environment::Image { texture: id, scale: Rgb::WHITE, rotation_rad: 0.0 };
        builder.set_environment(sky).unwrap();
    };
    let plain_room = room_of(samples::room_on_ground().unwrap(), &|_| ());
    let glossy_room = room_of(samples::room_on_ground().unwrap(), &glossy);
    let glazed_room = room_of(samples::glazed_room().unwrap(), &|_| ());
    let glossy_glazed_room = room_of(samples::glazed_room().unwrap(), &glossy);
    for (name, (world, product), is_guided) in [
        ("room", &plain_room, false),
        ("guided", &plain_room, true),
        ("glossy", &glossy_room, true),
        ("glazed", &glazed_room, false),
        ("glazed and guided", &glazed_room, true),
        ("glazed and glossy", &glossy_glazed_room, true),
    ] {
        let guide = product.guide().filter(|_| is_guided);
        assert_eq!(guide.is_some(), is_guided);
        let settings = PathSettings::all(None, 3);
        let (plain, _) = seen_as(settings, world, guide, 60, 16);
        let (knowing, _) = seen_as(PathSettings { knows_openings: true, ..settings }, world, guide, 60, 16);
        assert_same(&knowing, &plain, name);
        // Behind a pane light that falls straight from the sky counts as a caustic.
        let is_glazed = name.starts_with("glazed");
        let class = if is_glazed { PathClass::Caustic } else { PathClass::Direct };
        let [knowing, plain] = [&knowing, &plain].map(|found| found[class as usize].variance());
        // Half of what is gained behind a pane is to know where the sky shows.
        let gain = if is_glazed { 4.0 } else { 1.6 };
        assert!(name.ends_with("glossy") || knowing < plain / gain, "{name}: {knowing} for {plain}");
    }
}

/// Photons that fell all over a ball or on walls around it, all from one side.
fn one_sided(side: Vec3, normals: impl Fn(Vec3) -> Vec3) -> Guide {
    let flight = |number: u32| {
        let [u, v, ..] = crate::math::sobol::point(3, number);
        let to = warp::sphere([u, v]);
        Flight { from: to + side, to, normal: normals(to), flux_w: 1.0, is_focused: false }
    };
    Guide::of((0..4000).map(flight).collect()).unwrap()
}

/// In white surroundings whatever loses no light looks like nothing, also where photons speak of one side alone: right of some places,
/// below the horizon of others.
#[test]
fn misled_paths_keep_the_white_furnace() {
    let half_glass = Material { transmission: 0.5, roughness: 0.0, ..Material::default() };
    for (name, material) in [("lambert", Material::lambert(Rgb::WHITE)), ("half glass", half_glass)] {
        let world = World::prepare(Arc::new(in_white_surroundings(material)));
        for side in [Vec3::Z, Vec3::new(0.9, 0.1, 0.3), Vec3::NEG_X] {
            let side = side.normalize();
            let guide = one_sided(side, |to| to);
            assert!(guide.at(side, side).is_some());
            let (found, _) = seen(&world, Some(&guide), 24, 16);
            let all = found.last().unwrap();
            let off = (all.mean() - 1.0).abs();
            assert!(off < 4.0 * all.standard_error() + 1e-4, "{name} {side}: {}", all.mean());
        }
    }
}

/// A closed box that emits E and reflects ρ everywhere holds E / (1 − ρ), many scatterings in a row misled or not.
#[test]
fn misled_paths_keep_closed_furnaces() {
    let world = World::prepare(Arc::new(samples::furnace(0.6, 0.25).unwrap()));
    let on_walls = |number: u32| {
        let [u, v, which, _] = crate::math::sobol::point(3, number);
        let axis = number as usize % 3;
        let side = if which < 0.5 { -1.0 } else { 1.0 };
        let mut to = Vec3::ZERO;
        (to[axis], to[(axis + 1) % 3], to[(axis + 2) % 3]) = (side, 2.0 * u - 1.0, 2.0 * v - 1.0);
        let mut normal = Vec3::ZERO;
        normal[axis] = -side;
        Flight { from: to + normal + 0.2 * Vec3::X, to, normal, flux_w: 1.0, is_focused: false }
    };
    let guide = Guide::of((0..10_000).map(on_walls).collect()).unwrap();
    let (found, _) = seen(&world, Some(&guide), 40, 32);
    let all = found.last().unwrap();
    let off = (all.mean() - 0.625).abs();
    // A hundredth at most, else it would say little.
    assert!(off < 4.0 * all.standard_error() && all.standard_error() < 0.0016, "{}", all.mean());
}

/// Of a room that is lit by a spot in a corner, guided paths know as much from half as many rays; in an even one they lose little.
#[test]
fn guidance_takes_noise_where_light_comes_from_one_side() {
    let noise = |world: &World, guide: Option<&Guide>| {
        let (found, counts) = seen(world, guide, 60, 4);
        let indirect = &found[PathClass::Indirect as usize];
        indirect.variance() / indirect.mean().powi(2) * counts.all_rays() as f64
    };
    let (world, photons) = traced(lit_corner());
    let [guided, plain] = [photons.guide(), None].map(|guide| noise(&world, guide));
    assert!(guided < 0.5 * plain, "{guided} for {plain}");
    let (world, photons) = traced(samples::cornell_box().unwrap());
    let [guided, plain] = [photons.guide(), None].map(|guide| noise(&world, guide));
    assert!(guided < 1.4 * plain, "{guided} for {plain}");
}

/// A box with a lamp in its ceiling beneath a pane of clear glass: light sampling does not see it, and few rays go there by chance.
fn lit_through_a_pane(has_size: bool) -> Scene {
    let mut stage = samples::Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.7))).unwrap();
    let clear = Material { transmission: 1.0, roughness: 0.0, ..Material::default() };
    let clear = stage.material("clear", clear).unwrap();
    let bright = Material { emission: Rgb::splat(20.0), ..Material::lambert(Rgb::BLACK) };
    let bright = stage.material("bright", bright).unwrap();
    let v = DVec3::new;
    let walls = samples::cuboid(DVec3::splat(-2.0), DVec3::splat(2.0), &white);
    stage.place("room", walls, DAffine3::from_scale(v(-1.0, 1.0, 1.0))).unwrap();
    stage
        .place("pane", samples::cuboid(v(-0.4, 1.9, -0.4), v(0.4, 1.95, 0.4), &clear), DAffine3::IDENTITY)
        .unwrap();
    let corners = [v(-0.2, 1.99, -0.2), v(0.2, 1.99, -0.2), v(0.2, 1.99, 0.2), v(-0.2, 1.99, 0.2)];
    if has_size {
        stage.place("lamp", samples::quad(corners, &bright), DAffine3::IDENTITY).unwrap();
    } else {
        let kind = LightKind::Point { intensity: Rgb::splat(5.0) };
        let light = Light { parent: None, position: v(0.0, 1.98, 0.0), direction: DVec3::NEG_Y, kind };
        stage.light("lamp", light).unwrap();
    }
    let view = CameraView::look_at(v(-1.8, -1.0, 1.8), v(2.0, -1.0, -1.0), DVec3::Y, 1.2);
    stage.camera("view", view, 1.0).unwrap();
    stage.finish()
}

/// Light that only glass sent on is found by chance alone: guided paths know it as well with a third of the rays.
#[test]
fn paths_are_guided_to_lamps_behind_glass() {
    let (world, photons) = traced(lit_through_a_pane(true));
    let runs = [None, photons.guide()].map(|guide| seen(&world, guide, 60, 16));
    let [plain, guided] = &runs;
    assert_same(&guided.0, &plain.0, "behind glass");
    let [plain, guided] = [plain, guided].map(|(found, counts)| {
        let focused = &found[PathClass::Caustic as usize];
        assert!(focused.mean() > 0.0);
        focused.variance() / focused.mean().powi(2) * counts.all_rays() as f64
    });
    assert!(3.0 * guided < plain, "{guided} for {plain}");
}

/// No path meets a lamp without size behind glass: photons of such light lead nobody there, those that a wall sent on do.
#[test]
fn nobody_is_guided_to_what_no_path_finds() {
    let flights = |has_size: bool| {
        let world = World::prepare(Arc::new(lit_through_a_pane(has_size)));
        let mut photons =
            PhotonTracing::new(PhotonSettings { emitted_count: 10_000, ..PhotonSettings::default() });
        photons.trace_all(&world);
        [PathClass::Caustic, PathClass::Indirect].map(|class| {
            let flights = photons.paths().flights((class, 1), |_| Vec3::Y);
            assert!(flights.iter().all(|flight| flight.is_focused == (class == PathClass::Caustic)));
            flights.len()
        })
    };
    let [focused, indirect] = flights(true);
    assert!(focused > 500 && indirect > 500, "{focused} {indirect}");
    let [focused, indirect] = flights(false);
    assert!(focused == 0 && indirect > 500, "{focused} {indirect}");
}
