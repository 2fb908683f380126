//! One pixel: a sample on its way in, and the sums it adds to.

use crate::math::Rgb;
use crate::transport::PathClass;
use glam::Vec3;

/// One sample of one pixel: a path's radiance by class, and what its first hit looked like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelSample {
    /// W/(m² sr) by path class, in the order of [`PathClass::ALL`].
    pub radiance: [Rgb; PathClass::COUNT],
    /// Share of light that the first hit reflects in total.
    pub albedo: Rgb,
    /// Shading normal of the first hit in the world: unit, or zero when nothing was hit.
    pub normal: Vec3,
    /// Distance of the first hit along the camera's axis, metres; 0 when nothing was hit.
    pub depth_m: f32,
    /// What is seen straight or in mirrors shines by itself, or nothing was hit: light of [`PathClass::SEEN`] comes from there as it is. Else
    /// it is seen through glass or in a gloss, by samples that meet it or not.
    pub is_shining: bool,
    /// What is seen in mirrors or through clear glass, where the first hit is one.
    pub beyond: Option<Beyond>,
}

/// The first surface that is neither a mirror nor clear glass, seen by way of those alone: reflected by mirrors, and where glass shows most from. What
/// is around the scene counts as one that faces the ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beyond {
    /// Share of light that it reflects in total and that comes from there to the eye, by this path: over its chance of getting so far.
    pub albedo: Rgb,
    /// Its shading normal in the world, about unit: cards have it in bytes.
    pub normal: Vec3,
}

impl PixelSample {
    /// A sample that hit nothing and saw no light.
    pub const BLACK: PixelSample = PixelSample {
        radiance: [Rgb::BLACK; PathClass::COUNT],
        albedo: Rgb::BLACK,
        normal: Vec3::ZERO,
        depth_m: 0.0,
        is_shining: false,
        beyond: None,
    };

    /// True when a film can take it: finite and not negative; and radiance so far below the largest float
    /// that the sum over the classes is a float too.
    pub fn is_sound(&self) -> bool {
        let limit = f32::MAX / PathClass::COUNT as f32;
        let radiance_is_sound =
            |colour: &Rgb| colour.is_non_negative() && colour.to_array().iter().all(|value| *value <= limit);
        let albedo_is_sound = |albedo: &Rgb| albedo.is_finite() && albedo.is_non_negative();
        let beyond_is_sound = |beyond: Beyond| albedo_is_sound(&beyond.albedo) && beyond.normal.is_finite();
        self.radiance.iter().all(radiance_is_sound)
            && albedo_is_sound(&self.albedo)
            && self.normal.is_finite()
            && self.beyond.is_none_or(beyond_is_sound)
            && self.depth_m.is_finite()
            && self.depth_m >= 0.0
    }

    /// Radiance of all classes together.
    pub fn total(&self) -> Rgb {
        self.radiance.iter().fold(Rgb::BLACK, |sum, class| sum + *class)
    }
}

/// Classes of light that is scattered on its way: what is sampled of it may be replaced.
pub(super) const SCATTERED: [PathClass; 3] = [PathClass::Direct, PathClass::Caustic, PathClass::Indirect];

/// How many passes a tile's sums hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Held {
    /// Passes.
    pub(super) passes: u32,
    /// Those whose light was forgotten, in the order of [`SCATTERED`].
    pub(super) forgotten: [u32; SCATTERED.len()],
    /// Those that came before the halves were begun anew.
    pub(super) before_halves: u32,
    /// Those that came before how much samples spread was noted anew.
    pub(super) before_spread: u32,
}

impl Held {
    /// Passes that a class's sum holds.
    pub(super) fn of(self, class: PathClass) -> u32 {
        match class {
            PathClass::Emitted | PathClass::Specular => self.passes,
            PathClass::Direct => self.passes - self.forgotten[0],
            PathClass::Caustic => self.passes - self.forgotten[1],
            PathClass::Indirect => self.passes - self.forgotten[2],
        }
    }

    /// Passes that the sum of the class with the fewest holds.
    pub(super) fn fewest(self) -> u32 {
        self.passes - self.forgotten.into_iter().max().unwrap_or(0)
    }

    /// Passes whose samples tell how much they spread.
    pub(super) fn spread(self) -> u32 {
        self.passes - self.before_spread
    }

    /// Passes in the halves, even and odd ones.
    fn halves(self) -> [u32; 2] {
        let odd = self.passes / 2 - self.before_halves / 2;
        [self.passes - self.before_halves - odd, odd]
    }

    fn after_one_more(self) -> Held {
        Held { passes: self.passes + 1, ..self }
    }
}

/// Sums over the samples of one pixel. Why which precision: [`super::Film::BYTES_PER_PIXEL`].
#[derive(Clone, Debug, Default)]
pub(super) struct Pixel {
    /// Σ radiance by class and channel.
    radiance_sum: [[f64; 3]; PathClass::COUNT],
    /// ΣA − ΣB by channel: the total radiance of even passes less that of odd passes, since the halves were begun.
    half_difference: [f64; 3],
    /// Σ (luminance − mean)², running [Welford1962].
    squared_deviation_sum: f64,
    pub(super) albedo_sum: Rgb,
    pub(super) normal_sum: Vec3,
    depth_sum_m: f32,
    met: Met,
}

/// Sums over the samples of one pixel that note what is [`Beyond`].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BeyondSums {
    albedo: Rgb,
    normal: Vec3,
    count: u32,
}

impl BeyondSums {
    pub(super) fn add(&mut self, beyond: Beyond) {
        self.albedo += beyond.albedo;
        self.normal += beyond.normal;
        self.count += 1;
    }

    /// Of those samples, where they are half of a pixel's `passes` or more; the normal is zero where theirs leave none.
    pub(super) fn mean(&self, passes: u32) -> Option<Beyond> {
        (self.count > 0 && 2 * self.count >= passes).then(|| Beyond {
            albedo: self.albedo / self.count as f32,
            normal: self.normal.normalize_or_zero(),
        })
    }
}

/// What samples met, in four bytes: how many met anything first, and whether any met what shines by itself or saw past all, straight or in
/// mirrors.
#[derive(Clone, Copy, Debug, Default)]
struct Met(u32);

impl Met {
    const SHINING: u32 = 1 << 31;

    fn add(&mut self, is_hit: bool, is_shining: bool) {
        self.0 += u32::from(is_hit);
        if is_shining {
            self.0 |= Self::SHINING;
        }
    }

    fn count(self) -> u32 {
        self.0 & !Self::SHINING
    }

    fn are_shining(self) -> bool {
        self.0 & Self::SHINING != 0
    }
}

impl Pixel {
    /// Takes in a sample after those that the sums hold.
    pub(super) fn add(&mut self, sample: &PixelSample, held: Held) {
        let pass_index = held.passes;
        let mean_before = luminance(self.total_mean(held));
        // Even passes are half A, odd ones half B.
        let sign = if pass_index & 1 == 0 { 1.0 } else { -1.0 };
        for (sums, radiance) in self.radiance_sum.iter_mut().zip(&sample.radiance) {
            for (channel_index, value) in radiance.to_array().into_iter().enumerate() {
                sums[channel_index] += f64::from(value);
                self.half_difference[channel_index] += sign * f64::from(value);
            }
        }
        if held.spread() > 0 {
            let value = f64::from(sample.total().luminance());
            self.add_deviation(value, mean_before, luminance(self.total_mean(held.after_one_more())));
        }
        self.albedo_sum += sample.albedo;
        self.met.add(sample.depth_m > 0.0, sample.is_shining);
        if sample.depth_m > 0.0 {
            self.normal_sum += sample.normal;
            self.depth_sum_m += sample.depth_m;
        }
    }

    /// Scales the sums of a class, and begins the halves anew.
    pub(super) fn scale(&mut self, class: PathClass, share: f64) {
        self.half_difference = [0.0; 3];
        self.radiance_sum[class as usize].iter_mut().for_each(|sum| *sum *= share);
    }

    /// Begins to note how much samples spread anew.
    pub(super) fn forget_spread(&mut self) {
        self.squared_deviation_sum = 0.0;
    }

    /// Welford's step with the means taken from the sums, so that they need no place of their own:
    /// with n samples before, M₂ grows by (x − mean_n)(x − mean_{n+1}).
    fn add_deviation(&mut self, value: f64, mean_before: f64, mean_after: f64) {
        // Exactly, the product cannot be negative; by rounding it can.
        self.squared_deviation_sum += ((value - mean_before) * (value - mean_after)).max(0.0);
    }

    fn total_sum(&self) -> [f64; 3] {
        let mut total = [0.0; 3];
        for class in &self.radiance_sum {
            for (sum, value) in total.iter_mut().zip(class) {
                *sum += value;
            }
        }
        total
    }

    /// Mean radiance over all classes; zero before the first pass.
    pub(super) fn total_mean(&self, held: Held) -> [f64; 3] {
        if held.forgotten == [0; SCATTERED.len()] {
            return self.total_sum().map(|sum| sum / f64::from(held.passes.max(1)));
        }
        let mut total = [0.0; 3];
        for class in PathClass::ALL {
            for (sum, value) in total.iter_mut().zip(self.class_mean(class, held)) {
                *sum += value;
            }
        }
        total
    }

    /// Mean radiance of one class; zero before its first pass.
    pub(super) fn class_mean(&self, class: PathClass, held: Held) -> [f64; 3] {
        self.radiance_sum[class as usize].map(|sum| sum / f64::from(held.of(class).max(1)))
    }

    /// Mean depth of the samples that hit; 0 without any.
    pub(super) fn depth_mean_m(&self) -> f32 {
        match self.met.count() {
            0 => 0.0,
            count => self.depth_sum_m / count as f32,
        }
    }

    /// Some sample met what shines by itself, or nothing that hides what shines around the scene, straight or in mirrors.
    pub(super) fn is_shining(&self) -> bool {
        self.met.are_shining()
    }

    /// Variance of the mean luminance; 0 while fewer than two passes tell it.
    pub(super) fn variance_of_mean(&self, held: Held) -> f64 {
        let n = f64::from(held.spread());
        if n < 2.0 { 0.0 } else { self.squared_deviation_sum / (n - 1.0) / n }
    }

    /// Unbiased estimate, per channel, of the squared error of the mean of the n ≥ 2 passes that the halves hold, as far as it is
    /// noise; infinite below two.
    ///
    /// Halves A and B hold a = ⌈n/2⌉ and b = ⌊n/2⌋ passes (or the other way round), are independent and have one expectation μ.
    /// The mean is M = (a·Ā + b·B̄)/n, so Var M = (a² Var Ā + b² Var B̄)/n².
    /// - n even, a = b: Var M = (Var Ā + Var B̄)/4 = E[((Ā−B̄)/2)²], whatever the spread within a half is
    ///   (stratified passes included).
    /// - n odd: with Var Ā = σ²/a and Var B̄ = σ²/b, Var M = σ²/n and E[(Ā−B̄)²] = σ²·n/(a·b), hence
    ///   Var M = (a·b/n²)·E[(Ā−B̄)²]; for a = b this is the line above.
    ///
    /// What is kept is D = a·Ā − b·B̄; as D − (a−b)·M = 2ab/n·(Ā−B̄), the estimate is (D − (a−b)·M)²/(4ab).
    pub(super) fn squared_error_of_mean(&self, held: Held) -> [f64; 3] {
        let [a, b] = held.halves().map(f64::from);
        let mean = self.total_mean(held);
        std::array::from_fn(|channel| {
            (self.half_difference[channel] - (a - b) * mean[channel]).powi(2) / (4.0 * a * b)
        })
    }
}

/// Rec.709 luminance in double precision.
pub(super) fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}
