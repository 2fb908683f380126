//! Lights as the integrator asks for them: a direction, the radiance from there, and the density of having drawn it.
//!
//! Emissive triangles, point and spot lights stand in one light tree; directional lights and the environment
//! are chosen evenly beside it. Every density includes the choice of the light.

mod bounds;
mod change;
mod environment;
mod openings;
mod shares;
mod source;
#[cfg(test)]
mod tests;
mod tree;
mod upload;

use glam::Vec3;

pub(crate) use self::change::{LightsChange, change_of_lights};
pub(in crate::transport) use self::environment::EnvironmentLight;
pub(in crate::transport) use self::openings::Openings;
pub use self::openings::{Opening, Through};
pub(in crate::transport) use self::shares::Shares;
pub use self::source::{Aim, AimedPhoton, EmissionNumbers, EmittedPhoton, Source, SourceName, Sphere};
use self::{
    bounds::LightBounds,
    shares::{Cut, Part},
    tree::LightTree,
};
#[cfg(all(test, feature = "gpu"))]
pub(crate) use self::{
    bounds::{IMPORTANCE_MAX, LEVEL},
    tree::FEW,
};
use crate::{
    accel::{Accel, Hit, Ray, SurfacePoint},
    math::{Rgb, warp},
    scene::{LightKind, Scene},
};

/// Room around a light without size in shares of its largest coordinate: see [`room_at_point`].
pub(crate) const POINT_ROOM: f32 = 1.0 / 32_768.0;

/// How near to a light without size nothing hides it or catches its photons, m: a ceiling that a lamp stands in does not shadow what lies on either
/// side, though rounding puts the lamp before it or behind. What runs by the plane of the ceiling at an angle of sine s passes it where the
/// lamp is no farther off than s times this; roundings leave that but for a degree along the plane. Near the middle of render space there is less room
/// than corners far from it are rounded by, and none in the very middle: a plane through a lamp there may hide it.
pub(in crate::transport) fn room_at_point(position: Vec3) -> f32 {
    position.abs().max_element() * POINT_ROOM
}

/// A light that stands somewhere.
#[derive(Clone, Copy, Debug)]
enum LocalLight {
    Triangle {
        instance: u32,
        triangle: u32,
        /// All of it, or one of those that it is cut into.
        part: Part,
        /// Of the part.
        area_m2: f32,
        /// See [`Shares`].
        share: f32,
        two_sided: bool,
    },
    Point {
        position: Vec3,
        intensity: Rgb,
    },
    Spot {
        position: Vec3,
        axis: Vec3,
        intensity: Rgb,
        cos_inner: f32,
        cos_outer: f32,
    },
}

/// A directional light: travels along `direction`.
#[derive(Clone, Copy, Debug)]
struct Directional {
    direction: Vec3,
    irradiance: Rgb,
}

/// Where a light sample comes from.
#[derive(Clone, Copy, Debug)]
pub enum LightOrigin {
    /// A point on an emissive triangle; the caller looks up what it emits.
    Surface {
        /// Instance index.
        instance: u32,
        /// Triangle index.
        triangle: u32,
        /// Barycentric weights of the second and third vertex.
        barycentric: [f32; 2],
        /// The point.
        point: SurfacePoint,
    },
    /// A point without size.
    Point(Vec3),
    /// Infinitely far.
    Infinite,
}

/// A direction towards a light.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit direction to the light.
    pub wi: Vec3,
    /// Radiance along −wi for surfaces and the environment; for lights without size what radiance × density would
    /// be: W/sr over squared distance, or W/m². Surfaces: left white, see [`LightOrigin::Surface`].
    pub radiance: Rgb,
    /// Density over solid angle times the chance of the light, 1/sr; for lights without size the chance alone.
    pub pdf: f32,
    /// True for lights without size, which no scattered ray can hit.
    pub is_delta: bool,
    /// Where it comes from.
    pub origin: LightOrigin,
}

/// Triangles of one primitive of an instance that emit, their parts numbered from `first_light` on.
#[derive(Clone, Copy, Debug)]
struct EmissiveRun {
    first_triangle: u32,
    triangle_count: u32,
    first_light: u32,
    cut: Cut,
}

impl EmissiveRun {
    /// The lights that its triangles are.
    fn lights(&self) -> std::ops::Range<usize> {
        let first = self.first_light as usize;
        first..first + self.triangle_count as usize * self.cut.count() as usize
    }
}

/// All lights of a scene.
#[derive(Debug)]
pub struct Lights {
    local: Vec<LocalLight>,
    tree: LightTree,
    directional: Vec<Directional>,
    environment: Option<EnvironmentLight>,
    /// Per instance, the runs of its triangles that emit.
    runs: Vec<Vec<EmissiveRun>>,
    emissive_triangles: usize,
    /// Largest of the instances that emit: what rounding may move a ray by on its way into mesh space, m.
    slack_m: f32,
}

/// What the lights need to know of a primitive that emits.
#[derive(Clone, Debug)]
pub(in crate::transport) struct Emission {
    /// Mean luminance of the emitted radiance over the material's texture.
    pub(in crate::transport) luminance: f32,
    /// `None`: as much everywhere.
    pub(in crate::transport) shares: Option<Shares>,
    pub(in crate::transport) two_sided: bool,
}

impl Emission {
    fn cut(&self) -> Cut {
        self.shares.as_ref().map_or(Cut::default(), |shares| shares.cut)
    }

    /// - `number`: of a part of a triangle among the primitive's
    fn share(&self, number: usize) -> f32 {
        self.shares.as_ref().map_or(1.0, |shares| shares.of_parts[number])
    }
}

impl Lights {
    /// Collects the lights of `scene`; `emission_of(instance, primitive)` says what a primitive emits.
    pub(in crate::transport) fn collect(
        scene: &Scene,
        accel: &Accel,
        mut emission_of: impl FnMut(usize, usize) -> Option<Emission>,
    ) -> Lights {
        let mut lights = Lights {
            local: Vec::new(),
            tree: LightTree::default(),
            directional: Vec::new(),
            environment: EnvironmentLight::of(scene),
            runs: Vec::with_capacity(accel.instances().len()),
            emissive_triangles: 0,
            slack_m: 0.0,
        };
        let mut bounds = Vec::new();
        for (instance_index, instance) in accel.instances().iter().enumerate() {
            let mut runs = Vec::new();
            for (primitive_index, primitive) in instance.mesh().primitives().iter().enumerate() {
                let Some(emission) = emission_of(instance_index, primitive_index) else { continue };
                lights.slack_m = lights.slack_m.max(instance.slack_m());
                let cut = emission.cut();
                runs.push(EmissiveRun {
                    first_triangle: primitive.first_triangle,
                    triangle_count: primitive.triangle_count,
                    first_light: lights.local.len() as u32,
                    cut,
                });
                lights.emissive_triangles += primitive.triangle_count as usize;
                for number in 0..primitive.triangle_count {
                    let triangle = primitive.first_triangle + number;
                    let first = number as usize * cut.count() as usize;
                    let shares = (first..).map(|part| emission.share(part));
                    lights.add_triangle(
                        accel,
                        (instance_index as u32, triangle),
                        cut.parts().zip(shares),
                        &emission,
                        &mut bounds,
                    );
                }
            }
            lights.runs.push(runs);
        }
        lights.add_punctual(scene, accel, &mut bounds);
        lights.tree = LightTree::build(bounds);
        lights
    }

    /// - `parts`: those that it is cut into, all of the same size, each with its share
    fn add_triangle(
        &mut self,
        accel: &Accel,
        (instance, triangle): (u32, u32),
        parts: impl Iterator<Item = (Part, f32)>,
        emission: &Emission,
        bounds: &mut Vec<(u32, LightBounds)>,
    ) {
        let placed = &accel.instances()[instance as usize];
        let corners = placed.mesh().triangles()[triangle as usize];
        let [a, b, c] = corners.map(|vertex| placed.vertex_in_render(vertex));
        // The area from the edges as the mesh has them: corners in render space are rounded to 2⁻²⁴ of their distance
        // from its origin, which a lamp of a centimetre ten kilometres away does not survive.
        let [v0, v1, v2] = corners.map(|vertex| placed.mesh().positions()[vertex as usize]);
        let [e1, e2] = [v1 - v0, v2 - v0].map(|edge| placed.vector_to_render(edge).as_dvec3());
        let area_m2 = (e1.cross(e2).length() * 0.5 / f64::from(emission.cut().count())) as f32;
        let axis = placed.surface_point(triangle, 1.0 / 3.0, 1.0 / 3.0).n_geo;
        let two_sided = emission.two_sided;
        for (part, share) in parts {
            let [a, b, c] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|own| {
                let [b1, b2] = part.at(own);
                a * (1.0 - b1 - b2) + b * b1 + c * b2
            });
            let light = LightBounds {
                min: a.min(b).min(c),
                max: a.max(b).max(c),
                axis,
                cos_normals: 1.0,
                cos_emission: 0.0,
                intensity: (emission.luminance * share * area_m2).min(f32::MAX),
                two_sided,
            };
            bounds.push((self.local.len() as u32, light));
            self.local.push(LocalLight::Triangle { instance, triangle, part, area_m2, share, two_sided });
        }
    }

    fn add_punctual(&mut self, scene: &Scene, accel: &Accel, bounds: &mut Vec<(u32, LightBounds)>) {
        for light in scene.lights().values() {
            let world_from_parent = scene.world_from_node(light.parent.as_ref());
            let position = accel.to_render(world_from_parent.transform_point3(light.position));
            let axis = world_from_parent
                .transform_vector3(light.direction)
                .normalize_or(glam::DVec3::NEG_Z)
                .as_vec3();
            let standing = |intensity: Rgb, cos_normals: f32, cos_emission: f32| LightBounds {
                min: position,
                max: position,
                axis,
                cos_normals,
                cos_emission,
                intensity: intensity.luminance(),
                two_sided: false,
            };
            match light.kind {
                LightKind::Directional { irradiance } => {
                    if !irradiance.is_black() {
                        self.directional.push(Directional { direction: axis, irradiance });
                    }
                    continue;
                }
                LightKind::Point { intensity } => {
                    bounds.push((self.local.len() as u32, standing(intensity, -1.0, 0.0)));
                    self.local.push(LocalLight::Point { position, intensity });
                }
                LightKind::Spot { intensity, inner_angle_rad, outer_angle_rad } => {
                    let (cos_inner, cos_outer) = (inner_angle_rad.cos(), outer_angle_rad.cos());
                    // The axis spreads over the outer cone and emission ends there: no further spread.
                    bounds.push((self.local.len() as u32, standing(intensity, cos_outer, 1.0 - 1e-6)));
                    self.local.push(LocalLight::Spot { position, axis, intensity, cos_inner, cos_outer });
                }
            }
        }
    }

    /// The environment, if any light comes from there.
    pub(in crate::transport) fn environment(&self) -> Option<&EnvironmentLight> {
        self.environment.as_ref()
    }

    /// Light comes from outside the scene.
    pub fn has_environment(&self) -> bool {
        self.environment.is_some()
    }

    /// Number of emissive triangles.
    pub fn emissive_triangle_count(&self) -> usize {
        self.emissive_triangles
    }

    /// True when no light of the scene sends anything out.
    pub fn is_dark(&self) -> bool {
        self.tree.is_empty() && self.infinite_count() == 0
    }

    /// Bytes of lights and their tree.
    pub fn bytes(&self) -> usize {
        self.local.len() * size_of::<LocalLight>()
            + self.tree.bytes()
            + self.environment.as_ref().map_or(0, EnvironmentLight::bytes)
    }

    /// False when nothing that emits lies on the ray; the environment does not count.
    pub fn may_meet(&self, ray: &Ray) -> bool {
        self.emissive_triangles > 0 && self.tree.may_meet(ray, self.slack_m)
    }

    fn infinite_count(&self) -> usize {
        self.directional.len() + usize::from(self.environment.is_some())
    }

    /// Chance of each infinite light, and of the tree: even, since power at a distance compares with nothing near.
    fn shares(&self) -> (f32, f32) {
        let choices = self.infinite_count() + usize::from(!self.tree.is_empty());
        let each = 1.0 / choices.max(1) as f32;
        (each, if self.tree.is_empty() { 0.0 } else { each })
    }

    /// Draws a light for the point `p` whose surface faces `n` (zero vector: faces anywhere), with numbers `u`
    /// (choice, two for the place on it). `None`: no light for these numbers.
    ///
    /// - `opening`: where the sky shows from there, asked if that is the light
    pub fn sample<'a>(
        &self,
        accel: &Accel,
        p: Vec3,
        n: Vec3,
        opening: impl FnOnce() -> Option<&'a Opening>,
        u: [f32; 3],
    ) -> Option<LightSample> {
        let (each, tree_share) = self.shares();
        if u[0] < tree_share {
            let (light, chance) = self.tree.sample(p, n, u[0] / tree_share)?;
            return self.sample_local(accel, light, chance * tree_share, p, [u[1], u[2]]);
        }
        let infinite_count = self.infinite_count();
        // Rounding may reach one past the last.
        let index = (((u[0] - tree_share) / each) as usize).min(infinite_count.checked_sub(1)?);
        if let Some(light) = self.directional.get(index) {
            return Some(LightSample {
                wi: -light.direction,
                radiance: light.irradiance,
                pdf: each,
                is_delta: true,
                origin: LightOrigin::Infinite,
            });
        }
        let environment = self.environment.as_ref()?;
        let (wi, pdf) = environment.sample_through(opening(), n, [u[1], u[2]])?;
        let radiance = environment.radiance(wi);
        // Parts of the hemisphere that light comes through may hold black ones.
        if radiance.is_black() {
            return None;
        }
        Some(LightSample { wi, radiance, pdf: pdf * each, is_delta: false, origin: LightOrigin::Infinite })
    }

    fn sample_local(
        &self,
        accel: &Accel,
        light: u32,
        chance: f32,
        p: Vec3,
        u: [f32; 2],
    ) -> Option<LightSample> {
        let point_light = |position: Vec3, intensity: Rgb| {
            let to_light = position - p;
            let distance2 = to_light.length_squared();
            let wi = to_light.try_normalize()?;
            let radiance = intensity * (1.0 / distance2);
            let origin = LightOrigin::Point(position);
            Some(LightSample { wi, radiance, pdf: chance, is_delta: true, origin })
        };
        match self.local[light as usize] {
            LocalLight::Point { position, intensity } => point_light(position, intensity),
            LocalLight::Spot { position, axis, intensity, cos_inner, cos_outer } => {
                let mut sample = point_light(position, intensity)?;
                sample.radiance *= spot_falloff(-sample.wi.dot(axis), cos_inner, cos_outer);
                (!sample.radiance.is_black()).then_some(sample)
            }
            LocalLight::Triangle { instance, triangle, part, area_m2, two_sided, .. } => {
                let barycentric = part.at(warp::triangle(u));
                let point = accel.instances()[instance as usize].surface_point(
                    triangle,
                    barycentric[0],
                    barycentric[1],
                );
                let to_light = point.position - p;
                let wi = to_light.try_normalize()?;
                let pdf = area_pdf(point.n_geo, area_m2, two_sided, wi, to_light.length_squared())? * chance;
                let origin = LightOrigin::Surface { instance, triangle, barycentric, point };
                Some(LightSample { wi, radiance: Rgb::WHITE, pdf, is_delta: false, origin })
            }
        }
    }

    /// Which light shines where a triangle was hit, if it is one.
    fn number_of(&self, hit: &Hit) -> Option<u32> {
        let runs = &self.runs[hit.instance as usize];
        let run =
            runs.iter().find(|run| hit.triangle.wrapping_sub(run.first_triangle) < run.triangle_count)?;
        let before = (hit.triangle - run.first_triangle) * run.cut.count();
        Some(run.first_light + before + run.cut.part_of([hit.b1, hit.b2]))
    }

    /// Density with which [`Lights::sample`] at (`p`, `n`) draws direction `wi` to this point of a triangle; zero when
    /// the triangle is no light.
    pub fn pdf_of_triangle(&self, p: Vec3, n: Vec3, wi: Vec3, hit: &Hit, on_light: &SurfacePoint) -> f32 {
        let Some(light) = self.number_of(hit) else { return 0.0 };
        let LocalLight::Triangle { area_m2, two_sided, .. } = self.local[light as usize] else { return 0.0 };
        let distance2 = (on_light.position - p).length_squared();
        match area_pdf(on_light.n_geo, area_m2, two_sided, wi, distance2) {
            Some(pdf) => pdf * self.tree.probability(p, n, light) * self.shares().1,
            None => 0.0,
        }
    }

    /// Density with which [`Lights::sample`] draws `wi` from the environment.
    pub fn pdf_of_environment(&self, n: Vec3, opening: Option<&Opening>, wi: Vec3) -> f32 {
        self.environment
            .as_ref()
            .map_or(0.0, |environment| environment.pdf_through(opening, n, wi) * self.shares().0)
    }
}

/// Density of an evenly drawn point of a triangle as a direction: distance² / (cos θ · area). `None` from behind.
fn area_pdf(n: Vec3, area_m2: f32, two_sided: bool, wi: Vec3, distance2: f32) -> Option<f32> {
    let cos = -n.dot(wi);
    let cos = if two_sided { cos.abs() } else { cos };
    let pdf = distance2 / (cos * area_m2);
    (cos > 0.0 && pdf > 0.0 && pdf.is_finite()).then_some(pdf)
}

/// glTF's spot falloff: 1 inside the inner cone, 0 outside the outer one, smooth (squared) between.
fn spot_falloff(cos: f32, cos_inner: f32, cos_outer: f32) -> f32 {
    let range = (cos_inner - cos_outer).max(1e-6);
    let t = ((cos - cos_outer) / range).clamp(0.0, 1.0);
    t * t
}
