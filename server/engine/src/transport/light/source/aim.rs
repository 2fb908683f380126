//! Photons that leave their light towards a few spheres only: what is there gets all of them, whatever its solid angle
//! [Jensen1996; Larsen2004, 12.1].
//!
//! A photon is drawn towards one of the spheres by its solid angle (for light from infinitely far: by the area of its disc)
//! times a weight, and weighed by the density of all of them together, so that spheres may overlap. A light that stands inside
//! a sphere sends half of its photons anywhere. **Unbiased** for all flux that reaches a sphere straight from the light.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::{EmissionNumbers, Left, Source, SourceKind, from_point, luminance, target::Across};
use crate::{
    accel::Ray,
    math::{Frame, Rgb, sobol, warp},
    transport::{World, light::spot_falloff},
};

/// A sphere in render space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Its middle.
    pub middle: Vec3,
    /// Its radius, m.
    pub radius_m: f32,
    /// How often it is drawn beside others of its size, in (0, 1].
    pub weight: f32,
}

/// What photons are aimed at.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Aim {
    /// The spheres; they may overlap.
    pub spheres: Vec<Sphere>,
}

/// A photon on its way from the light.
#[derive(Clone, Copy, Debug)]
pub struct AimedPhoton {
    /// Its first ray.
    pub ray: Ray,
    /// Its flux times the number of photons that the light sends out, W.
    pub flux_w: Rgb,
}

/// Where a photon goes from a light.
struct Aimed {
    direction: Vec3,
    shares: Shares,
    /// Sum of the weights of the spheres that lie there.
    held: f32,
}

impl Aimed {
    /// Density of the direction where going anywhere has the density `blind`, 1/sr.
    fn density(&self, blind: f32) -> f32 {
        self.shares.density(self.held, blind)
    }
}

/// Shares of what is drawn: anywhere, and towards spheres.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shares {
    anywhere: f32,
    /// Sum of the sizes of the spheres, solid angles or areas, times their weights.
    size: f32,
}

impl Shares {
    /// - `is_inside`: a light stands within a sphere
    /// - `whole`: size of anywhere
    fn of(size: f32, is_inside: bool, whole: f32) -> Shares {
        let anywhere = match (size < whole, is_inside && size > 0.0) {
            (true, true) => 0.5,
            (true, false) if is_inside => 1.0,
            (true, false) => 0.0,
            (false, _) => 1.0,
        };
        Shares { anywhere, size }
    }

    /// Density of drawing what spheres of so much weight hold and anywhere has with the density `blind`.
    fn density(self, held: f32, blind: f32) -> f32 {
        let aimed = if held == 0.0 { 0.0 } else { held / self.size };
        self.anywhere * blind + (1.0 - self.anywhere) * aimed
    }
}

/// Splits off the choice of one of two from a number: true below `share`; and the rest of the number, as good as new.
fn choose(u: f32, share: f32) -> (bool, f32) {
    let is_first = u < share;
    let rest = if is_first { u / share } else { (u - share) / (1.0 - share) };
    (is_first, rest.clamp(0.0, 1.0 - f32::EPSILON))
}

/// Which of some sizes a place in their sum falls into, and where in it, in [0, 1). `None` where all are nothing.
fn choose_by_size(sizes: impl Iterator<Item = f32>, place: f32) -> Option<(usize, f32)> {
    let mut left = place;
    let mut last = None;
    for (index, size) in sizes.enumerate().filter(|(_, size)| *size > 0.0) {
        // By rounding the place may lie past the end: then it is in the last.
        last = Some((index, (left / size).clamp(0.0, 1.0 - f32::EPSILON)));
        if left < size {
            break;
        }
        left -= size;
    }
    last
}

/// The cone in which a sphere is seen.
struct Cone {
    axis: Vec3,
    sin2: f32,
    solid_angle_sr: f32,
    /// Of the sphere.
    weight: f32,
}

impl Sphere {
    /// `None` from within.
    fn seen_from(&self, p: Vec3) -> Option<Cone> {
        let away = self.middle - p;
        let sin2 = self.radius_m * self.radius_m / away.length_squared();
        // 1 − cos without cancellation.
        let open = sin2 / (1.0 + (1.0 - sin2).max(0.0).sqrt());
        let solid_angle_sr = TAU * open;
        let weight = self.weight;
        (sin2 < 1.0).then(|| Cone { axis: away.normalize_or(Vec3::Z), sin2, solid_angle_sr, weight })
    }

    /// Whether a ray goes through it.
    pub(crate) fn is_met_by(&self, ray: &Ray) -> bool {
        let direction = ray.direction.normalize();
        let to = self.middle - ray.origin;
        let along = to.dot(direction);
        let beside = (to - direction * along).length_squared();
        let r2 = self.radius_m * self.radius_m;
        beside <= r2 && (along >= 0.0 || to.length_squared() <= r2)
    }

    /// Area of its disc, m², times its weight.
    fn weighted_disc_m2(&self) -> f32 {
        PI * self.radius_m * self.radius_m * self.weight
    }
}

impl Cone {
    fn weighted_sr(&self) -> f32 {
        self.solid_angle_sr * self.weight
    }

    fn holds(&self, direction: Vec3) -> bool {
        direction.dot(self.axis) > 0.0 && direction.cross(self.axis).length_squared() <= self.sin2
    }

    fn draw(&self, u: [f32; 2]) -> Vec3 {
        let open = u[0] * self.solid_angle_sr / TAU;
        let sin = (open * (2.0 - open)).max(0.0).sqrt();
        let (sin_phi, cos_phi) = (TAU * u[1]).sin_cos();
        Frame::around(self.axis).to_world(Vec3::new(sin * cos_phi, sin * sin_phi, 1.0 - open))
    }
}

impl Aim {
    /// A direction from `p` towards a sphere, or anywhere. `None` where there is nothing to aim at.
    ///
    /// - `whole_sr`: solid angle of anywhere
    /// - `anywhere`: draws a direction that goes there
    fn direction(
        &self,
        p: Vec3,
        u: [f32; 2],
        whole_sr: f32,
        anywhere: impl FnOnce([f32; 2]) -> Vec3,
    ) -> Option<Aimed> {
        let cones = || self.spheres.iter().map(|sphere| sphere.seen_from(p));
        let size = cones().flatten().map(|cone| cone.weighted_sr()).sum::<f32>();
        let shares = Shares::of(size, cones().any(|cone| cone.is_none()), whole_sr);
        let (is_anywhere, rest) = choose(u[0], shares.anywhere);
        if is_anywhere {
            let direction = anywhere([rest, u[1]]);
            let held = cones().flatten().filter(|cone| cone.holds(direction)).map(|cone| cone.weight).sum();
            return Some(Aimed { direction, shares, held });
        }
        let (chosen, u0) = choose_by_size(cones().flatten().map(|cone| cone.weighted_sr()), rest * size)?;
        let cone = cones().flatten().nth(chosen)?;
        let direction = cone.draw([u0, u[1]]);
        // The one it was drawn for holds it, whatever rounding says.
        let others = cones().flatten().enumerate();
        let others = others.filter(|(index, other)| *index != chosen && other.holds(direction));
        let held = cone.weight + others.map(|(_, other)| other.weight).sum::<f32>();
        Some(Aimed { direction, shares, held })
    }

    /// Where a photon that comes along `across` from far away starts, and 1 / its density, m².
    fn start(&self, across: &Across, u: [f32; 2]) -> Option<(Vec3, f32)> {
        let size = self.spheres.iter().map(Sphere::weighted_disc_m2).sum::<f32>();
        if size >= across.area_m2() {
            return Some(across.start(u));
        }
        let (chosen, u0) = choose_by_size(self.spheres.iter().map(Sphere::weighted_disc_m2), u[0] * size)?;
        let sphere = &self.spheres[chosen];
        let offset = warp::disc([u0, u[1]]) * sphere.radius_m;
        let at = sphere.middle + across.frame.t * offset.x + across.frame.b * offset.y;
        let n = across.frame.n;
        let holds = |(index, other): &(usize, &Sphere)| {
            let away = at - other.middle;
            let beside = away - n * n.dot(away);
            *index != chosen && beside.length_squared() <= other.radius_m * other.radius_m
        };
        let others = self.spheres.iter().enumerate().filter(holds);
        let held = sphere.weight + others.map(|(_, other)| other.weight).sum::<f32>();
        Some((at - n * n.dot(at - across.origin), size / held))
    }
}

impl World {
    /// The photon of `source` for these numbers that goes towards one of the spheres; `None` when they ask for light that is
    /// not there.
    pub fn emit_at(&self, source: &Source, aim: &Aim, numbers: &EmissionNumbers) -> Option<AimedPhoton> {
        let photon = |ray, radiometric: Rgb, factor: f32| {
            let flux_w = radiometric * factor;
            (flux_w.is_finite() && flux_w.luminance() > 0.0).then_some(AimedPhoton { ray, flux_w })
        };
        match &source.kind {
            SourceKind::Point { position, intensity } => {
                let aimed = aim.direction(*position, numbers.direction, 2.0 * TAU, warp::sphere)?;
                photon(from_point(*position, aimed.direction), *intensity, 1.0 / aimed.density(0.5 / TAU))
            }
            SourceKind::Spot { position, axis, intensity, cos_inner, cos_outer } => {
                let whole_sr = TAU * (1.0 - cos_outer);
                let cone = Cone { axis: *axis, sin2: 1.0, solid_angle_sr: whole_sr, weight: 1.0 };
                let aimed = aim.direction(*position, numbers.direction, whole_sr, |u| cone.draw(u))?;
                let cos = aimed.direction.dot(*axis);
                let blind = if cos >= *cos_outer { 1.0 / whole_sr } else { 0.0 };
                let radiometric = *intensity * spot_falloff(cos, *cos_inner, *cos_outer);
                photon(from_point(*position, aimed.direction), radiometric, 1.0 / aimed.density(blind))
            }
            SourceKind::Directional { direction, irradiance, target } => {
                let (start, area_m2) = aim.start(&target.across(*direction), numbers.position)?;
                photon(Ray::new(start, *direction), *irradiance, area_m2)
            }
            SourceKind::Environment { target, .. } => {
                let environment = self.lights().environment()?;
                let (wi, pdf) = environment.sample(Vec3::ZERO, numbers.direction)?;
                let (start, area_m2) = aim.start(&target.across(-wi), numbers.position)?;
                photon(Ray::new(start, -wi), environment.radiance(wi), area_m2 / pdf)
            }
            SourceKind::Surface(surface) => {
                let Left { point, n, radiance, area_m2 } = self.leave(surface, numbers)?;
                let anywhere = |u| Frame::around(n).to_world(warp::cosine_hemisphere(u));
                let aimed = aim.direction(point.position, numbers.direction, TAU, anywhere)?;
                let cos = aimed.direction.dot(n);
                if cos <= 0.0 {
                    return None;
                }
                let sides = if surface.two_sided { 2.0 } else { 1.0 };
                let density = aimed.density(warp::cosine_hemisphere_pdf(cos));
                photon(point.ray_towards(aimed.direction), radiance, cos * area_m2 * sides / density)
            }
        }
    }

    /// Luminance of the flux that `source` sends towards the spheres, W: steers how many photons it gets.
    ///
    /// - `points`: photons that are tried; 512 say it to a few percent
    pub fn power_towards_w(&self, source: &Source, aim: &Aim, points: u32) -> f64 {
        let flux = |index: u32| {
            let [u, v, s, t] = sobol::point(0, index);
            let [side, ..] = sobol::point(1, index);
            let numbers = EmissionNumbers { direction: [u, v], position: [s, t], side };
            self.emit_at(source, aim, &numbers).map_or(0.0, |photon| luminance(photon.flux_w))
        };
        (0..points).map(flux).sum::<f64>() / f64::from(points.max(1))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DAffine3, DQuat, DVec3};

    use super::*;
    use crate::{
        math::RunningStatistics,
        scene::{
            Environment, Light, LightKind, Material,
            samples::{Stage, quad},
        },
    };

    const ROOM_HALF_M: f64 = 3.0;

    /// A world of four floating corners, so that its bounds are known, with one light.
    fn world(light: impl FnOnce(&mut Stage)) -> World {
        let mut stage = Stage::default();
        let matt = stage.material("matt", Material::lambert(Rgb::splat(0.5))).unwrap();
        let h = ROOM_HALF_M;
        let floor =
            [DVec3::new(-h, -h, h), DVec3::new(h, -h, h), DVec3::new(h, -h, -h), DVec3::new(-h, -h, -h)];
        stage.place("floor", quad(floor, &matt), DAffine3::IDENTITY).unwrap();
        let ceiling = floor.map(|corner| corner.with_y(h));
        stage.place("ceiling", quad(ceiling, &matt), DAffine3::IDENTITY).unwrap();
        light(&mut stage);
        World::prepare(Arc::new(stage.finish()))
    }

    fn punctual(kind: LightKind) -> World {
        world(|stage| {
            let direction = DVec3::new(0.3, -1.0, 0.2).normalize();
            let light = Light { kind, parent: None, position: DVec3::new(0.0, 2.0, 0.0), direction };
            stage.light("lamp", light).unwrap();
        })
    }

    fn lamp(two_sided: bool) -> World {
        world(|stage| {
            let emitter = Material { double_sided: two_sided, ..Material::emitter(Rgb::splat(3.0)) };
            let lamp = stage.material("lamp", emitter).unwrap();
            let corners = [[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]];
            let corners = corners.map(|[x, y]| DVec3::new(x, y, 0.0));
            let tilted = DAffine3::from_rotation_translation(DQuat::from_rotation_x(1.2), DVec3::Y);
            stage.place("lamp", quad(corners, &lamp), tilted).unwrap();
        })
    }

    fn sky() -> World {
        world(|stage| stage.builder().set_environment(Environment::Constant(Rgb::splat(2.0))).unwrap())
    }

    /// Independent numbers: the standard error of a mean is then that of independent draws.
    fn numbers(i: u32) -> EmissionNumbers {
        let [u, v, s, t] = sobol::point(2 * u64::from(i) + 1, 0);
        let [side, ..] = sobol::point(2 * u64::from(i) + 2, 0);
        EmissionNumbers { direction: [u, v], position: [s, t], side }
    }

    /// Aimed photons bring the spheres, and every smaller thing in them, the flux that blind ones bring: every kind of light,
    /// spheres far and near, overlapping, around the light, and all around.
    #[test]
    fn aimed_flux_is_that_of_blind_emission() {
        let weighted = |x: f32, y: f32, z: f32, radius_m: f32, weight: f32| Sphere {
            middle: Vec3::new(x, y, z),
            radius_m,
            weight,
        };
        let ball = |x: f32, y: f32, z: f32, radius_m: f32| weighted(x, y, z, radius_m, 1.0);
        let aims = [
            vec![ball(1.0, -1.0, 0.5, 0.4)],
            vec![ball(1.0, -1.0, 0.5, 0.9), ball(0.4, -1.2, 0.4, 0.7), ball(-1.5, 0.0, 1.0, 0.3)],
            vec![
                weighted(1.0, -1.0, 0.5, 0.9, 0.3),
                ball(0.4, -1.2, 0.4, 0.7),
                weighted(-1.5, 0.0, 1.0, 0.3, 0.6),
            ],
            vec![ball(0.0, 1.5, 0.0, 1.5), ball(1.5, -2.0, 0.0, 0.5)],
            vec![weighted(0.0, 1.5, 0.0, 1.5, 0.2), weighted(1.5, -2.0, 0.0, 0.5, 0.4)],
            vec![ball(0.0, 0.0, 0.0, 9.0)],
        ];
        let intensity = Rgb::new(1.0, 2.0, 3.0);
        let worlds = [
            punctual(LightKind::Point { intensity }),
            punctual(LightKind::Spot { intensity, inner_angle_rad: 0.5, outer_angle_rad: 0.9 }),
            punctual(LightKind::Directional { irradiance: intensity }),
            lamp(false),
            lamp(true),
            sky(),
        ];
        for (which, world) in worlds.iter().enumerate() {
            let source = &world.sources()[0];
            for spheres in &aims {
                let aim = Aim { spheres: spheres.clone() };
                // What counts: the flux that meets any sphere, and that which meets the lower half of the last.
                let last = spheres.last().unwrap();
                let part = Sphere {
                    middle: last.middle - Vec3::Y * 0.5 * last.radius_m,
                    radius_m: 0.5 * last.radius_m,
                    weight: 1.0,
                };
                let mut figures = [RunningStatistics::default(); 4];
                for i in 0..60_000 {
                    let aimed = world.emit_at(source, &aim, &numbers(i));
                    let blind = world.emit(source, &numbers(i));
                    let aimed = aimed.map_or((0.0, None), |p| (luminance(p.flux_w), Some(p.ray)));
                    let blind =
                        blind.map_or((0.0, None), |p| (luminance(p.weight) * source.power_w(), Some(p.ray)));
                    for (offset, (flux, ray)) in [(0, aimed), (2, blind)] {
                        let any = ray.is_some_and(|ray| spheres.iter().any(|sphere| sphere.is_met_by(&ray)));
                        let in_part = ray.is_some_and(|ray| part.is_met_by(&ray));
                        figures[offset].add(if any { flux } else { 0.0 });
                        figures[offset + 1].add(if in_part { flux } else { 0.0 });
                    }
                }
                for pair in [[figures[0], figures[2]], [figures[1], figures[3]]] {
                    let [aimed, blind] = pair;
                    let error = aimed.standard_error().hypot(blind.standard_error());
                    let off = (aimed.mean() - blind.mean()).abs();
                    assert!(
                        off <= 4.5 * error + 1e-4 * blind.mean(),
                        "light {which}, {spheres:?}: {} for {} ± {error}",
                        aimed.mean(),
                        blind.mean()
                    );
                }
                let power_w = world.power_towards_w(source, &aim, 512);
                // Of light that goes anywhere as well, all counts.
                assert!(power_w >= 0.85 * figures[0].mean(), "light {which}: {power_w}");
            }
        }
    }

    /// Where there is nothing to aim at, or nothing that is seen, nothing is sent.
    #[test]
    fn nothing_is_aimed_at_nothing() {
        let world = lamp(false);
        let source = &world.sources()[0];
        for spheres in [vec![], vec![Sphere { middle: Vec3::ONE, radius_m: 0.0, weight: 1.0 }]] {
            let aim = Aim { spheres };
            assert_eq!(world.power_towards_w(source, &aim, 512), 0.0);
        }
    }
}
