//! The scene made ready for light paths.

use std::{collections::HashMap, sync::Arc};

use glam::Vec3;

#[cfg(feature = "gpu")]
use super::Absorption;
use super::{
    Lights, Surface,
    light::{Emission, EnvironmentLight, Opening, Openings, Shares, Through, room_at_point},
    surface::PreparedMaterial,
};
use crate::{
    accel::{Accel, AccelReport, Hit, Instance, Ray, SurfacePoint, TriangleId},
    math::Rgb,
    scene::{Id, NestedBounds, Scene, SceneChange},
    transport::LightOrigin,
};

/// A scene with its trees, materials and lights. Immutable: an edit makes a new one that shares what stayed.
#[derive(Debug)]
pub struct World {
    scene: Arc<Scene>,
    accel: Accel,
    nested_bounds: Option<NestedBounds>,
    materials: Vec<PreparedMaterial>,
    /// Per instance: the material of each primitive, by index into `materials`.
    primitive_materials: Vec<Vec<u32>>,
    /// Some surface is cut by an alpha mask; without one, rays never ask.
    has_masks: bool,
    /// Some surface is glass.
    has_glass: bool,
    lights: Lights,
    /// Through holes, and through holes and panes, by [`Through`]; none without an environment, and no second one without glass.
    openings: Vec<Openings>,
}

/// A ray from a surface to a light.
#[derive(Clone, Copy, Debug)]
pub struct ShadowRay {
    /// From off the surface to off the light, or without end.
    pub ray: Ray,
    /// The light's own triangle, which is never in its own way: from afar the rounding of `t` exceeds the
    /// distance by which the ray ends off it.
    pub light: Option<TriangleId>,
}

/// What preparing took and holds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorldReport {
    /// Trees.
    pub accel: AccelReport,
    /// Bytes of lights, their tree, and what is known of where the environment shows.
    pub light_bytes: usize,
    /// Bytes of meshes.
    pub mesh_bytes: usize,
    /// Bytes of textures.
    pub texture_bytes: usize,
}

impl World {
    /// Prepares a scene from nothing.
    pub fn prepare(scene: Arc<Scene>) -> World {
        let accel = Accel::build(&scene);
        World::with(scene, accel)
    }

    /// Prepares the next state of a scene, taking over the trees of what `change` did not touch.
    pub fn update(&self, scene: Arc<Scene>, change: &SceneChange) -> World {
        let accel = self.accel.updated(&scene, change);
        World::with(scene, accel)
    }

    fn with(scene: Arc<Scene>, accel: Accel) -> World {
        let materials: Vec<PreparedMaterial> =
            scene.materials().keys().map(|id| PreparedMaterial::new(&scene, id)).collect();
        let index_of = |id: &Id| scene.materials().get_index_of(id).unwrap_or(0) as u32;
        let primitive_materials: Vec<Vec<u32>> = accel
            .instances()
            .iter()
            .map(|instance| {
                instance.mesh().primitives().iter().map(|primitive| index_of(&primitive.material)).collect()
            })
            .collect();
        let has_masks =
            primitive_materials.iter().flatten().any(|material| materials[*material as usize].is_masked());
        let has_glass = primitive_materials
            .iter()
            .flatten()
            .any(|material| materials[*material as usize].material().transmission > 0.0);
        let places = primitive_materials
            .iter()
            .flatten()
            .filter(|material| materials[**material as usize].emits_a_picture())
            .count();
        // Of a mesh that stands in many places once.
        let mut known_shares = HashMap::new();
        let emission_of = |instance: usize, primitive: usize| {
            let number = primitive_materials[instance][primitive];
            let material = &materials[number as usize];
            let luminance = material.emission_luminance();
            (luminance > 0.0).then(|| {
                let instance = &accel.instances()[instance];
                let mesh = instance.mesh();
                let shares = known_shares
                    .entry((std::ptr::from_ref(mesh), primitive, number))
                    .or_insert_with(|| Shares::of(material, instance, &mesh.primitives()[primitive], places))
                    .clone();
                Emission { luminance, shares, two_sided: material.material().double_sided }
            })
        };
        let lights = Lights::collect(&scene, &accel, emission_of);
        let nested_bounds = scene.nested_bounds();
        let has_sky = lights.has_environment();
        let ways = [Through::Holes, Through::HolesAndPanes];
        let looks = ways.into_iter().filter(|through| has_sky && (has_glass || *through == Through::Holes));
        let openings = looks
            .filter_map(|through| Openings::of(&scene, nested_bounds.as_ref(), &accel, through))
            .collect();
        World {
            scene,
            accel,
            nested_bounds,
            materials,
            primitive_materials,
            has_masks,
            has_glass,
            lights,
            openings,
        }
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// See [`Scene::nested_bounds`].
    pub fn nested_bounds(&self) -> Option<&NestedBounds> {
        self.nested_bounds.as_ref()
    }

    /// Where the environment shows about `p` from a surface that faces `n`; `None` where there is none, where it shows nowhere, or where so
    /// much of it does that to know more would not help. Whoever asks first of a place sends the rays that tell it: 400 for each of three
    /// cubes around it at most, and 1,200 for what is around these.
    ///
    /// - `through`: what the sky counts as shown through
    pub fn opening_at(&self, p: Vec3, n: Vec3, through: Through) -> Option<&Opening> {
        // Without glass there is but one.
        let openings = self.openings.get(through as usize).or(self.openings.first());
        openings?.at(self, p, n)
    }

    /// Every part is of the material of the same number.
    pub(in crate::transport) fn is_made_like(&self, other: &World) -> bool {
        self.primitive_materials == other.primitive_materials
    }

    /// The trees.
    pub fn accel(&self) -> &Accel {
        &self.accel
    }

    /// The lights.
    pub fn lights(&self) -> &Lights {
        &self.lights
    }

    /// What preparing took and holds.
    pub fn report(&self) -> WorldReport {
        WorldReport {
            accel: self.accel.report(),
            light_bytes: self.lights.bytes() + self.openings.iter().map(Openings::bytes).sum::<usize>(),
            mesh_bytes: self.mesh_bytes(),
            texture_bytes: self.texture_bytes(),
        }
    }

    /// Bytes of meshes, of what places them and of textures, about: what is packed for a card grows with them.
    pub fn surface_bytes(&self) -> usize {
        self.mesh_bytes() + self.texture_bytes() + self.accel.instances().len() * size_of::<Instance>()
    }

    fn mesh_bytes(&self) -> usize {
        self.scene.meshes().values().map(|mesh| mesh.bytes()).sum()
    }

    fn texture_bytes(&self) -> usize {
        self.scene.textures().values().map(|texture| texture.bytes()).sum()
    }

    /// Every material, by the index that [`World::materials_of`] gives.
    pub(in crate::transport) fn materials(&self) -> &[PreparedMaterial] {
        &self.materials
    }

    /// What fills bodies of glass of a material, by its place among the scene's; `None` where that absorbs nothing, and there is no such.
    #[cfg(feature = "gpu")]
    pub(crate) fn absorption_in(&self, material: usize) -> Option<Absorption> {
        self.materials.get(material)?.absorption()
    }

    /// The material of each primitive of an instance.
    pub(in crate::transport) fn materials_of(&self, instance: usize) -> &[u32] {
        &self.primitive_materials[instance]
    }

    pub(in crate::transport) fn material_of(&self, hit: &Hit) -> &PreparedMaterial {
        &self.materials[self.primitive_materials[hit.instance as usize][self.primitive_of(hit)] as usize]
    }

    /// Index of the primitive that was met, in its mesh.
    pub fn primitive_of(&self, hit: &Hit) -> usize {
        let primitives = self.accel.instances()[hit.instance as usize].mesh().primitives();
        primitives.partition_point(|primitive| primitive.first_triangle <= hit.triangle) - 1
    }

    /// Indices of the primitives of an instance that may reflect or refract light in a direction.
    pub fn specular_primitives(&self, instance: u32) -> Vec<usize> {
        self.primitives_where(instance, |material| material.material().is_specular())
    }

    /// Of these, those that may be perfect mirrors or clear glass.
    pub fn smooth_primitives(&self, instance: u32) -> Vec<usize> {
        self.primitives_where(instance, PreparedMaterial::may_be_smooth)
    }

    /// Share of the light that falls on specular primitives which they send on by lobes that are not diffuse, about: that of the most
    /// specular one. 1 where any may focus light.
    pub fn sent_on_share(&self) -> f32 {
        let placed = self.primitive_materials.iter().flatten().map(|index| &self.materials[*index as usize]);
        let specular = placed.filter(|material| material.material().is_specular());
        specular.map(PreparedMaterial::sent_on_share).fold(0.0, f32::max)
    }

    fn primitives_where(&self, instance: u32, is_so: impl Fn(&PreparedMaterial) -> bool) -> Vec<usize> {
        let materials = self.primitive_materials[instance as usize].iter().enumerate();
        materials
            .filter(|(_, index)| is_so(&self.materials[**index as usize]))
            .map(|(place, _)| place)
            .collect()
    }

    /// Some surface may let light through.
    pub fn has_glass(&self) -> bool {
        self.has_glass
    }

    fn is_present(&self, hit: &Hit) -> bool {
        self.material_of(hit).is_present(&self.accel.instances()[hit.instance as usize], hit)
    }

    /// Nearest surface along the ray; masks are honoured.
    pub fn closest_hit(&self, ray: &Ray) -> Option<Hit> {
        if self.has_masks {
            self.accel.closest_hit(ray, |hit| self.is_present(hit))
        } else {
            self.accel.closest_hit(ray, |_| true)
        }
    }

    /// [`World::closest_hit`] of every ray; fast where rays that follow each other start together and go the same way.
    pub fn closest_hits(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        if self.has_masks {
            self.accel.closest_hits(rays, hits, |hit| self.is_present(hit));
        } else {
            self.accel.closest_hits(rays, hits, |_| true);
        }
    }

    /// True when anything stands between a surface and its light; masks are honoured.
    pub fn is_occluded(&self, shadow: &ShadowRay) -> bool {
        let ShadowRay { ray, light } = shadow;
        let in_the_way = |hit: &Hit| *light != Some(hit.triangle_id());
        if self.has_masks {
            self.accel.is_occluded(ray, |hit| in_the_way(hit) && self.is_present(hit))
        } else {
            self.accel.is_occluded(ray, in_the_way)
        }
    }

    /// The surface at `hit`, met along the unit direction `direction`.
    pub fn surface(&self, hit: &Hit, direction: Vec3) -> Surface {
        self.material_of(hit).surface(&self.accel.instances()[hit.instance as usize], hit, direction)
    }

    /// Radiance from outside the scene, W/(m² sr).
    pub fn environment_radiance(&self, wi: Vec3) -> Rgb {
        self.lights
            .environment()
            .map_or(Rgb::BLACK, |environment: &EnvironmentLight| environment.radiance(wi))
    }

    /// Radiance of a light sample at the surface it was drawn for, before occlusion, and the ray that tests it.
    pub fn towards_light(
        &self,
        from: &SurfacePoint,
        sample: &super::LightSample,
    ) -> Option<(Rgb, ShadowRay)> {
        let endless = from.ray_towards(sample.wi);
        let (radiance, target, room_m, light) = match sample.origin {
            LightOrigin::Infinite => {
                return Some((sample.radiance, ShadowRay { ray: endless, light: None }));
            }
            LightOrigin::Point(position) => (sample.radiance, position, room_at_point(position), None),
            LightOrigin::Surface { instance, triangle, barycentric, point } => {
                let hit = Hit { t: 0.0, instance, triangle, b1: barycentric[0], b2: barycentric[1] };
                let placed = &self.accel.instances()[instance as usize];
                let material = self.material_of(&hit);
                let from_front = sample.wi.dot(point.n_geo) < 0.0;
                if !material.is_present(placed, &hit) {
                    return None;
                }
                let radiance = material.emitted(placed, &hit, from_front);
                (radiance, point.origin_towards(-sample.wi), 0.0, Some(TriangleId { instance, triangle }))
            }
        };
        let direction = target - endless.origin;
        let t_max = if room_m > 0.0 { 1.0 - room_m / direction.length() } else { 1.0 };
        let ray = Ray { direction, t_max, ..endless };
        (!radiance.is_black()).then_some((radiance, ShadowRay { ray, light }))
    }
}
