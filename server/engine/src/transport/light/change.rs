//! How much otherwise the lights of a scene shine after an edit.

use std::collections::HashMap;

use super::{EmissionNumbers, EmittedPhoton, Source, SourceName};
use crate::{
    math::{Rgb, sobol},
    transport::World,
};

/// Photons of a light that are compared: shares are known to a tenth, in 20 µs.
const PHOTONS: u32 = 64;
/// Of fewer that meet anything nothing is known.
const MET_MIN: u32 = 8;
/// Share of the brightest channel's flux from which on another one counts.
const COUNTS: f64 = 0.1;
/// Lights that are compared, since an edit is not to wait for thousands: where more have changed, all may be otherwise.
const LIGHTS_MAX: usize = 16;
/// Names the photons' random numbers.
const KEY: u64 = 0x6c69_6768;

/// The least and the greatest of what lights have become brighter by, over each other, that pass for the same: what rounding leaves.
const ALIKE: f32 = 1e-3;

/// How the lights shine after an edit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LightsChange {
    /// All lights of before times this, by channel; 1 unless all have changed alike.
    pub(crate) dimmed: Rgb,
    /// How much otherwise they shine beside that; see [`change_of_lights`].
    pub(crate) share: f32,
}

impl LightsChange {
    /// Lights that stay.
    pub(crate) const NONE: LightsChange = LightsChange { dimmed: Rgb::WHITE, share: 0.0 };
    /// Other lights.
    const ALL: LightsChange = LightsChange { dimmed: Rgb::WHITE, share: 1.0 };

    /// This change and another after it. How much otherwise lights shine beside what all have changed alike is that of the greater: what follows
    /// small steps is behind by few of them.
    pub(crate) fn then(self, later: LightsChange) -> LightsChange {
        let dimmed = self.dimmed * later.dimmed;
        // Beyond what numbers hold nothing is known of the light.
        if dimmed.is_finite() {
            LightsChange { dimmed, share: self.share.max(later.share) }
        } else {
            LightsChange::ALL
        }
    }
}

/// Where all lights have become brighter, darker or of another colour alike, by how much; and beside that the share of a light's flux that
/// falls elsewhere after an edit, or in another colour, or comes or goes by it: that of the light and of the channel for which it
/// is most, since a red light that turns white is none that what is known of red says much of. 0: all shine as before; 1: one was taken away, or shines on other things, or nothing is known of it.
///
/// The same photons set out in both scenes. Where they fall counts as elsewhere by how far that is from where they fell, over the
/// length of their way: so a lamp that moves by a hundredth of a room counts as little in a doll's house as in a hall.
pub(crate) fn change_of_lights(before: &World, after: &World) -> LightsChange {
    let (old, new) = (before.sources(), after.sources());
    if new.is_empty() {
        // A light that sends out nothing is none.
        let dimmed = if old.is_empty() { Rgb::WHITE } else { Rgb::BLACK };
        return LightsChange { dimmed, share: 0.0 };
    }
    let by_name: HashMap<&SourceName, &Source> = old.iter().map(|source| (source.name(), source)).collect();
    let stays = |source: &Source| by_name.contains_key(source.name());
    if old.len() != new.len() || !new.iter().all(stays) {
        return LightsChange::ALL;
    }
    let pair = |source| Some((*by_name.get(Source::name(source))?, source));
    let changed: Vec<(&Source, &Source)> =
        new.iter().filter_map(pair).filter(|(a, b)| !a.shines_like(b)).collect();
    if changed.len() > LIGHTS_MAX {
        return LightsChange::ALL;
    }
    let all_change = changed.len() == new.len();
    let dimmed = all_change.then(|| common_dimming(before, after, &changed)).flatten().unwrap_or(Rgb::WHITE);
    let share_of = |(a, b): &(&Source, &Source)| change_of((before, *a), (after, *b), dimmed);
    LightsChange { dimmed, share: changed.iter().map(share_of).fold(0.0, f32::max) }
}

/// The numbers of one of the photons that are compared.
fn numbers_of(number: u32) -> EmissionNumbers {
    let [u, v, s, t] = sobol::point(KEY, number);
    let [side, ..] = sobol::point(KEY + 1, number);
    EmissionNumbers { direction: [u, v], position: [s, t], side }
}

/// By how much each of some lights sends out more or less, if it is the same of all, and all are aimed as before.
fn common_dimming(before: &World, after: &World, changed: &[(&Source, &Source)]) -> Option<Rgb> {
    if !changed.iter().all(|(a, b)| a.aims_like(b)) {
        return None;
    }
    let sent_w = |world: &World, source: &Source| {
        let weights = (0..PHOTONS).filter_map(|number| Some(world.emit(source, &numbers_of(number))?.weight));
        weights.fold(Rgb::BLACK, |sum, weight| sum + weight) * source.power_w() as f32
    };
    let ratios: Vec<Rgb> =
        changed.iter().map(|(a, b)| ratio_of(sent_w(after, b), sent_w(before, a))).collect::<Option<_>>()?;
    let first = *ratios.first()?;
    let is_alike = |ratio: &Rgb| (0..3).all(|k| (ratio[k] - first[k]).abs() <= ALIKE * first[k]);
    ratios.iter().all(is_alike).then_some(first)
}

/// `now` over `before`, by channel; `None` where light comes out of nothing.
fn ratio_of(now: Rgb, before: Rgb) -> Option<Rgb> {
    let of = |k: usize| if now[k] == 0.0 { 0.0 } else { now[k] / before[k] };
    let ratio = Rgb::new(of(0), of(1), of(2));
    ratio.is_finite().then_some(ratio)
}

/// Share of one light's flux; of what meets nothing in either scene nothing is seen, and none of it counts.
///
/// - `dimmed`: what it sent out before counts times this
fn change_of((before, old): (&World, &Source), (after, new): (&World, &Source), dimmed: Rgb) -> f32 {
    let moved = (after.accel().origin_in_world() - before.accel().origin_in_world()).as_vec3();
    let (mut met, mut all, mut otherwise) = (0, [0.0; 3], [0.0; 3]);
    for number in 0..PHOTONS {
        let numbers = numbers_of(number);
        let fall = |world: &World, source: &Source, times: Rgb| {
            let EmittedPhoton { ray, weight } = world.emit(source, &numbers)?;
            let weight = weight * times;
            let hit = world.closest_hit(&ray)?;
            let way_m = hit.t * ray.direction.length();
            let flux_w = [weight.r, weight.g, weight.b].map(|share| f64::from(share) * source.power_w());
            Some((ray.origin + ray.direction * hit.t, way_m, flux_w))
        };
        let (was, is) = (fall(before, old, dimmed), fall(after, new, Rgb::WHITE));
        let nothing = [0.0; 3];
        let away = match (was, is) {
            (None, None) => continue,
            (Some((p, way_m, _)), Some((q, other_way_m, _))) => {
                let away = p.distance(q + moved) / way_m.min(other_way_m).max(f32::MIN_POSITIVE);
                f64::from(away.min(1.0))
            }
            _ => 1.0,
        };
        met += 1;
        let [was, is] = [was, is].map(|fall| fall.map_or(nothing, |(.., flux_w)| flux_w));
        for channel in 0..3 {
            let (was, is) = (was[channel], is[channel]);
            all[channel] += was.max(is);
            otherwise[channel] += away * was.min(is) + (was - is).abs();
        }
    }
    let has_surfaces = [before, after].iter().any(|world| !world.accel().instances().is_empty());
    let brightest = all.into_iter().fold(0.0, f64::max);
    // Of a channel that hardly shines nobody sees much.
    let counts = |channel: &usize| all[*channel] > COUNTS * brightest;
    match (met >= MET_MIN, has_surfaces) {
        (true, _) if brightest > 0.0 => {
            let shares = (0..3).filter(counts).map(|channel| otherwise[channel] / all[channel]);
            shares.fold(0.0, f64::max) as f32
        }
        (_, true) => 1.0,
        (_, false) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::{
        math::Rgb,
        scene::{
            Environment, Light, LightKind, Material, Scene, SceneBuilder, SceneLimits,
            samples::{Stage, cuboid},
        },
    };

    fn lamp(position: DVec3, intensity: f32) -> Light {
        let kind = LightKind::Point { intensity: Rgb::splat(intensity) };
        Light { parent: None, position, direction: DVec3::NEG_Z, kind }
    }

    /// A lamp of so much intensity in a room `size_m` wide, and one of a room beside it.
    fn rooms(size_m: f64, place: DVec3, intensity: f32) -> World {
        let mut stage = Stage::default();
        let grey = stage.material("grey", Material::default()).unwrap();
        for (name, left) in [("room", 0.0), ("other room", 3.0)] {
            let corner = DVec3::new(left, 0.0, 0.0) * size_m;
            let walls = cuboid(corner, corner + size_m, &grey);
            stage.place(name, walls, DAffine3::IDENTITY).unwrap();
        }
        stage.light("lamp", lamp(place * size_m, intensity)).unwrap();
        stage.light("other", lamp(DVec3::new(3.5, 0.5, 0.5) * size_m, 1.0)).unwrap();
        World::prepare(Arc::new(stage.finish()))
    }

    /// Sun and sky bring the same to every place when things move below them, and when the scene grows and their photons are aimed at more:
    /// neither has become brighter.
    #[test]
    fn sun_and_sky_stay_when_things_move() {
        let under = |place: DVec3, is_sky: bool| {
            let mut stage = Stage::default();
            let grey = stage.material("grey", Material::default()).unwrap();
            let ground = cuboid(DVec3::new(-30.0, -1.0, -30.0), DVec3::new(30.0, 0.0, 30.0), &grey);
            stage.place("ground", ground, DAffine3::IDENTITY).unwrap();
            let thing = cuboid(DVec3::ZERO, DVec3::splat(2.0), &grey);
            stage.place("thing", thing, DAffine3::from_translation(place)).unwrap();
            if is_sky {
                let sky = Environment::Constant(Rgb::new(1.0, 2.0, 3.0));
                stage.builder().set_environment(sky).unwrap();
            } else {
                let kind = LightKind::Directional { irradiance: Rgb::splat(3.0) };
                let direction = DVec3::new(0.6, -0.8, 0.0);
                stage.light("sun", Light { parent: None, position: DVec3::ZERO, direction, kind }).unwrap();
            }
            World::prepare(Arc::new(stage.finish()))
        };
        for is_sky in [false, true] {
            let before = under(DVec3::ZERO, is_sky);
            for place in [DVec3::new(21.0, 0.0, -8.0), DVec3::new(90.0, 0.0, 0.0)] {
                let after = under(place, is_sky);
                let [source, moved] = [&before, &after].map(|world| world.sources().remove(0));
                assert!(!source.emits_like(&moved), "{place} is aimed at as well");
                assert_eq!(change_of_lights(&before, &after), LightsChange::NONE, "{place} {is_sky}");
            }
        }
    }

    /// Nothing where lights stay, little where one goes a little way, all where it goes into the next room, as much as it gains or
    /// loses of its strength; at any scale.
    #[test]
    fn lights_count_by_how_much_falls_elsewhere() {
        let middle = DVec3::splat(0.5);
        for size_m in [1e-3, 1.0, 1e4] {
            let change = |place: DVec3, intensity: f32| {
                let before = rooms(size_m, middle, 1.0);
                change_of_lights(&before, &rooms(size_m, place, intensity)).share
            };
            assert_eq!(change(middle, 1.0), 0.0);
            let small = change(middle + DVec3::X * 0.01, 1.0);
            assert!(small > 0.01 && small < 0.04, "{size_m}: {small}");
            let large = change(middle + DVec3::X * 0.1, 1.0);
            assert!((large / small / 10.0 - 1.0).abs() < 0.2, "{size_m}: {large} of {small}");
            assert!(change(middle + DVec3::X * 3.0, 1.0) > 0.99);
            assert!((change(middle, 2.0) - 0.5).abs() < 1e-3);
            assert!((change(middle, 0.9) - 0.1).abs() < 1e-3);
        }
    }

    /// A light that goes is all of it, also beside one that stays; so is one that comes.
    #[test]
    fn a_light_that_goes_is_all_of_it() {
        let with = rooms(1.0, DVec3::splat(0.5), 1.0);
        let mut builder = SceneBuilder::from_scene(with.scene(), SceneLimits::default());
        builder.remove_light("lamp").unwrap();
        let (scene, change) = builder.finish();
        let less = with.update(Arc::new(scene), &change);
        assert_eq!(change_of_lights(&with, &less), LightsChange::ALL);
        assert_eq!(change_of_lights(&less, &with), LightsChange::ALL);
    }

    /// Another colour of the same brightness is other light.
    #[test]
    fn colours_count() {
        let shining = |intensity: Rgb| {
            let world = rooms(1.0, DVec3::splat(0.5), 1.0);
            let mut builder = SceneBuilder::from_scene(world.scene(), SceneLimits::default());
            let kind = LightKind::Point { intensity };
            builder.set_light("lamp", Light { kind, ..lamp(DVec3::splat(0.5), 1.0) }).unwrap();
            let (scene, change) = builder.finish();
            world.update(Arc::new(scene), &change)
        };
        let red = shining(Rgb::new(1.0 / 0.2126, 0.0, 0.0));
        assert!(change_of_lights(&red, &shining(Rgb::new(0.0, 0.0, 1.0 / 0.0722))).share > 0.99);
        // By luminance a fifth of it stays.
        assert!(change_of_lights(&red, &shining(Rgb::splat(1.0 / 0.2126))).share > 0.99);
        let (warm, cold) = (Rgb::new(1.0, 0.9, 0.8), Rgb::new(0.8, 0.9, 1.0));
        let between = change_of_lights(&shining(warm), &shining(cold)).share;
        assert!((between - 0.2).abs() < 1e-3, "{between}");
        // What little of blue there is may double.
        let [some, more] = [0.01, 0.02].map(|blue| shining(Rgb::new(1.0, 1.0, blue)));
        assert!(change_of_lights(&some, &more).share < 1e-3);
        assert_eq!(change_of_lights(&red, &red), LightsChange::NONE);
    }

    /// Nothing there to be lit is not changed, and nothing is known of what hardly any light meets.
    #[test]
    fn little_to_be_lit_is_not_taken_for_little_change() {
        let lamp_at = |x: f64, has_speck: bool| {
            let mut stage = Stage::default();
            stage.light("lamp", lamp(DVec3::X * x, 1.0)).unwrap();
            if has_speck {
                let grey = stage.material("grey", Material::default()).unwrap();
                let speck = cuboid(DVec3::splat(100.0), DVec3::splat(100.1), &grey);
                stage.place("speck", speck, DAffine3::IDENTITY).unwrap();
            }
            World::prepare(Arc::new(stage.finish()))
        };
        assert_eq!(change_of_lights(&lamp_at(0.0, false), &lamp_at(1.0, false)).share, 0.0);
        assert_eq!(change_of_lights(&lamp_at(0.0, true), &lamp_at(1.0, true)).share, 1.0);
        let empty = World::prepare(Arc::new(Scene::default()));
        assert_eq!(change_of_lights(&empty, &empty), LightsChange::NONE);
    }

    /// Changes one after the other are one, as far as numbers hold what becomes of the light.
    #[test]
    fn dimmings_beyond_numbers_are_other_lights() {
        let by = |times: f32| LightsChange { dimmed: Rgb::new(times, 1.0, 1.0), share: 0.1 };
        let twice = by(0.5).then(by(1e20));
        assert_eq!((twice.dimmed.r, twice.share), (5e19, 0.1));
        assert_eq!(by(1e20).then(by(1e20)), LightsChange::ALL);
        assert_eq!(by(1e20).then(by(1e20)).then(by(0.0)).share, 1.0);
    }

    /// Lights that all change alike are what they were times something, to black; where one changes otherwise, or not at all, or out of
    /// black, they are others.
    #[test]
    fn lights_that_change_alike_are_the_same_dimmed() {
        let lit = |lamps: [Rgb; 2]| {
            let mut stage = Stage::default();
            let grey = stage.material("grey", Material::default()).unwrap();
            stage.place("room", cuboid(DVec3::ZERO, DVec3::ONE, &grey), DAffine3::IDENTITY).unwrap();
            for (place, intensity) in lamps.into_iter().enumerate() {
                let kind = LightKind::Point { intensity };
                let light = Light { kind, ..lamp(DVec3::splat(0.3 + 0.2 * place as f64), 1.0) };
                stage.light(&format!("lamp {place}"), light).unwrap();
            }
            World::prepare(Arc::new(stage.finish()))
        };
        let (warm, cold) = (Rgb::new(3.0, 2.0, 1.0), Rgb::new(0.1, 0.2, 0.3));
        let by = Rgb::new(0.25, 0.5, 2.0);
        let alike = change_of_lights(&lit([warm, cold]), &lit([warm * by, cold * by]));
        assert!(alike.share < 1e-3, "{alike:?}");
        (0..3).for_each(|k| assert!((alike.dimmed[k] / by[k] - 1.0).abs() < 1e-3, "{alike:?}"));
        let black = change_of_lights(&lit([warm, cold]), &lit([Rgb::BLACK; 2]));
        assert_eq!(black, LightsChange { dimmed: Rgb::BLACK, share: 0.0 });
        for others in [[warm, cold * by], [warm * by, cold * 0.5]] {
            let change = change_of_lights(&lit([warm, cold]), &lit(others));
            assert!(change.dimmed == Rgb::WHITE && change.share > 0.4, "{change:?}");
        }
        assert_eq!(change_of_lights(&lit([Rgb::BLACK; 2]), &lit([warm, cold])), LightsChange::ALL);
        let twice = alike.then(alike);
        assert!((twice.dimmed.r - 0.0625).abs() < 1e-3);
    }
}
