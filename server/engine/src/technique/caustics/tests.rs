//! Laws of caustics: where focused flux ends up, how much of it, and that what is not there costs nothing.

mod panes;

use std::{
    f64::consts::PI,
    sync::{Arc, atomic::AtomicBool},
};

use glam::{DAffine3, DVec3, Vec3};

use super::*;
use crate::{
    accel::Ray,
    math::{Rgb, RunningStatistics},
    scene::{
        Id, Light, LightKind, Material, Scene, Texels, Texture, TextureRef, TextureSlot,
        samples::{self, Stage, cuboid, quad, sphere},
    },
    technique::{
        Counts, FocusedLight, Products,
        photons::{PhotonSettings, PhotonTracing},
    },
};

fn settings(photons_per_pass: u32) -> CausticSettings {
    CausticSettings { photons_per_pass, photons_max: 1 << 20, ..CausticSettings::of(1, None, 3) }
}

pub(super) fn world_of(scene: Scene) -> World {
    World::prepare(Arc::new(scene))
}

fn next_map(caustics: &mut Caustics, world: &World) -> Option<Arc<dyn FocusedLight>> {
    let mut products = Products::default();
    let cancel = AtomicBool::new(false);
    let mut step = Step { world, products: &mut products, canvas: None, cancel: &cancel };
    assert!(caustics.step(&mut step).complete);
    products.caustics
}

pub(super) fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

/// A white ceiling of 16 m at y = 4, a square of `half` m that faces up at y = 1, and a light at (`x`, 3, 0).
pub(super) fn stage_with_mirror(half: f64, mirror: Material, kind: LightKind, x: f64) -> Stage {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).unwrap();
    let mirror = stage.material("mirror", mirror).unwrap();
    let square = |h: f64, y: f64| [v(-h, y, h), v(h, y, h), v(h, y, -h), v(-h, y, -h)];
    stage.place("ceiling", quad(square(8.0, 4.0), &white), DAffine3::IDENTITY).unwrap();
    stage.place("mirror", quad(square(half, 1.0), &mirror), DAffine3::IDENTITY).unwrap();
    let light = Light { kind, parent: None, position: v(x, 3.0, 0.0), direction: DVec3::NEG_Y };
    stage.light("light", light).unwrap();
    stage
}

pub(super) fn clear_glass() -> Material {
    Material { transmission: 1.0, roughness: 0.0, ior: 1.5, base_color: Rgb::WHITE, ..Material::default() }
}

pub(super) fn mirror(reflectance: f32) -> Material {
    Material { base_color: Rgb::splat(reflectance), metallic: 1.0, roughness: 0.0, ..Material::default() }
}

pub(super) fn point(intensity: f32) -> LightKind {
    LightKind::Point { intensity: Rgb::splat(intensity) }
}

/// Radiance that the matt ceiling at `to` sends down of the caustics in `map`.
pub(super) fn seen_at(world: &World, map: &dyn FocusedLight, to: DVec3) -> f64 {
    let ray = Ray::new(world.accel().to_render(to - DVec3::Y), Vec3::Y);
    let surface = world.surface(&world.closest_hit(&ray).unwrap(), ray.direction);
    f64::from(map.scattered(&surface, -ray.direction, u32::MAX).diffuse.g)
}

/// A point light over a mirror lights the ceiling like a second one below the mirror: I · ρ · cos θ / d² · albedo / π.
#[test]
fn a_mirror_lights_the_ceiling_as_the_image_of_the_light_would() {
    let world = world_of(stage_with_mirror(2.0, mirror(0.9), point(5.0), 0.0).finish());
    let image = v(0.0, -1.0, 0.0);
    let expected = |to: DVec3| {
        let away = to - image;
        5.0 * 0.9 * (away.normalize().y / away.length_squared()) * 0.8 / PI
    };
    let mut caustics = Caustics::new(settings(40_000));
    let mut ratios = RunningStatistics::default();
    for _ in 0..16 {
        let map = next_map(&mut caustics, &world).unwrap();
        // Of the 10 m that are lit, the inner 8, in shares of what is expected there.
        let places = (0..400).map(|i| v(f64::from(i % 20) * 0.4 - 3.8, 4.0, f64::from(i / 20) * 0.4 - 3.8));
        let sum: f64 = places.map(|to| seen_at(&world, &*map, to) / expected(to)).sum();
        ratios.add(sum / 400.0);
        // Beyond what the mirror's edge sends there is nothing.
        assert_eq!(seen_at(&world, &*map, v(6.5, 4.0, 0.0)), 0.0);
    }
    assert!((ratios.mean() - 1.0).abs() < 0.01, "{}", ratios.mean());
    assert!(ratios.standard_error() < 0.005, "{}", ratios.standard_error());
}

/// Flux on all diffuse surfaces by way of glass and mirrors is that of blind photons, and of a glass ball over a floor it is
/// what Fresnel's equations and absorption leave.
#[test]
fn aimed_photons_bring_the_flux_of_blind_ones() {
    let world = world_of(samples::cornell_box().unwrap());
    let aimed: f64 =
        photons_of_a_pass(&world, &settings(2_000_000)).iter().map(|p| f64::from(p.flux_w.luminance())).sum();
    let mut tracing =
        PhotonTracing::new(PhotonSettings { emitted_count: 2_000_000, ..PhotonSettings::default() });
    tracing.trace_all(&world);
    let hits =
        tracing.paths().hits().filter(|(hit, _)| hit.class() == PathClass::Caustic && hit.is_on_diffuse());
    let blind: f64 = hits.map(|(_, flux)| f64::from(flux.luminance())).sum();
    assert!((aimed / blind - 1.0).abs() < 0.01, "{aimed} W for {blind} W");
}

/// A sphere of clear glass under the sun loses light by Fresnel reflection alone: of what the disc catches, the floor
/// gets what passes twice, straight from the sun's direction on average over the disc.
#[test]
fn a_glass_ball_lets_through_what_fresnel_says() {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).unwrap();
    let glass = stage.material("glass", clear_glass()).unwrap();
    let h = 40.0;
    let floor = [v(-h, -1.2, h), v(h, -1.2, h), v(h, -1.2, -h), v(-h, -1.2, -h)];
    stage.place("floor", quad(floor, &white), DAffine3::IDENTITY).unwrap();
    stage.place("ball", sphere(DVec3::ZERO, 1.0, 96, &glass), DAffine3::IDENTITY).unwrap();
    let sun = LightKind::Directional { irradiance: Rgb::splat(3.0) };
    let light = Light { kind: sun, parent: None, position: DVec3::ZERO, direction: DVec3::NEG_Y };
    stage.light("sun", light).unwrap();
    let world = world_of(stage.finish());
    // Photons that passed without further reflection inside come from above, through the ball: within its double shadow.
    let photons = photons_of_a_pass(&world, &settings(60_000_000));
    let through: f64 = photons
        .iter()
        .filter(|photon| photon.position.with_y(0.0).length() < 1.0)
        .map(|photon| f64::from(photon.flux_w.g))
        .sum();
    // ∫ (1 − F(θ))² over the disc; rays cross the floor 0.2 m below the ball within its radius, whatever their offset.
    let mut expected = 0.0;
    let rings = 20_000;
    for ring in 0..rings {
        let s = (f64::from(ring) + 0.5) / f64::from(rings);
        let (cos_i, cos_t) = ((1.0 - s * s).sqrt(), (1.0 - s * s / 2.25f64).sqrt());
        let parallel = (1.5 * cos_i - cos_t) / (1.5 * cos_i + cos_t);
        let perpendicular = (cos_i - 1.5 * cos_t) / (cos_i + 1.5 * cos_t);
        let passing = 1.0 - 0.5 * (parallel * parallel + perpendicular * perpendicular);
        expected += passing * passing * 2.0 * PI * s / f64::from(rings) * 3.0;
    }
    // Some of what was reflected inside falls there as well: below one percent of it.
    assert!(through > 0.99 * expected && through < 1.02 * expected, "{through} W for {expected} W");
}

/// The same photons whatever the threads.
#[test]
fn photons_are_the_same_whatever_the_threads() {
    let world = world_of(samples::cornell_box().unwrap());
    let of_threads = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| photons_of_a_pass(&world, &settings(50_000)))
    };
    let [one, three] = [1, 3].map(of_threads);
    assert!(!one.is_empty() && one == three);
}

/// A map is that of its pass, however often making it was cut short and whichever came before; even and odd passes share no
/// photon.
#[test]
fn a_map_depends_on_its_pass_alone() {
    let world = world_of(stage_with_mirror(2.0, mirror(0.9), point(5.0), 0.0).finish());
    let (never, always) = (AtomicBool::new(false), AtomicBool::new(true));
    let places: Vec<DVec3> =
        (0..200).map(|i| v(f64::from(i % 20) * 0.4 - 4.0, 4.0, f64::from(i / 20) * 0.8 - 4.0)).collect();
    let seen = |caustics: &Caustics| -> Vec<f64> {
        let map = caustics.map().unwrap();
        places.iter().map(|to| seen_at(&world, &*map, *to)).collect()
    };
    let mut whole = Caustics::new(settings(20_000));
    let whole: Vec<Vec<f64>> = (0..4)
        .map(|pass| {
            assert!(whole.prepare(&world, pass, &never).complete);
            seen(&whole)
        })
        .collect();
    let mut cut = Caustics::new(settings(20_000));
    for pass in 0..4 {
        for _ in 0..3 {
            assert!(!cut.prepare(&world, pass, &always).complete && cut.map().is_none());
        }
        assert!(cut.prepare(&world, pass, &never).complete);
        // It is there.
        assert_eq!(cut.prepare(&world, pass, &never).counts, Counts::default());
        assert_eq!(seen(&cut), whole[pass as usize], "pass {pass}");
    }
    assert!(whole.iter().flatten().any(|light| *light > 0.0));
    for pair in [[0, 1], [0, 2], [1, 2]] {
        assert_ne!(whole[pair[0]], whole[pair[1]]);
    }
}

/// However few photons a pass has, the mean over passes goes to the truth; also if the first pass had none.
#[test]
fn passes_of_a_photon_or_two_add_up() {
    let world = world_of(stage_with_mirror(0.4, mirror(0.9), point(5.0), 0.0).finish());
    let expected = 5.0 * 0.9 * (1.0 / 25.0) * 0.8 / PI;
    // Some hundredth of the light falls on the mirror.
    for photons_per_pass in [20, 200] {
        let mut caustics = Caustics::new(settings(photons_per_pass));
        let mut radiance = RunningStatistics::default();
        for pass in 0..20_000 {
            caustics.prepare(&world, pass, &AtomicBool::new(false));
            let at = |i: u32| v(f64::from(i % 3) * 0.4 - 0.4, 4.0, f64::from(i / 3) * 0.4 - 0.4);
            let map = caustics.map().unwrap();
            radiance.add((0..9).map(|i| seen_at(&world, &*map, at(i))).sum::<f64>() / 9.0);
        }
        let allowed = 4.0 * radiance.standard_error() + 0.03 * expected;
        let off = (radiance.mean() - expected).abs();
        assert!(
            off < allowed && allowed < 0.6 * expected,
            "{photons_per_pass}: {} ± {} for {expected}",
            radiance.mean(),
            radiance.standard_error()
        );
    }
}

/// Where a broad gloss loses next to nothing, photons are kept now and then and carry more: their flux is that of all hits,
/// and memory is bounded.
#[test]
fn photons_that_are_never_absorbed_are_kept_now_and_then() {
    let mut stage = Stage::default();
    let metal =
        Material { base_color: Rgb::splat(0.99), metallic: 1.0, roughness: 0.4, ..Material::default() };
    let metal = stage.material("metal", metal).unwrap();
    stage.place("room", cuboid(v(-2., -2., -2.), v(2., 2., 2.), &metal), DAffine3::IDENTITY).unwrap();
    let kind = point(1.0);
    let light = Light { kind, parent: None, position: v(0.3, 0.2, 0.1), direction: DVec3::NEG_Y };
    stage.light("light", light).unwrap();
    let world = world_of(stage.finish());
    let emitted = 20_000;
    let of =
        |bounces| CausticSettings { bounces_max: Some(bounces), photons_max: emitted, ..settings(emitted) };
    // Hits two to four of each photon, all of the first two kept.
    let flux = |photons: &[CausticPhoton], least: u16| -> f64 {
        let later = photons.iter().filter(|photon| photon.scatterings >= least);
        later.map(|photon| f64::from(photon.flux_w.g)).sum()
    };
    let few = photons_of_a_pass(&world, &of(12));
    let [early, late] = [1, 9].map(|least| {
        let photons: Vec<CausticPhoton> =
            few.iter().filter(|photon| (least..least + 3).contains(&photon.scatterings)).copied().collect();
        flux(&photons, least)
    });
    // GGX of this roughness loses some percent a time.
    assert!(late < early && late > 0.5 * early, "{early} W, later {late} W");
    let all = photons_of_a_pass(&world, &of(4096));
    assert!((all.len() as f64) < 12.0 * f64::from(emitted), "{} of {emitted}", all.len());
}

/// What counts may be bounded by how often it was scattered before.
#[test]
fn scatterings_are_bounded_at_the_look_up() {
    let world = world_of(stage_with_mirror(2.0, mirror(0.9), point(5.0), 0.0).finish());
    let map = next_map(&mut Caustics::new(settings(20_000)), &world).unwrap();
    let ray = Ray::new(world.accel().to_render(v(0.2, 3.0, 0.1)), Vec3::Y);
    let surface = world.surface(&world.closest_hit(&ray).unwrap(), ray.direction);
    let light = |most| map.scattered(&surface, -ray.direction, most).diffuse.g;
    assert!(light(0) == 0.0 && light(1) > 0.0 && light(1) == light(u32::MAX));
}

/// Without mirrors and glass, or light, nothing is traced and nothing held.
#[test]
fn what_is_not_there_costs_nothing() {
    for scene in [samples::boxes().unwrap(), samples::furnace(0.5, 1.0).unwrap(), Scene::default()] {
        let world = world_of(scene);
        let mut caustics = Caustics::new(settings(10_000));
        assert!(next_map(&mut caustics, &world).is_none());
        assert_eq!(caustics.report(), CausticReport::default());
    }
    // A lamp alone is no hidden light.
    let world = world_of(samples::cornell_box().unwrap());
    let mut caustics = Caustics::new(CausticSettings { light: CausticLight::Hidden, ..settings(10_000) });
    assert!(next_map(&mut caustics, &world).is_none());
    assert_eq!(caustics.report(), CausticReport::default());
}

/// Photons go with the solid angle of what they are aimed at: of a ball of half the width a quarter, each of the same flux.
#[test]
fn cost_is_in_proportion_to_the_light_that_is_caught() {
    let emitted = |half: f64| {
        let mut stage = stage_with_mirror(0.01, Material::lambert(Rgb::splat(0.5)), point(1.0), 0.0);
        let glass = Material { transmission: 1.0, roughness: 0.0, ..Material::default() };
        let glass = stage.material("glass", glass).unwrap();
        stage
            .place("ball", cuboid(v(-half, -half, -half), v(half, half, half), &glass), DAffine3::IDENTITY)
            .unwrap();
        let mut caustics = Caustics::new(settings(1_000_000));
        next_map(&mut caustics, &world_of(stage.finish()));
        caustics.report().photons_emitted as f64
    };
    let [large, small] = [0.2, 0.1].map(emitted);
    assert!((large / small / 4.0 - 1.0).abs() < 0.03, "{large} and {small}");
    // Of a sphere of √3 · 0.2 m three metres away: (1 − cos) / 2.
    let sin2: f64 = 3.0 * 0.04 / 9.0;
    let share = 0.5 * (1.0 - (1.0 - sin2).sqrt());
    assert!((large / (1e6 * share) - 1.0).abs() < 0.03, "{large} of 1,000,000, share {share}");
}

/// A point light in a room of one material.
fn room_of(material: Material, texture: Option<Texture>) -> Stage {
    let mut material = material;
    let mut stage = Stage::default();
    if let Some(texture) = texture {
        let id = Id::new("texture").unwrap();
        stage.builder().add_texture(id.clone(), texture).unwrap();
        material.textures[TextureSlot::MetallicRoughness as usize] = Some(TextureRef::new(id));
    }
    let material = stage.material("walls", material).unwrap();
    let room = cuboid(v(-1.0, -1.0, -1.0), v(1.0, 1.0, 1.0), &material);
    stage.place("room", room, DAffine3::IDENTITY).unwrap();
    let (position, direction) = (v(0.1, 0.2, 0.3), DVec3::NEG_Y);
    stage.light("light", Light { kind: point(1.0), parent: None, position, direction }).unwrap();
    stage
}

fn coat(roughness: f32) -> Material {
    Material { roughness, ..Material::default() }
}

/// What rough coats send on takes as many fewer photons as it is less than all, down to those of a sketch; the narrower the gloss is the
/// more, and what may focus light, as far as is known, takes all.
#[test]
fn rough_coats_take_few_photons() {
    let emitted = |material: Material, texture: Option<Texture>, photons: u32| {
        let mut caustics = Caustics::new(settings(photons));
        next_map(&mut caustics, &world_of(room_of(material, texture).finish()));
        caustics.report().photons_emitted as f64 / f64::from(photons)
    };
    let rough = Texture { width: 1, height: 1, texels: Texels::Rgba8(vec![[0, 255, 0, 255]]) };
    let of_coat: f64 = 0.04 + 0.96 / 21.0;
    for (what, material, texture, expected) in [
        ("glTF's default", coat(1.0), None, of_coat),
        ("half as strong", Material { specular: 0.5, ..coat(0.5) }, None, 0.5 * of_coat),
        // α = 0.175, half of the way.
        ("narrower", coat(0.175f32.sqrt()), None, of_coat.sqrt()),
        ("polished", coat(0.3), None, 1.0),
        ("with a picture", coat(1.0), Some(rough), 1.0),
        ("metal", Material { metallic: 1.0, ..coat(1.0) }, None, 1.0),
    ] {
        let found = emitted(material, texture, 400_000);
        assert!((found / expected - 1.0).abs() < 0.03, "{what}: {found} for {expected}");
    }
    let found = emitted(coat(1.0), None, 20_000) * 20_000.0;
    assert!((found / f64::from(SKETCH_PHOTONS) - 1.0).abs() < 0.03, "{found}");
    assert_eq!(emitted(coat(1.0), None, 5_000), emitted(coat(0.2), None, 5_000));
}

/// Few photons show of rough coats what many do, all over a floor: something polished that is too small to matter makes them many.
#[test]
fn few_photons_show_what_many_do() {
    const PASSES: u32 = 12;
    const SIDE: usize = 24;
    // Rows of a grid over the floor, and photons in all.
    let seen = |is_polished: bool| {
        let mut stage = room_of(coat(0.6), None);
        if is_polished {
            let polished = stage.material("polished", coat(0.1)).unwrap();
            let square = [v(-1e-4, 0.5, 1e-4), v(1e-4, 0.5, 1e-4), v(1e-4, 0.5, -1e-4), v(-1e-4, 0.5, -1e-4)];
            stage.place("tiny", quad(square, &polished), DAffine3::IDENTITY).unwrap();
        }
        let world = world_of(stage.finish());
        let mut caustics = Caustics::new(settings(150_000));
        let mut rows = [0.0; SIDE];
        for _ in 0..PASSES {
            let map = next_map(&mut caustics, &world).unwrap();
            for at in 0..SIDE * SIDE {
                let place = |at: usize| (at as f64 + 0.5) * 2.0 / SIDE as f64 - 1.0;
                let eye = v(place(at % SIDE), 0.0, place(at / SIDE));
                let ray = Ray::new(world.accel().to_render(eye), Vec3::NEG_Y);
                let surface = world.surface(&world.closest_hit(&ray).unwrap(), ray.direction);
                rows[at / SIDE] += f64::from(map.scattered(&surface, -ray.direction, u32::MAX).diffuse.g);
            }
        }
        (rows, caustics.report().photons_emitted)
    };
    let ((few, few_count), (many, many_count)) = (seen(false), seen(true));
    assert!(10 * few_count < many_count, "{few_count} and {many_count}");
    let sums = [few, many].map(|rows| rows.iter().sum::<f64>());
    assert!((sums[0] / sums[1] - 1.0).abs() < 0.02, "{sums:?}");
    for (few, many) in few.iter().zip(&many) {
        assert!((few / many - 1.0).abs() < 0.1, "{few} for {many}");
    }
}

/// Whatever photons there are, maps are finite and not negative: none, one, many in one place, on a line, of enormous and of
/// tiny flux, far from the origin.
#[test]
fn degenerate_photons_make_finite_maps() {
    let world = world_of(stage_with_mirror(2.0, mirror(0.9), point(1.0), 0.0).finish());
    let ray = Ray::new(world.accel().to_render(v(0.0, 2.0, 0.0)), Vec3::Y);
    let hit = world.closest_hit(&ray).unwrap();
    let surface = world.surface(&hit, ray.direction);
    let at = surface.point.position;
    let photon = |offset: Vec3, flux: f32| CausticPhoton {
        position: at + offset,
        radius_m: 0.0,
        flux_w: Rgb::splat(flux),
        direction: Vec3::NEG_Y,
        normal: Vec3::NEG_Y,
        sheet: Sheet::of(0, 0, Vec3::NEG_Y),
        scatterings: 1,
        is_on_back: false,
    };
    let line = |count: u32, flux: f32| (0..count).map(move |i| photon(Vec3::X * i as f32 * 0.01, flux));
    let cases: Vec<Vec<CausticPhoton>> = vec![
        vec![],
        vec![photon(Vec3::ZERO, 1.0)],
        vec![photon(Vec3::ZERO, 1.0); 1000],
        line(2, 1.0).collect(),
        line(300, 1e-30).collect(),
        line(300, 1e30).collect(),
        line(100, 1.0).chain(std::iter::once(photon(Vec3::Z * 1e6, 1.0))).collect(),
        vec![photon(Vec3::ZERO, 1.0); 500].into_iter().chain(line(2, 1.0)).collect(),
    ];
    for photons in cases {
        let pilot = Pilot::of(&photons, 0.01);
        for shrinking in [1.0, 1e-3] {
            let count = photons.len();
            let mut photons = photons.clone();
            pilot.blur(&mut photons, shrinking);
            borders::correct(&world, &mut photons, 0, 1);
            let map = CausticMap::of(photons, CausticLight::All);
            let light = map.scattered(&surface, -ray.direction, u32::MAX);
            assert!(light.diffuse.is_finite() && light.diffuse.is_non_negative(), "{count}: {light:?}");
        }
    }
}

/// Blurred or not, a map holds the flux of its photons: the mean irradiance over a plane is flux over area.
#[test]
fn blurs_keep_flux() {
    let world = world_of(stage_with_mirror(0.5, mirror(1.0), point(2.0), 0.2).finish());
    let of = settings(60_000);
    let flux: f64 = photons_of_a_pass(&world, &of).iter().map(|photon| f64::from(photon.flux_w.g)).sum();
    let map = next_map(&mut Caustics::new(of), &world).unwrap();
    let mut radiosity = 0.0;
    const SIDE: u32 = 200;
    for i in 0..SIDE * SIDE {
        let place = |index: u32| 16.0 * (f64::from(index) + 0.5) / f64::from(SIDE) - 8.0;
        radiosity += PI / 0.8 * seen_at(&world, &*map, v(place(i % SIDE), 4.0, place(i / SIDE)));
    }
    let measured = radiosity * (16.0 / f64::from(SIDE)).powi(2);
    assert!((measured / flux - 1.0).abs() < 0.01, "{measured} W for {flux} W");
}

/// Nor do blurs lose any over edges, or under what stands in the light: on a plate of a metre with a box on it, and on a strip of
/// it, narrower than blurs are wide, all flux is seen. Without mending, a ninth of the plate's is lost and more of the strip's.
#[test]
fn blurs_keep_flux_at_borders() {
    const SIDE: u32 = 60;
    const PASSES: u32 = 16;
    for (half_z, mirror_half, photons) in [(0.5, 2.0, 20_000), (0.05, 0.4, 300_000)] {
        let mut stage = Stage::default();
        let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).unwrap();
        let black = stage.material("black", Material::lambert(Rgb::BLACK)).unwrap();
        let metal = stage.material("mirror", mirror(1.0)).unwrap();
        let plate = |x: f64, y: f64, z: f64| [v(-x, y, z), v(x, y, z), v(x, y, -z), v(-x, y, -z)];
        stage.place("plate", quad(plate(0.5, 4.0, half_z), &white), DAffine3::IDENTITY).unwrap();
        let cube = cuboid(v(-0.1, 3.6, -0.1), v(0.1, 3.999, 0.1), &black);
        stage.place("box", cube, DAffine3::IDENTITY).unwrap();
        let square = quad(plate(mirror_half, 1.0, mirror_half), &metal);
        stage.place("mirror", square, DAffine3::IDENTITY).unwrap();
        let (position, direction) = (v(0.2, 3.0, 0.1), DVec3::NEG_Y);
        stage.light("light", Light { kind: point(2.0), parent: None, position, direction }).unwrap();
        let world = world_of(stage.finish());
        let mut caustics = Caustics::new(settings(photons));
        let mut seen = 0.0;
        for _ in 0..PASSES {
            let map = next_map(&mut caustics, &world).unwrap();
            for i in 0..SIDE * SIDE {
                let place = |index: u32| 2.0 * (f64::from(index) + 0.5) / f64::from(SIDE) - 1.0;
                let to = v(0.5 * place(i % SIDE), 4.0, half_z * place(i / SIDE));
                // What the box covers nobody sees.
                if to.x.abs() > 0.1 || to.z.abs() > 0.1 {
                    let ray = Ray::new(world.accel().to_render(to - DVec3::Y * 0.3), Vec3::Y);
                    let surface = world.surface(&world.closest_hit(&ray).unwrap(), ray.direction);
                    let light = map.scattered(&surface, -ray.direction, u32::MAX).diffuse.g;
                    seen += PI / 0.8 * f64::from(light) * 2.0 * half_z / f64::from(SIDE * SIDE);
                }
            }
        }
        let photons = photons_of_a_pass(&world, &settings(20 * photons));
        let top_m = world.accel().to_render(DVec3::Y * 3.8).y;
        let on_plate = photons.iter().filter(|photon| photon.normal.y < -0.9 && photon.position.y > top_m);
        let flux = f64::from(PASSES) * on_plate.map(|photon| f64::from(photon.flux_w.g)).sum::<f64>();
        assert!((seen / flux - 1.0).abs() < 0.03, "±{half_z}: {seen} W for {flux} W");
    }
}

/// What is made up for is 1 over the share of the blur on the surface, whatever way its triangles turn: within, at an edge, at a
/// corner, and where the plate goes on in another thing that turns the other way.
#[test]
fn photons_at_borders_carry_what_the_rest_of_their_blurs_would() {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).unwrap();
    let corners = [v(-1.0, 0.0, 1.0), v(1.0, 0.0, 1.0), v(1.0, 0.0, -1.0), v(-1.0, 0.0, -1.0)];
    let mut half_turned = quad(corners, &white);
    half_turned.triangles[1].reverse();
    stage.place("plate", half_turned, DAffine3::IDENTITY).unwrap();
    let mut turned = corners.map(|corner| corner - v(2.0, 0.0, 0.0));
    turned.reverse();
    stage.place("next", quad(turned, &white), DAffine3::IDENTITY).unwrap();
    let world = world_of(stage.finish());
    for (x, z, share) in
        [(0.0, 0.0, 1.0), (1.0, 0.0, 0.5), (1.0, 1.0, 0.25), (-1.0, 0.0, 1.0), (-1.0, 1.0, 0.5)]
    {
        let ray = Ray::new(world.accel().to_render(v(x * 0.9999, 1.0, z * 0.9999)), Vec3::NEG_Y);
        let hit = world.closest_hit(&ray).unwrap();
        let surface = world.surface(&hit, ray.direction);
        let photon = CausticPhoton {
            position: surface.point.position,
            radius_m: 0.1,
            flux_w: Rgb::WHITE,
            direction: Vec3::Y,
            normal: Vec3::Y,
            sheet: Sheet::of(hit.instance, 0, Vec3::Y),
            scatterings: 1,
            is_on_back: surface.point.n_geo.y < 0.0,
        };
        let mut photons = vec![photon; 20_000];
        borders::correct(&world, &mut photons, 0, 9);
        let mut flux = RunningStatistics::default();
        photons.iter().for_each(|photon| flux.add(f64::from(photon.flux_w.g)));
        let off = (flux.mean() * share - 1.0).abs();
        assert!(
            off < 5.0 * share * flux.standard_error() + 2e-3,
            "at {x}, {z}: {} for {}",
            flux.mean(),
            1.0 / share
        );
    }
}
