//! Hostile eyes: in walls, in glass, on surfaces, far away, with hardly any or nearly all of a view; and bounds on work.

use glam::DVec3;
use lumicast_engine::scene::samples::sphere;
use lumicast_engine::scene::{CameraView, Projection};

use super::case::Case;
use super::hostility::Hostility;
use crate::draft::{glass, v};

pub(super) const ALL: [Hostility; 13] = [
    Hostility::harsh("an eye in a block", |case, random| {
        let at = v(random.between(-0.2, 0.2), random.between(0.1, 0.3), random.between(-0.9, -0.5));
        look(case, at, at + v(0.3, 0.5, -1.0));
    }),
    Hostility::harsh("an eye behind the wall", |case, random| {
        look(case, v(random.between(-1.0, 1.0), 1.0, 2.5), v(0.0, 1.0, -1.0));
    }),
    Hostility::harsh("an eye in a wall", |case, _| look(case, v(0.3, 1.2, 2.0), v(0.0, 1.0, -1.0))),
    Hostility::harsh("an eye on the floor", |case, random| {
        let up = [0.0, 1e-9, 1e-6, 1e-3][random.below(4)];
        look(case, v(0.4, up, 0.9), v(-0.3, random.between(0.0, 1.0), -1.0));
    }),
    Hostility::harsh("an eye that looks along the floor", |case, _| {
        look(case, v(0.4, 0.0, 0.9), v(-0.3, 0.0, -1.0));
    }),
    Hostility::harsh("an eye in glass", |case, random| {
        let at = case.draft.view.world_from_camera.translation;
        let ior = [1.0, 1.5, 2.4][random.below(3)];
        case.draft.thing("eyeglass", glass(ior), |id| sphere(at, 0.08, 12, id));
    }),
    Hostility::harsh("an eye at the lamp", |case, _| look(case, v(0.0, 2.4, 0.0), v(0.1, 0.0, -0.3))),
    Hostility::harsh("a view of a hair's width", |case, random| {
        let yfov_rad = 10f64.powf(random.between(-5.5, -2.0));
        case.draft.view.projection = Projection::Perspective { yfov_rad };
    }),
    Hostility::mild("a view of nearly all", |case, random| {
        let yfov_rad = std::f64::consts::PI - 10f64.powf(random.between(-5.5, -0.5));
        case.draft.view.projection = Projection::Perspective { yfov_rad };
    }),
    Hostility::harsh("an eye without perspective", |case, random| {
        let half_height_m = 10f64.powf(random.between(-6.0, 4.0));
        case.draft.view.projection = Projection::Orthographic { half_height_m };
    }),
    Hostility::harsh("an eye far away", |case, random| {
        let at = v(0.3, 1.4, 10f64.powf(random.between(1.0, 6.0)));
        look(case, at, v(0.0, 1.0, 0.0));
    }),
    Hostility::harsh("a single photon", |case, _| case.photons = 1),
    Hostility::mild("a bound on bounces", |case, random| case.bounces_max = Some(random.below(4) as u32)),
];

fn look(case: &mut Case, at: DVec3, target: DVec3) {
    case.draft.view = CameraView::look_at(at, target, DVec3::Y, 1.2);
}
