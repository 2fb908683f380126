//! Laws of the irradiance cache [techniques.md].

use std::{
    num::NonZeroUsize,
    sync::{Arc, atomic::AtomicBool},
};

use glam::{DAffine3, DVec3, Vec3, Vec3Swizzles};

use super::{record::GatherBy, walk::Seen, *};
use crate::{
    accel::{Hit, Ray, SurfacePoint},
    math::{
        sobol::{self, PixelSampler, point},
        statistics::RunningStatistics,
        warp,
    },
    scene::Material,
    scene::samples,
    technique::{Guide, samples_of_guides::guide_of},
    transport::{EVEN_RISE, World, schlick_rise},
};

/// Walls that shine as painted, wherever they are looked at from.
pub(super) struct Painted<F>(pub(super) F);

impl<F> std::fmt::Debug for Painted<F> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Painted")
    }
}

impl<F: Fn(Vec3) -> Rgb + Send + Sync> ArrivingLight for Painted<F> {
    fn radiance(
        &self,
        _world: &World,
        ray: &Ray,
        met: Option<Hit>,
        _sampler: &PixelSampler,
        _counts: &mut Counts,
    ) -> Rgb {
        met.map_or(Rgb::BLACK, |hit| (self.0)(ray.origin + ray.direction * hit.t))
    }
}

/// A box from −1 to 1 m.
pub(super) fn room() -> World {
    World::prepare(Arc::new(samples::furnace(0.5, 0.5).unwrap()))
}

/// The point of the floor below a place.
fn floor(world: &World, x: f32, z: f32) -> SurfacePoint {
    let ray = Ray::new(Vec3::new(x, 0.0, z), Vec3::NEG_Y);
    world.surface(&world.closest_hit(&ray).unwrap(), ray.direction).point
}

pub(super) fn with_rays(count: usize) -> IrradianceSettings {
    IrradianceSettings {
        ray_count: NonZeroUsize::new(count).unwrap(),
        visits: Visits::exactly(VISITS.least),
        ..IrradianceSettings::default()
    }
}

fn record(world: &World, x: f32, z: f32, n: Vec3, rays: usize, arriving: &dyn ArrivingLight) -> Record {
    record_at(world, (floor(world, x, z), Facing::flat(n)), &with_rays(rays), arriving).0
}

pub(super) fn record_at(
    world: &World,
    (point, facing): (SurfacePoint, Facing),
    settings: &IrradianceSettings,
    arriving: &dyn ArrivingLight,
) -> (Record, Counts) {
    let by = GatherBy { world, settings, arriving, cancel: &AtomicBool::new(false) };
    let (records, counts) = by.gather_all(&[Seen { point, facing, pixel_m: 0.0 }]).unwrap();
    (records[0].record, counts)
}

/// Even light of radiance 1 is an irradiance of π from wherever, and does not change.
#[test]
fn a_white_furnace_gives_pi() {
    let world = room();
    let even = Painted(|_| Rgb::WHITE);
    for (x, z) in [(0.0, 0.0), (0.99, -0.99), (-0.3, 0.999_99)] {
        let record = record(&world, x, z, Vec3::Y, 800, &even);
        for channel in record.irradiance.to_array() {
            assert!((channel / std::f32::consts::PI - 1.0).abs() < 1e-3, "{channel}");
        }
        assert!(record.moving.iter().all(|gradient| gradient.length() < 1e-3), "{:?}", record.moving);
        assert!(record.turning.iter().all(|gradient| gradient.length() < 1e-3), "{:?}", record.turning);
        assert!(record.radius_m > 0.0 && record.radius_m.is_finite());
    }
}

/// Records know how steeply their light falls, and so what a coat lets through of it: from all around, from above, from low walls, from
/// nowhere.
#[test]
fn records_know_what_a_coat_reflects_of_their_light() {
    let world = room();
    let low = |p: Vec3| if p.y < -0.6 && p.y > -0.99 { Rgb::WHITE } else { Rgb::BLACK };
    let above = |p: Vec3| Rgb::new(0.0, if p.y > 0.9 { 1.0 + p.x } else { 0.0 }, 0.0);
    for (name, paint) in [
        ("even", &(|_| Rgb::splat(1e-30)) as &(dyn Fn(Vec3) -> Rgb + Send + Sync)),
        ("above", &above),
        ("low", &low),
        ("dark", &|_| Rgb::BLACK),
    ] {
        let found = record(&world, 0.1, -0.2, Vec3::Y, 20_000, &Painted(paint)).coat_rise();
        let [mut risen, mut all] = [0.0; 2];
        for index in 0..40_000 {
            let [u, v, ..] = point(61, index);
            let direction = warp::cosine_hemisphere([u, v]);
            let ray = Ray::new(Vec3::new(0.1, -1.0 + 1e-6, -0.2), direction.xzy());
            let hit = world.closest_hit(&ray).unwrap();
            let light = paint(ray.origin + ray.direction * hit.t).mean();
            risen += f64::from(light * schlick_rise(direction.z));
            all += f64::from(light);
        }
        let expected = if all > 0.0 { (risen / all) as f32 } else { EVEN_RISE };
        assert!((found - expected).abs() < 0.01 * expected + 2e-5, "{name}: {found} for {expected}");
    }
}

/// Gradients are what finite differences of many more rays say, channel by channel.
#[test]
fn gradients_agree_with_finite_differences() {
    let world = room();
    let painted = Painted(|p: Vec3| {
        Rgb::new(1.0 + 0.8 * p.x, (1.5 * p.z).sin() + 1.1, if p.y > 0.5 { 2.0 + p.x * p.z } else { 0.2 })
    });
    const STEP: f32 = 0.05;
    const MANY: usize = 60_000;
    for (x, z) in [(0.0, 0.0), (0.4, -0.3), (-0.6, 0.5)] {
        let here = record(&world, x, z, Vec3::Y, 6_000, &painted);
        let irradiance =
            |x: f32, z: f32, n: Vec3| record(&world, x, z, n, MANY, &painted).irradiance.to_array();
        let difference = |a: [f32; 3], b: [f32; 3], channel: usize| (a[channel] - b[channel]) / (2.0 * STEP);
        let along_x = [irradiance(x + STEP, z, Vec3::Y), irradiance(x - STEP, z, Vec3::Y)];
        let along_z = [irradiance(x, z + STEP, Vec3::Y), irradiance(x, z - STEP, Vec3::Y)];
        for channel in 0..3 {
            let expected = Vec3::new(
                difference(along_x[0], along_x[1], channel),
                0.0,
                difference(along_z[0], along_z[1], channel),
            );
            let found = here.moving[channel];
            let off = found.distance(expected);
            assert!(off < 0.1 * expected.length() + 0.06, "{channel}: {found} for {expected}");
        }
        for axis in [Vec3::X, Vec3::Z] {
            let turned = |by: f32| (Vec3::Y + axis * by).normalize();
            let [more, less] = [irradiance(x, z, turned(STEP)), irradiance(x, z, turned(-STEP))];
            for channel in 0..3 {
                let expected = difference(more, less, channel);
                let found = Vec3::Y.cross(axis).dot(here.turning[channel]);
                assert!(
                    (found - expected).abs() < 0.05 * expected.abs() + 0.08,
                    "{channel}: {found} for {expected}"
                );
            }
        }
    }
}

/// What the halves of a gathering say of its noise is, in the mean, how much it differs from seed to seed: less than half as much again, no
/// less than a third; nothing in even light.
#[test]
fn halves_tell_the_noise_of_a_gathering() {
    let world = room();
    let spot =
        Painted(|p: Vec3| Rgb::WHITE * if p.distance(Vec3::new(1.0, 0.4, 0.3)) < 0.15 { 50.0 } else { 0.2 });
    let smooth = Painted(|p: Vec3| Rgb::WHITE * (1.5 + p.x + 0.4 * (5.0 * p.z).sin()));
    let stripes =
        Painted(|p: Vec3| Rgb::WHITE * if (9.0 * p.x).sin() * (7.0 * p.z).sin() > 0.3 { 1.0 } else { 0.0 });
    let even = Painted(|_| Rgb::WHITE);
    let noise = |arriving: &dyn ArrivingLight| {
        let (mut told, mut found) = (RunningStatistics::default(), RunningStatistics::default());
        for seed in 0..300 {
            let settings = IrradianceSettings { seed, ..with_rays(200) };
            let by =
                GatherBy { world: &world, settings: &settings, arriving, cancel: &AtomicBool::new(false) };
            let (point, facing) = (floor(&world, -0.2, 0.1), Facing::flat(Vec3::Y));
            let (gathered, _) = by.gather_all(&[Seen { point, facing, pixel_m: 0.0 }]).unwrap();
            told.add(f64::from(gathered[0].deviation).powi(2));
            found.add(f64::from(gathered[0].record.irradiance.mean()));
        }
        (told.mean(), found.variance())
    };
    for (name, arriving) in
        [("spot", &spot as &dyn ArrivingLight), ("smooth", &smooth), ("stripes", &stripes)]
    {
        let (told, found) = noise(arriving);
        println!("{name}: {told:e} told, {found:e} found");
        assert!(told > found / 3.0 && told < 1.5 * found, "{name}: {told:e} told, {found:e} found");
    }
    assert!(noise(&even).0 < 1e-10);
}

/// A ball of few triangles with a ball's normals, in even light: some rays set out behind a triangle and meet its neighbours
/// from within, at next to no distance. Records neither count less far for it nor lean.
#[test]
fn what_lies_behind_a_triangle_makes_no_record_steep() {
    let mut stage = samples::Stage::default();
    let grey = stage.material("grey", Material::lambert(Rgb::splat(0.5))).unwrap();
    for (name, radius_m) in [("ball", 1.0), ("walls", 10.0)] {
        stage.place(name, samples::sphere(DVec3::ZERO, radius_m, 12, &grey), DAffine3::IDENTITY).unwrap();
    }
    let world = World::prepare(Arc::new(stage.finish()));
    let walls_shine = Painted(|p: Vec3| Rgb::splat(if p.length() > 5.0 { 1.0 } else { 0.0 }));
    let mut leaning = 0;
    for index in 0..200 {
        let [u, v, ..] = point(7, index);
        let out = warp::sphere([u, v]);
        let ray = Ray::new(out * 5.0, -out);
        let surface = world.surface(&world.closest_hit(&ray).unwrap(), ray.direction);
        let facing = Facing::of(&surface, out);
        leaning += usize::from(facing.normal.dot(facing.n_geo) < 0.999);
        let (record, _) = record_at(&world, (surface.point, facing), &with_rays(400), &walls_shine);
        assert!(record.radius_m > 8.0, "counts as far as {} m at {out}", record.radius_m);
        for gradient in record.moving {
            assert!(gradient.length() * 0.5 < 0.05 * record.irradiance.mean(), "{gradient} at {out}");
        }
    }
    assert!(leaning > 100, "{leaning}");
}

/// A small bright spot on the ceiling of [`room`], in the dark.
const SPOT: Vec3 = Vec3::new(0.3, 1.0, -0.2);
const SPOT_RADIUS_M: f32 = 0.1;

fn spotted() -> Painted<impl Fn(Vec3) -> Rgb + Send + Sync> {
    Painted(|p: Vec3| Rgb::splat(if p.distance(SPOT) < SPOT_RADIUS_M { 100.0 } else { 0.1 }))
}

/// What the middle of the floor receives of it: of the spot in parts, 2 m above.
fn spotted_irradiance() -> f64 {
    let parts = (0..400).flat_map(|x| (0..400).map(move |z| Vec3::new(x as f32 + 0.5, 0.0, z as f32 + 0.5)));
    let part_m = 2.0 * SPOT_RADIUS_M / 400.0;
    let of_spot: f64 = parts
        .map(|part| SPOT - Vec3::new(SPOT_RADIUS_M, 0.0, SPOT_RADIUS_M) + part * part_m)
        .filter(|p| p.distance(SPOT) < SPOT_RADIUS_M)
        .map(|p| {
            let way2 = f64::from(p.distance_squared(Vec3::NEG_Y));
            4.0 / (way2 * way2) * f64::from(part_m * part_m) * 99.9
        })
        .sum();
    of_spot + f64::from(0.1 * std::f32::consts::PI)
}

/// What many records in the middle of the floor hold, each of a seed of its own.
fn many_records(count: u64, rays: usize, arriving: &dyn ArrivingLight) -> RunningStatistics {
    let world = room();
    let at = (floor(&world, 0.0, 0.0), Facing::flat(Vec3::Y));
    let mut found = RunningStatistics::default();
    for seed in 0..count {
        let settings = IrradianceSettings { seed, ..with_rays(rays) };
        found.add(f64::from(record_at(&world, at, &settings, arriving).0.irradiance.r));
    }
    found
}

/// Rays that go where light is uneven take nothing from the truth on average, though most hemispheres miss a spot smaller than
/// their cells, and some look at it many times.
#[test]
fn a_bright_spot_counts_for_what_it_is() {
    let (found, expected) = (many_records(4_000, 100, &spotted()), spotted_irradiance());
    assert!((found.mean() / expected - 1.0).abs() < 0.02, "{} for {expected}", found.mean());
    assert!(found.variance() > 0.25 * expected * expected, "{}", found.variance());
}

/// Light with what photons say of it.
#[derive(Debug)]
struct Hinted<A>(A, Guide);

impl<A: ArrivingLight> ArrivingLight for Hinted<A> {
    fn radiance(
        &self,
        world: &World,
        ray: &Ray,
        met: Option<Hit>,
        sampler: &PixelSampler,
        counts: &mut Counts,
    ) -> Rgb {
        self.0.radiance(world, ray, met, sampler, counts)
    }

    fn guide(&self) -> Option<&Guide> {
        Some(&self.1)
    }
}

/// Photons that fell around the middle of the floor, from within a distance of `from`.
fn photons_from(from: Vec3, radius_m: f32) -> Guide {
    let photon = |number: u32| {
        let [u, v, x, z] = point(17, number);
        let around = Vec3::new(2.0 * u - 1.0, 0.0, 2.0 * v - 1.0) * radius_m;
        let to = Vec3::new(0.4 * x - 0.2, -1.0, 0.4 * z - 0.2);
        (to, from + around)
    };
    guide_of(Vec3::Y, (0..300).map(photon))
}

/// Of a spot that photons tell of, records have a fraction of the noise. Whatever photons say, the mean is the truth, also where
/// they tell of another place, of one below the floor and of the record's own.
#[test]
fn photons_say_where_a_bright_spot_is() {
    let expected = spotted_irradiance();
    let right = |found: &RunningStatistics| {
        let off = (found.mean() - expected).abs();
        assert!(off < 3.5 * found.standard_error(), "{} for {expected}", found.mean());
    };
    let without = many_records(1_000, 400, &spotted());
    let with = many_records(1_000, 400, &Hinted(spotted(), photons_from(SPOT, SPOT_RADIUS_M)));
    right(&with);
    assert!(with.variance() < 0.1 * without.variance(), "{} {}", with.variance(), without.variance());
    // Elsewhere, beside the spot in its own cell and those around, and where nothing is told.
    for (wrong, radius_m) in [
        (Vec3::new(-0.9, 0.2, 0.9), 0.05),
        (SPOT + Vec3::new(0.15, 0.0, 0.0), 0.02),
        (SPOT - Vec3::new(0.0, 0.0, 0.12), 0.04),
        (Vec3::NEG_Y, 0.0),
    ] {
        let misled = many_records(4_000, 400, &Hinted(spotted(), photons_from(wrong, radius_m)));
        right(&misled);
        assert!(misled.variance() < 2.0 * without.variance(), "{} {}", misled.variance(), without.variance());
    }
}

/// Even light is as even with photons from everywhere as without, and photons from one side change no distance.
#[test]
fn photons_change_nothing_of_even_light() {
    let world = room();
    let even = Painted(|_| Rgb::WHITE);
    let everywhere = |number: u32| {
        let [u, v, x, z] = point(5, number);
        let from = warp::cosine_hemisphere([u, v]);
        (Vec3::new(0.4 * x - 0.2, -1.0, 0.4 * z - 0.2), Vec3::new(from.x, from.z, from.y) - Vec3::Y)
    };
    let record = |arriving: &dyn ArrivingLight| record(&world, 0.2, 0.1, Vec3::Y, 800, arriving);
    let plain = record(&even);
    let told = record(&Hinted(Painted(|_| Rgb::WHITE), guide_of(Vec3::Y, (0..300).map(everywhere))));
    assert!((told.irradiance.r / std::f32::consts::PI - 1.0).abs() < 1e-3, "{}", told.irradiance.r);
    assert!(told.moving.iter().all(|gradient| gradient.length() < 1e-3), "{:?}", told.moving);
    let aside = record(&Hinted(even, photons_from(Vec3::new(0.99, 0.0, 0.0), 0.1)));
    for found in [&told, &aside] {
        assert!(
            (found.radius_m / plain.radius_m - 1.0).abs() < 0.02,
            "{} {}",
            found.radius_m,
            plain.radius_m
        );
    }
}

/// Noise of a record over that of as many cells without rays that go where light is uneven, and over that of one visit.
#[test]
fn more_rays_and_visits_take_noise_away() {
    let world = room();
    let painted = Painted(|p: Vec3| Rgb::splat(if p.x > 0.3 && p.y > 0.2 { 10.0 } else { 0.1 }));
    let point = floor(&world, 0.0, 0.0);
    let noise = |share: f32, visits: u32| {
        let irradiances = (0..300).map(|seed| {
            let settings = IrradianceSettings { seed, noise: share, ..with_rays(400) };
            let facing = Facing::flat(Vec3::Y);
            let (mut record, _) = record_at(&world, (point, facing), &settings, &painted);
            let cancel = AtomicBool::new(false);
            let by = GatherBy { world: &world, settings: &settings, arriving: &painted, cancel: &cancel };
            for visit in 1..visits {
                let seen = Seen { point, facing, pixel_m: 0.0 };
                record = by.refine_all((&[seen], &[record]), visit).unwrap().0[0].record;
            }
            f64::from(record.irradiance.r)
        });
        let (sum, squares) = irradiances.fold((0.0, 0.0), |(sum, squares), e| (sum + e, squares + e * e));
        let mean = sum / 300.0;
        (squares / 300.0 - mean * mean).sqrt() / mean
    };
    let [even, adapted, visited] = [noise(1e3, 1), noise(1e-3, 1), noise(1e3, 4)];
    assert!(adapted < 0.6 * even, "{adapted} for {even}");
    assert!(visited < 0.65 * even, "{visited} for {even}");
}

/// Twice the light is twice the record, to the last bit, over eighteen orders of magnitude.
#[test]
fn records_are_linear_in_light() {
    let world = room();
    let painted = |scale: f32| Painted(move |p: Vec3| Rgb::new(1.0 + p.x, 0.5, (p.z + 1.0) * 1e-3) * scale);
    let one = record(&world, 0.2, 0.1, Vec3::Y, 500, &painted(1.0));
    for exponent in [-30, 1, 30] {
        let scale = 2f32.powi(exponent);
        let other = record(&world, 0.2, 0.1, Vec3::Y, 500, &painted(scale));
        assert_eq!(other.irradiance, one.irradiance * scale);
        assert_eq!(other.radius_m, one.radius_m);
        assert_eq!(other.moving, one.moving.map(|gradient| gradient * scale));
    }
}

/// In a corner, at a point light of dazzling paint and where paint is not a number, records stay finite and nowhere negative.
#[test]
fn records_stay_finite() {
    let world = room();
    let wild = Painted(|p: Vec3| match p {
        p if p.x > 0.999 => Rgb::splat(f32::NAN),
        p if p.z > 0.9 && p.y > 0.9 => Rgb::splat(1e9),
        _ => Rgb::splat(1e-9),
    });
    for (x, z) in [(0.999_99, 0.999_99), (-0.999_999, 0.0), (0.0, 0.0)] {
        let record = record(&world, x, z, Vec3::Y, 500, &wild);
        assert!(record.irradiance.is_finite() && record.radius_m.is_finite() && record.radius_m > 0.0);
        assert!(record.moving.iter().chain(&record.turning).all(|gradient| gradient.is_finite()));
        let weighing = IrradianceSettings::default().weighing;
        for (p, n) in
            [(record.position, Vec3::Y), (record.position + Vec3::X, Vec3::X), (Vec3::ZERO, Vec3::Z)]
        {
            let light = record.irradiance_at(p, n, &weighing);
            assert!(light.is_finite() && light.to_array().iter().all(|channel| *channel >= 0.0), "{light:?}");
            assert!(record.weight(p, &Facing::flat(n), &weighing).is_finite());
        }
    }
}

/// A strip of wall beside the floor that shines.
pub(super) fn strip() -> Painted<impl Fn(Vec3) -> Rgb + Send + Sync> {
    Painted(|p: Vec3| Rgb::splat(if p.x > 0.99 && p.y < -0.9 { 10.0 } else { 0.1 }))
}

/// Pixels make records count as far as light changes little over them: whole where it is even, less beside what shines, and never less than
/// one however steep it is. Elsewhere a record would say of the pixels around what holds at its own place alone.
#[test]
fn steep_light_counts_over_few_pixels() {
    let world = room();
    let pixel_m = 0.1;
    let reach = |x: f32, arriving: &dyn ArrivingLight| {
        let (settings, point) = (with_rays(2_000), floor(&world, x, 0.0));
        let by = GatherBy { world: &world, settings: &settings, arriving, cancel: &AtomicBool::new(false) };
        let seen = Seen { point, facing: Facing::flat(Vec3::Y), pixel_m };
        let record = by.gather_all(&[seen]).unwrap().0[0].record;
        record.reach_min_m / pixel_m
    };
    let whole = IrradianceSettings::default().pixels_min;
    assert_eq!(reach(0.0, &Painted(|_| Rgb::WHITE)), whole);
    assert_eq!(reach(-0.9, &strip()), whole);
    let [near, nearest] = [0.6, 0.97].map(|x| reach(x, &strip()));
    assert!(near < 0.9 * whole && near > 1.0, "{near}");
    assert_eq!(nearest, whole / STEEP_FINER_MAX);
}

fn somewhere(index: u32, irradiance: f32) -> Record {
    let [x, z, r, _] = point(11, index);
    let position = Vec3::new(2.0 * x - 1.0, 0.0, 2.0 * z - 1.0);
    Record {
        irradiance: Rgb::splat(irradiance),
        ..Record::dark_in_the_open(position, Facing::flat(Vec3::Y), 0.1 + 1.2 * r * r)
    }
}

/// Records count in front, on the side they face, and up to a · R; smoothly to nothing there if asked for.
#[test]
fn weights_are_those_of_the_paper() {
    let record = Record { position: Vec3::ZERO, radius_m: 2.0, ..somewhere(0, 1.0) };
    let original = Weighing { accuracy: 0.2, is_smooth: false, has_gradients: true };
    let smooth = Weighing { is_smooth: true, ..original };
    // 1 / (0.1 / 2 + 0).
    assert!((record.weight(Vec3::X * 0.1, &Facing::flat(Vec3::Y), &original) - 20.0).abs() < 1e-3);
    assert!((record.weight(Vec3::X * 0.1, &Facing::flat(Vec3::Y), &smooth) - 15.0).abs() < 1e-3);
    // a · R = 0.4.
    assert!(record.weight(Vec3::X * 0.399, &Facing::flat(Vec3::Y), &original) >= 5.0);
    assert_eq!(record.weight(Vec3::X * 0.401, &Facing::flat(Vec3::Y), &original), 0.0);
    assert!(record.weight(Vec3::X * 0.3999, &Facing::flat(Vec3::Y), &smooth) < 0.01);
    // √(1 − cos) < 0.2 up to 16.26°.
    let turned = |degrees: f32| Vec3::new(degrees.to_radians().sin(), degrees.to_radians().cos(), 0.0);
    assert!(record.weight(Vec3::ZERO, &Facing::flat(turned(16.0)), &original) > 0.0);
    assert_eq!(record.weight(Vec3::ZERO, &Facing::flat(turned(16.5)), &original), 0.0);
    // The other side of a thin wall, and what lies behind.
    assert_eq!(record.weight(Vec3::Y * -1e-4, &Facing::flat(Vec3::NEG_Y), &original), 0.0);
    assert_eq!(record.weight(Vec3::new(0.1, -0.1, 0.0), &Facing::flat(Vec3::Y), &original), 0.0);
    // Shading normals that agree around the edge of a wall.
    let around_the_edge = Facing { normal: Vec3::Y, n_geo: Vec3::X };
    assert_eq!(record.weight(Vec3::X * 0.1, &around_the_edge, &original), 0.0);
    // At the very point.
    assert!(record.weight(Vec3::ZERO, &Facing::flat(Vec3::Y), &original).is_finite());
}

/// The index leaves out no record that counts, at any scale.
#[test]
fn the_index_finds_every_record_that_counts() {
    for scale in [1e-4f32, 1.0, 1e4] {
        let settings = IrradianceSettings { clamps_neighbours: false, ..IrradianceSettings::default() };
        let mut cache = IrradianceCache::new(settings, None);
        for index in 0..100 {
            let record = somewhere(index, 1.0 + index as f32);
            let (position, radius_m) = (record.position * scale, record.radius_m * scale);
            cache.insert(Record { position, radius_m, ..record });
        }
        let weighing = &settings.weighing;
        let mut covered = 0;
        for index in 0..2000 {
            let [x, z, ..] = point(12, index);
            let p = Vec3::new(2.0 * x - 1.0, 0.0, 2.0 * z - 1.0) * scale;
            let (sum, weights) = cache.records().iter().fold((0.0, 0.0), |(sum, weights), record| {
                let weight = record.weight(p, &Facing::flat(Vec3::Y), weighing);
                (sum + record.irradiance.r * weight, weights + weight)
            });
            match cache.irradiance(p, &Facing::flat(Vec3::Y)) {
                Some(found) => assert!((found.r - sum / weights).abs() < 1e-3 * found.r, "{scale}"),
                None => assert!(weights <= 0.0, "{scale}: {p} lies within a record"),
            }
            covered += u32::from(weights > 0.0);
        }
        assert!(covered > 500 && covered < 1900, "{covered}");
    }
}

/// Where radii are clamped, none is larger than a neighbour's plus the way there.
#[test]
fn neighbours_clamp_each_other() {
    let mut cache = IrradianceCache::new(IrradianceSettings::default(), None);
    for index in 0..300 {
        cache.insert(somewhere(index, 1.0));
    }
    let small = Record { radius_m: 1e-3, ..somewhere(300, 1.0) };
    cache.insert(small);
    let shrunk = cache
        .records()
        .iter()
        .take(300)
        .zip(0..)
        .filter(|(now, index)| now.radius_m < somewhere(*index, 1.0).radius_m);
    assert!(shrunk.count() > 30);
    let reach = |record: &Record| record.reach_m(0.15);
    for record in cache.records() {
        let away = record.position.distance(small.position);
        if away < 0.9 * reach(record) {
            assert!(record.radius_m <= small.radius_m + away + 1e-6, "{} at {away}", record.radius_m);
        }
    }
}

/// A record depends on its place alone: the same bytes again, and others elsewhere.
#[test]
fn records_are_named_by_their_place() {
    let world = room();
    let painted =
        Painted(|p: Vec3| Rgb::splat(if sobol::mix(u64::from(p.x.to_bits())) & 1 == 0 { 1.0 } else { 0.0 }));
    let a = record(&world, 0.3, 0.3, Vec3::Y, 100, &painted);
    assert_eq!(a, record(&world, 0.3, 0.3, Vec3::Y, 100, &painted));
    assert_ne!(a.irradiance, record(&world, 0.31, 0.3, Vec3::Y, 100, &painted).irradiance);
}

/// No more than the 256 bytes that a record may take, what its rays saw among them.
#[test]
fn a_record_is_small() {
    let with_bound = size_of::<Record>() + size_of::<sight::Sight>();
    assert!(with_bound <= 256, "{with_bound}");
}
