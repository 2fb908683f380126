//! Both ways that records get onto pixels, in whatever pieces, bring the same.

use super::{super::super::splats::Pace, *};
use crate::gpu::Session;

/// Pictures of any size are splatted to their last pixel, in whole tiles and parts of them.
#[test]
fn pictures_of_any_size_are_splatted() {
    let Some(gpu) = shared() else { return };
    let boxes = shot(samples::boxes().unwrap());
    let cache = strewn(&boxes, PLAIN, 100, [0.2, 0.8]);
    for [width, height] in [[1, 1], [16, 8], [15, 7], [17, 9], [32, 24], [3, 70], [90, 5]] {
        let shot = Shot { size: size(width, height), ..boxes.clone() };
        let found = splatted_alike(&format!("{width} x {height}"), &gpu, &shot, &cache);
        assert!(found.diffuse >= shot.size.pixel_count() / 2, "{width} x {height}: {found:?}");
        assert!(found.answered > 0, "{width} x {height}: {found:?}");
    }
}

/// Both ways say the same but for rounding, of more records than tiles look through at a time: what one may be off from the truth, and what
/// the other, they may be off from each other.
#[test]
fn quads_and_tiles_say_the_same() {
    let Some(gpu) = shared() else { return };
    let shot = Shot { size: size(67, 45), ..from_elsewhere(shot(samples::boxes().unwrap())) };
    let (view, scene) = (view_of(&shot), on_card(&gpu, &shot));
    let weighing = Weighing { accuracy: 0.3, is_smooth: true, has_gradients: true };
    let cache = strewn(&shot, weighing, 2_500, [0.02, 0.3]);
    let known: Arc<dyn SecondaryLight> = Arc::new(cache.clone());
    let [by_quads, by_tiles] = WAYS.map(|by| scene.splatted_by(&view, &known, by).unwrap());
    assert_eq!(by_quads.points(), by_tiles.points());
    let points = by_tiles.points();
    let [quads, tiles] = [by_quads, by_tiles].map(|splatted| splatted.irradiances().unwrap());
    let (mut answered, mut alike, mut undecided, mut off_max) = (0, 0, 0, 0.0f32);
    for (point, (quads, tiles)) in points.iter().zip(quads.iter().zip(&tiles)) {
        alike += usize::from(quads == tiles);
        let (Some(quads), Some(tiles)) = (quads, tiles) else {
            undecided += usize::from(quads.is_some() || tiles.is_some());
            continue;
        };
        answered += 1;
        off_max = off_max.max(off_rgb(*quads, *tiles, 1e-6));
        let (p, facing) = facing_of(point);
        let Said::This(_, allowed) = said(&cache, p, &facing) else { continue };
        let off = (*quads - *tiles).map(f32::abs).to_array();
        assert!((0..3).all(|channel| f64::from(off[channel]) <= 2.0 * allowed[channel]), "{off:?}");
    }
    let count = points.len();
    eprintln!("{answered} of {count} answered, {alike} alike to the bit, others to {off_max} at most");
    assert!(answered > 1_000, "{answered}");
    assert!(undecided as f64 <= 2.0 + UNDECIDED_MAX * answered as f64, "{undecided}");
}

/// However many records are drawn at once, or are added up in however many tiles, sums have the same bits.
#[test]
fn batches_of_any_size_bring_the_same_bits() {
    let Some(gpu) = shared() else { return };
    let shot = shot(samples::boxes().unwrap());
    let (view, scene) = (view_of(&shot), on_card(&gpu, &shot));
    let weighing = Weighing { accuracy: 0.3, is_smooth: true, has_gradients: true };
    let fine = strewn(&shot, weighing, 200, [0.1, 0.5]);
    let cache = fine.before(strewn(&shot, weighing, 70, [0.5, 1.0]));
    let known: Arc<dyn SecondaryLight> = Arc::new(cache);
    let pixels = shot.size.pixel_count();
    for by in WAYS {
        let of = |covered_first: usize, at_once_max: u32| {
            let pace = Pace { covered_first, at_once_max, ..scene.pace(Session::batch) };
            let splatted = scene.splat_once(&view, &known, by, pace).unwrap();
            (splatted.irradiances().unwrap(), splatted.missing().unwrap())
        };
        let (irradiances, missing) = of(usize::MAX / 2, u32::MAX);
        assert!(irradiances.iter().flatten().count() > 300 && missing.len() > 100);
        // The last ones keep sums of tiles between batches.
        for (covered_first, at_once_max) in [
            (1, u32::MAX),
            (5 * pixels, u32::MAX),
            (199 * pixels, u32::MAX),
            (1, 7),
            (5 * pixels, 32),
            (usize::MAX / 2, 199),
        ] {
            let found = of(covered_first, at_once_max);
            assert!(
                found == (irradiances.clone(), missing.clone()),
                "{by:?}, {covered_first}, {at_once_max}"
            );
        }
    }
}
