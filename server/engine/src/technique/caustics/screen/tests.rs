//! Laws of caustics on the screen: as bright from wherever they are looked at, and only on what shows them.

use std::f64::consts::PI;

use glam::{DAffine3, DVec3};

use super::super::tests::{mirror, point, seen_at, stage_with_mirror, v, world_of};
use super::*;
use crate::{
    film::PictureSize,
    math::Rgb,
    scene::{CameraView, Material, Projection, samples::quad},
};

const PERSPECTIVE: Projection = Projection::Perspective { yfov_rad: 1.0 };
const ORTHOGRAPHIC: Projection = Projection::Orthographic { half_height_m: 5.0 };

fn settings() -> CausticSettings {
    CausticSettings { photons_max: 100_000, ..CausticSettings::for_sketch(None, 3) }
}

fn view_from(world: &World, eye: DVec3, at: DVec3, projection: Projection, size: [u32; 2]) -> View {
    let size = PictureSize::new(size[0], size[1]).unwrap();
    let view = CameraView { projection, ..CameraView::look_at(eye, at, DVec3::Z, 1.0) };
    View::new(world, &view, size)
}

/// What Larsen scales for [Larsen2004, 12.1]: the distance, the angle, the size of the picture and the kind of camera change
/// nothing.
#[test]
fn caustics_are_as_bright_from_wherever_they_are_seen() {
    let world = world_of(stage_with_mirror(2.0, mirror(0.9), point(5.0), 0.0).finish());
    let image = v(0.0, -1.0, 0.0);
    let expected = |to: DVec3| {
        let away = to - image;
        5.0 * 0.9 * (away.normalize().y / away.length_squared()) * 0.8 / PI
    };
    let sketch = CausticSketch::of(&world, &settings());
    assert!(sketch.report().photons_stored > 5_000, "{:?}", sketch.report());
    let cameras = [
        (v(0.0, -8.0, 0.1), PERSPECTIVE, [512, 512]),
        (v(0.0, -0.5, 0.1), PERSPECTIVE, [200, 200]),
        (v(0.0, -30.0, 0.1), PERSPECTIVE, [640, 360]),
        (v(12.0, 0.0, 0.0), PERSPECTIVE, [512, 512]),
        (v(16.0, 1.5, 3.0), PERSPECTIVE, [1920, 1080]),
        // At a cosine of 0.06, 0.03 and 0.003.
        (v(16.0, 3.0, 3.0), PERSPECTIVE, [1920, 1080]),
        (v(30.0, 3.0, 3.0), PERSPECTIVE, [1024, 1024]),
        (v(12.0, 3.96, 0.0), PERSPECTIVE, [1024, 1024]),
        (v(0.0, -8.0, 0.1), ORTHOGRAPHIC, [512, 512]),
        (v(6.0, -6.0, 0.0), ORTHOGRAPHIC, [300, 200]),
    ];
    for (eye, projection, size) in cameras {
        let view = view_from(&world, eye, v(0.0, 4.0, 0.0), projection, size);
        let seen = sketch.seen_by(&view).unwrap();
        // Of the 10 m that are lit, the inner 3 m: these show from everywhere.
        let places =
            (0..400).map(|i| v(f64::from(i % 20) * 0.15 - 1.425, 4.0, f64::from(i / 20) * 0.15 - 1.425));
        let ratio = places.map(|to| seen_at(&world, &*seen, to) / expected(to)).sum::<f64>() / 400.0;
        // Seen along the ceiling windows are metres long.
        let within = if eye.y < 2.0 { 0.06 } else { 0.15 };
        assert!((ratio - 1.0).abs() < within, "{ratio} from {eye} at {size:?}");
        let shadow = seen_at(&world, &*seen, v(7.5, 4.0, 0.0));
        assert_eq!(shadow, 0.0, "from {eye} at {size:?}");
    }
}

/// What lies behind shows no caustic of what lies in front of it.
#[test]
fn caustics_stay_on_their_sheet() {
    let mut stage = stage_with_mirror(2.0, mirror(0.9), point(5.0), 0.0);
    let white = stage.material("roof", Material::lambert(Rgb::splat(0.8))).unwrap();
    let square = |h: f64, y: f64| [v(-h, y, h), v(h, y, h), v(h, y, -h), v(-h, y, -h)];
    stage.place("roof", quad(square(8.0, 4.3), &white), DAffine3::IDENTITY).unwrap();
    let world = world_of(stage.finish());
    let view = view_from(&world, v(0.0, -8.0, 0.1), v(0.0, 4.0, 0.0), PERSPECTIVE, [512, 512]);
    let seen = CausticSketch::of(&world, &settings()).seen_by(&view).unwrap();
    assert!(seen_at(&world, &*seen, v(0.0, 4.0, 0.0)) > 0.0);
    let ray = crate::accel::Ray::new(world.accel().to_render(v(0.0, 4.1, 0.0)), Vec3::Y);
    let roof = world.surface(&world.closest_hit(&ray).unwrap(), ray.direction);
    assert!(seen.scattered(&roof, -ray.direction, u32::MAX).diffuse.is_black());
}

/// Nothing specular, or nothing in sight: no photon, and nothing seen.
#[test]
fn without_caustics_there_is_nothing_on_the_screen() {
    let white = Material::lambert(Rgb::splat(0.5));
    let world = world_of(stage_with_mirror(2.0, white, point(5.0), 0.0).finish());
    let sketch = CausticSketch::of(&world, &settings());
    assert_eq!(sketch.report().photons_emitted + sketch.report().bytes as u64, 0);
    let view = view_from(&world, v(0.0, -8.0, 0.1), v(0.0, 4.0, 0.0), PERSPECTIVE, [16, 16]);
    assert_eq!(seen_at(&world, &*sketch.seen_by(&view).unwrap(), v(0.0, 4.0, 0.0)), 0.0);
    let world = world_of(stage_with_mirror(2.0, mirror(0.9), point(5.0), 0.0).finish());
    let away = view_from(&world, v(0.0, -8.0, 0.1), v(0.0, -20.0, 0.0), PERSPECTIVE, [1, 1]);
    let seen = CausticSketch::of(&world, &settings()).seen_by(&away).unwrap();
    assert_eq!(seen_at(&world, &*seen, v(0.0, 4.0, 0.0)), 0.0);
}

/// All the flux of a focus and of what lies loosely around it is seen, and no more: where wide windows meet narrow ones, and in
/// small pictures.
#[test]
fn flux_is_seen_once() {
    let world = world_of(stage_with_mirror(2.0, mirror(0.9), point(5.0), 0.0).finish());
    let sketch = CausticSketch::of(&world, &settings());
    let photon = *sketch.photons.iter().find(|photon| photon.normal.y < 0.0).unwrap();
    let middle = world.accel().to_render(v(0.0, 4.0, 0.0));
    // Rays meet pixels anywhere.
    let within = |i: u32| crate::math::sobol::point(9, i).map(|at| at.clamp(0.001, 0.999));
    // Most in a focus of 4 cm, some around it, every hundredth far out.
    let place = |i: u32| {
        let [u, v, ..] = crate::math::sobol::point(7, i);
        let radius_m = match i % 100 {
            0 => 1.0,
            1..20 => 0.6,
            _ => 0.02,
        };
        let (sin, cos) = (std::f32::consts::TAU * u).sin_cos();
        Vec3::new(cos, 0.0, sin) * (radius_m * v.sqrt())
    };
    let photons = (0..2000).map(|i| CausticPhoton {
        position: middle + place(i),
        direction: photon.normal,
        flux_w: Rgb::splat(1e-3),
        ..photon
    });
    let sketch = CausticSketch { photons: photons.collect(), ..sketch };
    for size in [[512, 512], [300, 200], [64, 48], [7, 7]] {
        let view = view_from(&world, v(0.3, 1.2, 0.1), v(0.0, 4.0, 0.0), PERSPECTIVE, size);
        let seen = sketch.seen_by(&view).unwrap();
        let mut flux_w = 0.0;
        for (x, y) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y))) {
            let [right, down, ..] = within(y * size[0] + x);
            let ray = view.ray(x as f32 + right, y as f32 + down);
            let surface = world.surface(&world.closest_hit(&ray).unwrap(), ray.direction);
            let (towards_eye, pixel_m2) = view.pixel_at(surface.point.position);
            let area_m2 = f64::from(pixel_m2 / towards_eye.dot(surface.point.n_geo).abs());
            let scattered = seen.scattered(&surface, -ray.direction, u32::MAX).diffuse.g;
            flux_w += f64::from(scattered) * PI / 0.8 * area_m2;
        }
        assert!((flux_w / 2.0 - 1.0).abs() < 0.01, "{flux_w} W at {size:?}");
    }
}

/// Photons beyond the picture's border count in the windows at it.
#[test]
fn borders_of_the_picture_are_as_bright_as_its_middle() {
    let world = world_of(stage_with_mirror(2.0, mirror(0.9), point(5.0), 0.0).finish());
    let many = CausticSettings { photons_max: 400_000, ..settings() };
    let sketch = CausticSketch::of(&world, &many);
    let narrow = Projection::Perspective { yfov_rad: 0.2 };
    let view = view_from(&world, v(0.0, -8.0, 0.1), v(0.0, 4.0, 0.0), narrow, [256, 256]);
    let seen = sketch.seen_by(&view).unwrap();
    let mean = |pixels: &mut dyn Iterator<Item = (f32, f32)>| {
        let (mut sum, mut count) = (0.0, 0);
        for (x, y) in pixels {
            let ray = view.ray(x, y);
            let at = ray.origin + ray.direction * ((4.0 + 8.0) / ray.direction.y);
            let up = crate::accel::Ray::new(at - Vec3::Y, Vec3::Y);
            let surface = world.surface(&world.closest_hit(&up).unwrap(), up.direction);
            sum += seen.scattered(&surface, -Vec3::Y, u32::MAX).diffuse.g;
            count += 1;
        }
        sum / count as f32
    };
    let along = |at: f32| (0..256).flat_map(move |i| [(at, i as f32 + 0.5), (i as f32 + 0.5, at)]);
    let border = mean(&mut along(0.5).chain(along(255.5)));
    let inner = mean(&mut along(64.5).chain(along(191.5)));
    assert!((border / inner - 1.0).abs() < 0.1, "{border} for {inner}");
}

/// A camera that sees a few photons from near is told to find its own.
#[test]
fn sketches_of_too_few_photons_are_not_seen() {
    let world = world_of(stage_with_mirror(2.0, mirror(0.9), point(5.0), 0.0).finish());
    let few = CausticSettings { photons_max: 50_000, ..settings() };
    let sketch = CausticSketch::of(&world, &few);
    let near = view_from(&world, v(0.0, 3.7, 0.1), v(0.0, 4.0, 0.0), PERSPECTIVE, [512, 512]);
    assert!(sketch.seen_by(&near).is_none());
    let far = view_from(&world, v(0.0, -8.0, 0.1), v(0.0, 4.0, 0.0), PERSPECTIVE, [512, 512]);
    assert!(sketch.seen_by(&far).is_some());
}
