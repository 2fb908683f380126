//! What hostile scenes have found and what was mended, each by the name of what it was.

use std::sync::Arc;
use std::time::Duration;

use lumicast_engine::math::Rgb;
use lumicast_engine::render::{Indirect, Rendering};
use lumicast_engine::scene::samples::cuboid;
use lumicast_engine::scene::{LightKind, Material};
use lumicast_engine::transport::World;

use crate::draft::{Draft, matt, metal, v};
use crate::drawing::{Drawn, Effort, Technique, draw};
use crate::hostile::{Case, check, on_threads};

/// Holds a case against all that is demanded of hostile scenes.
fn holds(case: &Case) {
    if let Err(error) = on_threads(1, || check(case)) {
        panic!("{}\n    {error}", case.described());
    }
}

/// Nothing at all to see or to trace.
#[test]
fn an_empty_scene_is_black() {
    holds(&Case::named("closed room", &["nothing"], 0));
}

/// A picture by the octree of 20,000 photons in a closed room with such walls, and a small grey chip on its floor or none.
fn octree_in_a_room(walls: Material, has_chip: bool) -> Rendering {
    let mut room = Draft::seen_from(v(0.3, 1.4, 1.9), v(0.0, 1.0, 0.0), 1.2);
    room.thing("walls", walls, |id| cuboid(v(-2., 0., -2.), v(2., 2.5, 2.), id));
    if has_chip {
        room.thing("chip", matt(0.5), |id| cuboid(v(0.0, 0.0, 0.0), v(0.02, 0.02, 0.02), id));
    }
    room.light("point", v(0.0, 2.0, 0.0), -glam::DVec3::Y, LightKind::Point { intensity: Rgb::WHITE });
    let world = Arc::new(World::prepare(Arc::new(room.build().expect("a scene"))));
    let of = Drawn { technique: Technique::on_cpu(Indirect::Octree), seed: 0, bounces_max: None };
    let patience = Duration::from_secs(60);
    let effort = Effort { side: 8, passes: 1, photons: 20_000, neighbours: 16, rays: 16, patience };
    draw(&world, of, &effort).expect("an end")
}

/// In a closed room that loses no light at all a photon was kept at each of the 4,096 surfaces after which it is ended, and a
/// million photons would have filled the memory of any machine: found as seed 128, which took minutes for 4,000. Now chance ends
/// it after 100 surfaces in the mean, and fewer are sent out the more often each is kept.
#[test]
fn photons_end_where_nothing_is_lost() {
    let rendering = octree_in_a_room(matt(1.0), false);
    let report = rendering.illumination().expect("photons").report();
    let kept = report.photons_stored as f64 / report.photons_emitted as f64;
    assert!((80.0..120.0).contains(&kept), "{kept} times each");
    assert!(report.photons_stored < 12 * 20_000, "{} photons kept", report.photons_stored);
}

/// Mirrors all around: next to nothing falls into maps, so that more photons were sent out, each of which was kept at hundreds of
/// mirrors.
#[test]
fn photons_between_mirrors_are_bounded() {
    let rendering = octree_in_a_room(metal(1.0, 0.0), true);
    let hits = rendering.counts().all_rays();
    assert!(hits < 40 * 20_000, "{hits} rays");
}
