//! What a scene is made of and lit by, kept through edits: following one takes time in proportion to what it touches.

use std::{collections::HashMap, sync::Arc};

use super::{EffectPlan, SceneFacts};
use crate::scene::{Environment, Id, Light, LightKind, Material, Scene, SceneChange};

/// The facts of a scene, and what is needed to tell those of the next one.
#[derive(Clone, Debug, Default)]
pub struct Inventory {
    facts: SceneFacts,
    /// Triangles of every placed material, over all instances; those of none are not here.
    uses: HashMap<Id, u64>,
}

/// What is counted comes or goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Count {
    Add,
    Remove,
}

impl Inventory {
    /// Looks at all of a scene.
    pub fn of(scene: &Scene) -> Inventory {
        let mut inventory = Inventory::default();
        let (nodes, lights) = (scene.nodes().keys(), scene.lights().keys());
        inventory.take(&Scene::default(), scene, nodes, scene.materials().keys(), lights);
        inventory
    }

    /// Goes on to the next state of the scene it is of.
    pub fn follow(&mut self, before: &Scene, after: &Scene, change: &SceneChange) {
        self.take(before, after, change.nodes.iter(), change.materials.iter(), change.lights.iter());
    }

    /// What the scene calls for.
    pub fn plan(&self) -> EffectPlan {
        EffectPlan::from_facts(self.facts.clone())
    }

    fn take<'a>(
        &mut self,
        before: &Scene,
        after: &Scene,
        nodes: impl Iterator<Item = &'a Id>,
        materials: impl Iterator<Item = &'a Id>,
        lights: impl Iterator<Item = &'a Id>,
    ) {
        // Triangles before, of all materials that may count otherwise now.
        let mut touched: HashMap<Id, u64> = HashMap::new();
        for node in nodes {
            // Meshes never change under a node.
            self.count_mesh_of(before, node, Count::Remove, &mut touched);
            self.count_mesh_of(after, node, Count::Add, &mut touched);
        }
        for material in materials {
            let uses = self.uses.get(material).copied().unwrap_or(0);
            touched.entry(material.clone()).or_insert(uses);
        }
        for (id, triangles_before) in touched {
            let triangles = self.uses.get(&id).copied().unwrap_or(0);
            self.count_material(before.materials().get(&id), triangles_before, Count::Remove);
            self.count_material(after.materials().get(&id), triangles, Count::Add);
            if triangles == 0 {
                self.uses.remove(&id);
            }
        }
        for light in lights {
            let is_lit = |scene: &Scene| scene.lights().get(light).is_some_and(is_lit);
            self.facts.punctual_lights -= usize::from(is_lit(before));
            self.facts.punctual_lights += usize::from(is_lit(after));
        }
        self.facts.environment_is_lit = match after.environment() {
            Environment::None => false,
            Environment::Constant(radiance) => !radiance.is_black(),
            Environment::Image { scale, .. } => !scale.is_black(),
        };
    }

    fn count_mesh_of(&mut self, scene: &Scene, node: &Id, count: Count, touched: &mut HashMap<Id, u64>) {
        let mesh = scene.nodes().get(node).and_then(|node| scene.meshes().get(node.mesh.as_ref()?));
        for primitive in mesh.iter().flat_map(|mesh| mesh.primitives()) {
            let triangles = u64::from(primitive.triangle_count);
            let uses = self.uses.entry(primitive.material.clone()).or_insert(0);
            touched.entry(primitive.material.clone()).or_insert(*uses);
            count.apply(uses, triangles);
            count.apply(&mut self.facts.triangles, triangles);
        }
    }

    fn count_material(&mut self, material: Option<&Arc<Material>>, triangles: u64, count: Count) {
        let Some(material) = material.filter(|_| triangles > 0) else { return };
        if material.is_emissive() {
            count.apply(&mut self.facts.emissive_triangles, triangles);
        }
        self.facts.count(material, |number| match count {
            Count::Add => *number += 1,
            Count::Remove => *number -= 1,
        });
    }
}

impl Count {
    fn apply(self, number: &mut u64, by: u64) {
        match self {
            Count::Add => *number += by,
            Count::Remove => *number -= by,
        }
    }
}

fn is_lit(light: &Light) -> bool {
    match light.kind {
        LightKind::Point { intensity } | LightKind::Spot { intensity, .. } => !intensity.is_black(),
        LightKind::Directional { irradiance } => !irradiance.is_black(),
    }
}
