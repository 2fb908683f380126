//! Scene files → scene builder, and scenes → GLB.
//!
//! Everything from outside enters here: glTF 2.0 (`.glb`, `.gltf`) and OBJ with MTL. Sizes are checked against
//! [`AssetLimits`] before memory is taken, numbers against the file that names them, and what remains goes
//! through the engine's `SceneBuilder`, which checks every value again. A file ends in a valid scene with
//! warnings, or in an [`AssetError`] that names file, object and field; never in a panic.
//! Imports the engine's `scene` room only.

mod builtin;
mod error;
mod export;
mod folder;
mod gltf;
mod limits;
mod names;
mod obj;
mod pictures;
#[cfg(test)]
mod tests;

use std::path::Path;

use glam::Vec3;
use lumicast_engine::scene::{Id, Scene, SceneBuilder};

pub use builtin::BuiltinScene;
pub use error::AssetError;
pub use export::export_glb;
pub use limits::AssetLimits;

use folder::Folder;

/// What to say of a file's normals when some have no length: the engine takes a zero for the wish for a flat normal,
/// which an importer may have, but in a file it is most likely a mistake of the exporter.
fn zero_normals(normals: &[Vec3]) -> Option<String> {
    let count = normals.iter().filter(|normal| **normal == Vec3::ZERO).count();
    (count > 0).then(|| format!("{count} normals of zero length: the triangle's own normal is used there"))
}

/// Where the objects of a glTF file go in a scene that exists already.
#[derive(Clone, Debug, Default)]
pub struct GltfPlacement {
    /// The node that the file's root nodes hang on; the world for `None`.
    pub parent: Option<Id>,
    /// Put in front of every name of the file, as it is.
    pub prefix: Option<String>,
}

/// Reads a scene file: `.glb` and `.gltf` are told by their first bytes, `.obj` by its extension.
///
/// Files that it refers to are read from its own folder and below, never from elsewhere.
pub fn load_scene(path: &Path, limits: &AssetLimits) -> Result<Scene, AssetError> {
    let file = path.display().to_string();
    load_file(path, limits).map_err(|error| error.in_file(&file))
}

fn load_file(path: &Path, limits: &AssetLimits) -> Result<Scene, AssetError> {
    let bytes = folder::read_file(path, limits.file_bytes_max, "file_bytes")?;
    let folder = Folder::of_file(path, limits.buffers_bytes_max)?;
    let mut builder = SceneBuilder::new(limits.scene);
    if gltf::looks_like_gltf(&bytes) {
        let environment = gltf::import(&bytes, folder, &mut builder, &GltfPlacement::default(), limits)?;
        if let Some(environment) = environment {
            builder.set_environment(environment)?;
        }
    } else if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("obj")) {
        obj::import(bytes, path, folder, &mut builder, limits)?;
    } else {
        return Err(AssetError::UnknownKind { file: String::new() });
    }
    Ok(builder.finish().0)
}

/// Reads a scene from a glTF file in memory, its environment included.
///
/// - `bytes`: a `.glb`, or a `.gltf` whose buffers and images are data URIs: there is no folder to read from
pub fn load_glb(bytes: &[u8], limits: &AssetLimits) -> Result<Scene, AssetError> {
    let mut builder = SceneBuilder::new(limits.scene);
    let folder = Folder::none(limits.buffers_bytes_max);
    gltf::import(bytes, folder, &mut builder, &GltfPlacement::default(), limits)
        .and_then(|environment| match environment {
            Some(environment) => Ok(builder.set_environment(environment)?),
            None => Ok(()),
        })
        .map_err(|error| error.in_file("glTF data"))?;
    Ok(builder.finish().0)
}

/// Adds the content of a glTF file to a scene under construction. Names that are taken get a ` #2`.
///
/// - `bytes`: a `.glb`, or a `.gltf` whose buffers and images are data URIs: there is no folder to read from
/// - the file's environment, if it has one, is left out: the scene keeps its own
/// - counts are checked against the builder's limits, bytes against `limits`
/// - after an error the builder holds a part of the file: drop it
pub fn load_gltf_bytes(
    bytes: &[u8],
    builder: &mut SceneBuilder,
    placement: GltfPlacement,
    limits: &AssetLimits,
) -> Result<(), AssetError> {
    let folder = Folder::none(limits.buffers_bytes_max);
    gltf::import(bytes, folder, builder, &placement, limits)
        .map(|_environment| ())
        .map_err(|error| error.in_file("glTF data"))
}
