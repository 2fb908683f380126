//! glTF 2.0 → scene builder.
//!
//! `container` and `document` take the file apart, `uris` and `buffers` give bytes, `accessors` numbers;
//! `textures`, `materials`, `meshes` and `nodes` make engine objects of them. Nothing here recurses with the
//! file's depth, and nothing allocates by a number from the file that is not checked first.

mod accessors;
mod buffers;
mod container;
mod document;
pub(in crate::assets) mod extras;
mod materials;
mod meshes;
mod nodes;
mod textures;
mod uris;

use ::gltf::json::Node as JsonNode;
use glam::DAffine3;
use lumicast_engine::scene::{Environment, Id, SceneBuilder};

use self::{
    accessors::Accessors,
    buffers::Buffers,
    document::{Document, at},
    meshes::{LoadedMesh, Room},
    nodes::{Mount, Visit},
    textures::Images,
};
use super::{
    AssetLimits, GltfPlacement,
    error::{AssetError, bad},
    folder::Folder,
    names::Names,
};

pub(super) use container::looks_like_gltf;

/// Adds a file's default scene to `builder`. Returns its environment, which the caller may set.
pub(super) fn import(
    bytes: &[u8],
    mut folder: Folder,
    builder: &mut SceneBuilder,
    placement: &GltfPlacement,
    limits: &AssetLimits,
) -> Result<Option<Environment>, AssetError> {
    let parts = container::split(bytes)?;
    let document = Document::parse(parts.json, limits, builder.limits())?;
    document.warn_of_unread(builder);
    let buffers = Buffers::load(&document.root, parts.bin, &mut folder)?;
    let mut import = Import::new(&document, &buffers, builder, placement, limits);
    import.textures_and_materials(&mut folder)?;
    import.hierarchy(placement.parent.clone())?;
    import.lights_and_cameras()?;
    import.environment()
}

/// One file on its way into the scene.
struct Import<'a> {
    document: &'a Document,
    buffers: &'a Buffers<'a>,
    builder: &'a mut SceneBuilder,
    limits: &'a AssetLimits,
    textures: Names,
    material_names: Names,
    mesh_names: Names,
    node_names: Names,
    light_names: Names,
    camera_names: Names,
    /// By index in the file.
    materials: Vec<Id>,
    /// By index in the file; outer `None`: not loaded yet, inner `None`: shows nothing.
    meshes: Vec<Option<Option<Id>>>,
    default_material: Option<Id>,
    /// Nodes of the scene with what a light or camera on them needs, in the order of the walk.
    mounts: Vec<(usize, Mount)>,
}

impl<'a> Import<'a> {
    fn new(
        document: &'a Document,
        buffers: &'a Buffers<'a>,
        builder: &'a mut SceneBuilder,
        placement: &GltfPlacement,
        limits: &'a AssetLimits,
    ) -> Import<'a> {
        let names = || Names::new(placement.prefix.as_deref());
        Import {
            document,
            buffers,
            builder,
            limits,
            textures: names(),
            material_names: names(),
            mesh_names: names(),
            node_names: names(),
            light_names: names(),
            camera_names: names(),
            materials: Vec::new(),
            meshes: vec![None; document.root.meshes.len()],
            default_material: None,
            mounts: Vec::new(),
        }
    }

    /// All materials of the file, and the images that they use.
    fn textures_and_materials(&mut self, folder: &mut Folder) -> Result<(), AssetError> {
        let root = &self.document.root;
        let mut used = vec![false; root.images.len()];
        for (index, material) in root.materials.iter().enumerate() {
            for (_, info) in materials::infos(material) {
                if let Some(image) = textures::image_of(root, info.texture, &format!("material {index}"))? {
                    used[image] = true;
                }
            }
        }
        let images: Images =
            textures::load(root, &used, self.buffers, folder, self.builder, &mut self.textures, self.limits)?;
        for (index, json) in root.materials.iter().enumerate() {
            let (material, warnings) = materials::load(root, index, &images)?;
            let id =
                self.material_names.unique(&[json.name.as_deref()], &format!("material {index}"), |id| {
                    self.builder.scene().materials().contains_key(id)
                });
            self.builder.set_material(id.clone(), material)?;
            for warning in warnings {
                self.builder.warn(format!("material {id:?}"), warning);
            }
            self.materials.push(id);
        }
        Ok(())
    }

    /// Nodes of the default scene, parents before children, with all that hangs on them.
    fn hierarchy(&mut self, parent: Option<Id>) -> Result<(), AssetError> {
        let root = &self.document.root;
        let visit = |index, parent: &Option<Id>| Visit { index, parent: parent.clone() };
        let mut seen = vec![false; root.nodes.len()];
        let mut open: Vec<Visit> =
            nodes::roots(root)?.into_iter().rev().map(|index| visit(index, &parent)).collect();
        while let Some(Visit { index, parent }) = open.pop() {
            let user = || parent.as_ref().map_or("scene".into(), |parent| format!("node {parent:?}"));
            at(&root.nodes, index, user, "children")?;
            if std::mem::replace(&mut seen[index], true) {
                let problem = "name it twice or name a node above it: a node has one parent";
                return Err(bad(nodes::node_label(root, index), "children", problem));
            }
            if let Some(id) = self.node(index, parent)? {
                let id = Some(id);
                open.extend(nodes::children(&root.nodes[index]).rev().map(|child| visit(child, &id)));
            }
        }
        Ok(())
    }

    /// One node with its mesh, light and camera. `None` when nothing below it can be shown.
    fn node(&mut self, index: usize, parent: Option<Id>) -> Result<Option<Id>, AssetError> {
        let root = &self.document.root;
        let json = &root.nodes[index];
        let (parent_from_node, warning) = nodes::transform(&self.document.exact.nodes[index]);
        let fallback = format!("node {index}");
        let id = self
            .node_names
            .unique(&[json.name.as_deref()], &fallback, |id| self.builder.scene().nodes().contains_key(id));
        if let Some(warning) = warning {
            self.builder.warn(format!("node {id:?}"), warning);
        }
        if !parent_from_node.is_finite() {
            return Err(bad(nodes::node_label(root, index), "transform", "is not finite"));
        }
        if !nodes::is_showable(self.builder, parent.as_ref(), &parent_from_node) {
            let message =
                "is flattened (or stretched beyond use) by its scale and is left out with all below it";
            self.builder.warn(format!("node {id:?}"), message);
            return Ok(None);
        }
        let is_carrier = json.mesh.is_none()
            && json.children.is_none()
            && extras::ours::<extras::NodeExtras>(&json.extras).is_some_and(|extras| extras.carrier);
        if is_carrier {
            self.mounts.push((index, Mount { parent, parent_from_mount: parent_from_node }));
            return Ok(None);
        }
        let mesh = match json.mesh {
            Some(mesh) => self.mesh(mesh.value(), index)?,
            None => None,
        };
        nodes::add(self.builder, id.clone(), parent, parent_from_node, mesh)?;
        let mount = Mount { parent: Some(id.clone()), parent_from_mount: DAffine3::IDENTITY };
        self.mounts.push((index, mount));
        Ok(Some(id))
    }

    /// Lights and cameras in the order of the file's own lists, so that its first camera comes first.
    fn lights_and_cameras(&mut self) -> Result<(), AssetError> {
        let nodes = &self.document.root.nodes;
        let mounts = std::mem::take(&mut self.mounts);
        let light_of = |node: &JsonNode| {
            let extensions = node.extensions.as_ref()?;
            Some(extensions.khr_lights_punctual.as_ref()?.light.value())
        };
        let in_order = |index_of: &dyn Fn(&JsonNode) -> Option<usize>| {
            let used = |mount: &(usize, Mount)| Some((index_of(&nodes[mount.0])?, mount.clone()));
            let mut used: Vec<(usize, (usize, Mount))> = mounts.iter().filter_map(used).collect();
            used.sort_by_key(|(index, _)| *index);
            used
        };
        for (light, (node, mount)) in in_order(&light_of) {
            self.light(light, node, mount)?;
        }
        for (camera, (node, mount)) in in_order(&|node| node.camera.map(|camera| camera.value())) {
            self.camera(camera, node, mount)?;
        }
        Ok(())
    }

    fn light(&mut self, index: usize, node_index: usize, mount: Mount) -> Result<(), AssetError> {
        let root = &self.document.root;
        let user = nodes::node_label(root, node_index);
        let loaded = nodes::light(root, index, &user, mount)?;
        let node_name = root.nodes[node_index].name.as_deref();
        let id = self.light_names.unique(&[loaded.name, node_name], &format!("light {node_index}"), |id| {
            self.builder.scene().lights().contains_key(id)
        });
        for warning in loaded.warnings {
            self.builder.warn(format!("light {id:?}"), warning);
        }
        Ok(self.builder.add_light(id, loaded.light)?)
    }

    fn camera(&mut self, index: usize, node_index: usize, mount: Mount) -> Result<(), AssetError> {
        let root = &self.document.root;
        let user = nodes::node_label(root, node_index);
        let (camera, warning) = nodes::camera(self.document, index, &user, mount)?;
        // People place cameras by their nodes; several nodes may share one lens.
        let node_name = root.nodes[node_index].name.as_deref();
        let own_name = root.cameras.get(index).and_then(|camera| camera.name.as_deref());
        let id = self.camera_names.unique(&[node_name, own_name], &format!("camera {node_index}"), |id| {
            self.builder.scene().cameras().contains_key(id)
        });
        if let Some(warning) = warning {
            self.builder.warn(format!("camera {id:?}"), warning);
        }
        Ok(self.builder.set_camera(id, camera)?)
    }

    /// The engine mesh of a file's mesh, made at its first use; `None` when it shows nothing.
    fn mesh(&mut self, index: usize, node_index: usize) -> Result<Option<Id>, AssetError> {
        let root = &self.document.root;
        let json = at(&root.meshes, index, || nodes::node_label(root, node_index), "mesh")?;
        if let Some(loaded) = &self.meshes[index] {
            return Ok(loaded.clone());
        }
        let scene = self.builder.scene();
        let used = |count: fn(&lumicast_engine::scene::Mesh) -> usize| {
            scene.meshes().values().map(|mesh| count(mesh) as u64).sum::<u64>()
        };
        let limits = self.builder.limits();
        let room = Room {
            vertices_used: used(|mesh| mesh.positions().len()),
            vertices_max: limits.vertices_max,
            triangles_used: used(|mesh| mesh.triangles().len()),
            triangles_max: limits.triangles_max,
        };
        let accessors = Accessors {
            accessors: &root.accessors,
            buffers: self.buffers,
            elements_max: self.limits.accessor_elements_max,
        };
        let user = self.document.mesh_label(index);
        let mut loaded = meshes::load(&json.primitives, &user, &accessors, room, |material| {
            self.material(material, &user)
        })?;
        meshes::clamp_colors(&mut loaded);
        self.warn_of_missing_texcoords(&mut loaded);
        let node_name = root.nodes[node_index].name.as_deref();
        let id = self.mesh_names.unique(&[json.name.as_deref(), node_name], &format!("mesh {index}"), |id| {
            self.builder.scene().meshes().contains_key(id)
        });
        for warning in loaded.warnings {
            self.builder.warn(format!("mesh {id:?}"), warning);
        }
        let shows = !loaded.source.primitives.is_empty();
        if shows {
            self.builder.add_mesh(id.clone(), loaded.source)?;
        }
        self.meshes[index] = Some(shows.then_some(id));
        Ok(self.meshes[index].clone().flatten())
    }

    /// A texture over a mesh without coordinates shows one texel everywhere: most likely a mistake of the exporter.
    fn warn_of_missing_texcoords(&self, loaded: &mut LoadedMesh) {
        let missing = loaded.source.primitives.iter().find_map(|primitive| {
            let material = self.builder.scene().materials().get(&primitive.material)?;
            let mut sets = material.textures.iter().flatten().map(|texture| texture.texcoord_set);
            let set = sets.find(|set| loaded.source.texcoords[usize::from(*set)].is_empty())?;
            Some(format!(
                "has no TEXCOORD_{set}, which material {:?} needs for a texture",
                primitive.material
            ))
        });
        loaded.warnings.extend(missing);
    }

    /// The engine material of a primitive; glTF's default one is made when a primitive first needs it.
    fn material(&mut self, index: Option<usize>, user: &str) -> Result<Id, AssetError> {
        if let Some(index) = index {
            return at(&self.materials, index, || user.into(), "material").cloned();
        }
        if let Some(id) = &self.default_material {
            return Ok(id.clone());
        }
        let taken = |id: &Id| self.builder.scene().materials().contains_key(id);
        let id = self.material_names.unique(&[], "default", taken);
        self.builder.set_material(id.clone(), materials::default_material())?;
        self.default_material = Some(id.clone());
        Ok(id)
    }

    fn environment(&mut self) -> Result<Option<Environment>, AssetError> {
        let root = &self.document.root;
        if let Some(noted) = extras::ours::<extras::AssetExtras>(&root.asset.extras) {
            for warning in noted.warnings {
                self.builder.warn("file", warning.chars().take(200).collect::<String>());
            }
        }
        let scene = root.scenes.get(root.scene.map_or(0, |scene| scene.value()));
        let Some(scene) = scene else { return Ok(None) };
        extras::environment(&scene.extras, self.buffers, self.builder, &mut self.textures)
    }
}
