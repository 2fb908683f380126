//! The crease surfaces of a scene, instance by instance, and how much of them lies within a gather.
//!
//! A surface has two sides, and a photon map for each: what falls on one side of a wall must not light the other.

use std::{collections::HashMap, sync::Arc};

use glam::{Mat3, Vec3};
use rayon::prelude::*;

#[cfg(feature = "gpu")]
use super::extent::PackedExtents;
use super::{
    crease::CreaseSurfaces,
    extent::{Extent, Facets},
    gather::{GatherBounds, Reach},
};
use crate::{
    accel::{Accel, Instance},
    scene::Mesh,
};

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
    crease: Arc<CreaseSurfaces>,
    surfaces: Vec<Extent>,
}

/// All crease surfaces of a scene [Larsen2004, 8.1].
#[derive(Debug, Default)]
pub struct Surfaces {
    instances: Vec<Arc<InstanceSurfaces>>,
    /// Number of each instance's first surface, and of all.
    first: Vec<u32>,
    angle_rad: f32,
}

impl Surfaces {
    /// Of the instances of `accel`; what `before` knows of those that stayed is taken over.
    pub(in crate::technique) fn of(accel: &Accel, angle_rad: f32, before: &Surfaces) -> Surfaces {
        let known = |index: usize, instance: &Arc<Instance>| {
            let same = |old: &&Arc<InstanceSurfaces>| Arc::ptr_eq(&old.instance, instance);
            // Mostly at its old place.
            before.instances.get(index).filter(same).or_else(|| before.instances.iter().find(same)).cloned()
        };
        let instances: Vec<Arc<InstanceSurfaces>> = accel
            .instances()
            .par_iter()
            .enumerate()
            .map(|(index, instance)| {
                known(index, instance)
                    .unwrap_or_else(|| Arc::new(InstanceSurfaces::of(instance, angle_rad, before)))
            })
            .collect();
        let mut first = vec![0];
        let mut count = 0;
        for instance in &instances {
            count += instance.crease.count();
            first.push(count);
        }
        Surfaces { instances, first, angle_rad }
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
        self.instances[instance as usize].crease.surface_of(triangle)
    }

    /// What a side of a surface turns to the gather's normal, within a cosine of it, in the ellipsoid around its middle.
    pub(super) fn within(&self, side: SideId, bounds: &GatherBounds, reach: Reach) -> Facets {
        let (instance, surface) = self.place_of(side.surface());
        let normal = if side.is_front() { bounds.normal } else { -bounds.normal };
        let bounds = GatherBounds { normal, ..*bounds };
        let front = self.instances[instance].within(surface, &bounds, reach);
        if side.is_front() { front } else { front.turned() }
    }

    /// Area of a surface, m².
    pub fn area_m2(&self, surface: u32) -> f32 {
        let (instance, surface) = self.place_of(surface);
        self.instances[instance].surfaces[surface as usize].area_m2()
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
            sides.extend((0..2 * instance.crease.count()).map(|side| Some(SideId(first? + side))));
        }
        sides
    }

    /// All surfaces, packed for gathers on a graphics card.
    #[cfg(feature = "gpu")]
    pub(super) fn packed(&self) -> PackedExtents {
        let mut packed = PackedExtents::default();
        for of_instance in &self.instances {
            for surface in &of_instance.surfaces {
                surface.pack(|triangle| corners(&of_instance.instance, triangle), &mut packed);
            }
        }
        packed
    }

    /// Memory.
    pub fn bytes(&self) -> usize {
        let extents = self.instances.iter().flat_map(|instance| &instance.surfaces);
        let triangles: usize = extents.map(Extent::bytes).sum();
        triangles + self.instances.iter().map(|instance| instance.crease.bytes()).sum::<usize>()
    }
}

impl InstanceSurfaces {
    fn of(instance: &Arc<Instance>, angle_rad: f32, before: &Surfaces) -> InstanceSurfaces {
        let crease = InstanceSurfaces::crease_of(instance, angle_rad, before);
        let mut triangles = vec![Vec::new(); crease.count() as usize];
        for triangle in 0..instance.mesh().triangles().len() as u32 {
            triangles[crease.surface_of(triangle) as usize].push(triangle);
        }
        let surfaces = triangles
            .iter()
            .map(|of_one| Extent::of(of_one, |triangle| corners(instance, triangle), instance.handedness()))
            .collect();
        InstanceSurfaces { instance: instance.clone(), crease, surfaces }
    }

    /// Angles stay where a transform turns, moves and scales evenly: the surfaces of a mesh that was seen like that before
    /// are taken over.
    fn crease_of(instance: &Instance, angle_rad: f32, before: &Surfaces) -> Arc<CreaseSurfaces> {
        let mesh_to_render = linear_of(instance);
        let known = before.instances.iter().find(|known| {
            Arc::ptr_eq(known.instance.mesh(), instance.mesh())
                && before.angle_rad == angle_rad
                && (linear_of(&known.instance) == mesh_to_render
                    || (keeps_angles(linear_of(&known.instance)) && keeps_angles(mesh_to_render)))
        });
        known.map_or_else(
            || {
                let mesh: &Mesh = instance.mesh();
                // Even scaling is left out, so that what follows does not depend on which instance came first.
                let linear = if keeps_angles(mesh_to_render) { Mat3::IDENTITY } else { mesh_to_render };
                Arc::new(CreaseSurfaces::split(mesh.positions(), mesh.triangles(), linear, angle_rad))
            },
            |known| known.crease.clone(),
        )
    }

    fn within(&self, surface: u32, bounds: &GatherBounds, reach: Reach) -> Facets {
        let corners = |triangle| corners(&self.instance, triangle);
        self.surfaces[surface as usize].within(bounds, reach, corners)
    }
}

fn linear_of(instance: &Instance) -> Mat3 {
    Mat3::from_cols(
        instance.vector_to_render(Vec3::X),
        instance.vector_to_render(Vec3::Y),
        instance.vector_to_render(Vec3::Z),
    )
}

/// Columns at right angles and of one length.
fn keeps_angles(linear: Mat3) -> bool {
    let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis];
    let size = x.length_squared();
    let close = |value: f32, target: f32| (value - target).abs() <= 1e-5 * size;
    close(y.length_squared(), size)
        && close(z.length_squared(), size)
        && close(x.dot(y), 0.0)
        && close(y.dot(z), 0.0)
        && close(z.dot(x), 0.0)
}

fn corners(instance: &Instance, triangle: u32) -> [Vec3; 3] {
    instance.mesh().triangles()[triangle as usize].map(|vertex| instance.vertex_in_render(vertex))
}
