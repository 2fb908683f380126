//! What those who look choose in place of the plan.

use super::{Effect, EffectKind, EffectPlan};
use crate::transport::{PathClass, PathClasses};

/// Whether an effect runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum EffectChoice {
    /// As the scene calls for.
    #[default]
    Plan,
    /// Though the scene does not call for it: that costs time and changes nothing that is seen.
    On,
    /// Though the scene may call for it: its light is missing, and the error is measured against pictures without it.
    Off,
}

/// Choices of the effects that are computed by themselves. The others are what the scene's materials, textures and lights are:
/// they come and go with edits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct EffectChoices {
    /// Light focused by reflection or refraction on diffuse surfaces.
    pub caustics: EffectChoice,
    /// Light between diffuse surfaces.
    pub indirect: EffectChoice,
}

impl EffectChoice {
    /// Whether the effect runs.
    ///
    /// - `plan`: what the plan says
    pub fn runs(self, plan: bool) -> bool {
        match self {
            EffectChoice::Plan => plan,
            EffectChoice::On => true,
            EffectChoice::Off => false,
        }
    }
}

impl EffectChoices {
    /// The effects that can be chosen.
    pub const KINDS: [EffectKind; 2] = [EffectKind::Caustics, EffectKind::Indirect];

    /// What is chosen of an effect; `None` for those that cannot be.
    pub fn choice_mut(&mut self, kind: EffectKind) -> Option<&mut EffectChoice> {
        match kind {
            EffectKind::Caustics => Some(&mut self.caustics),
            EffectKind::Indirect => Some(&mut self.indirect),
            _ => None,
        }
    }

    /// Classes of paths that are left to be shown.
    pub fn shown(self) -> PathClasses {
        let classes = [(self.caustics, PathClass::Caustic), (self.indirect, PathClass::Indirect)];
        let off = classes.into_iter().filter(|(choice, _)| *choice == EffectChoice::Off);
        off.fold(PathClasses::ALL, |shown, (_, class)| shown.without(class))
    }
}

impl EffectPlan {
    /// The plan with what was chosen in its place, and the reasons of either.
    pub fn chosen(mut self, mut choices: EffectChoices) -> EffectPlan {
        for Effect { kind, is_on, reason } in &mut self.effects {
            let runs = choices.choice_mut(*kind).map_or(*is_on, |choice| choice.runs(*is_on));
            if runs != *is_on {
                (*is_on, *reason) = (runs, format!("chosen, though {reason}"));
            }
        }
        self
    }
}
