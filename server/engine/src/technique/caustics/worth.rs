//! What photons of a light are aimed at, and how often: more at what sends them on to where the camera sees them.
//!
//! Of photons aimed at everything that shines most may fall where nobody looks: those for the ground around a house on its walls, and few come
//! through its windows. Some are tried for every sphere. What counts for the noise of a picture is the root of the share that is seen
//! [Neyman1934]: a sphere of which one photon in a hundred is gets a tenth of those that one of the same size gets where all are. Half
//! goes by flux, since few tries miss what is rare, and mirrors and glass show what is not seen straight; where the other half is spent
//! otherwise there are as many more, so that nothing gets less than half of what it would by flux alone, and what is seldom seen hardly less. And where
//! what is seen is lit by them and hardly straight by anything, such as a room by the sun through panes, there are as many as there may be,
//! however little of all light that is. First maps that somebody waits for go without ([`CausticSettings::passes_by_flux`]).

use glam::Vec3;
use rayon::prelude::*;

use super::{
    AimedLight, CausticSettings,
    photons::{self, CausticTracer, emission_of, facing, focused_into, is_shown_on},
};
use crate::{
    accel::Ray,
    math::sobol,
    technique::View,
    transport::{Aim, Source, Sphere, World},
};

/// Photons that are tried for all spheres of all lights, and for one sphere of one light at least; where there are more spheres than that allows
/// all count alike.
const TRIES_OF_ALL: usize = 1 << 11;
const TRIES_LEAST: usize = 16;
/// Surfaces that a tried photon reaches at most: between mirrors it would go on for a thousand. Where most reach half as many, more photons than flux
/// asks for would take too long.
const BOUNCES_TRIED: u32 = 16;
/// Photons of all lights that are tried for what they light straight, and of one light at least; where there are more lights, that counts as all.
const STRAIGHT_OF_ALL: usize = 1 << 9;
const STRAIGHT_LEAST: usize = 8;
/// Tries of which nothing was seen may have missed so much of one.
const STRAIGHT_MISSED: f64 = 1.0 / 16.0;
/// Least weight of a sphere: none is left out.
const WEIGHT_LEAST: f32 = 1e-6;
/// What a ray from the eye meets so close to a photon, in shares of its length, is where the photon lies.
const NEAR: f32 = 0.01;

/// What came of weighing.
pub(super) struct Weighed {
    /// That it took.
    pub(super) rays: u64,
    /// Photons go elsewhere than by flux alone.
    pub(super) is_changed: bool,
}

/// Weighs the spheres that lights are aimed at by what is seen of them, and shares the photons of a pass out to the lights: no more than
/// [`CausticSettings::photons_end`].
///
/// - `lights`: aimed at the same spheres each, with as many photons as their flux there asks for
pub(super) fn weigh(world: &World, settings: &CausticSettings, lights: &mut [AimedLight]) -> Weighed {
    let pairs = lights.iter().map(|light| light.aim.spheres.len()).sum::<usize>();
    let tries = TRIES_OF_ALL / pairs.max(1);
    let Some(view) = settings.seen_by.filter(|_| tries >= TRIES_LEAST) else {
        return Weighed { rays: 0, is_changed: false };
    };
    let bounces_max = settings.bounces_max.map_or(BOUNCES_TRIED, |bounces| bounces.min(BOUNCES_TRIED));
    let of_tries = CausticSettings { bounces_max: Some(bounces_max), ..*settings };
    let tracer = CausticTracer { world, settings: &of_tries };
    let tries_of = |light: &AimedLight| -> Vec<Tried> {
        let spheres = (0..light.aim.spheres.len()).into_par_iter();
        spheres.map(|sphere| Tried::of(&tracer, &view, (light, sphere), tries)).collect()
    };
    let tried: Vec<Vec<Tried>> = lights.par_iter().map(tries_of).collect();
    let rays = tried.iter().flatten().map(|tried| tried.rays).sum::<u64>();
    let seen: f64 = tried.iter().flatten().map(Tried::wanted).sum();
    let count: f64 = lights.iter().map(|light| light.photon_count).sum();
    let followed = |which: usize| tried.iter().flatten().map(|tried| tried.followed[which]).sum::<u64>();
    let is_to_and_fro = followed(1) > followed(0) * u64::from(BOUNCES_TRIED / 2);
    if is_to_and_fro || !(seen > 0.0 && seen.is_finite() && count > 0.0) {
        return Weighed { rays, is_changed: false };
    }
    // Photons for every sphere, by flux and by what is seen.
    let wanted_of = |(light, tried): (&AimedLight, &Vec<Tried>)| -> Vec<[f64; 2]> {
        let flux_w = tried.iter().map(|tried| tried.flux_w).sum::<f64>().max(f64::MIN_POSITIVE);
        let each = tried.iter();
        each.map(|tried| [light.photon_count * tried.flux_w / flux_w, count * tried.wanted() / seen])
            .collect()
    };
    let wanted: Vec<Vec<[f64; 2]>> = lights.iter().zip(&tried).map(wanted_of).collect();
    let otherwise: f64 = wanted.iter().flatten().map(|[flux, seen]| (seen - flux).max(0.0)).sum();
    let seen_w: f64 = tried.iter().flatten().map(|tried| tried.flux_w * tried.seen).sum();
    let (straight_w, straight_rays) = seen_straight_w(world, &view, settings.seed);
    let lit_so = seen_w / (seen_w + straight_w);
    let many = f64::from(settings.photons_max) * f64::from(world.sent_on_share());
    let more = (lit_so * many / count).max(1.0);
    let share = 0.5 * (1.0 + (otherwise / count).min(1.0));
    let all: f64 = wanted.iter().flatten().map(|[flux, seen]| share * (flux + more * seen)).sum();
    let share = share * (f64::from(settings.photons_end()) / all).min(1.0);
    for ((light, tried), wanted) in lights.iter_mut().zip(&tried).zip(&wanted) {
        let counts = || wanted.iter().map(|[flux, seen]| share * (flux + more * seen));
        // Photons for as much flux.
        let densities = || counts().zip(tried).map(|(count, tried)| count / tried.flux_w);
        let known = || densities().filter(|density| density.is_finite());
        let most = known().fold(0.0, f64::max);
        let least = known().fold(most, f64::min);
        if most > 0.0 {
            light.photon_count = counts().sum();
            light.aim.spheres.iter_mut().zip(densities()).for_each(|(sphere, density)| {
                // What no try found a way to may yet be lit.
                let density = if density.is_finite() { density } else { least };
                sphere.weight = ((density / most) as f32).max(WEIGHT_LEAST);
            });
        }
    }
    Weighed { rays: rays + straight_rays, is_changed: true }
}

/// What came of photons aimed at one sphere.
struct Tried {
    /// Luminance of the flux that the light sends there, W.
    flux_w: f64,
    /// Share of it that arrives where it is seen, as far as the sphere is to be thanked for it.
    seen: f64,
    rays: u64,
    /// How many were followed, and over how many surfaces.
    followed: [u64; 2],
}

impl Tried {
    /// - `sphere`: which of those that the light is aimed at
    fn of(
        tracer: &CausticTracer<'_>,
        view: &View,
        (light, sphere): (&AimedLight, usize),
        tries: usize,
    ) -> Tried {
        let aimed_at = light.aim.spheres[sphere];
        let alone = Aim { spheres: vec![aimed_at] };
        let key = key_of_tries(light.key);
        let (mut flux_w, mut seen_w, mut seen_rays, mut followed) = (0.0, 0.0, 0, [0, 0]);
        let mut photons = Vec::new();
        for number in 0..tries as u32 {
            let Some(emitted) = tracer.world.emit_at(&light.source, &alone, &emission_of(key, number)) else {
                continue;
            };
            // Those that are sent anywhere tell nothing of it.
            if !aimed_at.is_met_by(&emitted.ray) {
                continue;
            }
            let set_out_w = f64::from(emitted.flux_w.luminance());
            photons.clear();
            let surfaces = tracer.follow(&light.source, emitted, (key, number), focused_into(&mut photons));
            followed = [followed[0] + 1, followed[1] + surfaces];
            let seen = photons.iter().filter(|photon| {
                seen_rays += 1;
                is_seen(tracer.world, view, (photon.position, photon.normal))
            });
            let of_photon_w: f64 = seen.map(|photon| f64::from(photon.flux_w.luminance())).sum();
            flux_w += set_out_w;
            // What lands on several things counts once.
            seen_w += share_of(sphere, &light.aim, &emitted.ray) * of_photon_w.min(set_out_w);
        }
        let seen = if flux_w > 0.0 { seen_w / flux_w } else { 0.0 };
        Tried { flux_w: flux_w / tries as f64, seen, rays: followed[1] + seen_rays, followed }
    }

    /// Photons that there should be for what is seen, over those of others.
    fn wanted(&self) -> f64 {
        self.flux_w * self.seen.sqrt()
    }
}

/// Names the numbers of tries: what they say is not to depend on the photons that it is for.
fn key_of_tries(key: u64) -> u64 {
    sobol::mix(key) << 1
}

/// Luminance of the flux that falls straight from lights on what is seen and shows it, W, with the rays that took; infinite where there are too
/// many lights.
fn seen_straight_w(world: &World, view: &View, seed: u64) -> (f64, u64) {
    let sources = world.sources();
    let tries = STRAIGHT_OF_ALL / sources.len().max(1);
    if tries < STRAIGHT_LEAST {
        return (f64::INFINITY, 0);
    }
    let of = |source: &Source| {
        let key = key_of_tries(photons::key_of(seed, source.name()));
        let lit_w = |number: u32| {
            let emitted = world.emit(source, &emission_of(key, number))?;
            let hit = world.closest_hit(&emitted.ray)?;
            let surface = world.surface(&hit, emitted.ray.direction);
            let lit = (surface.point.position, facing(&surface, -emitted.ray.direction));
            let is_shown = is_shown_on(&surface) && is_seen(world, view, lit);
            is_shown.then(|| f64::from(emitted.weight.luminance()) * source.power_w())
        };
        let lit_w: f64 = (0..tries as u32).filter_map(lit_w).sum();
        lit_w.max(STRAIGHT_MISSED * source.power_w()) / tries as f64
    };
    // In order: the sum does not depend on the threads.
    let of_each: Vec<f64> = sources.par_iter().map(of).collect();
    (of_each.iter().sum(), 2 * (tries * sources.len()) as u64)
}

/// Share of a photon that is owed to one of the spheres that it meets, by how densely each alone would send photons there, about: what comes
/// through a pane of a house is owed to the pane, not to the house.
fn share_of(sphere: usize, aim: &Aim, ray: &Ray) -> f64 {
    let density = |sphere: &Sphere| {
        let r2 = sphere.radius_m * sphere.radius_m;
        f64::from(ray.origin.distance_squared(sphere.middle).max(r2) / r2)
    };
    let others =
        aim.spheres.iter().enumerate().filter(|(index, other)| *index != sphere && other.is_met_by(ray));
    let own = density(&aim.spheres[sphere]);
    own / (own + others.map(|(_, other)| density(other)).sum::<f64>())
}

/// Whether a point shows in a picture on the side of its normal, looked at straight.
fn is_seen(world: &World, view: &View, (p, normal): (Vec3, Vec3)) -> bool {
    let Some([x, y]) = view.project(p).filter(|at| view.holds(*at)) else { return false };
    let ray = view.ray(x, y);
    if ray.direction.dot(normal) >= 0.0 {
        return false;
    }
    let met = world.closest_hit(&ray).map(|hit| (ray.origin + ray.direction * hit.t, hit.t));
    met.is_some_and(|(met, t)| met.distance(p) <= NEAR * t)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use glam::{DAffine3, DVec3};

    use super::{
        super::{
            CausticLight, Caustics, Emission, photons_of_a_pass,
            tests::{clear_glass, world_of},
        },
        *,
    };
    use crate::{
        film::PictureSize,
        math::Rgb,
        scene::{
            CameraView, Light, LightKind, Material,
            samples::{Stage, cuboid, quad},
        },
    };

    /// A room 4 m wide under the sun, with clear glass in its ceiling, on much ground of varnished wood; and a camera in the room.
    ///
    /// - `lean_m`: by so much the glass is higher on one side
    fn room_under_glass(lean_m: f64) -> (World, View) {
        let v = DVec3::new;
        let mut stage = Stage::default();
        let white = stage.material("white", Material::lambert(Rgb::splat(0.8))).unwrap();
        let varnish = Material { roughness: 0.2, base_color: Rgb::splat(0.3), ..Material::default() };
        let varnish = stage.material("varnish", varnish).unwrap();
        let glass = stage.material("glass", clear_glass()).unwrap();
        let square = |h: f64, y: f64| [v(-h, y, h), v(h, y, h), v(h, y, -h), v(-h, y, -h)];
        stage.place("ground", quad(square(50.0, -0.1), &varnish), DAffine3::IDENTITY).unwrap();
        stage.place("floor", quad(square(2.0, 0.0), &white), DAffine3::IDENTITY).unwrap();
        let walls = [
            ([-2.1, -2.1], [-2.0, 2.1]),
            ([2.0, -2.1], [2.1, 2.1]),
            ([-2.0, -2.1], [2.0, -2.0]),
            ([-2.0, 2.0], [2.0, 2.1]),
        ];
        let roof = [
            ([-2.1, -2.1], [-0.5, 2.1]),
            ([0.5, -2.1], [2.1, 2.1]),
            ([-0.5, -2.1], [0.5, -0.5]),
            ([-0.5, 0.5], [0.5, 2.1]),
        ];
        let parts = [(walls, [0.0, 3.0]), (roof, [3.0, 3.1])];
        for (kind, (boxes, [low, high])) in parts.into_iter().enumerate() {
            for (place, ([x, z], [x2, z2])) in boxes.into_iter().enumerate() {
                let mesh = cuboid(v(x, low, z), v(x2, high, z2), &white);
                stage.place(&format!("part {kind} {place}"), mesh, DAffine3::IDENTITY).unwrap();
            }
        }
        let mut leaning = cuboid(v(-0.5, 3.02, -0.5), v(0.5, 3.03, 0.5), &glass);
        leaning.positions.iter_mut().filter(|p| p.y > 3.025 && p.x > 0.0).for_each(|p| p.y += lean_m);
        stage.place("glass", leaning, DAffine3::IDENTITY).unwrap();
        let kind = LightKind::Directional { irradiance: Rgb::splat(5.0) };
        let sun =
            Light { kind, parent: None, position: DVec3::ZERO, direction: v(0.2, -1.0, 0.1).normalize() };
        stage.light("sun", sun).unwrap();
        let world = world_of(stage.finish());
        let camera = CameraView::look_at(v(-1.5, 2.0, 1.5), v(0.3, 0.0, 0.0), DVec3::Y, 1.3);
        let view = View::new(&world, &camera, PictureSize::new(64, 64).unwrap());
        (world, view)
    }

    /// What lights the floor of a room through a wedge of glass gets most of the photons that are to be seen, and as much light as before.
    #[test]
    fn photons_go_where_they_are_seen() {
        let (world, view) = room_under_glass(0.04);
        let of = CausticSettings { photons_max: 8_192, ..CausticSettings::of(1 << 14, None, 3) };
        let on_floor = |settings: &CausticSettings| {
            let photons = photons_of_a_pass(&world, settings);
            let inside = photons.iter().filter(|photon| {
                let at = photon.position.as_dvec3() + world.accel().origin_in_world();
                at.y.abs() < 1e-3 && at.x.abs() < 2.0 && at.z.abs() < 2.0
            });
            let fluxes: Vec<f64> = inside.map(|photon| f64::from(photon.flux_w.g)).collect();
            (fluxes.len(), fluxes.iter().sum::<f64>())
        };
        for light in [CausticLight::All, CausticLight::Hidden] {
            let of = CausticSettings { light, ..of };
            let seen = CausticSettings { seen_by: Some(view), ..of };
            let (count, flux_w) = on_floor(&of);
            let (seen_count, seen_flux_w) = on_floor(&seen);
            assert!(seen_count > 8 * count && seen_count > 400, "{light:?}: {seen_count} for {count}");
            // By so many more blindly that they tell.
            let many = CausticSettings { photons_per_pass: u32::MAX, photons_max: 1 << 22, ..of };
            let (_, true_flux_w) = on_floor(&many);
            assert!(
                (seen_flux_w / true_flux_w - 1.0).abs() < 0.03,
                "{light:?}: {seen_flux_w} W for {true_flux_w}, {flux_w} blindly"
            );
        }
    }

    /// There are no more photons than there may be, no sphere gets less than half of what it would by its flux, hardly less what is seldom seen, and where
    /// nobody looks nothing changes.
    #[test]
    fn no_sphere_goes_without_photons() {
        let (world, view) = room_under_glass(0.0);
        let of = CausticSettings { photons_max: 8_192, ..CausticSettings::of(1 << 14, None, 3) };
        let photons_of = |emission: &Emission| -> Vec<f64> {
            let light = &emission.lights[0];
            // For light from infinitely far by area.
            let sizes = light
                .aim
                .spheres
                .iter()
                .map(|sphere| f64::from(sphere.radius_m * sphere.radius_m * sphere.weight));
            let all: f64 = sizes.clone().sum();
            sizes.map(|size| light.photon_count * size / all).collect()
        };
        let blind = Emission::of(&world, &of);
        assert!(blind.lights[0].aim.spheres.iter().all(|sphere| sphere.weight == 1.0));
        let seen = Emission::of(&world, &CausticSettings { seen_by: Some(view), ..of });
        assert!(seen.lights[0].photon_count <= f64::from(of.photons_end()) * (1.0 + 1e-9));
        for (blind, seen) in photons_of(&blind).into_iter().zip(photons_of(&seen)) {
            assert!(seen > 0.9 * blind, "{seen} for {blind}");
        }
    }

    /// First passes that are waited for take no tries; those after them are as if there had been none.
    #[test]
    fn what_is_seen_counts_from_the_second_pass_on_where_the_first_is_waited_for() {
        // What comes straight through a pane is not looked up.
        let (world, view) = room_under_glass(0.04);
        let by_flux = CausticSettings { photons_max: 8_192, ..CausticSettings::of(1 << 14, None, 3) };
        let seen = CausticSettings { seen_by: Some(view), ..by_flux };
        let maps = |settings: CausticSettings, passes: &[u32]| -> Vec<Vec<f32>> {
            let mut caustics = Caustics::new(settings);
            let map_of = |&pass: &u32| {
                assert!(caustics.prepare(&world, pass, &AtomicBool::new(false)).complete);
                let map = caustics.map().unwrap();
                let of_floor = |i: u32| {
                    let from =
                        DVec3::new(f64::from(i % 16) * 0.24 - 1.8, 0.5, f64::from(i / 16) * 0.24 - 1.8);
                    let ray = Ray::new(world.accel().to_render(from), Vec3::NEG_Y);
                    let floor = world.surface(&world.closest_hit(&ray).unwrap(), ray.direction);
                    map.scattered(&floor, Vec3::Y, u32::MAX).diffuse.g
                };
                (0..256).map(of_floor).collect()
            };
            passes.iter().map(map_of).collect()
        };
        let [blind, weighed] = [by_flux, seen].map(|settings| maps(settings, &[0]).remove(0));
        let waited_for = maps(CausticSettings { passes_by_flux: 1, ..seen }, &[0, 1, 2]);
        assert!(waited_for[0] == blind && blind != weighed);
        assert!(waited_for[1..] == maps(seen, &[1, 2]));
        assert!(waited_for[1].iter().any(|light| *light > 0.0));
        // What the first has shown is taken back once, where those after it show more.
        let taken_back = |settings: CausticSettings| -> Vec<bool> {
            let mut caustics = Caustics::new(settings);
            let after = |pass: u32| {
                // Cut short first: what was found out by then stays.
                for cancelled in [true, false] {
                    caustics.prepare(&world, pass, &AtomicBool::new(cancelled));
                }
                caustics.takes_back()
            };
            (0..3).map(after).collect()
        };
        assert_eq!(taken_back(CausticSettings { passes_by_flux: 1, ..seen }), [false, true, false]);
        for settings in [seen, by_flux, CausticSettings { passes_by_flux: 1, ..by_flux }] {
            assert_eq!(taken_back(settings), [false; 3]);
        }
    }
}
