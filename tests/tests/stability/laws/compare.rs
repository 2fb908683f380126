//! When two sets of pictures count as those of the same scene.

use std::sync::Arc;
use std::time::Duration;

use lumicast_engine::math::{Rgb, RunningStatistics};
use lumicast_engine::transport::World;

use crate::draft::Draft;
use crate::drawing::{Drawn, Effort, Technique, draw, name};

/// Pictures of each kind, with seeds of their own.
const PICTURES: u64 = 3;
const SIDE: usize = 24;
/// Sides of the blocks that are compared: small enough that a wall that has lost its light shows, large enough that noise does not.
const BLOCK: usize = 6;
const BLOCKS_ACROSS: usize = SIDE / BLOCK;
const BLOCKS: usize = BLOCKS_ACROSS * BLOCKS_ACROSS;

pub(super) const EFFORT: Effort = Effort {
    side: SIDE as u32,
    passes: 24,
    photons: 24_000,
    neighbours: 48,
    rays: 100,
    patience: Duration::from_secs(120),
};

/// Pictures of one scene by one technique, seed by seed.
#[derive(Clone, Debug)]
pub(super) struct Pictures {
    pub(super) technique: Technique,
    pub(super) radiance: Vec<Vec<Rgb>>,
}

/// How far means may be off for other reasons than noise, in shares: that of the picture, and that of every block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tolerance {
    pub(super) whole: f64,
    pub(super) block: f64,
}

impl Pictures {
    pub(super) fn of(draft: &Draft, technique: Technique) -> Pictures {
        let scene = draft.build().unwrap_or_else(|error| panic!("{error}"));
        let world = Arc::new(World::prepare(Arc::new(scene)));
        let picture = |seed| {
            let rendering = draw(&world, Drawn { technique, seed, bounces_max: None }, &EFFORT)
                .unwrap_or_else(|error| panic!("{}: {error}", name(technique)));
            assert_eq!(rendering.dropped_samples(), 0, "{}", name(technique));
            technique.assert_drawn_as_named(&rendering);
            rendering.picture().radiance()
        };
        Pictures { technique, radiance: (0..PICTURES).map(picture).collect() }
    }

    pub(super) fn plus(&self, other: &Pictures) -> Pictures {
        let added = |(a, b): (&Vec<Rgb>, &Vec<Rgb>)| a.iter().zip(b).map(|(a, b)| *a + *b).collect();
        let radiance = self.radiance.iter().zip(&other.radiance).map(added).collect();
        Pictures { technique: self.technique, radiance }
    }

    /// Mean over all pictures, and its standard error.
    pub(super) fn mean(&self) -> RunningStatistics {
        let mut means = RunningStatistics::default();
        self.radiance.iter().for_each(|picture| means.add(lumicast_tests::mean(picture)));
        means
    }

    fn blocks(&self, seed: usize) -> [f64; BLOCKS] {
        let mut blocks = [0.0; BLOCKS];
        for (at, colour) in self.radiance[seed].iter().enumerate() {
            let block = at / SIDE / BLOCK * BLOCKS_ACROSS + at % SIDE / BLOCK;
            blocks[block] += f64::from(colour.mean()) / (BLOCK * BLOCK) as f64;
        }
        blocks
    }

    /// What tells the pictures from those of `other`, if anything does: no block of them, and not the whole, may be off by more
    /// than the tolerance and six standard deviations of chance. Chance is what the pictures of different seeds differ by, taken
    /// over all blocks together, since three say little.
    pub(super) fn differ(&self, other: &Pictures, tolerance: Tolerance) -> Option<String> {
        let of_seeds: Vec<[[f64; BLOCKS]; 2]> =
            (0..PICTURES as usize).map(|seed| [self.blocks(seed), other.blocks(seed)]).collect();
        let level = |block: usize| {
            of_seeds.iter().map(|[a, b]| (a[block] + b[block]) / 2.0).sum::<f64>() / PICTURES as f64
        };
        let levels: Vec<f64> = (0..BLOCKS).map(level).collect();
        let mean = levels.iter().sum::<f64>() / BLOCKS as f64;
        let mut variance = 0.0;
        let mut off = [0.0; BLOCKS];
        for block in 0..BLOCKS {
            let mut differences = RunningStatistics::default();
            // A dark block is compared with the picture as well, which it is part of.
            let scale = levels[block] + 0.2 * mean;
            of_seeds.iter().for_each(|[a, b]| differences.add((a[block] - b[block]) / scale));
            off[block] = differences.mean();
            variance += differences.standard_error().powi(2) / BLOCKS as f64;
        }
        let chance = 6.0 * variance.sqrt();
        let mut whole = RunningStatistics::default();
        of_seeds.iter().for_each(|[a, b]| {
            whole.add((a.iter().sum::<f64>() - b.iter().sum::<f64>()) / BLOCKS as f64 / mean)
        });
        let whole_chance = 6.0 * whole.standard_error();
        let worst = off.iter().fold(0.0f64, |worst, off| worst.max(off.abs()));
        let found = format!(
            "{}: mean off by {:+.4} (chance {whole_chance:.4}, allowed {}), worst block by {worst:.4} (chance {chance:.4}, allowed {})",
            name(self.technique),
            whole.mean(),
            tolerance.whole,
            tolerance.block
        );
        println!("  {found}");
        let is_same =
            whole.mean().abs() <= tolerance.whole + whole_chance && worst <= tolerance.block + chance;
        (!is_same).then_some(found)
    }
}
