//! Laws of splatting: it says what look-ups say.

use glam::{DAffine3, DVec3};

use super::{
    super::{
        caching::tests::{finish, step_once, uneven},
        tests::{room, with_rays},
        {IrradianceCaching, IrradianceSettings},
    },
    *,
};
use crate::{
    film::{Film, PictureSize},
    math::sobol::point,
    scene::{CameraView, Projection, samples},
    technique::SecondaryLight,
    transport::World,
};

/// Cameras in the middle of a room and close to a wall, one of them without perspective.
fn cameras(world: &World) -> Vec<CameraView> {
    let camera = world.scene().camera_view(None).unwrap();
    let turned = DAffine3::from_rotation_y(2.5) * camera.world_from_camera;
    let near = CameraView::look_at(DVec3::new(0.3, -0.9, 0.2), DVec3::new(0.9, -1.0, 0.9), DVec3::Y, 1.4);
    let projection = Projection::Orthographic { half_height_m: 0.7 };
    vec![camera, CameraView { world_from_camera: turned, ..camera }, near, CameraView { projection, ..near }]
}

/// What samples anywhere in the pixels of a tile see.
fn sights(world: &World, view: &View, origin: UVec2, size: UVec2) -> Vec<Option<FirstSight>> {
    let sight = |x: u32, y: u32| {
        let at = point(7, y * 4096 + x);
        let ray = view.ray((origin.x + x) as f32 + at[0], (origin.y + y) as f32 + at[1]);
        let surface = world.surface(&world.closest_hit(&ray)?, ray.direction);
        Some(FirstSight { surface, wo: -ray.direction })
    };
    (0..size.y).flat_map(|y| (0..size.x).map(move |x| (x, y))).map(|(x, y)| sight(x, y)).collect()
}

/// Records made for three cameras, in the rounds from rough to fine, splatted for those and another: every sample gets what it would look up, to
/// rounding, and what gets nothing finds nothing either.
#[test]
fn splats_say_what_look_ups_say() {
    let size = PictureSize::new(70, 41).unwrap();
    for world in [room(), World::prepare(Arc::new(samples::cornell_box().unwrap()))] {
        let cameras = cameras(&world);
        let mut caching = IrradianceCaching::new(with_rays(40), uneven(), None);
        (0..).zip(&cameras[..3]).for_each(|(key, camera)| {
            caching.look(key, camera, size);
        });
        let (mut answered, mut looked_up) = (0, 0);
        for steps in [1, 4, 80, usize::MAX] {
            match steps {
                usize::MAX => finish(&mut caching, &world),
                _ => (0..steps).for_each(|_| step_once(&mut caching, &world)),
            }
            let cache = Arc::new(caching.cache().clone());
            for camera in &cameras {
                let view = View::new(&world, camera, size);
                let splats = Splats::of(cache.clone(), &view).unwrap();
                for tile in Film::new(size).tiles() {
                    let seen = sights(&world, &view, tile.origin(), tile.size());
                    let found = splats.scattered_over(tile.origin(), tile.size(), &seen);
                    for (sight, found) in seen.iter().zip(found) {
                        let Some(FirstSight { surface, wo }) = sight else {
                            assert_eq!(found, None);
                            continue;
                        };
                        let expected = cache.scattered(surface, *wo, None).indirect;
                        match found {
                            Some(found) => {
                                let off = (found - expected).map(f32::abs).max_component();
                                assert!(off <= 1e-5 * expected.max_component(), "{found:?} for {expected:?}");
                                answered += 1;
                            }
                            None => {
                                // No record counts there, or only by what hides behind something.
                                let (p, facing) = (surface.point.position, Facing::of(surface, *wo));
                                let counts = cache.any_light(p, &facing).is_some();
                                assert!(!counts || !surface.bsdf.has_diffuse(), "{expected:?}");
                                looked_up += 1;
                            }
                        }
                    }
                }
            }
        }
        assert!(answered > 6_000 && looked_up > 100, "{answered} answered, {looked_up} not");
        assert!(caching.cache().rougher.is_some());
    }
}

/// What does not fit is looked up: no picture lays out more than so many bytes for each pixel.
#[test]
fn too_many_records_are_not_laid_out() {
    let world = room();
    let camera = world.scene().camera_view(None).unwrap();
    let mut caching = IrradianceCaching::new(with_rays(20), uneven(), None);
    caching.look(0, &camera, PictureSize::new(64, 48).unwrap());
    finish(&mut caching, &world);
    let cache = Arc::new(caching.cache().clone());
    let laid_out = |width, height| {
        Splats::of(cache.clone(), &View::new(&world, &camera, PictureSize::new(width, height).unwrap()))
    };
    let splats = laid_out(64, 48).unwrap();
    let placed_count =
        |splats: &Splats| splats.caches.iter().map(|placed| placed.records.len()).sum::<usize>();
    let bytes = placed_count(&splats) * size_of::<PlacedRecord>();
    assert!(bytes > 0 && bytes <= 64 * 48 * IrradianceCache::BYTES_PER_PIXEL, "{bytes}");
    assert!(cache.records.len() > 30 && laid_out(3, 2).is_none());
    // Few pixels that see many records each.
    assert!(laid_out(16, 16).is_none_or(|splats| placed_count(&splats) <= PLACED_PER_PIXEL * 256));
}

/// A record counts over as many pixels as it was made for at least, so most of them lie in few tiles.
#[test]
fn records_lie_in_few_tiles() {
    let world = room();
    let camera = world.scene().camera_view(None).unwrap();
    let size = PictureSize::new(160, 120).unwrap();
    let settings = IrradianceSettings { pixels_min: 2.0, ..with_rays(20) };
    let mut caching = IrradianceCaching::new(settings, uneven(), None);
    caching.look(0, &camera, size);
    finish(&mut caching, &world);
    let cache = Arc::new(caching.cache().clone());
    let splats = Splats::of(cache.clone(), &View::new(&world, &camera, size)).unwrap();
    let [finest, ..] = &splats.caches[..] else { panic!("nothing laid out") };
    let tiles = finest.starts.len() - 2;
    assert!(finest.records.len() < cache.records.len() * tiles / 8, "{} in {tiles}", finest.records.len());
}
