//! What techniques make for each other: photon maps over the surfaces of the scene, and caches of the light there.

mod carried;
mod crease;
mod dimmed;
mod extent;
mod gather;
mod guide;
mod map;
mod packed;
#[cfg(feature = "gpu")]
mod packed_maps;
mod patch;
mod shape;
mod surfaces;
mod touched;
mod walls;

use std::{
    collections::HashMap,
    fmt,
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, atomic::AtomicBool},
};

use glam::{UVec2, Vec3};

pub use self::{
    carried::{
        CarriedPhotons, KeptPhoton, PHOTON_MARK_BITS, PHOTON_MARK_DIFFUSE, PHOTON_MARK_FRONT,
        PHOTON_SURVIVAL_MAX, PhotonCarrier, SentPhoton,
    },
    crease::CREASE_ANGLE_RAD,
    dimmed::Dimmed,
    gather::{Gather, GatherBounds, GatheredPhoton},
    guide::{Flight, GUIDED_SHARE, Guidance, Guide},
    map::{FallenPhoton, MAPPED, MapPhoton, PhotonMaps, SideMap},
    packed::{
        GpuLightSet, GpuOctreeHeader, GpuPhoton, GpuRecord, LIKE_COS, PackedFocused, PackedLight,
        PackedPhotons, PackedRecords, PackedSketch, SHOWN_NOWHERE, SKETCH_WIDTHS, SketchWindows,
    },
    patch::{Patch, clip_to_box},
    surfaces::{SideId, Surfaces, TriangleSide},
    touched::{Touched, TouchedBoxes, renamed_instances},
    walls::{WallSearch, Walls},
};

pub(in crate::technique) use self::extent::{PartVisitor, PlacedPart};
#[cfg(feature = "gpu")]
pub use self::gather::{FoundPhotons, OtherMaps};
#[cfg(test)]
pub(in crate::technique) use self::guide::samples_of_guides;
#[cfg(feature = "gpu")]
pub(in crate::technique) use self::{
    extent::Facets,
    gather::{COUNTS as GATHER_COUNTS, FAR_M, NEAR_M, NUMBERS as GATHER_NUMBERS},
    packed_maps::PackedMaps,
    walls::DIRECTIONS as WALLS_MAX,
};
#[cfg(all(test, feature = "gpu"))]
pub(in crate::technique) use self::{
    extent::{GpuExtentNode, GpuFace},
    packed_maps::{GpuMapPhoton, GpuPhotonNode},
};

use super::{Card, Counts, View};
use crate::{
    accel::{Hit, Ray},
    math::{Rgb, sobol::PixelSampler},
    transport::{LightOrigin, LightSample, Surface, World},
};

/// What a diffuse lobe sends to the eye of light that did not come straight from its source, W/(m² sr), and how well that is
/// known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScatteredLight {
    /// Of light that another diffuse surface scattered before.
    pub indirect: Rgb,
    /// Of light that only mirrors and glass sent on before.
    pub caustic: Rgb,
    /// How far indirect light is blurred here, m: nearer than that it is not to be looked at.
    pub blur_m: f32,
    /// Where some of the indirect light comes from; `None` where nobody asked, that is not known, or nothing is near.
    pub from: Option<LitFrom>,
    /// Nothing is known here, though elsewhere it is, as where something came to stand since: paths go on, and ask what they meet.
    pub is_missing: bool,
}

/// A direction that indirect light comes from, drawn about in proportion to what the diffuse lobe sends on of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LitFrom {
    /// A unit vector.
    pub direction: Vec3,
    /// What the lobe sends on of the light that was drawn, over its chance: on average all of [`ScatteredLight::indirect`].
    pub share: Rgb,
    /// What lies nearer is lost in the blur, m: it may hide this light, and send on other light in its place.
    pub lost_m: f32,
}

/// A cache of the light that surfaces receive: what the eye's paths ask at the first diffuse surface instead of going on.
pub trait SecondaryLight: fmt::Debug + Send + Sync {
    /// What made it.
    fn card(&self) -> &'static Card;

    /// What the diffuse lobe of `surface` sends to `wo`.
    ///
    /// - `draw`: random numbers in [0, 1) that [`ScatteredLight::from`] is drawn by, if it is asked for
    fn scattered(&self, surface: &Surface, wo: Vec3, draw: Option<[f32; 3]>) -> ScatteredLight;

    /// The same, but for caustics, which something else knows better: they may be left out.
    fn scattered_but_caustics(&self, surface: &Surface, wo: Vec3, draw: Option<[f32; 3]>) -> ScatteredLight {
        self.scattered(surface, wo, draw)
    }

    /// Irradiance of light that other surfaces scattered, without caustics, W/m²; `None` where it is not known, and from what knows it at
    /// single points only.
    ///
    /// - `n_geo`, `n`: normals of the triangle and of shading, on the side that receives, unit
    fn even_irradiance(&self, _p: Vec3, _n_geo: Vec3, _n: Vec3) -> Option<Rgb> {
        None
    }

    /// The same light for pictures of one camera: what many neighbouring pixels see is answered for at once, where that takes less time
    /// than to ask for each. Holds no caustics.
    fn laid_out_for(self: Arc<Self>, _view: &View) -> Option<Arc<dyn ScreenLight>> {
        None
    }

    /// Where it was gathered, in render space, if that was at single points.
    fn places(&self) -> Vec<Vec3> {
        Vec::new()
    }

    /// Some surface receives light that only mirrors and glass sent on.
    fn has_caustics(&self) -> bool;

    /// What it is a multiple of, channel by channel: that is what path tracing on a graphics card is given, and shows times as much. `None` of
    /// what is light of its own.
    fn undimmed(&self) -> Option<(&Arc<dyn SecondaryLight>, Rgb)> {
        None
    }

    /// Light in cells for look-ups on a graphics card; `None` of what has none, or cannot be looked up there.
    fn packed(&self) -> Option<PackedLight> {
        None
    }

    /// Records of irradiance for look-ups on a graphics card; `None` of what has none.
    fn packed_records(&self) -> Option<PackedRecords> {
        None
    }

    /// Where light comes from, for paths that look for it; `None` where that is not known.
    fn guide(&self) -> Option<&Guide> {
        None
    }

    /// It has records of irradiance.
    fn has_records(&self) -> bool {
        false
    }

    /// relMSE of the light at the single points that it was gathered at, by the chance of the rays that gathered it; 0 where that is not
    /// known.
    fn noise(&self) -> f64 {
        0.0
    }

    /// What answers where it knows nothing.
    fn base(&self) -> Option<&Arc<dyn SecondaryLight>> {
        None
    }
}

/// What a sample of a picture sees first.
#[derive(Clone, Copy, Debug)]
pub struct FirstSight {
    /// The surface.
    pub surface: Surface,
    /// Unit direction from it to the eye.
    pub wo: Vec3,
}

/// What is known of light, laid out over a picture.
pub trait ScreenLight: fmt::Debug + Send + Sync {
    /// What the diffuse lobes of what is seen send to the eye of light that another diffuse surface scattered before, W/(m² sr); `None`
    /// where that is to be asked for alone.
    ///
    /// - `origin`: top left pixel of a tile of the picture
    /// - `size`: of the tile, px
    /// - `seen`: by any sample of its pixels, `[size.y × size.x]`
    fn scattered_over(&self, origin: UVec2, size: UVec2, seen: &[Option<FirstSight>]) -> Vec<Option<Rgb>>;

    /// What it took so far, of all threads.
    fn thread_seconds(&self) -> f64;
}

/// What a surface sends to the eye of light that only mirrors and glass sent on before, W/(m² sr).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FocusedScatter {
    /// By its diffuse lobe: caustics.
    pub diffuse: Rgb,
    /// By its glossy lobe, where that is [broad](crate::transport::Bsdf::has_broad_gloss).
    pub glossy: Rgb,
}

/// What of the light from infinitely far that comes straight through panes ([`World::through_panes`](crate::transport::World::through_panes))
/// is for light sampling to find, and not in what is looked up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeftToSampling {
    /// Nothing.
    Nothing,
    /// That of directional lights.
    Suns,
    /// That of the environment too.
    SunsAndSky,
}

impl LeftToSampling {
    /// Whether that of a light is.
    pub fn holds(self, light: &LightSample) -> bool {
        let is_left = match self {
            LeftToSampling::Nothing => false,
            LeftToSampling::Suns => light.is_delta,
            LeftToSampling::SunsAndSky => true,
        };
        is_left && matches!(light.origin, LightOrigin::Infinite)
    }
}

/// Light that mirrors and glass focus on surfaces.
pub trait FocusedLight: fmt::Debug + Send + Sync {
    /// What `surface` sends to `wo` of it, but for what it [leaves](FocusedLight::leaves).
    ///
    /// - `scatterings_max`: most scatterings before, of what counts
    fn scattered(&self, surface: &Surface, wo: Vec3, scatterings_max: u32) -> FocusedScatter;

    /// What light sampling is to find.
    fn leaves(&self) -> LeftToSampling;

    /// The same as [`FocusedLight::scattered`] for look-ups on a graphics card; `None` where it cannot be looked up there.
    fn packed(&self) -> Option<PackedFocused> {
        None
    }

    /// It stands for photons of its own in a picture's first pass, and where a card has no room for it the CPU draws that.
    fn is_sketch(&self) -> bool {
        false
    }
}

/// A ray that light is gathered along.
#[derive(Clone, Copy, Debug)]
pub struct GatherRay {
    /// Its direction is a unit vector.
    pub ray: Ray,
    /// Random numbers of what it meets.
    pub sampler: PixelSampler,
}

/// What such a ray brings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrived {
    /// See [`ArrivingLight::radiance`].
    pub radiance: Rgb,
    /// To what it meets first, m; `None` where that is nothing.
    pub distance_m: Option<f32>,
}

/// What arrives along rays: what records of light are gathered from.
pub trait ArrivingLight: fmt::Debug + Send + Sync {
    /// Radiance that arrives along `ray` from the first diffuse surface on its way, past mirrors and glass: what that surface
    /// scatters, not what it or a light emits, W/(m² sr).
    ///
    /// - `met`: what the ray meets first
    fn radiance(
        &self,
        world: &World,
        ray: &Ray,
        met: Option<Hit>,
        sampler: &PixelSampler,
        counts: &mut Counts,
    ) -> Rgb;

    /// Where much of it comes from, as far as that is known: hints that have no say in what it is.
    fn guide(&self) -> Option<&Guide> {
        None
    }

    /// How many rays are to be asked for together, about: those of one point, or as many as keep a card busy.
    fn rays_at_once(&self) -> usize {
        1
    }

    /// What arrives along all of `rays`, in their order; `None` if it was cancelled, which only those are who take many at once.
    fn along(
        &self,
        world: &World,
        rays: &[GatherRay],
        _cancel: &AtomicBool,
        counts: &mut Counts,
    ) -> Option<Vec<Arrived>> {
        let first: Vec<Ray> = rays.iter().map(|ray| ray.ray).collect();
        let mut met = vec![None; rays.len()];
        world.closest_hits(&first, &mut met);
        let arrived = rays.iter().zip(met).map(|(GatherRay { ray, sampler }, met)| Arrived {
            radiance: self.radiance(world, ray, met, sampler, counts),
            distance_m: met.map(|hit| hit.t),
        });
        Some(arrived.collect())
    }
}

/// Photon maps with what changed since the last ones.
#[derive(Debug, Default)]
pub struct PhotonProduct {
    /// The maps.
    pub maps: PhotonMaps,
    /// Counts up with every product of one technique.
    pub generation: u64,
    /// Where photons came or went since the generation before; `None`: anywhere.
    pub changed: Option<ChangedPhotons>,
    /// Some of those that maps hold, until the guide is made of them.
    flights: Mutex<Vec<Flight>>,
    guide: OnceLock<Option<Guide>>,
}

impl PhotonProduct {
    /// What a technique made.
    ///
    /// - `flights`: of photons that maps hold; see [`Flight::is_asked`]
    pub fn new(
        maps: PhotonMaps,
        generation: u64,
        changed: Option<ChangedPhotons>,
        flights: Vec<Flight>,
    ) -> PhotonProduct {
        PhotonProduct { maps, generation, changed, flights: Mutex::new(flights), guide: OnceLock::new() }
    }

    /// Memory.
    pub fn bytes(&self) -> usize {
        let guide = self.guide.get().and_then(Option::as_ref).map_or(0, Guide::bytes);
        self.maps.bytes() + self.flights().len() * size_of::<Flight>() + guide
    }

    fn flights(&self) -> MutexGuard<'_, Vec<Flight>> {
        self.flights.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the photons say of where light comes from; `None` without photons that paths could look for. Whoever asks first waits some
    /// tens of milliseconds.
    pub fn guide(&self) -> Option<&Guide> {
        // On the one thread that asks: sharing the work out could hand it another's question for the same.
        self.guide.get_or_init(|| Guide::of(std::mem::take(&mut *self.flights()))).as_ref()
    }
}

/// Places of photons that came or went, by class as in [`MAPPED`], and by the side they lie on.
pub type ChangedPhotons = [HashMap<SideId, Vec<Vec3>>; 2];

/// The newest of what is there so far.
#[derive(Clone, Debug, Default)]
pub struct Products {
    /// Photon maps.
    pub photons: Option<Arc<PhotonProduct>>,
    /// What is known of the light that surfaces receive by way of others.
    pub secondary: Option<Arc<dyn SecondaryLight>>,
    /// Caustics for one pass of a picture.
    pub caustics: Option<Arc<dyn FocusedLight>>,
}
