//! Accessors → numbers. Counts, offsets and strides are checked against the bytes before memory is taken.

use ::gltf::json::{
    Accessor,
    accessor::{ComponentType, Type, sparse::Sparse},
    validation::Checked,
};

use super::{
    buffers::{Buffers, View},
    document::at,
};
use crate::assets::error::{AssetError, Bound, bad};

/// Reads the accessors of one file.
#[derive(Debug)]
pub(super) struct Accessors<'a> {
    pub(super) accessors: &'a [Accessor],
    pub(super) buffers: &'a Buffers<'a>,
    pub(super) elements_max: u64,
}

/// Elements whose every byte is known to exist.
#[derive(Clone, Copy, Debug)]
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
    count: usize,
}

impl<'a> Elements<'a> {
    fn iter(self) -> impl Iterator<Item = &'a [u8]> {
        (0..self.count).map(move |index| &self.bytes[index * self.stride..index * self.stride + self.size])
    }
}

/// How the bytes of an element are to be read.
#[derive(Clone, Copy, Debug)]
struct Layout {
    component: ComponentType,
    normalized: bool,
    component_count: usize,
}

impl Layout {
    fn size(self) -> usize {
        self.component.size() * self.component_count
    }
}

impl<'a> Accessors<'a> {
    /// Number of elements and components of an accessor, checked against the bound for elements.
    pub(super) fn shape(
        &self,
        index: usize,
        user: &str,
        field: &'static str,
    ) -> Result<(usize, usize), AssetError> {
        let (accessor, layout) = self.accessor(index, user, field)?;
        Ok((accessor.count.0 as usize, layout.component_count))
    }

    /// Vectors of `N` numbers; integers become floats, normalised ones shares.
    pub(super) fn vectors<const N: usize>(
        &self,
        index: usize,
        user: &str,
        field: &'static str,
    ) -> Result<Vec<[f32; N]>, AssetError> {
        let (accessor, layout) = self.accessor(index, user, field)?;
        let object = format!("accessor {index}");
        if layout.component_count != N {
            let problem =
                format!("has {} components, but {field} of {user} needs {N}", layout.component_count);
            return Err(bad(object, "type", problem));
        }
        if layout.component == ComponentType::U32 {
            return Err(bad(
                object,
                "componentType",
                format!("is unsigned int, but {field} needs float or shorter integers"),
            ));
        }
        let mut vectors = vec![[0.0; N]; accessor.count.0 as usize];
        if let Some(elements) = self.base(accessor, layout, &object)? {
            for (vector, element) in vectors.iter_mut().zip(elements.iter()) {
                *vector = numbers(element, layout);
            }
        }
        if let Some(sparse) = &accessor.sparse {
            let (places, values) = self.sparse(sparse, accessor.count.0, layout, &object)?;
            for (place, element) in places.into_iter().zip(values.iter()) {
                vectors[place as usize] = numbers(element, layout);
            }
        }
        Ok(vectors)
    }

    /// Vertex indices of any integer type.
    pub(super) fn indices(&self, index: usize, user: &str) -> Result<Vec<u32>, AssetError> {
        let (accessor, layout) = self.accessor(index, user, "indices")?;
        let object = format!("accessor {index}");
        let is_index =
            matches!(layout.component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32);
        if !is_index || layout.component_count != 1 {
            return Err(bad(
                object,
                "componentType",
                format!("indices of {user} need scalar unsigned integers"),
            ));
        }
        let mut indices = match self.base(accessor, layout, &object)? {
            Some(elements) => elements.iter().map(whole_number).collect(),
            None => vec![0; accessor.count.0 as usize],
        };
        if let Some(sparse) = &accessor.sparse {
            let (places, values) = self.sparse(sparse, accessor.count.0, layout, &object)?;
            for (place, element) in places.into_iter().zip(values.iter()) {
                indices[place as usize] = whole_number(element);
            }
        }
        Ok(indices)
    }

    fn accessor(
        &self,
        index: usize,
        user: &str,
        field: &'static str,
    ) -> Result<(&'a Accessor, Layout), AssetError> {
        let accessor = at(self.accessors, index, || user.into(), field)?;
        let object = || format!("accessor {index}");
        let elements = Bound { what: "elements", limit: self.elements_max, setting: "accessor_elements" };
        elements.check(object(), accessor.count.0)?;
        let Checked::Valid(component) = accessor.component_type else {
            return Err(bad(object(), "componentType", "is none that glTF knows"));
        };
        let component_count = match accessor.type_ {
            Checked::Valid(Type::Scalar) => 1,
            Checked::Valid(Type::Vec2) => 2,
            Checked::Valid(Type::Vec3) => 3,
            Checked::Valid(Type::Vec4) => 4,
            _ => {
                return Err(bad(
                    object(),
                    "type",
                    format!("is neither scalar nor vector, but {field} of {user} needs that"),
                ));
            }
        };
        Ok((accessor, Layout { component: component.0, normalized: accessor.normalized, component_count }))
    }

    /// The dense part; `None` where the accessor starts as zeros.
    fn base(
        &self,
        accessor: &Accessor,
        layout: Layout,
        object: &str,
    ) -> Result<Option<Elements<'_>>, AssetError> {
        let Some(view) = accessor.buffer_view else {
            return match accessor.sparse {
                Some(_) => Ok(None),
                None => {
                    Err(bad(object, "bufferView", "is missing and nothing that is read here stands for it"))
                }
            };
        };
        let view = self.buffers.view(view.value(), object)?;
        let offset = accessor.byte_offset.unwrap_or_default().0;
        elements(view, offset, accessor.count.0, layout.size(), object).map(Some)
    }

    /// Places and values that replace elements of the dense part.
    fn sparse(
        &self,
        sparse: &Sparse,
        count: u64,
        layout: Layout,
        object: &str,
    ) -> Result<(Vec<u32>, Elements<'_>), AssetError> {
        if sparse.count.0 > count {
            return Err(bad(
                object,
                "sparse.count",
                format!("is {}, but there are {count} elements", sparse.count.0),
            ));
        }
        let Checked::Valid(component) = sparse.indices.component_type else {
            return Err(bad(object, "sparse.indices.componentType", "is not an unsigned integer type"));
        };
        // Both parts lie without gaps [glTF 2.0, 3.6.2.3].
        let packed =
            |index: usize| self.buffers.view(index, object).map(|view| View { stride: None, ..view });
        let view = packed(sparse.indices.buffer_view.value())?;
        let offset = sparse.indices.byte_offset.0;
        let places = elements(view, offset, sparse.count.0, component.0.size(), object)?;
        let places: Vec<u32> = places.iter().map(whole_number).collect();
        if let Some(place) = places.iter().find(|place| u64::from(**place) >= count) {
            return Err(bad(object, "sparse.indices", format!("name element {place} of {count}")));
        }
        let view = packed(sparse.values.buffer_view.value())?;
        let values = elements(view, sparse.values.byte_offset.0, sparse.count.0, layout.size(), object)?;
        Ok((places, values))
    }
}

/// `count` elements of `size` bytes from `offset` on, if the view holds them all.
fn elements<'a>(
    view: View<'a>,
    offset: u64,
    count: u64,
    size: usize,
    object: &str,
) -> Result<Elements<'a>, AssetError> {
    let stride = view.stride.unwrap_or(size);
    if stride < size {
        return Err(bad(object, "byteStride", format!("is {stride}, but an element takes {size} bytes")));
    }
    // The last element may end before its stride does.
    let span = match count.checked_sub(1) {
        Some(gaps) => gaps.checked_mul(stride as u64).and_then(|bytes| bytes.checked_add(size as u64)),
        None => Some(0),
    };
    let end = span.and_then(|span| span.checked_add(offset)).and_then(|end| usize::try_from(end).ok());
    match end.and_then(|end| view.bytes.get(offset as usize..end)) {
        Some(bytes) => Ok(Elements { bytes, stride, size, count: count as usize }),
        None => {
            let problem = format!(
                "{count} elements of {stride} bytes from byte {offset} on do not fit a view of {} bytes",
                view.bytes.len()
            );
            Err(bad(object, "count", problem))
        }
    }
}

/// One element as numbers. Components are little-endian; signed shares clamp at −1 [glTF 2.0, 3.6.2.2].
fn numbers<const N: usize>(element: &[u8], layout: Layout) -> [f32; N] {
    let size = layout.component.size();
    std::array::from_fn(|component| {
        let bytes = &element[component * size..(component + 1) * size];
        let (value, scale) = match *bytes {
            [a] if layout.component == ComponentType::I8 => (f32::from(a as i8), 127.0),
            [a] => (f32::from(a), 255.0),
            [a, b] if layout.component == ComponentType::I16 => {
                (f32::from(i16::from_le_bytes([a, b])), 32767.0)
            }
            [a, b] => (f32::from(u16::from_le_bytes([a, b])), 65535.0),
            [a, b, c, d] => return f32::from_le_bytes([a, b, c, d]),
            _ => (0.0, 1.0),
        };
        if layout.normalized { (value / scale).max(-1.0) } else { value }
    })
}

fn whole_number(element: &[u8]) -> u32 {
    element.iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte))
}
