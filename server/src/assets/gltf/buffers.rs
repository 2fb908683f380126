//! Buffers and views: bytes by index, every range checked.

use std::borrow::Cow;

use ::gltf::json::{Root, buffer};

use super::{document::at, uris};
use crate::assets::{
    error::{AssetError, bad},
    folder::Folder,
};

/// All bytes that a file's accessors and images may refer to.
#[derive(Debug)]
pub(super) struct Buffers<'a> {
    views: &'a [buffer::View],
    /// `None`: an extension was to fill it.
    buffers: Vec<Option<Cow<'a, [u8]>>>,
}

/// A run of bytes, perhaps of elements that do not touch.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<'a> {
    pub(super) bytes: &'a [u8],
    /// From one element to the next; `None`: they touch.
    pub(super) stride: Option<usize>,
}

impl<'a> Buffers<'a> {
    /// Reads what lies beside the file and decodes data URIs. `bin`: the binary chunk of a GLB.
    pub(super) fn load(
        root: &'a Root,
        bin: Option<&'a [u8]>,
        folder: &mut Folder,
    ) -> Result<Buffers<'a>, AssetError> {
        let mut buffers = Vec::with_capacity(root.buffers.len());
        for (index, buffer) in root.buffers.iter().enumerate() {
            let object = format!("buffer {index}");
            let bytes: Option<Cow<'a, [u8]>> = match &buffer.uri {
                Some(uri) => Some(uris::read(uri, &object, folder)?.into()),
                // Only the first buffer may be the binary chunk [glTF 2.0, 4.4.3.3].
                None => bin.filter(|_| index == 0).map(Cow::Borrowed),
            };
            let length = bytes.as_ref().map_or(0, |bytes| bytes.len() as u64);
            if bytes.is_some() && buffer.byte_length.0 > length {
                let problem = format!(
                    "is {}, but there are {length} bytes: the file was cut off",
                    buffer.byte_length.0
                );
                return Err(bad(object, "byteLength", problem));
            }
            buffers.push(bytes);
        }
        Ok(Buffers { views: &root.buffer_views, buffers })
    }

    /// The view `index`, asked for by `user`.
    pub(super) fn view(&self, index: usize, user: &str) -> Result<View<'_>, AssetError> {
        let view = at(self.views, index, || user.into(), "bufferView")?;
        let object = || format!("bufferView {index}");
        let buffer_index = view.buffer.value();
        let Some(buffer) = at(&self.buffers, buffer_index, object, "buffer")? else {
            return Err(bad(object(), "buffer", format!("is {buffer_index}, which has no data")));
        };
        let offset = view.byte_offset.unwrap_or_default().0;
        let range = usize::try_from(offset)
            .ok()
            .zip(offset.checked_add(view.byte_length.0).and_then(|end| usize::try_from(end).ok()));
        let bytes = range.and_then(|(start, end)| buffer.get(start..end)).ok_or_else(|| {
            let (length, buffer) = (view.byte_length.0, buffer.len());
            bad(
                object(),
                "byteOffset",
                format!("{offset} and {length} bytes do not fit a buffer of {buffer}"),
            )
        })?;
        let stride = view.byte_stride.map(|stride| stride.0).filter(|stride| *stride != 0);
        Ok(View { bytes, stride })
    }
}
