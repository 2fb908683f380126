//! Running mean and variance.

/// Mean and variance of a stream of numbers [Welford1962], mergeable.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunningStatistics {
    count: u64,
    mean: f64,
    sum_of_squared_deviations: f64,
}

impl RunningStatistics {
    /// Takes one number in.
    pub fn add(&mut self, value: f64) {
        self.count += 1;
        let delta = value - self.mean;
        self.mean += delta / self.count as f64;
        self.sum_of_squared_deviations += delta * (value - self.mean);
    }

    /// Number of values.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Mean; zero without values.
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// Unbiased variance of the values; zero below two values.
    pub fn variance(&self) -> f64 {
        if self.count < 2 { 0.0 } else { self.sum_of_squared_deviations / (self.count - 1) as f64 }
    }

    /// Standard error of the mean; zero below two values.
    pub fn standard_error(&self) -> f64 {
        if self.count < 2 { 0.0 } else { (self.variance() / self.count as f64).sqrt() }
    }
}

/// Distribution function of the standard normal distribution, right to 2·10⁻⁷ [Abramowitz1964, 7.1.26].
fn normal_cdf(x: f64) -> f64 {
    const A: [f64; 5] = [0.254_829_592, -0.284_496_736, 1.421_413_741, -1.453_152_027, 1.061_405_429];
    let t = 1.0 / (1.0 + 0.327_591_1 * x.abs() / std::f64::consts::SQRT_2);
    let tail = 0.5 * t * A.iter().rev().fold(0.0, |sum, a| sum * t + a) * (-x * x / 2.0).exp();
    if x < 0.0 { tail } else { 1.0 - tail }
}

/// Mean of a number x ≥ 0 that was measured as `z`, −3 to 3, with a normal error of deviation 1, and of which nothing was known before
/// but that any value of its root is as likely as any other: its density is x^−½ exp(−(x − z)² / 2), scaled. Right to 10⁻⁴.
pub fn mean_of_squared(z: f64) -> f64 {
    const STEPS: u32 = 256;
    // By the root t the density is that of the normal distribution at t² alone; beyond 3 nothing is left of it.
    let (mut weights, mut sum) = (0.0, 0.0);
    for step in 0..STEPS {
        let t = 3.0 * (f64::from(step) + 0.5) / f64::from(STEPS);
        let weight = (-(t * t - z).powi(2) / 2.0).exp();
        weights += weight;
        sum += weight * t * t;
    }
    sum / weights
}

/// Of the normal distribution with mean `z` ≥ −3 and deviation 1 of which only what is positive is kept: a share lies below this.
pub fn cut_normal_quantile(z: f64, share: f64) -> f64 {
    let [mut low, mut high] = [0.0, z.max(0.0) + 8.0];
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        // What is kept and lies above.
        let above = normal_cdf(z - middle) / normal_cdf(z);
        if above > 1.0 - share { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The running figures equal the textbook ones.
    #[test]
    fn running_mean_and_variance_equal_the_two_pass_ones() {
        let values = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0];
        let mut statistics = RunningStatistics::default();
        values.iter().for_each(|value| statistics.add(*value));
        let mean = values.iter().sum::<f64>() / 8.0;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 7.0;
        assert!((statistics.mean() - mean).abs() < 1e-12);
        assert!((statistics.variance() - variance).abs() < 1e-12);
    }

    /// The cut normal distribution has the textbook's quantiles, and those of the whole one far from the cut.
    #[test]
    fn the_cut_normal_distribution_is_right() {
        // 95 % of a half-normal distribution lie below 1.959964.
        assert!((cut_normal_quantile(0.0, 0.95) - 1.959_964).abs() < 1e-4);
        assert!((cut_normal_quantile(8.0, 0.975) - 9.959_964).abs() < 1e-4);
        for z in [-3.0, -1.0, 0.0, 1.5] {
            assert!(cut_normal_quantile(z, 0.975) > mean_of_squared(z));
        }
    }

    /// The mean of a square is √2 Γ(¾)/Γ(¼) where nothing was measured but noise, grows with what was measured, and is less than that
    /// where it is well known: roots being as likely, small squares are likelier.
    #[test]
    fn the_mean_of_a_square_is_right() {
        assert!((mean_of_squared(0.0) - 0.477_99).abs() < 1e-4, "{}", mean_of_squared(0.0));
        let means: Vec<f64> = (-12..=12).map(|z| mean_of_squared(0.25 * f64::from(z))).collect();
        assert!(means.windows(2).all(|pair| pair[0] < pair[1]) && means[0] > 0.1);
        assert!((2.7..3.0).contains(&means[24]), "{}", means[24]);
    }
}
