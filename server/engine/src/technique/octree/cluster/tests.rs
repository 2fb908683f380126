//! Laws of clustering: power, directions, degenerate input.

use glam::Vec3;

use super::{Clustering, GatheredPhoton, Spread, VDL_COUNT_MAX, Vdl};
use crate::math::Rgb;
use crate::math::sobol::point;

fn sphere_point([u, v]: [f32; 2]) -> Vec3 {
    let z = 2.0 * u - 1.0;
    let (sin, cos) = (std::f32::consts::TAU * v).sin_cos();
    Vec3::new(cos, sin, 0.0) * (1.0 - z * z).max(0.0).sqrt() + z * Vec3::Z
}

/// Photons of random colour: alone, in a cone of `cone` around one of `lamp_count` random directions.
fn lamps(key: u64, photon_count: u32, lamp_count: u32, cone: f32) -> Vec<GatheredPhoton> {
    let photon = |index| {
        let [u, v, w, r] = point(key, index);
        let [g, b, ..] = point(key ^ 99, index);
        let [a, c, ..] = point(1234, index % lamp_count);
        let direction = sphere_point([a, c]) + cone * w * sphere_point([u, v]);
        GatheredPhoton { direction: direction.normalize(), irradiance: Rgb::new(r, g, b) }
    };
    (0..photon_count).map(photon).collect()
}

fn cluster(photons: &[GatheredPhoton], count_max: usize, key: u64) -> (Vec<Vdl>, Spread) {
    let mut vdls = Vec::new();
    let spread = Clustering::default().cluster(photons, Vec3::ZERO, count_max, key, &mut vdls);
    (vdls, spread)
}

fn white(direction: Vec3) -> GatheredPhoton {
    GatheredPhoton { direction, irradiance: Rgb::WHITE }
}

/// Channel sums in double precision.
fn sum(colors: impl Iterator<Item = Rgb>) -> [f64; 3] {
    let add = |s: [f64; 3], c: Rgb| [s[0] + f64::from(c.r), s[1] + f64::from(c.g), s[2] + f64::from(c.b)];
    colors.fold([0.0; 3], add)
}

/// What goes in comes out: irradiance is conserved channel by channel, over all counts and scales.
#[test]
fn irradiance_is_conserved() {
    for (case, scale) in [1.0f32, 1e-30, 1e-12, 1e9, 1e30].into_iter().enumerate() {
        for photon_count in [1, 2, 3, 7, 8, 9, 64, 301] {
            let mut photons = lamps(case as u64, photon_count, 5, 0.5);
            photons.iter_mut().for_each(|photon| photon.irradiance *= scale);
            for count_max in 1..=VDL_COUNT_MAX {
                let (vdls, _) = cluster(&photons, count_max, 7);
                assert!(!vdls.is_empty() && vdls.len() <= count_max.min(photons.len()));
                let before = sum(photons.iter().map(|photon| photon.irradiance));
                let after = sum(vdls.iter().map(|vdl| vdl.irradiance));
                for (before, after) in before.into_iter().zip(after) {
                    // Each light's sum is rounded once, by half a unit in 2²⁴.
                    assert!((before - after).abs() <= 6e-8 * before, "{before} {after}");
                }
            }
        }
    }
}

/// Every light has a unit direction, finite numbers, and lies within the hull of its photons' directions.
#[test]
fn lights_are_unit_vectors() {
    for key in 0..300 {
        let photons = lamps(key, 1 + key as u32, 1 + key as u32 % 9, 1.5 * point(key, 0)[0]);
        let (vdls, spread) = cluster(&photons, 1 + key as usize % 8, key);
        assert!(spread.chord_rms.is_finite() && (0.0..=2.0).contains(&spread.chord_rms));
        for vdl in vdls {
            assert!((vdl.direction.length() - 1.0).abs() < 1e-6 && vdl.irradiance.is_finite());
        }
    }
}

/// The same input gives the same bits, whatever the memory held before.
#[test]
fn memory_of_other_leaves_changes_nothing() {
    let mut used = Clustering::default();
    let mut vdls = Vec::new();
    used.cluster(&lamps(1, 500, 8, 0.4), Vec3::ZERO, 8, 1, &mut vdls);
    let before = vdls.len();
    let spread = used.cluster(&lamps(2, 100, 3, 0.4), Vec3::ZERO, 4, 2, &mut vdls);
    assert_eq!((vdls[before..].to_vec(), spread), cluster(&lamps(2, 100, 3, 0.4), 4, 2));
}

/// Photons of as many narrow lamps as there are lights come apart by lamp, whatever the first centres.
#[test]
fn narrow_lamps_are_found() {
    let directions = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::ONE.normalize()];
    for key in 0..100 {
        let photons: Vec<GatheredPhoton> = (0..200)
            .map(|index| {
                let [u, v, w, _] = point(3, index);
                let shift = 0.02 * w * sphere_point([u, v]);
                white((directions[index as usize % 4] + shift).normalize())
            })
            .collect();
        let (vdls, spread) = cluster(&photons, 4, key);
        assert_eq!(vdls.len(), 4);
        for direction in directions {
            // 50 photons each; the mean of shifts up to 0.02 is less than 0.02 away.
            let found = vdls.iter().filter(|vdl| vdl.direction.distance(direction) < 0.02);
            assert_eq!(found.map(|vdl| vdl.irradiance).collect::<Vec<_>>(), [Rgb::splat(50.0)], "{key}");
        }
        assert!(spread.chord_rms < 0.02, "{key}: {}", spread.chord_rms);
    }
}

/// One light stands at the luminance-weighted mean, with the spread about it.
#[test]
fn one_light_is_the_weighted_mean() {
    let tilted = |angle: f32| Vec3::new(angle.sin(), 0.0, angle.cos());
    let photons = [
        GatheredPhoton { direction: tilted(-0.3), irradiance: Rgb::splat(1.0) },
        GatheredPhoton { direction: tilted(0.3), irradiance: Rgb::splat(1.0) },
    ];
    let (vdls, spread) = cluster(&photons, 1, 0);
    assert!(vdls[0].direction.distance(Vec3::Z) < 1e-6);
    // Both are seen under 0.3 radians from the mean.
    assert!((spread.degrees() - 0.3f32.to_degrees()).abs() < 1e-4, "{}", spread.degrees());
    // Green outweighs blue as Rec.709 says.
    let photons = [
        GatheredPhoton { direction: Vec3::X, irradiance: Rgb::new(0.0, 1.0, 0.0) },
        GatheredPhoton { direction: Vec3::Y, irradiance: Rgb::new(0.0, 0.0, 1.0) },
    ];
    let expected = Vec3::new(0.7152, 0.0722, 0.0).normalize();
    assert!(cluster(&photons, 1, 0).0[0].direction.distance(expected) < 1e-6);
}

/// Photons of one direction are one light, at once and without spread.
#[test]
fn one_direction_is_one_light() {
    for index in 0..50 {
        let [u, v, ..] = point(5, index);
        let direction = sphere_point([u, v]);
        let (vdls, spread) = cluster(&vec![white(direction); 37], 8, 3);
        assert_eq!(vdls.len(), 1);
        assert!(vdls[0].direction.distance(direction) < 1e-6);
        assert_eq!(vdls[0].irradiance, Rgb::splat(37.0));
        assert!(spread.chord_rms < 1e-6);
    }
}

/// Fewer directions than lights give each its own light.
#[test]
fn fewer_directions_than_lights_are_kept_as_they_are() {
    for directions in 1..=5usize {
        let photons: Vec<GatheredPhoton> =
            [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y, Vec3::Z][..directions].iter().map(|d| white(*d)).collect();
        for key in 0..20 {
            let (vdls, spread) = cluster(&photons, 8, key);
            // All along a surface that faces nowhere.
            assert_eq!((vdls.len(), spread), (directions, Spread { rise: 1.0, ..Spread::default() }));
            for photon in &photons {
                assert!(vdls.iter().any(|vdl| vdl.direction == photon.direction));
            }
        }
    }
}

/// Opposite photons cancel; their one light then stands where the brighter is.
#[test]
fn opposite_directions_fall_back_on_the_brightest() {
    let mut photons = vec![white(Vec3::X), white(-Vec3::X), white(Vec3::Y), white(-Vec3::Y)];
    photons.push(GatheredPhoton { direction: Vec3::Z, irradiance: Rgb::splat(1e-5) });
    photons[3].irradiance = Rgb::splat(1.000_01);
    let (vdls, _) = cluster(&photons, 1, 0);
    assert_eq!(vdls[0].direction, -Vec3::Y);
}

/// Without light there are no lights; nor without photons.
#[test]
fn nothing_gives_no_lights() {
    let dark = GatheredPhoton { direction: Vec3::Z, irradiance: Rgb::BLACK };
    for photons in [vec![], vec![dark], vec![dark; 20]] {
        assert_eq!(cluster(&photons, 4, 1), (vec![], Spread::default()));
    }
}

/// Numbers that are none are left out and counted, and the rest is as if they had never come.
#[test]
fn unsound_photons_are_dropped_and_counted() {
    let sound = lamps(8, 40, 3, 0.2);
    let bad = [
        GatheredPhoton { direction: Vec3::NAN, irradiance: Rgb::WHITE },
        GatheredPhoton { direction: Vec3::ZERO, irradiance: Rgb::WHITE },
        GatheredPhoton { direction: Vec3::X * 1.001, irradiance: Rgb::WHITE },
        GatheredPhoton { direction: Vec3::splat(f32::MAX), irradiance: Rgb::WHITE },
        GatheredPhoton { direction: Vec3::Z, irradiance: Rgb::new(0.0, f32::NAN, 0.0) },
        GatheredPhoton { direction: Vec3::Z, irradiance: Rgb::splat(f32::INFINITY) },
        GatheredPhoton { direction: Vec3::Z, irradiance: Rgb::new(2.0, 2.0, -1.0) },
    ];
    let mixed: Vec<GatheredPhoton> = bad.iter().chain(&sound).chain(&bad).copied().collect();
    let (expected, spread) = cluster(&sound, 4, 2);
    assert_eq!(cluster(&mixed, 4, 2), (expected, Spread { dropped_count: 14, ..spread }));
    assert_eq!(cluster(&bad, 4, 2).0, []);
}

/// More lights never stand worse for the photons than one, and eight stand well: the spread about k centres of a
/// uniform sphere is that of caps of area 4π/k, √(2/k) (flat disc of radius 2/√k: rms radius √2/√k).
#[test]
fn the_spread_shrinks_with_the_root_of_the_count() {
    let photons: Vec<GatheredPhoton> = (0..512)
        .map(|index| {
            let [u, v, ..] = point(21, index);
            white(sphere_point([u, v]))
        })
        .collect();
    for count in 2..=VDL_COUNT_MAX {
        for key in 0..20 {
            let (vdls, spread) = cluster(&photons, count, key);
            assert_eq!(vdls.len(), count);
            let ideal = (2.0 / count as f32).sqrt();
            // Cells are not round, and Lloyd finds a local optimum: a quarter above at most.
            assert!(spread.chord_rms > 0.9 * ideal && spread.chord_rms < 1.25 * ideal, "{count}: {spread:?}");
        }
    }
}

/// The labels are a fixed point of Lloyd's rounds where these end early: each photon is nearest to its own light.
#[test]
fn lights_hold_the_photons_nearest_to_them() {
    for key in 0..50 {
        let photons = lamps(key, 60, 4, 0.1);
        let (vdls, _) = cluster(&photons, 3, key);
        let nearest = |photon: &GatheredPhoton| {
            let chord = |vdl: &Vdl| vdl.direction.distance_squared(photon.direction);
            (0..vdls.len()).min_by(|a, b| chord(&vdls[*a]).total_cmp(&chord(&vdls[*b])))
        };
        for (index, vdl) in vdls.iter().enumerate() {
            let members = photons.iter().filter(|photon| nearest(photon) == Some(index));
            let expected = sum(members.map(|photon| photon.irradiance));
            assert!((expected[0] - f64::from(vdl.irradiance.r)).abs() < 1e-5, "{key}");
        }
    }
}

/// A centre that loses all its members takes the photon farthest from its own.
#[test]
fn empty_centres_take_the_farthest_photon() {
    let mut clustering = Clustering::default();
    let photons = [Vec3::X, Vec3::X, Vec3::Y, Vec3::Z, -Vec3::Z].map(white);
    clustering.photons.fill(&photons, Vec3::ZERO);
    clustering.centres.count = 4;
    clustering.centres.direction = [Vec3::X; VDL_COUNT_MAX];
    // All labels are 0: three centres are empty, and three photons far away take them.
    clustering.average();
    let label = clustering.photons.blocks[0].label;
    let mut taken = label[..5].to_vec();
    taken.sort_unstable();
    taken.dedup();
    assert_eq!(taken, [0, 1, 2, 3]);
    // With one place left for each photon but none off its centre, an empty centre stays empty.
    clustering.centres.count = 8;
    clustering.average();
    clustering.average();
    assert_eq!(clustering.photons.farthest(&clustering.centres), None);
    let mut vdls = Vec::new();
    clustering.photons.emit(&clustering.centres, &mut vdls);
    assert_eq!(vdls.len(), 4);
}

/// Lengths at the edge of what passes for a unit vector neither hang the rounds nor come out in a light.
#[test]
fn nearly_unit_directions_give_unit_lights() {
    for key in 0..200 {
        let mut photons = lamps(key, 2 + key as u32 % 30, 3, 0.001);
        for (photon, index) in photons.iter_mut().zip(0..) {
            photon.direction *= 1.0 + 1.8e-4 * (point(key ^ 5, index)[0] - 0.5);
            photon.irradiance *= 10f32.powf(-40.0 * point(key ^ 6, index)[0]);
        }
        let (vdls, spread) = cluster(&photons, 8, key);
        assert_eq!(spread.dropped_count, 0);
        assert!(vdls.iter().all(|vdl| (vdl.direction.length() - 1.0).abs() < 1e-6), "{key}: {vdls:?}");
    }
}

/// One light lights surfaces of any normal like its photons, as long as all lie above the horizon: its direction is that of
/// Σ E ω / cos, not of Σ E ω.
#[test]
fn grazing_photons_count_by_what_they_bring_to_what_faces_them() {
    let at = |degrees: f32| Vec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos());
    let directions = [at(10.0), at(70.0)];
    // As much light from either.
    let photons =
        directions.map(|direction| GatheredPhoton { direction, irradiance: Rgb::splat(direction.z) });
    let mut vdls = Vec::new();
    Clustering::default().cluster(&photons, Vec3::Z, 1, 0, &mut vdls);
    assert!(vdls[0].direction.distance(at(40.0)) < 1e-5, "{}", vdls[0].direction);
    for normal in [at(0.0), at(20.0), at(-15.0), at(60.0)] {
        let of_photons: f32 = directions.iter().map(|direction| direction.dot(normal)).sum();
        let of_light = vdls[0].irradiance.r * vdls[0].direction.dot(normal) / vdls[0].direction.z;
        assert!((of_light - of_photons).abs() < 1e-4, "{normal}: {of_light}, not {of_photons}");
    }
}
