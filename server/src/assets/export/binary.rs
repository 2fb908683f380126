//! The binary chunk with its views and accessors, and the GLB around it.

use serde_json::{Map, Value, json};

use super::failed;
use crate::assets::error::AssetError;

/// `ARRAY_BUFFER` and `ELEMENT_ARRAY_BUFFER` of OpenGL, which glTF quotes.
pub(super) const VERTICES: Option<u32> = Some(34_962);
pub(super) const INDICES: Option<u32> = Some(34_963);

/// Bytes, and how glTF finds its way in them.
#[derive(Debug, Default)]
pub(super) struct Binary {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Binary {
    /// Adds bytes; gives the view's index.
    pub(super) fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        // Four bytes suit every component type.
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bytes.extend_from_slice(bytes);
        self.views.push(view);
        self.views.len() - 1
    }

    /// Adds vectors of floats; gives the accessor's index.
    pub(super) fn floats<const N: usize>(&mut self, vectors: impl Iterator<Item = [f32; N]>) -> usize {
        let bytes: Vec<u8> = vectors.flatten().flat_map(f32::to_le_bytes).collect();
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1];
        let accessor = json!({
            "bufferView": self.view(&bytes, VERTICES), "componentType": 5126, "count": bytes.len() / (4 * N), "type": kind,
        });
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Adds positions, with the bounds that glTF asks for.
    pub(super) fn positions(&mut self, positions: &[[f32; 3]]) -> usize {
        let index = self.floats(positions.iter().copied());
        let bound = |pick: fn(f32, f32) -> f32| -> Option<[f32; 3]> {
            positions.iter().copied().reduce(|a, b| std::array::from_fn(|axis| pick(a[axis], b[axis])))
        };
        self.accessors[index]["min"] = json!(bound(f32::min));
        self.accessors[index]["max"] = json!(bound(f32::max));
        index
    }

    /// Adds vertex indices below `vertex_count`, in 16 bits where they fit (65535 is reserved).
    pub(super) fn indices(&mut self, indices: impl Iterator<Item = u32>, vertex_count: usize) -> usize {
        let (bytes, kind, size): (Vec<u8>, _, _) = if vertex_count <= usize::from(u16::MAX) {
            (indices.flat_map(|index| (index as u16).to_le_bytes()).collect(), 5123, 2)
        } else {
            (indices.flat_map(u32::to_le_bytes).collect(), 5125, 4)
        };
        let accessor = json!({
            "bufferView": self.view(&bytes, INDICES), "componentType": kind, "count": bytes.len() / size, "type": "SCALAR",
        });
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// The finished file.
    pub(super) fn into_glb(mut self, mut root: Map<String, Value>) -> Result<Vec<u8>, AssetError> {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        if !self.views.is_empty() {
            root.insert("buffers".into(), json!([{ "byteLength": self.bytes.len() }]));
            root.insert("bufferViews".into(), Value::Array(self.views));
        }
        if !self.accessors.is_empty() {
            root.insert("accessors".into(), Value::Array(self.accessors));
        }
        let mut json = serde_json::to_vec(&root).map_err(|error| failed("JSON".into(), error.to_string()))?;
        json.resize(json.len().next_multiple_of(4), b' ');
        let binary_bytes = if self.bytes.is_empty() { 0 } else { 8 + self.bytes.len() };
        let whole = 12 + 8 + json.len() + binary_bytes;
        let Ok(length) = u32::try_from(whole) else {
            return Err(failed(
                "scene".into(),
                format!("{whole} bytes do not fit a GLB, which ends at 4 GiB"),
            ));
        };
        let mut glb = Vec::with_capacity(whole);
        glb.extend_from_slice(b"glTF");
        glb.extend(2u32.to_le_bytes());
        glb.extend(length.to_le_bytes());
        let mut chunk = |kind: &[u8; 4], bytes: &[u8]| {
            // Below the whole, which fits.
            glb.extend((bytes.len() as u32).to_le_bytes());
            glb.extend_from_slice(kind);
            glb.extend_from_slice(bytes);
        };
        chunk(b"JSON", &json);
        if !self.bytes.is_empty() {
            chunk(b"BIN\0", &self.bytes);
        }
        Ok(glb)
    }
}
