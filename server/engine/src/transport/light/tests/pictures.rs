//! Lamps with a picture of what they emit.

use glam::Vec2;

use super::*;
use crate::scene::{Filter, MeshSource, TextureRef, TextureSlot};

/// A material that emits what a picture shows, texel by texel.
fn showing(stage: &mut Stage, picture: Texture) -> Id {
    let picture_id = Id::new("picture").unwrap();
    stage.builder().add_texture(picture_id.clone(), picture).unwrap();
    let mut material = Material::emitter(Rgb::WHITE);
    let of = TextureRef { filter: Filter::Nearest, ..TextureRef::new(picture_id) };
    material.textures[TextureSlot::Emission as usize] = Some(of);
    stage.material("screen", material).unwrap()
}

/// A strip of squares that look down, one above each of sixteen texels of a picture: the sixth shines, the twelfth a fifth as much, all others
/// are black. And the corners of each, clockwise seen from below.
fn strip() -> (World, [[DVec3; 4]; 16]) {
    let mut stage = Stage::default();
    let radiance = |texel: usize| match texel {
        5 => 10.0,
        11 => 2.0,
        _ => 0.0,
    };
    let texels = (0..16).map(|texel| [radiance(texel), radiance(texel), radiance(texel), 1.0]).collect();
    let picture = Texture { width: 16, height: 1, texels: Texels::Rgba32F(texels) };
    let material = showing(&mut stage, picture);
    let squares = std::array::from_fn(|i| {
        let (x, half) = (0.25 * i as f64 - 2.0, 0.1);
        [(-half, -half), (half, -half), (half, half), (-half, half)].map(|(a, b)| DVec3::new(x + a, 1.0, b))
    });
    let mut strip = MeshSource::default();
    for (i, square) in squares.iter().enumerate() {
        let one = quad(*square, &material);
        let first = strip.positions.len() as u32;
        strip.positions.extend(one.positions);
        strip.triangles.extend(one.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
        strip.texcoords[0].extend([Vec2::new((i as f32 + 0.5) / 16.0, 0.5); 4]);
        strip.primitives = one.primitives;
        strip.primitives[0].triangle_count = strip.triangles.len() as u32;
    }
    stage.place("strip", strip, DAffine3::IDENTITY).unwrap();
    (World::prepare(Arc::new(stage.finish())), squares)
}

/// Of a lamp with a picture those triangles are drawn that shine, and all of them bring what they send out.
#[test]
fn pictures_say_which_triangles_shine() {
    let (world, squares) = strip();
    let (p, n) = (DVec3::new(-0.3, 0.0, 0.2), DVec3::Y);
    let at = receiver(&world, p, n);
    let expected =
        10.0 * polygon_irradiance(&squares[5], p, n) + 2.0 * polygon_irradiance(&squares[11], p, n);
    let found = irradiance(&world, &at, 20_000);
    let off = (found.mean() - expected).abs();
    assert!(
        off < 4.0 * found.standard_error(),
        "{} ± {}, not {expected}",
        found.mean(),
        found.standard_error()
    );
    // One in sixteen would shine if all were drawn alike, and the mean be four times as uncertain.
    assert!(found.standard_error() < 0.01 * expected, "{} of {expected}", found.standard_error());
}

/// And photons leave them by what they send out.
#[test]
fn photons_leave_the_triangles_that_shine() {
    let (world, _) = strip();
    let sources = world.sources();
    assert_eq!(sources.len(), 1);
    let expected_w = std::f64::consts::PI * 0.04 * 12.0;
    let (mut sent_w, mut lost, count) = (0.0, 0, 10_000);
    for number in 0..count {
        let ([a, b, c, d], [side, ..]) = (point(1, number), point(2, number));
        let numbers = EmissionNumbers { direction: [a, b], position: [c, d], side };
        match world.emit(&sources[0], &numbers) {
            Some(photon) => sent_w += f64::from(photon.weight.g) * sources[0].power_w() / f64::from(count),
            None => lost += 1,
        }
    }
    assert!((sent_w / expected_w - 1.0).abs() < 1e-3, "{sent_w} W for {expected_w}");
    // Fourteen sixteenths are taken to emit a twentieth of the mean.
    assert!(20 * lost < count, "{lost} of {count} start where nothing shines");
    assert!((sources[0].power_w() / expected_w - 1.0).abs() < 0.1, "{} W", sources[0].power_w());
}

/// What a square shows.
#[derive(Clone, Copy)]
enum Screen {
    /// Two of 16 × 16 texels shine.
    TwoTexels,
    /// It shines everywhere, on one side twice as much.
    Gradient,
    /// One in fifty of 256 × 256 texels shines, all over it.
    Stars,
}

/// A square that looks down, with a picture; of the two texels a corner each (u along x, v along z, clockwise seen from below) and their
/// radiance.
///
/// - `copies`: other places where it stands, far off
fn screen(shows: Screen, copies: u32) -> (World, [([DVec3; 4], f64); 2]) {
    const SHINING: [(u32, f32); 2] = [(3 * 16 + 5, 10.0), (11 * 16 + 2, 2.0)];
    let mut stage = Stage::default();
    let side = if matches!(shows, Screen::Stars) { 256 } else { 16 };
    let radiance = |texel: u32| match shows {
        Screen::TwoTexels => {
            SHINING.iter().find(|(at, _)| *at == texel).map_or(0.0, |(_, radiance)| *radiance)
        }
        Screen::Gradient => 1.0 + (texel % side) as f32 / side as f32,
        Screen::Stars => f32::from(u8::from(texel.wrapping_mul(0x9e37_79b9) < u32::MAX / 50)),
    };
    let texels =
        (0..side * side).map(|texel| [radiance(texel), radiance(texel), radiance(texel), 1.0]).collect();
    let picture = Texture { width: side, height: side, texels: Texels::Rgba32F(texels) };
    let material = showing(&mut stage, picture);
    let corner = |u: f64, v: f64| DVec3::new(2.0 * u - 1.0, 1.0, 2.0 * v - 1.0);
    let square = |[u, v]: [f64; 2], side: f64| {
        [corner(u, v), corner(u + side, v), corner(u + side, v + side), corner(u, v + side)]
    };
    let mut mesh = quad(square([0.0, 0.0], 1.0), &material);
    mesh.texcoords[0] = vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
    for number in 0..copies {
        let far = DAffine3::from_translation(DVec3::new(0.0, -100.0 - f64::from(number), 0.0));
        stage.place(&format!("copy {number}"), mesh.clone(), far).unwrap();
    }
    stage.place("screen", mesh, DAffine3::IDENTITY).unwrap();
    let shining = SHINING.map(|(texel, radiance)| {
        let at = [texel % 16, texel / 16].map(|at| f64::from(at) / 16.0);
        (square(at, 1.0 / 16.0), f64::from(radiance))
    });
    (World::prepare(Arc::new(stage.finish())), shining)
}

/// A rectangle of two triangles is sampled where its picture shines, by light sampling and by photons; densities are the same for both ways
/// to a light.
#[test]
fn large_triangles_are_sampled_where_their_picture_shines() {
    let (world, shining) = screen(Screen::TwoTexels, 0);
    assert_eq!(world.lights().emissive_triangle_count(), 2);
    for (p, n) in
        [(DVec3::new(-0.3, 0.0, 0.2), DVec3::Y), (DVec3::new(-0.4, 0.9, -0.6), DVec3::new(0.6, 0.8, 0.0))]
    {
        let at = receiver(&world, p, n);
        let expected: f64 =
            shining.iter().map(|(corners, radiance)| radiance * polygon_irradiance(corners, p, n)).sum();
        let found = mean_over_samples(&world, &at, 20_000, |sample| {
            assert_densities_agree(&world, &at, sample);
            let Some((radiance, _)) = world.towards_light(&at, sample) else { return 0.0 };
            f64::from(radiance.g * sample.wi.dot(at.n_geo).max(0.0) / sample.pdf)
        });
        assert_is(&found, expected, 1e-5, "two texels");
        // Two of 256 texels shine: drawn evenly the mean would be uncertain by 11 %.
        assert!(found.standard_error() < 0.01 * expected, "{} of {expected}", found.standard_error());
    }
    let source = &world.sources()[0];
    let expected_w = std::f64::consts::PI * 4.0 / 256.0 * 12.0;
    let (mut sent_w, mut lost, count) = (0.0, 0, 20_000);
    for number in 0..count {
        let ([a, b, c, d], [side, ..]) = (point(1, number), point(2, number));
        let numbers = EmissionNumbers { direction: [a, b], position: [c, d], side };
        match world.emit(source, &numbers) {
            Some(photon) => sent_w += f64::from(photon.weight.g) * source.power_w() / f64::from(count),
            None => lost += 1,
        }
    }
    assert!((sent_w / expected_w - 1.0).abs() < 0.01, "{sent_w} W for {expected_w}");
    assert!(10 * lost < count, "{lost} of {count} start where nothing shines");
}

/// One that shines nearly everywhere, or alike all over, stays whole; and many together are cut into no more than are few beside what else a
/// scene holds.
#[test]
fn pictures_are_cut_as_far_as_is_worth_it() {
    let parts = |shows, copies| screen(shows, copies).0.lights().local.len();
    assert_eq!(parts(Screen::Gradient, 0), 2);
    assert_eq!(parts(Screen::Stars, 0), 2);
    let one = parts(Screen::TwoTexels, 0);
    assert!((128..=4096).contains(&one), "{one}");
    assert_eq!(parts(Screen::TwoTexels, 7), 8 * one);
    assert!(parts(Screen::TwoTexels, 299) <= 1 << 16);
    assert_eq!(parts(Screen::TwoTexels, 16_384), 2 * 16_385);
}
