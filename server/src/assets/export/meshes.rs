//! Meshes → primitives over shared vertices.

use std::collections::HashMap;

use glam::Vec3;
use lumicast_engine::scene::{Id, Mesh, Scene};
use serde_json::{Map, Value, json};

use super::Output;

/// The meshes as written; one without triangles is none in glTF.
#[derive(Debug)]
pub(super) struct Written {
    pub(super) json: Vec<Value>,
    pub(super) index_of: HashMap<Id, usize>,
}

pub(super) fn write(scene: &Scene, output: &mut Output) -> Written {
    let mut written = Written { json: Vec::new(), index_of: HashMap::new() };
    for (id, mesh) in scene.meshes() {
        if mesh.triangles().is_empty() {
            continue;
        }
        let primitives = primitives(scene, mesh, output);
        written.index_of.insert(id.clone(), written.json.len());
        written.json.push(json!({ "name": id.as_str(), "primitives": primitives }));
    }
    written
}

/// A zero normal stands for the triangle's own, which glTF says by leaving normals out, a whole primitive at
/// a time. So where there is one, every primitive gets vertices of its own.
fn primitives(scene: &Scene, mesh: &Mesh, output: &mut Output) -> Vec<Value> {
    let splits = mesh.primitives().len() > 1 && mesh.normals().contains(&Vec3::ZERO);
    let all: Vec<u32> = (0..mesh.positions().len() as u32).collect();
    let shared = if splits { None } else { Some(attributes(mesh, &all, output)) };
    let mut primitives = Vec::new();
    for primitive in mesh.primitives() {
        let first = primitive.first_triangle as usize;
        let corners = mesh.triangles()[first..first + primitive.triangle_count as usize].as_flattened();
        let (attributes, indices) = match &shared {
            Some(attributes) => {
                (attributes.clone(), output.binary.indices(corners.iter().copied(), all.len()))
            }
            None => {
                let mut used = corners.to_vec();
                used.sort_unstable();
                used.dedup();
                let renumbered =
                    corners.iter().map(|corner| used.partition_point(|used| used < corner) as u32);
                (attributes(mesh, &used, output), output.binary.indices(renumbered, used.len()))
            }
        };
        let material = scene.materials().get_index_of(&primitive.material);
        primitives.push(json!({ "attributes": attributes, "indices": indices, "material": material }));
    }
    primitives
}

/// Writes the vertices `used`.
fn attributes(mesh: &Mesh, used: &[u32], output: &mut Output) -> Map<String, Value> {
    let mut attributes = Map::new();
    let mut add = |name: &str, accessor: usize| attributes.insert(name.into(), json!(accessor));
    let absolute =
        |vertex: &u32| (mesh.centre() + mesh.positions()[*vertex as usize].as_dvec3()).as_vec3().to_array();
    let positions: Vec<[f32; 3]> = used.iter().map(absolute).collect();
    add("POSITION", output.binary.positions(&positions));
    let normals = mesh.normals();
    if used.iter().any(|vertex| normals.get(*vertex as usize).is_some_and(|normal| *normal != Vec3::ZERO)) {
        add("NORMAL", output.binary.floats(used.iter().map(|vertex| normals[*vertex as usize].to_array())));
    }
    if !mesh.tangents().is_empty() {
        let tangents = mesh.tangents();
        add("TANGENT", output.binary.floats(used.iter().map(|vertex| tangents[*vertex as usize].to_array())));
    }
    for set in [0, 1] {
        let texcoords = mesh.texcoords(set);
        if !texcoords.is_empty() {
            let accessor =
                output.binary.floats(used.iter().map(|vertex| texcoords[*vertex as usize].to_array()));
            add(&format!("TEXCOORD_{set}"), accessor);
        }
    }
    if !mesh.colors().is_empty() {
        let colors = mesh.colors();
        add("COLOR_0", output.binary.floats(used.iter().map(|vertex| colors[*vertex as usize].to_array())));
    }
    attributes
}
