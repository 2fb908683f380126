//! Which lights have maps, where those lie, and what they tell: all but how a card draws them.
//!
//! A directional light sees all of the scene on one plane, a spot its cone, a point light all around on six. The twin of what is drawn is a ray
//! through the middle of each texel, [`ShadowPlanes::by_rays`]; that of `shadows/look_up.wgsl` stands among the tests.
//!
//! **Percentage closer** [Reeves1987]: the texels around say lit or not, each by itself, and their mean is the share of the light that
//! arrives. Each is compared with where the plane of the surface would be in that texel [Isidoro2006], so that no surface shadows itself
//! however it is turned, but for what a texel's size makes.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use rayon::prelude::*;

use super::super::lookouts::{NEAREST, corners_of_instance};
use crate::{
    accel::Ray,
    math::Rgb,
    transport::{GpuLight, World},
};

/// Cosine of a spot's outer angle below which it is drawn as a point light: planes of broader ones are wasted on their rims.
const SPOT_COS_LEAST: f32 = 0.5;
/// How much larger than what they show planes are, so that rounding leaves nothing out.
const LARGER: f32 = 1.001;

/// Texels of a side, in multiples of 64: copies take whole rows of so many.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct MapSides {
    pub(in super::super) directional: u32,
    pub(in super::super) spot: u32,
    /// Of each of the six planes of a light that shines all around.
    pub(in super::super) point: u32,
}

impl Default for MapSides {
    /// 16, 4 and 14 MiB a light.
    fn default() -> MapSides {
        MapSides { directional: 2048, spot: 1024, point: 768 }
    }
}

/// Cosine of the angle to a surface's normal below which a ray is traced: there what is between texels decides.
pub(in super::super) const COS_LEAST: f32 = 0.1;
/// Texels where those around do not agree are no larger on the surface than so many pixels, or a ray is traced: shadows are no rougher than the
/// picture.
pub(in super::super) const TEXEL_SMOOTH: f32 = 2.0;
/// The same where they agree: what is thinner than a texel may be missed between them.
pub(in super::super) const TEXEL_MOST: f32 = 4.0;
/// Texels' sizes by which something must be nearer to hide a surface: where that bends, others of its facets lie above its plane.
pub(in super::super) const ROOM_TEXELS: f32 = 0.5;
/// Of the weights of those around, what rounding may make.
pub(in super::super) const SURE: f32 = 1e-5;

/// `ShadowPlane` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(in super::super) struct GpuShadowPlane {
    pub(in super::super) origin: [f32; 3],
    pub(in super::super) half_width: f32,
    pub(in super::super) right: [f32; 3],
    pub(in super::super) half_height: f32,
    pub(in super::super) up: [f32; 3],
    pub(in super::super) reach_m: f32,
    pub(in super::super) back: [f32; 3],
    pub(in super::super) is_perspective: u32,
    pub(in super::super) first_texel: u32,
    pub(in super::super) side: u32,
    pub(in super::super) padding_0: u32,
    pub(in super::super) padding_1: u32,
}

impl GpuShadowPlane {
    /// Of rays that part, from a light that stands somewhere.
    fn from(
        origin: Vec3,
        [ahead, up]: [Vec3; 2],
        half_size: f32,
        nearest_m: f32,
        side: u32,
    ) -> GpuShadowPlane {
        GpuShadowPlane {
            origin: origin.into(),
            half_width: half_size,
            right: ahead.cross(up).into(),
            half_height: half_size,
            up: up.into(),
            reach_m: nearest_m,
            back: (-ahead).into(),
            is_perspective: 1,
            side,
            ..GpuShadowPlane::zeroed()
        }
    }

    /// Of parallel rays, over all that stands in the scene.
    fn along(direction: Vec3, world: &World, side: u32) -> GpuShadowPlane {
        let corners = corners_of(world);
        let extent = |axis: Vec3| {
            corners
                .iter()
                .map(|corner| corner.dot(axis))
                .fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
        };
        // Along the longest side of what is seen, so that rows are not wasted on its corners.
        let seen = |axis: Vec3| {
            let [low, high] = extent(axis);
            (axis - direction * axis.dot(direction)) * (high - low)
        };
        let longer = |a: Vec3, b: Vec3| if b.length_squared() > a.length_squared() { b } else { a };
        let right = Vec3::AXES.map(seen).into_iter().fold(Vec3::ZERO, longer);
        let right = right.try_normalize().unwrap_or_else(|| direction.any_orthonormal_vector());
        let up = right.cross(direction);
        let least = (1e-6 * world.accel().radius()).max(f32::MIN_POSITIVE);
        let [across, upwards, ahead] = [right, up, direction].map(extent);
        let middle = |[low, high]: [f32; 2]| 0.5 * (low + high);
        let half = |[low, high]: [f32; 2]| (0.5 * LARGER * (high - low)).max(least);
        let nearest = middle(ahead) - half(ahead);
        GpuShadowPlane {
            origin: (right * middle(across) + up * middle(upwards) + direction * nearest).into(),
            half_width: half(across),
            right: right.into(),
            half_height: half(upwards),
            up: up.into(),
            reach_m: 2.0 * half(ahead),
            back: (-direction).into(),
            is_perspective: 0,
            side,
            ..GpuShadowPlane::zeroed()
        }
    }

    pub(in super::super) fn is_perspective(&self) -> bool {
        self.is_perspective != 0
    }

    pub(super) fn texel_count(&self) -> u32 {
        self.side * self.side
    }

    /// All of some bounds lies behind it, render space.
    pub(super) fn is_before(&self, corners: &[Vec3], room_m: f32) -> bool {
        let [origin, back] = [self.origin, self.back].map(Vec3::from);
        self.is_perspective() && corners.iter().all(|corner| (*corner - origin).dot(back) > room_m)
    }

    /// Through the middle of a texel, and by how much of it the light gets ahead.
    fn ray(&self, column: u32, row: u32) -> (Ray, f32) {
        let [origin, right, up, back] = [self.origin, self.right, self.up, self.back].map(Vec3::from);
        let middle = |place: u32| 2.0 * (place as f32 + 0.5) / self.side as f32 - 1.0;
        let aside = right * (middle(column) * self.half_width) - up * (middle(row) * self.half_height);
        if self.is_perspective() {
            let direction = (aside - back).normalize();
            (Ray::new(origin, direction), -direction.dot(back))
        } else {
            (Ray::new(origin + aside, -back), 1.0)
        }
    }

    /// How near what lies so far ahead is.
    pub(in super::super) fn nearness(&self, ahead_m: f32) -> f32 {
        if self.is_perspective() { self.reach_m / ahead_m } else { 1.0 - ahead_m / self.reach_m }
    }
}

/// Corners of what stands in the scene, render space.
fn corners_of(world: &World) -> Vec<Vec3> {
    (0..world.accel().instances().len()).flat_map(|instance| corners_of_instance(world, instance)).collect()
}

/// Ahead and up, as `face_before` in WGSL counts.
const FACES: [[Vec3; 2]; 6] = [
    [Vec3::X, Vec3::Y],
    [Vec3::NEG_X, Vec3::Y],
    [Vec3::Y, Vec3::Z],
    [Vec3::NEG_Y, Vec3::Z],
    [Vec3::Z, Vec3::X],
    [Vec3::NEG_Z, Vec3::X],
];

/// Maps that there are to be of a scene's lights.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct ShadowPlanes {
    pub(in super::super) planes: Vec<GpuShadowPlane>,
    /// By light: the first of its planes, and how many it has.
    pub(in super::super) of_lights: Vec<[u32; 2]>,
    pub(in super::super) texel_count: u32,
}

impl ShadowPlanes {
    /// The strongest lights without extent have maps, as far as those take no more than `bytes_max`; `None` where none has.
    ///
    /// - `lights`: those of the world, as shaders know them
    pub(in super::super) fn of(
        world: &World,
        lights: &[GpuLight],
        sides: MapSides,
        bytes_max: u64,
    ) -> Option<ShadowPlanes> {
        if world.accel().instances().is_empty() {
            return None;
        }
        let mut strongest: Vec<(usize, f32)> = lights
            .iter()
            .enumerate()
            .map(|(number, light)| (number, power_of(world, light)))
            .filter(|(_, power)| *power > 0.0)
            .collect();
        strongest.sort_by(|(_, a), (_, b)| b.total_cmp(a));
        let mut maps =
            ShadowPlanes { planes: Vec::new(), of_lights: vec![[0, 0]; lights.len()], texel_count: 0 };
        for (number, _) in strongest {
            let planes = planes_of(world, &lights[number], sides);
            let texels: u32 = planes.iter().map(GpuShadowPlane::texel_count).sum();
            let bytes = size_of::<f32>() as u64 * (u64::from(maps.texel_count) + u64::from(texels));
            if bytes > bytes_max || maps.texel_count.checked_add(texels).is_none() {
                continue;
            }
            maps.of_lights[number] = [maps.planes.len() as u32, planes.len() as u32];
            for plane in planes {
                maps.planes.push(GpuShadowPlane { first_texel: maps.texel_count, ..plane });
                maps.texel_count += plane.texel_count();
            }
        }
        (!maps.planes.is_empty()).then_some(maps)
    }

    /// What rays through the middles of all texels meet: the twin of what a card draws.
    pub(in super::super) fn by_rays(&self, world: &World) -> Vec<f32> {
        let of_row = |plane: &GpuShadowPlane, row: u32| -> Vec<f32> {
            let texel = |column| {
                let (ray, ahead) = plane.ray(column, row);
                world.closest_hit(&ray).map_or(0.0, |hit| plane.nearness(hit.t * ahead))
            };
            (0..plane.side).map(texel).collect()
        };
        let rows = self.planes.iter().flat_map(|plane| (0..plane.side).map(move |row| (plane, row)));
        let rows: Vec<_> = rows.collect();
        rows.par_iter().flat_map_iter(|(plane, row)| of_row(plane, *row)).collect()
    }

    /// Texels of which two drawings say other things: by more than a quarter of a texel's size, or that something is seen.
    pub(in super::super) fn differing(&self, a: &[f32], b: &[f32]) -> usize {
        let of_plane = |plane: &GpuShadowPlane| {
            let texels = plane.first_texel as usize..(plane.first_texel + plane.texel_count()) as usize;
            let texel = 2.0 * plane.half_width.max(plane.half_height) / plane.side as f32;
            let is_other = |(a, b): &(&f32, &f32)| {
                let room = 0.25 * if plane.is_perspective() { **b * texel } else { texel / plane.reach_m };
                (**a > 0.0) != (**b > 0.0) || (**a - **b).abs() > room
            };
            a[texels.clone()].iter().zip(&b[texels]).filter(is_other).count()
        };
        self.planes.iter().map(of_plane).sum()
    }
}

/// What a light without extent sends out in all, W, about; of others 0.
fn power_of(world: &World, light: &GpuLight) -> f32 {
    let intensity = Rgb::from(light.intensity).luminance();
    let spread = match light.kind {
        GpuLight::POINT => 2.0,
        GpuLight::SPOT => 1.0 - light.cos_outer,
        GpuLight::DIRECTIONAL => 0.5 * world.accel().radius().powi(2),
        _ => 0.0,
    };
    intensity * spread
}

/// First texels are left at 0.
fn planes_of(world: &World, light: &GpuLight, sides: MapSides) -> Vec<GpuShadowPlane> {
    let nearest_m = (world.accel().radius() * NEAREST).max(f32::MIN_POSITIVE);
    let position = Vec3::from(light.position);
    match light.kind {
        GpuLight::DIRECTIONAL => vec![GpuShadowPlane::along(position, world, sides.directional)],
        GpuLight::SPOT if light.cos_outer >= SPOT_COS_LEAST => {
            let axis = Vec3::from(light.axis);
            let half_size = (1.0 - light.cos_outer.powi(2)).sqrt() / light.cos_outer * LARGER;
            // A cone without width sees something still.
            let half_size = half_size.max(1e-4);
            let ahead_and_up = [axis, axis.any_orthonormal_vector()];
            vec![GpuShadowPlane::from(position, ahead_and_up, half_size, nearest_m, sides.spot)]
        }
        _ => FACES.map(|face| GpuShadowPlane::from(position, face, LARGER, nearest_m, sides.point)).to_vec(),
    }
}
