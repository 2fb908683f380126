//! Laws of photons: where flux starts, and where it ends up.

use std::{
    collections::HashSet,
    f64::consts::PI,
    sync::{Arc, atomic::AtomicBool},
};

use glam::{DAffine3, DVec3};

use super::{PhotonPaths, PhotonSettings, PhotonTracing, ThinnedOut};
use crate::{
    math::Rgb,
    scene::{
        Environment, Id, Light, LightKind, Material, Scene, SceneBuilder, SceneLimits,
        samples::{self, Stage},
    },
    technique::{Edit, Flight, Products, Step, Technique},
    transport::{PathClass, World},
};

fn traced(scene: Scene, settings: PhotonSettings) -> PhotonTracing {
    let mut tracing = PhotonTracing::new(settings);
    complete(&World::prepare(Arc::new(scene)), &mut tracing);
    tracing
}

fn complete(world: &World, tracing: &mut PhotonTracing) {
    let mut products = Products::default();
    let cancel = AtomicBool::new(false);
    let mut step = Step { world, products: &mut products, canvas: None, cancel: &cancel };
    let is_complete = (0..10_000).any(|_| tracing.step(&mut step).complete);
    assert!(is_complete, "no end of it");
}

fn emitting(emitted_count: u32) -> PhotonSettings {
    PhotonSettings { emitted_count, ..PhotonSettings::default() }
}

/// Flights are those of the photons that maps of indirect light hold, each from where its photon fell before.
#[test]
fn flights_end_where_maps_hold_photons() {
    let tracing = traced(samples::cornell_box().unwrap(), emitting(20_000));
    let count = tracing.product().maps.photon_count(PathClass::Indirect);
    let flights = tracing.paths().flights((PathClass::Indirect, count), |_| glam::Vec3::Z);
    assert!(flights.len() > 10_000, "{}", flights.len());
    assert_eq!(flights.len(), count);
    let ways: HashSet<[[u32; 3]; 2]> = tracing
        .paths()
        .each()
        .flat_map(|(_, hits)| hits.windows(2))
        .map(|way| [&way[0], &way[1]].map(|hit| hit.position.to_array().map(f32::to_bits)))
        .collect();
    let bits = |flight: &Flight| [flight.from, flight.to].map(|p| p.to_array().map(f32::to_bits));
    assert!(flights.iter().all(|flight| ways.contains(&bits(flight)) && flight.flux_w > 0.0));
}

/// What leaves the lights is absorbed, escapes or is cut off: to float rounding nothing is lost or won.
#[test]
fn flux_is_conserved() {
    let mut dim = samples::cornell_box().unwrap();
    for bounces_max in [None, Some(1), Some(3)] {
        let tracing = traced(dim.clone(), PhotonSettings { bounces_max, ..emitting(30_000) });
        let flux = tracing.flux();
        let ended = flux.absorbed + flux.absorbed_on_the_way + flux.escaped + flux.cut_off;
        assert!(flux.emitted > 0.0 && flux.escaped > 0.0, "{flux:?}");
        assert!((ended / flux.emitted - 1.0).abs() < 1e-6, "{bounces_max:?}: {flux:?}");
        assert_eq!(flux.cut_off > 0.0, bounces_max.is_some());
        let power: f64 = World::prepare(Arc::new(dim.clone())).sources().iter().map(|s| s.power_w()).sum();
        assert!((flux.emitted / power - 1.0).abs() < 1e-5, "{} W of {power} W", flux.emitted);
    }
    // Nothing sends out light: nothing is traced, and that is an answer.
    dim = samples::furnace(0.5, 0.0).unwrap();
    let dark = traced(dim, emitting(1000));
    assert_eq!((dark.paths().path_count(), dark.flux().emitted), (0, 0.0));
}

/// In a closed box of albedo ρ the flux that falls on all walls together is the emitted flux over 1 − ρ, and the share of
/// the k-th reflection is ρᵏ.
#[test]
fn reflections_of_a_furnace_are_a_geometric_series() {
    for albedo in [0.2f64, 0.7] {
        let tracing = traced(samples::furnace(albedo as f32, 1.0).unwrap(), emitting(200_000));
        let flux = tracing.flux();
        // The box emits as much outwards, which escapes.
        let inside = flux.emitted - flux.escaped;
        let sum = |class: PathClass| {
            let hits = tracing.paths().hits().filter(|(hit, _)| hit.class() == class);
            hits.map(|(_, flux)| f64::from(flux.luminance())).sum::<f64>()
        };
        // Straight: everything that stays.
        assert!((sum(PathClass::Direct) / inside - 1.0).abs() < 1e-4);
        let expected = inside * albedo / (1.0 - albedo);
        let indirect = sum(PathClass::Indirect);
        // Reflections of a photon are geometrically distributed: mean ρ/(1−ρ), variance ρ/(1−ρ)². Of n photons the mean is
        // off by 1/√(ρn), relative to itself; four of these, of the 100,000 that stay inside.
        let tolerance = 4.0 / (albedo * 1e5).sqrt();
        assert!((indirect / expected - 1.0).abs() < tolerance, "ρ {albedo}: {indirect} for {expected}");
        assert_eq!(sum(PathClass::Caustic), 0.0);
        // And of all that falls on them walls keep 1 − ρ.
        let kept = flux.absorbed / (sum(PathClass::Direct) + indirect);
        assert!((kept / (1.0 - albedo) - 1.0).abs() < tolerance, "ρ {albedo}: {kept} is kept");
    }
}

/// A square of 2 × 2 m in the plane y = 0 that faces up.
fn square_below(light: impl FnOnce(&mut Stage)) -> Scene {
    let mut stage = Stage::default();
    let black = stage.material("black", Material::lambert(Rgb::BLACK)).unwrap();
    let v = DVec3::new;
    let corners = [v(-1., 0., 1.), v(1., 0., 1.), v(1., 0., -1.), v(-1., 0., -1.)];
    stage.place("square", samples::quad(corners, &black), DAffine3::IDENTITY).unwrap();
    light(&mut stage);
    stage.finish()
}

fn punctual(kind: LightKind) -> impl FnOnce(&mut Stage) {
    move |stage: &mut Stage| {
        let light = Light {
            parent: None,
            position: DVec3::new(0.0, 1.0, 0.0),
            direction: DVec3::new(0.6, -0.8, 0.0),
            kind,
        };
        stage.light("light", light).unwrap();
    }
}

/// Every kind of light sends the flux onto a square that its radiometry says.
#[test]
fn lights_send_their_flux() {
    let colour = Rgb::new(1.0, 2.0, 4.0);
    let luminance = f64::from(colour.luminance());
    // Seen from a cube's middle one of its faces is a sixth of all directions: a point 1 m above the 2 m square.
    let point = square_below(punctual(LightKind::Point { intensity: colour }));
    let sun = square_below(punctual(LightKind::Directional { irradiance: colour }));
    let sky = square_below(|stage| {
        stage.builder().set_environment(Environment::Constant(colour)).unwrap();
    });
    let lamp = square_below(|stage| {
        let lamp = stage.material("lamp", Material::emitter(colour)).unwrap();
        let v = DVec3::new;
        // As large, 2 m above, facing down: the form factor between opposite faces of a cube is 0.1998.
        let corners = [v(-1., 2., -1.), v(1., 2., -1.), v(1., 2., 1.), v(-1., 2., 1.)];
        stage.place("lamp", samples::quad(corners, &lamp), DAffine3::IDENTITY).unwrap();
    });
    let cases = [
        ("point", point, luminance * 4.0 * PI / 6.0),
        ("sun", sun, luminance * 4.0 * 0.8),
        // Both sides of 4 m².
        ("sky", sky, luminance * PI * 8.0),
        ("lamp", lamp, luminance * PI * 4.0 * 0.199_825),
    ];
    for (name, scene, expected) in cases {
        // Nothing that a black square shows ends up in maps: a quarter of them is sent.
        let tracing = traced(scene, emitting(800_000));
        let on_square =
            |instance: u32| tracing.paths().hits().filter(move |(hit, _)| hit.instance() == Some(instance));
        let got: f64 = on_square(0).map(|(_, flux)| f64::from(flux.luminance())).sum();
        // Low-discrepancy points: far below the 0.7 % that chance would leave of 20,000 photons.
        assert!((got / expected - 1.0).abs() < 0.007, "{name}: {got} W for {expected} W");
        let blue: f64 = on_square(0).map(|(_, flux)| f64::from(flux.b)).sum();
        assert!((blue / got - 4.0 / luminance).abs() < 1e-4, "{name} has another colour");
    }
}

/// Where wide ground lies around things most photons of sun and sky are aimed at these, and each place gets as much flux as if none were.
#[test]
fn photons_aimed_at_things_bring_each_place_its_flux() {
    let v = DVec3::new;
    let under = |light: &dyn Fn(&mut Stage)| {
        let mut stage = Stage::default();
        let black = stage.material("black", Material::lambert(Rgb::BLACK)).unwrap();
        let corners = [v(-50., 0., 50.), v(50., 0., 50.), v(50., 0., -50.), v(-50., 0., -50.)];
        stage.place("ground", samples::quad(corners, &black), DAffine3::IDENTITY).unwrap();
        let plate = samples::cuboid(v(29., 0.01, 9.), v(31., 0.02, 11.), &black);
        stage.place("plate", plate, DAffine3::IDENTITY).unwrap();
        light(&mut stage);
        stage.finish()
    };
    let sun = under(&|stage| punctual(LightKind::Directional { irradiance: Rgb::splat(3.0) })(stage));
    let sky =
        under(&|stage| stage.builder().set_environment(Environment::Constant(Rgb::splat(2.0))).unwrap());
    for (name, scene, expected) in [("sun", sun, 3.0 * 0.8), ("sky", sky, 2.0 * PI)] {
        let origin = World::prepare(Arc::new(scene.clone())).accel().origin_in_world();
        let tracing = traced(scene, emitting(1_600_000));
        // Squares around the plate, on it first, and on what is left: flux and photons over area.
        let mut found = [[0.0f64; 2]; 5];
        for (hit, flux) in tracing.paths().hits().filter(|(hit, _)| hit.is_on_front()) {
            let away = (hit.position.as_dvec3() + origin - v(30.0, 0.0, 10.0)).abs();
            let ring = [1.0, 3.0, 8.0, 20.0].iter().position(|half_m| away.x.max(away.z) <= *half_m);
            found[ring.unwrap_or(4)][0] += f64::from(flux.luminance());
            found[ring.unwrap_or(4)][1] += 1.0;
        }
        let squares = [4.0, 36.0, 256.0, 1600.0, 10_000.0];
        let areas: [f64; 5] =
            std::array::from_fn(|ring| squares[ring] - if ring > 0 { squares[ring - 1] } else { 0.0 });
        for (ring, ([flux_w, _], area_m2)) in found.iter().zip(areas).enumerate() {
            let off = flux_w / area_m2 / expected - 1.0;
            assert!(off.abs() < 0.03, "{name}, ring {ring}: {off}, {found:?}");
        }
        let [on_it, .., far] = std::array::from_fn::<f64, 5, _>(|ring| found[ring][1] / areas[ring]);
        assert!(on_it > 30.0 * far, "{name}: {on_it} and {far} a square metre");
    }
}

/// A spot sends out what its intensity adds up to over its cone, and nothing beyond.
#[test]
fn spots_keep_to_their_cone() {
    let (inner, outer) = (0.2f32, 0.6f32);
    let kind = LightKind::Spot { intensity: Rgb::splat(3.0), inner_angle_rad: inner, outer_angle_rad: outer };
    let mut stage = Stage::default();
    let black = stage.material("black", Material::lambert(Rgb::BLACK)).unwrap();
    stage
        .place("ball", samples::sphere(DVec3::new(0., 1., 0.), 5.0, 64, &black), DAffine3::IDENTITY)
        .unwrap();
    punctual(kind)(&mut stage);
    let tracing = traced(stage.finish(), emitting(50_000));
    // ∫ 3 t² dω with t = (cos θ − cos o) / (cos i − cos o), 1 inside: 2π · 3 · [(1 − cos i) + (cos i − cos o) / 3].
    let (ci, co) = (f64::from(inner.cos()), f64::from(outer.cos()));
    let expected = 2.0 * PI * 3.0 * ((1.0 - ci) + (ci - co) / 3.0);
    let got: f64 = tracing.paths().hits().map(|(_, flux)| f64::from(flux.luminance())).sum();
    assert!((got / expected - 1.0).abs() < 0.005, "{got} for {expected}");
    for (hit, _) in tracing.paths().hits() {
        let direction = (hit.position.as_dvec3() - DVec3::new(0.0, 1.0, 0.0)).normalize();
        assert!(direction.dot(DVec3::new(0.6, -0.8, 0.0)) > co - 1e-4);
    }
}

/// Photons fall to lights in proportion to their power: each carries nearly the same.
#[test]
fn photons_carry_nearly_the_same_flux() {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).unwrap();
    let room = samples::cuboid(DVec3::splat(-2.0), DVec3::splat(2.0), &white);
    stage.place("room", room, DAffine3::IDENTITY).unwrap();
    for (index, watts) in [1.0f32, 3.0, 10.0, 1e-9].into_iter().enumerate() {
        let light = Light {
            parent: None,
            position: DVec3::new(0.3 * index as f64, 0.0, 0.0),
            direction: DVec3::NEG_Y,
            kind: LightKind::Point { intensity: Rgb::splat(watts) },
        };
        stage.builder().add_light(Id::new(&format!("light {index}")).unwrap(), light).unwrap();
    }
    let tracing = traced(stage.finish(), emitting(28_000));
    let total = tracing.paths().path_count();
    assert!((23_000..34_000).contains(&total), "{total} photons");
    let mut all: Vec<f32> = tracing.paths().hits().map(|(_, flux)| flux.luminance()).collect();
    all.sort_by(f32::total_cmp);
    let (median, high) = (all[all.len() / 2], all[all.len() - 1]);
    assert!(high < 1.05 * median, "{high} against {median}");
    // Neither more nor fewer for the one that sends out a billionth: one photon.
    assert!(all[0] < 1e-4 * median);
}

/// A wide roof in the sun with a pit of 6 m in its middle.
fn courtyard() -> Scene {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).unwrap();
    let v = DVec3::new;
    let (near, far, deep) = (3.0, 20.0, -6.0);
    let roof = |x0, x1, z0, z1| [v(x0, 0., z1), v(x1, 0., z1), v(x1, 0., z0), v(x0, 0., z0)];
    let roofs = [
        roof(-far, -near, -far, far),
        roof(near, far, -far, far),
        roof(-near, near, -far, -near),
        roof(-near, near, near, far),
    ];
    for (index, corners) in roofs.into_iter().enumerate() {
        let name = format!("roof {index}");
        stage.place(&name, samples::quad(corners, &white), DAffine3::IDENTITY).unwrap();
    }
    let floor = [v(-near, deep, near), v(near, deep, near), v(near, deep, -near), v(-near, deep, -near)];
    stage.place("floor", samples::quad(floor, &white), DAffine3::IDENTITY).unwrap();
    let corners = [(-near, -near), (near, -near), (near, near), (-near, near)];
    for (index, (x0, z0)) in corners.into_iter().enumerate() {
        let (x1, z1) = corners[(index + 1) % 4];
        let wall = [v(x0, deep, z0), v(x1, deep, z1), v(x1, 0., z1), v(x0, 0., z0)];
        let name = format!("wall {index}");
        stage.place(&name, samples::quad(wall, &white), DAffine3::IDENTITY).unwrap();
    }
    punctual(LightKind::Directional { irradiance: Rgb::splat(2.0) })(&mut stage);
    stage.finish()
}

/// What falls on the roof tells nothing that maps hold, and gets few photons; what is stored is still the flux there is.
#[test]
fn what_tells_little_gets_few_photons() {
    let sum = |tracing: &PhotonTracing, class| {
        let hits = tracing.paths().hits().filter(move |(hit, _)| hit.class() == class);
        hits.fold((0.0, 0.0), |(flux, count), (_, w)| (flux + f64::from(w.luminance()), count + 1.0))
    };
    // So few photons that a light is one stratum, which is not thinned out: sixty times others.
    let plain: Vec<PhotonTracing> = (0..60)
        .map(|seed| traced(courtyard(), PhotonSettings { seed, ..emitting(4_500) }))
        .inspect(|tracing| assert_eq!(tracing.paths().path_count(), tracing.paths().full_count()))
        .collect();
    let plain_paths: f64 = plain.iter().map(|tracing| tracing.paths().path_count() as f64).sum();
    // Of the second size of strata and of the first.
    for emitted_count in [300_000, 60_000] {
        let tracing = traced(courtyard(), emitting(emitted_count));
        let paths = tracing.paths().path_count() as f64;
        let full = tracing.paths().full_count() as f64;
        assert!(paths < 0.6 * full, "{paths} of {full} photons");
        let flux = tracing.flux();
        let power: f64 = World::prepare(Arc::new(courtyard())).sources().iter().map(|s| s.power_w()).sum();
        assert!((flux.emitted / power - 1.0).abs() < 1e-5, "{} W of {power} W", flux.emitted);
        let ended = flux.absorbed + flux.absorbed_on_the_way + flux.escaped + flux.cut_off;
        assert!((ended / flux.emitted - 1.0).abs() < 1e-6, "{flux:?}");
        // Of some 6,000 photons that fall into the pit and bring about two hits each, four standard deviations.
        for (class, tolerance) in [(PathClass::Direct, 0.02), (PathClass::Indirect, 0.1)] {
            let flux = sum(&tracing, class).0;
            let expected = plain.iter().map(|tracing| sum(tracing, class).0).sum::<f64>() / 60.0;
            assert!((flux / expected - 1.0).abs() < tolerance, "{class:?}: {flux} W for {expected} W");
        }
        let found = sum(&tracing, PathClass::Indirect).1 / paths;
        let found_plain: f64 = plain.iter().map(|tracing| sum(tracing, PathClass::Indirect).1).sum();
        let gain = found / (found_plain / plain_paths);
        assert!(gain > 1.5, "{gain} times as many of them tell something");
    }
}

/// How many are sent and kept of more photons is foreseen by a few, also where there are too few for some strata to be thinned out.
#[test]
fn what_is_left_of_more_photons_is_foreseen() {
    let boxed = || samples::cornell_box().unwrap();
    for (scene, few, more) in [
        (courtyard(), 6_000, 2_000_000),
        (courtyard(), 30_000, 130_000),
        (courtyard(), 120_000, 250_000),
        (boxed(), 6_000, 100_000),
    ] {
        let of_few = traced(scene.clone(), emitting(few));
        let then = traced(scene, emitting(more));
        let paths = then.paths();
        let times = paths.full_count() as f64 / of_few.paths().full_count() as f64;
        let foreseen = of_few.paths().thinned_out(times);
        let [sent, kept] = [paths.path_count(), paths.hit_count()].map(|count| count as f64);
        // Pilots of a few strata say what those of many will, by chance.
        assert!((foreseen.sent / sent - 1.0).abs() < 0.1, "{few} and {more}: {foreseen:?}: {sent}");
        assert!((foreseen.kept / kept - 1.0).abs() < 0.15, "{few} and {more}: {foreseen:?}: {kept}");
    }
    assert_eq!(PhotonPaths::default().thinned_out(2.0), ThinnedOut::default());
}

/// Photons added to those that are there are those of a fresh trace, path for path, and only what is new is traced.
#[test]
fn more_photons_are_those_of_a_fresh_trace() {
    let never = AtomicBool::new(false);
    // Below and above the number from which a light has strata, and across it.
    let in_a_box = [[1000, 3000], [6000, 30_000], [5000, 5001], [1000, 30_000], [30_000, 6000]];
    let in_a_box = in_a_box.into_iter().map(|counts| (samples::cornell_box().unwrap(), counts));
    // Where some strata are thinned out, by how much depends on how many photons there are.
    for (scene, [fewer, more]) in in_a_box.chain([(courtyard(), [20_000, 60_000])]) {
        let world = World::prepare(Arc::new(scene));
        let rays_of = |tracing: &mut PhotonTracing| {
            let (mut products, mut rays) = (Products::default(), 0);
            while !tracing.is_complete() {
                let mut step = Step { world: &world, products: &mut products, canvas: None, cancel: &never };
                rays += tracing.step(&mut step).counts.all_rays();
            }
            rays as f64
        };
        let mut fresh = PhotonTracing::new(emitting(more));
        let mut known = PhotonTracing::new(emitting(fewer));
        rays_of(&mut known);
        // About as many as asked for.
        let known_count = known.paths().path_count();
        let mut added = PhotonTracing::adding_to(known, emitting(more));
        let share = rays_of(&mut added) / rays_of(&mut fresh);
        let hits = |tracing: &PhotonTracing| -> Vec<_> {
            tracing.paths().hits().map(|(hit, flux)| (*hit, flux)).collect()
        };
        assert_eq!(hits(&added), hits(&fresh), "{fewer} and {more}");
        assert!(added.paths().segments().eq(fresh.paths().segments()));
        let class = PathClass::Indirect;
        assert_eq!(added.product().maps.photon_count(class), fresh.product().maps.photon_count(class));
        let is_kept = fewer < more && (fewer < 4608) == (more < 4608);
        assert_eq!(added.taken_over_count(), if is_kept { known_count } else { 0 });
        let known_share = known_count as f64 / added.paths().path_count() as f64;
        let expected = if is_kept { 1.0 - known_share } else { 1.0 };
        // Paths that were known may be longer or shorter than others where strata are thinned out.
        assert!(
            (share - expected).abs() < 0.15 * expected + 0.02,
            "{fewer} and {more}: {share} for {expected}"
        );
    }
}

/// What counts as changed after an edit came or went: hits that a path kept on its way to where it changed are neither.
#[test]
fn hits_before_the_change_have_not_changed() {
    let before = samples::boxes().unwrap();
    let mut builder = SceneBuilder::from_scene(&before, SceneLimits::default());
    let there = before.nodes()["blue box"].parent_from_node;
    builder
        .set_transform("blue box", DAffine3::from_translation(DVec3::new(0.02, 0.01, 0.0)) * there)
        .unwrap();
    let (after, change) = builder.finish();
    let before = World::prepare(Arc::new(before));
    let after = before.update(Arc::new(after), &change);
    let mut tracing = PhotonTracing::new(emitting(4000));
    complete(&before, &mut tracing);
    // So few photons that none of them is thinned out: all keep their flux.
    assert_eq!(tracing.paths().full_count(), tracing.paths().path_count());
    let places = |tracing: &PhotonTracing| -> HashSet<[u32; 3]> {
        tracing.paths().hits().map(|(hit, _)| hit.position.to_array().map(f32::to_bits)).collect()
    };
    let lost = places(&tracing);
    tracing.apply(&Edit { before: &before, after: &after, change: &change });
    assert!(tracing.edit_counts().withdrawn > 100, "{:?}", tracing.edit_counts());
    complete(&after, &mut tracing);
    let won = places(&tracing);
    let changed = tracing.product().changed.clone().unwrap();
    let changed = changed.iter().flat_map(|of_class| of_class.values().flatten());
    let changed: Vec<[u32; 3]> = changed.map(|place| place.to_array().map(f32::to_bits)).collect();
    assert!(changed.len() > 100, "{}", changed.len());
    let kept = changed.iter().filter(|place| lost.contains(*place) == won.contains(*place)).count();
    assert_eq!(kept, 0, "of {}", changed.len());
}
