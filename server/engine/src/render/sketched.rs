//! Caustics of a picture's first pass, from a sketch: on a card where that draws it.

use std::sync::Arc;

use super::Rendering;
#[cfg(feature = "gpu")]
use crate::gpu::GpuError;
use crate::technique::{FocusedLight, caustics::CausticSketch};

/// A sketch, and what the picture's camera sees of it once that was asked.
#[derive(Debug)]
pub(super) struct Sketched {
    sketch: Arc<CausticSketch>,
    seen: Option<Seen>,
}

/// Kept while the first pass is drawn: one that was cut goes on with the same.
#[derive(Clone, Debug, Default)]
pub(super) struct Seen {
    /// `None`: too little.
    pub(super) light: Option<Arc<dyn FocusedLight>>,
    /// A card counted it, and draws with it.
    pub(super) is_on_card: bool,
}

impl Sketched {
    pub(super) fn new(sketch: Arc<CausticSketch>) -> Sketched {
        Sketched { sketch, seen: None }
    }

    /// It is one of that.
    pub(super) fn is_of(&self, sketch: &Arc<CausticSketch>) -> bool {
        Arc::ptr_eq(&self.sketch, sketch)
    }

    /// The first pass is drawn: what was seen is not needed any more.
    pub(super) fn end(&mut self) {
        self.seen = None;
    }
}

impl Rendering {
    /// What its camera sees of the sketch, if it has one and shows it.
    pub(super) fn seen_of_sketch(&mut self) -> Option<Seen> {
        self.caustics.as_ref()?;
        let is_by_card = self.sketches_on_gpu();
        let Sketched { sketch, seen } = self.sketch.as_ref()?;
        if let Some(seen) = seen.as_ref().filter(|seen| is_by_card || !seen.is_on_card) {
            return Some(seen.clone());
        }
        let sketch = Arc::clone(sketch);
        let seen = self
            .seen_by_card(&sketch)
            .unwrap_or_else(|| Seen { light: sketch.seen_by(&self.view), is_on_card: false });
        self.sketch = Some(Sketched { sketch, seen: Some(seen.clone()) });
        Some(seen)
    }

    #[cfg(not(feature = "gpu"))]
    fn sketches_on_gpu(&self) -> bool {
        false
    }

    #[cfg(not(feature = "gpu"))]
    fn seen_by_card(&mut self, _sketch: &Arc<CausticSketch>) -> Option<Seen> {
        None
    }
}

#[cfg(feature = "gpu")]
impl Rendering {
    /// What a card finds that its camera sees; `None` where none draws, or this one has no room: then the CPU finds it out, and the card
    /// draws what comes after the first pass. One that fails at it is given up, as by drawing.
    fn seen_by_card(&mut self, sketch: &Arc<CausticSketch>) -> Option<Seen> {
        let scene = Arc::clone(self.gpu_scene().filter(|_| self.sketches_on_gpu())?);
        let light = sketch.for_card(&self.view)?;
        match self.counted_as_card_work(|| scene.is_fit(&light)) {
            Ok(is_fit) => Some(Seen { light: is_fit.then_some(light), is_on_card: true }),
            Err(GpuError::LightTooLarge { .. } | GpuError::OutOfMemory { .. }) => None,
            Err(error) => {
                self.give_gpu_up(error);
                None
            }
        }
    }
}
