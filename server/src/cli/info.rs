//! `lumicast info`: what a scene holds, what was odd about it, and which effects it calls for.

use std::{collections::BTreeSet, fmt::Write as _};

use lumicast_engine::{
    effects::EffectPlan,
    math::Rgb,
    scene::{Environment, Id, LightKind, Projection, Scene, Warning},
};
use serde::Serialize;

use super::{CliError, SceneSource, output::print_line, render::default_size};

/// Show what a scene holds, its warnings, and the effect plan with the reason for each effect.
#[derive(Clone, Debug, clap::Args)]
pub struct InfoArgs {
    /// Scene file (.glb, .gltf, .obj), builtin:cornell-box or builtin:boxes
    pub scene: SceneSource,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// List nodes, materials and lights too, by the ids that edits call them by
    #[arg(long)]
    pub ids: bool,
}

/// Prints the facts of a scene.
pub fn run(args: InfoArgs) -> Result<(), CliError> {
    let loaded = args.scene.load()?;
    let mut facts = SceneInfo::of(&args.scene.to_string(), &loaded.scene, loaded.load_seconds);
    facts.ids = args.ids.then(|| Ids::of(&loaded.scene));
    if !args.json {
        return print_line(facts.text().trim_end());
    }
    let json = serde_json::to_string_pretty(&facts).map_err(|error| CliError::System {
        doing: "writing the facts as JSON".into(),
        source: error.into(),
    })?;
    print_line(&json)
}

/// Everything that `info` says.
#[derive(Clone, Debug, Serialize)]
pub struct SceneInfo {
    scene: String,
    load_seconds: f64,
    triangles: Triangles,
    vertices: usize,
    meshes: usize,
    nodes: usize,
    materials: usize,
    textures: usize,
    texels: usize,
    lights: Lights,
    cameras: Vec<CameraInfo>,
    /// Metres, in the world; nothing for a scene without surface.
    bounds: Option<Bounds>,
    bytes: Bytes,
    effects: Vec<EffectInfo>,
    warnings: Vec<WarningInfo>,
    /// Where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    ids: Option<Ids>,
}

/// What edits can name beside cameras.
#[derive(Clone, Debug, Serialize)]
struct Ids {
    nodes: Vec<NodeInfo>,
    materials: Vec<MaterialInfo>,
    lights: Vec<LightInfo>,
}

#[derive(Clone, Debug, Serialize)]
struct MaterialInfo {
    id: String,
    /// It sends out light: what is made of it is a lamp.
    emits: bool,
}

#[derive(Clone, Debug, Serialize)]
struct NodeInfo {
    id: String,
    parent: Option<String>,
    mesh: Option<String>,
    /// Of the mesh.
    materials: Vec<String>,
}

#[derive(Clone, Debug, Serialize)]
struct LightInfo {
    id: String,
    kind: &'static str,
    parent: Option<String>,
}

#[derive(Clone, Debug, Serialize)]
struct Triangles {
    /// In meshes.
    unique: usize,
    /// Over all nodes that show them.
    instanced: u64,
}

#[derive(Clone, Debug, Serialize)]
struct Lights {
    punctual: usize,
    emissive_triangles: u64,
    environment: &'static str,
}

#[derive(Clone, Debug, Serialize)]
struct CameraInfo {
    name: String,
    projection: &'static str,
    aspect: Option<f64>,
    /// Size of a picture when none is asked for.
    default_size: [u32; 2],
}

#[derive(Clone, Debug, Serialize)]
struct Bounds {
    min: [f64; 3],
    max: [f64; 3],
}

#[derive(Clone, Debug, Serialize)]
struct Bytes {
    meshes: usize,
    textures: usize,
}

#[derive(Clone, Debug, Serialize)]
struct EffectInfo {
    name: &'static str,
    on: bool,
    reason: String,
}

#[derive(Clone, Debug, Serialize)]
struct WarningInfo {
    object: String,
    message: String,
}

impl SceneInfo {
    fn of(source: &str, scene: &Scene, load_seconds: f64) -> SceneInfo {
        let plan = EffectPlan::of(scene);
        let meshes = || scene.meshes().values();
        let textures = || scene.textures().values();
        SceneInfo {
            scene: source.into(),
            load_seconds,
            triangles: Triangles {
                unique: meshes().map(|mesh| mesh.triangles().len()).sum(),
                instanced: scene.instanced_triangle_count(),
            },
            vertices: meshes().map(|mesh| mesh.positions().len()).sum(),
            meshes: scene.meshes().len(),
            nodes: scene.nodes().len(),
            materials: scene.materials().len(),
            textures: scene.textures().len(),
            texels: textures().map(|texture| texture.texel_count()).sum(),
            lights: Lights {
                punctual: scene.lights().len(),
                emissive_triangles: plan.facts.emissive_triangles,
                environment: match scene.environment() {
                    Environment::None => "none",
                    Environment::Constant(_) => "constant",
                    Environment::Image { .. } => "image",
                },
            },
            cameras: cameras(scene),
            bounds: scene
                .bounds()
                .map(|bounds| Bounds { min: bounds.min.to_array(), max: bounds.max.to_array() }),
            bytes: Bytes {
                meshes: meshes().map(|mesh| mesh.bytes()).sum(),
                textures: textures().map(|texture| texture.bytes()).sum(),
            },
            effects: plan
                .effects
                .into_iter()
                .map(|effect| EffectInfo {
                    name: effect.kind.name(),
                    on: effect.is_on,
                    reason: effect.reason,
                })
                .collect(),
            warnings: scene
                .warnings()
                .iter()
                .cloned()
                .chain(scene.odd_glass())
                .map(|Warning { object, message }| WarningInfo { object, message })
                .collect(),
            ids: None,
        }
    }

    /// The facts as lines for people.
    fn text(&self) -> String {
        let mut text = String::new();
        let mut line = |name: &str, value: String| {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{name:<12} {value}");
        };
        line("scene", format!("{} (read in {:.2} s)", self.scene, self.load_seconds));
        let Triangles { unique, instanced } = self.triangles;
        line("triangles", format!("{unique} unique, {instanced} instanced"));
        line(
            "vertices",
            format!("{} in {} meshes, placed by {} nodes", self.vertices, self.meshes, self.nodes),
        );
        line("materials", self.materials.to_string());
        line("textures", format!("{} with {} texels", self.textures, self.texels));
        let Lights { punctual, emissive_triangles, environment } = &self.lights;
        line(
            "lights",
            format!(
                "{punctual} punctual, {emissive_triangles} emissive triangles, environment {environment}"
            ),
        );
        for camera in &self.cameras {
            let [width, height] = camera.default_size;
            line("camera", format!("{} ({}, {width}×{height})", camera.name, camera.projection));
        }
        if let Some(Bounds { min, max }) = &self.bounds {
            let metres = |p: &[f64; 3]| format!("({:.3}, {:.3}, {:.3})", p[0], p[1], p[2]);
            line("bounds", format!("{} to {} m", metres(min), metres(max)));
        }
        line("bytes", format!("{} meshes, {} textures", self.bytes.meshes, self.bytes.textures));
        for effect in &self.effects {
            let state = if effect.on { "on " } else { "off" };
            line("effect", format!("{state} {:<16} {}", effect.name, effect.reason));
        }
        for warning in &self.warnings {
            line("warning", format!("{}: {}", warning.object, warning.message));
        }
        if let Some(Ids { nodes, materials, lights }) = &self.ids {
            nodes.iter().for_each(|node| line("node", node.text()));
            materials.iter().for_each(|of| {
                line("material", format!("{}{}", of.id, if of.emits { " (sends out light)" } else { "" }));
            });
            lights.iter().for_each(|light| {
                let on = light.parent.iter().map(|parent| format!("; on {parent}")).collect::<String>();
                line("light", format!("{} ({}{on})", light.id, light.kind));
            });
        }
        text
    }
}

impl Ids {
    fn of(scene: &Scene) -> Ids {
        let name = |id: &Id| id.as_str().to_owned();
        let materials_of = |mesh: &Id| {
            let primitives = scene.meshes().get(mesh).map_or(&[][..], |mesh| mesh.primitives());
            let ids: BTreeSet<&str> =
                primitives.iter().map(|primitive| primitive.material.as_str()).collect();
            ids.into_iter().map(String::from).collect()
        };
        let nodes = scene.nodes().iter().map(|(id, node)| NodeInfo {
            id: name(id),
            parent: node.parent.as_ref().map(name),
            mesh: node.mesh.as_ref().map(name),
            materials: node.mesh.as_ref().map(materials_of).unwrap_or_default(),
        });
        let lights = scene.lights().iter().map(|(id, light)| LightInfo {
            id: name(id),
            kind: match light.kind {
                LightKind::Point { .. } => "point",
                LightKind::Spot { .. } => "spot",
                LightKind::Directional { .. } => "directional",
            },
            parent: light.parent.as_ref().map(name),
        });
        let materials = scene
            .materials()
            .iter()
            .map(|(id, material)| MaterialInfo { id: name(id), emits: material.emission != Rgb::BLACK });
        Ids { nodes: nodes.collect(), materials: materials.collect(), lights: lights.collect() }
    }
}

impl NodeInfo {
    /// Its id, what it hangs on and what it shows.
    fn text(&self) -> String {
        let mut facts: Vec<String> = self.parent.iter().map(|parent| format!("on {parent}")).collect();
        match (&self.mesh, self.materials.is_empty()) {
            (Some(mesh), true) => facts.push(format!("mesh {mesh}")),
            (Some(mesh), false) => facts.push(format!("mesh {mesh} of {}", self.materials.join(", "))),
            (None, _) => facts.push("no mesh".into()),
        }
        format!("{} ({})", self.id, facts.join("; "))
    }
}

fn cameras(scene: &Scene) -> Vec<CameraInfo> {
    scene
        .cameras()
        .iter()
        .map(|(id, camera)| {
            let size = default_size(Some(camera));
            CameraInfo {
                name: id.as_str().into(),
                projection: match camera.projection {
                    Projection::Perspective { .. } => "perspective",
                    Projection::Orthographic { .. } => "orthographic",
                },
                aspect: camera.aspect,
                default_size: [size.width(), size.height()],
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumicast_engine::scene::samples;

    /// The facts of the built-in box, in both forms.
    #[test]
    fn the_built_in_box_is_described() {
        let scene = samples::cornell_box().unwrap();
        let info = SceneInfo::of("builtin:cornell-box", &scene, 0.0);
        let json = serde_json::to_value(&info).unwrap();
        assert_eq!(json["triangles"]["instanced"], scene.instanced_triangle_count());
        assert_eq!(json["lights"]["emissive_triangles"], 2);
        assert_eq!(json["cameras"][0]["name"], "main");
        assert_eq!(json["cameras"][0]["default_size"], serde_json::json!([256, 256]));
        assert_eq!(json["effects"].as_array().unwrap().len(), 13);
        let text = info.text();
        for part in ["camera       corner (perspective, 320×180)", "effect       on  glass", "2 emissive"] {
            assert!(text.contains(part), "{part:?} is missing from\n{text}");
        }
        assert!(json.get("ids").is_none() && !text.contains("\nnode "), "{text}");
    }

    /// Whoever writes an edit finds what it can name.
    #[test]
    fn ids_are_listed_where_they_are_asked_for() {
        let scene = samples::cornell_box().unwrap();
        let info =
            SceneInfo { ids: Some(Ids::of(&scene)), ..SceneInfo::of("builtin:cornell-box", &scene, 0.0) };
        let json = serde_json::to_value(&info).unwrap();
        let listed = |kind: &str| json["ids"][kind].as_array().unwrap().len();
        assert_eq!(listed("nodes"), scene.nodes().len());
        assert_eq!([listed("materials"), listed("lights")], [scene.materials().len(), scene.lights().len()]);
        let text = info.text();
        for id in scene.nodes().keys() {
            assert!(text.contains(&format!("node         {} (mesh ", id.as_str())), "{id:?} in\n{text}");
        }
        assert!(text.contains("material     lamp (sends out light)\n"), "{text}");
        assert!(text.contains("material     red\n"), "{text}");
    }
}
