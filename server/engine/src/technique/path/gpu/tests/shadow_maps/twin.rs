//! The twin of `shadows/look_up.wgsl`.

use glam::{Vec2, Vec3};

use super::super::super::shadow_maps::{
    ShadowPlanes,
    planes::{COS_LEAST, ROOM_TEXELS, SURE, TEXEL_MOST, TEXEL_SMOOTH},
};

fn face_before(from_light: Vec3) -> usize {
    let size = from_light.abs();
    if size.x >= size.y && size.x >= size.z {
        usize::from(from_light.x < 0.0)
    } else if size.y >= size.z {
        2 + usize::from(from_light.y < 0.0)
    } else {
        4 + usize::from(from_light.z < 0.0)
    }
}

impl ShadowPlanes {
    /// Share of a light that arrives at `p` on a flat surface that faces along `n` or against it; `None`: a ray is to be traced.
    ///
    /// - `nearnesses`: of all texels
    /// - `pixel_m`: size of a pixel there
    pub(super) fn lit_share(
        &self,
        nearnesses: &[f32],
        light: usize,
        [p, n]: [Vec3; 2],
        pixel_m: f32,
    ) -> Option<f32> {
        let [first, count] = self.of_lights[light];
        let of_light = &self.planes[first as usize..][..count as usize];
        let plane = match of_light {
            [] => return None,
            [only] => only,
            faces => &faces[face_before(p - Vec3::from(faces[0].origin))],
        };
        let [origin, right, up, back] = [plane.origin, plane.right, plane.up, plane.back].map(Vec3::from);
        let from_light = p - origin;
        let ahead = -from_light.dot(back);
        let half_size = Vec2::new(plane.half_width, plane.half_height);
        let side = plane.side as f32;
        let texel = 2.0 * half_size.max_element() / side;
        let tilt = Vec2::new(n.dot(right), n.dot(up)) * half_size;
        let aside = Vec2::new(from_light.dot(right), from_light.dot(up)) / half_size;
        let (at, texel_m, room, cosine, steeper);
        if plane.is_perspective() {
            if ahead.partial_cmp(&plane.reach_m) != Some(std::cmp::Ordering::Greater) {
                return None;
            }
            let height = n.dot(from_light);
            (at, texel_m, room) = (aside / ahead, texel * ahead, ROOM_TEXELS * texel * plane.nearness(ahead));
            (cosine, steeper) = (height / from_light.length(), tilt * (plane.reach_m / height));
        } else {
            (at, texel_m, room) = (aside, texel, ROOM_TEXELS * texel / plane.reach_m);
            cosine = -n.dot(back);
            steeper = tilt / (cosine * plane.reach_m);
        }
        let pixel_in_light_m = pixel_m * cosine.abs();
        let is_known = cosine.abs() >= COS_LEAST
            && at.abs().max_element() <= 1.0
            && texel_m <= TEXEL_MOST * pixel_in_light_m;
        if !is_known {
            return None;
        }
        let place = Vec2::new(0.5 + 0.5 * at.x, 0.5 - 0.5 * at.y) * side;
        let last = Vec2::splat(side - 1.0);
        let middle = place.floor().clamp(Vec2::ZERO, last);
        let within = (place - middle).clamp(Vec2::ZERO, Vec2::ONE);
        let weight_of = |which: u32, within: f32| match which {
            0 => 0.5 * (1.0 - within),
            1 => 0.5,
            _ => 0.5 * within,
        };
        let mut lit = 0.0;
        for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
            let tap = (middle + Vec2::new(column as f32, row as f32) - 1.0).clamp(Vec2::ZERO, last);
            let apart = (tap + 0.5 - place) * Vec2::new(2.0, -2.0) / side;
            let index = plane.first_texel + tap.y as u32 * plane.side + tap.x as u32;
            if nearnesses[index as usize] <= (plane.nearness(ahead) + steeper.dot(apart) + room).max(0.0) {
                lit += weight_of(column, within.x) * weight_of(row, within.y);
            }
        }
        let is_edge = lit > SURE && lit < 1.0 - SURE;
        if is_edge && texel_m > TEXEL_SMOOTH * pixel_in_light_m {
            return None;
        }
        Some(if is_edge { lit } else { lit.round() })
    }
}
