//! What records show of what was gathered for them: as much as that surely says more than what answers where no record counts.
//!
//! What is gathered along some hundred rays has noise, which shows as blotches; the light octree has less of it and an error of its own. With
//! B² the squared error of the octree and σ² the variance of a record, independent of it, the octree and a share B² / (B² + σ²) of how far the
//! record differs from it have the least squared error there is. The squared difference of the two has the expectation B² + σ², and the halves of
//! a record's rays measure σ²: both are taken in the mean over the records around, since a record that is far off by chance differs most of all
//! (the positive-part estimator of [JamesStein1961], as between films, `film/picture.rs`).

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::record::Record;
use crate::{math::Rgb, technique::SecondaryLight};

/// Share of the variance of records that pixels have: some of them answer for each. The more, the fewer blotches. With a quarter and a half of
/// it, and sums relative to each record's own value, `auto` was off by 10.07 and 10.08 % in the mean of four views and two seeds after 2 s (10.96
/// without any of this), by 7.00 and 7.09 % after 5 s (7.05), and with all of it in Sponza's gallery by 15.1 % after 6 s (14.1).
const VARIANCE_SHOWN: f64 = 0.35;
/// Width of the cells that records are taken together in, in reaches, rounded up to a power of two. 27 of them are asked.
const CELL_REACHES: f32 = 4.0;
/// Cells that are larger or smaller than any scene's are as good as those.
const LEVEL_MAX: f32 = 60.0;

/// Records of about one reach, in one place, on surfaces that face about one way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Cell {
    level: i32,
    /// The axis that is nearest to the normal, with its sign: −3 to 3.
    facing: i8,
    at: IVec3,
}

impl Cell {
    fn of(record: &Record, accuracy: f32) -> Cell {
        let level = (CELL_REACHES * record.reach_m(accuracy)).log2().ceil().clamp(-LEVEL_MAX, LEVEL_MAX);
        let axis = record.normal.abs().max_position();
        let is_back = record.normal[axis] < 0.0;
        let place = (record.position * (-level).exp2()).floor().clamp(Vec3::splat(-1e9), Vec3::splat(1e9));
        let facing = axis as i8 + 1;
        Cell { level: level as i32, facing: if is_back { -facing } else { facing }, at: place.as_ivec3() }
    }

    /// Itself and those around.
    fn with_neighbours(self) -> impl Iterator<Item = Cell> {
        let around = move |offset: i32| IVec3::new(offset % 3 - 1, offset / 3 % 3 - 1, offset / 9 - 1);
        (0..27).map(move |offset| Cell { at: self.at + around(offset), ..self })
    }
}

/// Sums over the records of a cell, (W/m²)². Not relative to what each says: those that are far off by chance would count for less than what
/// they are off by, and light of small bright spots would look known where most have not met it.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    /// Of squares of how far their mean irradiance differs from the octree's.
    difference: f64,
    variance: f64,
}

impl Sums {
    fn with(self, other: Sums) -> Sums {
        Sums { difference: self.difference + other.difference, variance: self.variance + other.variance }
    }

    /// Share of the differences that is shown.
    fn share(self) -> f32 {
        let own = (self.difference - self.variance).max(0.0);
        let all = own + VARIANCE_SHOWN * self.variance;
        if all > 0.0 { (own / all) as f32 } else { 1.0 }
    }
}

/// Lets records show what they surely know better than `base`; returns the share of what was gathered that each shows.
///
/// - `variances`: of the mean of each one's channels, (W/m²)²
pub(super) fn steady(
    records: &mut [Record],
    variances: &[f64],
    accuracy: f32,
    base: &dyn SecondaryLight,
) -> Vec<f32> {
    let even = |record: &Record| {
        base.even_irradiance(record.position, record.n_geo, record.normal).filter(|even| even.is_finite())
    };
    let known: Vec<Option<Rgb>> = records.par_iter().map(even).collect();
    let mut sums: HashMap<Cell, Sums> = HashMap::new();
    for ((record, even), variance) in records.iter().zip(&known).zip(variances) {
        let Some(even) = even else { continue };
        let difference = f64::from((record.irradiance - *even).mean()).powi(2);
        if difference.is_finite() && variance.is_finite() {
            let sum = sums.entry(Cell::of(record, accuracy)).or_default();
            *sum = sum.with(Sums { difference, variance: *variance });
        }
    }
    let shares: HashMap<Cell, f32> = sums
        .par_iter()
        .map(|(cell, _)| {
            let near = cell.with_neighbours().filter_map(|near| sums.get(&near));
            (*cell, near.fold(Sums::default(), |all, sums| all.with(*sums)).share())
        })
        .collect();
    let show = |(record, even): (&mut Record, Option<Rgb>)| {
        let (Some(even), Some(share)) = (even, shares.get(&Cell::of(record, accuracy))) else { return 1.0 };
        // To the last bit what it was where nothing is doubted.
        if *share < 1.0 && record.irradiance.is_finite() {
            record.irradiance = even + (record.irradiance - even) * *share;
            record.turning.iter_mut().chain(&mut record.moving).for_each(|gradient| *gradient *= *share);
        }
        *share
    };
    records.par_iter_mut().zip(known).map(show).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        math::{RunningStatistics, sobol::PixelSampler},
        technique::{
            Card, ScatteredLight,
            irradiance::{CARD, Facing},
        },
        transport::Surface,
    };

    /// What would answer without records: right for x below zero, `off` times as much beyond; so many times as bright.
    #[derive(Debug)]
    struct Base {
        off: f32,
        times: f32,
    }

    impl SecondaryLight for Base {
        fn card(&self) -> &'static Card {
            &CARD
        }

        fn scattered(&self, _: &Surface, _: Vec3, _: Option<[f32; 3]>) -> ScatteredLight {
            ScatteredLight::default()
        }

        fn even_irradiance(&self, p: Vec3, _: Vec3, _: Vec3) -> Option<Rgb> {
            Some(TRUE * self.times * if p.x < 0.0 { 1.0 } else { self.off })
        }

        fn has_caustics(&self) -> bool {
            false
        }
    }

    const TRUE: Rgb = Rgb::new(2.0, 3.0, 1.0);

    /// On a floor and the ceiling over it, four metres wide, with a reach of 5 cm; (1 ± `noise`) times as much light as is true, evenly.
    fn records(noise: f32) -> (Vec<Record>, Vec<f64>) {
        let record = |index: u32| {
            let [x, z, side, u] = PixelSampler::new(7, 0, index, 0).four(0);
            let normal = if side < 0.5 { Vec3::Y } else { Vec3::NEG_Y };
            let position = Vec3::new(4.0 * x - 2.0, 0.0, 4.0 * z - 2.0);
            Record {
                irradiance: TRUE * (1.0 + noise * (2.0 * u - 1.0)),
                turning: [Vec3::X; 3],
                moving: [Vec3::Z; 3],
                ..Record::dark_in_the_open(position, Facing::flat(normal), 0.5)
            }
        };
        let variance = f64::from(TRUE.mean() * noise).powi(2) / 3.0;
        ((0..4000).map(record).collect(), vec![variance; 4000])
    }

    /// Mean and root of the mean square of relative errors of those that a rule names.
    fn error(records: &[Record], is_meant: impl Fn(&Record) -> bool) -> [f64; 2] {
        let mut errors = [RunningStatistics::default(); 2];
        for record in records.iter().filter(|record| is_meant(record)) {
            let off = f64::from(record.irradiance.mean() / TRUE.mean()) - 1.0;
            errors[0].add(off);
            errors[1].add(off * off);
        }
        [errors[0].mean(), errors[1].mean().sqrt()]
    }

    /// Records without noise are left as they are, whatever the base says; those that differ from it by their noise alone show it less; where
    /// the base is far off they show what was gathered; a border between the two is told within some reaches.
    #[test]
    fn records_show_what_they_surely_know_better() {
        let (exact, none) = (records(0.0).0, vec![0.0; 4000]);
        let mut shown = exact.clone();
        let shares = steady(&mut shown, &none, 0.1, &Base { off: 1.5, times: 1.0 });
        assert!(shown == exact && shares.iter().all(|share| *share == 1.0));
        let (noisy, variances) = records(0.4);
        let mut shown = noisy.clone();
        let left = steady(&mut shown, &variances, 0.1, &Base { off: 3.0, times: 1.0 });
        let [_, before] = error(&noisy, |record| record.position.x < -0.7);
        let [bias, after] = error(&shown, |record| record.position.x < -0.7);
        assert!(after < 0.5 * before && bias.abs() < 0.01, "{bias} {after} {before}");
        let beyond = |record: &Record| record.position.x > 0.7;
        let ([bias, after], [_, before]) = (error(&shown, beyond), error(&noisy, beyond));
        assert!(after < 1.05 * before && bias.abs() < 0.1 * 2.0, "{bias} {after} {before}");
        let left = left.iter().sum::<f32>() / left.len() as f32;
        assert!(left > 0.4 && left < 0.7, "{left}");
        // Gradients go with it.
        let (record, was) = shown.iter().zip(&noisy).find(|(record, _)| record.position.x < -1.0).unwrap();
        let even = (TRUE.g - record.irradiance.g) / (TRUE.g - was.irradiance.g);
        assert!((record.moving[1].z - even).abs() < 1e-4, "{} {even}", record.moving[1].z);
    }

    /// Twice the light is twice of what is shown, to the last bit; nothing at all stays nothing.
    #[test]
    fn it_does_not_depend_on_how_bright_it_is() {
        let of = |times: f32| {
            let (mut records, mut variances) = records(0.3);
            records.iter_mut().for_each(|record| record.irradiance *= times);
            variances.iter_mut().for_each(|variance| *variance *= f64::from(times).powi(2));
            steady(&mut records, &variances, 0.1, &Base { off: 1.2, times });
            records
        };
        let once = of(1.0);
        for times in [2.0, 2f32.powi(-30), 2f32.powi(30)] {
            let is_times = |(record, once): (&Record, &Record)| record.irradiance == once.irradiance * times;
            assert!(of(times).iter().zip(&once).all(is_times), "{times:e}");
        }
        assert!(of(0.0).iter().all(|record| record.irradiance.is_black()));
    }
}
