//! Addresses in glTF: data URIs [RFC 2397] with base64 or percent-encoding, and files beside the scene.

use std::borrow::Cow;

use base64::{
    Engine, alphabet,
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig},
};

use crate::assets::{
    error::{AssetError, bad},
    folder::Folder,
};

/// Exporters disagree on padding and on the last bits.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// The bytes behind an address, as asked for by `object`.
pub(super) fn read(uri: &str, object: &str, folder: &mut Folder) -> Result<Vec<u8>, AssetError> {
    let is_data = uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"));
    if !is_data {
        let path = percent_decoded(uri.as_bytes());
        let path = String::from_utf8(path.into_owned())
            .map_err(|_| bad(object, "uri", "is not UTF-8 after percent-decoding"))?;
        return folder.read(object, &path);
    }
    let Some((kind, payload)) = uri[5..].split_once(',') else {
        return Err(bad(object, "uri", "is a data URI without a comma, so it holds no data"));
    };
    // Both encodings only shrink, so the text's length bounds what decoding takes.
    let is_base64 = kind.rsplit(';').next().is_some_and(|last| last.trim().eq_ignore_ascii_case("base64"));
    let size = if is_base64 { payload.len() as u64 / 4 * 3 } else { payload.len() as u64 };
    folder.take_bytes(object, size)?;
    let payload = percent_decoded(payload.as_bytes());
    if !is_base64 {
        return Ok(payload.into_owned());
    }
    BASE64.decode(payload).map_err(|error| bad(object, "uri", format!("is not base64: {error}")))
}

/// `%41` → `A`; a percent sign that two hexadecimal digits do not follow stays.
fn percent_decoded(text: &[u8]) -> Cow<'_, [u8]> {
    if !text.contains(&b'%') {
        return Cow::Borrowed(text);
    }
    let digit = |at: usize| text.get(at).and_then(|byte| char::from(*byte).to_digit(16));
    let mut decoded = Vec::with_capacity(text.len());
    let mut at = 0;
    while at < text.len() {
        match (text[at], digit(at + 1), digit(at + 2)) {
            (b'%', Some(high), Some(low)) => {
                decoded.push((high * 16 + low) as u8);
                at += 3;
            }
            (byte, ..) => {
                decoded.push(byte);
                at += 1;
            }
        }
    }
    Cow::Owned(decoded)
}
