//! Laws of paths that photons say where to go.

use std::sync::{Arc, atomic::AtomicBool};

use glam::{DAffine3, DVec3, Vec3};

use super::in_white_surroundings;
use crate::{
    film::PictureSize,
    math::{Rgb, RunningStatistics, sobol::PixelSampler, warp},
    scene::{CameraView, Light, LightKind, Material, Scene, samples},
    technique::{
        Guide, Products, Step, Technique,
        path::{
            Counts, PathSettings, Tracer, View,
            cpu::{Near, primary_ray},
        },
        photons::{PhotonSettings, PhotonTracing},
        samples_of_guides::guide_of,
    },
    transport::{PathClass, World},
};

const SIDE: u32 = 12;

/// Means over the picture by class, of `passes` samples a pixel each, and the rays of all.
fn seen(world: &World, guide: Option<&Guide>, runs: u32, passes: u32) -> (Vec<RunningStatistics>, Counts) {
    let view = world.scene().camera_view(None).unwrap();
    let view = View::new(world, &view, PictureSize::new(SIDE, SIDE).unwrap());
    let tracer = Tracer {
        world,
        view: Some(&view),
        settings: PathSettings::all(None, 3),
        secondary: None,
        screen: None,
        caustics: None,
        near: Near::Blurred,
        guide,
    };
    let mut counts = Counts::default();
    let mut found = vec![RunningStatistics::default(); PathClass::ALL.len() + 1];
    for run in 0..runs {
        let mut sums = [0.0; PathClass::ALL.len() + 1];
        for (pixel, index) in (0..SIDE * SIDE).flat_map(|pixel| (0..passes).map(move |index| (pixel, index)))
        {
            let sampler = PixelSampler::new(u64::from(guide.is_some()), run, pixel, index);
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

/// Both see the same light of every class.
fn assert_same(guided: &[RunningStatistics], plain: &[RunningStatistics], what: &str) {
    for (guided, plain) in guided.iter().zip(plain) {
        let error = guided.standard_error().hypot(plain.standard_error());
        let off = (guided.mean() - plain.mean()).abs();
        assert!(off < 4.0 * error + 1e-6, "{what}: {} for {} ± {error}", guided.mean(), plain.mean());
    }
}

fn traced(scene: Scene) -> (World, Guide) {
    let world = World::prepare(Arc::new(scene));
    let mut photons =
        PhotonTracing::new(PhotonSettings { emitted_count: 100_000, ..PhotonSettings::default() });
    let (mut products, never) = (Products::default(), AtomicBool::new(false));
    let mut step = Step { world: &world, products: &mut products, canvas: None, cancel: &never };
    while !photons.is_complete() {
        photons.step(&mut step);
    }
    let guide = Guide::of(photons.product().flights().to_vec()).unwrap();
    (world, guide)
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
    let (guided, _) = seen(&world, Some(&right), 40, 16);
    assert_same(&guided, &plain, "right");
    let (_, wrong) = traced(lit_corner());
    let (misled, _) = seen(&world, Some(&wrong), 40, 16);
    assert_same(&misled, &plain, "of another scene");
}

/// In white surroundings whatever loses no light looks like nothing, also where photons speak of one side alone.
#[test]
fn misled_paths_keep_the_white_furnace() {
    let half_glass = Material { transmission: 0.5, roughness: 0.0, ..Material::default() };
    for (name, material) in [("lambert", Material::lambert(Rgb::WHITE)), ("half glass", half_glass)] {
        let world = World::prepare(Arc::new(in_white_surroundings(material)));
        let from = |side: Vec3| {
            let photon = |number: u32| {
                let [u, v, ..] = crate::math::sobol::point(3, number);
                {
                    let to = warp::cosine_hemisphere([u, v]);
                    (to, to + side)
                }
            };
            guide_of(Vec3::Z, (0..400).map(photon))
        };
        for side in [Vec3::Z, Vec3::new(0.9, 0.1, 0.3), Vec3::NEG_Z] {
            let guide = from(side.normalize());
            let (found, _) = seen(&world, Some(&guide), 24, 16);
            let all = found.last().unwrap();
            let off = (all.mean() - 1.0).abs();
            assert!(off < 4.0 * all.standard_error() + 2e-3, "{name} {side}: {}", all.mean());
        }
    }
}

/// Of a room that is lit by a spot in a corner, guided paths know as much from half as many rays; in an even one they lose little.
#[test]
fn guidance_takes_noise_where_light_comes_from_one_side() {
    let noise = |world: &World, guide: Option<&Guide>| {
        let (found, counts) = seen(world, guide, 60, 4);
        let indirect = &found[PathClass::Indirect as usize];
        indirect.variance() / indirect.mean().powi(2) * counts.all_rays() as f64
    };
    let (world, guide) = traced(lit_corner());
    let [guided, plain] = [Some(&guide), None].map(|guide| noise(&world, guide));
    assert!(guided < 0.5 * plain, "{guided} for {plain}");
    let (world, guide) = traced(samples::cornell_box().unwrap());
    let [guided, plain] = [Some(&guide), None].map(|guide| noise(&world, guide));
    assert!(guided < 1.4 * plain, "{guided} for {plain}");
}
