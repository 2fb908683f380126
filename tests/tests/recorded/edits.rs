//! Random edits from a seed: every kind in turn, in random order, with random values.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use lumicast_tests::Random;
use serde_json::{Value, json};

/// What an edit does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Move,
    Material,
    LampOnOrOff,
    AddLight,
    SetLight,
    RemoveLight,
    AddMeshAndNode,
    RemoveNode,
    SetCamera,
    RemoveCamera,
    Environment,
    LoadGltf,
    Matching,
    Invalid,
    Stale,
}

impl Kind {
    const ALL: [Kind; 15] = [
        Kind::Move,
        Kind::Material,
        Kind::LampOnOrOff,
        Kind::AddLight,
        Kind::SetLight,
        Kind::RemoveLight,
        Kind::AddMeshAndNode,
        Kind::RemoveNode,
        Kind::SetCamera,
        Kind::RemoveCamera,
        Kind::Environment,
        Kind::LoadGltf,
        Kind::Matching,
        Kind::Invalid,
        Kind::Stale,
    ];

    /// The status that it must be answered with.
    pub(crate) fn status(self) -> u16 {
        match self {
            Kind::Invalid => 422,
            Kind::Stale => 412,
            _ => 200,
        }
    }

    pub(crate) fn is_refused(self) -> bool {
        self.status() != 200
    }
}

/// A batch to send.
#[derive(Debug, Clone)]
pub(crate) struct Planned {
    pub(crate) kind: Kind,
    pub(crate) edits: Value,
    pub(crate) if_match: Option<u64>,
}

/// The kinds still to come, and what the accepted edits have added to the scene.
#[derive(Debug, Default)]
pub(crate) struct Deck {
    cards: Vec<Kind>,
    made: u64,
    nodes: Vec<String>,
    lights: Vec<(String, &'static str)>,
    cameras: Vec<String>,
    lamp_is_off: bool,
}

impl Deck {
    /// The next batch. Removing what is not there becomes adding it, so no card is idle.
    pub(crate) fn next(&mut self, random: &mut Random, revision: u64) -> Planned {
        if self.cards.is_empty() {
            self.cards = Kind::ALL.to_vec();
            random.shuffle(&mut self.cards);
        }
        let kind = match self.cards.pop() {
            Some(Kind::SetLight | Kind::RemoveLight) if self.lights.is_empty() => Kind::AddLight,
            Some(Kind::RemoveNode) if self.nodes.is_empty() => Kind::AddMeshAndNode,
            Some(Kind::RemoveCamera) if self.cameras.is_empty() => Kind::SetCamera,
            card => card.unwrap_or(Kind::Move),
        };
        self.made += 1;
        let if_match = match kind {
            Kind::Matching => Some(revision),
            // Both sides of the present revision are wrong.
            Kind::Stale if random.below(2) == 0 => Some(revision + 1),
            Kind::Stale => Some(revision - 1),
            _ => None,
        };
        Planned { kind, edits: self.batch(kind, random), if_match }
    }

    /// Takes note of what an accepted batch has changed.
    pub(crate) fn accepted(&mut self, planned: &Planned) {
        for edit in planned.edits.as_array().into_iter().flatten() {
            let name = |field: &str| edit[field].as_str().unwrap_or_default().to_string();
            match edit["op"].as_str().unwrap_or_default() {
                "add_node" => self.nodes.push(name("node")),
                "load_gltf" => self.nodes.push(format!("{}tile", name("prefix"))),
                "remove_node" => self.nodes.retain(|node| *node != name("node")),
                "add_light" => {
                    let kind =
                        ["point", "spot", "directional"].into_iter().find(|kind| edit["kind"] == **kind);
                    self.lights.push((name("light"), kind.unwrap_or("point")));
                }
                "remove_light" => self.lights.retain(|(light, _)| *light != name("light")),
                // The two that are watched stay.
                "set_camera" if !["main", "corner"].contains(&name("camera").as_str()) => {
                    self.cameras.push(name("camera"));
                }
                "remove_camera" => self.cameras.retain(|camera| *camera != name("camera")),
                "set_material" if name("material") == "lamp" => self.lamp_is_off = !self.lamp_is_off,
                _ => {}
            }
        }
    }

    fn batch(&self, kind: Kind, random: &mut Random) -> Value {
        let id = self.made;
        match kind {
            Kind::Move | Kind::Matching | Kind::Stale => json!([self.movement(random)]),
            Kind::Material => json!([material(random)]),
            Kind::LampOnOrOff => {
                let radiance = if self.lamp_is_off { [17.0, 12.5, 7.5] } else { [0.0; 3] };
                json!([{"op": "set_material", "material": "lamp", "emission": radiance}])
            }
            Kind::AddLight => json!([added_light(&format!("light-{id}"), random)]),
            Kind::SetLight => {
                let (light, kind) = random.pick(&self.lights).cloned().unwrap_or_default();
                // Sometimes off: black is a strength like any other.
                let strength = if random.below(3) == 0 { [0.0; 3] } else { colour(random, 3.0) };
                let field = if kind == "directional" { "irradiance" } else { "intensity" };
                json!([{"op": "set_light", "light": light, field: strength}])
            }
            Kind::RemoveLight => {
                let light = random.pick(&self.lights).cloned().unwrap_or_default().0;
                json!([{"op": "remove_light", "light": light}])
            }
            Kind::AddMeshAndNode => added_tile(id, random),
            Kind::RemoveNode => {
                let node = random.pick(&self.nodes).cloned().unwrap_or_default();
                json!([{"op": "remove_node", "node": node}])
            }
            Kind::SetCamera => {
                let added = format!("camera-{id}");
                let camera = random.pick(&["main", "corner", &added]).copied().unwrap_or("main");
                json!([{"op": "set_camera", "camera": camera, "yfov_rad": random.between(0.5, 0.9), "look_at": {
                    "position": within(random, [-0.6, 0.7, 2.0], [0.6, 1.5, 4.2]),
                    "target": within(random, [-0.3, 0.7, -0.3], [0.3, 1.2, 0.3]),
                }}])
            }
            Kind::RemoveCamera => {
                let camera = random.pick(&self.cameras).cloned().unwrap_or_default();
                json!([{"op": "remove_camera", "camera": camera}])
            }
            Kind::Environment => json!([environment(random)]),
            Kind::LoadGltf => {
                let data = BASE64_STANDARD.encode(glb_of_a_tile());
                json!([{"op": "load_gltf", "data": data, "prefix": format!("load-{id}/")}])
            }
            // A good edit first: of a batch that is refused nothing may stay.
            Kind::Invalid => json!([self.movement(random), invalid(id, random)]),
        }
    }

    fn movement(&self, random: &mut Random) -> Value {
        let nodes = ["tall block", "mirror block", "glass ball"];
        let node = random.pick(&nodes).copied().unwrap_or("tall block");
        let half_turn = random.between(0.0, std::f64::consts::PI);
        json!({"op": "set_transform", "node": node, "transform": {
            "translation": within(random, [-0.6, 0.0, -0.6], [0.6, 0.2, 0.6]),
            "rotation": [0.0, half_turn.sin(), 0.0, half_turn.cos()],
            "scale": within(random, [0.5; 3], [1.2; 3]),
        }})
    }
}

fn within(random: &mut Random, low: [f64; 3], high: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| random.between(low[axis], high[axis]))
}

fn colour(random: &mut Random, most: f64) -> [f64; 3] {
    within(random, [0.05 * most; 3], [most; 3])
}

fn material(random: &mut Random) -> Value {
    let name = random.pick(&["white", "red", "green", "mirror"]).copied().unwrap_or("white");
    match random.below(4) {
        0 => json!({"op": "set_material", "material": name, "base_color": colour(random, 0.9)}),
        1 => json!({"op": "set_material", "material": name, "metallic": random.between(0.0, 1.0),
                    "roughness": random.between(0.0, 1.0)}),
        2 => json!({"op": "set_material", "material": "glass", "ior": random.between(1.0, 2.0),
                    "attenuation_color": colour(random, 1.0), "attenuation_distance_m": random.between(0.1, 2.0)}),
        _ => json!({"op": "set_material", "material": format!("new-{}", random.below(4)), "create": true,
                    "base_color": colour(random, 0.9), "specular": random.between(0.0, 1.0)}),
    }
}

fn added_light(name: &str, random: &mut Random) -> Value {
    let position = within(random, [-0.8, 0.3, -0.8], [0.8, 1.8, 0.8]);
    let direction = within(random, [-1.0, -1.0, -1.0], [1.0, -0.2, 1.0]);
    match random.below(3) {
        0 => json!({"op": "add_light", "light": name, "kind": "point", "intensity": colour(random, 2.0),
                    "position": position}),
        1 => json!({"op": "add_light", "light": name, "kind": "spot", "intensity": colour(random, 3.0),
                    "position": position, "direction": direction, "inner_angle_rad": random.between(0.0, 0.3),
                    "outer_angle_rad": random.between(0.4, 1.2)}),
        _ => {
            json!({"op": "add_light", "light": name, "kind": "directional", "irradiance": colour(random, 3.0),
                    "direction": direction})
        }
    }
}

fn added_tile(id: u64, random: &mut Random) -> Value {
    let (mesh, node) = (format!("mesh-{id}"), format!("node-{id}"));
    json!([
        {"op": "set_material", "material": "tiles", "create": true, "base_color": colour(random, 0.9)},
        {"op": "add_mesh", "mesh": mesh, "material": "tiles",
         "positions": [[0, 0, 0], [0.3, 0, 0], [0.3, 0, -0.3], [0, 0, -0.3]], "triangles": [[0, 1, 2], [0, 2, 3]]},
        {"op": "add_node", "node": node, "mesh": mesh,
         "transform": {"translation": within(random, [-0.7, 0.1, -0.7], [0.4, 1.5, 0.7])}},
    ])
}

fn environment(random: &mut Random) -> Value {
    match random.below(3) {
        0 => json!({"op": "set_environment", "kind": "none"}),
        1 => json!({"op": "set_environment", "kind": "constant", "radiance": colour(random, 0.5)}),
        _ => {
            let texels: Vec<u8> =
                (0..8 * 4 * 3).flat_map(|_| (random.between(0.0, 1.0) as f32).to_le_bytes()).collect();
            let image = json!({"width": 8, "height": 4, "texels": BASE64_STANDARD.encode(texels)});
            json!({"op": "set_environment", "kind": "image", "image": image, "scale": random.between(0.1, 1.0),
                   "rotation_rad": random.between(0.0, 6.0)})
        }
    }
}

/// An edit that names a thing that is not there or holds a value that cannot be.
fn invalid(id: u64, random: &mut Random) -> Value {
    let cases = [
        json!({"op": "set_transform", "node": "tall block", "transform": {"scale": [1, 0, 1]}}),
        json!({"op": "set_transform", "node": "nowhere", "transform": {"translation": [0, 1, 0]}}),
        json!({"op": "set_transform", "node": "tall block", "transform": {"translation": [0, "NaN", 0]}}),
        json!({"op": "set_material", "material": "white", "base_color": [0.5, 1.5, 0.5]}),
        json!({"op": "set_material", "material": "unknown", "roughness": 0.5}),
        json!({"op": "add_mesh", "mesh": format!("bad-{id}"), "material": "white",
               "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "triangles": [[0, 1, 3]]}),
        json!({"op": "add_mesh", "mesh": format!("bad-{id}"), "material": "white",
               "positions": [[0, 0, 0], [1e39, 0, 0], [0, 1, 0]], "triangles": [[0, 1, 2]]}),
        json!({"op": "add_node", "node": "floor", "mesh": "floor"}),
        json!({"op": "remove_light", "light": "unknown"}),
        json!({"op": "remove_camera", "camera": "unknown"}),
        json!({"op": "add_light", "light": "bad", "kind": "point", "intensity": [-1, 0, 0]}),
        json!({"op": "set_camera", "camera": "bad", "yfov_rad": 4}),
        json!({"op": "set_environment", "kind": "constant", "radiance": [0, -1, 0]}),
        json!({"op": "load_gltf", "data": BASE64_STANDARD.encode(b"no glTF at all")}),
    ];
    random.pick(&cases).cloned().unwrap_or_default()
}

/// A quad as a binary glTF file.
fn glb_of_a_tile() -> Vec<u8> {
    let mut binary: Vec<u8> = Vec::new();
    for value in [0.0f32, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.2, 0.0] {
        binary.extend(value.to_le_bytes());
    }
    let mut document = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "tile", "mesh": 0, "translation": [-0.1, 0.9, 0.5]}],
        "meshes": [{"name": "tile", "primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"name": "tile", "pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.4, 0.8, 1.0]}}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                       "min": [0, 0, 0], "max": [0.2, 0.2, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": binary.len()}], "buffers": [{"byteLength": binary.len()}],
    })
    .to_string()
    .into_bytes();
    document.resize(document.len().next_multiple_of(4), b' ');
    let word = |value: usize| (value as u32).to_le_bytes();
    let bytes = 12 + 8 + document.len() + 8 + binary.len();
    [
        b"glTF".as_slice(),
        &word(2),
        &word(bytes),
        &word(document.len()),
        b"JSON",
        &document,
        &word(binary.len()),
        b"BIN\0",
        &binary,
    ]
    .concat()
}
