//! The GLB container: a header of 12 bytes, a JSON chunk, a binary chunk [glTF 2.0, 4].

use std::borrow::Cow;

use crate::assets::error::{AssetError, bad};

const MAGIC: &[u8] = b"glTF";
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BIN_CHUNK: u32 = 0x004E_4942;

/// The parts of a glTF file.
#[derive(Debug)]
pub(super) struct Parts<'a> {
    pub(super) json: &'a [u8],
    pub(super) bin: Option<&'a [u8]>,
}

/// True for GLB and for JSON, told by the first bytes.
pub(in crate::assets) fn looks_like_gltf(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC) || without_mark(bytes).trim_ascii_start().starts_with(b"{")
}

/// Takes a `.glb` or `.gltf` apart.
pub(super) fn split(bytes: &[u8]) -> Result<Parts<'_>, AssetError> {
    if !bytes.starts_with(MAGIC) {
        return Ok(Parts { json: without_mark(bytes), bin: None });
    }
    let header = bytes.get(..12).ok_or_else(|| bad("GLB header", "length", "the file ends inside it"))?;
    let (version, length) = (number(&header[4..8]), number(&header[8..12]) as usize);
    if version != 2 {
        return Err(bad("GLB header", "version", format!("is {version}, but 2 is read")));
    }
    let Some(body) = bytes.get(12..length) else {
        let problem = format!("says {length} bytes, the file has {}: it was cut off", bytes.len());
        return Err(bad("GLB header", "length", problem));
    };
    let (kind, json, rest) = chunk(body, 0)?;
    if kind != JSON_CHUNK {
        return Err(bad("GLB chunk 0", "type", "is not JSON"));
    }
    if rest.is_empty() {
        return Ok(Parts { json, bin: None });
    }
    let (kind, bin, _) = chunk(rest, 1)?;
    // Chunks of unknown kinds are to be skipped [glTF 2.0, 4.4.3].
    Ok(Parts { json, bin: (kind == BIN_CHUNK).then_some(bin) })
}

fn chunk(bytes: &[u8], index: usize) -> Result<(u32, &[u8], &[u8]), AssetError> {
    let cut_off =
        || bad(format!("GLB chunk {index}"), "length", "the file ends inside the chunk: it was cut off");
    let (header, rest) = bytes.split_at_checked(8).ok_or_else(cut_off)?;
    let (content, rest) = rest.split_at_checked(number(&header[..4]) as usize).ok_or_else(cut_off)?;
    Ok((number(&header[4..]), content, rest))
}

fn number(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte))
}

/// Without the byte order mark that some editors leave.
fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes)
}

/// Names a file's content for messages: `mesh 3 "floor"`.
pub(super) fn label(kind: &str, index: usize, name: Option<&str>) -> Cow<'static, str> {
    match name {
        Some(name) => format!("{kind} {index} {:?}", name.chars().take(64).collect::<String>()).into(),
        None => format!("{kind} {index}").into(),
    }
}
