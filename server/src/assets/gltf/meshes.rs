//! Meshes: primitives of any triangle mode → one engine mesh with a run of triangles per primitive.

use std::collections::HashMap;

use ::gltf::json::{
    mesh::{Mode, Primitive as JsonPrimitive, Semantic},
    validation::Checked,
};
use glam::{DVec3, Vec2, Vec3, Vec4};
use lumicast_engine::scene::{Id, MeshSource, Primitive};

use super::accessors::Accessors;
use crate::assets::{
    error::{AssetError, Bound, bad},
    zero_normals,
};

/// A mesh in the making and what was odd about it.
#[derive(Debug, Default)]
pub(super) struct LoadedMesh {
    pub(super) source: MeshSource,
    pub(super) warnings: Vec<String>,
}

/// What the meshes of the scene hold by now, and may hold.
#[derive(Clone, Copy, Debug)]
pub(super) struct Room {
    pub(super) vertices_used: u64,
    pub(super) vertices_max: u64,
    pub(super) triangles_used: u64,
    pub(super) triangles_max: u64,
}

/// Which accessors a primitive's vertices come from: primitives with the same ones share their vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Attributes {
    positions: usize,
    normals: Option<usize>,
    tangents: Option<usize>,
    texcoords: [Option<usize>; 2],
    colors: Option<usize>,
}

/// Reads all primitives of a mesh. `material_of` gives the material of a primitive by its index in the file.
pub(super) fn load(
    primitives: &[JsonPrimitive],
    user: &str,
    accessors: &Accessors<'_>,
    room: Room,
    mut material_of: impl FnMut(Option<usize>) -> Result<Id, AssetError>,
) -> Result<LoadedMesh, AssetError> {
    let mut mesh = LoadedMesh::default();
    let mut first_vertex_of: HashMap<Attributes, (u32, u32)> = HashMap::new();
    let kept: Vec<(Attributes, &JsonPrimitive)> = primitives
        .iter()
        .filter_map(|primitive| Some((drawable(primitive, &mut mesh.warnings)?, primitive)))
        .collect();
    for primitive in primitives {
        if primitive.targets.as_ref().is_some_and(|targets| !targets.is_empty()) {
            mesh.warnings.push("morph targets are left out: the mesh stands as written".into());
            break;
        }
    }
    for (attributes, primitive) in &kept {
        let (first, count) = match first_vertex_of.get(attributes) {
            Some(range) => *range,
            None => {
                let range = append_vertices(&mut mesh, attributes, &kept, user, accessors, room)?;
                first_vertex_of.insert(*attributes, range);
                range
            }
        };
        let corners = match primitive.indices {
            Some(indices) => corner_indices(indices.value(), count, user, accessors)?,
            None => (0..count).collect(),
        };
        let first_triangle = mesh.source.triangles.len();
        append_triangles(&mut mesh, &corners, mode(primitive), first);
        let triangles =
            Bound { what: "triangles in all meshes", limit: room.triangles_max, setting: "scene_triangles" };
        triangles.check(user, room.triangles_used.saturating_add(mesh.source.triangles.len() as u64))?;
        let triangle_count = (mesh.source.triangles.len() - first_triangle) as u32;
        let material = material_of(primitive.material.map(|material| material.value()))?;
        mesh.source.primitives.push(Primitive {
            first_triangle: first_triangle as u32,
            triangle_count,
            material,
        });
    }
    Ok(mesh)
}

fn mode(primitive: &JsonPrimitive) -> Mode {
    match primitive.mode {
        Checked::Valid(mode) => mode,
        Checked::Invalid => Mode::Points,
    }
}

/// The attributes of a primitive that shows triangles; `None` with a warning for any other.
fn drawable(primitive: &JsonPrimitive, warnings: &mut Vec<String>) -> Option<Attributes> {
    let index = |semantic| primitive.attributes.get(&Checked::Valid(semantic)).map(|index| index.value());
    let Some(positions) = index(Semantic::Positions) else {
        warnings.push("a primitive without positions is left out".into());
        return None;
    };
    if !matches!(mode(primitive), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
        warnings.push("a primitive of points or lines is left out: only triangles have a surface".into());
        return None;
    }
    Some(Attributes {
        positions,
        normals: index(Semantic::Normals),
        tangents: index(Semantic::Tangents),
        texcoords: [index(Semantic::TexCoords(0)), index(Semantic::TexCoords(1))],
        colors: index(Semantic::Colors(0)),
    })
}

/// Adds the vertices of `attributes`; what this primitive lacks but another one has is filled neutrally.
fn append_vertices(
    mesh: &mut LoadedMesh,
    attributes: &Attributes,
    all: &[(Attributes, &JsonPrimitive)],
    user: &str,
    accessors: &Accessors<'_>,
    room: Room,
) -> Result<(u32, u32), AssetError> {
    let (count, _) = accessors.shape(attributes.positions, user, "POSITION")?;
    let LoadedMesh { source, warnings } = mesh;
    let first = source.positions.len();
    let vertices =
        Bound { what: "vertices in all meshes", limit: room.vertices_max, setting: "scene_vertices" };
    vertices.check(user, room.vertices_used.saturating_add((first + count) as u64))?;
    let fits = |index: Option<usize>, field| match index {
        Some(index) => match accessors.shape(index, user, field)? {
            (own, components) if own == count => Ok(Some((index, components))),
            (own, _) => Err(bad(
                format!("accessor {index}"),
                "count",
                format!("is {own}, but {user} has {count} positions"),
            )),
        },
        None => Ok(None),
    };
    let any = |present: fn(&Attributes) -> bool| all.iter().any(|(attributes, _)| present(attributes));

    let positions = accessors.vectors::<3>(attributes.positions, user, "POSITION")?;
    source.positions.extend(positions.into_iter().map(|position| DVec3::from(position.map(f64::from))));
    let end = source.positions.len();
    if any(|attributes| attributes.normals.is_some()) {
        if let Some((index, _)) = fits(attributes.normals, "NORMAL")? {
            let before = source.normals.len();
            source
                .normals
                .extend(accessors.vectors(index, user, "NORMAL")?.into_iter().map(Vec3::from_array));
            warnings.extend(zero_normals(&source.normals[before..]));
        }
        // Zero stands for the triangle's own normal.
        source.normals.resize(end, Vec3::ZERO);
    }
    // Tangents follow from the texture coordinates where they are missing, so a part of them is worth nothing.
    if !all.iter().any(|(attributes, _)| attributes.tangents.is_none())
        && let Some((index, _)) = fits(attributes.tangents, "TANGENT")?
    {
        source.tangents.extend(accessors.vectors(index, user, "TANGENT")?.into_iter().map(Vec4::from_array));
    }
    for (set, field) in ["TEXCOORD_0", "TEXCOORD_1"].into_iter().enumerate() {
        if !all.iter().any(|(attributes, _)| attributes.texcoords[set].is_some()) {
            continue;
        }
        if let Some((index, _)) = fits(attributes.texcoords[set], field)? {
            source.texcoords[set]
                .extend(accessors.vectors(index, user, field)?.into_iter().map(Vec2::from_array));
        }
        source.texcoords[set].resize(end, Vec2::ZERO);
    }
    if any(|attributes| attributes.colors.is_some()) {
        match fits(attributes.colors, "COLOR_0")? {
            Some((index, 3)) => {
                let colors = accessors.vectors::<3>(index, user, "COLOR_0")?;
                source.colors.extend(colors.into_iter().map(|color| Vec3::from_array(color).extend(1.0)));
            }
            Some((index, _)) => {
                let colors = accessors.vectors(index, user, "COLOR_0")?;
                source.colors.extend(colors.into_iter().map(Vec4::from_array));
            }
            None => {}
        }
        source.colors.resize(end, Vec4::ONE);
    }
    // The bound on vertices keeps both below 2³².
    Ok((first as u32, count as u32))
}

fn corner_indices(
    index: usize,
    vertex_count: u32,
    user: &str,
    accessors: &Accessors<'_>,
) -> Result<Vec<u32>, AssetError> {
    let corners = accessors.indices(index, user)?;
    match corners.iter().position(|corner| *corner >= vertex_count) {
        Some(at) => {
            let problem = format!("name vertex {} at place {at}, but {user} has {vertex_count}", corners[at]);
            Err(bad(format!("accessor {index}"), "indices", problem))
        }
        None => Ok(corners),
    }
}

fn append_triangles(mesh: &mut LoadedMesh, corners: &[u32], mode: Mode, first_vertex: u32) {
    let triangles = &mut mesh.source.triangles;
    let shifted = |corners: [u32; 3]| corners.map(|corner| first_vertex + corner);
    match mode {
        // Every second triangle of a strip turns the other way [glTF 2.0, 3.7.2.1].
        Mode::TriangleStrip => {
            triangles.extend(corners.array_windows::<3>().enumerate().map(|(index, [a, b, c])| {
                if index % 2 == 0 { shifted([*a, *b, *c]) } else { shifted([*b, *a, *c]) }
            }))
        }
        Mode::TriangleFan => {
            let Some((hub, rim)) = corners.split_first() else { return };
            triangles.extend(rim.array_windows::<2>().map(|[b, c]| shifted([*b, *c, *hub])));
        }
        _ => {
            let (whole, rest) = corners.as_chunks::<3>();
            triangles.extend(whole.iter().copied().map(shifted));
            if !rest.is_empty() {
                let message = format!(
                    "the last {} of {} corners make no triangle and are left out",
                    rest.len(),
                    corners.len()
                );
                mesh.warnings.push(message);
            }
        }
    }
}

/// Colours outside [0, 1] cannot be shares of light: they are clamped, and NaN is left for the builder to refuse.
pub(super) fn clamp_colors(mesh: &mut LoadedMesh) {
    let mut clamped_count = 0;
    for color in &mut mesh.source.colors {
        let inside = color.clamp(Vec4::ZERO, Vec4::ONE);
        if !color.is_nan() && inside != *color {
            *color = inside;
            clamped_count += 1;
        }
    }
    if clamped_count > 0 {
        mesh.warnings.push(format!("{clamped_count} vertex colours outside 0 to 1 were clamped"));
    }
}
