//! What hangs low over a record's surface: a lamp under a ceiling, a cupboard over a floor, the next one of some stairs.
//!
//! Beneath it the light is another one however far off everything else is. The mean of distances hardly shows it from beside, nor does a
//! gradient, and nothing stands in between that would hide it; so rough records reached in, and the ceiling above a lamp shone like the
//! rest of it until finer ones came. Of a record's own low rays the nearest of each direction are followed once more: what they meet
//! hangs over the surface where it faces it. A wall stands across, and the inside of a vault faces the same way.

use glam::Vec3;

use crate::{
    accel::{Ray, SurfacePoint},
    math::Frame,
    transport::World,
};

/// What is turned against the surface by at most 45° hangs over it, roofs of that slope among it: what is steeper stands beside it like a wall.
const FACING_COS: f32 = 0.7;
/// Light counts as gone so many heights in: beneath a long board a seventieth of the hemisphere is open there, half of it at the edge.
const HEIGHTS: f32 = 4.0;
/// A ray that is followed again goes so many times as far as it did: its direction is rounded, and what it met lies at a slant.
const SLACK: f32 = 1.01;

/// The way over which light may be gone because something hangs over the surface, m; infinite where nothing nearer than `limit_m` is
/// found to. And the rays it took.
///
/// - `plane`: the frame around the triangle's normal on the side that receives
/// - `low_hits`: what the lowest rays have met, in that frame, m
pub(super) fn overhang_m(
    world: &World,
    (point, plane): (&SurfacePoint, &Frame),
    low_hits: impl Iterator<Item = Vec3>,
    limit_m: f32,
) -> (f32, u64) {
    let (mut least_m, mut rays) = (f32::INFINITY, 0);
    for at in low_hits {
        let reach_m = at.truncate().length() + HEIGHTS * at.z;
        if !(reach_m < least_m.min(limit_m)) {
            continue;
        }
        let direction = plane.to_world(at.normalize_or_zero());
        let ray = Ray { t_max: SLACK * at.length(), ..point.ray_towards(direction) };
        rays += 1;
        if let Some(hit) = world.closest_hit(&ray) {
            let n = world.accel().instances()[hit.instance as usize].point_of(&hit).n_geo;
            let facing = if n.dot(direction) > 0.0 { -n } else { n };
            if facing.dot(plane.n) < -FACING_COS {
                least_m = reach_m;
            }
        }
    }
    (least_m, rays)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DAffine3, DVec3};

    use super::{
        super::{
            Facing, Weighing,
            horizon::LowHits,
            tests::{Painted, record_at, with_rays},
        },
        *,
    };
    use crate::{
        accel::Ray,
        math::{Rgb, sobol::point as point_of_sequence, warp},
        scene::{
            Id, Material,
            samples::{self, Stage, cuboid},
        },
        transport::World,
    };

    /// A record on the floor of a room, even a rough one, says nothing of the floor beneath a board that hangs low over it.
    #[test]
    fn records_count_no_farther_than_to_what_hangs_over_them() {
        let mut stage = Stage::default();
        let grey = stage.material("grey", Material::lambert(Rgb::splat(0.5))).unwrap();
        let v = DVec3::new;
        let floor = cuboid(v(-3.0, -0.1, -3.0), v(3.0, 0.0, 3.0), &grey);
        stage.place("floor", floor, DAffine3::IDENTITY).unwrap();
        let walls = cuboid(v(-5.0, -1.0, -5.0), v(5.0, 4.0, 5.0), &grey);
        stage.place("walls", walls, DAffine3::IDENTITY).unwrap();
        let board = cuboid(v(0.2, 0.04, -1.0), v(1.2, 0.05, 1.0), &grey);
        stage.place("board", board, DAffine3::IDENTITY).unwrap();
        let world = World::prepare(Arc::new(stage.finish()));
        let rough = Weighing { accuracy: 0.6, is_smooth: true, has_gradients: true };
        let on_floor = |x: f32, z: f32| world.accel().to_render(v(f64::from(x), 0.0, f64::from(z)));
        let even = Painted(|_| Rgb::WHITE);
        let mut beneath = 0;
        for index in 0..100 {
            let [x, z, ..] = point_of_sequence(42, index);
            let [x, z] = [0.18 - 0.2 * x, 0.8 * z - 0.4];
            let ray = Ray::new(on_floor(x, z) + 0.02 * Vec3::Y, Vec3::NEG_Y);
            let at = world.surface(&world.closest_hit(&ray).unwrap(), ray.direction).point;
            let up = Facing::flat(Vec3::Y);
            let (record, _) = record_at(&world, (at, up), &with_rays(400), &even);
            // Two of its heights in, and more.
            let counts_at = |x: f32| record.weight(on_floor(x, z), &up, &rough) > 0.0;
            beneath += usize::from([0.28, 0.5, 0.8].into_iter().any(counts_at));
            assert!(counts_at(x - 0.1), "{x}, {z}");
        }
        // Of few rays none may have gone there, or only some that met it far in: 13. By the horizon alone, which hides what lies right behind
        // low hits, 33.
        assert!(beneath <= 20, "{beneath} of 100 count beneath");
    }

    /// Walls, and the inside of a vault of few flat sides, hang over nothing; a board does, at any size, and no ray is followed again for what is
    /// beyond the limit.
    #[test]
    fn only_what_faces_a_surface_hangs_over_it() {
        let found = |scale: f64, place: &dyn Fn(&mut Stage, &Id), at: DVec3, limit_m: f32| {
            let mut stage = Stage::default();
            let grey = stage.material("grey", Material::lambert(Rgb::splat(0.5))).unwrap();
            place(&mut stage, &grey);
            let world = World::prepare(Arc::new(stage.finish()));
            let from = world.accel().to_render((at + 1e-3 * DVec3::Y) * scale);
            let ground = Ray::new(from, Vec3::NEG_Y);
            let point = world.surface(&world.closest_hit(&ground).unwrap(), ground.direction).point;
            let plane = Frame::around(point.n_geo * point.n_geo.y.signum());
            let mut low_hits = LowHits::NONE;
            for index in 0..2_000 {
                let [u, v, ..] = point_of_sequence(43, index);
                let local = warp::cosine_hemisphere([u, v]);
                let hit = world.closest_hit(&point.ray_towards(plane.to_world(local)));
                low_hits.add(local, hit.map(|hit| hit.t));
            }
            let (way_m, rays) = overhang_m(&world, (&point, &plane), low_hits.places(), limit_m);
            (way_m / scale as f32, rays)
        };
        let ever = f32::INFINITY;
        for scale in [1e-4, 1.0, 1e4] {
            let v = |x: f64, y: f64, z: f64| DVec3::new(x, y, z) * scale;
            let room = |stage: &mut Stage, grey: &Id| {
                let walls = cuboid(v(-1.0, 0.0, -1.0), v(1.0, 2.0, 1.0), grey);
                stage.place("walls", walls, DAffine3::IDENTITY).unwrap();
            };
            let (way_m, rays) = found(scale, &room, DVec3::new(0.8, 0.0, -0.7), ever);
            assert!(way_m == ever && rays > 10, "{way_m} m, {rays} rays, {scale}");
            let vault = |stage: &mut Stage, grey: &Id| {
                let sides = samples::sphere(DVec3::ZERO, scale, 16, grey);
                stage.place("vault", sides, DAffine3::IDENTITY).unwrap();
            };
            assert_eq!(found(scale, &vault, DVec3::new(0.02, -0.9, 0.03), ever).0, ever, "{scale}");
            let board = |stage: &mut Stage, grey: &Id| {
                room(stage, grey);
                let board = cuboid(v(0.1, 0.04, -0.9), v(0.9, 0.05, 0.9), grey);
                stage.place("board", board, DAffine3::IDENTITY).unwrap();
            };
            let (way_m, rays) = found(scale, &board, DVec3::ZERO, ever);
            let nearest_m = 0.1 + 4.0 * 0.04;
            assert!(way_m > 0.99 * nearest_m && way_m < 1.3 * nearest_m, "{way_m} m, {scale}");
            assert!(rays > 0 && rays <= 24);
            let limit_m = 0.5 * nearest_m * scale as f32;
            assert_eq!(found(scale, &board, DVec3::ZERO, limit_m), (ever, 0));
        }
    }
}
