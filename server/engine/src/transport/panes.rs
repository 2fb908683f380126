//! Light from infinitely far that glass lets through as it came: panes, which bend a ray twice and leave it parallel to itself.
//!
//! From a lamp nearby, light behind a pane seems to come from a little beside where it does, and from anywhere by way of curved glass. From
//! infinitely far it comes from where it would without the pane: whoever draws a direction to such a light finds it there, and what the
//! boundaries in between let pass.

use glam::Vec3;

use super::{BsdfSample, Flight, World};
use crate::{
    accel::{Hit, Ray},
    math::Rgb,
};

/// What light, or a ray that looks for it, has passed since it set out, as long as that is boundaries of glass alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passed {
    /// The way it set out on, unit.
    way: Vec3,
    /// How many.
    pub boundaries: u32,
    /// Product of [`BsdfSample::eta_squared`].
    eta_squared: f32,
}

impl Passed {
    /// Unit vectors that differ by no more go one way: the sun is nine times as wide, and rounding ten thousand times less.
    pub(crate) const STRAIGHT: f32 = 1e-3;
    /// The indices of refraction at both ends of a way differ by no more than rounding makes them.
    pub(crate) const SAME_INDEX: f32 = 1e-3;
    /// Boundaries on a straight way, at most: those of sixteen panes.
    pub const BOUNDARIES_MAX: u32 = 32;

    /// Nothing yet.
    pub fn nothing(way: Vec3) -> Passed {
        Passed { way, boundaries: 0, eta_squared: 1.0 }
    }

    /// After one more surface; `None` where that did not let it pass.
    ///
    /// - `wo`: where it came from, in the surface's frame
    pub fn after(self, wo: Vec3, drawn: &BsdfSample) -> Option<Passed> {
        (wo.z * drawn.wi.z < 0.0).then_some(Passed {
            boundaries: self.boundaries + 1,
            eta_squared: self.eta_squared * drawn.eta_squared,
            ..self
        })
    }

    /// It goes on as it set out, in what it set out in: then so does what goes the other way. Where glass is entered and not left, a ray that goes in
    /// is turned by less than one that comes out.
    pub fn is_straight(&self, way: Vec3) -> bool {
        (1..=Self::BOUNDARIES_MAX).contains(&self.boundaries)
            && (self.eta_squared - 1.0).abs() < Self::SAME_INDEX
            && (self.way - way).length_squared() < Self::STRAIGHT * Self::STRAIGHT
    }
}

/// What glass lets through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passage {
    /// Of the radiance that comes in.
    pub share: Rgb,
    /// Boundaries that the light passes; two for a pane.
    pub boundaries: u32,
}

impl World {
    /// What arrives by panes of light from infinitely far; `None` where something else stands in the way, where glass turns the light aside,
    /// and where nothing is.
    ///
    /// - `ray`: to the light, without end; its direction is a unit vector
    /// - `on_ray`: called with every ray that this takes
    pub fn through_panes(&self, ray: &Ray, mut on_ray: impl FnMut(&Ray)) -> Option<Passage> {
        if !self.has_glass() {
            return None;
        }
        let mut flight = Flight::begin(*ray, Rgb::WHITE);
        let mut passed = Passed::nothing(ray.direction);
        while passed.boundaries <= Passed::BOUNDARIES_MAX {
            on_ray(&flight.ray);
            let Some(hit) = self.closest_hit(&flight.ray) else {
                let passage = Passage { share: flight.weight, boundaries: passed.boundaries };
                return passed.is_straight(flight.ray.direction).then_some(passage);
            };
            (flight, passed) = self.passed(flight, passed, &hit)?;
        }
        None
    }

    /// Beyond a boundary of glass.
    fn passed(&self, mut flight: Flight, passed: Passed, hit: &Hit) -> Option<(Flight, Passed)> {
        let towards = -flight.ray.direction;
        let surface = flight.arrive(self, hit);
        let wo = surface.frame.to_local(towards);
        let passing = surface.bsdf.passing(wo)?;
        Some((flight.scattered(&surface, &passing)?, passed.after(wo, &passing)?))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::scene::{
        Environment, Id, Material, MeshSource,
        samples::{Stage, cuboid, quad, sphere},
    };

    fn v(x: f64, y: f64, z: f64) -> DVec3 {
        DVec3::new(x, y, z)
    }

    fn clear() -> Material {
        Material {
            transmission: 1.0,
            roughness: 0.0,
            base_color: Rgb::WHITE,
            ior: 1.5,
            ..Material::default()
        }
    }

    /// Some meshes of a material before a sky.
    fn world_of(material: Material, placed: DAffine3, meshes: impl Fn(&Id) -> Vec<MeshSource>) -> World {
        let mut stage = Stage::default();
        let material = stage.material("glass", material).unwrap();
        for (number, mesh) in meshes(&material).into_iter().enumerate() {
            stage.place(&format!("mesh {number}"), mesh, placed).unwrap();
        }
        stage.builder().set_environment(Environment::Constant(Rgb::WHITE)).unwrap();
        World::prepare(Arc::new(stage.finish()))
    }

    /// What arrives at a place from a direction, both before they are `placed`.
    fn arriving(world: &World, placed: DAffine3, at: DVec3, way: DVec3) -> Option<Passage> {
        let origin = world.accel().to_render(placed.transform_point3(at));
        let direction = placed.transform_vector3(way).normalize().as_vec3();
        world.through_panes(&Ray::new(origin, direction), |_| ())
    }

    fn panes(count: usize) -> impl Fn(&Id) -> Vec<MeshSource> {
        move |material| {
            let at = |number: usize| 0.1 * number as f64;
            let pane = |z: f64| cuboid(v(-9., -9., z), v(9., 9., z + 0.01), material);
            (0..count).map(|number| pane(at(number))).collect()
        }
    }

    /// Of a pane of index 1.5 what Fresnel's equations leave at either side: 0.96 straight on, 0.9108 at 60°; of several as much less, at any
    /// size, place and turn.
    #[test]
    fn panes_let_through_what_fresnel_says() {
        let turned = DAffine3::from_rotation_y(0.7) * DAffine3::from_rotation_x(0.4);
        for scale in [1e-4, 1.0, 1e4] {
            for moved in [0.0, 1e5] {
                let placed = DAffine3::from_translation(DVec3::splat(moved))
                    * turned
                    * DAffine3::from_scale(DVec3::splat(scale));
                for count in [1, 2, 5] {
                    let world = world_of(clear(), placed, panes(count));
                    for (angle, share) in [(0.0, 0.96), (60f64.to_radians(), 0.910_81)] {
                        let way = v(angle.sin() * 0.6, angle.sin() * 0.8, angle.cos());
                        let passage = arriving(&world, placed, v(0.1, -0.2, -1.0), way).unwrap();
                        assert_eq!(passage.boundaries, 2 * count as u32);
                        let expected = f64::powi(share, passage.boundaries as i32) as f32;
                        let off = (passage.share.g / expected - 1.0).abs();
                        assert!(
                            off < 1e-4,
                            "{passage:?} for {expected}, {scale} times at {moved} m, {angle}"
                        );
                    }
                }
            }
        }
    }

    /// Base colours count at each boundary, and what absorbs by the way inside.
    #[test]
    fn panes_colour_what_passes() {
        let green = Material {
            base_color: Rgb::new(0.5, 1.0, 0.8),
            attenuation_color: Rgb::new(1.0, 0.25, 0.5),
            attenuation_distance_m: 0.02,
            ..clear()
        };
        let world = world_of(green, DAffine3::IDENTITY, panes(1));
        let passage = arriving(&world, DAffine3::IDENTITY, v(0., 0., -1.), DVec3::Z).unwrap();
        // Half of the way over which that much is left: its root.
        let expected = [0.25, 0.5, 0.64 * 0.5f32.sqrt()].map(|share| share * 0.9216);
        for (share, expected) in passage.share.to_array().into_iter().zip(expected) {
            assert!((share / expected - 1.0).abs() < 1e-3, "{passage:?}");
        }
        // Matt where it is not clear: as much less at each boundary.
        let half = world_of(Material { transmission: 0.5, ..clear() }, DAffine3::IDENTITY, panes(1));
        let passage = arriving(&half, DAffine3::IDENTITY, v(0., 0., -1.), DVec3::Z).unwrap();
        assert!((passage.share.g / (0.25 * 0.9216) - 1.0).abs() < 1e-3, "{passage:?}");
    }

    /// Nothing in the way, what is not glass, glass that turns light aside, glass that is never left and more panes than there may be.
    #[test]
    fn what_is_no_pane_lets_nothing_through() {
        let slant = v(0.3, 0.2, 1.0);
        let from = v(0.1, 0.1, -1.0);
        let of = |material: Material, meshes: &dyn Fn(&Id) -> Vec<MeshSource>| {
            arriving(&world_of(material, DAffine3::IDENTITY, meshes), DAffine3::IDENTITY, from, slant)
        };
        assert!(of(clear(), &panes(1)).is_some() && of(clear(), &panes(16)).is_some());
        assert_eq!(of(clear(), &panes(17)), None);
        assert_eq!(of(Material::lambert(Rgb::WHITE), &panes(1)), None);
        let mirror = Material { metallic: 1.0, roughness: 0.0, ..Material::default() };
        assert_eq!(of(mirror, &panes(1)), None);
        // Beside the ray.
        let beside = |material: &Id| vec![cuboid(v(5., 5., 0.), v(6., 6., 1.), material)];
        assert_eq!(of(clear(), &beside), None);
        let ball = |material: &Id| vec![sphere(v(0.3, 0., 0.), 0.8, 32, material)];
        assert_eq!(of(clear(), &ball), None);
        let sheet = |material: &Id| {
            vec![quad([v(-9., -9., 0.), v(9., -9., 0.), v(9., 9., 0.), v(-9., 9., 0.)], material)]
        };
        assert_eq!(of(clear(), &sheet), None);
        // Nor straight on, where it is not turned: what comes out of glass is.
        let world = world_of(clear(), DAffine3::IDENTITY, sheet);
        assert_eq!(arriving(&world, DAffine3::IDENTITY, from, DVec3::Z), None);
        let wedge = |material: &Id| {
            let mut mesh = cuboid(v(-9., -9., 0.), v(9., 9., 0.5), material);
            mesh.positions.iter_mut().filter(|p| p.z > 0.1 && p.x > 0.0).for_each(|p| p.z += 1.0);
            vec![mesh]
        };
        assert_eq!(of(clear(), &wedge), None);
    }
}
