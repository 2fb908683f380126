//! What samples note of surfaces that are seen by way of mirrors and glass.

use super::*;
use crate::{
    accel::Ray,
    film::{Beyond, PixelSample},
    math::sobol::PixelSampler,
    scene::{Id, MeshSource},
    technique::{
        Counts,
        path::{PathSettings, Tracer, closed_forms::SQUARE},
    },
};

const SAMPLES: u32 = 400;

/// A wall one metre behind the eye, if there is one, and something before it that looks back.
fn stage(wall: Option<Material>) -> Stage {
    let mut stage = Stage::default();
    stage.builder().set_environment(Environment::Constant(Rgb::new(0.2, 0.3, 0.4))).unwrap();
    if let Some(wall) = wall {
        let faces_the_eye = SQUARE.map(|c| 3.0 * DVec3::new(-c.x, c.y, 0.0) + DVec3::Z);
        placed(&mut stage, "wall", wall, |material| samples::quad(faces_the_eye, material));
    }
    stage
}

fn placed(stage: &mut Stage, name: &str, material: Material, mesh: impl Fn(&Id) -> MeshSource) {
    let material = stage.material(name, material).unwrap();
    stage.place(name, mesh(&material), DAffine3::IDENTITY).unwrap();
}

fn with_front(mut stage: Stage, front: Material) -> Stage {
    placed(&mut stage, "front", front, |material| samples::quad(SQUARE.map(|c| c - DVec3::Z), material));
    stage
}

/// Samples of one ray from the origin.
fn samples_of(stage: Stage, direction: Vec3) -> Vec<PixelSample> {
    let world = World::prepare(Arc::new(stage.finish()));
    let tracer = Tracer::of(&world, PathSettings::all(None, 3));
    let origin = world.accel().to_render(DVec3::ZERO);
    let ray = Ray::new(origin, direction);
    let sample = |index| {
        let sampler = PixelSampler::new(3, 0, 0, index);
        tracer.sample_pixel(&ray, world.closest_hit(&ray), &sampler, &mut Counts::default())
    };
    (0..SAMPLES).map(sample).collect()
}

fn metal(base_color: Rgb, roughness: f32) -> Material {
    Material { base_color, metallic: 1.0, roughness, ..Material::default() }
}

fn noted(samples: &[PixelSample]) -> Vec<Beyond> {
    samples.iter().filter_map(|sample| sample.beyond).collect()
}

fn assert_same(found: Beyond, albedo: Rgb, normal: Vec3) {
    let off = (found.albedo - albedo).map(f32::abs).max_component();
    assert!(off < 1e-5 && found.normal.distance(normal) < 1e-5, "{found:?} for {albedo:?} {normal:?}");
}

/// Whatever is seen in a mirror is noted as it is seen straight, in the mirror's colour.
#[test]
fn what_a_mirror_shows_is_noted_in_its_colour() {
    let tint = Rgb::new(0.9, 0.8, 0.7);
    let ahead = Vec3::new(0.1, 0.05, -1.0).normalize();
    let back = ahead * Vec3::new(1.0, 1.0, -1.0);
    for wall in [
        Material::lambert(Rgb::new(0.2, 0.5, 0.7)),
        Material::lambert(Rgb::BLACK),
        Material::emitter(Rgb::splat(3.0)),
        Material { unlit: true, ..Material::lambert(Rgb::new(0.3, 0.6, 0.1)) },
        Material { base_color: Rgb::new(0.1, 0.4, 0.2), roughness: 0.0, ..Material::default() },
        metal(Rgb::new(0.8, 0.6, 0.2), 0.3),
    ] {
        let straight = samples_of(stage(Some(wall.clone())), back)[0];
        assert_eq!(straight.beyond, None);
        let mirrored = samples_of(with_front(stage(Some(wall)), metal(tint, 0.0)), ahead);
        let noted = noted(&mirrored);
        assert_eq!(noted.len(), mirrored.len());
        noted.into_iter().for_each(|beyond| assert_same(beyond, tint * straight.albedo, straight.normal));
    }
    // What is around the scene faces the ray.
    let sky = noted(&samples_of(with_front(stage(None), metal(tint, 0.0)), ahead));
    assert_eq!(sky.len(), SAMPLES as usize);
    sky.into_iter().for_each(|beyond| assert_same(beyond, tint, -back));
}

/// Through a pane what lies behind is noted, tinted twice; what its two sides reflect, one sample in twelve, is not.
#[test]
fn what_lies_behind_a_pane_is_noted_and_its_reflections_are_not() {
    let tint = Rgb::new(0.9, 1.0, 0.8);
    let back = Vec3::new(0.1, 0.05, 1.0).normalize();
    let wall = Material::lambert(Rgb::new(0.2, 0.5, 0.7));
    let straight = samples_of(stage(Some(wall.clone())), back)[0];
    let mut stage = stage(Some(wall));
    let pane = Material { base_color: tint, transmission: 1.0, roughness: 0.0, ..Material::default() };
    let [min, max] = [DVec3::new(-2.0, -2.0, 0.4), DVec3::new(2.0, 2.0, 0.41)];
    placed(&mut stage, "pane", pane, |material| samples::cuboid(min, max, material));
    let samples = samples_of(stage, back);
    let noted = noted(&samples);
    // 1 − 0.96² = 7.8 % are reflected, of 400 give or take 1.3 %.
    let reflected = 1.0 - noted.len() as f64 / samples.len() as f64;
    assert!((0.02..0.14).contains(&reflected), "{reflected}");
    noted.into_iter().for_each(|beyond| assert_same(beyond, tint * tint * straight.albedo, straight.normal));
}

/// Where glass reflects all, what is seen by that is noted: the wall beyond the end of a block that the eye is in, by way of its side. What
/// the end reflects, a sample in sixteen, is not.
#[test]
fn what_total_reflection_shows_is_noted() {
    let tint = Rgb::new(0.9, 1.0, 0.8);
    let albedo = Rgb::new(0.2, 0.5, 0.7);
    let mut stage = stage(None);
    let beyond_the_end = SQUARE.map(|c| DVec3::new(3.0, 9.0 * c.y, 9.0 * c.x));
    placed(&mut stage, "wall", Material::lambert(albedo), |material| samples::quad(beyond_the_end, material));
    let glass = Material { base_color: tint, transmission: 1.0, roughness: 0.0, ..Material::default() };
    let [min, max] = [DVec3::new(-2.0, -2.0, -0.5), DVec3::new(2.0, 2.0, 0.5)];
    placed(&mut stage, "block", glass, |material| samples::cuboid(min, max, material));
    // 60° off the side's normal, of which 42° are enough, and 30° off the end's.
    let samples = samples_of(stage, Vec3::new(3f32.sqrt(), 0.0, -1.0) / 2.0);
    let noted = noted(&samples);
    let reflected = 1.0 - noted.len() as f64 / samples.len() as f64;
    assert!((0.01..0.14).contains(&reflected), "{reflected}");
    // Radiance is η² times as much in glass.
    noted.into_iter().for_each(|beyond| assert_same(beyond, tint * albedo * 2.25, Vec3::NEG_X));
}

/// What shines is told as such where it is shown as it is: straight, and by mirrors alone. Glass shows it in one sample and not in the next, and
/// so does a coat.
#[test]
fn what_shines_is_noted_straight_and_in_mirrors() {
    let ahead = Vec3::new(0.1, 0.05, -1.0).normalize();
    let back = ahead * Vec3::new(1.0, 1.0, -1.0);
    let mirror = || metal(Rgb::new(0.9, 0.8, 0.7), 0.0);
    let pane = Material { base_color: Rgb::WHITE, transmission: 1.0, roughness: 0.0, ..Material::default() };
    let coated = Material { roughness: 0.0, ..Material::default() };
    let count_of = |samples: &[PixelSample]| samples.iter().filter(|sample| sample.is_shining).count();
    let all = SAMPLES as usize;
    let unlit = Material { unlit: true, ..Material::lambert(Rgb::new(0.3, 0.6, 0.1)) };
    for (wall, shines) in [
        (Some(Material::emitter(Rgb::splat(3.0))), true),
        (Some(unlit), true),
        (None, true),
        (Some(Material::lambert(Rgb::WHITE)), false),
    ] {
        let here = || stage(wall.clone());
        let counts = [
            samples_of(here(), back),
            samples_of(with_front(here(), mirror()), ahead),
            samples_of(with_front(here(), pane.clone()), ahead),
            samples_of(with_front(here(), coated.clone()), ahead),
        ]
        .map(|samples| count_of(&samples));
        let shown = if shines { all } else { 0 };
        assert_eq!(counts, [shown, shown, 0, 0], "{wall:?}");
    }
    // From mirror to mirror, until one shows what shines; not once glass was on the way.
    for (between, shown) in [(mirror(), all), (pane, 0)] {
        let mut stage = stage(Some(Material::emitter(Rgb::splat(3.0))));
        let aslant = SQUARE.map(|c| DVec3::new(c.x, c.y, c.x - 1.5));
        placed(&mut stage, "aslant", between, |material| samples::quad(aslant, material));
        let across = SQUARE.map(|c| DVec3::new(c.x - 1.5, c.y, -1.5 - c.x));
        placed(&mut stage, "across", mirror(), |material| samples::quad(across, material));
        assert_eq!(count_of(&samples_of(stage, Vec3::new(0.05, 0.02, -1.0).normalize())), shown);
    }
}

/// What scatters, if little, is what is seen itself: nothing is noted beyond a coat, rough metal or what is seen in those.
#[test]
fn nothing_is_noted_beyond_what_scatters() {
    let ahead = Vec3::new(0.1, 0.05, -1.0).normalize();
    let coated = Material { roughness: 0.0, ..Material::default() };
    let frosted =
        Material { base_color: Rgb::splat(0.8), transmission: 0.5, roughness: 0.0, ..Material::default() };
    for front in [Material::lambert(Rgb::splat(0.5)), coated, frosted, metal(Rgb::splat(0.9), 0.2)] {
        let wall = Material::lambert(Rgb::splat(0.5));
        assert_eq!(noted(&samples_of(with_front(stage(Some(wall)), front), ahead)), []);
    }
}
