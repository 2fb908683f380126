//! Laws of light sampling: densities are those of the draws, and what is drawn adds up to closed forms.

mod pictures;
mod points;

use std::sync::Arc;

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};

use super::*;
use crate::{
    accel::TriangleId,
    math::{Rgb, RunningStatistics, sobol::point},
    scene::{
        Environment, Id, Light, Material, Scene, Texels, Texture,
        samples::{self, Stage, quad},
    },
    transport::World,
};

/// A point of a surface in the void, for asking what arrives there.
fn receiver(world: &World, p_in_world: DVec3, n: DVec3) -> SurfacePoint {
    SurfacePoint {
        position: world.accel().to_render(p_in_world),
        n_geo: n.as_vec3(),
        error_m: 0.0,
        on: TriangleId::NONE,
    }
}

/// Mean and standard error of `value(sample)` over light samples at a receiver; zero where no light is drawn.
fn mean_over_samples(
    world: &World,
    at: &SurfacePoint,
    count: u32,
    value: impl Fn(&LightSample) -> f64,
) -> RunningStatistics {
    let mut statistics = RunningStatistics::default();
    for i in 0..count {
        // Unstratified numbers: the standard error of the mean is then that of independent draws.
        let [a, b, c, _] = point(u64::from(i) + 1, 0);
        let sample = world.lights().sample(world.accel(), at.position, at.n_geo, || None, [a, b, c]);
        statistics.add(sample.map_or(0.0, |sample| value(&sample)));
    }
    statistics
}

/// Irradiance at a receiver, green channel, by light sampling alone.
fn irradiance(world: &World, at: &SurfacePoint, count: u32) -> RunningStatistics {
    mean_over_samples(world, at, count, |sample| {
        let Some((radiance, shadow)) = world.towards_light(at, sample) else { return 0.0 };
        if world.is_occluded(&shadow) {
            return 0.0;
        }
        f64::from(radiance.g * sample.wi.dot(at.n_geo).max(0.0) / sample.pdf)
    })
}

/// Irradiance from a polygon of radiance 1 that lies above the horizon: ½ Σ Γᵢ · n over its edges [Lambert1760].
/// Corners clockwise seen from the receiver.
fn polygon_irradiance(corners: &[DVec3], p: DVec3, n: DVec3) -> f64 {
    let to: Vec<DVec3> = corners.iter().map(|corner| (*corner - p).normalize()).collect();
    (0..to.len())
        .map(|i| {
            let (a, b) = (to[i], to[(i + 1) % to.len()]);
            let across = a.cross(b);
            a.dot(b).clamp(-1.0, 1.0).acos() * across.normalize_or_zero().dot(n)
        })
        .sum::<f64>()
        .abs()
        * 0.5
}

/// Solid angle of a triangle [VanOosterom1983].
fn solid_angle([a, b, c]: [DVec3; 3], p: DVec3) -> f64 {
    let [a, b, c] = [a, b, c].map(|corner| (corner - p).normalize());
    2.0 * a.cross(b).dot(c).abs().atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a))
}

/// What a light sample says of its density is what it has for who meets the light there by chance.
fn assert_densities_agree(world: &World, at: &SurfacePoint, sample: &LightSample) {
    let LightOrigin::Surface { instance, triangle, barycentric: [b1, b2], point } = sample.origin else {
        return;
    };
    let hit = Hit { t: 0.0, instance, triangle, b1, b2 };
    let again = world.lights().pdf_of_triangle(at.position, at.n_geo, sample.wi, &hit, &point);
    assert!((again / sample.pdf - 1.0).abs() < 1e-5, "{again} {}", sample.pdf);
}

/// `rounding`: relative error that single precision may make in every sample alike.
fn assert_is(statistics: &RunningStatistics, expected: f64, rounding: f64, what: &str) {
    let off = (statistics.mean() - expected).abs();
    assert!(
        off <= 5.0 * statistics.standard_error() + rounding * expected.abs(),
        "{what}: {} ± {}, not {expected}",
        statistics.mean(),
        statistics.standard_error()
    );
}

/// Corners of a lamp 2 by 1.4, counter-clockwise seen from below.
const LAMP: [DVec3; 4] = [
    DVec3::new(-1.0, 0.0, -0.7),
    DVec3::new(1.0, 0.0, -0.7),
    DVec3::new(1.0, 0.0, 0.7),
    DVec3::new(-1.0, 0.0, 0.7),
];

/// A lamp of radiance 3 under `placed`, and whatever `more` adds.
fn under_a_lamp(placed: DAffine3, two_sided: bool, more: impl FnOnce(&mut Stage)) -> World {
    let mut stage = Stage::default();
    let lamp = Material { double_sided: two_sided, ..Material::emitter(Rgb::new(1.0, 3.0, 2.0)) };
    let lamp = stage.material("lamp", lamp).unwrap();
    stage.place("lamp", quad(LAMP, &lamp), placed).unwrap();
    more(&mut stage);
    World::prepare(Arc::new(stage.finish()))
}

/// A rectangle lights a surface as Lambert's formula says: turned, stretched, mirrored, from its back, and a
/// millimetre of lamp at the end of a scene of four kilometres.
#[test]
fn rectangles_light_surfaces_as_lamberts_formula_says() {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 0.3, -0.5).normalize(), 0.6);
    let placed = |scale: DVec3, at: DVec3| DAffine3::from_scale_rotation_translation(scale, turn, at);
    let far = DVec3::new(1750.0, -750.0, 1000.0);
    for (name, world_from_lamp, two_sided, below, far_body) in [
        ("plain", DAffine3::IDENTITY, false, true, false),
        (
            "turned and stretched",
            placed(DVec3::new(2.0, 1.0, 0.5), DVec3::new(0.2, 0.4, 0.1)),
            false,
            true,
            false,
        ),
        ("mirrored", placed(DVec3::new(-1.0, 1.0, 2.0), DVec3::ZERO), false, true, false),
        ("from behind", placed(DVec3::ONE, DVec3::ZERO), false, false, false),
        ("two-sided, below", placed(DVec3::ONE, DVec3::ZERO), true, true, false),
        ("two-sided, above", placed(DVec3::ONE, DVec3::ZERO), true, false, false),
        ("small and far from the middle", placed(DVec3::splat(0.0005), far), false, true, true),
    ] {
        let world = under_a_lamp(world_from_lamp, two_sided, |stage| {
            if far_body {
                let grey = stage.material("grey", Material::lambert(Rgb::splat(0.5))).unwrap();
                let ball = samples::sphere(DVec3::ZERO, 1.0, 4, &grey);
                stage.place("far", ball, DAffine3::from_translation(-far)).unwrap();
            }
        });
        let side = if below { -1.0 } else { 1.0 };
        // The middle of a far scene is off what f32 can place: the receiver stands where f32 has it.
        let distance = if far_body { 600.0 } else { 1.1 };
        let p = world_from_lamp.transform_point3(DVec3::new(0.3, distance * side, -0.2));
        let p = world.accel().origin_in_world() + world.accel().to_render(p).as_dvec3();
        let corners = LAMP.map(|corner| world_from_lamp.transform_point3(corner));
        let n = (corners[0] + corners[2] - p * 2.0).normalize();
        let expected = if below || two_sided { 3.0 * polygon_irradiance(&corners, p, n) } else { 0.0 };
        let at = receiver(&world, p, n);
        // The far lamp is placed to 2⁻²⁴ of a kilometre, 6e-5 m in 0.3 m, and light goes with the distance squared.
        let rounding = if far_body { 4e-4 } else { 1e-4 };
        assert_is(&irradiance(&world, &at, 40_000), expected, rounding, name);
    }
}

/// Every density that sampling a triangle gives is the one that a ray which hits the same place is told, and the
/// densities integrate to the solid angles: the mean of 1/density is what the lamps cover of the sphere.
#[test]
fn densities_of_triangles_are_normalised_and_the_same_for_both_strategies() {
    let up = DAffine3::from_translation(DVec3::new(0.5, 3.0, 1.0));
    let world = under_a_lamp(DAffine3::from_translation(DVec3::Y), false, |stage| {
        let lamp = stage.material("other lamp", Material::emitter(Rgb::splat(40.0))).unwrap();
        stage.place("other", quad(LAMP, &lamp), up).unwrap();
    });
    let p = DVec3::new(0.1, -0.5, 0.2);
    let at = receiver(&world, p, DVec3::Y);
    let covered = mean_over_samples(&world, &at, 60_000, |sample| {
        assert_densities_agree(&world, &at, sample);
        1.0 / f64::from(sample.pdf)
    });
    let lamps = [DAffine3::from_translation(DVec3::Y), up];
    let expected: f64 = lamps
        .iter()
        .flat_map(|placed| [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i| placed.transform_point3(LAMP[i]))))
        .map(|triangle| solid_angle(triangle, p))
        .sum();
    assert_is(&covered, expected, 1e-4, "solid angle of two lamps");
}

/// Point, spot and directional lights on nodes that turn, scale and mirror: I cos θ / d², with glTF's falloff, and E cos θ.
#[test]
fn lights_without_size_light_surfaces_as_the_textbook_says() {
    let turn = DQuat::from_axis_angle(DVec3::new(0.2, 1.0, -0.4).normalize(), 1.1);
    let at = DVec3::new(2.0, -1.0, 0.5);
    let placed = DAffine3::from_scale_rotation_translation(DVec3::new(2.0, 2.0, -2.0), turn, at);
    let (inner, outer) = (0.3f32, 0.5f32);
    let intensity = Rgb::new(1.0, 7.0, 2.0);
    let lit_by = |kind: LightKind| {
        let mut stage = Stage::default();
        let node = crate::scene::Node { parent: None, parent_from_node: placed, mesh: None };
        let id = Id::new("mount").unwrap();
        stage.builder().add_node(id.clone(), node).unwrap();
        let direction = DVec3::new(0.0, -1.0, 0.2).normalize();
        stage.light("light", Light { parent: Some(id), position: DVec3::Y, direction, kind }).unwrap();
        World::prepare(Arc::new(stage.finish()))
    };
    let position = placed.transform_point3(DVec3::Y);
    let axis = placed.transform_vector3(DVec3::new(0.0, -1.0, 0.2)).normalize();
    let side = axis.any_orthonormal_vector();
    for off_axis_rad in [0.0f64, 0.2, 0.37, 0.45, 0.6] {
        let to_surface = axis * off_axis_rad.cos() + side * off_axis_rad.sin();
        let (p, distance) = (position + to_surface * 3.0, 3.0);
        let n = (-to_surface + side * 0.4).normalize();
        let cos = n.dot(-to_surface);
        let full = 7.0 * cos / (distance * distance);
        let spot = LightKind::Spot { intensity, inner_angle_rad: inner, outer_angle_rad: outer };
        let (cos_inner, cos_outer) = (f64::from(inner).cos(), f64::from(outer).cos());
        let falloff = ((off_axis_rad.cos() - cos_outer) / (cos_inner - cos_outer)).clamp(0.0, 1.0).powi(2);
        for (name, kind, expected) in [
            ("point", LightKind::Point { intensity }, full),
            ("spot", spot, full * falloff),
            ("directional", LightKind::Directional { irradiance: intensity }, 7.0 * n.dot(-axis).max(0.0)),
        ] {
            let world = lit_by(kind);
            let got = irradiance(&world, &receiver(&world, p, n), 8);
            assert!(
                (got.mean() - expected).abs() < 2e-5 * full,
                "{name} at {off_axis_rad}: {} for {expected}",
                got.mean()
            );
        }
    }
}

/// No light that lights a surface has chance zero there: a light without size would be lost for good.
#[test]
fn every_light_that_reaches_a_surface_can_be_drawn() {
    let numbers = |i: u32, k: u32| point(u64::from(k) + 77, i).map(f64::from);
    let mut stage = Stage::default();
    for i in 0..120u32 {
        let ([x, y, z, w], [a, b, c, d]) = (numbers(i, 0), numbers(i, 1));
        // Clusters, pairs in one place and a few far away: nodes of every shape.
        let at = DVec3::new(x, y, z) * [0.01, 3.0, 200.0][i as usize % 3] + DVec3::splat(f64::from(i % 5));
        let direction = DVec3::new(a - 0.5, b - 0.5, c - 0.5).normalize_or(DVec3::X);
        let outer_angle_rad = (0.001 + d * d * 1.5) as f32;
        let intensity = Rgb::splat(10f32.powf(6.0 * w as f32 - 3.0));
        let kind = match i % 4 {
            0 => LightKind::Point { intensity },
            1 | 2 => LightKind::Spot { intensity, inner_angle_rad: 0.5 * outer_angle_rad, outer_angle_rad },
            _ => {
                let lamp = Material { double_sided: i % 8 == 3, ..Material::emitter(intensity) };
                let lamp = stage.material(&format!("lamp {i}"), lamp).unwrap();
                let turn = DQuat::from_rotation_arc(DVec3::NEG_Y, direction);
                let placed = DAffine3::from_scale_rotation_translation(DVec3::splat(0.01 + d), turn, at);
                stage.place(&format!("lamp {i}"), quad(LAMP, &lamp), placed).unwrap();
                continue;
            }
        };
        stage.light(&format!("light {i}"), Light { parent: None, position: at, direction, kind }).unwrap();
    }
    let world = World::prepare(Arc::new(stage.finish()));
    let (lights, accel) = (world.lights(), world.accel());
    let mut lit = 0;
    for i in 0..400u32 {
        let ([x, y, z, w], [a, b, c, d]) = (numbers(i, 2), numbers(i, 3));
        let mut p = accel.to_render(DVec3::new(x, y, z) * [4.0, 10.0, 220.0][i as usize % 3]);
        let mut n = DVec3::new(a - 0.5, b - 0.5, c - 0.5).normalize_or(DVec3::X).as_vec3();
        if i % 4 == 0 {
            // Within the cone of some spot, however narrow.
            let spots = lights.local.iter().filter_map(|light| match light {
                LocalLight::Spot { position, axis, .. } => Some((*position, *axis)),
                _ => None,
            });
            let (position, axis) = spots.clone().nth(i as usize / 4 % spots.count()).unwrap();
            (p, n) = (position + axis * (0.01 + 30.0 * w as f32), -axis + n * 0.9 * d as f32);
            n = n.normalize();
        }
        for (index, light) in lights.local.iter().enumerate() {
            let reaches = match light {
                LocalLight::Point { position, .. } => (*position - p).normalize().dot(n) > 1e-4,
                LocalLight::Spot { position, axis, cos_inner, cos_outer, .. } => {
                    let wi = (*position - p).normalize();
                    wi.dot(n) > 1e-4 && spot_falloff(-wi.dot(*axis), *cos_inner, *cos_outer) > 1e-4
                }
                LocalLight::Triangle { instance, triangle, two_sided, .. } => {
                    let placed = &accel.instances()[*instance as usize];
                    [[0.01, 0.01], [0.98, 0.01], [0.01, 0.98], [0.3, 0.3]].into_iter().any(|[b1, b2]| {
                        let on_light = placed.surface_point(*triangle, b1, b2);
                        let wi = (on_light.position - p).normalize();
                        let cos = -wi.dot(on_light.n_geo);
                        wi.dot(n) > 1e-3 && (cos > 1e-3 || *two_sided && cos < -1e-3)
                    })
                }
            };
            if reaches {
                lit += 1;
                assert!(lights.tree.probability(p, n, index as u32) > 0.0, "receiver {i}: {light:?}");
            }
        }
    }
    assert!(lit > 10_000, "too few pairs to test anything: {lit}");
}

/// The mean over draws of all lights together is the sum of the lights: no choice is left out of a density.
#[test]
fn a_mixture_of_all_kinds_of_light_adds_up() {
    let p = DVec3::new(0.1, -0.6, 0.2);
    let light = |kind, x: f64| Light {
        parent: None,
        position: DVec3::new(x, 2.0, 0.3),
        direction: DVec3::new(0.1 - x * 0.2, -1.0, 0.0),
        kind,
    };
    let kinds = [
        LightKind::Point { intensity: Rgb::splat(3.0) },
        LightKind::Spot { intensity: Rgb::splat(9.0), inner_angle_rad: 0.4, outer_angle_rad: 0.9 },
        LightKind::Directional { irradiance: Rgb::splat(0.8) },
        LightKind::Directional { irradiance: Rgb::splat(0.3) },
    ];
    let world_of = |only: Option<usize>| {
        // The lamp stands where it hides nothing from the others.
        let lamp = DAffine3::from_translation(DVec3::new(6.0, 4.0, 0.0));
        under_a_lamp(lamp, false, |stage| {
            for (index, kind) in
                kinds.iter().enumerate().filter(|(index, _)| only.is_none_or(|only| only == *index))
            {
                stage.light(&format!("light {index}"), light(*kind, index as f64 * 0.7 - 1.0)).unwrap();
            }
            if only.is_none_or(|only| only == kinds.len()) {
                stage.builder().set_environment(Environment::Constant(Rgb::splat(0.2))).unwrap();
            }
        })
    };
    let estimate = |world: &World, count| irradiance(world, &receiver(world, p, DVec3::Y), count);
    let all = estimate(&world_of(None), 200_000);
    let lamp = estimate(&world_of(Some(99)), 50_000);
    let each: Vec<RunningStatistics> =
        (0..=kinds.len()).map(|only| estimate(&world_of(Some(only)), 100_000)).collect();
    let sum: f64 = lamp.mean() + each.iter().map(|one| one.mean() - lamp.mean()).sum::<f64>();
    let variance: f64 = all.standard_error().powi(2)
        + each.iter().map(|one| one.standard_error().powi(2)).sum::<f64>()
        + 16.0 * lamp.standard_error().powi(2);
    assert!(
        (all.mean() - sum).abs() < 5.0 * variance.sqrt(),
        "{} for {sum} ± {}",
        all.mean(),
        variance.sqrt()
    );
}

/// 12 × 6 texels: dim, with a bright row, a bright column, a dark patch and a sun of a thousand.
fn sky(rotation_rad: f32) -> (Scene, Vec<[f32; 4]>) {
    let texels: Vec<[f32; 4]> = (0..72)
        .map(|i| {
            let (x, y) = (i % 12, i / 12);
            let value = match (x, y) {
                (3, 1) => 1000.0,
                (7..=8, 3) => 0.0,
                (_, 4) => 5.0,
                (5, _) => 9.0,
                _ => 0.5 + 0.1 * x as f32,
            };
            [value, value * 0.9, value * 0.8, 1.0]
        })
        .collect();
    let mut stage = Stage::default();
    let id = Id::new("sky").unwrap();
    let texture = Texture { width: 12, height: 6, texels: Texels::Rgba32F(texels.clone()) };
    stage.builder().add_texture(id.clone(), texture).unwrap();
    let environment = Environment::Image { texture: id, scale: Rgb::splat(2.0), rotation_rad };
    stage.builder().set_environment(environment).unwrap();
    (stage.finish(), texels)
}

/// The picture stands as documented: u from −Z over +X, v from +Y down, turned right-handed around +Y.
#[test]
fn environment_pictures_stand_as_documented() {
    let (scene, texels) = sky(0.0);
    let world = World::prepare(Arc::new(scene));
    let turned = World::prepare(Arc::new(sky(1.0).0));
    for (i, texel) in texels.iter().enumerate() {
        let (u, v) = ((i % 12) as f64 + 0.5, (i / 12) as f64 + 0.5);
        let (phi, theta) = (u / 12.0 * std::f64::consts::TAU, v / 6.0 * std::f64::consts::PI);
        // From −Z (phi = 0) towards +X.
        let wi = DVec3::new(theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos());
        assert_eq!(world.environment_radiance(wi.as_vec3()).g, texel[1] * 2.0, "texel {i}");
        let wi = DMat3::from_rotation_y(1.0) * wi;
        assert_eq!(turned.environment_radiance(wi.as_vec3()).g, texel[1] * 2.0, "texel {i}, turned");
    }
}

/// Directions are drawn as often as their density says, texel by texel (χ²), and the density integrates to one.
#[test]
fn environment_directions_follow_their_density() {
    for rotation_rad in [0.0, 0.7, -40.0] {
        let world = World::prepare(Arc::new(sky(rotation_rad).0));
        let at = receiver(&world, DVec3::ZERO, DVec3::Y);
        // Bins a third of a texel wide and high: what is wrong within a texel shows as well.
        const COLUMNS: usize = 36;
        const ROWS: usize = 18;
        let direction = |x: f64, y: f64| {
            let (phi, theta) =
                (x / COLUMNS as f64 * std::f64::consts::TAU, y / ROWS as f64 * std::f64::consts::PI);
            let turn = DMat3::from_rotation_y(f64::from(rotation_rad));
            (turn * DVec3::new(theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos())).as_vec3()
        };
        let bin_of = |wi: Vec3| {
            let back = DMat3::from_rotation_y(-f64::from(rotation_rad)) * wi.as_dvec3();
            let u = (back.x.atan2(-back.z) / std::f64::consts::TAU).rem_euclid(1.0);
            let v = back.y.clamp(-1.0, 1.0).acos() / std::f64::consts::PI;
            let [x, y] = [u * COLUMNS as f64, v * ROWS as f64].map(|at| at as usize);
            y.min(ROWS - 1) * COLUMNS + x.min(COLUMNS - 1)
        };
        let count = 200_000u32;
        let mut seen = vec![0.0; COLUMNS * ROWS];
        for i in 0..count {
            let [a, b, c, _] = point(u64::from(i) + 1, 0);
            let sample =
                world.lights().sample(world.accel(), at.position, at.n_geo, || None, [a, b, c]).unwrap();
            seen[bin_of(sample.wi)] += 1.0;
            let again = world.lights().pdf_of_environment(at.n_geo, None, sample.wi);
            assert!((again / sample.pdf - 1.0).abs() < 1e-5);
        }
        let (mut chi2, mut freedom, mut total) = (0.0, -1.0, 0.0);
        for (bin, seen) in seen.iter().enumerate() {
            const FINE: usize = 8;
            let (x, y) = ((bin % COLUMNS) as f64, (bin / COLUMNS) as f64);
            let mut share = 0.0;
            for i in 0..FINE * FINE {
                let (dx, dy) = ((i % FINE) as f64 + 0.5, (i / FINE) as f64 + 0.5);
                let wi = direction(x + dx / FINE as f64, y + dy / FINE as f64);
                let sin_theta = f64::from(wi.x).hypot(f64::from(wi.z));
                let cell_sr = std::f64::consts::TAU * std::f64::consts::PI * sin_theta
                    / (COLUMNS * ROWS * FINE * FINE) as f64;
                share += f64::from(world.lights().pdf_of_environment(at.n_geo, None, wi)) * cell_sr;
            }
            total += share;
            let expected = share * f64::from(count);
            if expected > 0.0 {
                chi2 += (seen - expected).powi(2) / expected;
                freedom += 1.0;
            } else {
                // Borders of dark texels are met by rounding only.
                assert!(*seen <= 2.0, "{seen} draws where nothing shines");
            }
        }
        assert!((total - 1.0).abs() < 1e-3, "density integrates to {total}");
        // χ² is near normal at 600 degrees of freedom: mean f, variance 2f.
        let z = (chi2 - freedom) / (2.0f64 * freedom).sqrt();
        assert!(z < 4.0, "rotation {rotation_rad}: χ² {chi2} at {freedom} degrees");
    }
}

/// The image's irradiance by light sampling is the one that adding up its texels gives.
#[test]
fn environment_pictures_light_surfaces_as_their_texels_add_up() {
    let (scene, texels) = sky(0.4);
    let world = World::prepare(Arc::new(scene));
    for n in [DVec3::Y, DVec3::X, DVec3::new(-0.3, -0.8, 0.5).normalize()] {
        const FINE: usize = 40;
        let (columns, rows) = (12 * FINE, 6 * FINE);
        let mut expected = 0.0;
        for i in 0..columns * rows {
            let (x, y) = (i % columns, i / columns);
            let phi = (x as f64 + 0.5) / columns as f64 * std::f64::consts::TAU;
            let theta = (y as f64 + 0.5) / rows as f64 * std::f64::consts::PI;
            let wi = DMat3::from_rotation_y(f64::from(0.4f32))
                * DVec3::new(theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos());
            let cell_sr =
                theta.sin() * std::f64::consts::TAU * std::f64::consts::PI / (columns * rows) as f64;
            expected += 2.0 * f64::from(texels[y / FINE * 12 + x / FINE][1]) * wi.dot(n).max(0.0) * cell_sr;
        }
        let got = irradiance(&world, &receiver(&world, DVec3::ZERO, n), 100_000);
        let off = (got.mean() - expected).abs();
        // The grid's own error is below 1e-3: its cells are 0.75 degrees wide.
        assert!(off < 5.0 * got.standard_error() + 1e-3 * expected, "{n}: {} for {expected}", got.mean());
    }
}
