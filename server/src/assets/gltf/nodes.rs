//! The node hierarchy: transforms in double precision, instances, lights and cameras on their nodes.

use ::gltf::json::{Node as JsonNode, Root, extensions::scene::khr_lights_punctual, validation::Checked};
use glam::{DAffine3, DMat4, DQuat, DVec3};
use lumicast_engine::{
    math::Rgb,
    scene::{Camera, Id, Light, LightKind, Node, Projection, SceneBuilder, is_invertible},
};

use super::{
    container::label,
    document::{Document, ExactCamera, ExactNode, at},
};
use crate::assets::error::{AssetError, bad};

/// A node of the file on its way into the scene.
#[derive(Clone, Debug)]
pub(super) struct Visit {
    pub(super) index: usize,
    /// Engine node that it hangs on.
    pub(super) parent: Option<Id>,
}

/// Where a light or camera of the file is mounted.
#[derive(Clone, Debug)]
pub(super) struct Mount {
    pub(super) parent: Option<Id>,
    /// Identity, but for nodes that only carry something (see `extras`).
    pub(super) parent_from_mount: DAffine3,
}

/// The roots of the default scene, of the first one, or of a file without scenes: all nodes that hang on none.
pub(super) fn roots(root: &Root) -> Result<Vec<usize>, AssetError> {
    if root.scenes.is_empty() {
        let mut is_child = vec![false; root.nodes.len()];
        for child in root.nodes.iter().flat_map(children) {
            if let Some(is_child) = is_child.get_mut(child) {
                *is_child = true;
            }
        }
        return Ok((0..root.nodes.len()).filter(|index| !is_child[*index]).collect());
    }
    let scene = root.scene.map_or(0, |scene| scene.value());
    let scene = at(&root.scenes, scene, || "file".into(), "scene")?;
    Ok(scene.nodes.iter().map(|node| node.value()).collect())
}

/// Indices of a node's children, unchecked.
pub(super) fn children(node: &JsonNode) -> impl DoubleEndedIterator<Item = usize> {
    node.children.iter().flatten().map(|child| child.value())
}

/// `node 3 "lamp"`.
pub(super) fn node_label(root: &Root, index: usize) -> String {
    label("node", index, root.nodes.get(index).and_then(|node| node.name.as_deref())).into()
}

/// A node's transform, with a warning where it is no plain one.
pub(super) fn transform(node: &ExactNode) -> (DAffine3, Option<String>) {
    if let Some(matrix) = node.matrix {
        let matrix = DMat4::from_cols_array(&matrix);
        let [x, y, z, w] = matrix.row(3).to_array();
        // 1e-6: the single precision that most exporters write.
        let is_affine = [x, y, z, w - 1.0].iter().all(|value| value.abs() <= 1e-6);
        let warning =
            (!is_affine).then(|| "its matrix is a projection, of which only the affine part is used".into());
        return (DAffine3::from_mat4(matrix), warning);
    }
    let translation = DVec3::from(node.translation.unwrap_or([0.0; 3]));
    let scale = DVec3::from(node.scale.unwrap_or([1.0; 3]));
    let rotation = DQuat::from_array(node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]));
    let length = rotation.length();
    let (rotation, warning) = if length > 1e-12 && length.is_finite() {
        (rotation / length, None)
    } else {
        (DQuat::IDENTITY, Some("its rotation is zero and is read as none".into()))
    };
    (DAffine3::from_scale_rotation_translation(scale, rotation, translation), warning)
}

/// Whether a node can be shown: a singular one flattens all below it to nothing.
pub(super) fn is_showable(builder: &SceneBuilder, parent: Option<&Id>, parent_from_node: &DAffine3) -> bool {
    let world_from_node = builder.scene().world_from_node(parent) * *parent_from_node;
    is_invertible(parent_from_node) && is_invertible(&world_from_node)
}

/// Adds a node of the scene.
pub(super) fn add(
    builder: &mut SceneBuilder,
    id: Id,
    parent: Option<Id>,
    parent_from_node: DAffine3,
    mesh: Option<Id>,
) -> Result<(), AssetError> {
    Ok(builder.add_node(id, Node { parent, parent_from_node, mesh })?)
}

/// The light that a node carries, in that node's space, with what is odd about it.
pub(super) struct LoadedLight<'a> {
    pub(super) name: Option<&'a str>,
    pub(super) light: Light,
    pub(super) warnings: Vec<String>,
}

/// Reads the light `index` mounted at `mount`. Candela and lux are W/sr and W/m² (see the contract).
pub(super) fn light<'a>(
    root: &'a Root,
    index: usize,
    user: &str,
    mount: Mount,
) -> Result<LoadedLight<'a>, AssetError> {
    let lights = root.extensions.as_ref().and_then(|extensions| extensions.khr_lights_punctual.as_ref());
    let lights = lights.map_or(&[][..], |extension| &extension.lights);
    let json = at(lights, index, || user.into(), "KHR_lights_punctual.light")?;
    let object = String::from(label("light", index, json.name.as_deref()));
    let mut warnings = Vec::new();
    if json.range.is_some() {
        warnings.push("its range is left out: light falls off with the square of the distance".into());
    }
    let mut strength = Rgb::from(json.color) * json.intensity;
    if strength.is_finite() && !strength.is_non_negative() {
        strength = strength.map(|value| value.max(0.0));
        warnings.push("negative intensity is read as 0".into());
    }
    let kind = match json.type_ {
        Checked::Valid(khr_lights_punctual::Type::Directional) => {
            LightKind::Directional { irradiance: strength }
        }
        Checked::Valid(khr_lights_punctual::Type::Point) => LightKind::Point { intensity: strength },
        Checked::Valid(khr_lights_punctual::Type::Spot) => {
            let spot = json.spot.clone();
            if spot.is_none() {
                warnings.push("a spot light without cone angles gets glTF's: 0 and 45 degrees".into());
            }
            let (inner, outer) = spot.map_or((0.0, std::f32::consts::FRAC_PI_4), |spot| {
                (spot.inner_cone_angle, spot.outer_cone_angle)
            });
            spot_kind(strength, inner, outer, &mut warnings)
        }
        Checked::Invalid => return Err(bad(object, "type", "is neither directional, point nor spot")),
    };
    let position = mount.parent_from_mount.translation;
    let direction = mount.parent_from_mount.transform_vector3(DVec3::NEG_Z).normalize_or(DVec3::NEG_Z);
    let light = Light { parent: mount.parent, position, direction, kind };
    Ok(LoadedLight { name: json.name.as_deref(), light, warnings })
}

fn spot_kind(intensity: Rgb, inner: f32, outer: f32, warnings: &mut Vec<String>) -> LightKind {
    // A quarter turn is glTF's bound; a ten-thousandth of a radian still is a cone in single precision.
    let outer_angle_rad = outer.clamp(1e-4, std::f32::consts::FRAC_PI_2);
    // The engine fades between the two, so they must differ, if only by the last bit.
    let inner_angle_rad = inner.clamp(0.0, outer_angle_rad.next_down());
    // Exporters write equal angles for a hard edge: that is no news.
    if (outer_angle_rad, inner_angle_rad) != (outer, inner) && !(inner == outer && outer == outer_angle_rad) {
        let message =
            format!("cone angles {inner} and {outer} are read as {inner_angle_rad} and {outer_angle_rad}");
        warnings.push(message);
    }
    LightKind::Spot { intensity, inner_angle_rad, outer_angle_rad }
}

/// Reads the camera `index` mounted at `mount`.
pub(super) fn camera(
    document: &Document,
    index: usize,
    user: &str,
    mount: Mount,
) -> Result<(Camera, Option<String>), AssetError> {
    let json = at(&document.exact.cameras, index, || user.into(), "camera")?;
    let object = || format!("camera {index}");
    let missing = |field| bad(object(), field, "is missing");
    let (projection, aspect) = match json {
        ExactCamera { kind, perspective, .. } if kind == "perspective" => {
            let perspective = perspective.as_ref().ok_or_else(|| missing("perspective"))?;
            (Projection::Perspective { yfov_rad: perspective.yfov }, perspective.aspect_ratio)
        }
        ExactCamera { kind, orthographic, .. } if kind == "orthographic" => {
            let size = orthographic.as_ref().ok_or_else(|| missing("orthographic"))?;
            // Negative magnifications occur and are not forbidden; they would turn the picture over.
            (Projection::Orthographic { half_height_m: size.ymag.abs() }, Some((size.xmag / size.ymag).abs()))
        }
        _ => return Err(bad(object(), "type", "is neither perspective nor orthographic")),
    };
    let usable = aspect.filter(|aspect| (0.001..1000.0).contains(aspect) && *aspect > 0.001);
    let warning = (aspect != usable).then(|| "its aspect ratio is out of range and is left out".into());
    let Mount { parent, parent_from_mount: parent_from_camera } = mount;
    Ok((Camera { parent, parent_from_camera, projection, aspect: usable }, warning))
}
