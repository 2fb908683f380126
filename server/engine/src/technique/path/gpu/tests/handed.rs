//! Paths that a card hands over and the CPU follows to their ends.

use std::f64::consts::PI;

use glam::DQuat;

use super::{
    super::handed::{
        GpuHandedPath, HANDED_MAX, IS_BY_GLASS, IS_BY_MIRRORS, IS_CLOUDED, IS_NEAR, NEAR_COUNT_SHIFT, follow,
    },
    known_light::{ALL_STEPS, with_records},
    *,
};
use crate::{
    accel::{Ray, TriangleId},
    math::Rgb,
    scene::{CameraView, Environment, samples},
    technique::{Arrived, ArrivingLight, caustics::CausticLight, path::cpu::Sightline},
};

/// A pass in one slice, with the paths of it that have not ended.
fn pass(shot: &Shot, scene: &Arc<GpuScene>, number: u32, hands_over: bool) -> (GpuPathTracer, Handed) {
    let mut tracer = shot.tracer(scene);
    let pixel_count = shot.size.pixel_count();
    let Running { begun, .. } = shot.begin(&mut tracer, number);
    let light =
        LightBeside { known: shot.known.as_ref(), focused: shot.focused.as_ref(), ..LightBeside::default() };
    let traced = scene.trace_with(PathStart::Pixels, pixel_count, light, |tracing| {
        let capacity = tracing.capacity();
        let header = GpuPassHeader { path_count: pixel_count as u32, capacity, ..begun.header };
        let mut slice = tracing.trace_all(&header, hands_over)?;
        let paths = std::mem::take(&mut slice.handed);
        Ok((tracing.bring(&slice)?, paths))
    });
    let (brought, paths) = traced.unwrap();
    brought.read(|bytes| copy_samples(bytes, &mut tracer.samples)).unwrap();
    (tracer, Handed { first_pixel: 0, paths })
}

/// A closed room of one material with a lamp under the ceiling and something in it, seen from inside.
fn closed_room(walls: Material, lamp_half_m: f64, inside: impl FnOnce(&mut Stage)) -> Scene {
    let mut stage = Stage::default();
    let walls = stage.material("walls", walls).unwrap();
    let lamp = stage.material("lamp", Material::emitter(Rgb::new(9.0, 8.0, 7.0))).unwrap();
    placed(&mut stage, "room", samples::cuboid(DVec3::splat(-1.0), DVec3::splat(1.0), &walls));
    inside(&mut stage);
    let corners = SQUARE.map(|c| DVec3::new(lamp_half_m * c.x, 0.97, lamp_half_m * c.y));
    placed(&mut stage, "lamp", quad(corners, &lamp));
    let view = CameraView::look_at(DVec3::new(-0.3, 0.1, 0.9), DVec3::new(0.1, -0.2, 0.0), DVec3::Y, 1.2);
    stage.camera("main", view, 4.0 / 3.0).unwrap();
    stage.finish()
}

fn ball(material: &Material) -> impl FnOnce(&mut Stage) + '_ {
    move |stage| {
        let material = stage.material("ball", material.clone()).unwrap();
        placed(stage, "ball", samples::sphere(DVec3::new(0.2, -0.4, -0.2), 0.4, 24, &material));
    }
}

/// The eye in a block of glass that all but fills a room, with a matt ball in it: what is caught there comes out by way of that.
fn in_glass(glass: &Material, matt: &Material) -> Scene {
    closed_room(matt.clone(), 0.8, |stage| {
        let glass = stage.material("glass", glass.clone()).unwrap();
        placed(stage, "block", samples::cuboid(DVec3::splat(-0.95), DVec3::splat(0.95), &glass));
        ball(matt)(stage);
    })
}

/// Paths that go on by the CPU bring what they would have brought on the card, and all others the same bits: by matt walls, mirrors, in
/// glass that absorbs, under a sky, and where light is looked up and photons are. Those that take another decision bring as much in the mean.
#[test]
fn paths_that_are_handed_over_bring_the_same() {
    let Some(gpu) = shared() else { return };
    let matt = Material::lambert(Rgb::new(0.95, 0.9, 0.85));
    let mirror = |color| Material { base_color: color, metallic: 1.0, roughness: 0.0, ..Material::default() };
    let glass = Material {
        transmission: 1.0,
        roughness: 0.0,
        attenuation_color: Rgb::new(0.9, 0.8, 0.6),
        attenuation_distance_m: 5.0,
        ..Material::default()
    };
    let mirrors = || closed_room(mirror(Rgb::new(0.97, 0.95, 0.93)), 0.3, ball(&matt));
    let large = |of: Shot| Shot { size: size(96, 72), ..of };
    // Balls spread what rounding moves, from scattering to scattering: of their paths a tenth may differ, of others a fiftieth.
    let shots = [
        ("matt walls", large(shot(closed_room(matt.clone(), 0.8, |_| ()))), 50),
        ("matt walls and a mirror", shot(closed_room(matt.clone(), 0.3, ball(&mirror(Rgb::splat(0.9))))), 10),
        ("mirrors", shot(mirrors()), 10),
        (
            "mirrors, records and photons",
            with_records(mirrors(), ALL_STEPS, true).focused(CausticLight::All),
            10,
        ),
        ("glass ball", shot(closed_room(matt.clone(), 0.3, ball(&glass))), 10),
        ("in glass", large(shot(in_glass(&glass, &matt))), 10),
        ("tube under a sky", large(tube_under_a_sky(&matt)), 50),
    ];
    for (name, shot, one_of) in shots {
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let mut off = Vec::new();
        let noted = (0..PASSES)
            .map(|number| compare(&shot, &scene, number, (name, one_of), &mut off))
            .fold([0; 2], |[a, b], [more_a, more_b]| [a + more_a, b + more_b]);
        // In mirrors that look into each other the CPU is who finds what is seen, and that it shines.
        assert_eq!(noted.map(|noted| noted > 0), [name.starts_with("mirrors"); 2], "{name}: {noted:?}");
        let [mean, of_squares] =
            [1, 2].map(|power| off.iter().map(|off: &f64| off.powi(power)).sum::<f64>() / off.len() as f64);
        let error = ((of_squares - mean * mean) / off.len() as f64).sqrt();
        eprintln!("{name}: {} paths handed over, off by {mean:.1e} ± {error:.1e}", off.len());
        assert!(mean.abs() <= 4.0 * error + 1e-4, "{name}: {mean} ± {error}");
    }
}

/// Passes of each.
const PASSES: u32 = 4;

/// Inside of a long tube with matt walls, open at both ends, lit by a bright sky: most light comes late.
fn tube_under_a_sky(walls: &Material) -> Shot {
    let mut stage = Stage::default();
    let walls = stage.material("walls", walls.clone()).unwrap();
    stage.builder().set_environment(Environment::Constant(Rgb::new(1.0, 1.2, 1.5))).unwrap();
    let (half, long) = (0.5, 1.5);
    for (name, turn) in [("floor", 0.0), ("left", 0.5), ("ceiling", 1.0), ("right", 1.5)] {
        let corners = [[-half, long], [half, long], [half, -long], [-half, -long]];
        let turned = |[x, z]: [f64; 2]| DQuat::from_rotation_z(turn * PI) * DVec3::new(x, -half, z);
        placed(&mut stage, name, quad(corners.map(turned), &walls));
    }
    let view = CameraView::look_at(DVec3::new(-0.3, 0.1, 0.4), DVec3::new(0.1, -0.2, 0.0), DVec3::Y, 1.2);
    Shot { camera: view, ..shot(stage.finish()) }
}

/// One pass of it; adds by how much each path that was handed over is off, as a share of the mean.
///
/// - `one_of`: so many paths at most one takes another decision
/// - returns of how many the CPU notes what is beyond mirrors, and of how many that it shines
fn compare(
    shot: &Shot,
    scene: &Arc<GpuScene>,
    number: u32,
    (name, one_of): (&str, usize),
    off: &mut Vec<f64>,
) -> [usize; 2] {
    let (by_card, none) = pass(shot, scene, number, false);
    assert!(none.paths.is_empty(), "{name}");
    let (mut by_both, handed) = pass(shot, scene, number, true);
    let count = handed.paths.len();
    assert!((1..=HANDED_MAX as usize).contains(&count), "{name}: {count}");
    let is_handed = |slot: usize| handed.paths.iter().any(|path| path.slot as usize == slot);
    for slot in (0..shot.size.pixel_count()).filter(|slot| !is_handed(*slot)) {
        assert_eq!(by_card.samples[slot], by_both.samples[slot], "{name}, slot {slot}");
    }
    let samples = std::mem::take(&mut by_both.samples);
    let index = shot.begin(&mut by_both, number).begun.header.index;
    by_both.samples = samples;
    let followed = by_both.follow(&handed, index, shot.focused.as_deref());
    assert_eq!(followed.len(), count, "{name}");
    let before: Vec<GpuPixelSample> = by_both.samples.clone();
    let counts = by_both.add_followed(&handed, &followed);
    assert!(counts.rays as usize >= count && counts.paths == 0, "{name}: {counts:?}");
    let (mut others, mut brought, mut noted) = (0, 0, [0; 2]);
    for GpuHandedPath { slot, .. } in &handed.paths {
        let samples = [&by_card.samples, &by_both.samples, &before];
        let [card, both, begun] = samples.map(|samples| samples[*slot as usize].unpacked());
        let is_other_seen = match (card.beyond, both.beyond) {
            _ if card.is_shining != both.is_shining => true,
            (Some(card), Some(both)) => {
                // Both are rounded to bytes.
                let is_turned = card.normal.distance(both.normal) > 2.0 * BEYOND_TURN_MAX;
                is_turned || apart(card.albedo, both.albedo) > OFF_MAX
            }
            (card, both) => card.is_some() != both.is_some(),
        };
        noted[0] += usize::from(begun.beyond.is_none() && both.beyond.is_some());
        noted[1] += usize::from(!begun.is_shining && both.is_shining);
        let [card, both, begun] = [card, both, begun].map(|sample| sample.total());
        off.push(f64::from((both - card).mean()));
        others += usize::from(is_other_seen || off_rgb(card, both, 1e-4) > OFF_MAX);
        brought += usize::from(off_rgb(begun, both, 1e-4) > OFF_MAX);
    }
    assert!(others <= 1 + count / one_of, "{name}: {others} of {count}");
    // More than may take another decision, so that it shows where all others bring something else.
    assert!(brought > 2 * (1 + count / one_of), "{name}: {brought} of {count} bring anything");
    noted
}

/// The same of rays that light is gathered along.
#[test]
fn rays_that_are_handed_over_bring_the_same() {
    let Some(gpu) = shared() else { return };
    let matt = Material::lambert(Rgb::new(0.95, 0.9, 0.85));
    for (name, shot) in [
        ("matt walls", shot(closed_room(matt.clone(), 0.8, |_| ()))),
        ("tube under a sky", tube_under_a_sky(&matt)),
    ] {
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let view = View::new(&shot.world, &shot.camera, shot.size);
        let rays = rays_over_a_picture(&shot.world, &view, shot.size, 4);
        let gatherer = Arc::new(GpuGatherer::new(scene));
        let tracer = PathTracer::new(PathSettings::all(None, 4));
        let arriving = ArrivingByGpu::new(tracer, Arc::clone(&gatherer));
        let along =
            || arriving.along(&shot.world, &rays, &AtomicBool::new(false), &mut Counts::default()).unwrap();
        let by_card = along();
        assert!(gatherer.failure().is_none() && gatherer.ray_count() == rays.len() as u64);
        gatherer.stop();
        let by_cpu = along();
        let is_other = |(a, b): &(&Arrived, &Arrived)| off_rgb(a.radiance, b.radiance, 1e-4) > OFF_MAX;
        let others = by_card.iter().zip(&by_cpu).filter(is_other).count();
        eprintln!("{name}: {others} of {} rays bring another light", rays.len());
        // A sixteenth may be handed over.
        assert!(others <= 1 + rays.len() / 200, "{name}: {others} of {}", rays.len());
    }
}

/// More paths than there is room for go on by the card: none is handed over in part.
#[test]
fn more_paths_than_have_room_stay() {
    let Some(gpu) = shared() else { return };
    let white = Material::lambert(Rgb::splat(0.999));
    let shot = Shot { size: size(64, 48), ..shot(closed_room(white, 0.3, |_| ())) };
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let (by_both, handed) = pass(&shot, &scene, 0, true);
    let (by_card, _) = pass(&shot, &scene, 0, false);
    let count = handed.paths.len();
    assert!((1..=64 * 48 / 16).contains(&count), "{count}");
    let differing = by_card.samples.iter().zip(&by_both.samples).filter(|(a, b)| a != b).count();
    assert!(differing <= count, "{differing} samples lack something, {count} were handed over");
    let shortest = handed.paths.iter().map(|path| path.path.bounce).min().unwrap();
    assert!(shortest > 16, "{shortest}: all were there after 16 scatterings");
}

/// A path goes on in what it was in: the glass that a ray meets says by its surface what the number of its material says.
#[test]
fn paths_go_on_in_what_they_were_in() {
    let glass = Material {
        transmission: 1.0,
        roughness: 0.0,
        attenuation_color: Rgb::new(0.9, 0.5, 0.2),
        attenuation_distance_m: 0.7,
        ..Material::default()
    };
    let shot = shot(closed_room(Material::lambert(Rgb::splat(0.5)), 0.3, ball(&glass)));
    let towards = DVec3::new(0.2, -0.4, -0.2) - DVec3::new(-0.3, 0.1, 0.9);
    let ray = Ray {
        origin: DVec3::new(-0.3, 0.1, 0.9).as_vec3(),
        direction: towards.normalize().as_vec3(),
        t_max: f32::MAX,
        left: TriangleId::NONE,
    };
    let surface = shot.world.surface(&shot.world.closest_hit(&ray).unwrap(), ray.direction);
    let expected = surface.inside.expect("glass that absorbs").transmittance(1.3);
    let material = shot.world.scene().materials().keys().position(|id| id.as_str() == "ball").unwrap() as u32;
    let medium_of = |medium: u32| {
        let mut handed = GpuHandedPath::zeroed();
        handed.path.medium = medium;
        handed.underway(&shot.world, 0).unwrap().medium.map(|medium| medium.transmittance(1.3))
    };
    assert_eq!(medium_of(material + 1), Some(expected));
    for other in [0, material + 2, u32::MAX] {
        assert_ne!(medium_of(other), Some(expected), "{other}");
    }
}

/// What a path went by from the eye is known where it goes on, whatever else it passed.
#[test]
fn handed_paths_know_what_they_are_seen_by() {
    let shot = shot(closed_room(Material::lambert(Rgb::splat(0.5)), 0.3, |_| ()));
    let of = |passing: u32| {
        let mut handed = GpuHandedPath::zeroed();
        handed.path.passing = passing;
        let underway = handed.underway(&shot.world, 0).unwrap();
        (underway.sightline, underway.near_count)
    };
    for others in [0, IS_NEAR, IS_BY_MIRRORS, IS_NEAR | IS_BY_MIRRORS] {
        for near_count in [0, 1, 3] {
            let word = others | near_count << NEAR_COUNT_SHIFT;
            assert_eq!(of(word), (Sightline::Straight, near_count));
            assert_eq!(of(word | IS_BY_GLASS), (Sightline::Glass, near_count));
            assert_eq!(of(word | IS_CLOUDED), (Sightline::Clouded, near_count));
            assert_eq!(of(word | IS_CLOUDED | IS_BY_GLASS), (Sightline::Clouded, near_count));
        }
    }
}

/// What is no path is followed nowhere: words that no step of ours writes.
#[test]
fn hostile_paths_are_not_followed() {
    let shot = shot(closed_room(Material::lambert(Rgb::splat(0.5)), 0.3, |_| ()));
    let tracer = Tracer::of(&shot.world, shot.settings);
    let hostile = |class_of_path: u32, word: u32| {
        let mut path: GpuHandedPath = bytemuck::cast([word; 32]);
        path.path.class_so_far = class_of_path;
        path
    };
    for word in [0, 1, u32::MAX, f32::INFINITY.to_bits(), f32::NAN.to_bits(), 1.0_f32.to_bits()] {
        let no_class = PathClass::COUNT as u32;
        assert_eq!(follow(&tracer, &[hostile(no_class, word)], |_| Some(0)).len(), 0, "no class");
        for class in PathClass::ALL.map(|class| class as u32) {
            assert_eq!(follow(&tracer, &[hostile(class, word)], |_| None).len(), 0, "no slot");
            for followed in follow(&tracer, &[hostile(class, word)], |_| Some(0)) {
                assert_eq!(followed.slot, word as usize);
            }
        }
    }
}
