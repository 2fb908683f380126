//! Records splatted onto a picture on a card, beside look-ups at the same points on the CPU.
//!
//! What a card and the CPU say at one point differs by rounding alone, but that is not little everywhere: the angle between two normals is
//! a root of a small difference, and near a record its weight is one over that. So every record's weight is bounded from both sides, in
//! double precision, and what is said may differ by what those bounds leave open: with E = Σ w Eₖ / Σ w and other weights w',
//! E' − E = Σ (w' − w) (Eₖ − E) / Σ w'.

mod ways;

use glam::{Vec3, Vec3Swizzles};

use super::{
    super::splats::{GpuSeenPoint, SplatBy},
    gathering::cabinet,
    known_light::{ALL_STEPS, SOME_STEPS, gathered},
    textures::masked,
    *,
};
use crate::{
    accel::Ray,
    gpu::GpuOptions,
    math::{sobol::point, warp},
    scene::{Projection, samples},
    technique::irradiance::{Facing, IrradianceCache, IrradianceSettings, Record, Weighing},
};

pub(super) const SEES_NOTHING: u32 = 0;
pub(super) const SEES_OTHER: u32 = 1;
pub(super) const SEES_DIFFUSE: u32 = 2;

/// A rounding of a single-precision number, as a share of it.
const ROUNDING: f64 = 1.0 / (1 << 24) as f64;
/// How far from the middle of its pixel a point may show, px: cards move corners by a 512th of a pixel at most, along either axis, and
/// their interpolation is taken to be off by as much again.
const ASIDE_MAX_PX: f32 = 1.0 / 128.0;
/// Share of pixels that may see another surface than their ray, see `lookouts.rs`.
const ELSEWHERE_MAX: f64 = 2e-3;
/// How far shading normals may be apart: a normal map turns them by one at most over a texel of 1.3 pixels, of which points are off by
/// [`ASIDE_MAX_PX`].
const BENT_MAX: f32 = 1e-2;
/// Share of pixels at which rounding decides whether a record counts, at most. A few are to be expected: borders of spheres and horizons
/// are lines of pixels, and rounding moves them by a hundred-thousandth of a pixel.
const UNDECIDED_MAX: f64 = 2e-3;

/// Every law holds for both.
const WAYS: [SplatBy; 2] = [SplatBy::Quads, SplatBy::Tiles];

fn view_of(shot: &Shot) -> View {
    View::new(&shot.world, &shot.camera, shot.size)
}

fn on_card(gpu: &Arc<Gpu>, shot: &Shot) -> GpuScene {
    GpuScene::new(Arc::clone(gpu), Arc::clone(&shot.world))
}

/// Pixels become points where their rays meet, that face as surfaces do, and know what scatters diffusely.
#[test]
fn points_are_what_pixels_see() {
    let Some(gpu) = shared() else { return };
    for (name, scene) in [
        ("boxes", samples::boxes().unwrap()),
        ("cornell box", samples::cornell_box().unwrap()),
        ("cabinet", cabinet()),
        ("masks", masked()),
    ] {
        let shot = Shot { size: size(67, 48), ..shot(scene) };
        let view = view_of(&shot);
        let nothing: Arc<dyn SecondaryLight> = Arc::new(IrradianceCache::new(settings(PLAIN), None));
        let splatted = on_card(&gpu, &shot).splatted(&view, &nothing).unwrap();
        let points = splatted.points();
        assert_eq!(points.len(), shot.size.pixel_count());
        let (mut elsewhere, mut diffuse, mut others, mut aside) = (0, 0, 0, 0.0f32);
        for (number, point) in (0..).zip(&points) {
            let middle = [number % 67, number / 67].map(|at| at as f32 + 0.5);
            let ray = view.ray(middle[0], middle[1]);
            let Some(hit) = shot.world.closest_hit(&ray) else {
                elsewhere += usize::from(point.sees != SEES_NOTHING);
                continue;
            };
            let surface = shot.world.surface(&hit, ray.direction);
            let facing = Facing::of(&surface, -ray.direction);
            let (p, n) = (Vec3::from(point.position), Vec3::from(point.n_geo));
            let is_there = point.sees != SEES_NOTHING && n.distance(facing.n_geo) < 1e-4 && {
                let off_plane_m = (p - surface.point.position).dot(facing.n_geo).abs();
                off_plane_m < 1e-4 * hit.t
            };
            if !is_there {
                elsewhere += 1;
                continue;
            }
            let shown = view.project(p).unwrap();
            aside = aside.max((shown[0] - middle[0]).abs()).max((shown[1] - middle[1]).abs());
            let sees = if surface.bsdf.has_diffuse() { SEES_DIFFUSE } else { SEES_OTHER };
            assert_eq!(point.sees, sees, "{name}: pixel {number}");
            // Seen from the side, rounding decides which way it is turned.
            let normal = Vec3::from(point.normal);
            let is_aside = facing.normal.dot(ray.direction).abs() <= BENT_MAX;
            let turned = if is_aside && normal.dot(facing.normal) < 0.0 { -normal } else { normal };
            let bent = turned.distance(facing.normal);
            assert!(bent < BENT_MAX, "{name}: {bent} at pixel {number}");
            diffuse += usize::from(sees == SEES_DIFFUSE);
            others += usize::from(sees == SEES_OTHER);
        }
        eprintln!(
            "{name}: {diffuse} diffuse, {others} others, {elsewhere} elsewhere, {aside} px aside at most"
        );
        assert!(elsewhere as f64 <= 1.0 + ELSEWHERE_MAX * points.len() as f64, "{name}: {elsewhere}");
        assert!(aside <= ASIDE_MAX_PX, "{name}: {aside} px");
        assert!(diffuse > 1000 && (name != "cabinet" || others > 100), "{name}: {diffuse}, {others}");
        let of_picture = points.iter().filter(|point| point.sees == SEES_DIFFUSE).count();
        assert_eq!(splatted.missing().unwrap().len(), of_picture, "{name}");
    }
}

const PLAIN: Weighing = Weighing { accuracy: 0.3, is_smooth: false, has_gradients: false };

fn settings(weighing: Weighing) -> IrradianceSettings {
    IrradianceSettings { weighing, clamps_neighbours: false, ..IrradianceSettings::default() }
}

/// Records on whatever lies around the eye, before it and behind it, of light by chance.
///
/// - `reach`: least and most, over how far away they are
fn strewn(shot: &Shot, weighing: Weighing, count: u32, reach: [f32; 2]) -> IrradianceCache {
    let view = view_of(shot);
    let mut cache = IrradianceCache::new(settings(weighing), None);
    for number in 0..20 * count {
        if cache.records().len() == count as usize {
            break;
        }
        let [u, v, size, red] = point(81, number);
        let ray = Ray::new(view.origin, warp::sphere([u, v]));
        let Some(hit) = shot.world.closest_hit(&ray) else { continue };
        let surface = shot.world.surface(&hit, ray.direction);
        let facing = Facing::of(&surface, -ray.direction);
        let reach_m = hit.t * reach[0] * (reach[1] / reach[0]).powf(size);
        let [x, y, z, green] = point(82, number);
        let change = Vec3::new(x - 0.5, y - 0.5, z - 0.5);
        let radius_m = reach_m / weighing.accuracy;
        let mut record = Record::dark_in_the_open(surface.point.position, facing, radius_m);
        record.irradiance = Rgb::new(0.1 + red, 0.1 + green, 1.0);
        record.turning = [change, -change, change.zxy()];
        record.moving = [change.yzx(), change, -change.zxy()].map(|change| change / reach_m);
        cache.insert(record);
    }
    cache
}

/// The least and the most that a record's weight may be at a point, by whatever rounding single precision leaves to a machine.
fn weight_bounds(record: &Record, p: Vec3, facing: &Facing, weighing: &Weighing) -> [f64; 2] {
    let accuracy = f64::from(weighing.accuracy);
    let way = p.as_dvec3() - record.position.as_dvec3();
    // Differences, squares, their sums, a root, a quotient and products: twelve roundings.
    let distance = way.length() * accuracy / f64::from(record.reach_m(weighing.accuracy));
    let distance = [1.0 - 12.0 * ROUNDING, 1.0 + 12.0 * ROUNDING].map(|by| distance * by);
    // Three products of unit vectors, whose sum is at most one, are added up and taken from one: six roundings of one, and two for vectors
    // that are units by rounding.
    let turned = 1.0 - facing.normal.as_dvec3().dot(record.normal.as_dvec3());
    let turned = [-8.0 * ROUNDING, 8.0 * ROUNDING].map(|by| (turned + by).clamp(0.0, 2.0).sqrt());
    let inverse = [
        (distance[0] + turned[0]) * (1.0 - 8.0 * ROUNDING),
        (distance[1] + turned[1]) * (1.0 + 8.0 * ROUNDING),
    ];
    if inverse[0] >= accuracy {
        return [0.0; 2];
    }
    // What is hidden, or behind, or faces apart is so a little beside, too, or else rounding decides.
    let beside_m = 1e-5 * way.length() as f32 + 4.0 * f32::EPSILON * p.abs().max_element();
    let places = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z];
    let counting = places.iter().filter(|by| record.weight(p + **by * beside_m, facing, weighing) > 0.0);
    let counting = counting.count();
    let is_at_border = inverse[1] > accuracy * (1.0 - 1e-5);
    if counting == 0 && !is_at_border {
        return [0.0; 2];
    }
    let of_inverse = |inverse: f64, off: f64| {
        // WGSL allows a quotient two and a half roundings of its last digit; there are two.
        let off = off * 10.0 * ROUNDING / inverse.max(1e-4);
        let weight = 1.0 / inverse.max(1e-4) + off;
        (if weighing.is_smooth { weight - 1.0 / accuracy } else { weight }).max(0.0)
    };
    let least =
        if counting < places.len() || inverse[1] >= accuracy { 0.0 } else { of_inverse(inverse[1], -1.0) };
    [least, of_inverse(inverse[0], 1.0)]
}

/// What a cache says at a point.
enum Said {
    Nothing,
    /// Irradiance, and by how much a machine may be off, by channel.
    This([f64; 3], [f64; 3]),
    /// Rounding decides.
    Undecided,
}

fn said(cache: &IrradianceCache, p: Vec3, facing: &Facing) -> Said {
    let weighing = cache.weighing();
    let found: Vec<([f64; 2], &Record)> = cache
        .records()
        .iter()
        .map(|record| (weight_bounds(record, p, facing, weighing), record))
        .filter(|([_, most], _)| *most > 0.0)
        .collect();
    let [least, most] = found.iter().fold([0.0; 2], |[least, most], (of, _)| [least + of[0], most + of[1]]);
    if most == 0.0 {
        return Said::Nothing;
    }
    if least == 0.0 {
        return Said::Undecided;
    }
    let (mut is, mut off) = ([0.0; 3], [0.0; 3]);
    for channel in 0..3 {
        let says = |record: &Record| {
            let says = record.irradiance_at(p, facing.normal, weighing).to_array()[channel];
            let way_m = p.distance(record.position);
            let change = record.turning[channel].length() + way_m * record.moving[channel].length();
            // Two cross products, two sums of three and what they are added to: sixteen roundings of what is added up.
            (
                f64::from(says),
                16.0 * ROUNDING * f64::from(record.irradiance.to_array()[channel].abs() + change),
            )
        };
        let middle = |[least, most]: &[f64; 2]| 0.5 * (least + most);
        let weights: f64 = found.iter().map(|(of, _)| middle(of)).sum();
        let sum: f64 = found.iter().map(|(of, record)| middle(of) * says(record).0).sum();
        is[channel] = sum / weights;
        let by_one = |(of, record): &([f64; 2], &Record)| {
            let (says, rounded) = says(record);
            0.5 * (of[1] - of[0]) * (says - is[channel]).abs() + of[1] * rounded
        };
        let by_all: f64 = found.iter().map(by_one).sum();
        // Products, sums in whatever order, and a quotient.
        let by_sums = (found.len() as f64 + 8.0) * 2.0 * ROUNDING * is[channel].abs();
        off[channel] = by_all / least + by_sums;
    }
    Said::This(is, off)
}

/// How a card's answers were found to be.
#[derive(Debug, Default)]
struct Likeness {
    /// Pixels that see what scatters diffusely; of which a cache answered, and the finest did not.
    diffuse: usize,
    answered: usize,
    missing: usize,
    undecided: usize,
    /// Most that a card was off from what lies in the middle of all roundings, over what it may be.
    off_of_allowed: f64,
    /// Mean and most that it was off from what the CPU's roundings make of it, over that.
    mean_off: f64,
    off: f64,
    /// Mean of what it may be, over what is said.
    mean_allowed: f64,
}

/// Asserts that a picture shows what look-ups at its points say, and misses what they miss, splatted either way.
fn splatted_alike(name: &str, gpu: &Arc<Gpu>, shot: &Shot, cache: &IrradianceCache) -> Likeness {
    let [by_quads, by_tiles] = WAYS.map(|by| splatted_alike_by(name, gpu, shot, cache, by));
    let counts = |found: &Likeness| [found.diffuse, found.answered, found.missing, found.undecided];
    assert_eq!(counts(&by_quads), counts(&by_tiles), "{name}");
    by_tiles
}

fn splatted_alike_by(
    name: &str,
    gpu: &Arc<Gpu>,
    shot: &Shot,
    cache: &IrradianceCache,
    by: SplatBy,
) -> Likeness {
    let known: Arc<dyn SecondaryLight> = Arc::new(cache.clone());
    let view = view_of(shot);
    let splatted = on_card(gpu, shot).splatted_by(&view, &known, by).unwrap();
    let (points, irradiances) = (splatted.points(), splatted.irradiances().unwrap());
    let missing = splatted.missing().unwrap();
    assert!(missing.is_sorted_by(|a, b| a < b));
    let mut found = Likeness::default();
    for (number, (point, irradiance)) in (0..).zip(points.iter().zip(&irradiances)) {
        let is_missing = missing.binary_search(&number).is_ok();
        if point.sees != SEES_DIFFUSE {
            assert!(irradiance.is_none() && !is_missing, "{name}: pixel {number}");
            continue;
        }
        found.diffuse += 1;
        let (p, facing) = facing_of(point);
        let caches = cache.in_order();
        let by_finest = said(caches[0], p, &facing);
        if let Said::Undecided = by_finest {
            found.undecided += 1;
            continue;
        }
        assert_eq!(is_missing, matches!(by_finest, Said::Nothing), "{name}: pixel {number}");
        found.missing += usize::from(is_missing);
        let answers = caches.iter().map(|cache| said(cache, p, &facing));
        match answers.into_iter().find(|said| !matches!(said, Said::Nothing)) {
            None => assert_eq!(*irradiance, None, "{name}: pixel {number}"),
            Some(Said::This(is, allowed)) => {
                let irradiance = irradiance.unwrap_or_else(|| panic!("{name}: nothing at pixel {number}"));
                found.answered += 1;
                for (channel, value) in irradiance.to_array().into_iter().enumerate() {
                    let off = (f64::from(value) - is[channel]).abs();
                    let allowed = allowed[channel];
                    assert!(off <= allowed, "{name}: {value} for {} ± {allowed} at {number}", is[channel]);
                    found.off_of_allowed = found.off_of_allowed.max(off / allowed.max(f64::MIN_POSITIVE));
                }
                let looked_up = caches.iter().find_map(|cache| cache.irradiance(p, &facing)).unwrap();
                let off = (looked_up - irradiance).map(f32::abs).to_array();
                assert!((0..3).all(|channel| f64::from(off[channel]) <= 2.0 * allowed[channel]), "{name}");
                let off = f64::from(off_rgb(looked_up, irradiance, 1e-6));
                found.off = found.off.max(off);
                found.mean_off += off;
                found.mean_allowed += allowed[0] / is[0].max(1e-6);
            }
            Some(_) => found.undecided += 1,
        }
    }
    let answered = found.answered.max(1) as f64;
    (found.mean_off, found.mean_allowed) = (found.mean_off / answered, found.mean_allowed / answered);
    eprintln!("{name}, by {by:?}: {} records, {found:?}", cache.records().len());
    let undecided_max = 2.0 + UNDECIDED_MAX * found.diffuse as f64;
    assert!(found.undecided as f64 <= undecided_max, "{name}: {}", found.undecided);
    found
}

fn facing_of(point: &GpuSeenPoint) -> (Vec3, Facing) {
    let facing = Facing { normal: point.normal.into(), n_geo: point.n_geo.into() };
    (point.position.into(), facing)
}

/// From a corner into the room, where there is as much behind the eye as before it.
fn from_elsewhere(shot: Shot) -> Shot {
    let camera = CameraView::look_at(DVec3::new(-1.5, 1.2, -1.0), DVec3::new(0.6, -0.2, 0.4), DVec3::Y, 1.2);
    Shot { camera, ..shot }
}

/// By every way of weighing, on plain and bent surfaces, by records before the eye, behind it and around it, each pixel has what look-ups
/// say.
#[test]
fn splats_say_what_look_ups_say() {
    let Some(gpu) = shared() else { return };
    let weighings = [(false, false), (true, false), (false, true), (true, true)];
    let sized = |shot: Shot| Shot { size: size(67, 48), ..shot };
    for (name, shot) in [
        ("boxes", sized(shot(samples::boxes().unwrap()))),
        ("boxes from elsewhere", sized(from_elsewhere(shot(samples::boxes().unwrap())))),
        ("cabinet", sized(shot(cabinet()))),
    ] {
        let view = view_of(&shot);
        for (is_smooth, has_gradients) in weighings {
            let weighing = Weighing { accuracy: 0.3, is_smooth, has_gradients };
            let cache = strewn(&shot, weighing, 70, [0.05, 1.5]);
            let depths = cache.records().iter().map(|record| (view.origin - record.position).dot(view.back));
            let around = cache
                .records()
                .iter()
                .filter(|record| record.position.distance(view.origin) < record.reach_m(0.3));
            let (behind, around) = (depths.filter(|depth_m| *depth_m < 0.0).count(), around.count());
            // A cabinet has no wall behind the eye.
            let behind_min = if name == "cabinet" { 0 } else { 20 };
            assert!(behind >= behind_min && around > 3, "{name}: {behind} behind, {around} around");
            let found = splatted_alike(&format!("{name}, {weighing:?}"), &gpu, &shot, &cache);
            assert!(found.answered > 300 && found.missing > 50, "{name}: {found:?}");
        }
    }
}

/// A record shows wherever its sphere reaches into the picture: from below the eye, from behind it, around it and past it on either side.
#[test]
fn records_behind_the_eye_reach_before_it() {
    let Some(gpu) = shared() else { return };
    // Low above the floor of a room, looking along it.
    let eye = DVec3::new(0.0, -0.7, 1.0);
    let camera = CameraView::look_at(eye, eye - DVec3::Z, DVec3::Y, 1.6);
    let shot = Shot { camera, size: size(80, 60), ..shot(room().finish()) };
    for (name, aside_m, behind_m, reach_m, is_seen) in [
        ("before", 0.2, -1.0, 0.5, true),
        ("below", 0.0, 0.0, 0.8, true),
        ("around", 0.0, 0.5, 2.0, true),
        ("past it on the right", 1.0, 0.2, 0.9, true),
        ("past it on the left", -1.0, 0.2, 0.9, true),
        ("behind", 0.0, 0.8, 0.5, false),
        ("behind on the left", -1.0, 0.4, 0.5, false),
    ] {
        let position = shot.world.accel().to_render(DVec3::new(aside_m, -1.0, 1.0 + behind_m));
        let mut record = Record::dark_in_the_open(position, Facing::flat(Vec3::Y), reach_m / PLAIN.accuracy);
        record.irradiance = Rgb::WHITE;
        let mut cache = IrradianceCache::new(settings(PLAIN), None);
        cache.insert(record);
        let found = splatted_alike(name, &gpu, &shot, &cache);
        assert_eq!(found.answered > 20, is_seen, "{name}: {found:?}");
        assert!(is_seen || found.answered == 0, "{name}: {found:?}");
    }
}

/// So has each pixel in which no record of the finest cache counts, by rougher ones, and none that the finest answers.
#[test]
fn rougher_caches_answer_for_what_finer_ones_miss() {
    let Some(gpu) = shared() else { return };
    let shot = shot(samples::boxes().unwrap());
    let smooth = Weighing { accuracy: 0.2, is_smooth: true, has_gradients: true };
    let fine = strewn(&shot, smooth, 60, [0.05, 0.2]);
    let rough = strewn(&shot, Weighing { accuracy: 0.4, ..smooth }, 40, [0.2, 0.8]);
    let roughest = strewn(&shot, Weighing { accuracy: 0.8, ..PLAIN }, 20, [1.0, 2.0]);
    let none = IrradianceCache::new(settings(smooth), None);
    let all = fine.clone().before(rough.clone().before(roughest));
    let alone = splatted_alike("the finest", &gpu, &shot, &fine);
    let both = splatted_alike("two caches", &gpu, &shot, &fine.clone().before(rough.clone()));
    let three = splatted_alike("three caches", &gpu, &shot, &all);
    assert_eq!([both.missing, three.missing], [alone.missing; 2]);
    assert!(alone.answered + 50 < both.answered && both.answered + 50 < three.answered);
    // An empty one between and before others changes nothing but what is missing.
    let between =
        splatted_alike("nothing between", &gpu, &shot, &fine.before(none.clone().before(rough.clone())));
    assert_eq!([between.answered, between.missing], [both.answered, both.missing]);
    let before = splatted_alike("nothing before", &gpu, &shot, &none.clone().before(rough));
    assert!(before.answered > 50 && before.missing == before.diffuse);
    let nothing = splatted_alike("nothing at all", &gpu, &shot, &none);
    assert_eq!([nothing.answered, nothing.missing], [0, nothing.diffuse]);
}

/// Records as they are gathered, with horizons and several rounds of them.
#[test]
fn gathered_records_are_splatted_alike() {
    let Some(gpu) = shared() else { return };
    for (name, scene, steps) in [
        ("boxes", samples::boxes().unwrap(), ALL_STEPS),
        ("boxes, some", samples::boxes().unwrap(), SOME_STEPS),
        ("parted rooms", samples::parted_rooms([300.0, 3.0]).unwrap(), ALL_STEPS),
    ] {
        let (shot, caching) = gathered(scene, steps, false);
        let found = splatted_alike(name, &gpu, &shot, caching.cache());
        assert!(found.answered > 1_000, "{name}: {found:?}");
        // Seen from elsewhere, some of it lies behind what hid it.
        let elsewhere = from_elsewhere(shot);
        let found = splatted_alike(&format!("{name} from elsewhere"), &gpu, &elsewhere, caching.cache());
        assert!(found.missing > 50, "{name}: {found:?}");
    }
}

/// A record at the very point that a pixel sees says there what it holds.
#[test]
fn a_record_at_the_very_point_holds_there() {
    let Some(gpu) = shared() else { return };
    let shot = shot(samples::boxes().unwrap());
    let (view, scene) = (view_of(&shot), on_card(&gpu, &shot));
    let weighing = Weighing { accuracy: 0.2, is_smooth: true, has_gradients: true };
    let mut cache = IrradianceCache::new(settings(weighing), None);
    let empty: Arc<dyn SecondaryLight> = Arc::new(cache.clone());
    let points = scene.splatted(&view, &empty).unwrap().points();
    let number = points.iter().position(|point| point.sees == SEES_DIFFUSE).unwrap();
    let (p, facing) = facing_of(&points[number]);
    let irradiance = Rgb::new(3.0, 2.0, 1.0);
    // Too small to show in any other pixel, and of a light that changes so fast that it would be wrong beside.
    let mut record = Record::dark_in_the_open(p, facing, 1e-4);
    (record.irradiance, record.moving) = (irradiance, [Vec3::ONE * 1e3; 3]);
    cache.insert(record);
    let known: Arc<dyn SecondaryLight> = Arc::new(cache);
    let others = (0..).zip(&points).filter(|(_, point)| point.sees == SEES_DIFFUSE).map(|(other, _)| other);
    let others: Vec<u32> = others.filter(|other| *other != number as u32).collect();
    for by in WAYS {
        let splatted = scene.splatted_by(&view, &known, by).unwrap();
        let irradiances = splatted.irradiances().unwrap();
        assert_eq!(irradiances.iter().flatten().count(), 1, "{by:?}");
        assert_eq!(irradiances[number], Some(irradiance), "{by:?}");
        assert_eq!(splatted.missing().unwrap(), others, "{by:?}");
    }
}

/// A device that is lost before, or half way, is opened again and brings the same; what was on it is gone.
#[test]
fn splatting_survives_losses() {
    let Some(gpu) = shared() else { return };
    let gpu = Arc::new(Gpu::open_with(&gpu.options()).unwrap());
    let shot = shot(samples::boxes().unwrap());
    let (view, scene) = (view_of(&shot), on_card(&gpu, &shot));
    let cache = strewn(&shot, PLAIN, 300, [0.1, 0.5]);
    let known: Arc<dyn SecondaryLight> = Arc::new(cache);
    let missing = scene.missing(&view, &known).unwrap();
    for by in WAYS {
        let before = scene.splatted_by(&view, &known, by).unwrap();
        let irradiances = before.irradiances().unwrap();
        assert_eq!(before.missing().unwrap(), missing);
        gpu.session().unwrap().lose_for_test();
        assert_eq!(before.irradiances(), Err(GpuError::Lost));
        assert_eq!(before.missing(), Err(GpuError::Lost));
        let after = scene.splatted_by(&view, &known, by).unwrap();
        assert_eq!(after.irradiances().unwrap(), irradiances);
        assert_eq!(after.missing().unwrap(), missing);
    }
    // Some of these devices are lost while they draw, whichever those are.
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for _ in 0..3 {
                std::thread::yield_now();
                gpu.session().inspect(|session| session.lose_for_test()).ok();
            }
        });
        for _ in 0..4 {
            assert_eq!(scene.missing(&view, &known).unwrap(), missing);
        }
    });
}

/// Where a picture has no room beside light that others have asked for, that goes.
#[test]
fn other_light_goes_for_a_picture() {
    let Some(gpu) = shared() else { return };
    let shot = shot(samples::boxes().unwrap());
    let view = view_of(&shot);
    let of = |count| -> Arc<dyn SecondaryLight> { Arc::new(strewn(&shot, PLAIN, count, [0.02, 0.05])) };
    let (many, some) = (of(3_000), of(600));
    let roomy = on_card(&Arc::new(Gpu::open_with(&gpu.options()).unwrap()), &shot);
    let missing = [&many, &some].map(|known| roomy.missing(&view, known).unwrap());
    // Some 100 bytes a pixel while it is drawn.
    let bytes_max = roomy.bytes() + 50 * shot.size.pixel_count() as u64;
    let options = GpuOptions { bytes_max, ..gpu.options() };
    let narrow = on_card(&Arc::new(Gpu::open_with(&options).unwrap()), &shot);
    assert_eq!(narrow.missing(&view, &many).unwrap(), missing[0]);
    let with_many = narrow.bytes();
    assert_eq!(narrow.missing(&view, &some).unwrap(), missing[1]);
    assert!(narrow.bytes() < with_many && narrow.bytes() < roomy.bytes());
}

/// Views and light that are not splatted are refused, and so are pictures without room; others go on.
#[test]
fn what_is_not_splatted_is_refused() {
    let Some(gpu) = shared() else { return };
    let shot = shot(samples::boxes().unwrap());
    let known: Arc<dyn SecondaryLight> = Arc::new(strewn(&shot, PLAIN, 100, [0.1, 0.5]));
    let options = GpuOptions { bytes_max: 3_000_000, ..gpu.options() };
    let scene = on_card(&Arc::new(Gpu::open_with(&options).unwrap()), &shot);
    let missing = scene.missing(&view_of(&shot), &known).unwrap();
    let flat = CameraView { projection: Projection::Orthographic { half_height_m: 1.0 }, ..shot.camera };
    let flat = View::new(&shot.world, &flat, shot.size);
    assert!(matches!(scene.missing(&flat, &known), Err(GpuError::Failed { .. })));
    let octree = known_light::with_known(samples::boxes().unwrap(), None).known.unwrap();
    assert!(matches!(scene.missing(&view_of(&shot), &octree), Err(GpuError::Failed { .. })));
    let side = PictureSize::SIDE_MAX;
    for large in [size(640, 480), size(side, side)] {
        let large = View::new(&shot.world, &shot.camera, large);
        let refused = scene.missing(&large, &known);
        assert!(matches!(refused, Err(GpuError::OutOfMemory { .. })), "{refused:?}");
    }
    assert_eq!(scene.missing(&view_of(&shot), &known).unwrap(), missing);
    assert!(scene.bytes() <= options.bytes_max);
}
