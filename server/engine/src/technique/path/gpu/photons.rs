//! Photons on a graphics card: the twin of `photons/trace.rs`, many photons at once.
//!
//! Where they start is drawn by whoever sends them; the card takes them from surface to surface by the same numbers as the CPU
//! does, through the steps of paths, and says what they leave behind. Everything that becomes of that, down to the order of
//! bytes, stays with the CPU.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::{
    GpuPassHeader, GpuScene,
    known::LightBeside,
    slices::Slices,
    tracing::{PathStart, SLICE_MIN},
};
use crate::{
    gpu::GpuError,
    math::Rgb,
    technique::{CarriedPhotons, KeptPhoton, PHOTON_MARK_BITS, PhotonCarrier, SentPhoton},
    transport::{EmittedPhoton, Flight, World},
};

/// Places for what photons leave behind, for each photon: some four in most rooms. A slice that leaves more is sent again as two.
pub(super) const KEPT_PER_PHOTON: u64 = 8;
/// Bits of a name that say how many surfaces a photon met before.
pub(super) const BOUNCE_BITS: u32 = 13;
/// `place` of what met nothing.
pub(super) const ESCAPED: u32 = u32::MAX;

/// `SentPhoton` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuSentPhoton {
    pub(super) origin: [f32; 3],
    pub(super) left_instance: u32,
    pub(super) direction: [f32; 3],
    pub(super) left_triangle: u32,
    pub(super) weight: [f32; 3],
    pub(super) number: u32,
    pub(super) key: [u32; 2],
    pub(super) padding_0: u32,
    pub(super) padding_1: u32,
}

impl GpuSentPhoton {
    fn new(SentPhoton { emitted: EmittedPhoton { ray, weight }, key, number }: &SentPhoton) -> GpuSentPhoton {
        GpuSentPhoton {
            origin: ray.origin.into(),
            left_instance: ray.left.instance,
            direction: ray.direction.into(),
            left_triangle: ray.left.triangle,
            weight: weight.to_array(),
            number: *number,
            key: [*key as u32, (*key >> 32) as u32],
            padding_0: 0,
            padding_1: 0,
        }
    }
}

/// `KeptPhoton` in WGSL.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct GpuKeptPhoton {
    pub(super) b1: f32,
    pub(super) b2: f32,
    pub(super) triangle: u32,
    pub(super) place: u32,
    pub(super) weight: [f32; 3],
    pub(super) leaving: f32,
    pub(super) direction: [f32; 3],
    pub(super) name: u32,
}

impl GpuKeptPhoton {
    /// It lies on a triangle that is there: what a driver makes of a shader is not ours.
    fn is_sound(&self, world: &World) -> bool {
        let placed = world.accel().instances().get((self.place >> PHOTON_MARK_BITS) as usize);
        let triangles = placed.map_or(0, |placed| placed.mesh().triangles().len());
        self.place == ESCAPED || (self.triangle as usize) < triangles
    }

    fn kept(&self) -> KeptPhoton {
        KeptPhoton {
            barycentric: [self.b1, self.b2],
            triangle: self.triangle,
            place: (self.place != ESCAPED).then_some(self.place),
            weight: Rgb::from(self.weight),
            leaving: self.leaving,
            direction: self.direction.into(),
        }
    }
}

/// What carries photons on a card, for whoever sends them; it goes on after lost devices, and after an error it carries no more and
/// says why.
#[derive(Debug)]
pub struct GpuPhotons {
    scene: Arc<GpuScene>,
    slices: Slices,
}

impl GpuPhotons {
    /// On the card that a scene is on.
    pub fn new(scene: Arc<GpuScene>) -> GpuPhotons {
        GpuPhotons { scene, slices: Slices::new(PathStart::Photons) }
    }

    /// Leaves everything to the CPU from now on.
    pub fn stop(&self) {
        self.slices.stop();
    }

    /// Why it carries no more.
    pub fn failure(&self) -> Option<GpuError> {
        self.slices.failure()
    }

    /// Photons that it has carried.
    pub fn photon_count(&self) -> u64 {
        self.slices.path_count()
    }

    /// A slice, in as many parts as what it leaves behind takes.
    fn slice(
        &self,
        sent: &[SentPhoton],
        bounces_end: u32,
        carried: &mut CarriedPhotons,
    ) -> Result<(), GpuError> {
        let photons: Vec<GpuSentPhoton> = sent.par_iter().map(GpuSentPhoton::new).collect();
        let header = GpuPassHeader { path_count: sent.len() as u32, bounces_end, ..GpuPassHeader::zeroed() };
        // In powers of two, so that a few more than before do not need other places; and so many that one alone always has room.
        let room = sent.len().next_power_of_two().max(SLICE_MIN as usize);
        let light = LightBeside::default();
        let of_bytes = |bytes: &[u8]| -> Vec<GpuKeptPhoton> {
            bytes.par_chunks_exact(size_of::<GpuKeptPhoton>()).map(bytemuck::pod_read_unaligned).collect()
        };
        let (mut records, slice) =
            self.scene.slice_of(PathStart::Photons, &photons, &header, room, light, of_bytes)?;
        if !slice.is_whole {
            let (first, second) = sent.split_at(sent.len() / 2);
            self.slice(first, bounces_end, carried)?;
            return self.slice(second, bounces_end, carried);
        }
        self.slices.answered(&self.scene, header.path_count, slice.first_seconds);
        if !records.par_iter().all(|record| record.is_sound(self.scene.world())) {
            return Err(GpuError::Failed {
                what: "photons came back from triangles that are not there".into(),
            });
        }
        // They come in no order.
        records.par_sort_unstable_by_key(|record| record.name);
        let mut next = 0;
        carried.kept.reserve(records.len());
        for slot in 0..header.path_count {
            let own = records[next..].iter().take_while(|record| record.name >> BOUNCE_BITS == slot).count();
            carried.kept.extend(records[next..next + own].iter().map(GpuKeptPhoton::kept));
            carried.ends.push(carried.kept.len());
            next += own;
        }
        Ok(())
    }
}

impl PhotonCarrier for GpuPhotons {
    fn photons_at_once(&self) -> Option<usize> {
        self.slices.at_once()
    }

    fn carry(&self, world: &World, sent: &[SentPhoton], bounces_max: Option<u32>) -> Option<CarriedPhotons> {
        if !std::ptr::eq(world, &**self.scene.world()) {
            return None;
        }
        let bounces_end = bounces_max.unwrap_or(Flight::BOUNCES_END).min(Flight::BOUNCES_END);
        let mut carried = CarriedPhotons::default();
        if bounces_end == 0 {
            carried.ends = vec![0; sent.len()];
            return Some(carried);
        }
        let mut rest = sent;
        while !rest.is_empty() {
            let (now, later) = rest.split_at(rest.len().min(self.slices.next()?));
            if let Err(error) = self.slice(now, bounces_end, &mut carried) {
                self.slices.fail(error);
                return None;
            }
            rest = later;
        }
        self.slices.count(sent.len() as u64);
        Some(carried)
    }
}
