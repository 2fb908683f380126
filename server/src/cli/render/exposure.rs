//! Whether a picture shows what is in it, or is nearly black or white by its exposure.

use lumicast_engine::math::Rgb;

use super::arguments::EXPOSURE_MAX;

/// What a picture's middle pixel is to shine with after exposure to be shown as a middle grey, about, by whichever tone map.
const GREY: f32 = 0.18;
/// Stops from there from which on a picture counts as dark or blown out: without a tone map sRGB shows so little as 34 of 255.
const STOPS_OFF: f32 = 3.5;
/// Share of a picture that is lit at least for it to count as too bright: specks of light that few samples find say nothing of the rest.
const LIT_SHARE: f32 = 0.1;

/// Says which exposure would show a picture whose lit pixels are, half of them, far too dark or far too bright; nothing where they are not,
/// where no pixel is lit, and where the bright ones are few.
///
/// - `exposure_ev`: that it was shown with, stops
pub(super) fn hint(radiance: &[Rgb], exposure_ev: f32) -> Option<String> {
    let is_lit = |luminance: &f32| luminance.is_normal() && *luminance > 0.0;
    let mut luminances: Vec<f32> = radiance.iter().map(|pixel| pixel.luminance()).filter(is_lit).collect();
    let middle = luminances.len().checked_sub(1)? / 2;
    let (_, median, _) = luminances.select_nth_unstable_by(middle, f32::total_cmp);
    let better = (GREY / *median).log2();
    let off = better - exposure_ev;
    // Rounded to halves, without a sign before zero.
    let better = (2.0 * better).round() / 2.0 + 0.0;
    let shows = off > 0.0 || luminances.len() as f32 >= LIT_SHARE * radiance.len() as f32;
    (shows && off.abs() > STOPS_OFF && better.abs() <= EXPOSURE_MAX).then(|| {
        let how = if off > 0.0 { "dark" } else { "bright" };
        format!("most of the picture is too {how} to see much; --exposure {better} would show it")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_that_show_little_are_told() {
        let pixels = |lit: f32, lamp: f32| {
            let mut pixels = vec![Rgb::splat(lit); 60];
            pixels.extend([Rgb::splat(lamp); 39]);
            pixels.extend([Rgb::BLACK; 200]);
            pixels
        };
        // A lamp in view, or much of nothing, says nothing.
        assert_eq!(hint(&pixels(0.2, 1e4), 0.0), None);
        assert_eq!(hint(&pixels(0.02, 0.0), 0.0), None);
        let told = |pixels: &[Rgb], ev| hint(pixels, ev).unwrap();
        assert!(
            told(&pixels(0.18 / 64.0, 1e4), 0.0)
                .ends_with("too dark to see much; --exposure 6 would show it")
        );
        assert!(told(&pixels(180.0, 1e4), 0.0).contains("too bright to see much; --exposure -10 would"));
        // With the exposure that was named there is nothing to say, far beyond it there is.
        assert_eq!(hint(&pixels(180.0, 1e4), -10.0), None);
        assert!(told(&pixels(0.18, 0.18), 7.0).contains("bright"));
        // Specks in the dark.
        let specks = |count: usize| [vec![Rgb::splat(50.0); count], vec![Rgb::BLACK; 1_000]].concat();
        assert_eq!(hint(&specks(20), 0.0), None);
        assert!(told(&specks(200), 0.0).contains("bright"));
        // Nothing to see, and what no exposure shows.
        assert_eq!(hint(&[Rgb::BLACK; 9], 0.0), None);
        assert_eq!(hint(&[], 0.0), None);
        assert_eq!(hint(&[Rgb::splat(1e-30)], 0.0), None);
        assert!(told(&[Rgb::splat(0.19)], 7.0).contains("--exposure 0 "));
    }
}
