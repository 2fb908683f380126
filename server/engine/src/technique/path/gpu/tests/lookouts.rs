//! What places see, drawn on a card beside rays through the middles of pixels.

use super::{gathering::cabinet, textures::masked, *};
use crate::{
    accel::{Hit, TriangleId},
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
        let surface = shot.world.surface(&shot.world.closest_hit(&ray)?, ray.direction);
        let n = surface.frame.n;
        let n = if ray.direction.dot(n) > 0.0 { -n } else { n };
        Some(Lookout::before(&surface.point, n, HemiPlane::HALF_SIDE as f32, size(16, 16)))
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
