//! Edits → changes of a scene.

use super::{BadField, affine, id, projection, refuse};
use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};
use lumicast_engine::math::Rgb;
use lumicast_engine::scene::{
    Camera, CameraView, Environment, Light, LightKind, Material, MeshSource, Node, Primitive, Scene,
    SceneBuilder, SceneChange, SceneError, SceneLimits, Texels, Texture,
};
use lumicast_protocol::{
    AddLight, AddMesh, AddNode, Change, Edit, EnvironmentImage, LightSource, LoadGltf, MaterialProperties,
    Placement, Problem, ProblemKind, SetCamera, SetEnvironment, SetLight, SetMaterial,
};

use crate::assets::{self, AssetLimits};

/// What a batch is checked against.
#[derive(Debug, Clone, Default)]
pub struct EditLimits {
    /// Of the scene as a whole.
    pub scene: SceneLimits,
    /// Of files inside edits.
    pub assets: AssetLimits,
    /// Edits in one batch.
    pub edits_per_batch: usize,
}

/// A batch that fits: the scene after it, and what it touched.
#[derive(Debug)]
pub struct Applied {
    /// The scene after the batch.
    pub scene: Scene,
    /// What was touched.
    pub change: SceneChange,
}

/// Applies a batch to a copy of the scene: all of it, or a problem that names the first edit at fault.
pub fn apply(scene: &Scene, edits: &[Edit], limits: &EditLimits) -> Result<Applied, Problem> {
    if edits.is_empty() {
        return Err(Problem::new(
            ProblemKind::EditRefused,
            "the batch holds no edits; it would change nothing",
        )
        .at_field("edits"));
    }
    if edits.len() > limits.edits_per_batch {
        let detail =
            format!("{} edits in one batch; at most {} are allowed", edits.len(), limits.edits_per_batch);
        return Err(Problem::new(ProblemKind::EditRefused, detail).at_field("edits"));
    }
    let mut builder = SceneBuilder::from_scene(scene, limits.scene);
    for (op_index, edit) in edits.iter().enumerate() {
        apply_one(&mut builder, edit, limits).map_err(|refusal| {
            let detail = format!("edits[{op_index}] ({}): {}", edit.op_name(), refusal.reason);
            let problem = Problem::new(ProblemKind::EditRefused, detail).at_op(op_index, edit.op_name());
            match refusal.field {
                Some(field) => problem.at_field(field),
                None => problem,
            }
        })?;
    }
    let (scene, change) = builder.finish();
    Ok(Applied { scene, change })
}

/// Why one edit does not fit.
struct Refusal {
    field: Option<String>,
    reason: String,
}

impl From<SceneError> for Refusal {
    fn from(error: SceneError) -> Refusal {
        Refusal { field: error.field().map(String::from), reason: error.to_string() }
    }
}

impl From<BadField> for Refusal {
    fn from(BadField { field, reason }: BadField) -> Refusal {
        Refusal { field: Some(field.into()), reason: format!("field `{field}`: {reason}") }
    }
}

fn apply_one(builder: &mut SceneBuilder, edit: &Edit, limits: &EditLimits) -> Result<(), Refusal> {
    match edit {
        Edit::AddMesh(edit) => builder.add_mesh(id(&edit.mesh), mesh_source(edit)?)?,
        Edit::AddNode(edit) => builder.add_node(id(&edit.node), node(edit)?)?,
        Edit::RemoveNode(edit) => builder.remove_node(&edit.node)?,
        Edit::SetTransform(edit) => {
            builder.set_transform(&edit.node, affine(&edit.transform, "transform")?)?;
        }
        Edit::SetMaterial(edit) => set_material(builder, edit)?,
        Edit::AddLight(edit) => builder.add_light(id(&edit.light), added_light(edit))?,
        Edit::SetLight(edit) => set_light(builder, edit)?,
        Edit::RemoveLight(edit) => builder.remove_light(&edit.light)?,
        Edit::SetCamera(edit) => builder.set_camera(id(&edit.camera), camera(edit)?)?,
        Edit::RemoveCamera(edit) => builder.remove_camera(&edit.camera)?,
        Edit::SetEnvironment(edit) => set_environment(builder, edit)?,
        Edit::LoadGltf(edit) => load_gltf(builder, edit, &limits.assets)?,
    }
    Ok(())
}

fn mesh_source(edit: &AddMesh) -> Result<MeshSource, BadField> {
    let Ok(triangle_count) = u32::try_from(edit.triangles.len()) else {
        return refuse("triangles", "more than 2³² of them");
    };
    let per_vertex = [
        ("normals", edit.normals.as_ref().map(Vec::len)),
        ("texcoords", edit.texcoords.as_ref().map(Vec::len)),
        ("colors", edit.colors.as_ref().map(Vec::len)),
    ];
    for (field, length) in per_vertex {
        if let Some(length) = length.filter(|length| *length != edit.positions.len()) {
            return refuse(field, format!("{length} for {} positions", edit.positions.len()));
        }
    }
    let texcoords = edit.texcoords.iter().flatten().copied().map(Vec2::from).collect();
    Ok(MeshSource {
        positions: edit.positions.iter().map(|p| Vec3::from(*p).as_dvec3()).collect(),
        normals: edit.normals.iter().flatten().copied().map(Vec3::from).collect(),
        tangents: Vec::new(),
        texcoords: [texcoords, Vec::new()],
        colors: edit.colors.iter().flatten().copied().map(Vec4::from).collect(),
        triangles: edit.triangles.clone(),
        primitives: vec![Primitive { first_triangle: 0, triangle_count, material: id(&edit.material) }],
    })
}

fn node(edit: &AddNode) -> Result<Node, BadField> {
    Ok(Node {
        parent: edit.parent.as_ref().map(id),
        parent_from_node: affine(&edit.transform, "transform")?,
        mesh: edit.mesh.as_ref().map(id),
    })
}

fn set_material(builder: &mut SceneBuilder, edit: &SetMaterial) -> Result<(), Refusal> {
    let material_id = id(&edit.material);
    let material = match builder.scene().materials().get(&material_id) {
        Some(before) => with_properties(&edit.applied_to(&super::describe::properties(before)), before),
        None if edit.create => {
            with_properties(&edit.applied_to(&MaterialProperties::default()), &Material::default())
        }
        None => {
            let known = builder.scene().materials().keys();
            let unknown = SceneError::unknown("material", "material", material_id.as_str(), known);
            let reason = format!("{unknown}; `\"create\": true` would make it");
            return Err(Refusal { field: Some("material".into()), reason });
        }
    };
    Ok(builder.set_material(material_id, material)?)
}

fn rgb(channels: [f32; 3]) -> Rgb {
    Rgb::from(channels)
}

/// The material with these properties, and the rest (alpha, textures) as before.
fn with_properties(properties: &MaterialProperties, before: &Material) -> Material {
    Material {
        base_color: rgb(properties.base_color),
        alpha: before.alpha,
        metallic: properties.metallic,
        roughness: properties.roughness,
        ior: properties.ior,
        specular: properties.specular,
        specular_color: rgb(properties.specular_color),
        transmission: properties.transmission,
        attenuation_color: rgb(properties.attenuation_color),
        attenuation_distance_m: properties.attenuation_distance_m.unwrap_or(f32::INFINITY),
        emission: rgb(properties.emission),
        double_sided: properties.double_sided,
        unlit: properties.unlit,
        alpha_cutoff: properties.alpha_cutoff,
        normal_scale: properties.normal_scale,
        textures: before.textures.clone(),
    }
}

fn added_light(edit: &AddLight) -> Light {
    light(edit.parent.as_ref().map(id), &edit.source)
}

fn light(parent: Option<lumicast_engine::scene::Id>, source: &LightSource) -> Light {
    let (position, direction, kind) = match *source {
        LightSource::Point { intensity, position } => {
            (position.into(), DVec3::NEG_Z, LightKind::Point { intensity: rgb(intensity) })
        }
        LightSource::Spot { intensity, position, direction, inner_angle_rad, outer_angle_rad } => {
            let intensity = rgb(intensity);
            let kind = LightKind::Spot { intensity, inner_angle_rad, outer_angle_rad };
            (position.into(), direction.into(), kind)
        }
        LightSource::Directional { irradiance, direction } => {
            (DVec3::ZERO, direction.into(), LightKind::Directional { irradiance: rgb(irradiance) })
        }
    };
    Light { parent, position, direction, kind }
}

fn set_light(builder: &mut SceneBuilder, edit: &SetLight) -> Result<(), Refusal> {
    let Some(before) = builder.scene().lights().get(edit.light.as_str()) else {
        let known = builder.scene().lights().keys();
        let mut refusal: Refusal = SceneError::unknown("light", "light", edit.light.as_str(), known).into();
        // Who looks for a lamp looks for whatever shines.
        let mut materials = builder.scene().materials().iter();
        if let Some((material, _)) = materials.find(|(_, material)| material.is_emissive()) {
            refusal.reason +=
                &format!("; surfaces shine by their material, here {material:?}: set_material with emission");
        }
        return Err(refusal);
    };
    let source = edit.applied_to(&super::describe::light_source(before)).map_err(|reason| {
        // The protocol puts the field's name between the first backticks.
        Refusal { field: reason.split('`').nth(1).map(String::from), reason }
    })?;
    let parent = match &edit.parent {
        Change::Keep => before.parent.clone(),
        Change::Clear => None,
        Change::Set(parent) => Some(id(parent)),
    };
    Ok(builder.set_light(&edit.light, light(parent, &source))?)
}

fn camera(edit: &SetCamera) -> Result<Camera, BadField> {
    let parent_from_camera: DAffine3 = match &edit.placement {
        Placement::Transform(transform) => affine(transform, "transform")?,
        Placement::LookAt(look_at) => {
            let [position, target, up] = [look_at.position, look_at.target, look_at.up].map(DVec3::from);
            let forward = (target - position).try_normalize();
            let Some(forward) = forward.filter(|_| position.is_finite()) else {
                return refuse("look_at.target", "is where `position` is, or not finite");
            };
            // 1e-6: nearer to the line of sight than that, the picture's roll would be rounding noise.
            if !up.try_normalize().is_some_and(|up| up.cross(forward).length() > 1e-6) {
                return refuse("look_at.up", "is zero, not finite, or along the line of sight");
            }
            CameraView::look_at(position, target, up, 1.0).world_from_camera
        }
    };
    Ok(Camera {
        parent: edit.parent.as_ref().map(id),
        parent_from_camera,
        projection: projection(edit.projection),
        aspect: edit.aspect.map(f64::from),
    })
}

fn set_environment(builder: &mut SceneBuilder, edit: &SetEnvironment) -> Result<(), Refusal> {
    let environment = match edit {
        SetEnvironment::None {} => Environment::None,
        SetEnvironment::Constant { radiance } => Environment::Constant(rgb(*radiance)),
        SetEnvironment::Image { image, scale, rotation_rad } => {
            let texture = environment_texture(image)?;
            let texture_id = free_texture_id(builder.scene());
            builder
                .add_texture(texture_id.clone(), texture)
                .map_err(|error| Refusal { field: Some("image.texels".into()), reason: error.to_string() })?;
            Environment::Image { texture: texture_id, scale: Rgb::splat(*scale), rotation_rad: *rotation_rad }
        }
    };
    Ok(builder.set_environment(environment)?)
}

/// The picture with the column that looks down −Z first, as the engine has it, instead of in the middle.
fn environment_texture(image: &EnvironmentImage) -> Result<Texture, BadField> {
    let Some(radiance) = image.radiance() else {
        let (width, height, bytes) = (image.width, image.height, image.texels.len());
        return refuse(
            "image.texels",
            format!("{bytes} bytes for {width}×{height} pixels; width × height × 12 are needed"),
        );
    };
    if radiance.is_empty() {
        return refuse("image.width", "no texels");
    }
    // An odd width has no column boundary in its middle: every column twice has one, and looks the same.
    let twice = 1 + image.width as usize % 2;
    let width = image.width as usize * twice;
    let mut texels = Vec::with_capacity(radiance.len() * twice);
    for row in radiance.chunks_exact(image.width as usize) {
        texels.extend((0..width).map(|column| {
            let [r, g, b] = row[(column + width / 2) % width / twice];
            [r, g, b, 1.0]
        }));
    }
    Ok(Texture { width: width as u32, height: image.height, texels: Texels::Rgba32F(texels) })
}

fn free_texture_id(scene: &Scene) -> lumicast_engine::scene::Id {
    // Ends: a scene has finitely many textures.
    let names = std::iter::once("environment".to_string()).chain((2..).map(|n| format!("environment {n}")));
    let free = names.map(|name| lumicast_engine::scene::Id::sanitised(&name, "environment"));
    free.into_iter().find(|id| !scene.textures().contains_key(id)).unwrap_or_else(|| unreachable!())
}

fn load_gltf(builder: &mut SceneBuilder, edit: &LoadGltf, limits: &AssetLimits) -> Result<(), Refusal> {
    let parent = edit.parent.as_ref().map(id);
    // Before the file is read: from then on every refusal is the file's.
    let nodes = builder.scene().nodes();
    if let Some(unknown) = parent.as_ref().filter(|parent| !nodes.contains_key(*parent)) {
        return Err(SceneError::unknown("node", "parent", unknown.as_str(), nodes.keys()).into());
    }
    let placement = assets::GltfPlacement {
        parent,
        prefix: Some(edit.prefix.clone()).filter(|prefix| !prefix.is_empty()),
    };
    assets::load_gltf_bytes(&edit.data, builder, placement, limits)
        .map_err(|error| Refusal { field: Some("data".into()), reason: error.to_string() })?;
    Ok(())
}
