//! Pictures on surfaces: where they lie, what they feed, and the holes that masks cut.

use glam::{Affine2, DMat3, Vec2, Vec3, Vec4};

use super::*;
use crate::{
    scene::{Filter, Id, Texels, Texture, TextureRef, TextureSlot, Wrap, samples},
    technique::path::closed_forms::{asymmetric_room, id, picture, square},
};

/// `[h × w]` bytes with as little pattern as possible, the last a share of opacity.
fn noise(width: u32, height: u32) -> Texture {
    let byte = |number: u32| (number.wrapping_mul(0x9e37_79b9) >> 23) as u8;
    let texel = |i: u32| [byte(4 * i), byte(4 * i + 1), byte(4 * i + 2), byte(4 * i + 3)];
    picture(width, height, &(0..width * height).map(texel).collect::<Vec<_>>())
}

fn noise_of_floats(width: u32, height: u32) -> Texture {
    let Texels::Rgba8(bytes) = noise(width, height).texels else { unreachable!() };
    let texels = bytes.into_iter().map(|texel| texel.map(|byte| f32::from(byte) / 255.0));
    Texture { width, height, texels: Texels::Rgba32F(texels.collect()) }
}

/// A square with two sets of coordinates, the second a turned and stretched one.
fn painted_square(material: &Id, scale: f64) -> MeshSource {
    let mut mesh = square(material);
    mesh.positions.iter_mut().for_each(|p| *p *= scale);
    mesh.texcoords[1] = mesh.texcoords[0].iter().map(|uv| Vec2::new(0.3 - 1.7 * uv.y, 2.3 * uv.x)).collect();
    mesh
}

/// Squares in a grid, each of a material of its own, before a camera that sees them all.
fn gallery(texture: &Texture, materials: Vec<Material>) -> Shot {
    shot(hung(texture, materials).finish())
}

fn hung(texture: &Texture, materials: Vec<Material>) -> Stage {
    let mut stage = room();
    stage.builder().add_texture(id("picture"), texture.clone()).unwrap();
    let columns = materials.len().div_ceil(3);
    for (i, material) in materials.into_iter().enumerate() {
        let name = format!("painted {i}");
        let material = stage.material(&name, material).unwrap();
        let (column, row) = (i % columns, i / columns);
        let at =
            DVec3::new((column as f64 + 0.5) * 2.4 / columns as f64 - 1.2, 0.55 * row as f64 - 0.65, 0.0);
        let place = DAffine3::from_translation(at) * DAffine3::from_rotation_y(0.3);
        stage.place(&name, painted_square(&material, 0.25), place).unwrap();
    }
    stage
}

/// Squares with pictures, and some whose normals are bent by one.
pub(super) fn bent_and_textured() -> Stage {
    use TextureSlot::*;
    let reference = TextureRef::new(id("picture"));
    let matt = Material::lambert(Rgb::splat(0.8));
    let bent = Material { normal_scale: 0.4, ..matt.clone() };
    let plastic = Material { roughness: 0.4, ..Material::default() };
    let lamp = Material { double_sided: true, emission: Rgb::new(4.0, 3.0, 2.0), ..Material::default() };
    let materials = vec![
        using(&[BaseColor], &reference, matt),
        using(&[Normal], &reference, bent.clone()),
        using(&[Normal, BaseColor], &reference, bent),
        using(&[BaseColor, MetallicRoughness], &reference, Material { metallic: 0.8, ..Material::default() }),
        using(&[Specular, SpecularColor, BaseColor], &reference, plastic),
        using(&[Emission], &reference, lamp),
    ];
    hung(&noise(6, 5), materials)
}

fn using(slots: &[TextureSlot], reference: &TextureRef, material: Material) -> Material {
    let mut material = material;
    for slot in slots {
        material.textures[*slot as usize] = Some(reference.clone());
    }
    material
}

/// Every wrap along u and v, filter, coordinate set and transform, of bytes and floats, beyond the borders.
#[test]
fn pictures_are_looked_up_the_same_everywhere() {
    let Some(gpu) = shared() else { return };
    let wraps = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];
    let lamp = Material::emitter(Rgb::splat(0.9));
    let matt = Material::lambert(Rgb::splat(0.9));
    for (name, texture, slot, material) in [
        ("bytes", noise(5, 3), TextureSlot::BaseColor, &matt),
        ("a texel", noise(1, 1), TextureSlot::BaseColor, &matt),
        ("floats", noise_of_floats(7, 4), TextureSlot::Emission, &lamp),
    ] {
        let mut materials = Vec::new();
        for filter in [Filter::Nearest, Filter::Bilinear] {
            for (i, wrap_u) in wraps.into_iter().enumerate() {
                for (k, wrap_v) in wraps.into_iter().enumerate() {
                    let turned = Affine2::from_scale_angle_translation(
                        Vec2::new(2.7, -1.9),
                        0.4 * i as f32,
                        Vec2::new(-0.7, 3.2 * k as f32),
                    );
                    let texcoord_set = (i + k) as u8 % 2;
                    let reference = TextureRef {
                        texcoord_set,
                        uv_transform: turned,
                        wrap_u,
                        wrap_v,
                        filter,
                        ..TextureRef::new(id("picture"))
                    };
                    materials.push(using(&[slot], &reference, material.clone()));
                }
            }
        }
        gallery(&texture, materials).is_alike(&gpu, name);
    }
}

/// A picture feeds what its slot says: colour from sRGB, numbers as they are.
#[test]
fn pictures_feed_every_slot_the_same() {
    use TextureSlot::*;
    let Some(gpu) = shared() else { return };
    let reference = TextureRef::new(id("picture"));
    let smooth = Material { roughness: 0.6, metallic: 0.8, ..Material::default() };
    let glass = Material { transmission: 0.8, roughness: 0.0, ..Material::default() };
    let lamp = Material { double_sided: true, emission: Rgb::new(4.0, 3.0, 2.0), ..Material::default() };
    let plastic = Material { roughness: 0.4, ..Material::default() };
    let materials = vec![
        using(&[BaseColor], &reference, Material::lambert(Rgb::WHITE)),
        using(&[MetallicRoughness], &reference, Material { metallic: 1.0, ..Material::default() }),
        using(&[BaseColor, MetallicRoughness], &reference, smooth),
        using(&[Specular], &reference, plastic.clone()),
        using(&[SpecularColor], &reference, plastic.clone()),
        using(&[Specular, SpecularColor, BaseColor], &reference, plastic),
        using(&[Transmission], &reference, glass.clone()),
        using(&[Transmission, MetallicRoughness, BaseColor], &reference, Material { metallic: 1.0, ..glass }),
        using(&[Emission], &reference, lamp.clone()),
        using(&[Emission, BaseColor], &reference, Material { double_sided: false, ..lamp }),
        using(&[BaseColor], &reference, Material { unlit: true, ..Material::default() }),
        using(&[Normal], &reference, Material { normal_scale: 0.4, ..Material::lambert(Rgb::splat(0.8)) }),
    ];
    gallery(&noise(6, 5), materials).is_alike(&gpu, "slots");
}

/// Colours of vertices tint, and are interpolated.
#[test]
fn vertex_colours_tint_the_same() {
    let Some(gpu) = shared() else { return };
    let mut stage = room();
    let material = stage.material("tinted", Material { roughness: 0.5, ..Material::default() }).unwrap();
    let mut mesh = samples::sphere(DVec3::ZERO, 0.9, 12, &material);
    mesh.colors = mesh.normals.iter().map(|n| (*n * 0.5 + 0.5).extend(1.0)).collect();
    placed(&mut stage, "ball", mesh);
    shot(stage.finish()).is_alike(&gpu, "vertex colours");
}

/// A room with holes that masks cut by texture, factor and vertex colour, into surfaces and a lamp.
pub(super) fn masked() -> Scene {
    let mut stage = room();
    stage.builder().add_texture(id("picture"), noise(9, 9)).unwrap();
    for (name, filter, at) in [
        ("sieve", Filter::Nearest, DVec3::new(-0.5, 0.1, 0.5)),
        ("smooth sieve", Filter::Bilinear, DVec3::new(0.6, 0.1, 0.3)),
        ("shade", Filter::Nearest, DVec3::new(0.0, 1.6, 0.2)),
    ] {
        let reference = TextureRef { filter, ..TextureRef::new(id("picture")) };
        let cut = Material { alpha: 0.9, alpha_cutoff: Some(0.4), ..Material::lambert(Rgb::splat(0.7)) };
        let cut = stage.material(name, using(&[TextureSlot::BaseColor], &reference, cut)).unwrap();
        let colors = [0.6, 0.8, 1.0, 1.0].map(|alpha| Vec4::new(1.0, 0.9, 0.8, alpha)).to_vec();
        let mesh = MeshSource { colors, ..painted_square(&cut, 0.5) };
        let turn =
            if name == "shade" { DAffine3::from_rotation_x(1.5) } else { DAffine3::from_rotation_y(0.4) };
        stage.place(name, mesh, DAffine3::from_translation(at) * turn).unwrap();
    }
    // Bytes of texels are cut at 0.4 of 255 exactly nowhere, so nothing hangs by a rounding but borders.
    let reference = TextureRef { filter: Filter::Nearest, ..TextureRef::new(id("picture")) };
    let lamp = Material {
        alpha_cutoff: Some(0.55),
        double_sided: true,
        ..Material::emitter(Rgb::new(5.0, 4.0, 3.0))
    };
    let lamp = using(&[TextureSlot::BaseColor, TextureSlot::Emission], &reference, lamp);
    let lamp = stage.material("cut lamp", lamp).unwrap();
    let place = DAffine3::from_translation(DVec3::new(-1.2, 0.8, 0.0)) * DAffine3::from_rotation_y(0.9);
    stage.place("cut lamp", painted_square(&lamp, 0.5), place).unwrap();
    stage.finish()
}

/// Masks cut holes for eyes, for shadows and into lamps.
#[test]
fn masks_cut_the_same_holes() {
    let Some(gpu) = shared() else { return };
    shot(masked()).is_alike(&gpu, "masks");
}

/// Normal maps bend the same way, with tangents given or found, on turned, stretched, sheared and mirrored nodes.
#[test]
fn normal_maps_bend_the_same_way_on_any_node() {
    let Some(gpu) = shared() else { return };
    let shear = DMat3::from_cols(DVec3::X, DVec3::new(0.6, 1.0, 0.0), DVec3::new(0.0, -0.3, 1.2));
    for (name, turn) in [
        ("plain", DMat3::IDENTITY),
        ("turned", DMat3::from_rotation_y(0.5)),
        ("mirrored", DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))),
        ("stretched and mirrored", DMat3::from_diagonal(DVec3::new(1.4, -0.8, 1.1))),
        ("sheared", shear),
    ] {
        let eye = DVec3::new(0.7, 0.8, 2.6);
        let (scene, camera) = asymmetric_room(|mesh| mesh, DAffine3::from_mat3(turn), eye);
        Shot { camera, ..shot(scene) }.is_alike(&gpu, &format!("normal maps, {name}"));
    }
}

/// Normals of vertices go with sheared and mirrored nodes; zero ones stand for the triangle's own.
#[test]
fn smooth_normals_turn_the_same_way_on_any_node() {
    let Some(gpu) = shared() else { return };
    let mut stage = room();
    let matt = stage.material("matt", Material { roughness: 0.3, ..Material::default() }).unwrap();
    let mut ball = samples::sphere(DVec3::new(0.1, 0.2, -0.1), 0.5, 8, &matt);
    ball.normals.iter_mut().step_by(11).for_each(|n| *n = Vec3::ZERO);
    let shear = DMat3::from_cols(DVec3::X, DVec3::new(0.7, 1.0, 0.2), DVec3::new(0.0, -0.3, 0.6));
    let mirror = DMat3::from_diagonal(DVec3::new(-1.0, 0.7, 1.3));
    for (name, turn, x) in [("sheared", shear, -0.8), ("mirrored", mirror, 0.6)] {
        let place = DAffine3::from_mat3_translation(turn, DVec3::X * x);
        stage.place(name, ball.clone(), place).unwrap();
    }
    shot(stage.finish()).is_alike(&gpu, "smooth normals");
}

/// Lamps that are cut by what their picture shows, steep bumps seen along them, and a lamp in the plane of the wall light what they do on the CPU.
#[test]
fn lamps_with_pictures_and_lamps_in_walls_light_the_same() {
    let Some(gpu) = shared() else { return };
    let nearest = TextureRef { filter: Filter::Nearest, ..TextureRef::new(id("picture")) };
    let matt = Material::lambert(Rgb::splat(0.8));
    let coated = Material { roughness: 0.5, ..Material::default() };
    let mut stage = hung(
        &noise(16, 16),
        vec![
            using(&[TextureSlot::Emission], &nearest, Material::emitter(Rgb::new(4.0, 3.0, 2.0))),
            using(&[TextureSlot::Normal], &nearest, matt),
            using(&[TextureSlot::Normal], &nearest, coated),
        ],
    );
    let kind = LightKind::Point { intensity: Rgb::new(2.0, 3.0, 4.0) };
    let position = DVec3::new(0.4, 0.9, -2.0);
    stage.light("in the wall", Light { parent: None, position, direction: DVec3::NEG_Y, kind }).unwrap();
    shot(stage.finish()).is_alike(&gpu, "cut, bumpy and in the wall");
}
