//! Wavefront OBJ with MTL → scene builder, through `tobj`.
//!
//! One mesh and node per object (or group), a run of triangles per material. v = 0 is OBJ's bottom row and
//! the engine's top row. Without MTL everything is Lambertian grey. Materials: see `materials`.

mod materials;
mod screen;

use std::{cell::RefCell, collections::HashSet, path::Path};

use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};
use lumicast_engine::{
    math::Rgb,
    scene::{Id, Material, MeshSource, Node, Primitive, SceneBuilder},
};

use super::{
    AssetLimits,
    error::{AssetError, bad},
    folder::Folder,
    names::Names,
    zero_normals,
};

/// Adds an OBJ file's objects, and the materials of its libraries, to `builder`.
pub(super) fn import(
    bytes: Vec<u8>,
    path: &Path,
    folder: Folder,
    builder: &mut SceneBuilder,
    limits: &AssetLimits,
) -> Result<(), AssetError> {
    let screened = screen::object_lines(&bytes, builder.limits())?;
    drop(bytes);
    let libraries = Libraries { folder: RefCell::new(folder), events: RefCell::new(Vec::new()) };
    let options =
        tobj::LoadOptions { single_index: true, triangulate: true, ignore_points: true, ignore_lines: true };
    let loaded = tobj::load_obj_buf(&mut screened.text.as_bytes(), &options, |name| libraries.load(name));
    for event in libraries.events.into_inner() {
        let (object, warning) = event?;
        builder.warn(object, warning);
    }
    let (models, materials) = loaded.map_err(|error| bad("OBJ", "line", error.to_string()))?;
    // An error here is a missing library, told above.
    let materials = materials.unwrap_or_default();
    for warning in screened.warnings {
        builder.warn("file", warning);
    }
    let known: HashSet<&str> = materials.iter().map(|material| material.name.as_str()).collect();
    for name in &screened.materials_used {
        if !known.contains(name.as_str()) {
            builder.warn(format!("material {name:?}"), "is in no material library: shown grey");
        }
    }
    let material_ids = materials::add(&materials, &mut libraries.folder.into_inner(), builder, limits)?;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    Objects { builder, names: Names::new(None), material_ids, grey: None }.add_all(models, &stem)
}

/// Reads material libraries for `tobj`, whose callback cannot fail with our errors.
struct Libraries {
    folder: RefCell<Folder>,
    events: RefCell<Vec<Result<(String, String), AssetError>>>,
}

impl Libraries {
    fn load(&self, name: &Path) -> tobj::MTLLoadResult {
        let name = name.to_string_lossy().replace('\\', "/");
        let object = format!("material library {name:?}");
        let event = match self.folder.borrow_mut().read(&object, &name) {
            Ok(bytes) => match tobj::load_mtl_buf(&mut screen::material_lines(&bytes).as_bytes()) {
                Ok(materials) => return Ok(materials),
                Err(error) => Err(bad(object, "line", error.to_string())),
            },
            Err(AssetError::Missing { source, .. }) => {
                Ok((object, format!("cannot be read ({source}): its materials are shown grey")))
            }
            Err(error) => Err(error),
        };
        self.events.borrow_mut().push(event);
        Err(tobj::LoadError::OpenFileFailed)
    }
}

/// Objects on their way into the scene.
struct Objects<'a> {
    builder: &'a mut SceneBuilder,
    names: Names,
    material_ids: Vec<Id>,
    grey: Option<Id>,
}

impl Objects<'_> {
    /// `tobj` starts a new model of the same name at each change of material: those are one object.
    fn add_all(mut self, models: Vec<tobj::Model>, file_stem: &str) -> Result<(), AssetError> {
        let mut models = models.into_iter().filter(|model| !model.mesh.indices.is_empty()).peekable();
        while let Some(first) = models.next() {
            let name = first.name.clone();
            let mut source = MeshSource::default();
            let mut warnings = Vec::new();
            self.append(&mut source, first.mesh, &mut warnings)?;
            while let Some(next) = models.next_if(|next| next.name == name) {
                self.append(&mut source, next.mesh, &mut warnings)?;
            }
            let name = if name == "unnamed_object" { file_stem } else { &name };
            let id = self
                .names
                .unique(&[Some(name)], "object", |id| self.builder.scene().nodes().contains_key(id));
            for warning in warnings {
                self.builder.warn(format!("mesh {id:?}"), warning);
            }
            fill(&mut source);
            self.builder.add_mesh(id.clone(), source)?;
            let node = Node { parent: None, parent_from_node: DAffine3::IDENTITY, mesh: Some(id.clone()) };
            self.builder.add_node(id, node)?;
        }
        Ok(())
    }

    fn append(
        &mut self,
        source: &mut MeshSource,
        mesh: tobj::Mesh,
        warnings: &mut Vec<String>,
    ) -> Result<(), AssetError> {
        let material = self.material(mesh.material_id)?;
        let first = source.positions.len();
        let (positions, _) = mesh.positions.as_chunks::<3>();
        source.positions.extend(positions.iter().copied().map(DVec3::from_array));
        // tobj leaves out what a corner lacks, so lists of another length no longer belong to their vertices.
        let (normals, _) = mesh.normals.as_chunks::<3>();
        if normals.len() == positions.len() {
            source.normals.resize(first, Vec3::ZERO);
            source.normals.extend(normals.iter().map(|normal| DVec3::from_array(*normal).as_vec3()));
            warnings.extend(zero_normals(&source.normals[first..]));
        } else if !normals.is_empty() {
            warnings.push("some corners have no normal: flat normals are used".into());
        }
        let (texcoords, _) = mesh.texcoords.as_chunks::<2>();
        if texcoords.len() == positions.len() {
            source.texcoords[0].resize(first, Vec2::ZERO);
            source.texcoords[0].extend(texcoords.iter().map(|[u, v]| Vec2::new(*u as f32, 1.0 - *v as f32)));
        } else if !texcoords.is_empty() {
            warnings.push("some corners have no texture coordinates: none are used".into());
        }
        let (colors, _) = mesh.vertex_color.as_chunks::<3>();
        if colors.len() == positions.len() {
            source.colors.resize(first, Vec4::ONE);
            let share = |value: f64| if value.is_nan() { f32::NAN } else { value.clamp(0.0, 1.0) as f32 };
            source.colors.extend(colors.iter().map(|color| Vec3::from_array(color.map(share)).extend(1.0)));
        }
        let first_triangle = source.triangles.len() as u32;
        let shift = |corner: u32| first as u32 + corner;
        let (triangles, _) = mesh.indices.as_chunks::<3>();
        source.triangles.extend(triangles.iter().map(|triangle| triangle.map(shift)));
        let triangle_count = source.triangles.len() as u32 - first_triangle;
        source.primitives.push(Primitive { first_triangle, triangle_count, material });
        Ok(())
    }

    fn material(&mut self, index: Option<usize>) -> Result<Id, AssetError> {
        if let Some(id) = index.and_then(|index| self.material_ids.get(index)) {
            return Ok(id.clone());
        }
        if let Some(id) = &self.grey {
            return Ok(id.clone());
        }
        let taken = |id: &Id| self.builder.scene().materials().contains_key(id);
        let id = Names::new(None).unique(&[], "default", taken);
        // Half of the light: bright enough to see by, dark enough for the eye to tell surfaces apart.
        self.builder.set_material(id.clone(), Material::lambert(Rgb::splat(0.5)))?;
        self.grey = Some(id.clone());
        Ok(id)
    }
}

/// Lists that some parts of an object lack grow to its full length with neutral values.
fn fill(source: &mut MeshSource) {
    let count = source.positions.len();
    let grow = |length: usize| if length == 0 { 0 } else { count };
    source.normals.resize(grow(source.normals.len()), Vec3::ZERO);
    source.texcoords[0].resize(grow(source.texcoords[0].len()), Vec2::ZERO);
    source.colors.resize(grow(source.colors.len()), Vec4::ONE);
}
