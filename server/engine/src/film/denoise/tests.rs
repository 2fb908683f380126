use std::ops::Range;

use super::*;
use crate::{
    film::{Beyond, Film, Outdated, Picture, PictureSize, PixelSample},
    math::sobol::PixelSampler,
};

const WIDTH: u32 = 64;
const HEIGHT: u32 = 48;

/// A grey sheet, faced straight.
fn sheet(radiance: f32) -> PixelSample {
    let mut sample =
        PixelSample { albedo: Rgb::splat(0.5), normal: Vec3::Z, depth_m: 2.0, ..PixelSample::BLACK };
    sample.radiance[PathClass::Direct as usize] = Rgb::splat(0.4 * radiance);
    sample.radiance[PathClass::Indirect as usize] = Rgb::splat(0.6 * radiance);
    sample
}

fn film_of(size: PictureSize, passes: u32, sample: impl Fn(u32, u32, u32) -> PixelSample) -> Film {
    let mut film = Film::new(size);
    for pass in 0..passes {
        film.tiles_mut().iter_mut().for_each(|tile| tile.add_pass(|x, y| sample(x, y, pass)));
    }
    film
}

fn size() -> PictureSize {
    PictureSize::new(WIDTH, HEIGHT).unwrap()
}

/// From 0 to 2, evenly, in the mean 1.
fn noise(x: u32, y: u32, pass: u32) -> f32 {
    let [u, ..] = PixelSampler::new(7, pass, y * WIDTH + x, 0).four(0);
    2.0 * u
}

fn denoised(film: &Film) -> Vec<Rgb> {
    Picture::of(film).denoised(&Denoising::default()).radiance()
}

/// Mean of (value − truth)² over the columns.
fn squared_error(image: &[Rgb], columns: Range<u32>, truth: f32) -> f64 {
    let is_meant = |index: &usize| columns.contains(&(*index as u32 % WIDTH));
    let errors: Vec<f64> =
        (0..image.len()).filter(is_meant).map(|index| f64::from(image[index].g - truth).powi(2)).collect();
    errors.iter().sum::<f64>() / errors.len() as f64
}

/// On an evenly lit sheet nearly all noise goes, nothing of the light with it, and what is left is told.
#[test]
fn noise_goes_where_light_is_even() {
    for passes in [2, 4, 16, 64] {
        let film = film_of(size(), passes, |x, y, pass| sheet(noise(x, y, pass)));
        let denoising = Denoising::default();
        let picture = Picture::of(&film).denoised(&denoising);
        let (before, after) = (film.radiance(), picture.radiance());
        let [raw, left] = [&before, &after].map(|image| squared_error(image, 0..WIDTH, 1.0));
        assert!(left < 0.15 * raw, "{passes} passes: {left} of {raw}");
        let mean =
            |image: &[Rgb]| image.iter().map(|colour| f64::from(colour.g)).sum::<f64>() / image.len() as f64;
        assert!(
            (mean(&after) - mean(&before)).abs() < 0.01,
            "{passes}: {} for {}",
            mean(&after),
            mean(&before)
        );
        let told = picture.noise_left();
        assert!((0.7 * left..1.8 * left).contains(&(told * raw)), "{passes}: {told} told of {}", left / raw);
    }
}

/// Noise of lamps that are in view is left, and told with what is left of the rest.
#[test]
fn noise_of_lamps_in_view_is_told_as_left() {
    let film = film_of(size(), 16, |x, y, pass| {
        let noise = noise(x, y, pass);
        if x < WIDTH / 2 {
            return sheet(noise);
        }
        let mut sample = PixelSample { is_shining: true, ..sheet(0.0) };
        sample.radiance[PathClass::Emitted as usize] = Rgb::splat(noise);
        sample
    });
    let denoising = Denoising::default();
    let picture = Picture::of(&film).denoised(&denoising);
    let [raw, left] = [film.radiance(), picture.radiance()].map(|image| squared_error(&image, 0..WIDTH, 1.0));
    let told = picture.noise_left();
    assert!((0.9..1.1).contains(&(told * raw / left)), "{told} told of {}", left / raw);
}

/// Of a single pass nothing is known of the noise but how light differs around.
#[test]
fn one_pass_is_smoothed_by_what_lies_around() {
    let film = film_of(size(), 1, |x, y, pass| sheet(noise(x, y, pass)));
    let [raw, left] = [film.radiance(), denoised(&film)].map(|image| squared_error(&image, 0..WIDTH, 1.0));
    assert!(left < 0.25 * raw, "{left} of {raw}");
    assert_eq!(Picture::of(&film).denoised(&Denoising::default()).noise_left(), 1.0);
}

/// Light does not go over to another surface, whatever tells them apart, however noisy it is.
#[test]
fn light_stays_on_its_surface() {
    let turned = |sample: &mut PixelSample| sample.normal = Vec3::X;
    let farther = |sample: &mut PixelSample| sample.depth_m = 2.4;
    let darker = |sample: &mut PixelSample| sample.albedo = Rgb::splat(0.1);
    // In mirrors too, which are one surface themselves.
    let mirrored = Beyond { albedo: Rgb::splat(0.4), normal: Vec3::Y };
    let turned_beyond =
        |sample: &mut PixelSample| sample.beyond = Some(Beyond { normal: Vec3::X, ..mirrored });
    let darker_beyond =
        |sample: &mut PixelSample| sample.beyond = Some(Beyond { albedo: Rgb::splat(0.1), ..mirrored });
    type Edge<'a> = &'a dyn Fn(&mut PixelSample);
    for (name, beyond, edge) in [
        ("normal", None, &turned as Edge<'_>),
        ("depth", None, &farther),
        ("albedo", None, &darker),
        ("normal in a mirror", Some(mirrored), &turned_beyond),
        ("albedo in a mirror", Some(mirrored), &darker_beyond),
    ] {
        let film = film_of(size(), 2, |x, y, pass| {
            let is_other = x >= WIDTH / 2;
            let light = sheet(noise(x, y, pass) * if is_other { 0.2 } else { 1.0 });
            let mut sample = PixelSample { beyond, ..light };
            if is_other {
                edge(&mut sample);
            }
            sample
        });
        let image = denoised(&film);
        let beside = |column: u32| {
            let column = (0..HEIGHT).map(|y| f64::from(image[(y * WIDTH + column) as usize].g));
            column.sum::<f64>() / f64::from(HEIGHT)
        };
        let [bright, dark] = [beside(WIDTH / 2 - 1), beside(WIDTH / 2)];
        assert!((bright - 1.0).abs() < 0.12 && (dark - 0.2).abs() < 0.03, "{name}: {bright}, {dark}");
    }
}

/// Shadows that samples tell from noise stay as they are when looked-up light is replaced, which says nothing of them.
#[test]
fn shadows_outlast_light_that_is_replaced() {
    // Stripes two pixels wide, in light and in shadow by four of five samples.
    let is_lit = |x: u32| (x / 2).is_multiple_of(2);
    let sample = |x: u32, y: u32, pass: u32| {
        let mut sample = sheet(0.0);
        let comes = noise(x, y, pass) < if is_lit(x) { 1.6 } else { 0.4 };
        sample.radiance[PathClass::Direct as usize] = Rgb::splat(f32::from(u8::from(comes)));
        sample.radiance[PathClass::Indirect as usize] = Rgb::splat(0.02);
        sample
    };
    let error = |film: &Film| {
        let image = denoised(film);
        let columns =
            (0..WIDTH).map(|x| squared_error(&image, x..x + 1, if is_lit(x) { 0.82 } else { 0.22 }));
        columns.sum::<f64>() / f64::from(WIDTH)
    };
    let mut film = film_of(size(), 64, sample);
    let before = error(&film);
    film.outdate(&[PathClass::Indirect], Outdated::Rough);
    for pass in 64..66 {
        film.tiles_mut().iter_mut().for_each(|tile| tile.add_pass(|x, y| sample(x, y, pass)));
    }
    let after = error(&film);
    assert!(after < 1.2 * before, "{after} for {before}");
}

/// The edge of a shadow on one sheet is blurred while samples are few, and no more once they tell it from noise.
#[test]
fn what_is_known_is_left_alone() {
    let shadow = |x: u32| if x < WIDTH / 2 { 1.0 } else { 0.5 };
    let change_with = |passes: u32| {
        let film = film_of(size(), passes, |x, y, pass| sheet(shadow(x) * noise(x, y, pass)));
        let image = denoised(&film);
        // Of the two columns at the edge.
        let [bright, dark] = [(WIDTH / 2 - 1, 1.0), (WIDTH / 2, 0.5)]
            .map(|(column, truth)| squared_error(&image, column..column + 1, truth).sqrt());
        bright + dark
    };
    let [few, many, most] = [4, 64, 1024].map(change_with);
    assert!(few > 3.0 * many && many > 2.0 * most && most < 0.03, "{few}, {many}, {most}");
}

/// A picture without noise stays as it is, but for the last bit; so does light of emitters that are seen straight, however
/// noisy.
#[test]
fn without_noise_nothing_changes() {
    let still =
        film_of(size(), 8, |x, y, _| sheet(1.0 + 0.3 * (0.4 * x as f32).sin() * (0.3 * y as f32).cos()));
    for (before, after) in still.radiance().iter().zip(denoised(&still)) {
        assert!((before.g - after.g).abs() <= 1e-6, "{before:?} {after:?}");
    }
    let shining = film_of(size(), 8, |x, y, pass| {
        let mut sample = PixelSample { is_shining: true, ..sheet(1.0) };
        sample.radiance[PathClass::Emitted as usize] = Rgb::splat(noise(x, y, pass));
        sample
    });
    let picture = Picture::of(&shining).denoised(&Denoising::default());
    assert_eq!(picture.layer(PathClass::Emitted), shining.layer(PathClass::Emitted));
    let [told, before] = [picture.variance(), shining.variance()];
    assert!(
        told.iter().zip(before).all(|(told, before)| (told - before).abs() <= 1e-6 * before),
        "none is taken off"
    );
    for (before, after) in shining.radiance().iter().zip(picture.radiance()) {
        assert!((before.g - after.g).abs() <= 1e-6);
    }
}

/// A lamp in a gloss, which one sample in ten finds, is smoothed; beside it the lamp itself stays as sharp as it was.
#[test]
fn lamps_in_glosses_are_smoothed_and_lamps_are_not() {
    let is_lamp = |x: u32| x >= 3 * WIDTH / 4;
    let film = film_of(size(), 16, |x, y, pass| {
        let mut sample = PixelSample { is_shining: is_lamp(x), ..sheet(0.0) };
        let found = f32::from(u8::from(noise(x, y, pass) < 0.2));
        let shining = if is_lamp(x) { 100.0 } else { 10.0 * found };
        sample.radiance[PathClass::Emitted as usize] = Rgb::splat(shining);
        sample
    });
    let image = denoised(&film);
    let gloss = 0..3 * WIDTH / 4;
    let [raw, left] = [&film.radiance(), &image].map(|image| squared_error(image, gloss.clone(), 1.0));
    assert!(left < 0.25 * raw, "{left} of {raw}");
    // What the gloss beside it shows may come on top, and nothing of the lamp's own goes.
    let is_sharp = |index: usize| !is_lamp(index as u32 % WIDTH) || (100.0..101.0).contains(&image[index].g);
    assert!((0..image.len()).all(is_sharp));
    let layer = Picture::of(&film).denoised(&Denoising::default()).layer(PathClass::Emitted);
    assert!(layer.iter().zip(&image).all(|(layer, all)| (layer.g - all.g).abs() <= 1e-5 * all.g));
}

/// Most of the light that one sample in forty finds is smoothed and not lost: a pixel that found it gives as those around take. Weights add up
/// to less around it, so that not all is kept: 0.78, 0.82 and 0.96; by each pixel's own deviations 0.62, 0.71 and 0.91.
#[test]
fn rare_light_is_not_lost() {
    for (passes, least) in [(4, 0.75), (8, 0.8), (32, 0.94)] {
        let film = film_of(size(), passes, |x, y, pass| {
            let found = f32::from(u8::from(noise(x, y, pass) < 0.05));
            sheet(0.05 + 40.0 * found)
        });
        let (before, after) = (film.radiance(), denoised(&film));
        let mean =
            |image: &[Rgb]| image.iter().map(|colour| f64::from(colour.g)).sum::<f64>() / image.len() as f64;
        let kept = mean(&after) / mean(&before);
        assert!((least..1.05).contains(&kept), "{passes} passes: {kept} of the light");
        let [raw, left] = [&before, &after].map(|image| squared_error(image, 0..WIDTH, 1.05));
        assert!(left < 0.4 * raw, "{passes} passes: {left} of {raw}");
    }
}

/// Two colours of one luminance are two colours.
#[test]
fn colours_of_one_luminance_do_not_mix() {
    let film = film_of(size(), 8, |x, _, _| {
        let mut sample = sheet(0.0);
        let colour =
            if x < WIDTH / 2 { Rgb::new(1.0, 0.0, 0.0) } else { Rgb::new(0.0, 0.2126 / 0.7152, 0.0) };
        sample.radiance[PathClass::Direct as usize] = colour;
        sample
    });
    assert!(
        denoised(&film).iter().zip(film.radiance()).all(|(after, before)| (after.r - before.r).abs() < 1e-6)
    );
}

/// Twice the light is twice the picture, to the last bit, and neither the largest nor the smallest numbers break it.
#[test]
fn the_unit_of_light_does_not_matter() {
    let of = |scale: f32| {
        denoised(&film_of(size(), 3, |x, y, pass| sheet(scale * noise(x, y, pass) * (1.0 + (x / 8) as f32))))
    };
    let one = of(1.0);
    for scale in [2.0, 1024.0, 1.0 / 4096.0] {
        assert!(one.iter().zip(of(scale)).all(|(one, other)| *one * scale == other), "{scale}");
    }
    for scale in [1e36, 1e-36] {
        let image = of(scale);
        assert!(image.iter().all(|colour| colour.is_finite() && colour.is_non_negative()), "{scale}");
        let far =
            one.iter().zip(image).map(|(one, other)| (other.g / scale - one.g).abs()).fold(0.0, f32::max);
        assert!(far < 1e-3, "{scale}: {far}");
    }
}

/// Numbers at their edges: what is hit at no distance, or where nothing is; albedo of zero; a spike.
#[test]
fn hostile_pixels_stay_finite() {
    let depths = [0.0, 1e-40, f32::MIN_POSITIVE, 1.0, 1e30];
    let film = film_of(size(), 4, |x, y, pass| {
        let mut sample = sheet(noise(x, y, pass));
        sample.depth_m = depths[(x % 5) as usize];
        sample.albedo = Rgb::splat([0.0, 1.0, 1e20][(y % 3) as usize]);
        if (x, y, pass) == (20, 20, 1) {
            sample.radiance[PathClass::Caustic as usize] = Rgb::splat(1e37);
        }
        sample
    });
    let picture = Picture::of(&film).denoised(&Denoising::default());
    assert!(picture.radiance().iter().all(|colour| colour.is_finite() && colour.is_non_negative()));
    assert!(picture.variance().iter().all(|variance| variance.is_finite() && *variance >= 0.0));
    assert!((0.0..=1.0).contains(&picture.noise_left()));
}

/// Pictures smaller than the filter, and films without a pass.
#[test]
fn small_pictures_and_empty_films() {
    for (width, height) in [(1, 1), (1, 5), (3, 2), (9, 1), (17, 16)] {
        let size = PictureSize::new(width, height).unwrap();
        let film = film_of(size, 4, |x, y, pass| sheet(noise(x, y, pass)));
        let image = denoised(&film);
        assert_eq!(image.len(), size.pixel_count());
        assert!(image.iter().all(|colour| colour.is_finite()), "{width} × {height}");
    }
    assert!(denoised(&Film::new(size())).iter().all(|colour| colour.is_black()));
}

/// The layers add up to the whole, and threads change nothing.
#[test]
fn layers_add_up_on_any_number_of_threads() {
    let film = film_of(size(), 3, |x, y, pass| {
        let mut sample = sheet(noise(x, y, pass));
        sample.radiance[PathClass::Caustic as usize] = Rgb::new(0.1 * noise(y, x, pass), 0.2, 0.0);
        sample
    });
    let draw = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let picture = Picture::of(&film).denoised(&Denoising::default());
            (picture.radiance(), PathClass::ALL.map(|class| picture.layer(class)))
        })
    };
    let (whole, layers) = draw(1);
    for (index, whole) in whole.iter().enumerate() {
        let sum = layers.iter().fold(Rgb::BLACK, |sum, layer| sum + layer[index]);
        assert!((sum.g - whole.g).abs() < 1e-5 && (sum.r - whole.r).abs() < 1e-5);
    }
    assert_eq!(draw(3), (whole, layers));
}

/// Samples whose albedos are sound, and whose sum is infinite: the pixel keeps its light.
#[test]
fn a_pixel_whose_albedos_overflow_keeps_its_light() {
    let film = film_of(size(), 4, |x, y, _| {
        let albedo = if (x, y) == (20, 20) { f32::MAX } else { 0.5 };
        PixelSample { albedo: Rgb::splat(albedo), ..sheet(1.0) }
    });
    for (before, after) in film.radiance().iter().zip(denoised(&film)) {
        assert!((before.g - after.g).abs() <= 1e-5, "{before:?} {after:?}");
    }
}
