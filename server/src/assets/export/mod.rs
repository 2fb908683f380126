//! Scene → GLB, to be read by [`super::load_scene`] and by any glTF program.
//!
//! Read back, the scene is the same up to single precision: ids, hierarchy, instances, materials, textures,
//! lights and cameras. What glTF has no word for stands in `extras` (see `gltf::extras`): nodes that only
//! carry a light or camera, the environment, and warnings about what was lost. Lost are meshes that no node
//! shows, textures that no material uses, and all but 8 bits of a float texture on a material.

mod binary;
mod materials;
mod meshes;
mod pictures;

use std::collections::BTreeSet;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use lumicast_engine::{
    math::Rgb,
    scene::{Camera, Environment, Id, Light, LightKind, Projection, Scene, Texels},
};
use serde_json::{Map, Value, json};

use self::binary::Binary;
use super::{
    error::{AssetError, bad},
    gltf::extras::{AssetExtras, EnvironmentExtras, EnvironmentImage, NodeExtras, Ours, SceneExtras},
};

/// Writes a scene as binary glTF 2.0; see the module's head for what is kept.
pub fn export_glb(scene: &Scene) -> Result<Vec<u8>, AssetError> {
    export(scene).map_err(|error| error.in_file("export"))
}

fn export(scene: &Scene) -> Result<Vec<u8>, AssetError> {
    let mut output = Output::default();
    let pictures = pictures::write(scene, &mut output)?;
    let materials = materials::write(scene, &pictures, &mut output);
    let meshes = meshes::write(scene, &mut output);
    let mut nodes = nodes(scene, &meshes);
    let lights = mount_lights(scene, &mut nodes, &mut output);
    let cameras = mount_cameras(scene, &mut nodes);
    let environment = environment(scene, &mut output);
    let (nodes, roots) = finished_nodes(nodes);

    let mut root = Map::new();
    let mut asset = json!({ "version": "2.0", "generator": concat!("Lumicast ", env!("CARGO_PKG_VERSION")) });
    if !output.warnings.is_empty() {
        asset["extras"] =
            json!(Ours { lumicast: AssetExtras { warnings: std::mem::take(&mut output.warnings) } });
    }
    root.insert("asset".into(), asset);
    if !roots.is_empty() || environment.is_some() {
        let mut whole = json!({ "nodes": roots });
        if let Some(environment) = environment {
            whole["extras"] = json!(Ours { lumicast: SceneExtras { environment } });
        }
        root.insert("scene".into(), json!(0));
        root.insert("scenes".into(), json!([whole]));
    }
    if !lights.is_empty() {
        root.insert("extensions".into(), json!({ "KHR_lights_punctual": { "lights": lights } }));
    }
    let lists = [
        ("nodes", nodes),
        ("meshes", meshes.json),
        ("materials", materials),
        ("textures", pictures.textures),
        ("images", pictures.images),
        ("samplers", pictures.samplers),
        ("cameras", cameras),
        ("extensionsUsed", output.extensions.iter().map(|name| json!(name)).collect()),
    ];
    let filled = |list: &(&str, Vec<Value>)| !list.1.is_empty();
    root.extend(lists.into_iter().filter(filled).map(|(name, list)| (name.into(), Value::Array(list))));
    output.binary.into_glb(root)
}

/// What all parts of the export add to.
#[derive(Debug, Default)]
struct Output {
    binary: Binary,
    extensions: BTreeSet<&'static str>,
    warnings: Vec<String>,
}

/// A glTF node in the making.
#[derive(Debug)]
struct NodeInProgress {
    parent: Option<usize>,
    json: Map<String, Value>,
}

impl NodeInProgress {
    fn new(name: &Id, parent: Option<usize>, parent_from_node: &DAffine3) -> NodeInProgress {
        let mut json = Map::from_iter([("name".to_string(), json!(name.as_str()))]);
        if *parent_from_node != DAffine3::IDENTITY {
            json.insert("matrix".into(), json!(DMat4::from(*parent_from_node).to_cols_array()));
        }
        NodeInProgress { parent, json }
    }

    /// A node that stands for nothing but what it carries.
    fn carrier(name: &Id, parent: Option<usize>, parent_from_node: &DAffine3) -> NodeInProgress {
        let mut node = NodeInProgress::new(name, parent, parent_from_node);
        node.json.insert("extras".into(), json!(Ours { lumicast: NodeExtras { carrier: true } }));
        node
    }
}

/// The scene's nodes, in its order, at the same indices.
fn nodes(scene: &Scene, meshes: &meshes::Written) -> Vec<NodeInProgress> {
    let write = |(id, node): (&Id, &lumicast_engine::scene::Node)| {
        let parent = node.parent.as_ref().and_then(|parent| scene.nodes().get_index_of(parent));
        let mut written = NodeInProgress::new(id, parent, &node.parent_from_node);
        if let Some(mesh) = node.mesh.as_ref().and_then(|mesh| meshes.index_of.get(mesh)) {
            written.json.insert("mesh".into(), json!(mesh));
        }
        written
    };
    scene.nodes().iter().map(write).collect()
}

/// Adds the lists of children; gives the nodes and the indices of those without parent.
fn finished_nodes(nodes: Vec<NodeInProgress>) -> (Vec<Value>, Vec<usize>) {
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); nodes.len()];
    let mut roots = Vec::new();
    for (index, node) in nodes.iter().enumerate() {
        match node.parent {
            Some(parent) => children[parent].push(index),
            None => roots.push(index),
        }
    }
    let finish = |(node, children): (NodeInProgress, Vec<usize>)| {
        let mut json = node.json;
        if !children.is_empty() {
            json.insert("children".into(), json!(children));
        }
        Value::Object(json)
    };
    (nodes.into_iter().zip(children).map(finish).collect(), roots)
}

fn mount_lights(scene: &Scene, nodes: &mut Vec<NodeInProgress>, output: &mut Output) -> Vec<Value> {
    let mut lights = Vec::new();
    for (id, light) in scene.lights() {
        let use_of_light = json!({ "KHR_lights_punctual": { "light": lights.len() } });
        lights.push(light_json(id, light));
        let parent = light.parent.as_ref().and_then(|parent| scene.nodes().get_index_of(parent));
        let is_plain = light.position == DVec3::ZERO && light.direction == DVec3::NEG_Z;
        match parent.filter(|parent| is_plain && !nodes[*parent].json.contains_key("extensions")) {
            Some(parent) => nodes[parent].json.insert("extensions".into(), use_of_light),
            None => {
                let rotation = DQuat::from_rotation_arc(DVec3::NEG_Z, light.direction);
                let parent_from_light = DAffine3::from_rotation_translation(rotation, light.position);
                let mut carrier = NodeInProgress::carrier(id, parent, &parent_from_light);
                carrier.json.insert("extensions".into(), use_of_light);
                nodes.push(carrier);
                None
            }
        };
        output.extensions.insert("KHR_lights_punctual");
    }
    lights
}

fn light_json(id: &Id, light: &Light) -> Value {
    let (kind, strength) = match light.kind {
        LightKind::Point { intensity } => ("point", intensity),
        LightKind::Spot { intensity, .. } => ("spot", intensity),
        LightKind::Directional { irradiance } => ("directional", irradiance),
    };
    let (color, intensity) = factor_and_strength(strength);
    let mut json = json!({ "name": id.as_str(), "type": kind, "color": color, "intensity": intensity });
    if let LightKind::Spot { inner_angle_rad, outer_angle_rad, .. } = light.kind {
        json["spot"] = json!({ "innerConeAngle": inner_angle_rad, "outerConeAngle": outer_angle_rad });
    }
    json
}

/// A colour in [0, 1] and a strength whose product is `light`, exactly: the strength is a power of two.
fn factor_and_strength(light: Rgb) -> ([f32; 3], f32) {
    let strength = if light.max_component() > 1.0 { light.max_component().log2().ceil().exp2() } else { 1.0 };
    ((light / strength).map(|value| value.min(1.0)).to_array(), strength)
}

fn mount_cameras(scene: &Scene, nodes: &mut Vec<NodeInProgress>) -> Vec<Value> {
    let mut cameras = Vec::new();
    for (id, camera) in scene.cameras() {
        let parent = camera.parent.as_ref().and_then(|parent| scene.nodes().get_index_of(parent));
        // A camera is read back under its node's name.
        let is_plain = camera.parent_from_camera == DAffine3::IDENTITY && camera.parent.as_ref() == Some(id);
        let index = json!(cameras.len());
        match parent.filter(|_| is_plain) {
            Some(parent) => nodes[parent].json.insert("camera".into(), index),
            None => {
                let mut carrier = NodeInProgress::carrier(id, parent, &camera.parent_from_camera);
                carrier.json.insert("camera".into(), index);
                nodes.push(carrier);
                None
            }
        };
        cameras.push(camera_json(id, camera));
    }
    cameras
}

fn camera_json(id: &Id, camera: &Camera) -> Value {
    // glTF wants clipping planes; nothing is clipped here.
    match camera.projection {
        Projection::Perspective { yfov_rad } => {
            let mut perspective = json!({ "yfov": yfov_rad, "znear": 0.001 });
            if let Some(aspect) = camera.aspect {
                perspective["aspectRatio"] = json!(aspect);
            }
            json!({ "name": id.as_str(), "type": "perspective", "perspective": perspective })
        }
        Projection::Orthographic { half_height_m } => {
            let half_width_m = half_height_m * camera.aspect.unwrap_or(1.0);
            let orthographic =
                json!({ "xmag": half_width_m, "ymag": half_height_m, "znear": 0.0, "zfar": 1e9 });
            json!({ "name": id.as_str(), "type": "orthographic", "orthographic": orthographic })
        }
    }
}

fn environment(scene: &Scene, output: &mut Output) -> Option<EnvironmentExtras> {
    match scene.environment() {
        Environment::None => None,
        Environment::Constant(radiance) => Some(EnvironmentExtras::Constant(radiance.to_array())),
        Environment::Image { texture: id, scale, rotation_rad } => {
            let texture = scene.textures().get(id)?;
            let Texels::Rgba32F(texels) = &texture.texels else { return None };
            let bytes: Vec<u8> = texels.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
            Some(EnvironmentExtras::Image(EnvironmentImage {
                name: id.as_str().into(),
                buffer_view: output.binary.view(&bytes, None),
                width: texture.width,
                height: texture.height,
                scale: scale.to_array(),
                rotation_rad: *rotation_rad,
            }))
        }
    }
}

/// A part that could not be written.
fn failed(object: String, problem: impl Into<String>) -> AssetError {
    bad(object, "export", problem)
}
