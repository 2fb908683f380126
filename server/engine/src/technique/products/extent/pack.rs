//! The triangles of a surface, packed for gathers on a graphics card.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::{super::shape::Placed, Extent, Facets, LEAF_COUNT};

// A leaf's triangles are counted in three bits.
const _: () = assert!(LEAF_COUNT < 8);

/// Some triangles that lie together; `ExtentNode` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct GpuExtentNode {
    pub(crate) middle: [f32; 3],
    pub(crate) reach_m: f32,
    pub(crate) axis: [f32; 3],
    pub(crate) cone_cos: f32,
    pub(crate) facing_m2: [f32; 3],
    pub(crate) area_m2: f32,
    pub(crate) squares_m2: [f32; 3],
    pub(crate) cone_sin: f32,
    pub(crate) products_m2: [f32; 3],
    /// Where those behind that are no parts of it begin.
    pub(crate) end: u32,
    /// Its first triangle, eight times, and how many; none of what has parts.
    pub(crate) faces: u32,
    pub(crate) padding_0: u32,
    pub(crate) padding_1: u32,
    pub(crate) padding_2: u32,
}

/// A triangle with its corners; `Face` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct GpuFace {
    pub(crate) a: [f32; 3],
    pub(crate) area_m2: f32,
    pub(crate) b: [f32; 3],
    pub(crate) reach_m: f32,
    pub(crate) c: [f32; 3],
    pub(crate) padding_0: f32,
    pub(crate) normal: [f32; 3],
    pub(crate) padding_1: f32,
    pub(crate) middle: [f32; 3],
    pub(crate) padding_2: f32,
}

/// Triangles of many surfaces, one after the other.
#[derive(Debug, Default)]
pub(crate) struct PackedExtents {
    /// `[surface]`: its first node, and the one behind its last.
    pub(crate) roots: Vec<[u32; 2]>,
    pub(crate) nodes: Vec<GpuExtentNode>,
    pub(crate) faces: Vec<GpuFace>,
}

impl Extent {
    /// Adds the surface to those that are packed.
    ///
    /// - `placed`: from its own space to render space
    /// - `corners`: of a triangle, render space
    pub(in crate::technique::products) fn pack(
        &self,
        placed: &Placed,
        corners: impl Fn(u32) -> [Vec3; 3],
        into: &mut PackedExtents,
    ) {
        let (first_node, first_face) = (into.nodes.len() as u32, into.faces.len() as u32);
        into.nodes.extend(self.nodes.iter().map(|node| {
            let facets = placed.facets_to_render(node.facets);
            GpuExtentNode {
                middle: placed.point_to_render(node.middle).to_array(),
                reach_m: placed.length_to_render(node.reach_m),
                axis: placed.direction_to_render(node.axis).to_array(),
                cone_cos: node.cone[0],
                facing_m2: facets.facing_m2.to_array(),
                area_m2: facets.area_m2,
                squares_m2: facets.squares_m2.to_array(),
                cone_sin: node.cone[1],
                products_m2: facets.products_m2.to_array(),
                end: first_node + node.end,
                faces: (first_face + node.first) << 3 | node.count,
                padding_0: 0,
                padding_1: 0,
                padding_2: 0,
            }
        }));
        into.faces.extend(self.faces.iter().map(|face| {
            let [a, b, c] = corners(face.triangle).map(|corner| corner.to_array());
            GpuFace {
                a,
                area_m2: placed.area_to_render(face.area_m2),
                b,
                reach_m: placed.length_to_render(face.reach_m),
                c,
                padding_0: 0.0,
                normal: placed.direction_to_render(face.normal).to_array(),
                padding_1: 0.0,
                middle: placed.point_to_render(face.middle).to_array(),
                padding_2: 0.0,
            }
        }));
        into.roots.push([first_node, into.nodes.len() as u32]);
    }
}

impl Facets {
    /// Of so much area; the sums of normals, of their squares and of their products.
    pub(in crate::technique) fn of_sums(area_m2: f32, [facing, squares, products]: [[f32; 3]; 3]) -> Facets {
        Facets { area_m2, facing_m2: facing.into(), squares_m2: squares.into(), products_m2: products.into() }
    }

    /// No number of it is infinite or NaN.
    pub(in crate::technique) fn is_finite(&self) -> bool {
        self.area_m2.is_finite()
            && self.facing_m2.is_finite()
            && self.squares_m2.is_finite()
            && self.products_m2.is_finite()
    }
}
