//! A scene → what is told about it.

use super::{wire_id, wire_projection};
use lumicast_engine::effects::EffectPlan;
use lumicast_engine::math::Rgb;
use lumicast_engine::scene::{
    Aabb, Environment, Id, Light, LightKind, Material, Scene, Texels, Texture, TextureSlot,
};
use lumicast_protocol as wire;

/// Everything but geometry and texels.
pub fn describe(
    scene: &Scene,
    id: &wire::SceneId,
    name: &str,
    revision: u64,
    durable: bool,
) -> wire::SceneDescription {
    wire::SceneDescription {
        id: id.clone(),
        name: name.into(),
        revision,
        durable,
        counts: counts(scene),
        bounds: scene.bounds().map(|Aabb { min, max }| [min.to_array(), max.to_array()]),
        warnings: scene
            .warnings()
            .iter()
            .map(|warning| wire::Warning { object: warning.object.clone(), message: warning.message.clone() })
            .collect(),
        nodes: nodes(scene),
        meshes: meshes(scene),
        materials: sorted(scene.materials().keys()).map(|id| material(id, &scene.materials()[id])).collect(),
        lights: sorted(scene.lights().keys()).map(|id| light(id, &scene.lights()[id])).collect(),
        cameras: cameras(scene),
        environment: environment(scene),
    }
}

fn sorted<'a>(ids: impl Iterator<Item = &'a Id>) -> impl Iterator<Item = &'a Id> {
    let mut ids: Vec<&Id> = ids.collect();
    ids.sort();
    ids.into_iter()
}

fn counts(scene: &Scene) -> wire::Counts {
    let meshes = || scene.meshes().values();
    wire::Counts {
        nodes: scene.nodes().len() as u64,
        meshes: scene.meshes().len() as u64,
        triangles: meshes().map(|mesh| mesh.triangles().len() as u64).sum(),
        instanced_triangles: scene.instanced_triangle_count(),
        vertices: meshes().map(|mesh| mesh.positions().len() as u64).sum(),
        materials: scene.materials().len() as u64,
        textures: scene.textures().len() as u64,
        texels: scene.textures().values().map(|texture| texture.texel_count() as u64).sum(),
        lights: scene.lights().len() as u64,
        emissive_triangles: emissive_triangles(scene),
        cameras: scene.cameras().len() as u64,
    }
}

fn emissive_triangles(scene: &Scene) -> u64 {
    let carried = scene.nodes().values().filter_map(|node| scene.meshes().get(node.mesh.as_ref()?));
    let primitives = carried.flat_map(|mesh| mesh.primitives());
    let emits = |id: &Id| scene.materials().get(id).is_some_and(|material| material.is_emissive());
    primitives
        .filter(|primitive| emits(&primitive.material))
        .map(|primitive| u64::from(primitive.triangle_count))
        .sum()
}

/// Parents before children, otherwise in the scene's order.
fn nodes(scene: &Scene) -> Vec<wire::NodeDescription> {
    // A parent exists before a node can name it and keeps its place, so the scene's order has this property.
    let describe = |(id, node): (&Id, &lumicast_engine::scene::Node)| wire::NodeDescription {
        id: wire_id(id),
        parent: node.parent.as_ref().map(wire_id),
        transform: wire::Transform::Matrix(glam::DMat4::from(node.parent_from_node).to_cols_array()),
        mesh: node.mesh.as_ref().map(wire_id),
    };
    scene.nodes().iter().map(describe).collect()
}

fn meshes(scene: &Scene) -> Vec<wire::MeshDescription> {
    let describe = |id: &Id| {
        let mesh = &scene.meshes()[id];
        let mut materials: Vec<wire::Id> = Vec::new();
        for primitive in mesh.primitives() {
            let material = wire_id(&primitive.material);
            if !materials.contains(&material) {
                materials.push(material);
            }
        }
        wire::MeshDescription {
            id: wire_id(id),
            triangles: mesh.triangles().len() as u64,
            vertices: mesh.positions().len() as u64,
            materials,
        }
    };
    sorted(scene.meshes().keys()).map(describe).collect()
}

fn material(id: &Id, material: &Material) -> wire::MaterialDescription {
    let with_texture = TextureSlot::ALL.into_iter().filter(|slot| material.texture(*slot).is_some());
    wire::MaterialDescription {
        id: wire_id(id),
        properties: properties(material),
        textures: with_texture.map(slot).collect(),
    }
}

fn slot(slot: TextureSlot) -> wire::TextureSlot {
    match slot {
        TextureSlot::BaseColor => wire::TextureSlot::BaseColor,
        TextureSlot::MetallicRoughness => wire::TextureSlot::MetallicRoughness,
        TextureSlot::Normal => wire::TextureSlot::Normal,
        TextureSlot::Emission => wire::TextureSlot::Emission,
        TextureSlot::Specular => wire::TextureSlot::Specular,
        TextureSlot::SpecularColor => wire::TextureSlot::SpecularColor,
        TextureSlot::Transmission => wire::TextureSlot::Transmission,
    }
}

/// A material's values as the wire has them.
pub(super) fn properties(material: &Material) -> wire::MaterialProperties {
    let distance_m = material.attenuation_distance_m;
    wire::MaterialProperties {
        base_color: material.base_color.to_array(),
        metallic: material.metallic,
        roughness: material.roughness,
        ior: material.ior,
        specular: material.specular,
        specular_color: material.specular_color.to_array(),
        transmission: material.transmission,
        attenuation_color: material.attenuation_color.to_array(),
        attenuation_distance_m: distance_m.is_finite().then_some(distance_m),
        emission: material.emission.to_array(),
        double_sided: material.double_sided,
        unlit: material.unlit,
        alpha_cutoff: material.alpha_cutoff,
        normal_scale: material.normal_scale,
    }
}

fn light(id: &Id, light: &Light) -> wire::LightDescription {
    wire::LightDescription {
        id: wire_id(id),
        parent: light.parent.as_ref().map(wire_id),
        source: light_source(light),
    }
}

/// A light as the wire has it.
pub(super) fn light_source(light: &Light) -> wire::LightSource {
    let (position, direction) = (light.position.to_array(), light.direction.to_array());
    match light.kind {
        LightKind::Point { intensity } => {
            wire::LightSource::Point { intensity: intensity.to_array(), position }
        }
        LightKind::Spot { intensity, inner_angle_rad, outer_angle_rad } => wire::LightSource::Spot {
            intensity: intensity.to_array(),
            position,
            direction,
            inner_angle_rad,
            outer_angle_rad,
        },
        LightKind::Directional { irradiance } => {
            wire::LightSource::Directional { irradiance: irradiance.to_array(), direction }
        }
    }
}

fn cameras(scene: &Scene) -> Vec<wire::CameraDescription> {
    let describe = |(id, camera): (&Id, &lumicast_engine::scene::Camera)| {
        let world_from_camera = scene.world_from_node(camera.parent.as_ref()) * camera.parent_from_camera;
        wire::CameraDescription {
            id: wire_id(id),
            parent: camera.parent.as_ref().map(wire_id),
            world_from_camera: glam::DMat4::from(world_from_camera).to_cols_array(),
            projection: wire_projection(camera.projection),
            aspect: camera.aspect.map(|aspect| aspect as f32),
        }
    };
    scene.cameras().iter().map(describe).collect()
}

fn environment(scene: &Scene) -> wire::EnvironmentDescription {
    match scene.environment() {
        Environment::None => wire::EnvironmentDescription::None,
        Environment::Constant(radiance) => {
            wire::EnvironmentDescription::Constant { radiance: radiance.to_array() }
        }
        Environment::Image { texture, scale, rotation_rad } => {
            let Some(image) = scene.textures().get(texture) else {
                // The builder lets no environment lose its texture.
                return wire::EnvironmentDescription::None;
            };
            let mean = mean_over_sphere(image);
            wire::EnvironmentDescription::Image {
                width: image.width,
                height: image.height,
                scale: scale.mean(),
                rotation_rad: *rotation_rad,
                mean_radiance: [mean[0] * scale.r, mean[1] * scale.g, mean[2] * scale.b],
            }
        }
    }
}

/// Mean of an equirectangular picture over the sphere: rows near the poles count less.
fn mean_over_sphere(image: &Texture) -> [f32; 3] {
    let Texels::Rgba32F(texels) = &image.texels else { return Rgb::BLACK.to_array() };
    let (width, height) = (image.width as usize, f64::from(image.height));
    let mut sum = [0.0; 3];
    let mut weights = 0.0;
    for (row_index, row) in texels.chunks_exact(width).enumerate() {
        let theta = |row: f64| std::f64::consts::PI * row / height;
        // Share of the sphere between the row's two circles of latitude.
        let weight = (theta(row_index as f64).cos() - theta(row_index as f64 + 1.0).cos()) / width as f64;
        for texel in row {
            for (sum, value) in sum.iter_mut().zip(texel) {
                *sum += weight * f64::from(*value);
            }
        }
        weights += weight * width as f64;
    }
    sum.map(|sum| (sum / weights) as f32)
}

/// Which parts of the renderer this scene needs, and why.
pub fn effects(plan: &EffectPlan, revision: u64) -> wire::Effects {
    let effects = plan.effects.iter().map(|effect| wire::Effect {
        effect: effect.kind.name().into(),
        on: effect.is_on,
        reason: effect.reason.clone(),
    });
    wire::Effects { revision, effects: effects.collect() }
}
