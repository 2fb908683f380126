//! What a batch of changes touched: what is kept of light is followed by it.

use indexmap::IndexSet;

use super::Id;

/// What the changes of one builder touched, by id, removed objects included.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SceneChange {
    /// Nodes added, removed or moved, with all their descendants.
    pub nodes: IndexSet<Id>,
    /// Meshes added or removed.
    pub meshes: IndexSet<Id>,
    /// Materials added, changed or removed.
    pub materials: IndexSet<Id>,
    /// Lights added, changed, moved or removed.
    pub lights: IndexSet<Id>,
    /// Cameras added, changed, moved or removed.
    pub cameras: IndexSet<Id>,
    /// The environment changed.
    pub environment: bool,
}

impl SceneChange {
    /// Adds what another change touched.
    pub fn join(&mut self, other: &SceneChange) {
        self.nodes.extend(other.nodes.iter().cloned());
        self.meshes.extend(other.meshes.iter().cloned());
        self.materials.extend(other.materials.iter().cloned());
        self.lights.extend(other.lights.iter().cloned());
        self.cameras.extend(other.cameras.iter().cloned());
        self.environment |= other.environment;
    }

    /// True when nothing changed but cameras, if anything: all light stays valid.
    pub fn leaves_light_alone(&self) -> bool {
        self.nodes.is_empty()
            && self.meshes.is_empty()
            && self.materials.is_empty()
            && self.lights.is_empty()
            && !self.environment
    }
}
