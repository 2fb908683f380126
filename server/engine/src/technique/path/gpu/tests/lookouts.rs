//! What places see, drawn on a card beside rays through the middles of pixels.

use glam::Vec3;

use super::{super::lookouts::meet, gathering::cabinet, textures::masked, *};
use crate::{
    accel::{Hit, Ray, SurfacePoint, TriangleId},
    gpu::GpuOptions,
    scene::{Projection, samples},
    technique::{Lookout, irradiance::HemiPlane},
};

/// Share of pixels that may see another triangle than their ray: cards move corners to multiples of 1/256 of a pixel, and edges that pass so
/// near to a pixel's middle may pass on its other side. Of 55,552 pixels in these tests 27 did on a software adapter.
const ELSEWHERE_MAX: f64 = 2e-3;
/// How far apart what both see may lie, over its distance.
const APART_MAX: f32 = 1e-4;

/// Planes before what some pixels of the camera see, and the camera's own view.
fn lookouts_of(shot: &Shot) -> [Vec<Lookout>; 2] {
    let view = View::new(&shot.world, &shot.camera, size(64, 48));
    let of_camera = Lookout { view, left: TriangleId::NONE };
    let few = View::new(&shot.world, &shot.camera, size(8, 6));
    let places = (0..48).filter_map(|pixel| {
        let ray = few.ray((pixel % 8) as f32 + 0.5, (pixel / 8) as f32 + 0.5);
        Lookout::before_what_is_met(&shot.world, &ray, HemiPlane::HALF_SIDE as f32, size(16, 16))
    });
    [vec![of_camera], places.collect()]
}

fn along_rays(world: &World, lookouts: &[Lookout]) -> Vec<Option<Hit>> {
    lookouts.iter().flat_map(Lookout::rays).map(|ray| world.closest_hit(&ray)).collect()
}

/// Pixels see the triangle that their ray meets, where it meets it; through holes of masks too, on turned and mirrored meshes, and never
/// the triangle that they lie on.
#[test]
fn planes_see_what_rays_meet() {
    let Some(gpu) = shared() else { return };
    let (mut pixels, mut elsewhere) = (0, 0);
    for (name, scene) in [
        ("boxes", samples::boxes().unwrap()),
        ("cornell box", samples::cornell_box().unwrap()),
        ("cabinet", cabinet()),
        ("masks", masked()),
    ] {
        let shot = shot(scene);
        let scene = GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world));
        for lookouts in lookouts_of(&shot) {
            let (rays, drawn) = (along_rays(&shot.world, &lookouts), scene.visible(&lookouts).unwrap());
            assert_eq!(rays.len(), drawn.len());
            assert!(rays.iter().flatten().count() * 4 > rays.len(), "{name}: nothing to see");
            let mut others = 0;
            for (number, (met, seen)) in rays.iter().zip(&drawn).enumerate() {
                let left = lookouts[number / lookouts[0].view.size().pixel_count()].left;
                assert!(seen.is_none_or(|seen| seen.triangle_id() != left), "{name}: itself");
                match (met, seen) {
                    (None, None) => {}
                    (Some(met), Some(seen)) if met.triangle_id() == seen.triangle_id() => {
                        assert!((seen.t - met.t).abs() <= APART_MAX * met.t, "{name}: {seen:?} for {met:?}");
                        let [there, here] = [met, seen]
                            .map(|hit| shot.world.accel().instances()[hit.instance as usize].point_of(hit));
                        let apart = there.position.distance(here.position);
                        assert!(apart <= 10.0 * APART_MAX * met.t, "{name}: {apart} m at {} m", met.t);
                    }
                    _ => others += 1,
                }
            }
            eprintln!("{name}: {others} of {} pixels see another triangle", rays.len());
            pixels += rays.len();
            elsewhere += others;
        }
    }
    assert!(elsewhere as f64 <= ELSEWHERE_MAX * pixels as f64, "{elsewhere} of {pixels}");
}

/// The triangle that is looked from is not seen where it lies in view, as under a tilted normal, and everything else is.
#[test]
fn what_is_looked_from_is_not_seen() {
    let Some(gpu) = shared() else { return };
    let shot = shot(samples::boxes().unwrap());
    let view = View::new(&shot.world, &shot.camera, size(8, 6));
    let ray = view.ray(4.0, 5.5);
    let surface = shot.world.surface(&shot.world.closest_hit(&ray).unwrap(), ray.direction);
    let (n, across) = (surface.frame.n, surface.frame.n.any_orthonormal_vector());
    let point = SurfacePoint { position: surface.point.position + 0.01 * n, ..surface.point };
    let tilted = (0.5 * n + 0.866 * across).normalize();
    let left = Lookout::before(&point, tilted, HemiPlane::HALF_SIDE as f32, size(32, 32));
    let whole = Lookout { left: TriangleId::NONE, ..left };
    let scene = GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world));
    let [without, with] = [left, whole].map(|lookout| scene.visible(&[lookout]).unwrap());
    let itself = |hit: &Option<Hit>| hit.is_some_and(|hit| hit.triangle_id() == surface.point.on);
    assert!(without.iter().filter(|hit| itself(hit)).count() == 0);
    assert!(with.iter().filter(|hit| itself(hit)).count() > 100, "it does not lie in view");
    for (without, with) in without.iter().zip(&with).filter(|(_, with)| !itself(with)) {
        assert_eq!(without, with);
    }
}

/// A ray that passes by a triangle meets its edge, from the side too, and one without area is not met.
#[test]
fn rays_beside_a_triangle_meet_its_edge() {
    let corners = [Vec3::new(0.0, 0.0, -2.0), Vec3::new(1.0, 0.0, -2.0), Vec3::new(0.0, 1.0, -4.0)];
    let along = |x: f32, y: f32| Ray::new(Vec3::ZERO, Vec3::new(x, y, -1.0).normalize());
    let length = |x: f32, y: f32| Vec3::new(x, y, -1.0).length();
    let [t, b1, b2] = meet(&along(0.1, 0.0), corners).unwrap();
    assert!((t - 2.0 * length(0.1, 0.0)).abs() < 1e-5 && (b1 - 0.2).abs() < 1e-5 && b2.abs() < 1e-6);
    let [t, b1, b2] = meet(&along(-0.01, 0.0), corners).unwrap();
    assert!((t - 2.0).abs() < 1e-2 && b1 == 0.0 && b2.abs() < 1e-2, "{t} {b1} {b2}");
    // From the side: all of it within a hundred-millionth of a plane through the eye.
    let flat = corners.map(|corner| Vec3::new(corner.x, 1e-8 * corner.y, corner.z));
    let [t, ..] = meet(&along(0.1, 0.1), flat).unwrap();
    assert!(t > 1.0 && t < 5.0, "{t}");
    assert_eq!(meet(&along(0.1, 0.0), [corners[0], corners[1], corners[1]]), None);
}

/// Where there is no room for many at once, fewer are drawn at a time.
#[test]
fn little_room_is_enough() {
    let Some(gpu) = shared() else { return };
    let shot = shot(samples::boxes().unwrap());
    let [_, planes] = lookouts_of(&shot);
    let planes: Vec<Lookout> = std::iter::repeat_n(planes, 8).flatten().collect();
    let all = GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)).visible(&planes).unwrap();
    // The scene takes some 100 kB, sixteen planes with what is read back of them as much.
    let options = GpuOptions { bytes_max: 400_000, ..gpu.options() };
    let small = Arc::new(Gpu::open_with(&options).unwrap());
    let scene = GpuScene::new(small, Arc::clone(&shot.world));
    // They lie elsewhere on targets then, where cards move corners otherwise: pixels on edges may see what lies beside it.
    let seen = scene.visible(&planes).unwrap();
    let elsewhere = seen.iter().zip(&all).filter(|(seen, of_all)| seen != of_all).count();
    assert!(seen.len() == all.len() && elsewhere as f64 <= ELSEWHERE_MAX * all.len() as f64, "{elsewhere}");
    assert!(scene.bytes() <= 400_000);
}

/// A device that is lost is opened again; views that a plane does not stand for, and pictures larger than any target, are refused.
#[test]
fn what_is_drawn_survives_a_loss_and_bounds_hold() {
    let Some(gpu) = shared() else { return };
    let gpu = Arc::new(Gpu::open_with(&gpu.options()).unwrap());
    let shot = shot(samples::boxes().unwrap());
    let scene = GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world));
    let [_, planes] = lookouts_of(&shot);
    let before = scene.visible(&planes).unwrap();
    gpu.session().unwrap().lose_for_test();
    assert_eq!(scene.visible(&planes).unwrap(), before);
    assert_eq!(scene.visible(&[]).unwrap(), []);
    let [mut seen, _] = lookouts_of(&shot);
    seen.extend_from_slice(&planes);
    assert!(matches!(scene.visible(&seen), Err(GpuError::Failed { .. })));
    let flat = CameraView { projection: Projection::Orthographic { half_height_m: 1.0 }, ..shot.camera };
    let flat = Lookout { view: View::new(&shot.world, &flat, size(16, 16)), left: TriangleId::NONE };
    assert!(matches!(scene.visible(&[flat]), Err(GpuError::Failed { .. })));
    let side = PictureSize::SIDE_MAX;
    let wide = View::new(&shot.world, &shot.camera, size(side, side));
    let refused = scene.visible(&[Lookout { view: wide, left: TriangleId::NONE }]);
    assert!(matches!(refused, Err(GpuError::OutOfMemory { .. })), "{refused:?}");
    assert_eq!(scene.visible(&planes).unwrap(), before);
}
