//! Where WGSL puts the fields of a struct, and the numbers that it declares, so that tests can prove that Rust has them, too.

use std::collections::HashMap;

/// A field of a WGSL struct.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Field {
    /// Its name.
    pub(crate) name: String,
    /// Bytes from the struct's start.
    pub(crate) offset: u32,
    /// Bytes that it takes.
    pub(crate) byte_count: u32,
}

/// Fields of a struct and the bytes of the whole, as naga lays them out.
pub(crate) fn layout(source: &str, struct_name: &str) -> (Vec<Field>, u32) {
    let module = naga::front::wgsl::parse_str(source).unwrap_or_else(|error| {
        panic!("{}", error.emit_to_string(source));
    });
    let (_, found) = module
        .types
        .iter()
        .find(|(_, found)| found.name.as_deref() == Some(struct_name))
        .unwrap_or_else(|| panic!("no struct {struct_name}"));
    let naga::TypeInner::Struct { members, span } = &found.inner else {
        panic!("{struct_name} is no struct");
    };
    let size_of = |member: &naga::StructMember| module.types[member.ty].inner.size(module.to_ctx());
    let fields = members.iter().map(|member| Field {
        name: member.name.clone().unwrap_or_default(),
        offset: member.offset,
        byte_count: size_of(member),
    });
    (fields.collect(), *span)
}

/// Numbers that `source` declares, by name.
pub(crate) fn numbers_of(source: &str) -> HashMap<String, f64> {
    let module = naga::front::wgsl::parse_str(source).unwrap();
    let number = |constant: &naga::Constant| match module.global_expressions[constant.init] {
        naga::Expression::Literal(naga::Literal::F32(value)) => Some(f64::from(value)),
        naga::Expression::Literal(naga::Literal::U32(value)) => Some(f64::from(value)),
        _ => None,
    };
    let constants = module.constants.iter();
    constants.filter_map(|(_, constant)| Some((constant.name.clone()?, number(constant)?))).collect()
}

/// Asserts that a Rust struct has the size of a WGSL struct and its fields, by name, order, offset and size. Named padding
/// at the end of the Rust struct need not stand in WGSL, which pads by itself.
macro_rules! assert_same_layout {
    ($source:expr, $wgsl:literal, $rust:ty { $($field:ident),* $(,)? }) => {{
        let (fields, byte_count) = $crate::gpu::tests::layout($source, $wgsl);
        assert_eq!(byte_count as usize, size_of::<$rust>(), "bytes of {}", $wgsl);
        let zeroed = <$rust as bytemuck::Zeroable>::zeroed();
        let of_rust = [$((
            stringify!($field).to_string(),
            std::mem::offset_of!($rust, $field),
            size_of_val(&zeroed.$field),
        )),*];
        let of_wgsl: Vec<_> = fields
            .into_iter()
            .map(|field| (field.name, field.offset as usize, field.byte_count as usize))
            .collect();
        assert_eq!(of_wgsl, of_rust, "fields of {}", $wgsl);
    }};
}
pub(crate) use assert_same_layout;
