//! What photons and the light octree cost: tracing against bare rays, gathers, look-ups, edits against building anew.
//!
//! `cargo bench -p lumicast-tests --bench octree [-- SCENE.glb …]`; without arguments the built-in box and, where they are
//! found, the shared dragon-room and sponza. The best of some rounds counts, since the machine may be shared; tracing and
//! its bare rays take turns.

use std::{
    hint::black_box,
    num::NonZeroUsize,
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
    time::Instant,
};

use glam::{DAffine3, DVec3, Vec3};
use lumicast::assets::{AssetLimits, load_scene};
use lumicast_engine::{
    accel::Ray,
    film::PictureSize,
    math::Rgb,
    render::{IlluminationSettings, Learner, Learning, Learnt, RenderSettings, Stage},
    scene::{Id, Material, Node, Scene, SceneBuilder, SceneLimits, samples},
    technique::{
        Edit, Products, SecondaryLight, Step, Technique,
        octree::{LightOctree, OctreeBuilding, OctreeSettings},
        path::View,
        photons::{PhotonSettings, PhotonTracing},
    },
    transport::{PathClass, Surface, World},
};
use rayon::prelude::*;

/// Photons in the maps that octrees are built of, as in the paper.
const PHOTONS: usize = 600_000;
/// Rounds of what takes long.
const ROUNDS: usize = 3;

fn main() {
    let named: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    println!("{} threads", rayon::current_num_threads());
    if named.is_empty() {
        match samples::cornell_box() {
            Ok(scene) => measure("built-in box", scene),
            Err(error) => eprintln!("built-in box: {error}"),
        }
    }
    let named = if named.is_empty() { shared_subjects() } else { named };
    for name in named {
        match load_scene(&PathBuf::from(&name), &AssetLimits::default()) {
            Ok(scene) => measure(name.rsplit('/').next().unwrap_or(&name), scene),
            Err(error) => eprintln!("{error}"),
        }
    }
}

fn shared_subjects() -> Vec<String> {
    let Some(folder) = lumicast_tests::shared_folder() else {
        println!("SKIPPED the shared scenes: no ../shared beside the project");
        return Vec::new();
    };
    let path = |name: &str| folder.join("scenes").join(name).display().to_string();
    ["dragon-room.glb", "sponza.glb"].iter().map(|name| path(name)).collect()
}

fn measure(name: &str, scene: Scene) {
    println!("\n### {name}: {} triangles\n", scene.instanced_triangle_count());
    let scene = with_a_small_box(scene);
    let world = World::prepare(Arc::new(scene));
    let settings = emitting_for(&world, PHOTONS);
    let tracing = trace(&world, settings);
    tracing_against_rays(&world, settings, &tracing);
    let products = Products { photons: Some(tracing.product().clone()), ..Products::default() };
    let octree = build(&world, &products, settings.emitted_count, 4);
    let octree = build(&world, &products, settings.emitted_count, 6).or(octree);
    if let Some(octree) = octree {
        look_up(&world, &octree);
    }
    drag(&world);
    edit(world, settings);
}

/// A cube of a fiftieth of the scene, standing in its middle, to be moved.
fn with_a_small_box(scene: Scene) -> Scene {
    let Some(bounds) = scene.bounds() else { return scene };
    let (middle, size) = ((bounds.min + bounds.max) * 0.5, (bounds.max - bounds.min).max_element() / 50.0);
    let mut builder = SceneBuilder::from_scene(&scene, SceneLimits::default());
    let added = (|| {
        let id = |name: &str| Id::new(name);
        let (material, mesh, node) = (id("bench grey")?, id("bench box")?, id("bench box")?);
        builder.set_material(material.clone(), Material::lambert(Rgb::splat(0.5))).ok()?;
        let half = DVec3::splat(size * 0.5);
        builder.add_mesh(mesh.clone(), samples::cuboid(-half, half, &material)).ok()?;
        let parent_from_node = DAffine3::from_translation(middle);
        builder.add_node(node, Node { parent: None, parent_from_node, mesh: Some(mesh) }).ok()
    })();
    if added.is_none() {
        eprintln!("the scene takes no box: edits are not measured");
    }
    builder.finish().0
}

/// Settings that leave about `mapped` photons in maps, found by a pilot of a twentieth.
fn emitting_for(world: &World, mapped: usize) -> PhotonSettings {
    let pilot = PhotonSettings { emitted_count: mapped as u32 / 20, ..PhotonSettings::default() };
    let found = mapped_count(&trace(world, pilot)).max(1);
    let emitted_count = (mapped as u64 * u64::from(pilot.emitted_count) / found as u64) as u32;
    PhotonSettings { emitted_count, ..pilot }
}

fn mapped_count(tracing: &PhotonTracing) -> usize {
    let maps = &tracing.product().maps;
    maps.photon_count(PathClass::Indirect) + maps.photon_count(PathClass::Caustic)
}

fn trace(world: &World, settings: PhotonSettings) -> PhotonTracing {
    let mut tracing = PhotonTracing::new(settings);
    complete(world, &mut tracing, &mut Products::default());
    tracing
}

/// Seconds until the technique has nothing more to do.
fn complete(world: &World, technique: &mut impl Technique, products: &mut Products) -> f64 {
    let start = Instant::now();
    let cancel = AtomicBool::new(false);
    while !technique.step(&mut Step { world, products, canvas: None, cancel: &cancel }).complete {}
    start.elapsed().as_secs_f64()
}

fn tracing_against_rays(world: &World, settings: PhotonSettings, tracing: &PhotonTracing) {
    // The same ways again, each a ray from where its photon was to beyond where it fell.
    let rays: Vec<Ray> = tracing
        .paths()
        .segments()
        .map(|(from, way)| Ray::new(from + way * 1e-4, way.normalize_or(Vec3::Y)))
        .collect();
    let (mut photons, mut bare) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..ROUNDS {
        photons = photons.min(PhotonTracing::new(settings).trace_all(world));
        let start = Instant::now();
        rays.par_chunks(256).for_each(|rays| {
            for ray in rays {
                black_box(world.closest_hit(ray));
            }
        });
        bare = bare.min(start.elapsed().as_secs_f64());
    }
    let start = Instant::now();
    let complete = trace(world, settings);
    let all = start.elapsed().as_secs_f64();
    let (hits, paths) = (tracing.paths().hit_count() as f64, tracing.paths());
    println!(
        "- photons: {} emitted, {hits} hits kept, {} of them in {} maps",
        paths.path_count(),
        mapped_count(tracing),
        tracing.product().maps.map_count(PathClass::Indirect)
    );
    println!(
        "- tracing {photons:.3} s ({:.2} M hits/s, {:.2} M rays/s), bare rays {bare:.3} s: {:.0} %",
        hits / photons / 1e6,
        rays.len() as f64 / photons / 1e6,
        100.0 * bare / photons
    );
    println!(
        "- with maps {all:.3} s; {:.1} bytes a hit with its path, {:.1} bytes a mapped photon in maps",
        paths.bytes() as f64 / hits,
        complete.product().maps.bytes() as f64 / mapped_count(&complete) as f64
    );
}

fn build(world: &World, products: &Products, photon_count: u32, depth: u32) -> Option<Arc<LightOctree>> {
    let settings = OctreeSettings { depth_first: depth, depth, photon_count, ..OctreeSettings::default() }
        .gathering(NonZeroUsize::new(300)?);
    let mut best: Option<(f64, Arc<LightOctree>)> = None;
    for _ in 0..ROUNDS {
        let mut building = OctreeBuilding::new(settings);
        let seconds = complete(world, &mut building, &mut products.clone());
        let octree = building.octree()?.clone();
        if best.as_ref().is_none_or(|(least, _)| seconds < *least) {
            best = Some((seconds, octree));
        }
    }
    let (seconds, octree) = best?;
    let counts = octree.counts();
    println!(
        "- octree, depth {depth}, k = 300, 4 VDLs: {seconds:.3} s in all; {} cells, {} groups, {} VDLs, {} bytes; \
         seconds of threads: voxels {:.3}, gather {:.3}, cluster {:.3}; {:.1} M photons gathered, {:.1} ns each",
        octree.leaf_count(),
        counts.gathered,
        octree.vdl_count(),
        octree.bytes(),
        counts.voxel_seconds,
        counts.gather_seconds,
        counts.cluster_seconds,
        counts.photons as f64 / 1e6,
        1e9 * counts.gather_seconds / counts.photons.max(1) as f64
    );
    Some(octree)
}

/// Surfaces that the first camera sees, asked again and again on one thread.
fn look_up(world: &World, octree: &LightOctree) {
    let scene = world.scene();
    let view = scene.camera_view(None).unwrap_or_else(|| scene.default_view());
    let Ok(size) = PictureSize::new(320, 180) else { return };
    let view = View::new(world, &view, size);
    let seen: Vec<(Surface, Vec3)> = (0..size.height())
        .flat_map(|y| (0..size.width()).map(move |x| (x, y)))
        .filter_map(|(x, y)| {
            let ray = view.ray(x as f32 + 0.5, y as f32 + 0.5);
            let hit = world.closest_hit(&ray)?;
            Some((world.surface(&hit, ray.direction), -ray.direction))
        })
        .filter(|(surface, _)| surface.bsdf.has_diffuse())
        .collect();
    let mut best = f64::INFINITY;
    for _ in 0..2 * ROUNDS {
        let start = Instant::now();
        for (surface, wo) in &seen {
            black_box(octree.scattered(surface, *wo, None));
        }
        best = best.min(start.elapsed().as_secs_f64());
    }
    println!("- look-ups in shading, one thread: {:.2} M/s", seen.len() as f64 / best / 1e6);
}

/// Moves the small box and compares with building anew.
fn edit(world: World, settings: PhotonSettings) {
    let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
    let Some(node) = world.scene().nodes().get("bench box") else { return };
    let step = world.accel().radius() as f64 / 100.0;
    let moved = DAffine3::from_translation(DVec3::new(step, 0.0, step)) * node.parent_from_node;
    if builder.set_transform("bench box", moved).is_err() {
        return;
    }
    let (scene, change) = builder.finish();
    let after = world.update(Arc::new(scene), &change);
    edit_records(&Edit { before: &world, after: &after, change: &change });
    let octree = OctreeSettings {
        depth_first: 6,
        depth: 6,
        photon_count: settings.emitted_count,
        ..OctreeSettings::default()
    };
    let mut best: Option<[f64; 2]> = None;
    for _ in 0..ROUNDS {
        let (mut tracing, mut building) = (PhotonTracing::new(settings), OctreeBuilding::new(octree));
        let mut products = Products::default();
        complete(&world, &mut tracing, &mut products);
        complete(&world, &mut building, &mut products);
        let start = Instant::now();
        tracing.apply(&Edit { before: &world, after: &after, change: &change });
        let again = start.elapsed().as_secs_f64() + tracing.trace_all(&after);
        let mapped = complete(&after, &mut tracing, &mut products);
        let shown = until_shown(&after, &mut building, &mut products);
        let first = building.octree().map(|octree| octree.counts()).unwrap_or_default();
        let built = shown + complete(&after, &mut building, &mut products);
        if best.is_none_or(|[_, least]| built < least) {
            best = Some([again, built]);
            let counts = tracing.edit_counts();
            println!(
                "- moving a small box: {} of {} paths held against it, {} withdrawn ({:.2} %); photons {:.1} ms, their maps \
                 {:.1} ms, octree of depth 6 shown {:.1} ms after those ({} of {} groups gathered), all of it {:.1} ms",
                counts.tested,
                counts.paths,
                counts.withdrawn,
                100.0 * counts.withdrawn as f64 / counts.paths.max(1) as f64,
                1e3 * again,
                1e3 * mapped,
                1e3 * shown,
                first.gathered,
                first.gathered + first.kept,
                1e3 * built
            );
        }
    }
    let anew = PhotonTracing::new(settings).trace_all(&after);
    if let Some([again, _]) = best {
        println!("- tracing all photons anew: {:.1} ms, {:.0} times as long", 1e3 * anew, anew / again);
    }
}

/// Seconds until an octree after an edit is shown.
fn until_shown(world: &World, building: &mut OctreeBuilding, products: &mut Products) -> f64 {
    let start = Instant::now();
    let cancel = AtomicBool::new(false);
    let before = building.octree().cloned();
    let is_new = |building: &OctreeBuilding| match (&before, building.octree()) {
        (Some(before), Some(now)) => !Arc::ptr_eq(before, now),
        (before, now) => before.is_some() != now.is_some(),
    };
    while !is_new(building) {
        if building.step(&mut Step { world, products, canvas: None, cancel: &cancel }).complete {
            break;
        }
    }
    start.elapsed().as_secs_f64()
}

/// Edits a second of who drags something.
const DRAGGED_A_SECOND: f64 = 10.0;
/// How often the box is moved.
const DRAGGED: u32 = 40;

/// Drags the small box: how often light of an edit becomes known meanwhile, how long after it, and how long after the last all is.
fn drag(world: &World) {
    let Some(node) = world.scene().nodes().get("bench box") else { return };
    let settings = RenderSettings { learning: Learning::First, ..RenderSettings::default() };
    let never = AtomicBool::new(false);
    let mut learner = Learner::new(Learnt::Octree, &settings, IlluminationSettings::of(&settings));
    while learner.stage() != Stage::Complete {
        learner.step(world, &never);
    }
    let (at, step) = (node.parent_from_node, world.accel().radius() as f64 / 1000.0);
    let moved = |world: &World, number: u32| {
        let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
        let moved = DAffine3::from_translation(DVec3::X * (step * f64::from(number))) * at;
        builder.set_transform("bench box", moved).ok()?;
        let (scene, change) = builder.finish();
        Some((world.update(Arc::new(scene), &change), change))
    };
    let start = Instant::now();
    // The edit that is followed, and when it came.
    let mut followed: Option<(World, f64)> = None;
    let (mut applied, mut behind, mut epoch) = (0, Vec::new(), learner.epoch());
    while applied < DRAGGED || learner.stage() != Stage::Complete {
        let due = ((start.elapsed().as_secs_f64() * DRAGGED_A_SECOND) as u32 + 1).min(DRAGGED);
        let before = followed.as_ref().map_or(world, |(world, _)| world);
        if due > applied && !learner.is_catching_up() {
            let Some((after, change)) = moved(before, due) else { return };
            learner.apply(&Edit { before, after: &after, change: &change });
            followed = Some((after, f64::from(due - 1) / DRAGGED_A_SECOND));
            applied = due;
        }
        let Some((after, came)) = &followed else { return };
        learner.step(after, &never);
        if std::mem::replace(&mut epoch, learner.epoch()) != learner.epoch() {
            behind.push(start.elapsed().as_secs_f64() - came);
        }
    }
    let complete = start.elapsed().as_secs_f64() - f64::from(DRAGGED - 1) / DRAGGED_A_SECOND;
    behind.sort_by(f64::total_cmp);
    println!(
        "- dragging it, {DRAGGED} edits at {DRAGGED_A_SECOND} a second: light of {} became known, {:.2} s after it in the middle and {:.2} at most; \
         all is {complete:.2} s after the last",
        behind.len(),
        behind.get(behind.len() / 2).copied().unwrap_or(f64::NAN),
        behind.last().copied().unwrap_or(f64::NAN)
    );
}

/// What an edit leaves of the records of irradiance of a view, and how long it takes to bring them up to date.
fn edit_records(edit: &Edit<'_>) {
    let Some(camera) = edit.before.scene().camera_view(None) else { return };
    let size = PictureSize::new(320, 180).expect("not empty");
    let settings = RenderSettings { learning: Learning::First, ..RenderSettings::default() };
    let learn = |learner: &mut Learner, world: &World| {
        let (start, never) = (Instant::now(), AtomicBool::new(false));
        while learner.stage() != Stage::Complete {
            learner.step(world, &never);
        }
        start.elapsed().as_secs_f64()
    };
    let fresh = || {
        let mut learner = Learner::new(Learnt::Records, &settings, IlluminationSettings::of(&settings));
        learner.look(0, &camera, size);
        learner
    };
    let mut learner = fresh();
    learn(&mut learner, edit.before);
    let before = learner.records().count;
    let start = Instant::now();
    learner.apply(edit);
    let applied = start.elapsed().as_secs_f64();
    let kept = learner.records().count;
    let again = learn(&mut learner, edit.after);
    let after = learner.records().count;
    let anew = learn(&mut fresh(), edit.after);
    println!(
        "- moving a small box: {kept} of {before} records stay, told in {:.1} ms with the photons; {after} are of the light of now \
         after {again:.2} s, anew {anew:.2} s",
        1e3 * applied
    );
}
