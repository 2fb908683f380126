//! Caustics of a picture's first pass, from a sketch: on a card where that draws it.

use std::sync::Arc;

use super::Rendering;
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
}

impl Rendering {
    /// What its camera sees of the sketch, if it has one and shows it.
    pub(super) fn seen_of_sketch(&mut self) -> Option<Seen> {
        self.caustics.as_ref()?;
        let is_on_gpu = self.has_card();
        let Sketched { sketch, seen } = self.sketch.as_ref()?;
        if let Some(seen) = seen.as_ref().filter(|seen| is_on_gpu || !seen.is_on_card) {
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
    fn has_card(&self) -> bool {
        false
    }

    #[cfg(not(feature = "gpu"))]
    fn seen_by_card(&mut self, _sketch: &Arc<CausticSketch>) -> Option<Seen> {
        None
    }
}

#[cfg(feature = "gpu")]
impl Rendering {
    fn has_card(&self) -> bool {
        self.is_on_gpu()
    }

    /// What a card finds that its camera sees; `None` where none draws, or this one cannot: then the CPU finds it out, and the card draws
    /// what comes after the first pass.
    fn seen_by_card(&mut self, sketch: &Arc<CausticSketch>) -> Option<Seen> {
        let scene = Arc::clone(self.gpu_scene()?);
        let light = sketch.for_card(&self.view)?;
        let is_fit = self.counted_as_card_work(|| scene.is_fit(&light)).ok()?;
        Some(Seen { light: is_fit.then_some(light), is_on_card: true })
    }
}
