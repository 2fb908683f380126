//! Whatever edits led to a scene, its trees answer as if built from nothing.

use super::*;
use crate::scene::{Node, SceneBuilder, SceneChange, SceneLimits};

/// Answers, numbers and places are those of a fresh build.
pub(super) fn assert_as_built(
    updated: &Accel,
    scene: &Scene,
    numbers: &mut Numbers,
    rays: usize,
    what: &str,
) {
    let fresh = Accel::build(scene);
    let names =
        |accel: &Accel| -> Vec<Id> { accel.instances().iter().map(|i| i.node_id().clone()).collect() };
    assert_eq!(names(updated), names(&fresh), "order of instances after {what}");
    assert_eq!(updated.origin_in_world(), fresh.origin_in_world(), "origin after {what}");
    assert_eq!(updated.radius(), fresh.radius(), "radius after {what}");
    for (number, instance) in updated.instances().iter().enumerate() {
        assert_eq!(updated.numbers.get(instance.node_id()), Some(&(number as u32)), "number after {what}");
        assert!(
            std::sync::Arc::ptr_eq(instance.mesh(), fresh.instances()[number].mesh()),
            "mesh after {what}"
        );
    }
    assert_eq!(updated.numbers.len(), updated.instances().len(), "numbers after {what}");
    for _ in 0..rays {
        let ray = ray_into(&fresh, numbers);
        let expected = fresh.closest_hit(&ray, |_| true);
        assert_eq!(updated.closest_hit(&ray, |_| true), expected, "{ray:?} after {what}");
        assert_eq!(updated.is_occluded(&ray, |_| true), expected.is_some(), "{ray:?} after {what}");
    }
}

/// Half the rays aim at a surface, however far apart surfaces are.
fn ray_into(accel: &Accel, numbers: &mut Numbers) -> Ray {
    let point = |numbers: &mut Numbers| {
        let instances = accel.instances();
        if instances.is_empty() {
            return Vec3::ZERO;
        }
        let instance = &instances[numbers.index(instances.len())];
        let (b1, b2) = numbers.barycentric();
        instance.surface_point(numbers.index(instance.mesh().triangles().len()) as u32, b1, b2).position
    };
    let origin = match numbers.index(3) {
        0 => point(numbers) + numbers.direction() * numbers.next() as f32,
        1 => numbers.point(f64::from(accel.radius())).as_vec3(),
        _ => numbers.direction() * accel.radius(),
    };
    Ray::new(origin, if numbers.next() < 0.5 { point(numbers) - origin } else { numbers.direction() })
}

/// Scenes in the making: what may be done next is drawn at random.
struct Playground {
    scene: Scene,
    accel: Accel,
    numbers: Numbers,
    named: usize,
}

impl Playground {
    fn new(seed: u64) -> Playground {
        let (stage, _) = stage_with_grey();
        let scene = stage.finish();
        Playground { accel: Accel::build(&scene), scene, numbers: Numbers(seed), named: 0 }
    }

    fn builder(&self) -> SceneBuilder {
        SceneBuilder::from_scene(&self.scene, SceneLimits::default())
    }

    fn adopt(&mut self, builder: SceneBuilder, what: &str) {
        let (scene, change) = builder.finish();
        self.accel = self.accel.updated(&scene, &change);
        self.scene = scene;
        assert_as_built(&self.accel, &self.scene, &mut self.numbers, 60, what);
    }

    fn transform(&mut self) -> DAffine3 {
        let numbers = &mut self.numbers;
        let at = match numbers.index(12) {
            0 => numbers.point(100.0),
            1 => numbers.point(1e5),
            _ => numbers.point(3.0),
        };
        let scale =
            DVec3::new(numbers.between(0.3, 2.0), numbers.between(0.3, 2.0), numbers.between(-2.0, -0.3));
        match numbers.index(4) {
            0 => DAffine3::from_translation(at),
            1 => DAffine3::from_mat3_translation(numbers.turn(), at),
            2 => DAffine3::from_mat3_translation(numbers.turn() * DMat3::from_diagonal(scale), at),
            _ => {
                let sheared = numbers.turn() * DMat3::from_diagonal(scale) * numbers.turn();
                DAffine3::from_mat3_translation(sheared, at)
            }
        }
    }

    fn any<'a, T>(numbers: &mut Numbers, mut all: impl ExactSizeIterator<Item = (&'a Id, T)>) -> Option<Id> {
        let count = all.len();
        (count > 0).then(|| all.nth(numbers.index(count)).unwrap().0.clone())
    }

    /// One random change; returns what it was. Refusals change nothing and are part of the game.
    fn change(&mut self, builder: &mut SceneBuilder) -> String {
        let node = Playground::any(&mut self.numbers, builder.scene().nodes().iter());
        let kind = self.numbers.index(10);
        match (kind, node) {
            (0..=3, Some(node)) => {
                let _ = builder.set_transform(node.as_str(), self.transform());
                format!("moving {node}")
            }
            (4 | 5, Some(node)) => {
                builder.remove_node(node.as_str()).unwrap();
                format!("removing {node}")
            }
            (6, Some(id)) => {
                // The same name again, where its mesh still exists with it or else as a group.
                let before = builder.scene().nodes()[&id].clone();
                builder.remove_node(id.as_str()).unwrap();
                let mesh = before.mesh.filter(|mesh| builder.scene().meshes().contains_key(mesh));
                let node = Node { parent: None, parent_from_node: self.transform(), mesh };
                let _ = builder.add_node(id.clone(), node);
                format!("removing and adding {id}")
            }
            (_, parent) => {
                self.named += 1;
                let id = Id::sanitised(&format!("{}", self.named), "node");
                let parent = parent.filter(|_| self.numbers.next() < 0.4);
                let known = Playground::any(&mut self.numbers, builder.scene().meshes().iter());
                let mesh = match self.numbers.index(5) {
                    0 => None,
                    1 | 2 if known.is_some() => known,
                    _ => {
                        builder.set_material(Id::new("grey").unwrap(), Material::default()).unwrap();
                        builder.add_mesh(id.clone(), self.mesh()).unwrap();
                        Some(id.clone())
                    }
                };
                let node = Node { parent, parent_from_node: self.transform(), mesh };
                let _ = builder.add_node(id.clone(), node);
                format!("adding {id}")
            }
        }
    }

    fn mesh(&mut self) -> MeshSource {
        let grey = Id::new("grey").unwrap();
        match self.numbers.index(5) {
            0 => soup(&mut self.numbers, 1, 0.1, 1.0, &grey),
            1 => soup(&mut self.numbers, 9, 0.6, 0.5, &grey),
            2 => samples::cuboid(DVec3::NEG_ONE, DVec3::ONE, &grey),
            3 => samples::sphere(self.numbers.point(2.0), 0.7, 6, &grey),
            _ => soup(&mut self.numbers, 150, 1.0, 0.3, &grey),
        }
    }
}

/// Any sequence of edits, alone and in batches, leads to the answers of a fresh build.
#[test]
fn any_sequence_of_edits_answers_as_a_fresh_build() {
    let (sequences, steps) = if is_nightly() { (2000, 60) } else { (48, 30) };
    (0..sequences).into_par_iter().for_each(|sequence| {
        let mut playground = Playground::new(1000 + sequence);
        for step in 0..steps {
            let mut builder = playground.builder();
            let changes = [1, 1, 1, 2, 5, 12][playground.numbers.index(6)];
            let done: Vec<String> = (0..changes).map(|_| playground.change(&mut builder)).collect();
            playground.adopt(builder, &format!("sequence {sequence} step {step}: {}", done.join(", ")));
            if step % 13 == 12 {
                let mut builder = playground.builder();
                let all: Vec<Id> = builder.scene().nodes().keys().cloned().collect();
                for id in all {
                    // Children have gone with their parents.
                    let _ = builder.remove_node(id.as_str());
                }
                playground.adopt(builder, &format!("sequence {sequence} step {step}: removing everything"));
            }
        }
    });
}

/// The number of an instance is its place in the scene, also of a node that was removed and added again in one edit.
#[test]
fn a_node_removed_and_added_in_one_edit_comes_last() {
    let (mut stage, grey) = stage_with_grey();
    stage.place("a", samples::cuboid(DVec3::NEG_ONE, DVec3::ONE, &grey), DAffine3::IDENTITY).unwrap();
    let mut again = Node { parent: None, parent_from_node: DAffine3::IDENTITY, mesh: Id::new("a") };
    for name in ["b", "c"] {
        stage.builder().add_node(Id::new(name).unwrap(), again.clone()).unwrap();
    }
    let scene = stage.finish();
    let first = Accel::build(&scene);
    for name in ["a", "b", "c"] {
        let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
        builder.remove_node(name).unwrap();
        again.parent_from_node = DAffine3::from_translation(DVec3::new(0.1, 0.0, 0.0));
        builder.add_node(Id::new(name).unwrap(), again.clone()).unwrap();
        let (next, change) = builder.finish();
        let mut numbers = Numbers(137);
        assert_as_built(&first.updated(&next, &change), &next, &mut numbers, 200, name);
    }
}

/// Hundreds of bodies that come to one place one by one, and go again, leave trees that answer rightly however deep.
#[test]
fn bodies_that_pile_up_in_one_place_answer_as_a_fresh_build() {
    let mut numbers = Numbers(139);
    let (mut stage, grey) = stage_with_grey();
    stage.place("0", soup(&mut numbers, 40, 1.0, 0.5, &grey), DAffine3::IDENTITY).unwrap();
    let mut scene = stage.finish();
    let mut accel = Accel::build(&scene);
    let apply = |scene: &mut Scene, accel: &mut Accel, edit: &mut dyn FnMut(&mut SceneBuilder)| {
        let mut builder = SceneBuilder::from_scene(scene, SceneLimits::default());
        edit(&mut builder);
        let (next, change) = builder.finish();
        *accel = accel.updated(&next, &change);
        *scene = next;
    };
    for i in 1..300 {
        let id = Id::sanitised(&i.to_string(), "node");
        let node = Node { parent: None, parent_from_node: DAffine3::IDENTITY, mesh: Id::new("0") };
        apply(&mut scene, &mut accel, &mut |builder| builder.add_node(id.clone(), node.clone()).unwrap());
        if i % 60 == 0 {
            assert_as_built(&accel, &scene, &mut numbers, 100, &format!("adding {i}"));
        }
    }
    while scene.nodes().len() > 1 {
        let index = numbers.index(scene.nodes().len());
        let id = scene.nodes().get_index(index).unwrap().0.clone();
        apply(&mut scene, &mut accel, &mut |builder| builder.remove_node(id.as_str()).unwrap());
        if scene.nodes().len() % 60 == 1 {
            assert_as_built(&accel, &scene, &mut numbers, 100, &format!("removing {id}"));
        }
    }
}

/// An edit that touches no surface changes nothing and shares the tree.
#[test]
fn an_edit_without_surfaces_shares_the_tree() {
    let scene = samples::cornell_box().unwrap();
    let first = Accel::build(&scene);
    let updated = first.updated(&scene, &SceneChange::default());
    assert!(std::sync::Arc::ptr_eq(&first.top, &updated.top));
    let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
    let group = Node { parent: None, parent_from_node: DAffine3::IDENTITY, mesh: None };
    builder.add_node(Id::new("group").unwrap(), group).unwrap();
    let (next, change) = builder.finish();
    assert!(std::sync::Arc::ptr_eq(&first.top, &first.updated(&next, &change).top));
}

/// After an edit the trees of meshes that stayed are taken over, and the answers are those of a fresh build.
#[test]
fn unchanged_meshes_keep_their_trees() {
    let scene = samples::cornell_box().unwrap();
    let first = Accel::build(&scene);
    let mut builder = SceneBuilder::from_scene(&scene, Default::default());
    builder.set_transform("tall block", DAffine3::from_translation(DVec3::new(0.3, 0.0, 0.0))).unwrap();
    let (moved, change) = builder.finish();
    let updated = first.updated(&moved, &change);
    assert_eq!(updated.report().trees_built, 0);
    assert_as_built(&updated, &moved, &mut Numbers(5), 10_000, "moving a block");
}
