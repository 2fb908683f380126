//! Tables 8.1 and 14.1 of [Larsen2004], measured again: what k-d trees over random photons cost by their size.
//!
//! The trees are those that the engine's maps are made of, asked the way they are asked there. One thread, as in the paper.

use std::{hint::black_box, num::NonZeroUsize, time::Instant};

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use lumicast_engine::math::sobol::mix;

use super::{
    Effort, ReportError,
    notebook::Notebook,
    table::{Cell, Cells, Column, Table},
};

/// Photons of table 8.1.
const MANY: u32 = 1_000_000;

/// Maps of table 8.1 with the paper's seconds of balancing and microseconds of a look-up.
const TABLE_8_1: [(u32, [f64; 2]); 4] =
    [(1, [5.05, 332.0]), (10, [3.08, 291.0]), (100, [0.70, 213.0]), (1000, [0.55, 116.0])];

/// Photons of table 14.1 with the paper's milliseconds of a look-up and of balancing.
const TABLE_14_1: [(u32, [f64; 2]); 4] =
    [(300, [0.023, 0.10]), (500, [0.027, 0.18]), (1000, [0.029, 0.39]), (2000, [0.034, 0.84])];

/// Rounds of look-ups for a median, each in one map.
const ROUNDS: usize = 25;

/// Look-ups of a round: 10 ms at the least, long against the clock's grain.
const LOOK_UPS: usize = 300;

/// Builds that are timed as one where a tree takes microseconds.
const SMALL_BUILDS: usize = 50;

const PHOTONS: Column = Column::given("photons", "photons");
const MAPS: Column = Column::given("maps", "maps");
const BUILD_SECONDS: Column = Column::here("build_seconds", "building all trees", "s");
const PAPER_BUILD_SECONDS: Column = Column::paper("paper_build_seconds", "paper's balancing", "s");
const LOOK_UP_US: Column = Column::here("look_up_us", "500 nearest", "µs");
const PAPER_LOOK_UP_US: Column = Column::paper("paper_look_up_us", "paper", "µs");
const BUILD_MS: Column = Column::here("build_ms", "building", "ms");
const PAPER_BUILD_MS: Column = Column::paper("paper_build_ms", "paper's balancing", "ms");
const LOOK_UP_MS: Column = Column::here("look_up_ms", "100 nearest", "ms");
const PAPER_LOOK_UP_MS: Column = Column::paper("paper_look_up_ms", "paper", "ms");

type Tree = ImmutableKdTree<f32, 3>;

/// Points spread evenly over the unit cube, named by `seed`.
fn random_points(seed: u64, count: u32) -> Vec<[f32; 3]> {
    // 24 bits are what a float in [0, 1) holds.
    let unit = |key: u64| (mix(key) >> 40) as f32 / (1u32 << 24) as f32;
    (0..u64::from(count)).map(|point| [0, 1, 2].map(|axis| unit(seed << 40 | point << 2 | axis))).collect()
}

/// The middle one of some values; the upper of two.
pub(super) fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The k nearest, in no order, as the engine's maps ask for them.
pub(super) fn nearest(tree: &Tree, at: [f32; 3], count: NonZeroUsize) -> Vec<(f32, u32)> {
    let found =
        tree.query(&at).nearest_n::<SquaredEuclidean<f32>>(count).within(f32::MAX).unsorted().execute();
    found.iter().map(|near| (near.distance, near.item)).collect()
}

/// Trees over `maps` sets of `count` photons each, and seconds that building all of them took.
fn trees(maps: &[Vec<[f32; 3]>]) -> (Vec<Tree>, f64) {
    let start = Instant::now();
    let trees: Vec<Tree> = maps.iter().filter_map(|points| Tree::new_from_slice(points).ok()).collect();
    (trees, start.elapsed().as_secs_f64())
}

/// Median seconds of a look-up of the `count` nearest; every round asks one of `trees`, spread evenly over them.
fn look_up_seconds(trees: &[Tree], count: usize) -> Option<f64> {
    let count = NonZeroUsize::new(count)?;
    let rounds = (0..ROUNDS).filter_map(|round| {
        let tree = trees.get(round * trees.len() / ROUNDS)?;
        let places = random_points(1 << 20 | round as u64, LOOK_UPS as u32);
        let start = Instant::now();
        for place in &places {
            let found = tree.query(place).nearest_n::<SquaredEuclidean<f32>>(count);
            black_box(found.within(f32::MAX).unsorted().execute());
        }
        Some(start.elapsed().as_secs_f64() / LOOK_UPS as f64)
    });
    median(rounds.collect())
}

/// Table 8.1.
pub(super) fn measure_many(notebook: &mut Notebook, effort: Effort) -> Result<(), ReportError> {
    notebook.note(
        "Tables 8.1 and 14.1 are of photons at random places, which light nothing: there is no picture and no error.",
    );
    let about = format!(
        "Photons at random places in a unit cube, shared out over maps; one thread. Medians: of {} builds of all trees, and \
         of {ROUNDS} rounds of {LOOK_UPS} look-ups, each round in one map. The paper takes means over 100 random maps.",
        effort.repeats
    );
    let columns = [PHOTONS, MAPS, BUILD_SECONDS, PAPER_BUILD_SECONDS, LOOK_UP_US, PAPER_LOOK_UP_US];
    notebook.begin(Table::new("table-8.1", "Table 8.1: one map or many", about, &columns));
    let photon_count = effort.photons(MANY);
    for (map_count, [paper_build, paper_look_up]) in TABLE_8_1 {
        notebook.row(&format!("maps {map_count}"), || {
            let maps: Vec<_> = (0..map_count)
                .map(|map| random_points(u64::from(map), (photon_count / map_count).max(1)))
                .collect();
            let (built, first) = trees(&maps);
            let again = (1..effort.repeats).map(|_| trees(&maps).1);
            let seconds = median(std::iter::once(first).chain(again).collect());
            let look_up = look_up_seconds(&built, 500).map(|seconds| 1e6 * seconds);
            Ok(cells([
                (PHOTONS, f64::from(photon_count).into()),
                (MAPS, f64::from(map_count).into()),
                (BUILD_SECONDS, seconds.into()),
                (PAPER_BUILD_SECONDS, paper_build.into()),
                (LOOK_UP_US, look_up.into()),
                (PAPER_LOOK_UP_US, paper_look_up.into()),
            ]))
        })?;
    }
    Ok(())
}

/// Table 14.1.
pub(super) fn measure_small(notebook: &mut Notebook, effort: Effort) -> Result<(), ReportError> {
    let about = format!(
        "Small maps of photons at random places in a unit cube; one thread. Medians: of {} times {SMALL_BUILDS} builds, and \
         of {ROUNDS} rounds of {LOOK_UPS} look-ups.",
        effort.repeats
    );
    let columns = [PHOTONS, BUILD_MS, PAPER_BUILD_MS, LOOK_UP_MS, PAPER_LOOK_UP_MS];
    notebook.begin(Table::new("table-14.1", "Table 14.1: small maps", about, &columns));
    for (photon_count, [paper_look_up, paper_build]) in TABLE_14_1 {
        notebook.row(&format!("photons {photon_count}"), || {
            let maps: Vec<_> = (0..SMALL_BUILDS as u64).map(|map| random_points(map, photon_count)).collect();
            let (built, first) = trees(&maps);
            let again = (1..effort.repeats).map(|_| trees(&maps).1);
            let seconds = median(std::iter::once(first).chain(again).collect());
            let build = seconds.map(|seconds| 1e3 * seconds / SMALL_BUILDS as f64);
            let look_up = look_up_seconds(&built, 100).map(|seconds| 1e3 * seconds);
            Ok(cells([
                (PHOTONS, f64::from(photon_count).into()),
                (BUILD_MS, build.into()),
                (PAPER_BUILD_MS, paper_build.into()),
                (LOOK_UP_MS, look_up.into()),
                (PAPER_LOOK_UP_MS, paper_look_up.into()),
            ]))
        })?;
    }
    Ok(())
}

/// Figures by the key of their column.
pub(super) fn cells<const N: usize>(figures: [(Column, Cell); N]) -> Cells {
    figures.map(|(column, cell)| (column.key.to_string(), cell)).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The random points fill the cube evenly and differ by seed.
    #[test]
    fn random_points_fill_the_cube() {
        let points = random_points(3, 30_000);
        for axis in 0..3 {
            let mean = points.iter().map(|point| f64::from(point[axis])).sum::<f64>() / 30_000.0;
            // Five standard deviations of the mean of 30,000 even numbers.
            assert!((mean - 0.5).abs() < 5.0 / (12.0f64 * 30_000.0).sqrt(), "{mean}");
        }
        assert!(points.iter().flatten().all(|value| (0.0..1.0).contains(value)));
        assert_ne!(random_points(4, 1), random_points(3, 1));
    }

    /// The nearest are those that counting through all finds.
    #[test]
    fn nearest_are_the_nearest() {
        let points = random_points(1, 500);
        let tree = Tree::new_from_slice(&points).unwrap();
        let at = [0.3, 0.4, 0.9];
        let mut found: Vec<u32> =
            nearest(&tree, at, NonZeroUsize::new(20).unwrap()).into_iter().map(|(_, item)| item).collect();
        let distance =
            |item: u32| -> f32 { points[item as usize].iter().zip(at).map(|(p, a)| (p - a).powi(2)).sum() };
        let mut all: Vec<u32> = (0..500).collect();
        all.sort_by(|a, b| distance(*a).total_cmp(&distance(*b)));
        let mut expected = all[..20].to_vec();
        found.sort_unstable();
        expected.sort_unstable();
        assert_eq!(found, expected);
    }

    /// Medians are middles.
    #[test]
    fn medians_are_middles() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(Vec::new()), None);
    }
}
