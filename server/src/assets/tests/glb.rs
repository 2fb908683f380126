//! Writes tiny glTF files, good and bad ones.

use base64::Engine;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use lumicast_engine::scene::Scene;
use serde_json::{Value, json};

use crate::assets::AssetError;

pub(super) const U8: u32 = 5121;
pub(super) const I8: u32 = 5120;
pub(super) const U16: u32 = 5123;
pub(super) const U32: u32 = 5125;
pub(super) const F32: u32 = 5126;

/// A glTF file in the making: JSON that a test may bend as it likes, and its binary chunk.
#[derive(Clone, Debug)]
pub(super) struct Glb {
    pub(super) root: Value,
    pub(super) bin: Vec<u8>,
}

/// Little-endian bytes of floats.
pub(super) fn bytes_of<const N: usize>(vectors: &[[f32; N]]) -> Vec<u8> {
    vectors.iter().flatten().flat_map(|value| value.to_le_bytes()).collect()
}

/// An opaque picture as PNG.
pub(super) fn png(width: u32, height: u32, texels: &[[u8; 4]]) -> Vec<u8> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(texels.as_flattened(), width, height, ExtendedColorType::Rgba8)
        .expect("PNG of a test");
    bytes
}

pub(super) fn data_uri(bytes: &[u8]) -> String {
    format!(
        "data:application/octet-stream;base64,{}",
        base64::engine::general_purpose::STANDARD.encode(bytes)
    )
}

impl Glb {
    pub(super) fn new() -> Glb {
        Glb { root: json!({ "asset": { "version": "2.0" } }), bin: Vec::new() }
    }

    /// A unit square in the xy plane of two triangles, shown by one node: accessor 0 positions, 1 indices.
    pub(super) fn square() -> Glb {
        let mut glb = Glb::new();
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
        let positions = glb.floats(&corners);
        let indices = glb.accessor(&[0, 1, 2, 0, 2, 3], U8, "SCALAR", 6);
        glb.root["meshes"] = json!([{ "name": "square", "primitives": [{ "attributes": { "POSITION": positions }, "indices": indices }] }]);
        glb.root["nodes"] = json!([{ "name": "here", "mesh": 0 }]);
        glb.root["scenes"] = json!([{ "nodes": [0] }]);
        glb
    }

    /// A square with a material and an image over it, from texture coordinates that span the picture.
    pub(super) fn textured(picture: &[u8]) -> Glb {
        let mut glb = Glb::square();
        let texcoords = glb.floats(&[[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]);
        let view = glb.view(picture);
        glb.root["images"] = json!([{ "bufferView": view, "mimeType": "image/png", "name": "picture" }]);
        glb.root["textures"] = json!([{ "source": 0 }]);
        glb.root["materials"] =
            json!([{ "name": "paint", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]);
        glb.root["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(texcoords);
        glb.root["meshes"][0]["primitives"][0]["material"] = json!(0);
        glb
    }

    /// A square with one material.
    pub(super) fn with_material(material: Value) -> Glb {
        let mut glb = Glb::square();
        glb.root["materials"] = json!([material]);
        glb.root["meshes"][0]["primitives"][0]["material"] = json!(0);
        glb
    }

    fn push(&mut self, list: &str, value: Value) -> usize {
        let list = &mut self.root[list];
        if list.is_null() {
            *list = json!([]);
        }
        let list = list.as_array_mut().expect("a list");
        list.push(value);
        list.len() - 1
    }

    pub(super) fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let view = json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() });
        self.bin.extend_from_slice(bytes);
        self.push("bufferViews", view)
    }

    pub(super) fn accessor(&mut self, bytes: &[u8], component: u32, kind: &str, count: usize) -> usize {
        let view = self.view(bytes);
        self.push(
            "accessors",
            json!({ "bufferView": view, "componentType": component, "type": kind, "count": count }),
        )
    }

    pub(super) fn floats<const N: usize>(&mut self, vectors: &[[f32; N]]) -> usize {
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1];
        self.accessor(&bytes_of(vectors), F32, kind, vectors.len())
    }

    /// Sets an attribute of the only primitive.
    pub(super) fn attribute(&mut self, name: &str, accessor: usize) {
        self.root["meshes"][0]["primitives"][0]["attributes"][name] = json!(accessor);
    }

    /// As a `.glb`.
    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut root = self.root.clone();
        if !self.bin.is_empty() && root.get("buffers").is_none() {
            root["buffers"] = json!([{ "byteLength": self.bin.len() }]);
        }
        with_json(&serde_json::to_vec(&root).expect("JSON of a test"), &self.bin)
    }

    /// As a `.gltf` whose buffer has the given address.
    pub(super) fn gltf(&self, buffer_uri: &str) -> Vec<u8> {
        let mut root = self.root.clone();
        root["buffers"] = json!([{ "byteLength": self.bin.len(), "uri": buffer_uri }]);
        serde_json::to_vec(&root).expect("JSON of a test")
    }

    pub(super) fn load(&self) -> Result<Scene, AssetError> {
        super::load("test.glb", &self.bytes())
    }

    #[track_caller]
    pub(super) fn scene(&self) -> Scene {
        self.load().unwrap_or_else(|error| panic!("{error}"))
    }

    /// Asserts that loading fails with all of `parts` in the message.
    #[track_caller]
    pub(super) fn refused(&self, parts: &[&str]) {
        match self.load() {
            Ok(_) => panic!("loaded, but {parts:?} should have been refused"),
            Err(error) => {
                let message = error.to_string();
                assert!(
                    parts.iter().all(|part| message.contains(part)),
                    "{message:?} lacks some of {parts:?}"
                );
                assert!(message.contains("test.glb"), "{message:?} does not name the file");
            }
        }
    }
}

/// A GLB of any JSON, even of what is none.
pub(super) fn with_json(json: &[u8], bin: &[u8]) -> Vec<u8> {
    let padded = |bytes: &[u8], pad: u8| {
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), pad);
        bytes
    };
    let (json, bin) = (padded(json, b' '), padded(bin, 0));
    let mut glb = b"glTF".to_vec();
    glb.extend(2u32.to_le_bytes());
    glb.extend((12 + 8 + json.len() as u32 + 8 + bin.len() as u32).to_le_bytes());
    for (kind, bytes) in [(b"JSON", json), (b"BIN\0", bin)] {
        glb.extend((bytes.len() as u32).to_le_bytes());
        glb.extend_from_slice(kind);
        glb.extend(bytes);
    }
    glb
}
