//! Materials and textures of glTF.

use glam::{Vec2, Vec4};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use lumicast_engine::{
    math::Rgb,
    scene::{Encoding, Filter, Material, Scene, TextureSlot, Wrap},
};
use serde_json::{Value, json};

use super::{
    OnDisk,
    glb::{Glb, data_uri, png},
    load, warnings, warns,
};

const CHECKS: [[u8; 4]; 4] = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 0]];

fn only_material(scene: &Scene) -> &Material {
    assert_eq!(scene.materials().len(), 1);
    &scene.materials()[0]
}

#[track_caller]
fn material(json: Value) -> Material {
    let scene = Glb::with_material(json).scene();
    assert!(scene.warnings().is_empty(), "{:?}", scene.warnings());
    only_material(&scene).clone()
}

/// glTF's defaults, and every factor of the core and of the extensions, arrive where they belong.
#[test]
fn every_factor_arrives() {
    assert_eq!(material(json!({})), Material { metallic: 1.0, ..Material::default() });
    let all = material(json!({
        "name": "all",
        "pbrMetallicRoughness": { "baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.0 },
        "emissiveFactor": [1.0, 0.5, 0.25],
        "doubleSided": true,
        "alphaMode": "MASK", "alphaCutoff": 0.75,
        "extensions": {
            "KHR_materials_emissive_strength": { "emissiveStrength": 8.0 },
            "KHR_materials_ior": { "ior": 1.25 },
            "KHR_materials_specular": { "specularFactor": 0.25, "specularColorFactor": [2.0, 1.0, 0.5] },
            "KHR_materials_transmission": { "transmissionFactor": 0.75 },
            "KHR_materials_volume": { "thicknessFactor": 0.0, "attenuationDistance": 0.5, "attenuationColor": [0.5, 0.6, 0.7] },
            "KHR_materials_unlit": {},
        },
    }));
    let expected = Material {
        base_color: Rgb::new(0.1, 0.2, 0.3),
        alpha: 0.4,
        metallic: 0.5,
        roughness: 0.0,
        ior: 1.25,
        specular: 0.25,
        specular_color: Rgb::new(2.0, 1.0, 0.5),
        transmission: 0.75,
        attenuation_color: Rgb::new(0.5, 0.6, 0.7),
        attenuation_distance_m: 0.5,
        emission: Rgb::new(8.0, 4.0, 2.0),
        double_sided: true,
        unlit: true,
        alpha_cutoff: Some(0.75),
        ..Material::default()
    };
    assert_eq!(all, expected);
}

/// Numbers outside their range are clamped, and one warning each names material and field.
#[test]
fn odd_numbers_are_clamped_and_told() {
    let odd = |json: Value, parts: &[&str]| {
        let scene = Glb::with_material(json).scene();
        warns(&scene, parts);
        only_material(&scene).clone()
    };
    let red = odd(
        json!({ "name": "m", "pbrMetallicRoughness": { "baseColorFactor": [1.5, 0.5, 0.5, 1.0] } }),
        &["material \"m\"", "baseColorFactor", "1.5"],
    );
    assert_eq!(red.base_color, Rgb::new(1.0, 0.5, 0.5));
    let metal = odd(json!({ "pbrMetallicRoughness": { "metallicFactor": -1.0 } }), &["metallicFactor", "-1"]);
    assert_eq!(metal.metallic, 0.0);
    let dark = odd(json!({ "emissiveFactor": [-1.0, 0.0, 0.0] }), &["emissiveFactor"]);
    assert!(dark.emission.is_black());
    let ior = |ior: f32| json!({ "extensions": { "KHR_materials_ior": { "ior": ior } } });
    assert_eq!(odd(ior(0.5), &["ior", "0.5"]).ior, 1.0);
    assert_eq!(odd(ior(0.0), &["ior", "1000"]).ior, 1000.0);
    let volume = json!({ "extensions": { "KHR_materials_volume": { "attenuationDistance": 0.0 } } });
    assert_eq!(odd(volume, &["attenuationDistance"]).attenuation_distance_m, f32::INFINITY);
    let blend = odd(json!({ "alphaMode": "BLEND" }), &["BLEND", "mask at 0.5"]);
    assert_eq!(blend.alpha_cutoff, Some(0.5));
    let rough_glass = json!({
        "pbrMetallicRoughness": { "roughnessFactor": 0.5 },
        "extensions": { "KHR_materials_transmission": { "transmissionFactor": 1.0 } },
    });
    odd(rough_glass, &["roughness 0.5", "smooth"]);
    Glb::with_material(json!({ "emissiveFactor": [1e39, 0.0, 0.0] })).refused(&[
        "material 0",
        "emissiveFactor",
        "finite",
    ]);
}

/// Each texture of a material arrives in its slot, with its set, its sampler and its transform.
#[test]
fn textures_arrive_in_their_slots() {
    let mut glb = Glb::textured(&png(2, 2, &CHECKS));
    let transform = |set: u32| json!({ "KHR_texture_transform": { "offset": [0.5, 0.25], "scale": [2.0, 4.0], "texCoord": set } });
    glb.attribute("TEXCOORD_1", 2);
    glb.root["samplers"] = json!([{ "wrapS": 33071, "wrapT": 33648, "magFilter": 9728 }]);
    glb.root["textures"] = json!([{ "source": 0, "sampler": 0 }, { "source": 0 }]);
    glb.root["materials"][0] = json!({
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": 0, "extensions": transform(1) },
            "metallicRoughnessTexture": { "index": 1, "texCoord": 1 },
        },
        "normalTexture": { "index": 1, "scale": 0.5, "extensions": transform(0) },
        "occlusionTexture": { "index": 1 },
        "emissiveTexture": { "index": 1 },
        "extensions": {
            "KHR_materials_specular": { "specularTexture": { "index": 0 }, "specularColorTexture": { "index": 1 } },
            "KHR_materials_transmission": { "transmissionTexture": { "index": 1 } },
        },
    });
    let scene = glb.scene();
    assert!(scene.warnings().is_empty(), "{:?}", scene.warnings());
    assert_eq!(scene.textures().len(), 1);
    let material = only_material(&scene);
    assert!(TextureSlot::ALL.iter().all(|slot| material.texture(*slot).is_some()));
    let base = material.texture(TextureSlot::BaseColor).expect("base colour");
    assert_eq!((base.wrap_u, base.wrap_v, base.filter), (Wrap::Clamp, Wrap::Mirror, Filter::Nearest));
    assert_eq!(base.texcoord_set, 1);
    assert_eq!(base.uv_transform.transform_point2(Vec2::new(1.0, 1.0)), Vec2::new(2.5, 4.25));
    let normal = material.texture(TextureSlot::Normal).expect("normal");
    assert_eq!((normal.texcoord_set, material.normal_scale), (0, 0.5));
    assert_eq!(normal.uv_transform, base.uv_transform);
    assert_eq!(material.texture(TextureSlot::MetallicRoughness).map(|texture| texture.texcoord_set), Some(1));
}

/// A picture lies as glTF says: first row on top, sRGB, alpha as it is.
#[test]
fn texels_lie_where_gltf_puts_them() {
    let scene = Glb::textured(&png(2, 2, &CHECKS)).scene();
    let texture = &scene.textures()[0];
    assert_eq!(texture.texel(0, 0, Encoding::Srgb), Vec4::new(1.0, 0.0, 0.0, 1.0));
    assert_eq!(texture.texel(1, 1, Encoding::Srgb), Vec4::new(1.0, 1.0, 1.0, 0.0));
    let reference = only_material(&scene).texture(TextureSlot::BaseColor).expect("base colour");
    assert_eq!(
        reference.sample(texture, Vec2::new(0.25, 0.75), Encoding::Linear),
        Vec4::new(0.0, 0.0, 1.0, 1.0)
    );
}

/// A positive rotation turns counter-clockwise as seen on the picture, where v points down.
#[test]
fn texture_rotation_turns_counter_clockwise() {
    let mut glb = Glb::textured(&png(2, 2, &CHECKS));
    let info = &mut glb.root["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"];
    info["extensions"] = json!({ "KHR_texture_transform": { "rotation": std::f32::consts::FRAC_PI_2 } });
    let scene = glb.scene();
    let reference = only_material(&scene).texture(TextureSlot::BaseColor).expect("base colour");
    let turned = reference.uv_transform.transform_point2(Vec2::X);
    assert!((turned - Vec2::NEG_Y).length() < 1e-6, "{turned}");
}

/// Pictures come from views, data URIs and files; equal ones become one texture.
#[test]
fn equal_pictures_are_shared() {
    let picture = png(2, 2, &CHECKS);
    let mut glb = Glb::textured(&picture);
    glb.root["images"] =
        json!([glb.root["images"][0], { "uri": data_uri(&picture) }, { "uri": "beside.png" }]);
    glb.root["textures"] = json!([{ "source": 0 }, { "source": 1 }, { "source": 2 }]);
    glb.root["materials"] = json!([0, 1, 2].map(|index| json!({ "emissiveTexture": { "index": index } })));
    let scene =
        OnDisk::new("test.glb", &glb.bytes()).with("beside.png", &picture).load().expect("three sources");
    assert_eq!((scene.textures().len(), scene.materials().len()), (1, 3));
    let other = png(1, 1, &CHECKS[..1]);
    let scene =
        OnDisk::new("test.glb", &glb.bytes()).with("beside.png", &other).load().expect("three sources");
    assert_eq!(scene.textures().len(), 2);
    let error = load("test.glb", &glb.bytes()).expect_err("missing picture").to_string();
    assert!(error.contains("image 2") && error.contains("beside.png"), "{error}");
}

/// 16-bit pictures lose their lower bits and say so; grey ones become grey.
#[test]
fn deep_and_grey_pictures_become_eight_bit_rgba() {
    let mut deep = Vec::new();
    PngEncoder::new(&mut deep).write_image(&[0x80, 0x80], 1, 1, ExtendedColorType::L16).expect("PNG");
    let scene = Glb::textured(&deep).scene();
    warns(&scene, &["texture \"picture\"", "8 bits"]);
    assert_eq!(
        scene.textures()[0].texel(0, 0, Encoding::Linear) * 255.0,
        Vec4::new(128.0, 128.0, 128.0, 255.0)
    );
}

/// Look-ups that cannot be had are left out with a warning: a third set, a picture for an unread extension,
/// a mesh without coordinates.
#[test]
fn impossible_look_ups_are_told() {
    let picture = png(2, 2, &CHECKS);
    let mut glb = Glb::textured(&picture);
    glb.root["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = json!(2);
    let scene = glb.scene();
    warns(&scene, &["paint", "third set"]);
    assert!(only_material(&scene).texture(TextureSlot::BaseColor).is_none());

    let mut glb = Glb::textured(&picture);
    glb.root["textures"][0] = json!({ "extensions": { "EXT_texture_webp": { "source": 0 } } });
    warns(&glb.scene(), &["paint", "without a PNG or JPEG"]);

    let mut glb = Glb::textured(&picture);
    glb.root["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = json!(1);
    warns(&glb.scene(), &["square", "TEXCOORD_1", "paint"]);

    let mut glb = Glb::textured(&picture);
    glb.root["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"] = json!(5);
    glb.refused(&["material 0", "texture index", "is 5"]);
    let mut glb = Glb::textured(b"GIF89a no picture");
    glb.refused(&["image 0 \"picture\"", "header"]);
    glb.root["images"][0] = json!({});
    glb.refused(&["image 0", "uri", "missing"]);
}

/// Animations, skins and morph targets are left out and told.
#[test]
fn what_moves_stands_still_and_is_told() {
    let mut glb = Glb::square();
    glb.root["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": 0 }]);
    glb.root["skins"] = json!([{ "joints": [0] }]);
    glb.root["animations"] = json!([{ "channels": [], "samplers": [] }]);
    let told = warnings(&glb.scene());
    assert_eq!(told.len(), 3, "{told:?}");
    for word in ["animations", "skins", "morph targets"] {
        assert!(told.iter().any(|warning| warning.contains(word)), "{word} is not in {told:?}");
    }
}
