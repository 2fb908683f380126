//! What a set of rays found, how long that took, and with how many threads.

use std::{fmt, time::Instant};

use lumicast_engine::accel::Ray;
use rayon::{ThreadPool, ThreadPoolBuilder, prelude::*};

use crate::ray_set::RAY_COUNT;

/// Rays a thread takes at a time: contiguous, so that neighbours stay neighbours.
const CHUNK: usize = 1024;

/// One pool of one thread and one of two.
pub(crate) struct Pools {
    pub(crate) of: [ThreadPool; 2],
}

impl Pools {
    pub(crate) fn new() -> Pools {
        let pool = |threads| ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        Pools { of: [pool(1), pool(2)] }
    }
}

/// Hits of a set of rays, in numbers that can be compared.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Answer {
    pub(crate) hit_count: usize,
    /// Sum over all hits; 0 where only any hit was asked for.
    pub(crate) t_sum: f64,
}

impl Answer {
    /// Counts one ray's answer: where it hit, if it did.
    pub(crate) fn count(&mut self, t: Option<f32>) {
        if let Some(t) = t {
            self.hit_count += 1;
            self.t_sum += f64::from(t);
        }
    }

    fn and(self, other: Answer) -> Answer {
        Answer { hit_count: self.hit_count + other.hit_count, t_sum: self.t_sum + other.t_sum }
    }

    fn t_mean(&self) -> f64 {
        self.t_sum / self.hit_count.max(1) as f64
    }

    /// The same up to a share `tolerance` of the rays and of the mean distance.
    pub(crate) fn agrees_with(&self, other: &Answer, ray_count: usize, tolerance: f64) -> bool {
        self.hit_count.abs_diff(other.hit_count) as f64 <= tolerance * ray_count as f64
            && (self.t_mean() - other.t_mean()).abs() <= tolerance * other.t_mean()
    }
}

impl fmt::Display for Answer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} hits at {:.6} on average", self.hit_count, self.t_mean())
    }
}

impl FromIterator<Option<f32>> for Answer {
    fn from_iter<I: IntoIterator<Item = Option<f32>>>(hits: I) -> Answer {
        let mut answer = Answer::default();
        hits.into_iter().for_each(|t| answer.count(t));
        answer
    }
}

/// Arithmetic without memory, about as long as a query takes: what two threads gain here, they gain at most anywhere.
pub(crate) fn arithmetic(rays: &[Ray]) -> Answer {
    let of_ray = |ray: &Ray| {
        let mut state = u64::from(ray.direction.x.to_bits()) | 1;
        // Each step waits for the one before; 64 of them are some 300 cycles.
        for _ in 0..64 {
            state = (state ^ (state >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        }
        (state >> 63 == 1).then_some(0.0)
    };
    rays.iter().map(of_ray).collect()
}

/// An answer and the seconds it took.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Timed {
    pub(crate) seconds: f64,
    pub(crate) answer: Answer,
}

impl Timed {
    /// Worse than any measurement.
    pub(crate) const NEVER: Timed =
        Timed { seconds: f64::INFINITY, answer: Answer { hit_count: 0, t_sum: 0.0 } };

    /// Asks all `rays`, chunk by chunk, on the threads of `pool`.
    pub(crate) fn of(
        pool: &ThreadPool,
        rays: &[Ray],
        answer: impl Fn(&[Ray]) -> Answer + Send + Sync,
    ) -> Timed {
        pool.install(|| {
            let start = Instant::now();
            // Chunk by chunk, as Embree's threads take theirs: rayon's halves differ in how hard they are.
            let answer =
                rays.par_chunks(CHUNK).with_max_len(1).map(answer).reduce(Answer::default, Answer::and);
            Timed { seconds: start.elapsed().as_secs_f64(), answer }
        })
    }

    /// Keeps the faster of the two.
    pub(crate) fn or_better(&mut self, other: Timed) {
        if other.seconds < self.seconds {
            *self = other;
        }
    }

    pub(crate) fn rays_per_second(&self) -> f64 {
        RAY_COUNT as f64 / self.seconds
    }
}
