//! Samples of pixels as cards leave them.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::{
    film::{Beyond, PixelSample},
    math::Rgb,
};

/// `PixelSample` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuPixelSample {
    pub(super) emitted: [f32; 3],
    pub(super) depth_m: f32,
    pub(super) direct: [f32; 3],
    pub(super) albedo_red: f32,
    pub(super) caustic: [f32; 3],
    pub(super) albedo_green: f32,
    pub(super) indirect: [f32; 3],
    pub(super) albedo_blue: f32,
    pub(super) specular: [f32; 3],
    pub(super) is_shining: u32,
    pub(super) normal: [f32; 3],
    /// Signed bytes of 127; the last is nothing where nothing is noted.
    pub(super) beyond_normal: [i8; 4],
    pub(super) beyond_albedo: [f32; 3],
    pub(super) padding_0: u32,
}

impl GpuPixelSample {
    /// As films take it.
    pub(super) fn unpacked(&self) -> PixelSample {
        PixelSample {
            radiance: [self.emitted, self.direct, self.caustic, self.indirect, self.specular].map(Rgb::from),
            albedo: Rgb::new(self.albedo_red, self.albedo_green, self.albedo_blue),
            normal: Vec3::from(self.normal),
            depth_m: self.depth_m,
            is_shining: self.is_shining != 0,
            beyond: self.beyond(),
        }
    }

    /// Adds what its path has brought since.
    pub(super) fn add(&mut self, more: &PixelSample) {
        let classes =
            [&mut self.emitted, &mut self.direct, &mut self.caustic, &mut self.indirect, &mut self.specular];
        for (sum, more) in classes.into_iter().zip(more.radiance) {
            *sum = (Rgb::from(*sum) + more).to_array();
        }
        self.is_shining |= u32::from(more.is_shining);
        if let Some(beyond) = &more.beyond {
            self.note_beyond(beyond);
        }
    }

    fn beyond(&self) -> Option<Beyond> {
        let [x, y, z, is_noted] = self.beyond_normal.map(f32::from);
        (is_noted != 0.0).then(|| Beyond {
            albedo: self.beyond_albedo.into(),
            normal: Vec3::new(x, y, z) / f32::from(i8::MAX),
        })
    }

    fn note_beyond(&mut self, beyond: &Beyond) {
        self.beyond_albedo = beyond.albedo.to_array();
        let bytes = (beyond.normal * f32::from(i8::MAX)).round().as_i8vec3();
        self.beyond_normal = [bytes.x, bytes.y, bytes.z, i8::MAX];
    }
}

/// Copies samples, as many as there is room for, from where a card left them.
pub(super) fn copy_samples(bytes: &[u8], room: &mut [GpuPixelSample]) {
    bytemuck::cast_slice_mut(room).copy_from_slice(bytes);
}
