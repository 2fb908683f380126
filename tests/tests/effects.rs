//! Every path is in one room: the layers of pictures that are looked up, caustics among them, are those of the path tracer, in
//! rooms of random things; and light that no path from the eye can find is in every picture of the chain alike.
//!
//! By default eight rooms; `LUMICAST_NIGHTLY=1` takes 200, or `LUMICAST_ROOMS` of them. A failure names its seed.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{DAffine3, DVec3};
use lumicast::assets::{AssetLimits, load_scene};
use lumicast_engine::effects::{EffectChoice, EffectChoices};
use lumicast_engine::film::PictureSize;
use lumicast_engine::math::{Rgb, sobol};
use lumicast_engine::render::{Indirect, Learning, RenderSettings, Rendering};
use lumicast_engine::scene::samples::{self, Stage, cuboid, quad, sphere};
use lumicast_engine::scene::{
    CameraView, Environment, Light, LightKind, Material, Scene, SceneBuilder, SceneLimits,
};
use lumicast_engine::transport::{PathClass, World};
use lumicast_tests::{compare_layers, mean, picture, shared_folder};

const SIDE: u32 = 32;
const PASSES: u32 = 48;

fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

/// Numbers in [0, 1) by seed and place.
struct Dice {
    seed: u64,
    rolled: u32,
}

impl Dice {
    fn roll(&mut self) -> f32 {
        self.rolled += 1;
        sobol::point(self.seed ^ 0x726f_6f6d, self.rolled)[0]
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * f64::from(self.roll())
    }

    fn colour(&mut self) -> Rgb {
        Rgb::new(0.2 + 0.7 * self.roll(), 0.2 + 0.7 * self.roll(), 0.2 + 0.7 * self.roll())
    }

    fn material(&mut self) -> Material {
        let base_color = self.colour();
        let metal = |roughness| Material { base_color, metallic: 1.0, roughness, ..Material::default() };
        match (self.roll() * 7.0) as u32 {
            0 => Material::lambert(base_color),
            // Below and above the width from which on light is gathered on a gloss.
            1 => metal(0.25),
            2 => metal(0.45),
            3 => metal(0.0),
            4 => {
                Material { transmission: 1.0, roughness: 0.0, base_color: Rgb::WHITE, ..Material::default() }
            }
            _ => Material { base_color, roughness: 0.1 + 0.8 * self.roll(), ..Material::default() },
        }
    }
}

/// A matt room with a lamp below the ceiling and three things of random shapes and materials in it.
fn room(seed: u64) -> Scene {
    let mut dice = Dice { seed, rolled: 0 };
    let mut stage = Stage::default();
    let wall = stage.material("wall", Material::lambert(dice.colour())).expect("a material");
    let lamp = stage.material("lamp", Material::emitter(Rgb::splat(12.0))).expect("a material");
    stage.place("room", cuboid(v(-2., 0., -2.), v(2., 3., 2.), &wall), DAffine3::IDENTITY).expect("walls");
    let half = dice.between(0.3, 0.8);
    let corners = [v(-half, 0., -half), v(half, 0., -half), v(half, 0., half), v(-half, 0., half)];
    stage.place("lamp", quad(corners, &lamp), DAffine3::from_translation(v(0., 2.9, 0.))).expect("a lamp");
    for index in 0..3 {
        let material = dice.material();
        let material = stage.material(&format!("m{index}"), material).expect("a material");
        let size = dice.between(0.25, 0.5);
        let shape = match dice.roll() < 0.5 {
            true => sphere(DVec3::ZERO, size, 24, &material),
            false => cuboid(DVec3::splat(-size), DVec3::splat(size), &material),
        };
        // A place of its own for each, off the walls.
        let place = v(1.2 * f64::from(index) - 1.2, dice.between(0.6, 1.2), dice.between(-1.2, 0.4));
        let turned = DAffine3::from_rotation_y(dice.between(0.0, 3.0));
        stage
            .place(&format!("thing {index}"), shape, DAffine3::from_translation(place) * turned)
            .expect("a thing");
    }
    let view = CameraView::look_at(v(0.2, 1.5, 1.9), v(0., 0.9, -0.5), DVec3::Y, 1.3);
    stage.camera("main", view, 1.0).expect("a camera");
    stage.finish()
}

#[test]
fn rooms_of_light_add_up_to_the_path_tracer_layer_by_layer() {
    let is_nightly = std::env::var_os("LUMICAST_NIGHTLY").is_some();
    let rooms =
        std::env::var("LUMICAST_ROOMS").ok().map(|rooms| rooms.parse().expect("LUMICAST_ROOMS: a number"));
    let mut failures = Vec::new();
    let mut with_caustics = 0;
    for seed in 0..rooms.unwrap_or(if is_nightly { 200 } else { 8u64 }) {
        let world = Arc::new(World::prepare(Arc::new(room(seed))));
        let compared = compare_layers(&format!("room {seed}"), &world, Indirect::Irradiance, PASSES);
        with_caustics += u32::from(compared.caustic_share > 0.02);
        failures.extend(compared.failures);
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(with_caustics >= 2, "{with_caustics} rooms have caustics worth the name");
}

/// What shines into a room.
enum Outside {
    Sky,
    Sun,
}

/// A room with a pane in its window, under its sky alone or its sun alone.
fn glazed_room(outside: Outside) -> Scene {
    let scene = samples::glazed_room().expect("a scene");
    let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
    match outside {
        Outside::Sky => builder.remove_light("sun").expect("a sun"),
        Outside::Sun => builder.set_environment(Environment::Constant(Rgb::BLACK)).expect("a night"),
    }
    builder.finish().0
}

/// The same of a room under a sky, with a pane in its window: path tracing finds that behind it by chance and by light sampling, and what is
/// looked up leaves it to light sampling. Fewer scatterings let it through or not in both.
#[test]
fn skies_behind_panes_add_up_to_the_path_tracer_layer_by_layer() {
    let world = Arc::new(World::prepare(Arc::new(glazed_room(Outside::Sky))));
    for indirect in [Indirect::Octree, Indirect::Irradiance] {
        let compared = compare_layers(&format!("{indirect:?}"), &world, indirect, PASSES);
        assert!(compared.failures.is_empty(), "{}", compared.failures.join("\n"));
        assert!(compared.caustic_share > 0.02, "{}", compared.caustic_share);
    }
    // The two sides of the pane and the surface that shows it are three.
    for (bounces, is_seen) in [(2, false), (3, true)] {
        let of = |indirect| {
            let settings =
                RenderSettings { indirect, bounces_max: Some(bounces), ..RenderSettings::default() };
            mean(&picture(&world, SIDE, settings, PASSES).film().layer(PathClass::Caustic))
        };
        let [path, octree] = [Indirect::Path, Indirect::Octree].map(of);
        assert_eq!([path > 0.0, octree > 0.0], [is_seen; 2], "{bounces}: {path} and {octree}");
        assert!((octree - path).abs() <= 0.1 * path, "{bounces}: {octree} for {path}");
    }
}

/// The same of the shared scenes, which take two minutes together: `LUMICAST_NIGHTLY=1` takes them all, `LUMICAST_SCENE` one.
#[test]
fn shared_scenes_add_up_to_the_path_tracer_layer_by_layer() {
    let named = std::env::var("LUMICAST_SCENE").ok();
    let is_asked = named.is_some() || std::env::var_os("LUMICAST_NIGHTLY").is_some();
    let Some(shared) = shared_folder().filter(|_| is_asked) else {
        println!("SKIPPED shared scenes: LUMICAST_NIGHTLY=1 and ../shared beside the project are needed");
        return;
    };
    let mut files: Vec<_> = std::fs::read_dir(shared.join("scenes"))
        .expect("scenes")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "glb"))
        .collect();
    files.sort();
    let mut failures = Vec::new();
    let mut count = 0;
    for file in files {
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        if named.as_ref().is_some_and(|named| *named != name) {
            continue;
        }
        count += 1;
        let scene = load_scene(&file, &AssetLimits::default()).expect("a scene");
        let world = Arc::new(World::prepare(Arc::new(scene)));
        failures.extend(compare_layers(&name, &world, Indirect::Irradiance, PASSES).failures);
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(count > 0, "no scene in {}", shared.display());
}

/// A lamp without size over a mirror in a dark room: the ceiling is lit by the mirror alone.
fn hidden_scene() -> Scene {
    let mut stage = Stage::default();
    let wall = stage.material("wall", Material::lambert(Rgb::splat(0.5))).expect("a material");
    let metal =
        Material { base_color: Rgb::splat(0.9), metallic: 1.0, roughness: 0.0, ..Material::default() };
    let metal = stage.material("mirror", metal).expect("a material");
    stage.place("room", cuboid(v(-2., 0., -2.), v(2., 3., 2.), &wall), DAffine3::IDENTITY).expect("walls");
    let corners = [v(-0.5, 0., 0.5), v(0.5, 0., 0.5), v(0.5, 0., -0.5), v(-0.5, 0., -0.5)];
    stage
        .place("mirror", quad(corners, &metal), DAffine3::from_translation(v(0., 0.5, 0.)))
        .expect("a mirror");
    let kind = LightKind::Spot { intensity: Rgb::splat(20.0), inner_angle_rad: 0.3, outer_angle_rad: 0.6 };
    let light = Light { kind, parent: None, position: v(0.0, 1.2, 0.0), direction: DVec3::NEG_Y };
    stage.light("spot", light).expect("a light");
    let view = CameraView::look_at(v(0.0, 1.0, 1.9), v(0.0, 2.4, -1.0), DVec3::Y, 1.2);
    stage.camera("main", view, 1.0).expect("a camera");
    stage.finish()
}

/// Work that is cut short again and again ends in the same bytes.
#[test]
fn pictures_with_caustics_do_not_depend_on_cuts() {
    let view = room(3).camera_view(None).expect("a camera");
    let size = PictureSize::new(SIDE, SIDE).expect("a size");
    for (scene, indirect) in [(room(3), Indirect::Irradiance), (hidden_scene(), Indirect::Auto)] {
        let view = if indirect == Indirect::Auto { scene.camera_view(None).expect("a camera") } else { view };
        let world = Arc::new(World::prepare(Arc::new(scene)));
        let of =
            RenderSettings { indirect, seed: 1, learning: Learning::InStep, ..RenderSettings::default() };
        let [whole, cut] = [false, true].map(|is_cut| {
            let mut rendering = Rendering::new(world.clone(), view, size, of);
            let mut passes = 0;
            while rendering.passes() < 40 {
                if is_cut && passes != rendering.passes() {
                    (0..2).for_each(|_| {
                        rendering.step(&AtomicBool::new(true));
                    });
                }
                passes = rendering.passes();
                rendering.step(&AtomicBool::new(false));
            }
            rendering.picture().radiance()
        });
        assert!(whole == cut, "{indirect:?}");
    }
}

#[test]
fn light_that_no_path_finds_stays_in_pictures_of_the_chain() {
    let without = EffectChoices { caustics: EffectChoice::Off, ..EffectChoices::default() };
    // Without its caustics as well: what surfaces send on of them is indirect light.
    for (name, scene, effects) in [
        ("mirror", hidden_scene(), EffectChoices::default()),
        ("mirror", hidden_scene(), without),
        ("sun behind a pane", glazed_room(Outside::Sun), EffectChoices::default()),
    ] {
        let world = Arc::new(World::prepare(Arc::new(scene)));
        let of = |indirect| RenderSettings { indirect, effects, seed: 7, ..RenderSettings::default() };
        let looked_up = mean(&picture(&world, SIDE, of(Indirect::Irradiance), 64).picture().radiance());
        let chain = picture(&world, SIDE, of(Indirect::Auto), 800);
        let of_chain = chain.picture();
        let found = mean(&of_chain.radiance());
        assert!((found / looked_up - 1.0).abs() < 0.03, "{name}, {effects:?}: {found} for {looked_up}");
        // The measure of the error does not take it for one.
        let error = chain.measured_error_of(&of_chain).expect("a measure").error();
        assert!(error < 0.1, "{name}, {effects:?}: {error}");
        // What paths from the eye find by themselves is less, of a sun behind a pane by what that reflects alone.
        let path = mean(&picture(&world, SIDE, of(Indirect::Path), 64).picture().radiance());
        let expected = if name == "mirror" { 0.0..0.8 } else { 0.95..1.01 };
        assert!(expected.contains(&(path / looked_up)), "{name}, {effects:?}: {path} of {looked_up}");
        let share = of_chain.traced_share();
        assert!(share > 0.05, "{name}, {effects:?}: {share}: nothing was path-traced");
    }
}
