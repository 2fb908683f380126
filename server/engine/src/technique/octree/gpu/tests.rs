//! Gathers whose searches a card makes are those of the CPU.

use std::{num::NonZeroUsize, sync::atomic::AtomicBool};

use glam::{DAffine3, DVec3, Vec3};
use lumicast_shaders::PROOF_CONSTANTS;

use super::*;
use crate::{
    gpu::{
        AdapterChoice, Gpu, GpuOptions,
        tests::{assert_same_layout, open, open_with},
    },
    math::{Rgb, sobol::point},
    scene::{
        Material, Scene,
        samples::{self, Stage},
    },
    technique::{
        Gather, GpuExtentNode, GpuFace, GpuMapPhoton, GpuPhotonNode, MAPPED, OtherMaps, Products, Step,
        Technique, Walls,
        octree::{OctreeBuilding, OctreeGather, OctreeSettings},
        photons::{PhotonSettings, PhotonTracing},
    },
    transport::World,
};

/// What one operation of floats may be off by, as a share of its result.
const UNIT: f32 = f32::EPSILON / 2.0;

/// A scene's photon maps and what an octree gathers of them.
struct Subject {
    maps: PhotonMaps,
    gathers: Vec<OctreeGather>,
}

impl Subject {
    /// - `depth`: halvings of the octree
    fn of(scene: Scene, emitted_count: u32, depth: u32, settings: OctreeSettings) -> Subject {
        let world = World::prepare(Arc::new(scene));
        let mut photons = PhotonTracing::new(PhotonSettings { emitted_count, ..PhotonSettings::default() });
        let of = OctreeSettings { depth_first: depth, depth, photon_count: emitted_count, ..settings };
        let mut octree = OctreeBuilding::new(of);
        let (mut products, never) = (Products::default(), AtomicBool::new(false));
        while octree.octree().is_none() {
            let mut step = Step { world: &world, products: &mut products, canvas: None, cancel: &never };
            if photons.is_complete() {
                octree.step(&mut step);
            } else {
                photons.step(&mut step);
            }
        }
        let gathers = octree.octree().unwrap().gathers(&world);
        Subject { maps: products.photons.unwrap().maps.clone(), gathers }
    }

    fn asked(&self) -> Vec<AskedGather<'_>> {
        self.gathers.iter().map(|of| AskedGather { sides: &of.sides, bounds: of.bounds }).collect()
    }

    /// Farthest that anything lies from a gather, m.
    fn size_m(&self) -> f32 {
        let middles = || self.gathers.iter().map(|of| of.bounds.centre);
        let low = middles().fold(Vec3::INFINITY, Vec3::min);
        2.0 * middles().map(|centre| centre.distance(low)).fold(0.0, f32::max)
    }
}

fn card() -> Option<(Gpu, GatherOnCard)> {
    let gpu = open()?;
    let card = GatherOnCard::new(&gpu.session().unwrap()).unwrap();
    Some((gpu, card))
}

/// Gathers compared, and how far card and CPU are apart.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    gathers: usize,
    photons: usize,
    /// Walls kept photons out of so many, so many are of what faces any way.
    walled: usize,
    of_any: usize,
    /// Rounding decided otherwise which photons count.
    otherwise: usize,
    /// Areas, as a share of what rounding allows, and of the ellipse's.
    area_of_allowed: f32,
    area_of_ellipse: f32,
    /// Irradiance of what has the same photons, as a share of itself.
    irradiance: f32,
    /// Of those how many were narrowed otherwise.
    narrowed_otherwise: usize,
}

/// What cutting a surface in floats may be off by, m², where the farthest corner lies so far from the middle.
///
/// An edge's distance from the middle is off by a few units of its corners', and moves an area no larger than a diameter times as much; angles
/// of sectors are off by some units of a turn, of discs of π r². Three edges, two sectors each, of some triangles at the rim.
fn area_off_m2(radius_m: f32, size_m: f32) -> f32 {
    32.0 * UNIT * radius_m * (radius_m + size_m)
}

/// Asserts that the card found what the CPU finds.
fn agree(card: &GatherOnCard, subject: &Subject, tally: &mut Tally) {
    for (class_index, class) in MAPPED.into_iter().enumerate() {
        let maps = card.upload(&subject.maps, class).unwrap().unwrap();
        let found = card.find(&maps, &subject.asked()).unwrap();
        for (of, found) in subject.gathers.iter().zip(found) {
            let found = found.expect("nothing is odd");
            let expected = subject.maps.found(class, &of.sides, &of.bounds);
            tally.gathers += 1;
            tally.photons += expected.count();
            tally.walled += usize::from(expected.behind_count > 0);
            tally.of_any += usize::from(expected.facing_cos < 0.0 && expected.count() > 0);
            let is_same = found.near == expected.near
                && found.facing_cos == expected.facing_cos
                && found.behind_count == expected.behind_count;
            if !is_same {
                tally.otherwise += 1;
                assert_near_the_rim(subject, class_index, of, &found, &expected);
                continue;
            }
            // Every time that it looks farther, by a tenth or more, a root of a quotient decides how far: on a card the one is off by 9 units, the other
            // by 5, which the root halves, and products by two more.
            let growth_min = GATHER_NUMBERS.iter().find(|(name, _)| *name == "GATHER_GROWTH_MIN").unwrap().1;
            let (first_m, _) = of.bounds.first_look();
            let times = 1.0 + (expected.reach_m / first_m).max(1.0).ln() / growth_min.ln();
            let off = |a: f32, b: f32| (a - b).abs() <= 14.0 * UNIT * times.ceil() * b;
            assert!(off(found.radius_m, expected.radius_m), "{found:?} for {expected:?}");
            assert!(off(found.reach_m, expected.reach_m), "{found:?} for {expected:?}");
            assert_alike(subject, of, &found, &expected, tally);
            assert_same_light(subject, class, of, &found, &expected, tally);
        }
    }
}

/// What only one of them found lies at the rim, at a wall, or leans as far as any may: by a few units.
fn assert_near_the_rim(
    subject: &Subject,
    class: usize,
    of: &OctreeGather,
    found: &FoundPhotons,
    expected: &FoundPhotons,
) {
    let near = |a: f32, b: f32, scale: f32| (a - b).abs() <= 64.0 * UNIT * scale;
    let scale = subject.size_m() + of.bounds.centre.length();
    let differing = found
        .near
        .iter()
        .filter(|name| !expected.near.contains(name))
        .chain(expected.near.iter().filter(|name| !found.near.contains(name)));
    for name in differing {
        let (position, cos) = subject.maps.lies(class, *name, of.bounds.normal);
        let distance_m = of.bounds.flattened_from(position).length();
        let from_middle = position - of.bounds.centre;
        let is_at_rim = near(distance_m, expected.radius_m, scale) || near(distance_m, found.radius_m, scale);
        let is_at_wall = near(of.bounds.walls.behind_m(from_middle), 0.0, scale);
        let leans = near(cos, 0.5, 1.0) || near(cos, 0.79, 1.0);
        assert!(
            is_at_rim || is_at_wall || leans,
            "{name:?} at {position}, {distance_m} m, cosine {cos}: {found:?} for {expected:?} of {of:?}"
        );
    }
}

/// As much surface, side by side.
fn assert_alike(
    subject: &Subject,
    of: &OctreeGather,
    found: &FoundPhotons,
    expected: &FoundPhotons,
    tally: &mut Tally,
) {
    assert!(expected.of_sides.is_empty() || found.of_sides.len() == expected.of_sides.len());
    let size_m = subject.size_m() + of.bounds.centre.length();
    let allowed = area_off_m2(found.radius_m, size_m);
    for (found_side, expected_side) in found.of_sides.iter().zip(&expected.of_sides) {
        let off = found_side.farthest_from(expected_side);
        assert!(off <= allowed, "{off} of {allowed}: {found_side:?} for {expected_side:?} in {of:?}");
        tally.area_of_allowed = tally.area_of_allowed.max(off / allowed);
        let ellipse_m2 = std::f32::consts::PI * found.radius_m.powi(2);
        tally.area_of_ellipse = tally.area_of_ellipse.max(off / ellipse_m2);
    }
}

/// The estimates themselves, with all that follows on the CPU.
fn assert_same_light(
    subject: &Subject,
    class: PathClass,
    of: &OctreeGather,
    found: &FoundPhotons,
    expected: &FoundPhotons,
    tally: &mut Tally,
) {
    let [mut by_card, mut by_cpu] = [Gather::default(), Gather::default()];
    subject.maps.gather_found(class, &of.sides, &of.bounds, found, &mut by_card).unwrap();
    subject.maps.gather(class, &of.sides, &of.bounds, &mut by_cpu);
    if by_card.photons.len() != by_cpu.photons.len() {
        tally.narrowed_otherwise += 1;
        return;
    }
    let area_m2: f32 = expected.of_sides.iter().map(|facets| facets.area_m2).sum();
    let size_m = subject.size_m() + of.bounds.centre.length();
    // Irradiance goes with one over the area, and with one over the mean cosine, which is told by two more sums of it.
    let share = 8.0 * area_off_m2(expected.radius_m, size_m) / area_m2 + 32.0 * UNIT;
    for (card, cpu) in by_card.photons.iter().zip(&by_cpu.photons) {
        assert!(card.is_sound() && card.direction == cpu.direction);
        // Light that hardly meets the surface is told by the root of what cancels.
        let off = (card.irradiance + cpu.irradiance * -1.0).map(f32::abs).max_component();
        let size = cpu.irradiance.max_component();
        assert!(off <= share.sqrt() * size, "{card:?} for {cpu:?}");
    }
    let [card, cpu] = [&by_card, &by_cpu].map(|gather| gather.irradiance().luminance());
    if cpu > 0.0 {
        tally.irradiance = tally.irradiance.max((card - cpu).abs() / cpu);
    }
}

/// A ball in a room, lit by a lamp beneath the ceiling.
fn ball_room() -> Scene {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.7))).unwrap();
    let lamp = stage.material("lamp", Material::emitter(Rgb::splat(20.0))).unwrap();
    let v = DVec3::new;
    let half = DVec3::splat(2.0);
    let below = [v(-0.5, 1.9, -0.5), v(0.5, 1.9, -0.5), v(0.5, 1.9, 0.5), v(-0.5, 1.9, 0.5)];
    for (name, mesh) in [
        ("room", samples::cuboid(-half, half, &white)),
        ("ball", samples::sphere(v(0.2, -0.9, 0.1), 0.7, 24, &white)),
        ("lamp", samples::quad(below, &lamp)),
    ] {
        stage.place(name, mesh, DAffine3::IDENTITY).unwrap();
    }
    stage.finish()
}

fn settings() -> OctreeSettings {
    OctreeSettings::default()
}

/// Scenes of boxes, of balls, of rooms with walls between; cells large and small; few photons and many.
#[test]
fn a_card_finds_what_the_cpu_finds() {
    let Some((_gpu, card)) = card() else { return };
    let mut tally = Tally::default();
    let nearest = |count: usize| settings().gathering(NonZeroUsize::new(count).unwrap());
    for (scene, emitted_count, depth, settings) in [
        (samples::cornell_box().unwrap(), 20_000, 4, settings()),
        (samples::cornell_box().unwrap(), 1_000, 3, settings()),
        (samples::cornell_box().unwrap(), 5_000, 3, nearest(50)),
        (samples::boxes().unwrap(), 20_000, 3, settings()),
        (samples::parted_rooms([1.0, 0.01]).unwrap(), 5_000, 4, settings()),
        (samples::parted_rooms([1.0, 0.01]).unwrap(), 5_000, 4, nearest(1)),
        (ball_room(), 20_000, 4, settings()),
        (ball_room(), 300, 4, settings()),
    ] {
        agree(&card, &Subject::of(scene, emitted_count, depth, settings), &mut tally);
        eprintln!("{tally:?}");
    }
    assert!(tally.gathers > 3_000 && tally.photons > 100_000, "{tally:?}");
    assert!(tally.walled > 100 && tally.of_any > 20, "{tally:?}");
    assert!(tally.otherwise * 500 <= tally.gathers, "{tally:?}");
    assert!(tally.narrowed_otherwise * 500 <= tally.gathers, "{tally:?}");
    assert!(tally.irradiance < 5e-5 && tally.area_of_ellipse < 1e-5, "{tally:?}");
}

/// Gathers in slices are those at once.
#[test]
fn slices_change_nothing() {
    let Some((_gpu, mut card)) = card() else { return };
    let subject = Subject::of(samples::cornell_box().unwrap(), 2_000, 3, settings());
    let maps = card.upload(&subject.maps, MAPPED[0]).unwrap().unwrap();
    let name = |found: Option<FoundPhotons>| {
        found.map(|found| (found.near, found.radius_m, found.reach_m, found.behind_count, found.of_sides))
    };
    let find = |card: &GatherOnCard| -> Vec<_> {
        card.find(&maps, &subject.asked()).unwrap().into_iter().map(name).collect()
    };
    let whole = find(&card);
    for gathers_at_once in [1, 7, 100] {
        card.gathers_at_once = gathers_at_once;
        assert!(find(&card) == whole, "{gathers_at_once}");
    }
    card.gathers_at_once = GATHERS_AT_ONCE;
    for bytes_at_once in [10_000, 100_000] {
        card.bytes_at_once = bytes_at_once;
        assert!(find(&card) == whole, "{bytes_at_once}");
    }
    assert!(card.find(&maps, &[]).unwrap().is_empty());
    // A list that has no room anywhere is the CPU's, and only that one.
    let mut asked = subject.asked();
    asked[1].bounds.count_min = NonZeroUsize::MAX;
    let found: Vec<_> = card.find(&maps, &asked).unwrap().into_iter().map(name).collect();
    assert!(found[1].is_none() && found[0] == whole[0] && found[2..] == whole[2..]);
}

/// Thousands of photons in a gather take more than an invocation may; what is found beside them is what the CPU finds.
#[test]
fn what_takes_too_long_is_left_to_the_cpu() {
    let Some((_gpu, card)) = card() else { return };
    let of = |count: usize| settings().gathering(NonZeroUsize::new(count).unwrap());
    let many = Subject::of(samples::cornell_box().unwrap(), 100_000, 2, of(15_000));
    let few = Subject::of(samples::cornell_box().unwrap(), 100_000, 2, of(20));
    let maps = card.upload(&many.maps, MAPPED[0]).unwrap().unwrap();
    let asked: Vec<_> = many.asked().into_iter().chain(few.asked()).collect();
    let found = card.find(&maps, &asked).unwrap();
    let (of_many, of_few) = found.split_at(many.gathers.len());
    let [left, left_of_few] =
        [of_many, of_few].map(|found| found.iter().filter(|found| found.is_none()).count());
    let told = format!(
        "of {} {left} take more than {WORK_MAX} steps, with few photons {left_of_few}",
        of_many.len()
    );
    // Mesa's driver gives up earlier and leaves more than a quarter, an H200 one in 18.
    assert!(left > 0 && left_of_few < of_few.len() / 4, "{told}");
    println!("{told}");
    for (subject, found) in [(&many, of_many), (&few, of_few)] {
        for (of, found) in subject.gathers.iter().zip(found) {
            let Some(found) = found else { continue };
            let expected = subject.maps.found(MAPPED[0], &of.sides, &of.bounds);
            if found.near != expected.near {
                assert_near_the_rim(subject, 0, of, found, &expected);
            }
        }
    }
}

/// What was found in other maps, or on other sides, is refused.
#[test]
fn what_was_found_elsewhere_is_refused() {
    let large = Subject::of(samples::cornell_box().unwrap(), 5_000, 3, settings());
    let small = Subject::of(ball_room(), 10, 2, settings());
    let of = &large.gathers[0];
    let found = large.maps.found(MAPPED[0], &of.sides, &of.bounds);
    assert!(found.count() > 0);
    let mut gather = Gather::default();
    let mut gathered = |subject: &Subject, sides: &[SideId]| {
        let refused = subject.maps.gather_found(MAPPED[0], sides, &of.bounds, &found, &mut gather);
        (refused, gather.photons.len())
    };
    assert_eq!(gathered(&small, &of.sides), (Err(OtherMaps), 0));
    assert_eq!(gathered(&large, &[]), (Err(OtherMaps), 0));
    assert_eq!(gathered(&large, &of.sides).0, Ok(()));
}

/// What no float holds is left to the CPU; photons that lie nowhere, far away or all at one point bring nothing that is no number.
#[test]
fn what_is_no_number_never_comes_out() {
    let Some((_gpu, card)) = card() else { return };
    let subject = Subject::of(samples::cornell_box().unwrap(), 2_000, 3, settings());
    let odd =
        [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN_POSITIVE, f32::from_bits(1), -0.0];
    let mut packed = subject.maps.packed(0);
    for (index, photon) in packed.photons.iter_mut().enumerate() {
        let [u, v, ..] = point(3, index as u32);
        if u < 0.1 {
            photon.position[index % 3] = odd[(v * odd.len() as f32) as usize];
        } else if u < 0.2 {
            photon.normal[index % 3] = odd[(v * odd.len() as f32) as usize];
        }
    }
    for (index, node) in packed.extents.nodes.iter_mut().enumerate() {
        if index % 5 == 0 {
            node.area_m2 = odd[index / 5 % odd.len()];
            node.middle[0] = odd[index / 3 % odd.len()];
        }
    }
    let maps = card.upload_packed(&packed).unwrap();
    for found in card.find(&maps, &subject.asked()).unwrap().into_iter().flatten() {
        assert!(found.radius_m.is_finite() && found.radius_m > 0.0 && found.reach_m.is_finite());
        assert!(found.of_sides.iter().all(Facets::is_finite), "{found:?}");
    }
    let maps = card.upload(&subject.maps, MAPPED[0]).unwrap().unwrap();
    let of = &subject.gathers[0];
    let mut odd_bounds = Vec::new();
    for value in odd {
        for axis in 0..3 {
            let mut bounds = of.bounds;
            bounds.centre[axis] = value;
            odd_bounds.push(bounds);
            bounds = of.bounds;
            bounds.normal[axis] = value;
            odd_bounds.push(bounds);
        }
        odd_bounds.push(GatherBounds { radius_m: value, ..of.bounds });
        odd_bounds.push(GatherBounds { radius_max_m: value, ..of.bounds });
    }
    odd_bounds.push(GatherBounds { walls: Walls::default(), ..of.bounds });
    let asked: Vec<_> =
        odd_bounds.iter().map(|bounds| AskedGather { sides: &of.sides, bounds: *bounds }).collect();
    let found = card.find(&maps, &asked).unwrap();
    assert!(found.iter().any(Option::is_none) && found.iter().any(Option::is_some));
    for (found, bounds) in found.iter().zip(&odd_bounds) {
        let Some(found) = found else { continue };
        let expected = subject.maps.found(MAPPED[0], &of.sides, bounds);
        assert_eq!(found.count(), expected.count(), "{bounds:?}");
        assert!(found.radius_m.is_finite() && found.of_sides.iter().all(Facets::is_finite), "{bounds:?}");
    }
}

/// A device that is lost is an error, and the next session finds the same; what has no room is refused, and memory is given back.
#[test]
fn lost_devices_and_too_little_room_are_errors() {
    let options = GpuOptions { adapter: AdapterChoice::Any, bytes_max: 2_000_000, ..GpuOptions::default() };
    let Some(gpu) = open_with(&options) else { return };
    let session = gpu.session().unwrap();
    let mut card = GatherOnCard::new(&session).unwrap();
    card.gathers_at_once = 64;
    let subject = Subject::of(samples::cornell_box().unwrap(), 1_000, 2, settings());
    let large = Subject::of(samples::cornell_box().unwrap(), 60_000, 2, settings());
    let refused = card.upload(&large.maps, MAPPED[0]).unwrap_err();
    assert!(matches!(refused, GpuError::OutOfMemory { .. }), "{refused}");
    assert_eq!(session.bytes_held(), 0);
    let maps = card.upload(&subject.maps, MAPPED[0]).unwrap().unwrap();
    let held = session.bytes_held();
    let near = |found: Vec<Option<FoundPhotons>>| -> Vec<_> {
        found.into_iter().map(|found| found.map(|found| found.near)).collect()
    };
    let before = near(card.find(&maps, &subject.asked()).unwrap());
    assert_eq!(session.bytes_held(), held);
    assert!(card.upload(&subject.maps, PathClass::Direct).unwrap().is_none());
    session.lose_for_test();
    assert_eq!(card.find(&maps, &subject.asked()).unwrap_err(), GpuError::Lost);
    let mut next = GatherOnCard::new(&gpu.session().unwrap()).unwrap();
    next.gathers_at_once = 64;
    assert_eq!(next.find(&maps, &subject.asked()).unwrap_err(), GpuError::Lost, "maps of the lost device");
    let maps = next.upload(&subject.maps, MAPPED[0]).unwrap().unwrap();
    assert_eq!(near(next.find(&maps, &subject.asked()).unwrap()), before);
}

/// What goes to the card lies in WGSL as in Rust.
#[test]
fn gathers_lie_alike_in_rust_and_wgsl() {
    let search = OCTREE_SEARCH.source(PROOF_CONSTANTS);
    let within = OCTREE_WITHIN.source(PROOF_CONSTANTS);
    assert_same_layout!(
        &search,
        "Asked",
        GpuAsked {
            centre,
            radius_m,
            normal,
            radius_max_m,
            walls,
            first_side,
            end_side,
            count_min,
            count_max,
            padding_0,
            padding_1,
            padding_2,
            padding_3,
        }
    );
    assert_same_layout!(&search, "Found", GpuFound { radius_m, reach_m, facing_cos, count, behind_count });
    assert_same_layout!(&search, "Gathers", GpuGathers { count, list_length });
    assert_same_layout!(&search, "PhotonNode", GpuPhotonNode { low, end, high, photons });
    assert_same_layout!(&search, "MapPhoton", GpuMapPhoton { position, item, normal, padding });
    assert_same_layout!(
        &within,
        "Facets",
        GpuFacets { facing_m2, area_m2, squares_m2, padding_0, products_m2, padding_1 }
    );
    assert_same_layout!(
        &within,
        "Face",
        GpuFace { a, area_m2, b, reach_m, c, padding_0, normal, padding_1, middle, padding_2 }
    );
    assert_same_layout!(
        &within,
        "ExtentNode",
        GpuExtentNode {
            middle,
            reach_m,
            axis,
            cone_cos,
            facing_m2,
            area_m2,
            squares_m2,
            cone_sin,
            products_m2,
            end,
            faces,
            padding_0,
            padding_1,
            padding_2,
        }
    );
}
