//! MTL → engine materials.
//!
//! | MTL | engine |
//! | --- | --- |
//! | `Kd`, `map_Kd` | base colour of a Lambertian surface |
//! | `Ke` | emitted radiance, W/(m² sr) |
//! | `illum` 3, 5 with a `Ks` that is not black | perfect mirror of colour `Ks` |
//! | `illum` 6, 7 | smooth glass of index `Ni` |
//! | `Ks`, `Ns` otherwise; `Ka`, `d`, other maps | left out: their meaning differs from program to program |

use std::collections::HashMap;

use lumicast_engine::{
    math::Rgb,
    scene::{Id, Material, SceneBuilder, TextureRef, TextureSlot},
};

use crate::assets::{
    AssetLimits,
    error::{AssetError, Bound, bad},
    folder::Folder,
    names::Names,
    pictures,
};

/// Adds the materials and their pictures; gives their ids in the order of the file.
pub(super) fn add(
    materials: &[tobj::Material],
    folder: &mut Folder,
    builder: &mut SceneBuilder,
    limits: &AssetLimits,
) -> Result<Vec<Id>, AssetError> {
    let mut names = Names::new(None);
    let mut pictures = Pictures { folder, limits, loaded: HashMap::new(), names: Names::new(None) };
    let mut ids = Vec::with_capacity(materials.len());
    for source in materials {
        let id = names
            .unique(&[Some(&source.name)], "material", |id| builder.scene().materials().contains_key(id));
        let (mut material, mut warnings) = surface(source, &id)?;
        if let Some(map) = &source.diffuse_texture {
            // With a picture, many programs leave `Kd` at 0 and mean 1.
            if material.base_color.is_black() {
                material.base_color = Rgb::WHITE;
            }
            let texture = pictures.load(map, &id, builder, &mut warnings)?;
            material.textures[TextureSlot::BaseColor as usize] = texture.map(TextureRef::new);
        }
        builder.set_material(id.clone(), material)?;
        for warning in warnings {
            builder.warn(format!("material {id:?}"), warning);
        }
        ids.push(id);
    }
    Ok(ids)
}

fn surface(source: &tobj::Material, id: &Id) -> Result<(Material, Vec<String>), AssetError> {
    let mut warnings = Vec::new();
    let specular = source.specular.unwrap_or([0.0; 3]);
    let mut material = match source.illumination_model {
        Some(3 | 5) if specular != [0.0; 3] => Material {
            base_color: share(specular, id, "Ks", &mut warnings)?,
            metallic: 1.0,
            roughness: 0.0,
            ..Material::default()
        },
        Some(6 | 7) => {
            let ior = source.optical_density.unwrap_or(1.5);
            if !ior.is_finite() {
                return Err(bad(format!("material {id:?}"), "Ni", format!("is {ior}: must be finite")));
            }
            let ior = if ior >= 1.0 {
                ior as f32
            } else {
                warnings.push(format!("Ni {ior} is read as 1: an index of refraction is at least 1"));
                1.0
            };
            Material { transmission: 1.0, roughness: 0.0, ior, ..Material::default() }
        }
        _ => {
            // Without `Kd` the MTL specification says nothing; grey as for no material at all.
            let diffuse = source.diffuse.unwrap_or([0.5; 3]);
            Material::lambert(share(diffuse, id, "Kd", &mut warnings)?)
        }
    };
    if let Some(emission) = source.emissive {
        material.emission = Rgb::from(emission.map(|value| if value < 0.0 { 0.0 } else { value as f32 }));
    }
    if source.dissolve.is_some_and(|opacity| opacity < 1.0) && material.transmission == 0.0 {
        warnings.push("d (opacity) is left out: the surface is shown opaque".into());
    }
    Ok((material, warnings))
}

fn share(
    value: [f64; 3],
    id: &Id,
    field: &'static str,
    warnings: &mut Vec<String>,
) -> Result<Rgb, AssetError> {
    if let Some(value) = value.iter().find(|value| !value.is_finite()) {
        return Err(bad(format!("material {id:?}"), field, format!("is {value}: must be finite")));
    }
    let inside = value.map(|value| value.clamp(0.0, 1.0));
    if inside != value {
        warnings.push(format!("{field} {value:?} is read as {inside:?}: a share lies between 0 and 1"));
    }
    Ok(Rgb::from(inside.map(|value| value as f32)))
}

/// Pictures by the name that the MTL gives them.
struct Pictures<'a> {
    folder: &'a mut Folder,
    limits: &'a AssetLimits,
    loaded: HashMap<String, Option<Id>>,
    names: Names,
}

impl Pictures<'_> {
    fn load(
        &mut self,
        map: &str,
        material: &Id,
        builder: &mut SceneBuilder,
        warnings: &mut Vec<String>,
    ) -> Result<Option<Id>, AssetError> {
        let mut name = map;
        if map.starts_with('-') {
            warnings.push("options of map_Kd are left out".into());
            name = map.split_whitespace().next_back().unwrap_or(map);
        }
        let name = name.replace('\\', "/");
        if let Some(loaded) = self.loaded.get(&name) {
            return Ok(loaded.clone());
        }
        let object = format!("material {material:?}");
        let bytes = match self.folder.read(&object, &name) {
            Err(AssetError::Missing { source, .. }) => {
                warnings.push(format!("map_Kd {name:?} cannot be read ({source}): shown without"));
                self.loaded.insert(name, None);
                return Ok(None);
            }
            other => other?,
        };
        let refuse = |problem: String| bad(object.clone(), "map_Kd", format!("{name:?}: {problem}"));
        let size = pictures::size(&bytes).map_err(refuse)?;
        let bound = Bound { what: "texels", limit: self.limits.image_pixels_max, setting: "image_texels" };
        bound.check(&object, size.pixels())?;
        let taken: u64 =
            builder.scene().textures().values().map(|texture| texture.texel_count() as u64).sum();
        let all = Bound {
            what: "texels in all textures",
            limit: builder.limits().texels_max,
            setting: "scene_texels",
        };
        all.check(&object, taken + size.pixels())?;
        let picture = pictures::decode(&bytes, size).map_err(refuse)?;
        let id =
            self.names.unique(&[Some(&name)], "texture", |id| builder.scene().textures().contains_key(id));
        if picture.was_deeper {
            builder.warn(
                format!("texture {id:?}"),
                "has more than 8 bits a channel: the lower ones are left out",
            );
        }
        builder.add_texture(id.clone(), picture.texture)?;
        self.loaded.insert(name, Some(id.clone()));
        Ok(Some(id))
    }
}
