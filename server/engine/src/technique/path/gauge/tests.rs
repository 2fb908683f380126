//! Laws of gauges.

use super::*;
use crate::{
    math::Rgb,
    scene::{CameraView, Material, Scene, samples},
};
use glam::{DAffine3, DVec3};
use std::sync::Arc;

/// Whatever error is expected where, every picture's size has pixels in it, and weighed they stand for all of its pixels:
/// the weighted mean of any image is its mean.
#[test]
fn sets_stand_for_the_whole_picture() {
    for (width, height) in [(1, 1), (3, 500), (64, 48), (640, 3)] {
        let size = PictureSize::new(width, height).unwrap();
        let image = |x: u32, y: u32| 1.0 + f64::from(x * x + 3 * y);
        let mean = (0..height).flat_map(|y| (0..width).map(move |x| image(x, y))).sum::<f64>()
            / size.pixel_count() as f64;
        let mut expected: Vec<f32> = (0..size.pixel_count()).map(|i| (i % 7) as f32).collect();
        expected[0] = f32::INFINITY;
        for expected in [vec![], vec![0.0; size.pixel_count()], expected] {
            let sets: Vec<Set> = (0..400).map(|number| Set::nth(number, size, 1, &expected)).collect();
            let points = || sets.iter().flat_map(|set| &set.points);
            let count = points().count() as f64;
            let sum = points().map(|point| point.weight * image(point.x, point.y)).sum::<f64>();
            assert!((sum / count / mean - 1.0).abs() < 0.02, "{width}×{height}: {}", sum / count / mean);
            assert!(points().all(|point| point.weight <= 1.001 / EVEN_SHARE), "{width}×{height}");
            assert!(sets.iter().all(|set| set.points.len() <= SET_POINTS_MAX as usize));
        }
    }
}

/// Where error is expected in a hundredth of the picture, that has most of the pixels of every set.
#[test]
fn error_in_a_corner_is_met() {
    let size = PictureSize::new(80, 60).unwrap();
    let is_corner = |x: u32, y: u32| x < 8 && y < 6;
    let at = |index: u32| if is_corner(index % 80, index / 80) { 1.0 } else { 0.0 };
    let expected: Vec<f32> = (0..80 * 60).map(at).collect();
    for number in 0..8 {
        let set = Set::nth(number, size, 3, &expected);
        let met = set.points.iter().filter(|point| is_corner(point.x, point.y)).count();
        assert!(3 * met >= 2 * set.points.len(), "{met} of {}", set.points.len());
    }
}

/// Pixels that come again are traced with other numbers, and new sets begin once there are samples enough.
#[test]
fn what_comes_again_is_traced_anew() {
    let world = World::prepare(Arc::new(samples::boxes().unwrap()));
    let size = PictureSize::new(1, 1).unwrap();
    let view = View::new(&world, &world.scene().camera_view(None).unwrap(), size);
    let mut gauge = Gauge::new(PathSettings::all(None, 0), size);
    let never = AtomicBool::new(false);
    (0..8).for_each(|_| {
        gauge.step((&world, &view), 16, &[], [None, None], None, &never);
    });
    let pixels = gauge.pixels();
    assert_eq!((gauge.samples(), pixels.len(), gauge.is_black()), (16, 4, false));
    assert!(pixels.windows(2).all(|pair| pair[0].groups != pair[1].groups));
    assert!(gauge.cost().unwrap().variance > 0.0);
}

const PILOT: u32 = *PILOT_SAMPLES.start();

/// A room whose floor shines, and is all but free of noise; its walls are not.
fn over_a_shining_floor() -> Scene {
    let mut stage = samples::Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.6))).unwrap();
    let shining = Material { emission: Rgb::WHITE, ..Material::lambert(Rgb::splat(0.05)) };
    let shining = stage.material("shining", shining).unwrap();
    let v = DVec3::new;
    let walls = samples::cuboid(DVec3::splat(-2.0), DVec3::splat(2.0), &white);
    stage.place("room", walls, DAffine3::from_scale(v(-1.0, 1.0, 1.0))).unwrap();
    let corners = [v(-2.0, -1.9, 2.0), v(2.0, -1.9, 2.0), v(2.0, -1.9, -2.0), v(-2.0, -1.9, -2.0)];
    stage.place("floor", samples::quad(corners, &shining), DAffine3::IDENTITY).unwrap();
    let view = CameraView::look_at(v(0.0, 1.0, 1.8), v(0.0, -2.0, -0.6), DVec3::Y, 1.2);
    stage.camera("view", view, 1.0).unwrap();
    stage.finish()
}

/// A gauge of a box of so many steps, and what its next steps need.
fn of_box(world: &World, seed: u64, steps: u32) -> (Gauge, View) {
    let size = PictureSize::new(32, 32).unwrap();
    let view = View::new(world, &world.scene().camera_view(None).unwrap(), size);
    let mut gauge = Gauge::new(PathSettings::all(None, seed), size);
    step(&mut gauge, world, &view, steps);
    (gauge, view)
}

fn step(gauge: &mut Gauge, world: &World, view: &View, steps: u32) {
    let never = AtomicBool::new(false);
    (0..steps).for_each(|_| {
        gauge.step((world, view), 1 << 14, &[], [None, None], None, &never);
    });
}

/// A set that is known well enough is taken again, once; what was found the first time counts until the second is known half as well,
/// and then no more.
#[test]
fn pilots_count_until_their_successors_do() {
    let world = World::prepare(Arc::new(over_a_shining_floor()));
    let (mut gauge, view) = of_box(&world, 0, PILOT / STEP_SAMPLES - 1);
    gauge.concentrate(1e-3);
    assert_eq!(gauge.set_count(), 1, "too little is known");
    step(&mut gauge, &world, &view, 1);
    let pilot = gauge.pixels();
    (0..2).for_each(|_| gauge.concentrate(1e-3));
    assert_eq!(gauge.set_count(), 2);
    assert!(gauge.cost().unwrap().variance.is_finite());
    step(&mut gauge, &world, &view, PILOT / HALF_GROUPS / 2 - 1);
    assert_eq!(gauge.pixels(), pilot);
    step(&mut gauge, &world, &view, 1);
    let next = gauge.pixels();
    let place = |pixel: &GaugedPixel| (pixel.index, pixel.weight.to_bits());
    assert!(next.iter().map(place).eq(pilot.iter().map(place)));
    assert!(next.iter().zip(&pilot).any(|(next, pilot)| next.groups != pilot.groups));
    // Whoever asks for pixels that had no say before does not get these.
    assert!(gauge.pixels_since(1).is_empty() && gauge.pixels_since(0).len() == next.len());
    (0..2).for_each(|_| gauge.concentrate(1e-3));
    assert_eq!(gauge.set_count(), 2);
}

/// However sets differ when they are taken again, no pixel is without a say at any time.
#[test]
fn no_pixel_is_lost_while_sets_are_taken_again() {
    let world = World::prepare(Arc::new(over_a_shining_floor()));
    let (mut gauge, view) = of_box(&world, 1, 0);
    let never = AtomicBool::new(false);
    let step = |gauge: &mut Gauge, samples_enough: u32| {
        gauge.step((&world, &view), samples_enough, &[], [None, None], None, &never);
    };
    (0..2 * PILOT / STEP_SAMPLES).for_each(|_| step(&mut gauge, PILOT));
    (0..2).for_each(|_| step(&mut gauge, PILOT + STEP_SAMPLES));
    step(&mut gauge, PILOT + 2 * STEP_SAMPLES);
    assert_eq!(gauge.set_count(), 2);
    let count = gauge.pixels().len();
    gauge.concentrate(1e-3);
    assert_eq!(gauge.set_count(), 4);
    let mut noises = Vec::new();
    for _ in 0..120 {
        step(&mut gauge, 1 << 14);
        let pixels = gauge.pixels();
        assert_eq!(pixels.len(), count);
        noises.push(pixels.iter().map(|pixel| pixel.variance[1].powi(2)).sum::<f64>());
    }
    assert!(gauge.sets[2].samples > PILOT && gauge.sets[0].samples < 2 * PILOT);
    assert!(noises[119] < 0.5 * noises[0], "{noises:?}");
    // Sets before one that is asked for wait.
    gauge.trace_from(4);
    let before: Vec<u32> = gauge.sets.iter().map(|set| set.samples).collect();
    (0..4).for_each(|_| step(&mut gauge, 16));
    assert_eq!(gauge.sets[..4].iter().map(|set| set.samples).collect::<Vec<_>>(), before);
    assert_eq!((gauge.sets[4].samples, gauge.sets[5].samples), (16, 16));
}

/// With as many samples noisy pixels are known better and the sum of squared errors has less noise; what is found is as bright.
#[test]
fn noisy_pixels_get_more_samples() {
    let world = World::prepare(Arc::new(over_a_shining_floor()));
    let (mut noise, mut brightness) = ([0.0; 2], crate::math::RunningStatistics::default());
    for seed in 0..24 {
        let (mut gauge, view) = of_box(&world, seed, PILOT / STEP_SAMPLES);
        gauge.concentrate(1e-3);
        step(&mut gauge, &world, &view, PILOT / HALF_GROUPS);
        let [pilot, next] = [0, 1].map(|number| &gauge.sets[number]);
        assert_eq!((pilot.samples, next.samples), (PILOT, PILOT));
        let times = next.points.iter().map(|point| f64::from(point.times));
        assert!(times.clone().all(|times| (1.0..=TIMES_MAX[0]).contains(&times)));
        // As if both had taken as many in all.
        let mean = times.sum::<f64>() / next.points.len() as f64;
        assert!(mean > 1.0);
        for point in &next.points {
            let own = (point.weight * point.variance(next.samples, 1e-3)).powi(2);
            noise[0] += own;
            noise[1] += own * (mean / f64::from(point.times)).powi(2);
        }
        let of = |set: &Set| {
            let weighed = |point: &Point| point.weight * point.mean(set.samples).iter().sum::<f64>();
            set.points.iter().map(weighed).sum::<f64>()
        };
        brightness.add(of(next) / of(pilot) - 1.0);
    }
    assert!(noise[1] < 0.7 * noise[0], "{noise:?}");
    assert!(brightness.mean().abs() < 4.0 * brightness.standard_error(), "{}", brightness.mean());
    assert!(brightness.standard_error() < 0.02);
}
