//! Gathers in light that changes, and in light that does not.

use std::{collections::HashMap, sync::Arc};

use glam::{DAffine3, DVec3};

use super::*;
use crate::{
    accel::Ray,
    math::sobol::mix,
    scene::{
        Material,
        samples::{self, Stage},
    },
    technique::{CREASE_ANGLE_RAD, FallenPhoton, Surfaces, TriangleSide},
    transport::World,
};

/// Flux of every photon, W.
const FLUX_W: f32 = 1e-3;

/// A square of 2 × 2 m in the plane y = 0 that faces up, with photons spread evenly over its left and its right half.
struct Square {
    maps: PhotonMaps,
    side: SideId,
    /// On which none falls.
    below: SideId,
}

impl Square {
    /// - `counts`: photons on the left and on the right
    fn lit(counts: [u32; 2], key: u64) -> Square {
        let mut stage = Stage::default();
        let white = stage.material("white", Material::lambert(Rgb::new(0.5, 0.5, 0.5))).unwrap();
        let v = DVec3::new;
        let corners = [v(-1., 0., 1.), v(1., 0., 1.), v(1., 0., -1.), v(-1., 0., -1.)];
        stage.place("square", samples::quad(corners, &white), DAffine3::IDENTITY).unwrap();
        let world = World::prepare(Arc::new(stage.finish()));
        let accel = world.accel();
        let surfaces = Arc::new(Surfaces::of(accel, CREASE_ANGLE_RAD, &Surfaces::default()));
        let place = TriangleSide { instance: 0, triangle: 0, is_front: true };
        let fallen = |half: usize, index: u32| {
            // Photons fall by chance, not as evenly as a sequence.
            let bits = mix(key << 32 | (half as u64) << 31 | u64::from(index));
            let [u, w] = [bits >> 40, bits >> 16 & 0xff_ffff].map(|bits| bits as f64 / 16_777_216.0);
            let x = u - if half == 0 { 1.0 } else { 0.0 };
            let position = accel.to_render(v(x, 0.0, 2.0 * w - 1.0));
            let photon = FallenPhoton {
                position,
                flux: Rgb::new(FLUX_W, FLUX_W, FLUX_W),
                direction: octahedral::encode(Vec3::Y),
            };
            (PathClass::Indirect, place, photon)
        };
        let photons = [0, 1].into_iter().flat_map(|half| (0..counts[half]).map(move |index| (half, index)));
        let all: Vec<_> = photons.map(|(half, index)| fallen(half, index)).collect();
        let (side, below) = (surfaces.side(place), surfaces.side(TriangleSide { is_front: false, ..place }));
        Square { maps: PhotonMaps::of(all, surfaces, |_| Vec3::Y, |_, _| None), side, below }
    }

    /// A gather of 96 photons in the plane z = 0 that may be narrowed to so many.
    fn gather(&self, x_m: f32, count_narrow: usize) -> Gather {
        self.gather_before(Walls::default(), x_m, count_narrow)
    }

    fn gather_before(&self, walls: Walls, x_m: f32, count_narrow: usize) -> Gather {
        self.gather_on(&[self.side], walls, x_m, count_narrow)
    }

    fn gather_on(&self, sides: &[SideId], walls: Walls, x_m: f32, count_narrow: usize) -> Gather {
        let count = NonZeroUsize::new(96).unwrap();
        let bounds = GatherBounds {
            centre: Vec3::new(x_m, 0.0, 0.0),
            normal: Vec3::Y,
            radius_m: f32::INFINITY,
            count_min: count,
            count_max: count,
            radius_max_m: 4.0,
            count_narrow: NonZeroUsize::new(count_narrow).unwrap(),
            walls,
        };
        let mut gather = Gather::default();
        self.maps.gather(PathClass::Indirect, sides, &bounds, &mut gather);
        gather
    }
}

/// Beside a spot forty times as bright the nearest photons lie in the spot; a narrowed gather stays out of it.
#[test]
fn a_gather_beside_a_bright_spot_stays_out_of_it() {
    let (mut wide, mut narrow) = (0.0, 0.0);
    for key in 0..20 {
        let square = Square::lit([8000, 200], 100 * key);
        let expected = 100.0 * FLUX_W;
        let relative = |gather: &Gather| gather.irradiance().luminance() / expected;
        let (of_all, of_few) = (square.gather(0.25, 96), square.gather(0.25, 16));
        assert!(of_few.radius_m <= of_all.radius_m && of_few.reach_m >= of_all.radius_m);
        wide += relative(&of_all) / 20.0;
        narrow += relative(&of_few) / 20.0;
    }
    assert!(wide > 3.0, "light of the spot: {wide}");
    assert!((0.7..1.5).contains(&narrow), "{narrow}");
}

/// A side on which no photon falls takes no light from the other, wherever it comes in the list.
#[test]
fn a_dark_side_takes_no_light() {
    let square = Square::lit([400, 400], 0);
    let mut both = [square.side, square.below];
    both.sort_unstable();
    for count_narrow in [16, 96] {
        let [lit, both] = [&[square.side][..], &both]
            .map(|sides| square.gather_on(sides, Walls::default(), 0.1, count_narrow));
        assert!(lit.photons.len() > 40);
        assert_eq!(both.photons, lit.photons);
    }
}

/// In even light next to no gather is narrowed, and the mean stays the truth.
#[test]
fn even_light_is_not_narrowed() {
    let (mut sum, mut narrowed) = (0.0, 0);
    for key in 0..200 {
        let gather = Square::lit([400, 400], 100 * key).gather(0.1, 16);
        sum += gather.irradiance().luminance() / (200.0 * FLUX_W) / 200.0;
        narrowed += u32::from(gather.photons.len() < 95);
    }
    assert!((sum - 1.0).abs() < 0.03, "{sum}");
    assert!(narrowed <= 4, "{narrowed} of 200");
}

/// A wall between keeps the bright half out altogether and takes nothing from even light.
#[test]
fn walls_keep_out_what_lies_behind() {
    let wall = |x_m: f32| Walls::at([(-Vec3::X, x_m), (Vec3::Z, 5.0)]);
    let (mut dark, mut even) = (0.0, [0.0; 3]);
    for key in 0..400 {
        let gather = Square::lit([8000, 200], 100 * key).gather_before(wall(0.05), 0.05, 96);
        assert_eq!(gather.dark_m2, None);
        dark += gather.irradiance().luminance() / (100.0 * FLUX_W) / 400.0;
        for (mean, x_m) in even.iter_mut().zip([0.02, 0.1, 0.2]) {
            let gather = Square::lit([400, 400], 100 * key).gather_before(wall(x_m), x_m, 96);
            *mean += gather.irradiance().luminance() / (200.0 * FLUX_W) / 400.0;
        }
    }
    // 48 to 96 photons, 400 times: 0.5 to 0.7 %.
    assert!((dark - 1.0).abs() < 0.02, "{dark}");
    assert!(even.iter().all(|mean| (mean - 1.0).abs() < 0.02), "{even:?}");
    // Nothing but photons behind: that is said, with the area that would have caught some.
    let beside = Square::lit([400, 0], 1).gather_before(wall(0.05), 0.05, 96);
    assert!(beside.photons.is_empty() && beside.reach_m == 4.0);
    assert!((beside.dark_m2.unwrap() - 2.0).abs() < 1e-3, "{:?}", beside.dark_m2);
}

/// What brings no light agrees with any estimate, and what is known without noise with no other.
#[test]
fn estimates_agree_within_their_noise() {
    let mut agreement = Agreement::ANY;
    let mut sums = LightSums::default();
    assert!(agreement.admits(&sums), "no light");
    sums.sum = 1e9;
    assert!(!agreement.admits(&sums), "light where there is none");
}

/// A ball in parallel light shows it by the cosine at every angle, though a gather reaches 26° and more around the ball: the
/// mean of what falls on all that would be 5 % less.
#[test]
fn bent_surfaces_show_the_light_they_face() {
    let mut stage = Stage::default();
    let white = stage.material("white", Material::lambert(Rgb::splat(0.5))).unwrap();
    stage.place("ball", samples::sphere(DVec3::ZERO, 1.0, 48, &white), DAffine3::IDENTITY).unwrap();
    let world = World::prepare(Arc::new(stage.finish()));
    let surfaces = Arc::new(Surfaces::of(world.accel(), CREASE_ANGLE_RAD, &Surfaces::default()));
    const COUNT: u64 = 1500;
    const ROUNDS: u64 = 60;
    let angles = [0.0f32, 30.0, 60.0];
    let (mut found, mut narrowed) = ([0.0f32; 3], 0);
    for round in 0..ROUNDS {
        let mut normals = HashMap::new();
        let mut all = Vec::new();
        for index in 0..COUNT {
            let bits = mix(round << 32 | index);
            let [u, v] = [bits >> 40, bits >> 16 & 0xff_ffff].map(|bits| bits as f32 / 16_777_216.0);
            let (sin, cos) = (std::f32::consts::TAU * u).sin_cos();
            let ray = Ray::new(Vec3::new(v.sqrt() * cos, 3.0, v.sqrt() * sin), -Vec3::Y);
            // At the rim a ball of triangles lets some pass.
            let Some(hit) = world.closest_hit(&ray) else { continue };
            let point = world.surface(&hit, ray.direction).point;
            let is_front = point.n_geo.y > 0.0;
            let place = TriangleSide { instance: hit.instance, triangle: hit.triangle, is_front };
            normals.insert(hit.triangle, if is_front { point.n_geo } else { -point.n_geo });
            let flux = Rgb::splat(std::f32::consts::PI / COUNT as f32);
            let photon =
                FallenPhoton { position: point.position, flux, direction: octahedral::encode(Vec3::Y) };
            all.push((PathClass::Indirect, place, photon));
        }
        let side = surfaces.side(all[0].1);
        let maps = PhotonMaps::of(all, surfaces.clone(), |place| normals[&place.triangle], |_, _| None);
        for (angle, sum) in angles.iter().zip(&mut found) {
            let normal = Vec3::new(angle.to_radians().sin(), angle.to_radians().cos(), 0.0);
            let count = NonZeroUsize::new(300).unwrap();
            let bounds = GatherBounds {
                centre: normal,
                normal,
                radius_m: f32::INFINITY,
                count_min: count,
                count_max: count,
                radius_max_m: 4.0,
                count_narrow: NonZeroUsize::new(16).unwrap(),
                walls: Walls::default(),
            };
            let mut gather = Gather::default();
            maps.gather(PathClass::Indirect, &[side], &bounds, &mut gather);
            narrowed += u32::from(gather.radius_m < 0.4);
            *sum += gather.irradiance().luminance() / ROUNDS as f32;
        }
    }
    assert!(narrowed <= 9, "{narrowed} of 180");
    for (angle, found) in angles.into_iter().zip(found) {
        let expected = angle.to_radians().cos();
        assert!((found / expected - 1.0).abs() < 0.025, "{angle}°: {found} for {expected}");
    }
}

/// A radius that is next to nothing rounds back to itself when it grows; the search ends, and finds what one from elsewhere finds.
#[test]
fn a_search_from_next_to_nothing_ends() {
    let square = Square::lit([200, 200], 0);
    let of = |radius_m: f32, radius_max_m: f32| {
        let bounds = GatherBounds {
            centre: Vec3::ZERO,
            normal: Vec3::Y,
            radius_m,
            count_min: NonZeroUsize::MIN,
            count_max: NonZeroUsize::MIN,
            radius_max_m,
            count_narrow: NonZeroUsize::MIN,
            walls: Walls::default(),
        };
        let mut gather = Gather::default();
        square.maps.gather(PathClass::Indirect, &[square.side], &bounds, &mut gather);
        gather.radius_m
    };
    let nearest_m = of(f32::INFINITY, 4.0);
    assert!(nearest_m > 0.0 && nearest_m < 1.0);
    for bits in 1..8 {
        assert_eq!(of(f32::from_bits(bits), 4.0), nearest_m);
        assert_eq!(of(f32::INFINITY, f32::from_bits(bits)), f32::from_bits(bits));
    }
}
