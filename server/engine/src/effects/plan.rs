//! From facts to what runs, in plain words.

use super::{Inventory, SceneFacts};
use crate::scene::Scene;

/// A part of light transport that a scene may or may not call for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum EffectKind {
    /// Scattering in all directions.
    Diffuse,
    /// Highlights and blurred reflections.
    Glossy,
    /// Sharp reflections.
    Mirror,
    /// Refraction.
    Glass,
    /// Coloured glass and liquids.
    Absorption,
    /// Any texture look-up.
    Textures,
    /// Shading normals from pictures.
    NormalMaps,
    /// Surfaces cut out by pictures.
    AlphaMask,
    /// Emitting surfaces: soft shadows.
    AreaLights,
    /// Point, spot and directional lights.
    PunctualLights,
    /// Light from around the scene.
    Environment,
    /// Light focused by reflection or refraction on diffuse surfaces.
    Caustics,
    /// Light between diffuse surfaces.
    Indirect,
}

impl EffectKind {
    /// Name in statistics and the protocol.
    pub fn name(self) -> &'static str {
        match self {
            EffectKind::Diffuse => "diffuse",
            EffectKind::Glossy => "glossy",
            EffectKind::Mirror => "mirror",
            EffectKind::Glass => "glass",
            EffectKind::Absorption => "absorption",
            EffectKind::Textures => "textures",
            EffectKind::NormalMaps => "normal_maps",
            EffectKind::AlphaMask => "alpha_mask",
            EffectKind::AreaLights => "area_lights",
            EffectKind::PunctualLights => "punctual_lights",
            EffectKind::Environment => "environment",
            EffectKind::Caustics => "caustics",
            EffectKind::Indirect => "indirect",
        }
    }
}

/// One effect, on or off, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Effect {
    /// Which.
    pub kind: EffectKind,
    /// It runs.
    pub is_on: bool,
    /// The fact of the scene that decides.
    pub reason: String,
}

/// Every effect, in the order of [`EffectKind`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EffectPlan {
    /// What decided.
    pub facts: SceneFacts,
    /// The effects.
    pub effects: Vec<Effect>,
}

impl EffectPlan {
    /// The plan of a scene.
    pub fn of(scene: &Scene) -> EffectPlan {
        Inventory::of(scene).plan()
    }

    /// The plan of a scene of which these are the facts.
    pub(super) fn from_facts(facts: SceneFacts) -> EffectPlan {
        EffectPlan { effects: effects(&facts), facts }
    }

    /// Whether an effect runs.
    pub fn is_on(&self, kind: EffectKind) -> bool {
        self.effects.iter().any(|effect| effect.kind == kind && effect.is_on)
    }
}

fn effects(facts: &SceneFacts) -> Vec<Effect> {
    use EffectKind::*;
    let of_materials = |kind, count: usize, on: &str, off: &str| Effect {
        kind,
        is_on: count > 0,
        reason: match count {
            0 => format!("no placed material {off}"),
            1 => format!("1 of {} materials {off}", facts.materials),
            _ => format!("{count} of {} materials {on}", facts.materials),
        },
    };
    vec![
        of_materials(Diffuse, facts.diffuse, "scatter diffusely", "scatters diffusely"),
        of_materials(Glossy, facts.glossy, "have rough reflections", "has rough reflections"),
        of_materials(Mirror, facts.mirror, "have sharp reflections", "has sharp reflections"),
        of_materials(Glass, facts.glass, "let light through", "lets light through"),
        of_materials(Absorption, facts.absorbing, "colour the light inside", "colours the light inside"),
        of_materials(Textures, facts.textured, "have a texture", "has a texture"),
        of_materials(NormalMaps, facts.normal_mapped, "have a normal map", "has a normal map"),
        of_materials(AlphaMask, facts.masked, "have an alpha mask", "has an alpha mask"),
        Effect {
            kind: AreaLights,
            is_on: facts.emissive_triangles > 0,
            reason: match facts.emissive_triangles {
                0 => "no triangle sends out light: no soft shadows".into(),
                count => format!("{count} of {} triangles send out light", facts.triangles),
            },
        },
        Effect {
            kind: PunctualLights,
            is_on: facts.punctual_lights > 0,
            reason: match facts.punctual_lights {
                0 => "no point, spot or directional light that shines".into(),
                1 => "1 point, spot or directional light".into(),
                count => format!("{count} point, spot or directional lights"),
            },
        },
        Effect {
            kind: Environment,
            is_on: facts.environment_is_lit,
            reason: if facts.environment_is_lit {
                "light arrives from around"
            } else {
                "black around the scene"
            }
            .into(),
        },
        caustics(facts),
        indirect(facts),
    ]
}

fn caustics(facts: &SceneFacts) -> Effect {
    let senders = [(facts.mirror, "mirrors"), (facts.glossy, "glossy surfaces"), (facts.glass, "glass")];
    let senders: Vec<&str> = senders.iter().filter(|(count, _)| *count > 0).map(|(_, name)| *name).collect();
    let (senders, them) = match senders[..] {
        ["glass"] => ("glass sends".into(), "it"),
        _ => (format!("{} send", senders.join(" and ")), "them"),
    };
    let (is_on, reason) = if !facts.is_lit() {
        (false, "nothing sends out light".into())
    } else if !facts.is_specular() {
        (false, "all surfaces scatter diffusely: none is a mirror, glossy or glass".into())
    } else if facts.diffuse == 0 && facts.glossy > 0 && facts.hides_light() {
        (
            true,
            "mirrors or glass send the light of lamps without size on to glossy surfaces: photons alone find it"
                .into(),
        )
    } else if facts.diffuse == 0 {
        (false, "no diffuse surface for focused light to fall on".into())
    } else if facts.emissive_triangles == 0 && !facts.environment_is_lit && facts.glossy == 0 {
        let light = "the light of lamps without size";
        (true, format!("{senders} {light} on to diffuse surfaces: photons alone find it"))
    } else {
        (true, format!("{senders} light on to diffuse surfaces: photons are aimed at {them}"))
    };
    Effect { kind: EffectKind::Caustics, is_on, reason }
}

fn indirect(facts: &SceneFacts) -> Effect {
    let (is_on, reason) = if !facts.is_lit() {
        (false, "nothing sends out light")
    } else if facts.diffuse == 0 {
        (false, "no surface scatters diffusely")
    } else if facts.triangles < 2 {
        (false, "a single triangle cannot light another")
    } else {
        (true, "diffuse surfaces can light each other")
    };
    Effect { kind: EffectKind::Indirect, is_on, reason: reason.into() }
}
