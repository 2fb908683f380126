//! Laws of scattering: every sampler draws what it says (χ²), every lobe is reciprocal, nothing gains energy.

use glam::Vec3;

use super::*;
use crate::math::sobol::point;

fn direction(cos: f32, phi: f32) -> Vec3 {
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    Vec3::new(sin * phi.cos(), sin * phi.sin(), cos)
}

fn gltf(metallic: f32, roughness: f32) -> Bsdf {
    Bsdf::Gltf(Gltf::new(Rgb::new(0.8, 0.5, 0.2), metallic, roughness, 1.5, 1.0, Rgb::WHITE))
}

fn with_density() -> Vec<(&'static str, Bsdf)> {
    vec![
        ("lambert", Bsdf::Lambert { albedo: Rgb::splat(0.7) }),
        ("plastic, smooth", gltf(0.0, 0.0)),
        ("plastic, half rough", gltf(0.0, 0.5)),
        ("plastic, rough", gltf(0.0, 1.0)),
        ("metal, polished", gltf(1.0, 0.2)),
        ("metal, half rough", gltf(1.0, 0.5)),
        ("metal, rough", gltf(1.0, 1.0)),
        ("half metal", gltf(0.5, 0.4)),
        ("half glass", Bsdf::Glass(Glass { eta: 1.5, tint: Rgb::splat(0.9), transmission: 0.5 })),
    ]
}

/// Upper tail of the χ² distribution by the Wilson–Hilferty approximation: p-value of `chi2` at `freedom`.
fn chi2_p_value(chi2: f64, freedom: f64) -> f64 {
    let z = ((chi2 / freedom).cbrt() - (1.0 - 2.0 / (9.0 * freedom))) / (2.0 / (9.0 * freedom)).sqrt();
    // Complementary error function, Abramowitz & Stegun 7.1.26 (error below 1.5e-7).
    let x = z.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.3275911 * x);
    let poly =
        t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
    let tail = 0.5 * poly * (-x * x).exp();
    if z > 0.0 { tail } else { 1.0 - tail }
}

const COS_BINS: usize = 16;
const PHI_BINS: usize = 32;

fn bin_of(w: Vec3) -> usize {
    let cos_bin = (((w.z + 1.0) * 0.5 * COS_BINS as f32) as usize).min(COS_BINS - 1);
    let turn = (w.y.atan2(w.x) / std::f32::consts::TAU).rem_euclid(1.0);
    cos_bin * PHI_BINS + ((turn * PHI_BINS as f32) as usize).min(PHI_BINS - 1)
}

/// Directions fall into bins as often as the density says, lobe by lobe (χ², Šidák over all tests).
#[test]
fn samples_follow_their_density() {
    let wos = [direction(0.95, 0.3), direction(0.5, 2.0), direction(0.1, -1.0), direction(-0.6, 0.5)];
    let subjects = with_density();
    let tests = (subjects.len() * wos.len() * 2) as f64;
    // All tests together fail by chance once in a thousand runs; the numbers are seeded, so it is this run or none.
    let p_least = 1.0 - (1.0 - 1e-3f64).powf(1.0 / tests);
    let count = 400_000u32;
    for (name, bsdf) in &subjects {
        for wo in wos {
            for scatter in [Scatter::Diffuse, Scatter::Specular] {
                let mut seen = vec![0u32; COS_BINS * PHI_BINS];
                for i in 0..count {
                    // Numbers without stratification: χ² expects independent draws.
                    let [a, b, c, _] = point(u64::from(i) + 1, 0);
                    if let Some(sample) = bsdf.sample(wo, [a, b, c])
                        && sample.scatter == scatter
                        && sample.pdf_solid_angle.is_some()
                    {
                        seen[bin_of(sample.wi)] += 1;
                    }
                }
                let expected = expected_counts(bsdf, wo, scatter, f64::from(count));
                let (mut chi2, mut freedom, mut rest) = (0.0, -1.0, (0.0, 0.0));
                for (seen, expected) in seen.iter().zip(&expected) {
                    // Bins that expect few are pooled: χ² is a normal limit.
                    if *expected < 8.0 {
                        rest = (rest.0 + f64::from(*seen), rest.1 + expected);
                        continue;
                    }
                    chi2 += (f64::from(*seen) - expected).powi(2) / expected;
                    freedom += 1.0;
                }
                if rest.1 >= 8.0 {
                    chi2 += (rest.0 - rest.1).powi(2) / rest.1;
                    freedom += 1.0;
                }
                assert!(
                    rest.1 >= 8.0 || rest.0 < 30.0,
                    "{name} {wo} {scatter:?}: {} draws where none belong",
                    rest.0
                );
                if freedom < 1.0 {
                    continue;
                }
                // The share that is absorbed or goes to other lobes is a bin of its own: the total is not fixed.
                let p = chi2_p_value(chi2, freedom + 1.0);
                assert!(p > p_least, "{name} {wo} {scatter:?}: χ² {chi2} at {freedom} degrees, p {p}");
            }
        }
    }
}

/// Density integrated over each bin, by midpoints of a fine grid.
fn expected_counts(bsdf: &Bsdf, wo: Vec3, scatter: Scatter, count: f64) -> Vec<f64> {
    const FINE: usize = 24;
    let mut expected = vec![0.0; COS_BINS * PHI_BINS];
    let (cells_cos, cells_phi) = (COS_BINS * FINE, PHI_BINS * FINE);
    let cell_sr = 4.0 * std::f64::consts::PI / (cells_cos * cells_phi) as f64;
    for i in 0..cells_cos {
        let cos = 2.0 * (i as f32 + 0.5) / cells_cos as f32 - 1.0;
        for j in 0..cells_phi {
            let wi = direction(cos, (j as f32 + 0.5) / cells_phi as f32 * std::f32::consts::TAU);
            let value = bsdf.eval(wo, wi);
            let lobe = if scatter == Scatter::Diffuse { value.diffuse } else { value.glossy };
            expected[bin_of(wi)] += f64::from(lobe.pdf_solid_angle) * cell_sr * count;
        }
    }
    expected
}

/// A sample's weight is f cos / pdf of the very values that `eval` gives.
#[test]
fn weights_are_value_over_density() {
    for (name, bsdf) in with_density() {
        for i in 0..2000 {
            let [a, b, c, d] = point(17, i);
            let wo = direction(2.0 * d - 1.0, c * 6.0);
            let Some(sample) = bsdf.sample(wo, [a, b, c]) else { continue };
            let Some(pdf) = sample.pdf_solid_angle else { continue };
            let value = bsdf.eval(wo, sample.wi);
            let lobe = if sample.scatter == Scatter::Diffuse { value.diffuse } else { value.glossy };
            assert!(
                (lobe.pdf_solid_angle - pdf).abs() <= 2e-3 * pdf,
                "{name}: {} for {pdf}",
                lobe.pdf_solid_angle
            );
            let expected = lobe.f_cos * (1.0 / pdf);
            let off = (sample.weight - expected).map(f32::abs).max_component();
            assert!(
                off <= 4e-3 * expected.max_component() + 1e-6,
                "{name}: {:?} for {expected:?}",
                sample.weight
            );
        }
    }
}

/// f(wo, wi) = f(wi, wo) for every lobe with a density.
#[test]
fn scattering_is_reciprocal() {
    for (name, bsdf) in with_density() {
        for i in 0..2000 {
            let [a, b, c, d] = point(23, i);
            let (wo, wi) = (direction(0.02 + 0.97 * a, b * 6.0), direction(0.02 + 0.97 * c, d * 6.0));
            let f = |wo: Vec3, wi: Vec3| {
                let value = bsdf.eval(wo, wi);
                (value.diffuse.f_cos + value.glossy.f_cos) * (1.0 / wi.z)
            };
            let (there, back) = (f(wo, wi), f(wi, wo));
            let off = (there - back).map(f32::abs).max_component();
            assert!(off <= 1e-3 * there.max_component() + 1e-6, "{name}: {there:?} {back:?}");
        }
    }
}

/// Share of light from everywhere that a white surface sends towards `wo`.
fn directional_albedo(bsdf: &Bsdf, wo: Vec3) -> f64 {
    let count = 8192;
    let sum: f64 = (0..count)
        .filter_map(|i| {
            let [a, b, c, _] = point(31, i);
            bsdf.sample(wo, [a, b, c]).map(|sample| f64::from(sample.weight.max_component()))
        })
        .sum();
    sum / f64::from(count)
}

/// No surface sends out more than it receives, at any angle.
#[test]
fn no_direction_gains_energy() {
    for metallic in [0.0, 0.3, 1.0] {
        for roughness in [0.0, 0.1, 0.3, 0.6, 1.0] {
            let white = Bsdf::Gltf(Gltf::new(Rgb::WHITE, metallic, roughness, 1.5, 1.0, Rgb::WHITE));
            for cos in [0.02, 0.1, 0.3, 0.6, 1.0] {
                let albedo = directional_albedo(&white, direction(cos, 0.4));
                assert!(albedo <= 1.01, "metallic {metallic} roughness {roughness} cos {cos}: {albedo}");
            }
        }
    }
}

/// The stated loss of single scattering on a white metal, averaged over evenly arriving light.
#[test]
fn loss_of_rough_metal_is_as_stated() {
    for (roughness, stated_loss) in STATED_LOSS {
        let white = Bsdf::Gltf(Gltf::new(Rgb::WHITE, 1.0, roughness, 1.5, 0.0, Rgb::WHITE));
        // Midpoints in μ², in which evenly arriving light is even.
        let mean: f64 = (0..32)
            .map(|i| directional_albedo(&white, direction(((i as f32 + 0.5) / 32.0).sqrt(), 0.7)))
            .sum::<f64>()
            / 32.0;
        assert!((1.0 - mean - stated_loss).abs() < 0.003, "roughness {roughness}: loss {}", 1.0 - mean);
    }
}

/// (roughness, share lost), as in the module's head.
const STATED_LOSS: [(f32, f64); 4] = [(0.2, 0.006), (0.4, 0.060), (0.6, 0.197), (1.0, 0.591)];

/// Fresnel's end points: nothing at equal indices, all beyond the critical angle, the textbook value head on.
#[test]
fn fresnel_terms_meet_their_end_points() {
    use super::glass::fresnel_dielectric;
    for cos in [0.0, 1e-4, 0.3, 1.0] {
        assert_eq!(fresnel_dielectric(cos, 1.0).0, 0.0, "cos {cos}");
    }
    assert!((fresnel_dielectric(1.0, 1.5).0 - 0.04).abs() < 1e-6);
    assert_eq!(fresnel_dielectric(0.5, 1.0 / 1.5).0, 1.0);
    assert!((fresnel_dielectric(0.0, 1.5).0 - 1.0).abs() < 1e-6);
}

/// The base under a coat is Lambert's by what Schlick's terms leave both ways, normalised, whoever asks: all at once, or for the diffuse
/// lobe alone. What reflects everything leaves nothing.
#[test]
fn a_coat_passes_what_it_does_not_reflect() {
    let base_color = Rgb::new(0.2, 0.5, 0.9);
    for (ior, specular, tint) in [
        (1.5, 1.0, Rgb::WHITE),
        (1.5, 0.0, Rgb::WHITE),
        (2.4, 0.7, Rgb::new(1.0, 0.3, 0.1)),
        (1e9, 1.0, Rgb::WHITE),
    ] {
        let bsdf = Bsdf::Gltf(Gltf::new(base_color, 0.0, 0.5, ior, specular, tint));
        let f0 = f64::from(((ior - 1.0) / (ior + 1.0)).powi(2) * specular);
        let specular = f64::from(specular);
        let passing = |cos: f32| 1.0 - f0 - (specular - f0) * (1.0 - f64::from(cos)).powi(5);
        let mean = 1.0 - f0 - (specular - f0) / 21.0;
        for index in 0..200 {
            let [u, v, w, _] = point(3, index);
            let (wo, wi) = (direction(u, 0.4), direction(v, std::f32::consts::TAU * w));
            let both = passing(u) * passing(v) / mean.max(1e-6);
            let found = bsdf.eval(wo, wi).diffuse;
            assert_eq!(found.f_cos, bsdf.eval_diffuse(wo, wi).f_cos);
            assert_eq!(found.pdf_solid_angle, bsdf.eval_diffuse(wo, wi).pdf_solid_angle);
            let base = bsdf.coated_base(wo).unwrap();
            let at_once = base.scale * (base.passing(wi.z) * wi.z);
            let four = base.four_passing_around(glam::Vec4::splat(wi.z), 0.0).x;
            assert!((four - base.passing(wi.z)).abs() < 1e-6, "{four}");
            for found in [found.f_cos, at_once] {
                let expected = f64::from(base_color.g) / std::f64::consts::PI * f64::from(v) * both;
                assert!(
                    (f64::from(found.g) - expected).abs() < 1e-4 * expected + 1e-6,
                    "{found:?} for {expected}"
                );
            }
        }
    }
    for (name, bsdf) in with_density() {
        for (wo, wi) in [(0.7, 0.4), (-0.7, -0.4), (0.7, -0.4), (0.0, 0.3)] {
            let (wo, wi) = (direction(wo, 0.3), direction(wi, 2.0));
            assert_eq!(bsdf.eval(wo, wi).diffuse.f_cos, bsdf.eval_diffuse(wo, wi).f_cos, "{name}");
        }
    }
}

/// What the diffuse lobe makes of even light is the integral of its values, from either side.
#[test]
fn even_light_is_scattered_as_the_lobe_adds_up() {
    const COUNT: u32 = 1 << 14;
    for (name, bsdf) in with_density() {
        for wo in [direction(0.95, 0.3), direction(0.3, 2.0), direction(-0.6, 0.5), direction(-0.95, 0.1)] {
            if wo.z < 0.0 && !matches!(bsdf, Bsdf::Glass(_)) {
                // Only glass is met from inside.
                continue;
            }
            // Uniform over the sphere, for an irradiance of π.
            let sum = (0..COUNT).fold(Rgb::BLACK, |sum, index| {
                let [u, v, ..] = point(5, index);
                sum + bsdf.eval(wo, direction(2.0 * u - 1.0, std::f32::consts::TAU * v)).diffuse.f_cos
            });
            let expected = sum * (4.0 * std::f32::consts::PI / COUNT as f32);
            let found = bsdf.diffuse_of_even_light(wo) * std::f32::consts::PI;
            let off = (found - expected).to_array().map(f32::abs);
            assert!(off.iter().all(|off| *off < 0.01), "{name} from {wo}: {found:?} for {expected:?}");
        }
    }
}
