//! The one way into a [`Scene`]: every value from a file or an edit is checked here, once (`check.rs`, `mesh_check.rs`).
//!
//! A builder starts empty or from an existing scene; each method either makes its change or leaves the
//! scene as it was and says why. Dropping the builder drops the changes, which makes batches atomic.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use indexmap::{IndexMap, IndexSet};

use super::{
    Camera, Environment, Id, Light, LightKind, Material, Mesh, MeshSource, Node, Primitive, Projection,
    Scene, SceneChange, SceneError, SceneLimits, Texels, Texture, TextureSlot, Warning,
    check::{
        bad, check_light, check_light_colour, check_material, check_transform, over_limit, refuse_duplicate,
    },
    mesh_check,
};

/// How far a squared length may be from 1 for a direction to have unit length: some roundings.
const UNIT_SLACK: f64 = 1e-14;

/// Builds or changes a scene; see the module's head.
#[derive(Debug)]
pub struct SceneBuilder {
    scene: Scene,
    change: SceneChange,
    limits: SceneLimits,
    vertices: u64,
    triangles: u64,
    texels: u64,
    /// Triangles that send out light, over all instances.
    emissive_triangles: u64,
}

impl SceneBuilder {
    /// An empty scene.
    pub fn new(limits: SceneLimits) -> SceneBuilder {
        SceneBuilder::from_scene(&Scene::default(), limits)
    }

    /// A scene to be changed; the original stays as it is.
    pub fn from_scene(scene: &Scene, limits: SceneLimits) -> SceneBuilder {
        SceneBuilder {
            vertices: scene.meshes.values().map(|mesh| mesh.positions.len() as u64).sum(),
            triangles: scene.meshes.values().map(|mesh| mesh.triangles.len() as u64).sum(),
            texels: scene.textures.values().map(|texture| texture.texel_count() as u64).sum(),
            emissive_triangles: emissive_triangles(scene),
            scene: without_last_line(scene.clone()),
            change: SceneChange::default(),
            limits,
        }
    }

    /// The scene as changed so far.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The limits it checks.
    pub fn limits(&self) -> &SceneLimits {
        &self.limits
    }

    /// The changed scene and what was touched.
    pub fn finish(mut self) -> (Scene, SceneChange) {
        if self.scene.warnings_left_out > 0 {
            let message = format!("{} more warnings were left out", self.scene.warnings_left_out);
            self.scene.warnings.push(Warning { object: "scene".into(), message });
        }
        (self.scene, self.change)
    }

    /// Notes something odd but usable. Beyond the limit only a count is kept, over all builders of a scene.
    pub fn warn(&mut self, object: impl Into<String>, message: impl Into<String>) {
        if self.scene.warnings.len() < self.limits.warnings_max {
            self.scene.warnings.push(Warning { object: object.into(), message: message.into() });
        } else {
            self.scene.warnings_left_out += 1;
        }
    }

    /// Adds an image under a new id.
    pub fn add_texture(&mut self, id: Id, texture: Texture) -> Result<(), SceneError> {
        refuse_duplicate("texture", &self.scene.textures, &id)?;
        let expected = u64::from(texture.width) * u64::from(texture.height);
        if expected == 0 || texture.texel_count() as u64 != expected {
            let value = format!("{} texels for {}×{}", texture.texel_count(), texture.width, texture.height);
            return Err(bad("texture", &id, "texels", value, "width × height texels, at least one"));
        }
        if let Texels::Rgba32F(texels) = &texture.texels {
            let is_radiance = |texel: &[f32; 4]| texel.iter().all(|value| value.is_finite() && *value >= 0.0);
            if let Some(texel) = texels.iter().find(|texel| !is_radiance(texel)) {
                return Err(bad("texture", &id, "texels", format!("{texel:?}"), "finite and not negative"));
            }
        }
        over_limit("texture", &id, "texels", self.texels + expected, self.limits.texels_max)?;
        self.texels += expected;
        self.scene.textures.insert(id, Arc::new(texture));
        Ok(())
    }

    /// Adds a material or replaces the one of that id.
    pub fn set_material(&mut self, id: Id, material: Material) -> Result<(), SceneError> {
        check_material(&id, &material)?;
        for (slot, texture) in TextureSlot::ALL.iter().zip(&material.textures) {
            let Some(texture) = texture else { continue };
            let Some(image) = self.scene.textures.get(&texture.texture) else {
                return Err(SceneError::unknown(
                    "texture",
                    "texture",
                    texture.texture.as_str(),
                    self.scene.textures.keys(),
                ));
            };
            if slot.is_colour()
                && matches!(image.texels, Texels::Rgba32F(_))
                && *slot != TextureSlot::Emission
            {
                return Err(bad(
                    "material",
                    &id,
                    "texture",
                    "float texels".into(),
                    "8-bit texels for a share of light",
                ));
            }
        }
        if !self.scene.materials.contains_key(&id) {
            let count = self.scene.materials.len() as u64 + 1;
            over_limit("material", &id, "materials", count, self.limits.materials_max as u64)?;
        }
        let emissive = self.emissive_triangles_with(&id, material.is_emissive());
        over_limit("material", &id, "emissive triangles", emissive, self.limits.emissive_triangles_max)?;
        self.emissive_triangles = emissive;
        // What is as it was changes nothing, least of all the light.
        if self.scene.materials.get(&id).is_none_or(|before| **before != material) {
            self.change.materials.insert(id.clone());
            self.scene.materials.insert(id, Arc::new(material));
        }
        Ok(())
    }

    /// Adds a mesh under a new id. Triangles without area are left out with a warning.
    pub fn add_mesh(&mut self, id: Id, source: MeshSource) -> Result<(), SceneError> {
        refuse_duplicate("mesh", &self.scene.meshes, &id)?;
        let vertices = self.vertices + source.positions.len() as u64;
        let triangles = self.triangles + source.triangles.len() as u64;
        over_limit("mesh", &id, "vertices", vertices, self.limits.vertices_max)?;
        over_limit("mesh", &id, "triangles", triangles, self.limits.triangles_max)?;
        if let Some(primitive) =
            source.primitives.iter().find(|p| !self.scene.materials.contains_key(&p.material))
        {
            return Err(SceneError::unknown(
                "material",
                "material",
                primitive.material.as_str(),
                self.scene.materials.keys(),
            ));
        }
        let checked = mesh_check::check(&id, source, self.limits.coordinate_max_m)?;
        for warning in checked.warnings {
            self.warn(format!("mesh {id:?}"), warning);
        }
        self.vertices += checked.mesh.positions.len() as u64;
        self.triangles += checked.mesh.triangles.len() as u64;
        self.change.meshes.insert(id.clone());
        self.scene.meshes.insert(id, Arc::new(checked.mesh));
        Ok(())
    }

    /// Adds a node under a new id.
    pub fn add_node(&mut self, id: Id, node: Node) -> Result<(), SceneError> {
        refuse_duplicate("node", &self.scene.nodes, &id)?;
        over_limit("node", &id, "nodes", self.scene.nodes.len() as u64 + 1, self.limits.nodes_max as u64)?;
        check_transform("node", &id, &node.parent_from_node)?;
        self.check_parent(node.parent.as_ref())?;
        let mesh = node.mesh.as_ref().map(|mesh| (mesh, self.scene.meshes.get(mesh)));
        let emissive = match mesh {
            Some((mesh, None)) => {
                return Err(SceneError::unknown("mesh", "mesh", mesh.as_str(), self.scene.meshes.keys()));
            }
            Some((_, Some(mesh))) => emissive_triangles_of(&self.scene, mesh),
            None => 0,
        };
        let emissive = self.emissive_triangles + emissive;
        over_limit("node", &id, "emissive triangles", emissive, self.limits.emissive_triangles_max)?;
        let depth = 1 + self.depth_of(node.parent.as_ref());
        over_limit("node", &id, "levels of nodes", depth, self.limits.node_depth_max as u64)?;
        self.scene.nodes.insert(id.clone(), node);
        if let Err(error) = self.check_placed(&id) {
            self.scene.nodes.pop();
            return Err(error);
        }
        self.emissive_triangles = emissive;
        self.change.nodes.insert(id);
        Ok(())
    }

    /// Removes a node with everything below it: nodes, lights, cameras.
    ///
    /// A mesh goes with its last node, a material with its last mesh, a texture with its last material,
    /// so that adding and removing things for hours does not fill the scene.
    pub fn remove_node(&mut self, id: &str) -> Result<(), SceneError> {
        let Some((id, _)) = self.scene.nodes.get_key_value(id) else {
            return Err(SceneError::unknown("node", "node", id, self.scene.nodes.keys()));
        };
        let removed = self.with_descendants(&id.clone());
        self.touch_mounted(&removed);
        let mut orphans = IndexSet::new();
        for mesh in removed.iter().filter_map(|node| self.scene.nodes.get(node)?.mesh.as_ref()) {
            let emissive =
                self.scene.meshes.get(mesh).map_or(0, |mesh| emissive_triangles_of(&self.scene, mesh));
            self.emissive_triangles -= emissive;
            orphans.insert(mesh.clone());
        }
        // One pass over all: taking out node by node would move the rest each time (90,000 nodes: 41 s).
        self.scene.nodes.retain(|id, _| !removed.contains(id));
        let on_removed = |parent: &Option<Id>| parent.as_ref().is_some_and(|parent| removed.contains(parent));
        self.scene.lights.retain(|_, light| !on_removed(&light.parent));
        self.scene.cameras.retain(|_, camera| !on_removed(&camera.parent));
        self.change.nodes.extend(removed);
        self.drop_unused_meshes(orphans);
        Ok(())
    }

    /// Replaces a node's transform to its parent.
    pub fn set_transform(&mut self, id: &str, parent_from_node: DAffine3) -> Result<(), SceneError> {
        let Some((id, node)) = self.scene.nodes.get_key_value(id) else {
            return Err(SceneError::unknown("node", "node", id, self.scene.nodes.keys()));
        };
        let (id, before) = (id.clone(), node.parent_from_node);
        check_transform("node", &id, &parent_from_node)?;
        if parent_from_node == before {
            return Ok(());
        }
        self.scene.nodes[&id].parent_from_node = parent_from_node;
        let moved = self.with_descendants(&id);
        let refused = moved.iter().find_map(|node| self.check_placed(node).err());
        if let Some(error) = refused.or_else(|| self.check_lights_on(&moved).err()) {
            self.scene.nodes[&id].parent_from_node = before;
            return Err(error);
        }
        self.touch_mounted(&moved);
        self.change.nodes.extend(moved);
        Ok(())
    }

    /// Adds a punctual light under a new id.
    pub fn add_light(&mut self, id: Id, light: Light) -> Result<(), SceneError> {
        refuse_duplicate("light", &self.scene.lights, &id)?;
        over_limit(
            "light",
            &id,
            "lights",
            self.scene.lights.len() as u64 + 1,
            self.limits.lights_max as u64,
        )?;
        self.place_light(id, light)
    }

    /// Replaces a punctual light.
    pub fn set_light(&mut self, id: &str, light: Light) -> Result<(), SceneError> {
        let Some((id, _)) = self.scene.lights.get_key_value(id) else {
            return Err(SceneError::unknown("light", "light", id, self.scene.lights.keys()));
        };
        self.place_light(id.clone(), light)
    }

    /// Removes a punctual light.
    pub fn remove_light(&mut self, id: &str) -> Result<(), SceneError> {
        let Some((id, _)) = self.scene.lights.shift_remove_entry(id) else {
            return Err(SceneError::unknown("light", "light", id, self.scene.lights.keys()));
        };
        self.change.lights.insert(id);
        Ok(())
    }

    /// Adds a camera or replaces the one of that id.
    pub fn set_camera(&mut self, id: Id, camera: Camera) -> Result<(), SceneError> {
        self.check_parent(camera.parent.as_ref())?;
        check_transform("camera", &id, &camera.parent_from_camera)?;
        match camera.projection {
            Projection::Perspective { yfov_rad }
                if !(yfov_rad > 1e-6 && yfov_rad < std::f64::consts::PI - 1e-6) =>
            {
                return Err(bad("camera", &id, "yfov_rad", yfov_rad.to_string(), "between 0 and π"));
            }
            Projection::Orthographic { half_height_m }
                if !(half_height_m > 0.0 && half_height_m.is_finite()) =>
            {
                return Err(bad("camera", &id, "half_height_m", half_height_m.to_string(), "above 0"));
            }
            _ => {}
        }
        if let Some(aspect) = camera.aspect
            && !(aspect > 1e-3 && aspect < 1e3)
        {
            return Err(bad("camera", &id, "aspect", aspect.to_string(), "between 0.001 and 1000"));
        }
        if !self.scene.cameras.contains_key(&id) {
            let count = self.scene.cameras.len() as u64 + 1;
            over_limit("camera", &id, "cameras", count, self.limits.cameras_max as u64)?;
        }
        self.change.cameras.insert(id.clone());
        self.scene.cameras.insert(id, camera);
        Ok(())
    }

    /// Removes a camera.
    pub fn remove_camera(&mut self, id: &str) -> Result<(), SceneError> {
        let Some((id, _)) = self.scene.cameras.shift_remove_entry(id) else {
            return Err(SceneError::unknown("camera", "camera", id, self.scene.cameras.keys()));
        };
        self.change.cameras.insert(id);
        Ok(())
    }

    /// Replaces the environment; an image that nothing else uses any more goes.
    pub fn set_environment(&mut self, environment: Environment) -> Result<(), SceneError> {
        match &environment {
            Environment::None => {}
            Environment::Constant(radiance) => {
                check_light_colour("environment", "environment", "radiance", *radiance)?
            }
            Environment::Image { texture, scale, rotation_rad } => {
                check_light_colour("environment", "environment", "scale", *scale)?;
                if !rotation_rad.is_finite() {
                    let value = rotation_rad.to_string();
                    return Err(bad("environment", "environment", "rotation_rad", value, "finite"));
                }
                match self.scene.textures.get(texture).map(|texture| &texture.texels) {
                    None => {
                        return Err(SceneError::unknown(
                            "texture",
                            "image",
                            texture.as_str(),
                            self.scene.textures.keys(),
                        ));
                    }
                    Some(Texels::Rgba8(_)) => {
                        let value = "8-bit texels".to_string();
                        return Err(bad("environment", "environment", "image", value, "float texels"));
                    }
                    Some(Texels::Rgba32F(_)) => {}
                }
            }
        }
        if self.scene.environment == environment {
            return Ok(());
        }
        let before = std::mem::replace(&mut self.scene.environment, environment);
        if let Environment::Image { texture, .. } = before {
            self.drop_unused_textures([texture].into_iter().collect());
        }
        self.change.environment = true;
        Ok(())
    }

    fn place_light(&mut self, id: Id, mut light: Light) -> Result<(), SceneError> {
        self.check_parent(light.parent.as_ref())?;
        check_light(&id, &light, self.limits.coordinate_max_m)?;
        self.check_light_placed(&id, &light)?;
        // Unit length is part of the type's promise; `check_light` has seen that it is possible.
        // What has it stays as it is to the last bit, so that what is set again is the same.
        if (light.direction.length_squared() - 1.0).abs() > UNIT_SLACK {
            light.direction = light.direction.normalize_or(DVec3::NEG_Z);
        }
        if self.scene.lights.get(&id) != Some(&light) {
            self.change.lights.insert(id.clone());
            self.scene.lights.insert(id, light);
        }
        Ok(())
    }

    fn check_lights_on(&self, nodes: &IndexSet<Id>) -> Result<(), SceneError> {
        let is_on = |light: &Light| light.parent.as_ref().is_some_and(|parent| nodes.contains(parent));
        let mut lights = self.scene.lights.iter().filter(|(_, light)| is_on(light));
        lights.try_for_each(|(id, light)| self.check_light_placed(id, light))
    }

    /// A node's scale must not carry a light out of reach: from 1e19 m on, squared distances leave single precision, and
    /// such a light would blind the choice among all others.
    fn check_light_placed(&self, id: &Id, light: &Light) -> Result<(), SceneError> {
        let position = self.scene.world_from_node(light.parent.as_ref()).transform_point3(light.position);
        let reach = position.abs().max_element();
        let has_place = !matches!(light.kind, LightKind::Directional { .. });
        if has_place && !(position.is_finite() && reach <= self.limits.coordinate_max_m) {
            let value = format!("{reach:e} m from the origin");
            return Err(bad("light", id, "position", value, "within the coordinate limit"));
        }
        Ok(())
    }

    fn check_parent(&self, parent: Option<&Id>) -> Result<(), SceneError> {
        match parent {
            Some(parent) if !self.scene.nodes.contains_key(parent) => {
                Err(SceneError::unknown("node", "parent", parent.as_str(), self.scene.nodes.keys()))
            }
            _ => Ok(()),
        }
    }

    fn depth_of<'a>(&'a self, mut node: Option<&'a Id>) -> u64 {
        let mut depth = 0;
        while let Some(id) = node {
            depth += 1;
            node = self.scene.nodes.get(id).and_then(|node| node.parent.as_ref());
        }
        depth
    }

    /// The composed transform must be as sound as each single one, and its mesh must stay within reach.
    fn check_placed(&self, id: &Id) -> Result<(), SceneError> {
        let world_from_node = self.scene.world_from_node(Some(id));
        check_transform("node", id, &world_from_node)?;
        let reach = match self.scene.nodes.get(id).and_then(|node| self.scene.meshes.get(node.mesh.as_ref()?))
        {
            Some(mesh) if !mesh.bounds.is_empty() => {
                let bounds = mesh.bounds.transformed(&world_from_node);
                bounds.min.abs().max(bounds.max.abs()).max_element()
            }
            _ => world_from_node.translation.abs().max_element(),
        };
        if reach <= self.limits.coordinate_max_m {
            return Ok(());
        }
        Err(bad(
            "node",
            id,
            "transform",
            format!("{reach:e} m from the origin"),
            "within the coordinate limit",
        ))
    }

    /// `id` and everything below it, parents before children.
    fn with_descendants(&self, id: &Id) -> IndexSet<Id> {
        let mut children: IndexMap<&Id, Vec<&Id>> = IndexMap::new();
        for (child, node) in &self.scene.nodes {
            if let Some(parent) = &node.parent {
                children.entry(parent).or_default().push(child);
            }
        }
        let mut found = IndexSet::from([id.clone()]);
        let mut at = 0;
        while let Some(parent) = found.get_index(at).cloned() {
            found.extend(children.get(&parent).into_iter().flatten().map(|child| (*child).clone()));
            at += 1;
        }
        found
    }

    /// Lights and cameras that are mounted on `nodes` change with them.
    fn touch_mounted(&mut self, nodes: &IndexSet<Id>) {
        let on = |parent: &Option<Id>| parent.as_ref().is_some_and(|parent| nodes.contains(parent));
        let lights = self.scene.lights.iter().filter(|(_, light)| on(&light.parent));
        self.change.lights.extend(lights.map(|(id, _)| id.clone()));
        let cameras = self.scene.cameras.iter().filter(|(_, camera)| on(&camera.parent));
        self.change.cameras.extend(cameras.map(|(id, _)| id.clone()));
    }

    /// Emissive triangles that there would be if the material `id` were emissive or not.
    fn emissive_triangles_with(&self, id: &Id, is_emissive: bool) -> u64 {
        let was_emissive = self.scene.materials.get(id).is_some_and(|material| material.is_emissive());
        if was_emissive == is_emissive {
            return self.emissive_triangles;
        }
        let meshes = self.scene.nodes.values().filter_map(|node| self.scene.meshes.get(node.mesh.as_ref()?));
        let runs = meshes.flat_map(|mesh| &mesh.primitives).filter(|primitive| primitive.material == *id);
        let changed: u64 = runs.map(|primitive| u64::from(primitive.triangle_count)).sum();
        if is_emissive { self.emissive_triangles + changed } else { self.emissive_triangles - changed }
    }

    fn drop_unused_meshes(&mut self, mut candidates: IndexSet<Id>) {
        for mesh in self.scene.nodes.values().filter_map(|node| node.mesh.as_ref()) {
            candidates.swap_remove(mesh);
        }
        let mut materials = IndexSet::new();
        for mesh in candidates.iter().filter_map(|id| self.scene.meshes.get(id)) {
            self.vertices -= mesh.positions.len() as u64;
            self.triangles -= mesh.triangles.len() as u64;
            materials.extend(mesh.primitives.iter().map(|primitive| primitive.material.clone()));
        }
        self.scene.meshes.retain(|id, _| !candidates.contains(id));
        self.change.meshes.extend(candidates);
        for primitive in self.scene.meshes.values().flat_map(|mesh| &mesh.primitives) {
            materials.swap_remove(&primitive.material);
        }
        let mut textures = IndexSet::new();
        for material in materials.iter().filter_map(|id| self.scene.materials.get(id)) {
            textures.extend(material.textures.iter().flatten().map(|texture| texture.texture.clone()));
        }
        self.scene.materials.retain(|id, _| !materials.contains(id));
        self.change.materials.extend(materials);
        self.drop_unused_textures(textures);
    }

    fn drop_unused_textures(&mut self, mut candidates: IndexSet<Id>) {
        for texture in self.scene.materials.values().flat_map(|material| material.textures.iter().flatten()) {
            candidates.swap_remove(&texture.texture);
        }
        if let Environment::Image { texture, .. } = &self.scene.environment {
            candidates.swap_remove(texture);
        }
        for texture in candidates.iter().filter_map(|id| self.scene.textures.get(id)) {
            self.texels -= texture.texel_count() as u64;
        }
        self.scene.textures.retain(|id, _| !candidates.contains(id));
    }
}

/// Triangles of one mesh that send out light.
fn emissive_triangles_of(scene: &Scene, mesh: &Mesh) -> u64 {
    let emits = |primitive: &&Primitive| {
        scene.materials.get(&primitive.material).is_some_and(|material| material.is_emissive())
    };
    mesh.primitives.iter().filter(emits).map(|primitive| u64::from(primitive.triangle_count)).sum()
}

/// Triangles that send out light, over all instances.
fn emissive_triangles(scene: &Scene) -> u64 {
    let of_mesh: Vec<u64> = scene.meshes.values().map(|mesh| emissive_triangles_of(scene, mesh)).collect();
    let meshes = scene.nodes.values().filter_map(|node| scene.meshes.get_index_of(node.mesh.as_ref()?));
    meshes.map(|mesh| of_mesh[mesh]).sum()
}

/// Takes the line back that counts what was left out; the builder writes it again when it is done.
fn without_last_line(mut scene: Scene) -> Scene {
    if scene.warnings_left_out > 0 {
        scene.warnings.pop();
    }
    scene
}
