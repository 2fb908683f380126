//! Laws of the path tracer [techniques.md, numerical laws].

mod guided;
mod known;
mod noted;
mod panes;

use std::sync::{Arc, atomic::AtomicBool};

use glam::{DAffine3, DQuat, DVec3, Vec3};

use crate::{
    film::{Film, PictureSize},
    math::Rgb,
    render::{Indirect, RenderSettings, Rendering},
    scene::{
        CameraView, Environment, Light, LightKind, Material, Scene, SceneBuilder, SceneLimits,
        samples::{self, Stage},
    },
    technique::Technique,
    transport::{PathClass, World},
};

fn render(scene: &Scene, side: u32, passes: u32, settings: RenderSettings) -> Film {
    let world = Arc::new(World::prepare(Arc::new(scene.clone())));
    let view = scene.camera_view(None).unwrap_or_else(|| scene.default_view());
    let mut rendering = Rendering::new(world, view, PictureSize::new(side, side).unwrap(), settings);
    for _ in 0..passes {
        rendering.step(&AtomicBool::new(false));
    }
    rendering.film().clone()
}

fn seeded(seed: u64) -> RenderSettings {
    RenderSettings { seed, ..RenderSettings::default() }
}

fn mean(image: &[Rgb]) -> f64 {
    image.iter().map(|rgb| f64::from(rgb.mean())).sum::<f64>() / image.len() as f64
}

/// Mean of the picture and the standard error of that mean, from the spread over pixels.
pub(super) fn mean_and_error(image: &[Rgb]) -> (f64, f64) {
    let mut statistics = crate::math::RunningStatistics::default();
    image.iter().for_each(|rgb| statistics.add(f64::from(rgb.mean())));
    (statistics.mean(), statistics.standard_error())
}

/// A closed box that emits E and reflects ρ everywhere holds radiance E / (1 − ρ), whatever ρ.
#[test]
fn closed_furnace_holds_the_geometric_sum() {
    for albedo in [0.0, 0.5, 0.9, 0.98] {
        let scene = samples::furnace(albedo, 0.25).unwrap();
        let film = render(&scene, 48, 64, seeded(1));
        let (mean, error) = mean_and_error(&film.radiance());
        let expected = 0.25 / (1.0 - f64::from(albedo));
        // 5 standard errors, and 1e-4 for rounding over the hundreds of bounces of the whitest box.
        assert!(
            (mean - expected).abs() < 5.0 * error + 1e-4 * expected,
            "ρ {albedo}: {mean} ± {error}, not {expected}"
        );
    }
}

/// In a uniform surrounding of radiance 1 whatever loses no light looks like nothing: radiance 1 in every pixel.
#[test]
fn white_furnace_keeps_radiance_one_for_every_lossless_bsdf() {
    let glass = Material { transmission: 1.0, roughness: 0.0, ..Material::default() };
    let mirror = Material { metallic: 1.0, roughness: 0.0, ..Material::default() };
    let half_glass = Material { transmission: 0.5, roughness: 0.0, ..Material::default() };
    let smooth_plastic = Material { roughness: 0.0, ..Material::default() };
    for (name, material) in [
        ("lambert", Material::lambert(Rgb::WHITE)),
        ("mirror", mirror),
        ("glass", glass.clone()),
        ("glass of ior 1", Material { ior: 1.0, ..glass.clone() }),
        ("diamond", Material { ior: 2.4, ..glass }),
        ("half glass", half_glass),
    ] {
        let film = render(&in_white_surroundings(material), 32, 64, seeded(2));
        let (mean, error) = mean_and_error(&film.radiance());
        assert!((mean - 1.0).abs() < 5.0 * error + 2e-3, "{name}: {mean} ± {error}");
    }
    // Reciprocal Fresnel coats give up a little where F depends on the half vector: never a gain.
    for roughness in [0.0, 0.1, 0.3, 0.6, 1.0] {
        for metallic in [0.0, 0.5, 1.0] {
            let film = render(
                &in_white_surroundings(Material { metallic, roughness, ..smooth_plastic.clone() }),
                24,
                64,
                seeded(2),
            );
            let (mean, error) = mean_and_error(&film.radiance());
            assert!(
                mean < 1.0 + 5.0 * error + 1e-3,
                "roughness {roughness} metallic {metallic} gains: {mean} ± {error}"
            );
            assert!(mean > 0.4, "roughness {roughness} metallic {metallic} loses more than stated: {mean}");
        }
    }
}

pub(super) fn in_white_surroundings(material: Material) -> Scene {
    let mut stage = Stage::default();
    let material = stage.material("subject", material).unwrap();
    stage.place("ball", samples::sphere(DVec3::ZERO, 1.0, 48, &material), DAffine3::IDENTITY).unwrap();
    stage.builder().set_environment(Environment::Constant(Rgb::WHITE)).unwrap();
    let view = CameraView::look_at(DVec3::new(0.0, 0.5, 3.0), DVec3::ZERO, DVec3::Y, 0.6);
    stage.camera("view", view, 1.0).unwrap();
    stage.finish()
}

/// The same bytes whatever the number of threads.
#[test]
fn thread_count_changes_no_bit() {
    // What shows of the sky is learnt by whoever asks first.
    for scene in [samples::cornell_box().unwrap(), samples::room_on_ground().unwrap()] {
        let on_threads = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| render(&scene, 40, 3, seeded(3)).radiance())
        };
        let one = on_threads(1);
        for threads in [2, 3, 7] {
            assert_eq!(one, on_threads(threads), "{threads} threads");
        }
    }
}

/// Layers add up to the picture, and a picture without indirect light is its direct layer and those of light that met nothing
/// diffuse, in the mean.
#[test]
fn direct_picture_equals_the_direct_layers_of_the_full_one() {
    let scene = samples::cornell_box().unwrap();
    let full = render(&scene, 48, 64, seeded(4));
    let direct = render(&scene, 48, 64, RenderSettings { indirect: Indirect::None, ..seeded(5) });
    for class in [PathClass::Emitted, PathClass::Specular, PathClass::Direct] {
        let (a, error_a) = mean_and_error(&difference(&full.layer(class), &direct.layer(class)));
        assert!(a.abs() < 5.0 * error_a + 1e-5, "{class:?}: {a} ± {error_a}");
    }
    for class in [PathClass::Caustic, PathClass::Indirect] {
        assert_eq!(mean(&direct.layer(class)), 0.0);
        assert!(mean(&full.layer(class)) > 0.0);
    }
}

/// What is around a scene is emitted light where it is seen as it is, specular in mirrors and through glass, and neither on what is matt.
#[test]
fn light_that_meets_nothing_diffuse_is_emitted_or_specular() {
    let mirror = Material { metallic: 1.0, roughness: 0.0, ..Material::default() };
    let brushed = Material { roughness: 0.4, ..mirror.clone() };
    let glass = Material { transmission: 1.0, roughness: 0.0, ..Material::default() };
    let matt = Material::lambert(Rgb::WHITE);
    let (specular, diffuse) = (&[PathClass::Specular][..], &[PathClass::Direct, PathClass::Indirect][..]);
    for (name, material, by) in [
        ("mirror", mirror, specular),
        ("brushed metal", brushed, specular),
        ("glass", glass, specular),
        ("matt", matt, diffuse),
    ] {
        let film = render(&in_white_surroundings(material), 32, 64, seeded(2));
        let light = PathClass::ALL.map(|class| film.layer(class));
        let (mut seen, mut met) = (0, 0);
        for (index, depth_m) in film.depth().into_iter().enumerate() {
            let of = |class: PathClass| light[class as usize][index].mean();
            let emitted = of(PathClass::Emitted);
            for class in PathClass::ALL.into_iter().filter(|class| *class != PathClass::Emitted) {
                let may_be = by.contains(&class) && depth_m > 0.0;
                assert!(may_be || of(class) == 0.0, "{name}: {} at {index}: {}", class.name(), of(class));
            }
            let other: f32 = by.iter().map(|class| of(*class)).sum();
            // Edges hold some of both.
            assert!(emitted + other > 0.5, "{name}: {emitted} and {other} at {index}");
            seen += usize::from(other == 0.0);
            met += usize::from(emitted == 0.0);
        }
        assert!(seen > 50 && met > 50, "{name}: {seen} and {met}");
    }
}

fn difference(a: &[Rgb], b: &[Rgb]) -> Vec<Rgb> {
    a.iter().zip(b).map(|(a, b)| *a - *b).collect()
}

/// A scene as it is, seen after a similarity transform of everything in it, camera and lights included.
pub(super) fn transformed(scene: &Scene, world_from_scene: DAffine3, scale: f64) -> Scene {
    let mut builder = SceneBuilder::new(SceneLimits::default());
    for (id, material) in scene.materials() {
        builder.set_material(id.clone(), (**material).clone()).unwrap();
    }
    let root = crate::scene::Id::new("root of all").unwrap();
    let node = crate::scene::Node { parent: None, parent_from_node: world_from_scene, mesh: None };
    builder.add_node(root.clone(), node).unwrap();
    for (id, mesh) in scene.meshes() {
        let source = crate::scene::MeshSource {
            positions: mesh.positions().iter().map(|p| p.as_dvec3() + mesh.centre()).collect(),
            normals: mesh.normals().to_vec(),
            triangles: mesh.triangles().to_vec(),
            primitives: mesh.primitives().to_vec(),
            ..Default::default()
        };
        builder.add_mesh(id.clone(), source).unwrap();
    }
    for (id, node) in scene.nodes() {
        let parent = Some(node.parent.clone().unwrap_or_else(|| root.clone()));
        builder.add_node(id.clone(), crate::scene::Node { parent, ..node.clone() }).unwrap();
    }
    for (id, light) in scene.lights() {
        let mut light = Light { parent: Some(root.clone()), ..light.clone() };
        // W/sr seen from `scale` times as far must be scale² as strong for the same irradiance.
        if let LightKind::Point { intensity } | LightKind::Spot { intensity, .. } = &mut light.kind {
            *intensity *= (scale * scale) as f32;
        }
        builder.add_light(id.clone(), light).unwrap();
    }
    for (id, camera) in scene.cameras() {
        let camera = crate::scene::Camera { parent: Some(root.clone()), ..camera.clone() };
        builder.set_camera(id.clone(), camera).unwrap();
    }
    builder.finish().0
}

/// The Cornell box with a point and a spot light: every kind of light that has a place.
pub(super) fn box_with_lights(factor: f32, only: Option<&str>) -> Scene {
    let mut builder = SceneBuilder::from_scene(&samples::cornell_box().unwrap(), SceneLimits::default());
    let light =
        |kind| Light { parent: None, position: DVec3::new(0.5, 1.5, 0.6), direction: DVec3::NEG_Y, kind };
    let point = light(LightKind::Point { intensity: Rgb::new(0.6, 0.9, 1.4) * factor });
    let spot = light(LightKind::Spot {
        intensity: Rgb::new(4.0, 2.0, 1.0) * factor,
        inner_angle_rad: 0.3,
        outer_angle_rad: 0.6,
    });
    let wanted = |name| only.is_none() || only == Some(name);
    if wanted("point") {
        builder.add_light(crate::scene::Id::new("point").unwrap(), point).unwrap();
    }
    if wanted("spot") {
        builder.add_light(crate::scene::Id::new("spot").unwrap(), spot).unwrap();
    }
    let radiance = if wanted("lamp") { Rgb::new(17.0, 12.5, 7.5) * factor } else { Rgb::BLACK };
    builder.set_material(crate::scene::Id::new("lamp").unwrap(), Material::emitter(radiance)).unwrap();
    builder.finish().0
}

/// Size, place and turn of a scene change nothing but noise; turns by right angles about the origin and
/// power-of-two scales not even that.
#[test]
fn similar_scenes_give_the_same_picture_at_any_scale_place_and_turn() {
    let scene = box_with_lights(1.0, None);
    let original = render(&scene, 32, 64, seeded(6)).radiance();
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 2.1);
    for (scale, rotation, offset) in [
        (1e-4, DQuat::IDENTITY, DVec3::ZERO),
        (1e4, DQuat::IDENTITY, DVec3::ZERO),
        (1.0, DQuat::IDENTITY, DVec3::new(1e5, -1e5, 7e4)),
        (1.0, turn, DVec3::ZERO),
        (1e-3, turn, DVec3::new(1e5, 3.0, -1e5)),
        (1e3, turn, DVec3::new(-1e5, 1e5, 2.0)),
    ] {
        let placed = DAffine3::from_scale_rotation_translation(DVec3::splat(scale), rotation, offset);
        let moved = render(&transformed(&scene, placed, scale), 32, 64, seeded(6)).radiance();
        let (bias, error) = mean_and_error(&difference(&moved, &original));
        let level = mean(&original);
        // The same numbers draw nearly the same paths, so the difference is far below the pictures' own noise.
        assert!(
            bias.abs() < 5.0 * error + 1e-3 * level,
            "scale {scale} offset {offset}: {bias} ± {error} of {level}"
        );
    }
}

/// Twice the light, twice the picture (to rounding), and pictures of single lights add up to that of all.
#[test]
fn pictures_are_linear_in_light() {
    let once = render(&box_with_lights(1.0, None), 32, 32, seeded(7)).radiance();
    let twice = render(&box_with_lights(2.0, None), 32, 32, seeded(7)).radiance();
    for (a, b) in once.iter().zip(&twice) {
        assert!((*a * 2.0 - *b).map(f32::abs).max_component() <= 2e-4 * b.max_component(), "{a:?} {b:?}");
    }
    let all = render(&box_with_lights(1.0, None), 32, 256, seeded(8)).radiance();
    let parts = ["lamp", "point", "spot"]
        .map(|light| render(&box_with_lights(1.0, Some(light)), 32, 256, seeded(9)).radiance());
    let sum: Vec<Rgb> = (0..all.len()).map(|i| parts[0][i] + parts[1][i] + parts[2][i]).collect();
    let (bias, error) = mean_and_error(&difference(&sum, &all));
    assert!(bias.abs() < 5.0 * error, "{bias} ± {error}");
}

/// A light a thousand million times another overflows nothing, and both show.
#[test]
fn extreme_light_ratios_stay_finite() {
    let mut builder = SceneBuilder::from_scene(&box_with_lights(1.0, None), SceneLimits::default());
    let sun = LightKind::Directional { irradiance: Rgb::splat(1e9) };
    let sun =
        Light { parent: None, position: DVec3::ZERO, direction: DVec3::new(0.1, -0.2, -1.0), kind: sun };
    builder.add_light(crate::scene::Id::new("sun").unwrap(), sun).unwrap();
    let film = render(&builder.finish().0, 32, 16, seeded(10));
    assert_eq!(film.dropped_samples(), 0);
    assert!(film.radiance().iter().all(|rgb| rgb.is_finite() && rgb.is_non_negative()));
}

/// A camera inside a wall, at the very light, or looking at nothing gives a finite picture.
#[test]
fn odd_cameras_give_finite_pictures() {
    let scene = samples::cornell_box().unwrap();
    let world = Arc::new(World::prepare(Arc::new(scene)));
    for (position, target) in [
        (DVec3::new(0.0, 0.0, 0.0), DVec3::Y),
        (DVec3::new(-0.38, 0.6, -0.35), DVec3::ZERO),
        (DVec3::new(0.0, 1.995, 0.0), DVec3::ZERO),
        (DVec3::new(1e6, 1e6, 1e6), DVec3::new(2e6, 2e6, 2e6)),
        (DVec3::new(0.5, 0.45, 0.1), DVec3::new(0.5, 0.0, 0.1)),
    ] {
        let view = CameraView::look_at(position, target, DVec3::Y, 1.0);
        let size = PictureSize::new(16, 16).unwrap();
        let mut rendering = Rendering::new(world.clone(), view, size, seeded(11));
        for _ in 0..8 {
            rendering.step(&AtomicBool::new(false));
        }
        assert_eq!(rendering.film().dropped_samples(), 0, "from {position}");
    }
}

/// A cancelled step leaves every tile with whole samples, and the next step goes on from there.
#[test]
fn a_cancelled_step_leaves_a_valid_film() {
    let scene = samples::cornell_box().unwrap();
    let world = Arc::new(World::prepare(Arc::new(scene.clone())));
    let size = PictureSize::new(32, 32).unwrap();
    let mut rendering = Rendering::new(world, scene.default_view(), size, seeded(12));
    assert!(!rendering.step(&AtomicBool::new(true)).complete);
    assert_eq!(rendering.passes(), 0);
    assert!(rendering.step(&AtomicBool::new(false)).complete);
    assert_eq!(rendering.passes(), 1);
}
