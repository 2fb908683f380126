//! The crease surfaces of a scene, instance by instance, and how much of them lies within a gather.
//!
//! A surface has two sides, and a photon map for each: what falls on one side of a wall must not light the other.

use std::{collections::HashMap, sync::Arc};

use glam::Vec3;
use rayon::prelude::*;

#[cfg(feature = "gpu")]
use super::extent::PackedExtents;
use super::{
    extent::{Facets, PartVisitor, Whole},
    gather::{GatherBounds, Reach},
    shape::{Placed, Shape, ShapeName},
};
use crate::accel::{Accel, Instance};

/// One side of one crease surface: twice the surface's number, plus one for the back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SideId(u32);

impl SideId {
    /// A side of a surface.
    pub fn of(surface: u32, is_front: bool) -> SideId {
        SideId(surface << 1 | u32::from(!is_front))
    }

    /// The side at a place of lists over sides.
    pub fn at(index: usize) -> SideId {
        SideId(index as u32)
    }

    /// Place in lists over sides.
    pub fn index(self) -> usize {
        self.0 as usize
    }

    /// Number of the surface it is a side of.
    pub fn surface(self) -> u32 {
        self.0 >> 1
    }

    /// It is the front.
    pub fn is_front(self) -> bool {
        self.0 & 1 == 0
    }

    /// The other side of the same surface.
    pub fn other(self) -> SideId {
        SideId(self.0 ^ 1)
    }
}

/// One side of a triangle of an instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TriangleSide {
    /// Index of the instance.
    pub instance: u32,
    /// Index of the triangle.
    pub triangle: u32,
    /// Its front.
    pub is_front: bool,
}

/// The surfaces of one instance.
#[derive(Debug)]
struct InstanceSurfaces {
    instance: Arc<Instance>,
    shape: Arc<Shape>,
    placed: Placed,
}

/// All crease surfaces of a scene [Larsen2004, 8.1].
#[derive(Debug, Default)]
pub struct Surfaces {
    instances: Vec<Arc<InstanceSurfaces>>,
    shapes: HashMap<ShapeName, Arc<Shape>>,
    /// Number of each instance's first surface, and of all.
    first: Vec<u32>,
    /// `[surfaces]`: most that gathers ask for count wholly, or not at all.
    wholes: Vec<Whole>,
    angle_rad: f32,
}

impl Surfaces {
    /// Of the instances of `accel`; what `before` knows of those that stayed, and of their shapes, is taken over.
    pub(in crate::technique) fn of(accel: &Accel, angle_rad: f32, before: &Surfaces) -> Surfaces {
        let address = |instance: &Arc<Instance>| Arc::as_ptr(instance).addr();
        // Both sides hold them, so that none can be another's.
        let stayed: HashMap<usize, &Arc<InstanceSurfaces>> = match before.angle_rad == angle_rad {
            true => before.instances.iter().map(|known| (address(&known.instance), known)).collect(),
            false => HashMap::new(),
        };
        let came: Vec<&Arc<Instance>> =
            accel.instances().iter().filter(|instance| !stayed.contains_key(&address(instance))).collect();
        let shapes = Surfaces::shapes_of(&came, angle_rad, before);
        let placed = |instance: &Arc<Instance>| match stayed.get(&address(instance)) {
            Some(known) => Arc::clone(known),
            None => Arc::new(InstanceSurfaces::of(instance, &shapes[&ShapeName::of(instance)])),
        };
        let instances: Vec<Arc<InstanceSurfaces>> = accel.instances().par_iter().map(placed).collect();
        let mut first = vec![0];
        let mut count = 0;
        let mut wholes = Vec::new();
        // Shapes that nobody has any more go.
        let mut kept = HashMap::new();
        for of_instance in &instances {
            count += of_instance.shape.crease().count();
            first.push(count);
            wholes.extend(of_instance.shape.wholes(&of_instance.placed));
            kept.entry(ShapeName::of(&of_instance.instance)).or_insert_with(|| of_instance.shape.clone());
        }
        Surfaces { instances, shapes: kept, first, wholes, angle_rad }
    }

    /// The shapes of instances that came, those that are known and those that are not.
    fn shapes_of(
        came: &[&Arc<Instance>],
        angle_rad: f32,
        before: &Surfaces,
    ) -> HashMap<ShapeName, Arc<Shape>> {
        let asked: HashMap<ShapeName, &Arc<Instance>> =
            came.iter().map(|instance| (ShapeName::of(instance), *instance)).collect();
        let known = |name: &ShapeName| before.shapes.get(name).filter(|_| before.angle_rad == angle_rad);
        let shape_of = |(name, instance): (ShapeName, &Arc<Instance>)| {
            let shape = known(&name).cloned().unwrap_or_else(|| Arc::new(Shape::of(instance, angle_rad)));
            (name, shape)
        };
        asked.into_par_iter().map(shape_of).collect()
    }

    /// Number of surfaces.
    pub fn count(&self) -> u32 {
        self.first.last().copied().unwrap_or(0)
    }

    /// The instance and its triangle are known here.
    pub fn holds(&self, place: TriangleSide) -> bool {
        let known = self.instances.get(place.instance as usize);
        known.is_some_and(|known| (place.triangle as usize) < known.instance.mesh().triangles().len())
    }

    /// The side of a surface that the side of a triangle belongs to.
    pub fn side(&self, place: TriangleSide) -> SideId {
        let surface =
            self.first_surface(place.instance) + self.surface_in_instance(place.instance, place.triangle);
        SideId::of(surface, place.is_front)
    }

    /// Number of an instance's first surface.
    pub fn first_surface(&self, instance: u32) -> u32 {
        self.first[instance as usize]
    }

    /// Number of a triangle's surface among those of its instance.
    pub fn surface_in_instance(&self, instance: u32, triangle: u32) -> u32 {
        self.instances[instance as usize].shape.crease().surface_of(triangle)
    }

    /// The surfaces of an instance in pieces of work for [`Surfaces::visit`]: number of the surface in the instance, and of its part.
    pub(in crate::technique) fn pieces_of_work(&self, instance: u32) -> Vec<(u32, usize)> {
        self.instances[instance as usize].shape.pieces_of_work().collect()
    }

    /// Goes through the triangles of a piece of an instance, but for those without area: of parts that the visitor takes together none
    /// alone.
    pub(in crate::technique) fn visit(
        &self,
        instance: u32,
        piece: (u32, usize),
        visitor: &mut impl PartVisitor,
    ) {
        let InstanceSurfaces { shape, placed, .. } = &*self.instances[instance as usize];
        shape.visit(placed, piece, visitor);
    }

    /// False for a side of which nothing lies within a radius of a point.
    pub(super) fn may_reach(&self, side: SideId, centre: Vec3, radius_m: f32) -> bool {
        self.wholes[side.surface() as usize].meets(centre, radius_m)
    }

    /// What a side of a surface turns to the gather's normal, within a cosine of it, in the ellipsoid around its middle.
    pub(super) fn within(&self, side: SideId, bounds: &GatherBounds, reach: Reach) -> Facets {
        let normal = if side.is_front() { bounds.normal } else { -bounds.normal };
        let bounds = GatherBounds { normal, ..*bounds };
        let front = self.wholes[side.surface() as usize].within(&bounds, reach).unwrap_or_else(|| {
            let (instance, surface) = self.place_of(side.surface());
            let InstanceSurfaces { shape, placed, .. } = &*self.instances[instance];
            shape.within(placed, surface, &bounds, reach)
        });
        if side.is_front() { front } else { front.turned() }
    }

    /// Area of a surface, m².
    pub fn area_m2(&self, surface: u32) -> f32 {
        self.wholes[surface as usize].area_m2()
    }

    /// The instance of a surface, and its number there.
    fn place_of(&self, surface: u32) -> (usize, u32) {
        // The last instance that starts at or before it; those without surfaces start with their successor.
        let instance = self.first.partition_point(|first| *first <= surface) - 1;
        (instance, surface - self.first[instance])
    }

    /// For every side of these surfaces the same side of `other`, where both know the same instance, unmoved.
    pub fn sides_in(&self, other: &Surfaces) -> Vec<Option<SideId>> {
        let places: HashMap<*const InstanceSurfaces, u32> =
            (0..).zip(&other.instances).map(|(index, instance)| (Arc::as_ptr(instance), index)).collect();
        let mut sides = Vec::with_capacity(2 * self.count() as usize);
        for instance in &self.instances {
            let first = places.get(&Arc::as_ptr(instance)).map(|index| 2 * other.first[*index as usize]);
            sides.extend((0..2 * instance.shape.crease().count()).map(|side| Some(SideId(first? + side))));
        }
        sides
    }

    /// All surfaces, packed for gathers on a graphics card.
    #[cfg(feature = "gpu")]
    pub(super) fn packed(&self) -> PackedExtents {
        let mut packed = PackedExtents::default();
        for InstanceSurfaces { instance, shape, placed, .. } in self.instances.iter().map(Arc::as_ref) {
            shape.pack(placed, instance, &mut packed);
        }
        packed
    }

    /// Of meshes and transforms that are told apart.
    #[cfg(test)]
    pub(super) fn shapes(&self) -> Vec<Arc<Shape>> {
        self.shapes.values().cloned().collect()
    }

    /// Memory.
    pub fn bytes(&self) -> usize {
        let shapes: usize = self.shapes.values().map(|shape| shape.bytes()).sum();
        shapes
            + self.wholes.len() * size_of::<Whole>()
            + self.instances.len() * (size_of::<InstanceSurfaces>() + size_of::<u32>())
    }
}

impl InstanceSurfaces {
    fn of(instance: &Arc<Instance>, shape: &Arc<Shape>) -> InstanceSurfaces {
        let placed = shape.placed(instance);
        InstanceSurfaces { instance: instance.clone(), shape: shape.clone(), placed }
    }
}
