//! What of a scene lies on a card for every step: its trees, surfaces and lights.

use std::{sync::Arc, time::Instant};

use lumicast_shaders::Constant;

use super::{
    known::Shading,
    shadow_maps::constants_of_maps,
    tracing::{PathStart, WORKGROUP},
};
use crate::{
    accel::{AccelBuffers, GAMMA_5, GAMMA_19},
    gpu::{BindGroup, Binding, Buffer, GpuError, GpuTrees, Layout, Masks, Session},
    scene::Id,
    technique::{
        LIKE_COS, PHOTON_SURVIVAL_MAX,
        path::cpu::{BOUNCES_END, FROM_DIMENSION, NEAR_BLURS, NEAR_MAX, ROULETTE_FREE_BOUNCES, SURVIVAL_MAX},
    },
    transport::{
        AppearanceBuffers, BENT_MAX, GpuLight, POINT_ROOM, STRAIGHT_COS, TEXTURE_FLAGS, World, WorldBuffers,
        WorldFeatures,
        bsdf::{BROAD_ALPHA, SMOOTH_ALPHA},
    },
};

/// A scene on a card.
#[derive(Debug)]
pub(super) struct GpuWorld {
    pub(super) trees: GpuTrees,
    pub(super) trees_group: BindGroup,
    pub(super) trees_layout: Arc<Layout>,
    /// Of [`GpuWorld::BINDINGS`].
    pub(super) buffers: [Buffer; 8],
    pub(super) group: BindGroup,
    pub(super) layout: Arc<Layout>,
    pub(super) constants: Vec<(&'static str, Constant)>,
    /// Of each instance.
    pub(super) triangle_counts: Vec<u32>,
    /// Of packing it and bringing it, by [`World::surface_bytes`].
    pub(super) seconds_per_byte: f64,
}

/// A scene in words. Packing takes threads, and so is not done with a lock held.
#[derive(Debug)]
pub(super) struct PackedScene {
    trees: AccelBuffers,
    world: WorldBuffers,
    /// By instance.
    triangle_counts: Vec<u32>,
    /// Seconds of packing.
    seconds: f64,
    /// [`World::surface_bytes`].
    surface_bytes: usize,
}

impl PackedScene {
    pub(super) fn of(world: &World) -> PackedScene {
        let start = Instant::now();
        let trees = world.accel().upload();
        let count_of = |mesh_id: &Id| {
            let mesh = trees.meshes.binary_search_by(|mesh| mesh.mesh_id.cmp(mesh_id));
            mesh.map_or(0, |mesh| trees.meshes[mesh].triangle_count)
        };
        let instances = world.accel().instances().iter();
        let triangle_counts = instances.map(|instance| count_of(instance.mesh_id())).collect();
        let (surface_bytes, world) = (world.surface_bytes(), world.upload());
        PackedScene { triangle_counts, trees, world, seconds: start.elapsed().as_secs_f64(), surface_bytes }
    }

    /// As shaders number them.
    pub(super) fn lights(&self) -> &[GpuLight] {
        &self.world.appearance.lights
    }
}

impl GpuWorld {
    /// How steps see the scene beside its trees.
    pub(super) const BINDINGS: [Binding; 8] = [
        Binding::Uniform,
        Binding::Read,
        Binding::Read,
        Binding::Read,
        Binding::Read,
        Binding::Read,
        Binding::Read,
        Binding::Read,
    ];

    /// Places among them of what [`appearance_of`] makes.
    const OF_APPEARANCE: [usize; 5] = [0, 3, 5, 6, 7];

    pub(super) fn new(session: &Arc<Session>, packed: &PackedScene) -> Result<GpuWorld, GpuError> {
        let start = Instant::now();
        let constants = constants_of(packed);
        let PackedScene { trees, world: packed, triangle_counts, seconds, surface_bytes } = packed;
        let trees = GpuTrees::new(session, trees)?;
        let [header, materials, tables, lights, light_nodes] = appearance_of(session, &packed.appearance)?;
        let placements = session.buffer_of("placements", &packed.placements)?;
        let geometry = session.buffer_of("geometry", &packed.geometry)?;
        let texels = session.buffer_of("texels", &packed.texels)?;
        let buffers = [header, placements, geometry, materials, texels, tables, lights, light_nodes];
        let layout = session.layout(&GpuWorld::BINDINGS)?;
        let group = session.bind(&layout, &buffers.each_ref())?;
        let (trees_group, trees_layout) = (trees.bind(session)?, GpuTrees::layout(session)?);
        Ok(GpuWorld {
            trees,
            trees_group,
            trees_layout,
            buffers,
            group,
            layout,
            constants,
            triangle_counts: triangle_counts.clone(),
            seconds_per_byte: (seconds + start.elapsed().as_secs_f64()) / (*surface_bytes).max(1) as f64,
        })
    }
}

/// What steps are compiled with for a scene.
pub(super) fn constants_of(packed: &PackedScene) -> Vec<(&'static str, Constant)> {
    let features = packed.world.appearance.features;
    let masks = if features.has_masks { Masks::Asked } else { Masks::None };
    let mut constants = vec![
        ("WORKGROUP", Constant::U32(WORKGROUP)),
        ("SMOOTH_ALPHA", Constant::F32(SMOOTH_ALPHA)),
        ("FLOAT_MAX", Constant::F32(f32::MAX)),
        ("GAMMA_5", Constant::F32(GAMMA_5)),
        ("GAMMA_19", Constant::F32(GAMMA_19)),
        ("BOUNCES_END", Constant::U32(BOUNCES_END)),
        ("ROULETTE_FREE_BOUNCES", Constant::U32(ROULETTE_FREE_BOUNCES)),
        ("SURVIVAL_MAX", Constant::F32(SURVIVAL_MAX)),
        ("POINT_ROOM", Constant::F32(POINT_ROOM)),
        ("LIKE_COS", Constant::F32(LIKE_COS)),
        ("PHOTON_SURVIVAL_MAX", Constant::F32(PHOTON_SURVIVAL_MAX)),
        ("STRAIGHT_COS", Constant::F32(STRAIGHT_COS)),
        ("BENT_MAX", Constant::F32(BENT_MAX)),
    ];
    constants.extend(constants_of_features(features));
    constants.extend(constants_of_maps());
    constants.extend(TEXTURE_FLAGS.map(|(name, value)| (name, Constant::U32(value))));
    constants.extend(GpuTrees::constants(&packed.trees, masks));
    constants
}

/// What of them surfaces and lights call for, but for masks.
fn constants_of_features(features: WorldFeatures) -> [(&'static str, Constant); 4] {
    [
        ("HAS_TEXTURES", Constant::Bool(features.has_textures)),
        ("HAS_GLASS", Constant::Bool(features.has_glass)),
        ("HAS_GLTF", Constant::Bool(features.has_gltf)),
        ("HAS_SKY_PICTURE", Constant::Bool(features.has_sky_picture)),
    ]
}

/// Buffers of what surfaces look like and lights send out: header, materials, tables, lights, their nodes.
fn appearance_of(session: &Session, packed: &AppearanceBuffers) -> Result<[Buffer; 5], GpuError> {
    Ok([
        session.buffer_of("scene header", &[packed.header])?,
        session.buffer_of("materials", &packed.materials)?,
        session.buffer_of("tables", &packed.tables)?,
        session.buffer_of("lights", &packed.lights)?,
        session.buffer_of("light nodes", &packed.light_nodes)?,
    ])
}

impl GpuWorld {
    /// Steps that are compiled for this do for a scene that calls for those: what it does not call for costs them time and nothing else, and so
    /// does a larger stack.
    pub(super) fn does_for(&self, asked: &[(&'static str, Constant)]) -> bool {
        let does = |(name, asked): &(&str, Constant)| {
            let own = self.constants.iter().find(|(other, _)| other == name).map(|(_, own)| *own);
            match (own, *asked) {
                (Some(Constant::Bool(own)), Constant::Bool(asked)) => own || !asked,
                (Some(Constant::U32(own)), Constant::U32(asked)) if *name == "STACK_SIZE" => own >= asked,
                (own, asked) => own == Some(asked),
            }
        };
        asked.iter().all(does)
    }

    /// The same for an appearance.
    pub(super) fn does_for_appearance(&self, packed: &AppearanceBuffers) -> bool {
        let masks = [("HAS_MASKS", Constant::Bool(packed.features.has_masks))];
        self.does_for(&constants_of_features(packed.features)) && self.does_for(&masks)
    }

    /// Steps are compiled for glass.
    pub(super) fn has_glass(&self) -> bool {
        self.constants.contains(&("HAS_GLASS", Constant::Bool(true)))
    }

    /// Takes on another appearance; see [`World::appearance_after`].
    pub(super) fn take_on(&mut self, session: &Session, packed: &AppearanceBuffers) -> Result<(), GpuError> {
        let made = appearance_of(session, packed)?;
        GpuWorld::OF_APPEARANCE.into_iter().zip(made).for_each(|(at, buffer)| self.buffers[at] = buffer);
        self.group = session.bind(&self.layout, &self.buffers.each_ref())?;
        Ok(())
    }

    pub(super) fn constants_of_shade(
        &self,
        from: PathStart,
        shading: Shading,
    ) -> Vec<(&'static str, Constant)> {
        let mut constants = self.constants.clone();
        let asks = shading.asked.is_some();
        constants.push(("HAS_FOCUSED", Constant::Bool(shading.is_focused)));
        constants.push(("BROAD_ALPHA", Constant::F32(BROAD_ALPHA)));
        constants.push(("HAS_SECONDARY", Constant::Bool(asks)));
        constants.push(("LOOKS_PAST", Constant::Bool(asks && from == PathStart::Rays)));
        constants.push(("NEAR_BLURS", Constant::F32(NEAR_BLURS)));
        constants.push(("NEAR_MAX", Constant::U32(NEAR_MAX)));
        constants.push(("SHADOWS_KNOWN", Constant::Bool(asks && from == PathStart::Pixels)));
        constants.push(("FROM_DIMENSION", Constant::U32(FROM_DIMENSION)));
        constants
    }
}
