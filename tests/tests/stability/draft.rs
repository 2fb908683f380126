//! Scenes while they can still be changed: things, lights and an eye, and one transform for all of it.

use glam::{DAffine3, DQuat, DVec3};
use lumicast_engine::math::Rgb;
use lumicast_engine::scene::{
    Camera, CameraView, Environment, Id, Light, LightKind, Material, MeshSource, Node, Scene, SceneBuilder,
    SceneLimits,
};

pub(crate) fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

/// A mesh with a material and a place of its own.
#[derive(Clone, Debug)]
pub(crate) struct Thing {
    pub(crate) name: String,
    pub(crate) material: Material,
    pub(crate) mesh: MeshSource,
    pub(crate) world_from_mesh: DAffine3,
}

/// A scene that can still be changed.
#[derive(Clone, Debug)]
pub(crate) struct Draft {
    pub(crate) things: Vec<Thing>,
    pub(crate) lights: Vec<(String, Light)>,
    pub(crate) environment: Environment,
    pub(crate) view: CameraView,
    pub(crate) placed: Similarity,
}

/// Size, turn and place of all there is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Similarity {
    pub(crate) scale: f64,
    pub(crate) turn: DQuat,
    pub(crate) offset: DVec3,
}

impl Similarity {
    pub(crate) const NONE: Similarity = Similarity { scale: 1.0, turn: DQuat::IDENTITY, offset: DVec3::ZERO };
}

impl Draft {
    /// Nothing but an eye.
    pub(crate) fn seen_from(eye: DVec3, target: DVec3, yfov_rad: f64) -> Draft {
        Draft {
            things: Vec::new(),
            lights: Vec::new(),
            environment: Environment::None,
            view: CameraView::look_at(eye, target, DVec3::Y, yfov_rad),
            placed: Similarity::NONE,
        }
    }

    /// Adds a thing; `shape` is told the id of its material.
    pub(crate) fn thing(
        &mut self,
        name: &str,
        material: Material,
        shape: impl FnOnce(&Id) -> MeshSource,
    ) -> &mut Thing {
        let name = format!("{name} {}", self.things.len());
        let mesh = shape(&id(&name));
        let at = self.things.len();
        self.things.push(Thing { name, material, mesh, world_from_mesh: DAffine3::IDENTITY });
        &mut self.things[at]
    }

    /// Adds a thing once more, in the same place.
    pub(crate) fn again(&mut self, thing: &Thing) {
        let name = format!("{} again {}", thing.name, self.things.len());
        self.things.push(Thing { name, ..thing.clone() });
    }

    /// Adds a light without size.
    pub(crate) fn light(&mut self, name: &str, position: DVec3, direction: DVec3, kind: LightKind) {
        let name = format!("{name} {}", self.lights.len());
        self.lights.push((name, Light { parent: None, position, direction, kind }));
    }

    /// All light so many times as strong.
    pub(crate) fn brighter(mut self, factor: f32) -> Draft {
        self.things.iter_mut().for_each(|thing| thing.material.emission *= factor);
        self.lights.iter_mut().for_each(|(_, light)| brighten(light, factor));
        if let Environment::Constant(radiance) = &mut self.environment {
            *radiance *= factor;
        }
        self
    }

    /// The scene, all of it under one node that puts it into its place.
    ///
    /// # Errors
    /// What the builder refuses, in its words.
    pub(crate) fn build(&self) -> Result<Scene, lumicast_engine::scene::SceneError> {
        let mut builder = SceneBuilder::new(SceneLimits::default());
        let Similarity { scale, turn, offset } = self.placed;
        let root = id("all");
        let world_from_all = DAffine3::from_scale_rotation_translation(DVec3::splat(scale), turn, offset);
        builder
            .add_node(root.clone(), Node { parent: None, parent_from_node: world_from_all, mesh: None })?;
        for thing in &self.things {
            let name = id(&thing.name);
            let attenuation_distance_m = thing.material.attenuation_distance_m * scale as f32;
            let material = Material { attenuation_distance_m, ..thing.material.clone() };
            builder.set_material(name.clone(), material)?;
            builder.add_mesh(name.clone(), thing.mesh.clone())?;
            let parent_from_node = thing.world_from_mesh;
            let node = Node { parent: Some(root.clone()), parent_from_node, mesh: Some(name.clone()) };
            builder.add_node(name, node)?;
        }
        for (name, light) in &self.lights {
            let mut light = Light { parent: Some(root.clone()), ..light.clone() };
            // Seen from so many times as far a lamp without size must be as many times squared as strong.
            if !matches!(light.kind, LightKind::Directional { .. }) {
                brighten(&mut light, (scale * scale) as f32);
            }
            builder.add_light(id(name), light)?;
        }
        let CameraView { world_from_camera, projection } = self.view;
        let projection = match projection {
            lumicast_engine::scene::Projection::Orthographic { half_height_m } => {
                lumicast_engine::scene::Projection::Orthographic { half_height_m: half_height_m * scale }
            }
            perspective => perspective,
        };
        let camera =
            Camera { parent: Some(root), parent_from_camera: world_from_camera, projection, aspect: None };
        builder.set_camera(id("eye"), camera)?;
        builder.set_environment(self.environment.clone())?;
        Ok(builder.finish().0)
    }
}

fn brighten(light: &mut Light, factor: f32) {
    match &mut light.kind {
        LightKind::Point { intensity } | LightKind::Spot { intensity, .. } => *intensity *= factor,
        LightKind::Directional { irradiance } => *irradiance *= factor,
    }
}

fn id(name: &str) -> Id {
    Id::sanitised(name, "thing")
}

/// Glass of that index.
pub(crate) fn glass(ior: f32) -> Material {
    Material { transmission: 1.0, roughness: 0.0, base_color: Rgb::WHITE, ior, ..Material::default() }
}

/// Metal of that roughness.
pub(crate) fn metal(albedo: f32, roughness: f32) -> Material {
    Material { base_color: Rgb::splat(albedo), metallic: 1.0, roughness, ..Material::default() }
}

/// A matt material.
pub(crate) fn matt(albedo: f32) -> Material {
    Material::lambert(Rgb::splat(albedo))
}
