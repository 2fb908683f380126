//! Lights as photons leave them: how much each sends out, and where the photon of given numbers starts.

mod aim;
mod target;

use std::{f32::consts::PI, f64, sync::Arc};

use glam::Vec3;

pub use self::aim::{Aim, AimedPhoton, Sphere};
use self::target::Target;
use super::{LocalLight, room_at_point, spot_falloff};
use crate::{
    accel::{Hit, Instance, Ray, SurfacePoint, TriangleId},
    math::{Frame, Rgb, warp},
    scene::{Id, LightKind, Material, Texture, TextureSlot},
    transport::World,
};

/// Who a source is, whatever it sends out: edits are told apart by it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum SourceName {
    /// A punctual light of the scene.
    Punctual(Id),
    /// The emissive primitive with this index of the mesh that this node shows.
    Surface(Id, u32),
    /// What surrounds the scene.
    Environment,
}

/// A light as photons leave it.
#[derive(Clone, Debug)]
pub struct Source {
    name: SourceName,
    kind: SourceKind,
    power_w: f64,
}

#[derive(Clone, Debug)]
enum SourceKind {
    Point { position: Vec3, intensity: Rgb },
    Spot { position: Vec3, axis: Vec3, intensity: Rgb, cos_inner: f32, cos_outer: f32 },
    Directional { direction: Vec3, irradiance: Rgb, target: Target },
    Surface(Arc<EmissiveSurface>),
    Environment { identity: EnvironmentIdentity, target: Target },
}

/// What must be the same for the environment to send out the same.
#[derive(Clone, Debug)]
struct EnvironmentIdentity {
    description: crate::scene::Environment,
    texture: Option<Arc<Texture>>,
}

/// Triangles that emit together.
#[derive(Debug)]
struct EmissiveSurface {
    instance: Arc<Instance>,
    first_triangle: u32,
    first_light: u32,
    /// Running sums of the areas of the triangles' parts, m², times how much more of the light each emits than the mean.
    areas: Vec<f64>,
    material: Arc<Material>,
    /// Those that decide where and how much it emits: base colour (for its mask) and emission.
    textures: [Option<Arc<Texture>>; 2],
    two_sided: bool,
}

/// A point of an emissive surface that a photon leaves.
struct Left {
    point: SurfacePoint,
    /// Normal of a side that emits there.
    n: Vec3,
    /// What it sends out.
    radiance: Rgb,
    /// One over the density of the point over the surface.
    area_m2: f32,
}

/// The numbers in [0, 1) that a photon starts from.
#[derive(Clone, Copy, Debug)]
pub struct EmissionNumbers {
    /// Where it goes.
    pub direction: [f32; 2],
    /// Where on its light it starts.
    pub position: [f32; 2],
    /// Which side of a two-sided light.
    pub side: f32,
}

/// A photon on its way from the light.
#[derive(Clone, Copy, Debug)]
pub struct EmittedPhoton {
    /// Its first ray.
    pub ray: Ray,
    /// Its flux in shares of the source's power divided by the number of photons: of luminance about 1; of light that
    /// [is aimed](Source::is_aimed) 4 far from what it is aimed at, down to a thousandth there.
    pub weight: Rgb,
}

impl Source {
    /// Who it is.
    pub fn name(&self) -> &SourceName {
        &self.name
    }

    /// Luminance of the flux it sends out, W, above zero. Steers how many photons it gets; weights make up for what it
    /// is off by where textures are averaged.
    pub fn power_w(&self) -> f64 {
        self.power_w
    }

    /// It has no size, neither as a surface nor in the sky: no ray can meet it.
    pub fn is_delta(&self) -> bool {
        use SourceKind::*;
        matches!(self.kind, Point { .. } | Spot { .. } | Directional { .. })
    }

    /// It is infinitely far.
    pub fn is_infinite(&self) -> bool {
        matches!(self.kind, SourceKind::Directional { .. } | SourceKind::Environment { .. })
    }

    /// All that it sends out goes one way: photons differ by where they start alone.
    pub fn is_one_way(&self) -> bool {
        matches!(self.kind, SourceKind::Directional { .. })
    }

    /// It shines from infinitely far, and most of its photons are aimed at things on wide ground.
    pub fn is_aimed(&self) -> bool {
        self.target().is_some_and(Target::is_uneven)
    }

    /// What a photon of light that goes one way carries because more or fewer are aimed at where it goes, over what it would if they were spread
    /// evenly.
    pub fn share_by_aim(&self, numbers: &EmissionNumbers) -> f32 {
        match &self.kind {
            SourceKind::Directional { direction, target, .. } if target.is_uneven() => {
                let across = target.across(*direction);
                across.start(numbers.position).1 / across.area_m2()
            }
            _ => 1.0,
        }
    }

    /// What light from infinitely far is aimed at.
    fn target(&self) -> Option<&Target> {
        match &self.kind {
            SourceKind::Directional { target, .. } | SourceKind::Environment { target, .. } => Some(target),
            _ => None,
        }
    }

    /// Both aim at the same, or neither does.
    pub fn aims_like(&self, other: &Source) -> bool {
        self.target() == other.target()
    }

    /// True when both send out the very same photons for the same numbers.
    pub fn emits_like(&self, other: &Source) -> bool {
        self.power_w == other.power_w && self.aims_like(other) && self.shines_like(other)
    }

    /// True when both bring the same light to every place, whatever their photons are aimed at.
    pub fn shines_like(&self, other: &Source) -> bool {
        use SourceKind::*;
        let same_texture = |a: &Option<Arc<Texture>>, b: &Option<Arc<Texture>>| match (a, b) {
            (Some(a), Some(b)) => Arc::ptr_eq(a, b),
            (None, None) => true,
            _ => false,
        };
        (self.target().is_some() || self.power_w == other.power_w)
            && match (&self.kind, &other.kind) {
                (Point { position, intensity }, Point { position: p, intensity: i }) => {
                    (position, intensity) == (p, i)
                }
                (
                    Spot { position, axis, intensity, cos_inner, cos_outer },
                    Spot { position: p, axis: a, intensity: i, cos_inner: ci, cos_outer: co },
                ) => (position, axis, intensity, cos_inner, cos_outer) == (p, a, i, ci, co),
                (
                    Directional { direction, irradiance, .. },
                    Directional { direction: d, irradiance: i, .. },
                ) => (direction, irradiance) == (d, i),
                (Surface(a), Surface(b)) => {
                    Arc::ptr_eq(&a.instance, &b.instance)
                        && a.first_triangle == b.first_triangle
                        // Cut as finely as before: how many lamps there are bounds that.
                        && a.areas.len() == b.areas.len()
                        && (Arc::ptr_eq(&a.material, &b.material) || a.material == b.material)
                        && a.textures.iter().zip(&b.textures).all(|(a, b)| same_texture(a, b))
                }
                (Environment { identity: a, .. }, Environment { identity: b, .. }) => {
                    a.description == b.description && same_texture(&a.texture, &b.texture)
                }
                _ => false,
            }
    }
}

impl World {
    /// Every light that sends anything out, in the scene's order.
    pub fn sources(&self) -> Vec<Source> {
        let mut sources = self.surface_sources();
        let target = Target::of(self);
        let scene = self.scene();
        for (id, light) in scene.lights() {
            let world_from_parent = scene.world_from_node(light.parent.as_ref());
            let position = self.accel().to_render(world_from_parent.transform_point3(light.position));
            let axis = world_from_parent
                .transform_vector3(light.direction)
                .normalize_or(glam::DVec3::NEG_Z)
                .as_vec3();
            let (kind, power_w) = match light.kind {
                LightKind::Point { intensity } => {
                    (SourceKind::Point { position, intensity }, 4.0 * f64::consts::PI * luminance(intensity))
                }
                LightKind::Spot { intensity, inner_angle_rad, outer_angle_rad } => {
                    let (cos_inner, cos_outer) = (inner_angle_rad.cos(), outer_angle_rad.cos());
                    let solid_angle_sr = f64::consts::PI * f64::from(2.0 - cos_inner - cos_outer);
                    let kind = SourceKind::Spot { position, axis, intensity, cos_inner, cos_outer };
                    (kind, solid_angle_sr * luminance(intensity))
                }
                LightKind::Directional { irradiance } => {
                    let Some(target) = target else { continue };
                    let power_w = luminance(irradiance) * f64::from(target.across(axis).area_m2());
                    (SourceKind::Directional { direction: axis, irradiance, target }, power_w)
                }
            };
            sources.push(Source { name: SourceName::Punctual(id.clone()), kind, power_w });
        }
        sources.extend(target.and_then(|target| self.environment_source(target)));
        sources.retain(|source| source.power_w > 0.0 && source.power_w.is_finite());
        sources
    }

    fn surface_sources(&self) -> Vec<Source> {
        let lights = self.lights();
        let mut sources = Vec::new();
        for (index, (instance, runs)) in self.accel().instances().iter().zip(&lights.runs).enumerate() {
            for run in runs {
                let Some(primitive_index) = instance
                    .mesh()
                    .primitives()
                    .iter()
                    .position(|primitive| primitive.first_triangle == run.first_triangle)
                else {
                    continue;
                };
                let mut sum = 0.0;
                let areas: Vec<f64> = lights.local[run.lights()]
                    .iter()
                    .map(|light| {
                        if let LocalLight::Triangle { area_m2, share, .. } = light {
                            sum += f64::from(*area_m2) * f64::from(*share);
                        }
                        sum
                    })
                    .collect();
                let prepared = self.material_of(&Hit {
                    t: 0.0,
                    instance: index as u32,
                    triangle: run.first_triangle,
                    b1: 0.0,
                    b2: 0.0,
                });
                let two_sided = prepared.material().double_sided;
                let sides = if two_sided { 2.0 } else { 1.0 };
                let power_w = f64::from(prepared.emission_luminance()) * sum * f64::consts::PI * sides;
                let texture = |slot: TextureSlot| prepared.texture(slot).cloned();
                let surface = EmissiveSurface {
                    instance: instance.clone(),
                    first_triangle: run.first_triangle,
                    first_light: run.first_light,
                    areas,
                    material: prepared.shared_material().clone(),
                    textures: [texture(TextureSlot::BaseColor), texture(TextureSlot::Emission)],
                    two_sided,
                };
                let name = SourceName::Surface(instance.node_id().clone(), primitive_index as u32);
                sources.push(Source { name, kind: SourceKind::Surface(Arc::new(surface)), power_w });
            }
        }
        sources
    }

    fn environment_source(&self, target: Target) -> Option<Source> {
        let environment = self.lights().environment()?;
        // Mean over evenly spread directions of radiance × the target's size across: good to some percent, and what it is
        // off by is in the weights.
        const POINTS: u32 = 256;
        let mut sum = 0.0;
        for i in 0..POINTS {
            let u = [(i as f32 + 0.5) / POINTS as f32, (i as f32 * 0.618_034).fract()];
            let Some((wi, pdf)) = environment.sample(Vec3::ZERO, u) else { continue };
            sum += luminance(environment.radiance(wi)) * f64::from(target.across(-wi).area_m2() / pdf);
        }
        let description = self.scene().environment().clone();
        let texture = match &description {
            crate::scene::Environment::Image { texture, .. } => self.scene().textures().get(texture).cloned(),
            _ => None,
        };
        let kind = SourceKind::Environment { identity: EnvironmentIdentity { description, texture }, target };
        Some(Source { name: SourceName::Environment, kind, power_w: sum / f64::from(POINTS) })
    }

    /// The photon of `source` for these numbers; `None` when they ask for light that is not there (beyond a spot's cone,
    /// where a mask cuts the lamp away).
    pub fn emit(&self, source: &Source, numbers: &EmissionNumbers) -> Option<EmittedPhoton> {
        // Flux of this sample over the flux that the source's power would give it.
        let weighed = |radiometric: Rgb, factor: f32| {
            let scale = (f64::from(factor) / source.power_w) as f32;
            let weight = radiometric * scale;
            (weight.is_finite() && weight.luminance() > 0.0).then_some(weight)
        };
        match &source.kind {
            SourceKind::Point { position, intensity } => {
                let ray = from_point(*position, warp::sphere(numbers.direction));
                Some(EmittedPhoton { ray, weight: weighed(*intensity, 4.0 * PI)? })
            }
            SourceKind::Spot { position, axis, intensity, cos_inner, cos_outer } => {
                // Evenly over the outer cone: cos θ = 1 − u (1 − cos_outer).
                let [u, v] = numbers.direction;
                let cos = 1.0 - u * (1.0 - cos_outer);
                let sin = (1.0 - cos * cos).max(0.0).sqrt();
                let (sin_phi, cos_phi) = (2.0 * PI * v).sin_cos();
                let local = Vec3::new(sin * cos_phi, sin * sin_phi, cos);
                let ray = from_point(*position, Frame::around(*axis).to_world(local));
                let radiometric = *intensity * spot_falloff(cos, *cos_inner, *cos_outer);
                Some(EmittedPhoton { ray, weight: weighed(radiometric, 2.0 * PI * (1.0 - cos_outer))? })
            }
            SourceKind::Directional { direction, irradiance, target } => {
                let (start, area_m2) = target.across(*direction).start(numbers.position);
                let ray = Ray::new(start, *direction);
                Some(EmittedPhoton { ray, weight: weighed(*irradiance, area_m2)? })
            }
            SourceKind::Environment { target, .. } => {
                let environment = self.lights().environment()?;
                let (wi, pdf) = environment.sample(Vec3::ZERO, numbers.direction)?;
                let (start, area_m2) = target.across(-wi).start(numbers.position);
                let ray = Ray::new(start, -wi);
                let weight = weighed(environment.radiance(wi), area_m2 / pdf)?;
                Some(EmittedPhoton { ray, weight })
            }
            SourceKind::Surface(surface) => {
                let Left { point, n, radiance, area_m2 } = self.leave(surface, numbers)?;
                let direction = Frame::around(n).to_world(warp::cosine_hemisphere(numbers.direction));
                let sides = if surface.two_sided { 2.0 } else { 1.0 };
                // Radiance · cos / (1/area · cos/π · 1/sides): the cosine cancels.
                let weight = weighed(radiance, PI * area_m2 * sides)?;
                Some(EmittedPhoton { ray: point.ray_towards(direction), weight })
            }
        }
    }

    /// Where on an emissive surface a photon starts.
    fn leave(&self, surface: &EmissiveSurface, numbers: &EmissionNumbers) -> Option<Left> {
        let total = *surface.areas.last()?;
        let target = f64::from(numbers.position[0]) * total;
        let index = surface.areas.partition_point(|sum| *sum <= target).min(surface.areas.len() - 1);
        let below = if index == 0 { 0.0 } else { surface.areas[index - 1] };
        let share = surface.areas[index] - below;
        let rest = ((target - below) / share) as f32;
        let light = self.lights().local.get(surface.first_light as usize + index)?;
        let LocalLight::Triangle { instance, triangle, part, share: of_mean, .. } = *light else {
            return None;
        };
        let [b1, b2] = part.at(warp::triangle([rest.clamp(0.0, 1.0), numbers.position[1]]));
        let hit = Hit { t: 0.0, instance, triangle, b1, b2 };
        let placed = &self.accel().instances()[instance as usize];
        let material = self.material_of(&hit);
        if !material.is_present(placed, &hit) {
            return None;
        }
        let point =
            SurfacePoint { on: TriangleId { instance, triangle }, ..placed.surface_point(triangle, b1, b2) };
        let from_front = !surface.two_sided || numbers.side < 0.5;
        let n = if from_front { point.n_geo } else { -point.n_geo };
        let radiance = material.emitted(placed, &hit, from_front);
        Some(Left { point, n, radiance, area_m2: total as f32 / of_mean })
    }
}

/// The way of a photon from a light without size; begun as far from it as shadow rays end before it.
fn from_point(position: Vec3, direction: Vec3) -> Ray {
    Ray::new(position + direction * room_at_point(position), direction)
}

fn luminance(rgb: Rgb) -> f64 {
    f64::from(rgb.luminance())
}
