//! Cameras, sizes, seeds, passes, bounds and classes.

use super::*;
use crate::{
    render::{Indirect, RenderSettings, Rendering},
    scene::{Projection, samples},
    transport::PathClasses,
};

fn cornell() -> Shot {
    Shot { size: size(32, 24), ..shot(samples::cornell_box().unwrap()) }
}

/// Parallel cameras, mirrored and sheared ones, and cameras in odd places.
#[test]
fn cameras_see_the_same_from_everywhere() {
    let Some(gpu) = shared() else { return };
    let straight = cornell();
    let parallel = Projection::Orthographic { half_height_m: 1.3 };
    let mirrored = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    let from = |position, target| CameraView::look_at(position, target, DVec3::Y, 1.0);
    for (name, camera) in [
        ("parallel", CameraView { projection: parallel, ..straight.camera }),
        (
            "mirrored",
            CameraView { world_from_camera: mirrored * straight.camera.world_from_camera, ..straight.camera },
        ),
        ("in the glass ball", from(DVec3::new(0.5, 0.45, 0.1), DVec3::new(0.0, 0.5, 0.4))),
        ("in a block", from(DVec3::new(-0.38, 0.6, -0.35), DVec3::ZERO)),
        ("at the lamp", from(DVec3::new(0.0, 1.995, 0.0), DVec3::new(0.1, 0.0, 0.1))),
        ("away from it all", from(DVec3::new(1e6, 1e6, 1e6), DVec3::splat(2e6))),
    ] {
        Shot { camera, ..cornell() }.is_alike(&gpu, name);
    }
}

/// Pictures of any size, seeds of 64 bits and passes far on draw the same numbers.
#[test]
fn sizes_seeds_and_passes_draw_the_same_numbers() {
    let Some(gpu) = shared() else { return };
    for (name, width, height, seed, first) in [
        ("a pixel", 1, 1, 0, 0),
        ("17 by 3", 17, 3, 3, 0),
        ("a column", 1, 70, 4, 5),
        ("a seed beyond 32 bits", 31, 33, 0xfedc_ba98_7654_3210, 0),
        ("the largest seed", 31, 33, u64::MAX, 0),
        ("pass 100,001", 31, 33, 9, 100_001),
    ] {
        let settings = PathSettings::all(None, seed);
        Shot { size: size(width, height), settings, passes: first..first + 2, ..cornell() }
            .is_alike(&gpu, name);
    }
}

/// Bounds on scatterings end paths at the same surface.
#[test]
fn bounces_end_where_they_should_on_both() {
    let Some(gpu) = shared() else { return };
    for bounces in [0, 1, 2, 5] {
        let settings = PathSettings::all(Some(bounces), 3);
        Shot { settings, ..cornell() }.is_alike(&gpu, &format!("{bounces} bounces"));
    }
}

/// Only the classes that are asked for are traced, and only those to be shown are shown.
#[test]
fn classes_are_traced_and_shown_the_same() {
    use PathClass::*;
    let Some(gpu) = shared() else { return };
    let all = PathSettings::all(None, 5);
    let of = PathClasses::of;
    for (name, settings) in [
        ("asking", all.asking()),
        ("emitted", PathSettings { traced: of(&[Emitted]), ..all }),
        ("specular", PathSettings { traced: of(&[Specular]), ..all }),
        ("shown by specular lobes alone", PathSettings { shown: of(&[Specular]), ..all }),
        ("direct", PathSettings { traced: of(&[Direct]), ..all }),
        ("caustic", PathSettings { traced: of(&[Caustic]), ..all }),
        ("indirect and emitted", PathSettings { traced: of(&[Indirect, Emitted]), ..all }),
        ("nothing", PathSettings { traced: of(&[]), ..all }),
        ("all but shown direct", PathSettings { shown: PathClasses::ALL.without(Direct), ..all }),
        ("caustics shown alone", PathSettings { shown: of(&[Caustic]), ..all }),
    ] {
        Shot { settings, ..cornell() }.is_alike(&gpu, name);
    }
}

/// On films, too: passes of the technique on a card add to what passes of the CPU's technique add to.
#[test]
fn films_hold_the_same_picture() {
    let Some(gpu) = shared() else { return };
    let shown = PathClasses::ALL.without(PathClass::Direct);
    for settings in [PathSettings::all(None, 2), PathSettings { shown, ..PathSettings::all(Some(3), 2) }] {
        let shot = Shot { settings, ..cornell() };
        let cpu = film_by(&mut PathTracer::new(settings), &shot, 3);
        assert_alike(&cpu, &shot.film_on_card(&gpu, 3));
    }
}

/// So do renderings, with all light and with light that falls straight on surfaces alone.
#[test]
fn renderings_hold_the_same_picture() {
    let Some(gpu) = shared() else { return };
    let shot = cornell();
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    for (indirect, bounces_max) in [(Indirect::Path, None), (Indirect::Path, Some(2)), (Indirect::None, None)]
    {
        let settings = RenderSettings { indirect, bounces_max, seed: 8, ..RenderSettings::default() };
        let [cpu, card] = [false, true].map(|is_on_card| {
            let mut rendering = Rendering::new(Arc::clone(&shot.world), shot.camera, shot.size, settings);
            if is_on_card {
                rendering.draw_on(Arc::clone(&scene));
            }
            while rendering.passes() < 3 {
                rendering.step(&AtomicBool::new(false));
            }
            assert_eq!((rendering.is_on_gpu(), rendering.gpu_failure()), (is_on_card, None));
            rendering.film().clone()
        });
        assert_alike(&cpu, &card);
    }
}
