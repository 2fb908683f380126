//! Does it pay to sort rays that fly every which way before they are asked for?
//!
//! A batch is sorted by where its rays start, along a Morton curve, and there by where they fly, asked in that order, and
//! the hits are put back into the order asked for. All of that is in the times.

use std::time::Instant;

use glam::Vec3;
use lumicast_engine::accel::{Accel, Hit, Ray};
use lumicast_tests::Random;

use crate::{
    ROUNDS,
    answer::Pools,
    ours::Tree,
    ray_set::{Kind, onward_rays},
    subject::Subject,
    table::print_markdown,
};

/// Rays sorted at once: what a tile of a picture asks for, what a large tile does, what a whole picture does.
const SIZES: [usize; 3] = [1 << 10, 1 << 14, usize::MAX];
/// Cells on each axis of the box around a batch's origins, as a power of two: 32 … 256 were much the same.
const CELL_BITS: u32 = 5;
/// Steps of each coordinate of a direction, as a power of two.
const DIRECTION_BITS: u32 = 3;
/// Bits of a sorting key that say which ray it is.
const INDEX_BITS: u32 = 20;
/// Key bits that are sorted in one pass: counts of 2048 values stay in the nearest cache.
const DIGIT_BITS: u32 = 11;

/// Prints million rays a second with one thread for a subject's diffuse rays, for those of the next bounce, and for these
/// shuffled.
pub(crate) fn measure(subject: &Subject, pools: &Pools) {
    let tree = Tree::new("", &subject.flat, subject.view);
    let diffuse = tree.rays.of(Kind::Diffuse);
    let onward = onward_rays(diffuse, &tree.accel);
    let mut shuffled = onward.clone();
    let mut random = Random::new(7);
    for index in (1..shuffled.len()).rev() {
        shuffled.swap(index, random.below(index + 1));
    }
    let sets = [("diffuse", diffuse), ("second bounce", &onward), ("second bounce, shuffled", &shuffled)];
    println!("\n### batches: {}, million rays a second, one thread\n", subject.name);
    let rows = sets.map(|(name, rays)| {
        let rates = pools.of[0].install(|| rates(&tree.accel, rays));
        [name.to_string()].into_iter().chain(rates.map(|rate| format!("{rate:.2}"))).collect()
    });
    let sorted =
        SIZES.map(|size| if size == usize::MAX { "all sorted".into() } else { format!("sorted by {size}") });
    let [small, large, all] = &sorted;
    print_markdown(&["", "as they come", small, large, all], &rows);
}

fn rates(accel: &Accel, rays: &[Ray]) -> [f64; SIZES.len() + 1] {
    let mut best = [f64::INFINITY; SIZES.len() + 1];
    let mut expected = vec![None; rays.len()];
    let mut hits = vec![None; rays.len()];
    let seconds = |work: &mut dyn FnMut()| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    let (as_they_come, sorted) = best.split_at_mut(1);
    for _ in 0..ROUNDS {
        let once = seconds(&mut || accel.closest_hits(rays, &mut expected, |_| true));
        as_they_come[0] = once.min(as_they_come[0]);
        for (size, best) in SIZES.into_iter().zip(&mut *sorted) {
            hits.fill(None);
            let once = seconds(&mut || {
                for (rays, hits) in rays.chunks(size).zip(hits.chunks_mut(size)) {
                    closest_hits_sorted(accel, rays, hits);
                }
            });
            *best = once.min(*best);
            assert!(hits == expected, "sorting changed an answer");
        }
    }
    best.map(|seconds| rays.len() as f64 / seconds / 1e6)
}

fn closest_hits_sorted(accel: &Accel, rays: &[Ray], hits: &mut [Option<Hit>]) {
    let order = order_of(rays);
    let index = |key: &u64| (key & ((1 << INDEX_BITS) - 1)) as usize;
    let sorted: Vec<Ray> = order.iter().map(|key| rays[index(key)]).collect();
    let mut found = vec![None; sorted.len()];
    accel.closest_hits(&sorted, &mut found, |_| true);
    for (key, found) in order.iter().zip(found) {
        hits[index(key)] = found;
    }
}

/// Keys in ascending order: cell of the origin, then direction, then the ray's index.
fn order_of(rays: &[Ray]) -> Vec<u64> {
    assert!(rays.len() <= 1 << INDEX_BITS);
    let bounds = rays.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), ray| {
        (low.min(ray.origin), high.max(ray.origin))
    });
    let (low, size) = (bounds.0, (bounds.1 - bounds.0).max(Vec3::splat(f32::MIN_POSITIVE)));
    let key = |(index, ray): (usize, &Ray)| {
        let cell = morton((ray.origin - low) / size, CELL_BITS);
        let direction = morton(0.5 * (ray.direction.normalize_or_zero() + 1.0), DIRECTION_BITS);
        (cell << (3 * DIRECTION_BITS) | direction) << INDEX_BITS | index as u64
    };
    let mut keys: Vec<u64> = rays.iter().enumerate().map(key).collect();
    let mut moved = vec![0; keys.len()];
    let end = INDEX_BITS + 3 * (CELL_BITS + DIRECTION_BITS);
    for shift in (INDEX_BITS..end).step_by(DIGIT_BITS as usize) {
        let digit = |key: u64| (key >> shift) as usize & ((1 << DIGIT_BITS) - 1);
        let mut places = [0usize; 1 << DIGIT_BITS];
        keys.iter().for_each(|key| places[digit(*key)] += 1);
        let mut sum = 0;
        for place in &mut places {
            sum += std::mem::replace(place, sum);
        }
        for key in &keys {
            let place = &mut places[digit(*key)];
            moved[*place] = *key;
            *place += 1;
        }
        std::mem::swap(&mut keys, &mut moved);
    }
    keys
}

/// The place of a point of the unit cube along a Morton curve of `bits` bits an axis.
fn morton(p: Vec3, bits: u32) -> u64 {
    let cells = (1u32 << bits) as f32;
    let along = (p * cells).clamp(Vec3::ZERO, Vec3::splat(cells - 1.0)).as_uvec3().to_array();
    (0..3 * bits).fold(0, |place, bit| {
        let (axis, level) = (bit % 3, bit / 3);
        place | u64::from(along[axis as usize] >> level & 1) << bit
    })
}
