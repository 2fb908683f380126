//! Building the trees of a scene, and bringing them up to date after an edit.

use std::{sync::Arc, time::Instant};

use glam::DVec3;
use rayon::prelude::*;

use super::{
    Accel, AccelReport, Bottoms,
    bottom::BottomTree,
    instance::Instance,
    instructions::Instructions,
    restore::{Restorer, Top},
    top::{TopTree, Wear},
};
use crate::scene::{Aabb, Id, Mesh, Scene, SceneChange};

impl Accel {
    /// Builds the trees of a scene from nothing.
    pub fn build(scene: &Scene) -> Accel {
        let start = Instant::now();
        let (bottoms, trees_built) = bottoms_of(scene, &Bottoms::new());
        Accel::over(scene, Arc::new(bottoms), Arc::default(), trees_built, start)
    }

    /// The trees of the next state of a scene. Meshes that stayed keep theirs; nodes that were moved, added or removed
    /// change the tree over instances in proportion to their number. Answers are those of a fresh build, to the last
    /// bit.
    pub fn updated(&self, scene: &Scene, change: &SceneChange) -> Accel {
        let start = Instant::now();
        let (bottoms, trees_built) = if change.meshes.is_empty() {
            (self.bottoms.clone(), 0)
        } else {
            let (bottoms, built) = bottoms_of(scene, &self.bottoms);
            (Arc::new(bottoms), built)
        };
        let mut next = Accel { bottoms, ..self.clone() };
        next.report.trees_built = trees_built;
        let moved_only = change.nodes.iter().all(|id| {
            let shows = scene.nodes().get(id).is_some_and(|node| next.shows(node.mesh.as_ref()));
            match self.numbers.get(id) {
                Some(number) => shows && self.keeps_its_place(scene, *number),
                None => !shows,
            }
        });
        let mut top = None;
        if moved_only {
            let moved = change.nodes.iter().filter_map(|id| Some((id, *self.numbers.get(id)?)));
            for (id, number) in moved {
                let before = &self.instances[number as usize];
                let Some(instance) = next.place(scene, id) else { continue };
                if !Arc::ptr_eq(before.mesh(), instance.mesh()) {
                    // Another mesh under the same node: it was removed and added again.
                    return Accel::over(scene, next.bottoms, self.restorer.clone(), trees_built, start);
                }
                top.get_or_insert_with(|| self.top.tree().clone()).refit(number, &instance);
                next.instances[number as usize] = Arc::new(instance);
            }
        } else {
            top = Some(next.renumber(self, scene, change));
        }
        if origin_of(&next.instances) != self.origin_in_world {
            return Accel::over(scene, next.bottoms, self.restorer.clone(), trees_built, start);
        }
        if let Some(mut top) = top {
            top.finish();
            let wear = top.wear();
            next.report.top_growth = top.growth();
            if wear == Wear::Out {
                top = TopTree::build(&next.instances);
            }
            next.top = Arc::new(Top::new(top));
            if wear == Wear::Worn {
                next.restorer.restore(&next.top, &next.instances);
            }
        }
        next.measure(start);
        next
    }

    /// Places every node anew, around the origin that the scene's bounds ask for.
    fn over(
        scene: &Scene,
        bottoms: Arc<Bottoms>,
        restorer: Arc<Restorer>,
        trees_built: usize,
        start: Instant,
    ) -> Accel {
        let mut accel = Accel {
            origin_in_world: DVec3::ZERO,
            bottoms,
            instances: Vec::new(),
            numbers: Arc::default(),
            top: Arc::new(Top::new(TopTree::build(&[]))),
            restorer,
            level: Instructions::Avx2.level(),
            bottom_stack_need: 0,
            shear_rounding: 0.0,
            radius: 0.0,
            report: AccelReport { trees_built, ..AccelReport::default() },
        };
        let bounds =
            accel.shown(scene).map(|(id, mesh)| mesh.bounds().transformed(&scene.world_from_node(Some(id))));
        accel.origin_in_world = origin_of_bounds(bounds.reduce(|a, b| a.union(&b)));
        let placed: Vec<Arc<Instance>> =
            accel.shown(scene).filter_map(|(id, _)| accel.place(scene, id).map(Arc::new)).collect();
        accel.instances = placed;
        accel.top = Arc::new(Top::new(TopTree::build(&accel.instances)));
        accel.count();
        accel.measure(start);
        accel
    }

    /// Takes over what stayed in place, in the scene's order, and returns the top tree with what came and went.
    fn renumber(&mut self, before: &Accel, scene: &Scene, change: &SceneChange) -> TopTree {
        let mut number = vec![None; before.instances.len()];
        let mut come = Vec::new();
        let mut moved = Vec::new();
        let mut instances = Vec::with_capacity(before.instances.len());
        for (id, mesh) in self.shown(scene) {
            let index = instances.len() as u32;
            let old = before.numbers.get(id).map(|old| (*old, &before.instances[*old as usize]));
            let same_mesh = old.filter(|(_, instance)| Arc::ptr_eq(instance.mesh(), mesh));
            let is_touched = change.nodes.contains(id);
            match same_mesh {
                Some((old, instance)) => {
                    number[old as usize] = Some(index);
                    if is_touched {
                        moved.push(index);
                        instances.extend(self.place(scene, id).map(Arc::new));
                    } else {
                        instances.push(instance.clone());
                    }
                }
                None => {
                    come.push(index);
                    instances.extend(self.place(scene, id).map(Arc::new));
                }
            }
        }
        let mut top = before.top.tree().clone();
        for (old, _) in number.iter().enumerate().filter(|(_, new)| new.is_none()) {
            top.remove(old as u32);
        }
        top.renumber(&number, instances.len());
        for index in moved {
            top.refit(index, &instances[index as usize]);
        }
        for index in come {
            top.insert(index, &instances[index as usize]);
        }
        self.instances = instances;
        self.count();
        top
    }

    /// False for an instance whose node was removed and added again, which put it at the scene's end. All instances keep
    /// their order when each that was touched still stands between its neighbours.
    fn keeps_its_place(&self, scene: &Scene, number: u32) -> bool {
        let neighbours = (number.saturating_sub(1)..=number + 1).filter_map(|number| {
            let instance = self.instances.get(number as usize)?;
            scene.nodes().get_index_of(instance.node_id())
        });
        neighbours.is_sorted()
    }

    /// Nodes that show something, in the scene's order, with what they show.
    fn shown<'a>(&'a self, scene: &'a Scene) -> impl Iterator<Item = (&'a Id, &'a Arc<Mesh>)> {
        scene.nodes().iter().filter_map(|(id, node)| {
            let mesh = node.mesh.as_ref()?;
            Some((id, &self.bottoms.get(mesh)?.0))
        })
    }

    fn shows(&self, mesh: Option<&Id>) -> bool {
        mesh.is_some_and(|mesh| self.bottoms.contains_key(mesh))
    }

    /// The instance of a node; `None` when it shows nothing.
    fn place(&self, scene: &Scene, id: &Id) -> Option<Instance> {
        let mesh_id = scene.nodes().get(id)?.mesh.as_ref()?;
        let (mesh, bottom) = self.bottoms.get(mesh_id)?;
        let world_from_mesh = scene.world_from_node(Some(id));
        let shown = (mesh.clone(), bottom.clone());
        Some(Instance::new(id.clone(), mesh_id.clone(), shown, world_from_mesh, self.origin_in_world))
    }

    /// Brings into step what follows from the list of instances.
    fn count(&mut self) {
        let numbers = self.instances.iter().enumerate();
        self.numbers =
            Arc::new(numbers.map(|(number, instance)| (instance.node_id().clone(), number as u32)).collect());
        let needs = self.instances.iter().map(|instance| instance.bottom().tree().stack_need());
        self.bottom_stack_need = needs.max().unwrap_or(0);
    }

    fn measure(&mut self, start: Instant) {
        let reach = |instance: &Arc<Instance>| {
            let bounds = instance.bounds_in_world();
            let corner =
                (bounds.min - self.origin_in_world).abs().max((bounds.max - self.origin_in_world).abs());
            corner.length() as f32 * (1.0 + f32::EPSILON)
        };
        self.radius = self.instances.iter().map(reach).fold(0.0, f32::max);
        let conditions = self.instances.iter().map(|instance| instance.condition());
        self.shear_rounding = (conditions.fold(1.0, f32::max) - 1.0) * 8.0 * f32::EPSILON;
        self.report.build_seconds = start.elapsed().as_secs_f64();
    }
}

/// The trees of every mesh that a node shows, those in `known` taken over, and how many were built.
fn bottoms_of(scene: &Scene, known: &Bottoms) -> (Bottoms, usize) {
    let mut wanted: Vec<(&Id, &Arc<Mesh>)> = scene
        .nodes()
        .values()
        .filter_map(|node| scene.meshes().get_key_value(node.mesh.as_ref()?))
        .filter(|(_, mesh)| !mesh.triangles().is_empty())
        .collect();
    wanted.sort_unstable_by_key(|(id, _)| *id);
    wanted.dedup_by_key(|(id, _)| *id);
    let taken_over = |id: &Id, mesh: &Arc<Mesh>| {
        known.get(id).filter(|(same, _)| Arc::ptr_eq(same, mesh)).map(|(_, tree)| tree.clone())
    };
    let trees: Vec<(bool, Arc<BottomTree>)> = wanted
        .par_iter()
        .map(|(id, mesh)| match taken_over(id, mesh) {
            Some(tree) => (false, tree),
            None => (true, Arc::new(BottomTree::build(mesh))),
        })
        .collect();
    let built = trees.iter().filter(|(is_new, _)| *is_new).count();
    let bottoms = wanted
        .into_iter()
        .zip(trees)
        .map(|((id, mesh), (_, tree))| (id.clone(), (mesh.clone(), tree)))
        .collect();
    (bottoms, built)
}

fn origin_of(instances: &[Arc<Instance>]) -> DVec3 {
    let bounds = instances.iter().map(|instance| *instance.bounds_in_world());
    origin_of_bounds(bounds.reduce(|a, b| a.union(&b)))
}

/// Render space's origin for a scene with these bounds: their centre, rounded to a grid of half to all of the scene's
/// size. Most edits leave it where it is, so that what stands still keeps its place in render space; it depends on
/// nothing but the scene, so that a scene looks the same whatever edits led to it.
fn origin_of_bounds(bounds: Option<Aabb>) -> DVec3 {
    let Some(bounds) = bounds else { return DVec3::ZERO };
    let size = (bounds.max - bounds.min).max_element();
    // A power of two: multiples of it are exact.
    let grid = (size.max(f64::from(f32::MIN_POSITIVE)).log2().ceil() - 1.0).exp2();
    (bounds.centre() / grid).round() * grid
}
