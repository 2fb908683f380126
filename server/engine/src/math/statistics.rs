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
}
