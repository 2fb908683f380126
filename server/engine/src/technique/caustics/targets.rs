//! What reflects or refracts in a direction, as a few spheres for photons to be aimed at.

use glam::Vec3;

use super::CausticLight;
use crate::{
    accel::Instance,
    transport::{Aim, Sphere, World},
};

/// Spheres at most: each photon looks at all of them.
const SPHERES_MAX: usize = 16;
/// Room for rounding, in shares of a radius.
const ROOM: f32 = 1e-4;

/// A box in render space.
#[derive(Clone, Copy)]
struct Bounds {
    min: Vec3,
    max: Vec3,
}

/// Spheres that hold everything that may send such light on in `world`.
pub(super) fn aim_of(world: &World, light: CausticLight) -> Aim {
    let mut boxes = Vec::new();
    for (index, instance) in world.accel().instances().iter().enumerate() {
        let focusing = match light {
            CausticLight::All => world.specular_primitives(index as u32),
            CausticLight::Hidden => world.smooth_primitives(index as u32),
        };
        boxes.extend(focusing.into_iter().filter_map(|primitive| bounds_of(world, instance, primitive)));
    }
    let mut groups = vec![boxes];
    groups.retain(|group| !group.is_empty());
    // The group of the greatest extent is halved, as long as that is of use.
    while groups.len() < SPHERES_MAX {
        let Some(place) = (0..groups.len())
            .filter(|index| groups[*index].len() > 1)
            .max_by(|a, b| extent(&groups[*a]).total_cmp(&extent(&groups[*b])))
        else {
            break;
        };
        let group = groups.swap_remove(place);
        let (left, right) = halves(group);
        groups.extend([left, right]);
    }
    Aim { spheres: groups.iter().map(|group| sphere_of(&union(group))).collect() }
}

fn bounds_of(world: &World, instance: &Instance, primitive: usize) -> Option<Bounds> {
    if instance.mesh().primitives().len() == 1 {
        // Known, however many triangles there are.
        let bounds = instance.bounds_in_world();
        let [min, max] = [bounds.min, bounds.max].map(|corner| world.accel().to_render(corner));
        return Some(Bounds { min, max });
    }
    let primitive = &instance.mesh().primitives()[primitive];
    let first = primitive.first_triangle as usize;
    let triangles = &instance.mesh().triangles()[first..first + primitive.triangle_count as usize];
    let mut vertices = triangles.iter().flatten().map(|vertex| instance.vertex_in_render(*vertex));
    let begin = vertices.next()?;
    let begin = Bounds { min: begin, max: begin };
    Some(vertices.fold(begin, |bounds, v| Bounds { min: bounds.min.min(v), max: bounds.max.max(v) }))
}

fn union(group: &[Bounds]) -> Bounds {
    let begin = Bounds { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };
    group.iter().fold(begin, |all, one| Bounds { min: all.min.min(one.min), max: all.max.max(one.max) })
}

fn extent(group: &[Bounds]) -> f32 {
    let Bounds { min, max } = union(group);
    (max - min).length()
}

/// Two groups by the middles' place along the longest axis.
fn halves(mut group: Vec<Bounds>) -> (Vec<Bounds>, Vec<Bounds>) {
    let middle = |bounds: &Bounds| (bounds.min + bounds.max) * 0.5;
    let Bounds { min, max } = union(&group);
    let axis = (max - min).max_position();
    group.sort_by(|a, b| middle(a)[axis].total_cmp(&middle(b)[axis]));
    let right = group.split_off(group.len() / 2);
    (group, right)
}

fn sphere_of(bounds: &Bounds) -> Sphere {
    let middle = (bounds.min + bounds.max) * 0.5;
    let reach = (bounds.max - bounds.min).length() * 0.5;
    // Half the diagonal, and what single precision may be off by that far from the origin.
    let radius_m = reach * (1.0 + ROOM) + middle.abs().max_element() * 4.0 * f32::EPSILON;
    Sphere { middle, radius_m, weight: 1.0 }
}
