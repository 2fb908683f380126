//! How often light is gathered for a record, and what that tells of its noise.

use std::num::NonZeroU32;

use crate::math::Rgb;

/// How often light is gathered for a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Visits {
    /// In any case.
    pub least: NonZeroU32,
    /// At most, and no fewer than `least`: as long as the noise of all together is more than [`super::IrradianceSettings::noise`]. Not of each
    /// by itself: those that by chance never met what is bright and small are the quiet ones, and to leave them alone would leave them too
    /// dark.
    pub most: NonZeroU32,
}

impl Visits {
    /// As often for each.
    pub const fn exactly(count: NonZeroU32) -> Visits {
        Visits { least: count, most: count }
    }
}

/// What is known of a record's noise.
#[derive(Clone, Copy, Debug)]
pub(super) struct Visited {
    /// How often light was gathered for it, of the scene as it is and from what is known of it now.
    pub(super) count: u32,
    /// Sum of squared deviations of what each visit found from the mean of all, (W/m²)².
    squares: f64,
}

impl Visited {
    pub(super) const NEVER: Visited = Visited { count: 0, squares: 0.0 };
    pub(super) const ONCE: Visited = Visited { count: 1, squares: 0.0 };

    /// - `before`, `after`: irradiance known before and after the visit, W/m²
    pub(super) fn again(self, before: Rgb, after: Rgb) -> Visited {
        let Visited { count, squares } = self;
        let moved = f64::from(after.mean()) - f64::from(before.mean());
        // A mean of n + 1 has moved by a part of n + 1 of what the last is off [Welford1962].
        let of_count = f64::from(count) * (f64::from(count) + 1.0);
        Visited { count: count + 1, squares: squares + moved * moved * of_count }
    }

    /// The same where a share of what was found is shown.
    pub(super) fn shown(self, share: f32) -> Visited {
        Visited { squares: self.squares * f64::from(share).powi(2), ..self }
    }

    /// Squared standard error of the mean of all visits, (W/m²)²; infinite after one.
    pub(super) fn variance(self) -> f64 {
        let count = f64::from(self.count);
        if self.count > 1 { self.squares / (count * (count - 1.0)) } else { f64::INFINITY }
    }
}

/// relMSE of the irradiance of some records by chance, as the visits of each differ: relative to the square of what each holds and a
/// hundredth of that of their mean, as errors of pictures are. Infinite with one that was visited once.
pub(super) fn noise_of(records: impl Iterator<Item = (Visited, Rgb)> + Clone) -> f64 {
    let of = records.map(|(visited, irradiance)| (visited, f64::from(irradiance.mean())));
    let (count, sum) =
        of.clone().fold((0.0, 0.0), |(count, sum), (_, irradiance)| (count + 1.0, sum + irradiance));
    let floor = 0.01 * (sum / f64::max(count, 1.0)).powi(2);
    let off = |(visited, irradiance): (Visited, f64)| {
        let variance = visited.variance();
        if variance > 0.0 { variance / (irradiance.powi(2) + floor) } else { 0.0 }
    };
    of.map(off).sum::<f64>() / f64::max(count, 1.0)
}
