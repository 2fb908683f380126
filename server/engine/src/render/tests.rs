//! Laws of photons and octree together [techniques.md].

mod dragged;
mod meanwhile;
mod octrees;
mod pictures;
mod records;
mod rounds;
mod turns;

use std::{
    num::NonZeroUsize,
    sync::{Arc, atomic::AtomicBool},
};

use glam::{DAffine3, DQuat, DVec3, Vec3};

use super::{
    Illumination, IlluminationSettings, Indirect, Learner, Learning, Learnt, RenderSettings, Rendering, Stage,
};
use crate::{
    effects::EffectPlan,
    film::{PictureSize, compare},
    math::{Rgb, sobol},
    scene::{
        Environment, Id, Light, LightKind, Material, Node, Scene, SceneBuilder, SceneChange, SceneLimits,
        samples::{self, Stage as Building},
    },
    technique::{
        Edit, Products, Step, Technique,
        octree::{LightOctree, OctreeBuilding, OctreeSettings},
        photons::{PhotonSettings, PhotonTracing},
    },
    transport::{PathClass, World},
};

fn settings(emitted_count: u32, depth: u32) -> IlluminationSettings {
    IlluminationSettings {
        photons: PhotonSettings { emitted_count, ..PhotonSettings::default() },
        octree: OctreeSettings { depth, photon_count: emitted_count, ..OctreeSettings::default() },
        ..IlluminationSettings::default()
    }
}

fn world_of(scene: Scene) -> World {
    World::prepare(Arc::new(scene))
}

/// The world after an edit, and what it changed.
fn edited(world: &World, edit: impl FnOnce(&mut SceneBuilder)) -> (World, SceneChange) {
    let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
    edit(&mut builder);
    let (scene, change) = builder.finish();
    (world.update(Arc::new(scene), &change), change)
}

/// Photons and octree without the rounds of [`Illumination`], which would begin again where an edit changes much.
struct Caches {
    photons: PhotonTracing,
    octree: OctreeBuilding,
    products: Products,
}

impl Caches {
    fn new(settings: IlluminationSettings) -> Caches {
        Caches {
            photons: PhotonTracing::new(settings.photons),
            octree: OctreeBuilding::new(settings.octree),
            products: Products::default(),
        }
    }

    fn complete(settings: IlluminationSettings, world: &World) -> Caches {
        let mut light = Caches::new(settings);
        light.step_until_complete(world);
        light
    }

    fn is_complete(&self) -> bool {
        self.photons.is_complete() && self.octree.is_complete(self.photons.product())
    }

    fn step(&mut self, world: &World) {
        let cancel = AtomicBool::new(false);
        let mut step = Step { world, products: &mut self.products, canvas: None, cancel: &cancel };
        if self.photons.is_complete() {
            self.octree.step(&mut step);
        } else {
            self.photons.step(&mut step);
        }
    }

    fn step_until_complete(&mut self, world: &World) {
        for _ in 0..100_000 {
            if self.is_complete() {
                return;
            }
            self.step(world);
        }
        panic!("no end of it");
    }

    fn apply(&mut self, edit: &Edit<'_>) {
        self.photons.apply(edit);
        self.octree.apply(edit);
    }
}

/// The same a metre above ground, thirty times as wide as a furnace, that reflects so much.
fn on_ground(scene: &Scene, albedo: f32) -> Scene {
    let below = scene.bounds().unwrap().min.y - 1.0;
    let mut builder = SceneBuilder::from_scene(scene, SceneLimits::default());
    let ground = id("ground".to_owned());
    builder.set_material(ground.clone(), Material::lambert(Rgb::splat(albedo))).unwrap();
    let corners = [[-30.0, 30.0], [30.0, 30.0], [30.0, -30.0], [-30.0, -30.0]];
    let corners = corners.map(|[x, z]| DVec3::new(x, below, z));
    builder.add_mesh(ground.clone(), samples::quad(corners, &ground)).unwrap();
    let node = Node { parent: None, parent_from_node: DAffine3::IDENTITY, mesh: Some(ground.clone()) };
    builder.add_node(ground, node).unwrap();
    builder.finish().0
}

/// Numbers for choosing edits.
struct Dice {
    key: u64,
    thrown: u32,
}

impl Dice {
    fn throw(&mut self) -> [f32; 4] {
        self.thrown += 1;
        sobol::point(sobol::mix(self.key ^ u64::from(self.thrown)), self.thrown)
    }

    fn below(&mut self, count: usize) -> usize {
        ((self.throw()[0] * count as f32) as usize).min(count - 1)
    }

    fn place(&mut self) -> DVec3 {
        let [x, y, z, _] = self.throw().map(f64::from);
        DVec3::new(1.6 * x - 0.8, 1.5 * y + 0.2, 1.6 * z - 0.8)
    }

    fn transform(&mut self) -> DAffine3 {
        let [angle, size, stretch, _] = self.throw().map(f64::from);
        let scale = DVec3::new(0.3 + size, 0.3 + size * stretch.round() + 0.2, 0.3 + size);
        DAffine3::from_scale_rotation_translation(scale, DQuat::from_rotation_y(6.0 * angle), self.place())
    }

    fn colour(&mut self) -> Rgb {
        let [r, g, b, _] = self.throw();
        Rgb::new(r, g, b) * 0.9
    }

    fn light(&mut self) -> Light {
        let intensity = self.colour() * 8.0 + Rgb::splat(0.1);
        let direction = (self.place() - DVec3::new(0.0, 2.5, 0.0)).normalize();
        let kind = match self.below(3) {
            0 => LightKind::Point { intensity },
            1 => LightKind::Spot { intensity, inner_angle_rad: 0.3, outer_angle_rad: 0.9 },
            _ => LightKind::Directional { irradiance: intensity },
        };
        Light { parent: None, position: self.place(), direction, kind }
    }
}

fn id(name: String) -> Id {
    Id::new(&name).unwrap()
}

/// One random edit; the scene has a box to choose from at any time.
fn random_edit(scene: &Scene, dice: &mut Dice, number: u32) -> (Scene, SceneChange) {
    let mut builder = SceneBuilder::from_scene(scene, SceneLimits::default());
    let moving: Vec<Id> =
        scene.nodes().keys().filter(|id| id.as_str().starts_with("thing")).cloned().collect();
    let lights: Vec<Id> = scene.lights().keys().cloned().collect();
    let mesh_of = |name: &str| scene.nodes().get(name).and_then(|node| node.mesh.clone());
    match dice.below(9) {
        0 | 1 => {
            let mesh = mesh_of(["tall block", "glass ball", "lamp"][dice.below(3)]).unwrap();
            let node = Node { parent: None, parent_from_node: dice.transform(), mesh: Some(mesh) };
            builder.add_node(id(format!("thing {number}")), node).unwrap();
        }
        2 | 3 if !moving.is_empty() => {
            builder.set_transform(moving[dice.below(moving.len())].as_str(), dice.transform()).unwrap();
        }
        4 if !moving.is_empty() => {
            builder.remove_node(moving[dice.below(moving.len())].as_str()).unwrap();
        }
        5 => {
            let name = ["red", "white", "lamp", "glass", "mirror"][dice.below(5)];
            let material = match (name, dice.below(3)) {
                ("lamp", 0 | 1) => Material::emitter(dice.colour() * 20.0),
                ("glass" | "mirror", 0) => {
                    Material { transmission: 1.0, roughness: 0.0, ..Material::default() }
                }
                ("glass" | "mirror", 1) => {
                    Material { metallic: 1.0, roughness: 0.2 * dice.throw()[0], ..Material::default() }
                }
                _ => Material::lambert(dice.colour()),
            };
            builder.set_material(id(name.into()), material).unwrap();
        }
        6 if lights.len() < 4 => builder.add_light(id(format!("light {number}")), dice.light()).unwrap(),
        7 if !lights.is_empty() => {
            builder.set_light(lights[dice.below(lights.len())].as_str(), dice.light()).unwrap();
        }
        8 if !lights.is_empty() => builder.remove_light(lights[dice.below(lights.len())].as_str()).unwrap(),
        _ => {
            let radiance = dice.colour() * dice.throw()[3].round();
            builder.set_environment(Environment::Constant(radiance)).unwrap();
        }
    }
    builder.finish()
}

fn assert_same(kept: &Caches, fresh: &Caches, what: &str) {
    let (kept_paths, fresh_paths) = (kept.photons.paths(), fresh.photons.paths());
    assert_eq!(kept_paths.path_count(), fresh_paths.path_count(), "{what}: paths");
    assert_eq!(kept_paths.hit_count(), fresh_paths.hit_count(), "{what}: hits");
    for (number, (kept, fresh)) in kept_paths.hits().zip(fresh_paths.hits()).enumerate() {
        assert_eq!(kept, fresh, "{what}: hit {number}");
    }
    match (kept.octree.octree(), fresh.octree.octree()) {
        (Some(kept), Some(fresh)) => assert!(kept.holds_the_same(fresh), "{what}: octrees"),
        (kept, fresh) => assert_eq!(kept.is_some(), fresh.is_some(), "{what}: an octree"),
    }
}

/// After any edits photons and octree are those of a fresh build of the final scene, photon for photon and leaf for leaf;
/// also when edits come before the answer to the last one is complete.
#[test]
fn edits_leave_what_a_fresh_build_would_make() {
    let cornell = || samples::cornell_box().unwrap();
    let mut under_sky = SceneBuilder::from_scene(&on_ground(&cornell(), 0.5), SceneLimits::default());
    under_sky.set_environment(Environment::Constant(Rgb::splat(1.0))).unwrap();
    // The fourth with so many photons that lights have strata, some of them thinned out; the last where cells differ in size.
    for (seed, scene, photons, edits) in [
        (0, cornell(), 3_000, 100),
        (1, cornell(), 3_000, 100),
        (2, cornell(), 3_000, 100),
        (3, cornell(), 24_000, 40),
        (4, under_sky.finish().0, 24_000, 40),
    ] {
        let mut settings = settings(photons, 4);
        let mut thinned_out = 0;
        // Small gathers: many cells must stay as they were.
        settings.octree.neighbours_min = NonZeroUsize::new(8).unwrap();
        let mut kept_cells_share = 0.0;
        let mut dice = Dice { key: sobol::mix(seed), thrown: 0 };
        let mut world = world_of(scene);
        let mut kept = Caches::complete(settings, &world);
        let mut withdrawn_share = 0.0;
        let (mut nested_count, mut renested_count) = (0, 0);
        for number in 0..edits {
            let (scene, change) = random_edit(world.scene(), &mut dice, number);
            let next = world.update(Arc::new(scene), &change);
            nested_count += u32::from(next.nested_bounds().is_some());
            renested_count += u32::from(next.nested_bounds() != world.nested_bounds());
            kept.apply(&Edit { before: &world, after: &next, change: &change });
            world = next;
            let counts = kept.photons.edit_counts();
            withdrawn_share += counts.withdrawn as f64 / counts.paths.max(1) as f64 / f64::from(edits);
            assert!(counts.withdrawn <= counts.tested && counts.tested <= counts.paths, "{counts:?}");
            if dice.throw()[0] < 0.3 {
                // The next edit comes in the middle of the work.
                for _ in 0..dice.below(3) {
                    kept.step(&world);
                }
                continue;
            }
            // The first octree after an edit takes most over; one that completes it would take over all the rest.
            let before = kept.octree.octree().map(Arc::as_ptr);
            while !kept.is_complete() && kept.octree.octree().map(Arc::as_ptr) == before {
                kept.step(&world);
            }
            let built = kept.octree.octree().unwrap().counts();
            kept.step_until_complete(&world);
            thinned_out += u32::from(kept.photons.paths().path_count() < kept.photons.paths().full_count());
            // What an edit leaves as it was is not built at all.
            let of_edit = match change.leaves_light_alone() {
                true => 1.0,
                false => built.kept as f64 / (built.kept + built.gathered) as f64,
            };
            kept_cells_share += of_edit / (0.7 * f64::from(edits));
            if number % 5 == 0 || number > edits - 5 {
                let fresh = Caches::complete(settings, &World::prepare(world.scene().clone()));
                assert_same(&kept, &fresh, &format!("seed {seed} after edit {number}"));
            }
        }
        assert!(withdrawn_share < 0.8, "nearly everything was withdrawn every time: {withdrawn_share}");
        assert!(thinned_out >= edits / 8 || photons < 4608, "{thinned_out} times thinned out");
        assert!(kept_cells_share > 0.05, "nearly every cell was built anew: {kept_cells_share}");
        let is_on_ground = seed == 4;
        assert_eq!(nested_count > edits / 2, is_on_ground, "{nested_count} times on ground");
        assert_eq!(renested_count > 2, is_on_ground, "{renested_count} times other cells");
        assert_eq!(kept.photons.probe(&world).diverged, 0);
    }
}

/// A scene of a metre grows to forty: what flew off when there was nothing out there is found by what comes to stand there. And one that
/// moves as a whole but for a lamp, so that all is counted from elsewhere, is traced anew.
#[test]
fn what_comes_to_stand_far_outside_meets_what_flew_off() {
    let settings = PhotonSettings { emitted_count: 60_000, ..PhotonSettings::default() };
    let complete = |photons: &mut PhotonTracing, world: &World| {
        let (mut products, cancel) = (Products::default(), AtomicBool::new(false));
        let mut step = Step { world, products: &mut products, canvas: None, cancel: &cancel };
        assert!((0..10_000).any(|_| photons.step(&mut step).complete), "no end of it");
    };
    let v = DVec3::new;
    let panel = |x: f64, z: f64| [v(x, -3.0, z), v(x + 2.0, -3.0, z), v(x + 2.0, 5.0, z), v(x, 5.0, z)];
    let moved = DAffine3::from_translation(v(8.0, 0.0, 0.0));
    type Change<'a> = Box<dyn Fn(&mut SceneBuilder) + 'a>;
    let cases: [(&str, Vec<[DVec3; 4]>, Change<'_>); 3] = [
        (
            "one panel",
            vec![panel(4.0, 16.0)],
            Box::new(|builder| builder.set_transform("panel 0", DAffine3::IDENTITY).unwrap()),
        ),
        (
            "two panels",
            vec![panel(8.0, 40.0), panel(-10.0, -40.0)],
            Box::new(|builder| {
                let names = ["panel 0", "panel 1"];
                names.into_iter().for_each(|name| builder.set_transform(name, DAffine3::IDENTITY).unwrap());
            }),
        ),
        (
            "all but a panel",
            vec![panel(-1.0, 0.5)],
            Box::new(|builder| {
                builder.set_transform("square", moved).unwrap();
                let mut lamp = builder.scene().lights()["lamp"].clone();
                lamp.position += v(8.0, 0.0, 0.0);
                builder.set_light("lamp", lamp).unwrap();
            }),
        ),
    ];
    for (name, panels, change) in cases {
        let mut stage = Building::default();
        let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).unwrap();
        let square = [v(-1.0, 0.0, 1.0), v(1.0, 0.0, 1.0), v(1.0, 0.0, -1.0), v(-1.0, 0.0, -1.0)];
        stage.place("square", samples::quad(square, &white), DAffine3::IDENTITY).unwrap();
        // In a corner of the square, too small to be met.
        let dot = DAffine3::from_scale_rotation_translation(
            DVec3::splat(1e-3),
            DQuat::IDENTITY,
            v(-0.9, 0.01, 0.9),
        );
        for (number, panel) in panels.into_iter().enumerate() {
            stage.place(&format!("panel {number}"), samples::quad(panel, &white), dot).unwrap();
        }
        let kind = LightKind::Point { intensity: Rgb::splat(2.0) };
        let lamp = Light { parent: None, position: v(0.0, 1.0, 0.0), direction: DVec3::NEG_Y, kind };
        stage.light("lamp", lamp).unwrap();
        let before = world_of(stage.finish());
        let (after, change) = edited(&before, change);
        let mut kept = PhotonTracing::new(settings);
        complete(&mut kept, &before);
        kept.apply(&Edit { before: &before, after: &after, change: &change });
        complete(&mut kept, &after);
        let mut fresh = PhotonTracing::new(settings);
        complete(&mut fresh, &after);
        assert!(fresh.paths().hit_count() > 2000, "{name}");
        assert!(kept.paths().hits().eq(fresh.paths().hits()), "{name}: {:?}", kept.edit_counts());
    }
}

/// First light in a room that was black beside a lit one, and a wall that goes: what gathers beyond walls looked past is built again.
#[test]
fn edits_beside_walls_leave_what_a_fresh_build_would_make() {
    let settings = settings(20_000, 5);
    let mut world = world_of(samples::parted_rooms([300.0, 0.0]).unwrap());
    let mut kept = Caches::complete(settings, &world);
    type Change = fn(&mut SceneBuilder);
    let edits: [(&str, Change); 4] = [
        ("a faint lamp", |builder| {
            builder.set_material(id("right lamp".into()), Material::emitter(Rgb::splat(0.05))).unwrap();
        }),
        ("the wall moves", |builder| {
            builder.set_transform("wall", DAffine3::from_translation(DVec3::new(0.1, 0.0, 0.0))).unwrap();
        }),
        ("no lamp", |builder| {
            builder.set_material(id("right lamp".into()), Material::emitter(Rgb::BLACK)).unwrap();
        }),
        ("no wall", |builder| builder.remove_node("wall").unwrap()),
    ];
    for (name, edit) in edits {
        let (next, change) = edited(&world, edit);
        kept.apply(&Edit { before: &world, after: &next, change: &change });
        world = next;
        kept.step_until_complete(&world);
        let fresh = Caches::complete(settings, &World::prepare(world.scene().clone()));
        assert_same(&kept, &fresh, name);
    }
}

/// A light that is added and taken away again leaves the same bytes.
#[test]
fn a_light_turned_on_and_off_leaves_no_trace() {
    let settings = settings(4_000, 4);
    let world = world_of(samples::cornell_box().unwrap());
    let never_edited = Caches::complete(settings, &world);
    let mut edited = Caches::complete(settings, &world);
    let mut dice = Dice { key: 9, thrown: 0 };
    let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
    builder.add_light(id("more".into()), dice.light()).unwrap();
    let (scene, change) = builder.finish();
    let lit = world.update(Arc::new(scene), &change);
    edited.apply(&Edit { before: &world, after: &lit, change: &change });
    edited.step_until_complete(&lit);
    let lights = |light: &Caches| light.photons.paths().sources_count();
    assert_eq!(lights(&edited), lights(&never_edited) + 1);
    let mut builder = SceneBuilder::from_scene(lit.scene(), SceneLimits::default());
    builder.remove_light("more").unwrap();
    let (scene, change) = builder.finish();
    let dark = lit.update(Arc::new(scene), &change);
    edited.apply(&Edit { before: &lit, after: &dark, change: &change });
    edited.step_until_complete(&dark);
    assert_same(&edited, &never_edited, "on and off");
}

/// A change that nobody announced is found by probing: round after round, the groups it concerns are traced again.
#[test]
fn probing_finds_what_nobody_announced() {
    let world = world_of(samples::cornell_box().unwrap());
    let settings = settings(8_000, 4);
    let mut light = Caches::complete(settings, &world);
    assert_eq!(light.photons.probe(&world).diverged, 0, "nothing changed");
    let (moved, _) = edited(&world, |builder| {
        builder.set_transform("tall block", DAffine3::from_translation(DVec3::new(0.3, 0.0, 0.3))).unwrap();
    });
    let mut rounds = 0;
    let mut diverged = 0;
    // A group has 8,000 / 72 photons, to a fifth: after so many rounds each was asked.
    while rounds < 140 {
        let found = light.photons.probe(&moved).diverged;
        assert!(rounds > 0 || found > 20, "a fifth of the photons meet the block: {found} of 72 groups");
        diverged += found;
        light.step_until_complete(&moved);
        rounds += 1;
    }
    assert!(diverged > 60, "{diverged}");
    assert_same(&light, &Caches::complete(settings, &moved), "after probing");
}

/// The same photons and leaves whatever the number of threads.
#[test]
fn threads_change_nothing() {
    let world = world_of(samples::cornell_box().unwrap());
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Caches::complete(settings(10_000, 5), &world))
    };
    assert_same(&with(1), &with(3), "1 and 3 threads");
}
