//! What stands up from a surface around a gather: planes beyond which it does not look.
//!
//! A floor goes on under the wall between two rooms, and photons of the bright one lie within reach of a gather in the dark one.
//! Rays along the surface find such walls; a gather keeps to its side of their planes, with its photons and with its area alike, so
//! that even light stays even whatever is cut off.

use std::f32::consts::TAU;

use glam::{Mat3, Vec3};

use crate::{
    accel::{Accel, Hit, Ray},
    math::Frame,
};

/// Directions along the surface in which walls are looked for, and planes of a gather at most. Of eight, dragon-room, Sponza and
/// Sibenik's octrees took as long and were as good.
pub(in crate::technique) const DIRECTIONS: usize = 6;
/// Cosine between the normals of a surface and of what stands up from it, at most: what leans less is surface of its own.
const STANDS_COS: f32 = 0.5;
/// Cosine between a ray and the normal of the wall it meets, at least: what is met more flatly lies farther off than its plane, which
/// would cut where there is no wall.
const MET_COS: f32 = 0.3;
/// Cosine between two walls that are one.
const SAME_COS: f32 = 0.95;

/// Planes around the middle of a gather; see the module's head.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Walls {
    planes: [Wall; DIRECTIONS],
    count: usize,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Wall {
    /// Unit, away from the middle, along the surface.
    away: Vec3,
    /// From the middle, m.
    distance_m: f32,
}

impl Wall {
    fn behind_m(&self, from_middle: Vec3) -> f32 {
        self.away.dot(from_middle) - self.distance_m
    }
}

/// From where walls are looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallSearch {
    /// On the surface, render space.
    pub middle: Vec3,
    /// Unit.
    pub normal: Vec3,
    /// What stands up less than this does not count, m.
    pub lift_m: f32,
    /// How far to look, m.
    pub radius_m: f32,
    /// Turns the directions, in [0, 1].
    pub turn: f32,
}

impl Walls {
    /// Planes are of triangles, as if none had holes: masks are not asked.
    pub fn around(accel: &Accel, search: &WallSearch) -> Walls {
        let frame = Frame::around(search.normal);
        let from = search.middle + search.normal * search.lift_m;
        let found = (0..DIRECTIONS).filter_map(|number| {
            let angle = TAU * (number as f32 + search.turn) / DIRECTIONS as f32;
            let direction = frame.to_world(Vec3::new(angle.cos(), angle.sin(), 0.0));
            let ray = Ray { t_max: search.radius_m, ..Ray::new(from, direction) };
            standing(accel, &accel.closest_hit(&ray, |_| true)?, direction, search.normal)
        });
        let mut found: Vec<Wall> = found.collect();
        found.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        let mut walls = Walls::default();
        for wall in found {
            let is_known = walls.planes().iter().any(|known| known.away.dot(wall.away) > SAME_COS);
            if !is_known {
                walls.planes[walls.count] = wall;
                walls.count += 1;
            }
        }
        walls
    }

    fn planes(&self) -> &[Wall] {
        &self.planes[..self.count]
    }

    /// Of each wall, nearest first: the direction away from the middle, and its distance from there, m.
    pub fn nearest_first(&self) -> impl Iterator<Item = (Vec3, f32)> {
        self.planes().iter().map(|wall| (wall.away, wall.distance_m))
    }

    /// How far behind the wall that it is farthest behind a point lies, negative before all, m.
    pub(in crate::technique) fn behind_m(&self, from_middle: Vec3) -> f32 {
        self.planes().iter().map(|wall| wall.behind_m(from_middle)).fold(f32::NEG_INFINITY, f32::max)
    }

    /// The same in a space that is turned and whose lengths are so many times as long.
    pub(super) fn turned_by(&self, turn: Mat3, times: f32) -> Walls {
        let mut turned = *self;
        for wall in &mut turned.planes[..self.count] {
            *wall = Wall { away: turn * wall.away, distance_m: wall.distance_m * times };
        }
        turned
    }

    /// Cuts off what of a convex polygon lies behind; its corners are given from the middle.
    pub(super) fn cut(&self, polygon: &mut Vec<Vec3>) {
        for wall in self.planes() {
            let mut kept = Vec::with_capacity(polygon.len() + 1);
            for (place, p) in polygon.iter().enumerate() {
                let q = polygon[(place + 1) % polygon.len()];
                let (here, there) = (wall.behind_m(*p), wall.behind_m(q));
                if here <= 0.0 {
                    kept.push(*p);
                }
                if (here <= 0.0) != (there <= 0.0) {
                    kept.push(p.lerp(q, here / (here - there)));
                }
            }
            *polygon = kept;
        }
    }
}

/// The wall that a ray along a surface met, if it stands up from it.
fn standing(accel: &Accel, hit: &Hit, direction: Vec3, normal: Vec3) -> Option<Wall> {
    let n = accel.instances()[hit.instance as usize].point_of(hit).n_geo;
    let up = n.dot(normal);
    if up.abs() >= STANDS_COS {
        return None;
    }
    let across = (n - up * normal).normalize();
    let away = across * across.dot(direction).signum();
    let cos = away.dot(direction);
    (cos > MET_COS).then_some(Wall { away, distance_m: hit.t * cos })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::{scene::samples, transport::World};

    impl Walls {
        /// By direction and distance.
        pub(in crate::technique::products) fn at(walls: [(Vec3, f32); 2]) -> Walls {
            let mut planes = [Wall::default(); DIRECTIONS];
            for (plane, (away, distance_m)) in planes.iter_mut().zip(walls) {
                *plane = Wall { away, distance_m };
            }
            Walls { planes, count: walls.len() }
        }
    }

    fn search(middle: Vec3, radius_m: f32, turn: f32) -> WallSearch {
        WallSearch { middle, normal: Vec3::Y, lift_m: 0.1, radius_m, turn }
    }

    /// In a corner there are two walls, each found once and where it stands; what is too far away is none.
    #[test]
    fn walls_of_a_corner_are_two_planes() {
        let world = World::prepare(Arc::new(samples::parted_rooms([1.0, 1.0]).unwrap()));
        let accel = world.accel();
        let render = |x: f64, y: f64, z: f64| accel.to_render(glam::DVec3::new(x, y, z));
        for turn in [0.0, 0.2, 0.4, 0.6, 0.8, 1.0] {
            let walls = Walls::around(accel, &search(render(0.21, 0.0, -0.7), 0.5, turn));
            let mut found: Vec<(Vec3, f32)> = walls.nearest_first().collect();
            assert_eq!(found.len(), 2, "{found:?}");
            assert!(found[0].1 < found[1].1, "nearest first");
            found.sort_by(|a, b| a.0.x.total_cmp(&b.0.x));
            assert!(found[0].0.distance(-Vec3::X) < 1e-4 && (found[0].1 - 0.2).abs() < 1e-3, "{found:?}");
            assert!(found[1].0.distance(-Vec3::Z) < 1e-4 && (found[1].1 - 0.3).abs() < 1e-3, "{found:?}");
            assert!(walls.behind_m(Vec3::new(-0.25, 0.0, 0.0)) > 0.04);
            assert!(walls.behind_m(Vec3::new(-0.15, 0.0, 0.0)) < -0.04);
            let away = Walls::around(accel, &search(render(1.0, 0.0, 0.0), 0.5, turn));
            assert_eq!(away, Walls::default());
            assert_eq!(away.behind_m(Vec3::X), f32::NEG_INFINITY);
            // The ceiling leans as the floor does.
            assert_eq!(Walls::around(accel, &search(render(1.0, 1.95, 0.0), 0.6, turn)), Walls::default());
        }
    }
}
