//! Laws of the film: nothing lost, nothing counted twice, and an error that says the truth.

use super::*;
use crate::math::RunningStatistics;

/// Light that comes by way of other surfaces.
const SECONDARY: [PathClass; 2] = [PathClass::Caustic, PathClass::Indirect];

/// Uniform numbers in [0, 1) by (seed, pixel, pass): SplitMix64 of the three.
fn uniform(seed: u64, x: u32, y: u32, pass_index: u32) -> f64 {
    let mut z = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (u64::from(x) << 40 | u64::from(y) << 20 | u64::from(pass_index));
    for _ in 0..2 {
        z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
    }
    (z >> 11) as f64 / (1u64 << 53) as f64
}

fn film(width: u32, height: u32) -> Film {
    Film::new(PictureSize::new(width, height).unwrap())
}

/// One pass over all tiles; `sample` gets x, y and the pass.
fn pass(film: &mut Film, sample: impl Fn(u32, u32, u32) -> PixelSample) {
    for tile in film.tiles_mut() {
        let pass_index = tile.passes();
        tile.add_pass(|x, y| sample(x, y, pass_index));
    }
}

fn grey(radiance: f64) -> PixelSample {
    let mut sample = PixelSample::BLACK;
    sample.radiance[PathClass::Direct as usize] = Rgb::splat(radiance as f32);
    sample
}

/// Distributions of mean 1, from gentle to rough, with their variances.
#[derive(Clone, Copy, Debug)]
enum Noise {
    Uniform,
    Exponential,
    /// Zero, or 20 in one sample of 20: light that is rarely found.
    Rare,
}

impl Noise {
    fn sample(self, u: f64) -> f64 {
        match self {
            Noise::Uniform => 2.0 * u,
            Noise::Exponential => -(1.0 - u).ln(),
            Noise::Rare => 20.0 * f64::from(u8::from(u < 0.05)),
        }
    }

    fn variance(self) -> f64 {
        match self {
            Noise::Uniform => 1.0 / 3.0,
            Noise::Exponential => 1.0,
            Noise::Rare => 19.0,
        }
    }
}

/// A film of grey pixels of mean 1 with `passes` samples of noise.
fn noisy_film(noise: Noise, side: u32, passes: u32, seed: u64) -> Film {
    let mut film = film(side, side);
    for _ in 0..passes {
        pass(&mut film, |x, y, p| grey(noise.sample(uniform(seed, x, y, p))));
    }
    film
}

/// Tiles cover every pixel of every size exactly once and images are in row order.
#[test]
fn every_pixel_belongs_to_one_tile_and_one_place() {
    for (width, height) in [(1, 1), (16, 16), (17, 33), (250, 3), (3, 250)] {
        let mut film = film(width, height);
        pass(&mut film, |x, y, _| grey(f64::from(y * width + x + 1)));
        let expected: Vec<Rgb> = (1..=width * height).map(|i| Rgb::splat(i as f32)).collect();
        assert_eq!(film.radiance(), expected, "{width}×{height}");
        assert_eq!(film.sample_count(), u64::from(width * height));
        assert_eq!(film.passes_min(), 1);
    }
}

/// Sizes outside the range are refused and say so.
#[test]
fn empty_and_giant_sizes_are_refused() {
    for (width, height) in [(0, 1), (1, 0), (PictureSize::SIDE_MAX + 1, 1), (1, u32::MAX)] {
        let error = PictureSize::new(width, height).unwrap_err();
        assert!(error.to_string().contains("16384"), "{error}");
    }
    assert!(PictureSize::new(PictureSize::SIDE_MAX, 1).is_ok());
}

/// The layers add up to the picture.
#[test]
fn layers_add_up_to_the_radiance() {
    let mut film = film(20, 20);
    for _ in 0..5 {
        pass(&mut film, |x, y, p| PixelSample {
            radiance: std::array::from_fn(|class| {
                std::array::from_fn(|channel| uniform((class * 3 + channel) as u64, x, y, p) as f32).into()
            }),
            ..PixelSample::BLACK
        });
    }
    let layers = PathClass::ALL.map(|class| film.layer(class));
    for (index, total) in film.radiance().iter().enumerate() {
        let sum = layers.iter().fold(Rgb::BLACK, |sum, layer| sum + layer[index]);
        // Four roundings of layers and three of additions, each at most 2⁻²⁴ of the sum.
        assert!((sum - *total).map(f32::abs).max_component() <= 7.0 * 2f32.powi(-24) * total.max_component());
    }
}

/// A pass that ends between two tiles leaves every pixel the mean of its own samples.
#[test]
fn a_cancelled_pass_leaves_means() {
    let mut film = film(40, 40);
    for _ in 0..3 {
        pass(&mut film, |_, _, p| grey(f64::from(p)));
    }
    for tile in &mut film.tiles_mut()[..4] {
        let pass_index = tile.passes();
        tile.add_pass(|_, _| grey(f64::from(pass_index)));
    }
    assert_eq!(film.passes_min(), 3);
    assert_eq!(film.sample_count(), 3 * 1600 + 3 * 256 + 8 * 16);
    let radiance = film.radiance();
    assert_eq!(radiance[0], Rgb::splat(1.5));
    assert_eq!(radiance[1599], Rgb::splat(1.0));
    assert!(film.measured_error().is_some());
}

/// Light that is less well known counts for two passes beside better light, light from before an edit for none; direct light
/// stays.
#[test]
fn outdated_light_counts_for_two_passes() {
    let of = |radiance: f32| {
        let mut sample = grey(3.0);
        sample.radiance[PathClass::Indirect as usize] = Rgb::splat(radiance);
        sample
    };
    let mut film = film(20, 20);
    (0..8).for_each(|_| pass(&mut film, |_, _, _| of(5.0)));
    film.outdate(&SECONDARY, Outdated::Rough);
    film.outdate(&SECONDARY, Outdated::Rough);
    assert!(film.layer(PathClass::Indirect).iter().all(|value| value.r == 5.0), "until there is better");
    pass(&mut film, |_, _, _| of(2.0));
    let near = |value: f32, expected: f32| (value - expected).abs() < 1e-6 * expected;
    assert!(film.layer(PathClass::Indirect).iter().all(|value| near(value.r, (2.0 * 5.0 + 2.0) / 3.0)));
    (0..7).for_each(|_| pass(&mut film, |_, _, _| of(2.0)));
    assert!(
        film.layer(PathClass::Indirect).iter().all(|value| near(value.r, (2.0 * 5.0 + 8.0 * 2.0) / 10.0))
    );
    assert!(film.layer(PathClass::Direct).iter().all(|value| near(value.r, 3.0)));
    assert_eq!(film.measured_error(), None);
    // One pass that is outdated at once stays what it is.
    let mut film = self::film(4, 4);
    pass(&mut film, |_, _, _| of(5.0));
    film.outdate(&SECONDARY, Outdated::Rough);
    pass(&mut film, |_, _, _| of(2.0));
    assert!(film.layer(PathClass::Indirect).iter().all(|value| near(value.r, 3.5)));
    // Light from before an edit leaves nothing behind, whatever was said of it later.
    film.outdate(&SECONDARY, Outdated::Wrong);
    film.outdate(&SECONDARY, Outdated::Rough);
    pass(&mut film, |_, _, _| of(1.0));
    assert!(film.layer(PathClass::Indirect).iter().all(|value| value.r == 1.0));
    assert!(film.layer(PathClass::Direct).iter().all(|value| near(value.r, 3.0)));
}

/// Direct light is replaced as well where somebody says so: then all that was scattered is of the passes since, and what is seen straight of all.
#[test]
fn all_that_is_scattered_is_replaced() {
    let of = |emitted: f32, scattered: f32| {
        let mut sample = PixelSample::BLACK;
        for class in PathClass::SEEN {
            sample.radiance[class as usize] = Rgb::splat(emitted);
        }
        for class in SCATTERED {
            sample.radiance[class as usize] = Rgb::splat(scattered);
        }
        sample
    };
    let mut film = film(20, 20);
    pass(&mut film, |_, _, _| of(1.0, 9.0));
    film.outdate(&SCATTERED, Outdated::Wrong);
    assert!(film.layer(PathClass::Direct).iter().all(|value| value.r == 9.0), "until there is better");
    (0..3).for_each(|_| pass(&mut film, |_, _, _| of(3.0, 2.0)));
    for class in SCATTERED {
        assert!(film.layer(class).iter().all(|value| value.r == 2.0), "{}", class.name());
    }
    for class in PathClass::SEEN {
        assert!(film.layer(class).iter().all(|value| value.r == 2.5), "{}", class.name());
    }
    assert!(film.radiance().iter().all(|value| (value.r - 11.0).abs() < 1e-5));
    // What is left spreads as if the pass before had never been.
    for passes in [1, 2, 3, 8] {
        let scattered = |x, y, p| of(0.0, uniform(7, x, y, p) as f32);
        let [mut kept, mut alone] = [(); 2].map(|()| self::film(20, 20));
        pass(&mut kept, |_, _, _| of(0.0, 9.0));
        kept.outdate(&SCATTERED, Outdated::Wrong);
        (1..=passes).for_each(|p| pass(&mut kept, |x, y, _| scattered(x, y, p)));
        (1..=passes).for_each(|p| pass(&mut alone, |x, y, _| scattered(x, y, p)));
        assert_eq!(kept.radiance(), alone.radiance());
        for (kept, alone) in kept.variance().into_iter().zip(alone.variance()) {
            assert!((kept - alone).abs() <= 1e-6 * alone, "{passes}: {kept} for {alone}");
        }
        assert!(passes < 2 || kept.variance().iter().all(|variance| *variance > 0.0));
    }
}

/// Light of one class is replaced and that of the other stays, however often.
#[test]
fn classes_are_outdated_by_themselves() {
    let of = |caustic: f32, indirect: f32| {
        let mut sample = grey(1.0);
        sample.radiance[PathClass::Caustic as usize] = Rgb::splat(caustic);
        sample.radiance[PathClass::Indirect as usize] = Rgb::splat(indirect);
        sample
    };
    let mut film = film(5, 3);
    (0..6).for_each(|_| pass(&mut film, |_, _, _| of(4.0, 8.0)));
    film.outdate(&[PathClass::Indirect], Outdated::Wrong);
    (0..2).for_each(|_| pass(&mut film, |_, _, _| of(8.0, 2.0)));
    let is = |film: &Film, class, expected: f32| {
        film.layer(class).iter().all(|value| (value.r - expected).abs() < 1e-6)
    };
    assert!(is(&film, PathClass::Caustic, 5.0) && is(&film, PathClass::Indirect, 2.0));
    assert!(film.radiance().iter().all(|value| (value.r - (1.0 + 5.0 + 2.0)).abs() < 1e-6));
    film.outdate(&[PathClass::Caustic], Outdated::Rough);
    (0..2).for_each(|_| pass(&mut film, |_, _, _| of(3.0, 2.0)));
    assert!(is(&film, PathClass::Caustic, 4.0) && is(&film, PathClass::Indirect, 2.0));
}

/// Albedo counts misses as black; normal and depth are those of the samples that hit.
#[test]
fn first_hit_layers_are_means_over_what_was_hit() {
    let mut film = film(2, 1);
    for _ in 0..4 {
        pass(&mut film, |x, _, p| match (x, p % 2) {
            (0, 0) => PixelSample {
                albedo: Rgb::splat(0.5),
                normal: if p == 0 { Vec3::X } else { Vec3::Y },
                depth_m: 3.0 + p as f32,
                ..PixelSample::BLACK
            },
            _ => PixelSample::BLACK,
        });
    }
    assert_eq!(film.albedo(), [Rgb::splat(0.25), Rgb::BLACK]);
    assert!(film.normal()[0].distance(Vec3::new(1.0, 1.0, 0.0).normalize()) < 1e-6);
    assert_eq!(film.normal()[1], Vec3::ZERO);
    assert_eq!(film.depth(), [4.0, 0.0]);
}

/// Broken samples are black, counted, and touch no other sample.
#[test]
fn broken_samples_are_dropped_and_counted() {
    let broken = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1e-9, f32::MAX];
    let mut film = film(1, 1);
    for value in broken {
        pass(&mut film, |_, _, _| grey(f64::from(value)));
        pass(&mut film, |_, _, _| PixelSample { albedo: Rgb::splat(-value.abs()), ..grey(4.0) });
    }
    pass(&mut film, |_, _, _| PixelSample { depth_m: f32::NAN, ..grey(4.0) });
    pass(&mut film, |_, _, _| PixelSample { normal: Vec3::NAN, ..grey(4.0) });
    let beyond = Beyond { albedo: Rgb::WHITE, normal: Vec3::X };
    for broken in [Beyond { albedo: Rgb::splat(f32::NAN), ..beyond }, Beyond { normal: Vec3::NAN, ..beyond }]
    {
        pass(&mut film, |_, _, _| PixelSample { beyond: Some(broken), ..grey(4.0) });
    }
    assert_eq!(film.dropped_samples(), 14);
    assert_eq!(film.tiles()[0].beyond(0), None);
    for _ in 0..14 {
        pass(&mut film, |_, _, _| grey(2.0));
    }
    assert_eq!(film.radiance(), [Rgb::splat(1.0)]);
    assert_eq!(film.dropped_samples(), 14);
}

/// The measured relMSE is on average the true one, for even and odd numbers of passes, also while most pixels
/// are far from their mean.
#[test]
fn measured_error_is_unbiased() {
    for noise in [Noise::Uniform, Noise::Exponential, Noise::Rare] {
        for passes in [16, 17, 200, 201] {
            let mut ratio = RunningStatistics::default();
            for seed in 0..40 {
                let measured = noisy_film(noise, 24, passes, seed).measured_error().unwrap();
                let truth = noise.variance() / f64::from(passes) / 1.01;
                ratio.add(measured.rel_mse / truth);
            }
            // With a relative variance v = σ²/n per pixel, the mean of 24 neighbours (8 at corners: about 22 in
            // the mean) has v/22, and E[1/m²] ≈ 1 + 3v/22. On top, 4 standard errors.
            let weights = 3.0 * noise.variance() / f64::from(passes) / 22.0;
            let allowed = 1.5 * weights + 4.0 * ratio.standard_error();
            assert!((ratio.mean() - 1.0).abs() < allowed, "{noise:?} {passes}: {}", ratio.mean());
        }
    }
}

/// Detail finer than the 5 × 5 neighbourhood is weighed by itself: by the mean around, equal relative noise on a chequered
/// picture of 1 and 3 would read √1.25 of the truth, (1/2² + 3²/2²)/2 = 1.25.
#[test]
fn fine_patterns_of_one_to_three_read_as_they_are() {
    let mut ratio = RunningStatistics::default();
    for seed in 0..20 {
        let mut film = film(24, 24);
        for _ in 0..200 {
            pass(&mut film, |x, y, p| {
                let brightness = if (x + y) % 2 == 0 { 1.0 } else { 3.0 };
                grey(brightness * Noise::Uniform.sample(uniform(seed, x, y, p)))
            });
        }
        ratio.add(film.measured_error().unwrap().rel_mse / (Noise::Uniform.variance() / 200.0));
    }
    // One but for the floor of 1 % of the mean's square; 4 standard errors.
    let expected = 0.5 * (1.0 / 1.04 + 9.0 / 9.04);
    let allowed = 0.03 + 4.0 * ratio.standard_error();
    assert!((ratio.mean() - expected).abs() < allowed, "{} for {expected}", ratio.mean());
}

/// A weighting of the halves that were wrong by one pass would show at three passes at the latest.
#[test]
fn squared_error_is_unbiased_for_the_smallest_odd_count() {
    for passes in [2, 3, 5] {
        let mut squared = RunningStatistics::default();
        for seed in 0..50 {
            let film = noisy_film(Noise::Exponential, 16, passes, seed);
            let pixels = film.tiles()[0].pixels.iter();
            pixels.for_each(|pixel| squared.add(pixel.squared_error_of_mean(film.tiles()[0].held())[0]));
        }
        let z = (squared.mean() - 1.0 / f64::from(passes)) / squared.standard_error();
        assert!(z.abs() < 4.0, "{passes} passes: z = {z}");
    }
}

/// The 95 % interval holds the true relMSE in at least 95 % of pictures (more here: an even picture has no detail
/// that the weights could be wrong about), at few samples too.
#[test]
fn interval_holds_the_true_error_as_often_as_it_says() {
    const PICTURES: u64 = 200;
    for (noise, passes) in [(Noise::Uniform, 16), (Noise::Exponential, 256), (Noise::Rare, 256)] {
        let truth = noise.variance() / f64::from(passes) / 1.01;
        let held = (0..PICTURES).filter(|seed| {
            let film = noisy_film(noise, 24, passes, 1000 + seed);
            let [low, high] = film.measured_error().unwrap().interval_95;
            low <= truth && truth <= high
        });
        let share = held.count() as f64 / PICTURES as f64;
        // Binomial standard deviation √(0.95·0.05/200) = 1.5 %; 3 of them.
        assert!(share >= 0.95 - 0.046, "{noise:?}: {share}");
    }
}

/// What the film says of itself is what a comparison with the truth says.
#[test]
fn measured_error_agrees_with_the_error_against_the_truth() {
    let film = noisy_film(Noise::Exponential, 64, 100, 7);
    let measured = film.measured_error().unwrap();
    let true_error = compare(&film.radiance(), &[Rgb::WHITE; 64 * 64]).unwrap();
    let [low, high] = measured.interval_95;
    assert!(low < true_error.rel_mse && true_error.rel_mse < high, "{measured:?} {true_error:?}");
    assert!(measured.trimmed.unwrap() < measured.rel_mse);
    assert!((measured.error().powi(2) - measured.rel_mse).abs() < 1e-12);
}

/// Nothing can be said of fewer than two passes, or of a black picture before its 64th; then it is black.
#[test]
fn no_error_is_measured_without_two_passes_or_light() {
    let mut film = film(20, 20);
    assert_eq!(film.measured_error(), None);
    pass(&mut film, |_, _, _| grey(1.0));
    assert_eq!(film.measured_error(), None);
    pass(&mut film, |_, _, _| grey(1.0));
    let error = film.measured_error().unwrap();
    assert_eq!((error.rel_mse, error.interval_95, error.trimmed), (0.0, [0.0, 0.0], Some(0.0)));
    let mut black = self::film(20, 20);
    (0..2).for_each(|_| pass(&mut black, |_, _, _| PixelSample::BLACK));
    assert_eq!(black.measured_error(), None);
    (2..64).for_each(|_| pass(&mut black, |_, _, _| PixelSample::BLACK));
    assert_eq!(black.measured_error().map(|error| error.rel_mse), Some(0.0));
}

/// The variance layer is on average the variance of the mean luminance.
#[test]
fn variance_is_that_of_the_mean() {
    let mut film = film(64, 64);
    pass(&mut film, |x, y, p| grey(Noise::Exponential.sample(uniform(3, x, y, p))));
    assert!(film.variance().iter().all(|variance| *variance == 0.0));
    for _ in 1..50 {
        pass(&mut film, |x, y, p| grey(Noise::Exponential.sample(uniform(3, x, y, p))));
    }
    let mut variance = RunningStatistics::default();
    film.variance().iter().for_each(|value| variance.add(f64::from(*value)));
    let z = (variance.mean() - 1.0 / 50.0) / variance.standard_error();
    assert!(z.abs() < 4.0, "z = {z}");
}

/// One very bright sample, or very many samples, lose none of the light of the others.
#[test]
fn sums_hold_a_million_passes() {
    const PASSES: u32 = 1_000_000;
    let mut film = film(1, 1);
    let lit = PixelSample {
        albedo: Rgb::splat(0.1),
        normal: Vec3::new(0.6, 0.0, 0.8),
        depth_m: 123.4,
        ..grey(0.01)
    };
    pass(&mut film, |_, _, _| PixelSample { radiance: grey(1e6).radiance, ..lit });
    for _ in 1..PASSES {
        pass(&mut film, |_, _, _| lit);
        if film.passes_min() == 100_000 {
            // The single-precision sums of the guides, at the count that the type's comment names.
            assert!((film.depth()[0] / 123.4 - 1.0).abs() < 1e-3, "{}", film.depth()[0]);
            assert!((film.albedo()[0].r / 0.1 - 1.0).abs() < 1e-3, "{:?}", film.albedo()[0]);
            assert!(film.normal()[0].distance(lit.normal) < 1e-3);
        }
    }
    let expected = (1e6 + 0.01 * f64::from(PASSES - 1)) / f64::from(PASSES);
    assert!((f64::from(film.radiance()[0].r) / expected - 1.0).abs() < 1e-6, "{:?}", film.radiance());
}

/// The memory is what the documentation says.
#[test]
fn a_pixel_takes_184_bytes() {
    assert_eq!(Film::BYTES_PER_PIXEL, 184);
    let film = film(100, 100);
    let held: usize = film.tiles().iter().map(|tile| tile.pixels.capacity() * size_of::<Pixel>()).sum();
    assert_eq!(held, 100 * 100 * 184);
    assert!(film.bytes() >= held && film.bytes() < held + held / 100);
}

/// What is beyond mirrors is the mean of the samples that note it, where those are half of all; it takes memory in tiles that have any.
#[test]
fn what_is_beyond_is_a_mean_of_half_the_samples_or_more() {
    let mut film = film(40, 16);
    let without = film.bytes();
    for count in 1..=5 {
        // In the first tile alone; the second pixel from the third pass on, the third in every other.
        pass(&mut film, |x, y, p| {
            let is_noted = match (x, y) {
                (0, 0) => true,
                (1, 0) => p >= 2,
                (2, 0) => p % 2 == 1,
                _ => false,
            };
            let albedo = Rgb::splat(p as f32);
            let beyond = Beyond { albedo, normal: if p == 0 { Vec3::X } else { Vec3::Y } };
            PixelSample { beyond: is_noted.then_some(beyond), ..grey(1.0) }
        });
        let found = [0, 1, 2, 3].map(|index| film.tiles()[0].beyond(index).map(|beyond| beyond.albedo.r));
        let expected = match count {
            1 => [Some(0.0), None, None, None],
            2 => [Some(0.5), None, Some(1.0), None],
            3 => [Some(1.0), None, None, None],
            4 => [Some(1.5), Some(2.5), Some(2.0), None],
            _ => [Some(2.0), Some(3.0), None, None],
        };
        assert_eq!(found, expected, "{count}");
    }
    let normal = film.tiles()[0].beyond(0).unwrap().normal;
    assert!(normal.distance(Vec3::new(1.0, 4.0, 0.0).normalize()) < 1e-6, "{normal}");
    assert_eq!(film.bytes(), without + 16 * 16 * Film::BYTES_BEYOND);
    // Of what nobody filters nothing is kept.
    let mut unfiltered = Film::unfiltered(film.size());
    let beyond = Beyond { albedo: Rgb::WHITE, normal: Vec3::X };
    pass(&mut unfiltered, |_, _, _| PixelSample { beyond: Some(beyond), ..grey(1.0) });
    assert_eq!((unfiltered.tiles()[0].beyond(0), unfiltered.bytes()), (None, without));
    assert_eq!(film.albedo()[0], grey(1.0).albedo);
}

/// After light was replaced the noise is that of the passes since, whatever was there before, and of odd counts too.
#[test]
fn noise_is_that_of_the_passes_since_light_was_replaced() {
    for (before, since) in [(7, 2), (7, 5), (8, 4)] {
        let mut noise = RunningStatistics::default();
        for seed in 0..40 {
            let mut film = film(24, 24);
            let indirect = |radiance: f64| {
                let mut sample = PixelSample::BLACK;
                sample.radiance[PathClass::Indirect as usize] = Rgb::splat(radiance as f32);
                sample
            };
            // The halves before are far apart.
            (0..before).for_each(|_| pass(&mut film, |_, _, p| indirect(f64::from(5 * (p % 2)))));
            film.outdate(&SECONDARY, Outdated::Wrong);
            let sample = |x, y, p| indirect(Noise::Uniform.sample(uniform(seed, x, y, p)));
            (0..since).for_each(|_| pass(&mut film, sample));
            assert_eq!(film.measured_error(), None);
            let (found, passes) = film.noise().unwrap();
            assert_eq!(passes, since);
            noise.add(found.rel_mse);
        }
        // 1 / (1 + 0.01) for the floor; the weights are noisy at so few passes: up to a tenth.
        let expected = Noise::Uniform.variance() / f64::from(since) / 1.01;
        assert!((noise.mean() / expected - 1.0).abs() < 0.1, "{} for {expected}", noise.mean());
    }
}
