//! What stands up around a record: how far its surface lies open before it, direction by direction.
//!
//! A record counts over a sphere, and where that is wider than what the record is close to (over pixels, where it is rough, or because
//! one wall is near and all others far) it reaches through walls into the room behind them. Its own lowest rays say where they stand:
//! hits of neighbouring directions are joined by straight lines, as a wall is seen from above, and what lies beyond the
//! line and lower than where it was hit is hidden. Where a wall ends all that is farther in that sector is. On the inside of a
//! vault, where the lowest rays meet the vault itself, what lies beyond them lies higher, and is not.

use std::f32::consts::{SQRT_2, TAU};

use glam::{Vec2, Vec3};

/// Directions in which it is kept how far the surface lies open.
pub(super) const SECTORS: usize = 12;
/// Of the nearest hits that those are found from.
const BINS: usize = 2 * SECTORS;
/// Cosine to the normal up to which a ray is a low one: a sixth of those of a hemisphere are.
const LOW_COS: f32 = 0.408;
/// Steps of a length to an octave, 2 to the power of sixteenths: a wall is taken to stand nearer than it does by a twenty-third of its
/// distance at most.
#[rustfmt::skip]
const STEPS: [f32; 16] = [
    1.0, 1.044274, 1.090508, 1.138789, 1.189207, 1.241858, 1.29684, 1.354256,
    SQRT_2, 1.476826, 1.542211, 1.61049, 1.681793, 1.756252, 1.834008, 1.915207,
];
pub(super) const PER_OCTAVE: f32 = STEPS.len() as f32;
/// Nothing was met, or farther than codes go.
pub(super) const ENDLESS: u8 = u8::MAX;
/// In the code of a sector's first rise: what stands in the sector ends there.
pub(super) const SILHOUETTE: u8 = 0x80;
/// Sine of the angle by which a wall that is found from hits seems to turn at most.
const STRAIGHT_SIN: f32 = 0.17;
pub(super) const RISE_CODE_MAX: u8 = SILHOUETTE - 1;
/// Rise of the highest code, and a little more than that of any low ray.
pub(super) const RISE_MAX: f32 = 0.45;
/// Between two directions a wall may come nearer than in either, by so much: cos (π / 12), rounded down.
pub(super) const BETWEEN: f32 = 0.965;
/// Two hits with more than this between their directions are not joined, rad: in a corner they are of two walls.
const GAP_MAX: f32 = 0.25 * TAU;
/// A wall goes on beyond the last that was met of it by so much, rad: hardly more than the half of a sector.
const LENGTHENED: f32 = 0.05 * TAU;

/// See the module's head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Horizon {
    /// Nothing nearer is hidden: the upper half of the bits of a distance, which is rounded down by that.
    nearest: u16,
    /// Open way in each direction over the shortest, in steps of its logarithm, rounded down.
    ways: [u8; SECTORS],
    /// Rise over way of what was met there, rounded down; and whether what stands between there and the next direction ends.
    rises: [u8; SECTORS],
}

/// The nearest that low rays have met.
#[derive(Clone, Debug)]
pub(super) struct LowHits {
    bins: [Bin; BINS],
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Bin {
    /// No ray went there.
    Unknown,
    /// None of those that did met anything.
    Open,
    Met {
        /// In the surface's plane, m.
        at: Vec2,
        /// Height over way.
        rise: f32,
    },
}

/// The nearest in a direction.
#[derive(Clone, Copy, Debug)]
struct Nearest {
    angle: f32,
    met: Bin,
}

impl LowHits {
    pub(super) const NONE: LowHits = LowHits { bins: [Bin::Unknown; BINS] };

    /// Takes in a ray.
    ///
    /// - `local`: its unit direction in the frame around the triangle's normal
    /// - `distance_m`: to what it met; `None`: nothing
    pub(super) fn add(&mut self, local: Vec3, distance_m: Option<f32>) {
        if !(local.z > 0.0 && local.z < LOW_COS) {
            return;
        }
        let along = local.truncate();
        let bin = &mut self.bins[bin_of(along)];
        let Some(distance_m) = distance_m.filter(|distance_m| *distance_m < f32::INFINITY) else {
            *bin = if *bin == Bin::Unknown { Bin::Open } else { *bin };
            return;
        };
        let at = along * distance_m;
        // What a ray set out from stands on no side of it.
        if !(at.length_squared() > 0.0) {
            return;
        }
        let is_nearer = match bin {
            Bin::Met { at: other, .. } => at.length_squared() < other.length_squared(),
            _ => true,
        };
        if is_nearer {
            *bin = Bin::Met { at, rise: local.z / along.length() };
        }
    }

    /// Those hits, in the frame around the triangle's normal, m.
    pub(super) fn places(&self) -> impl Iterator<Item = Vec3> {
        self.bins.iter().filter_map(|bin| match *bin {
            Bin::Met { at, rise } => Some(at.extend(rise * at.length())),
            Bin::Unknown | Bin::Open => None,
        })
    }

    pub(super) fn horizon(&self) -> Horizon {
        let known: Vec<Nearest> = self
            .bins
            .iter()
            .enumerate()
            .filter_map(|(bin, met)| match met {
                Bin::Unknown => None,
                Bin::Open => Some(Nearest { angle: TAU * (bin as f32 + 0.5) / BINS as f32, met: *met }),
                Bin::Met { at, .. } => Some(Nearest { angle: angle_of(*at), met: *met }),
            })
            .collect();
        let open: [Option<(f32, f32)>; SECTORS] = std::array::from_fn(|sector| {
            let direction = direction_of(sector);
            let angle = TAU * sector as f32 / SECTORS as f32;
            // Ascending by angle: bins do not overlap.
            let next = known.iter().position(|one| one.angle > angle).unwrap_or(0);
            let before = known.get((next + known.len()).checked_sub(1)? % known.len())?;
            way_between(direction, angle, before, &known[next])
        });
        let shortest_m = open.iter().flatten().map(|(way_m, _)| *way_m).fold(f32::INFINITY, f32::min);
        let nearest = upper_half(BETWEEN * shortest_m);
        let shortest_m = from_upper_half(nearest) / BETWEEN;
        if !(shortest_m > 0.0 && shortest_m < f32::INFINITY) {
            return Horizon::OPEN;
        }
        let way = |met: &Option<(f32, f32)>| {
            // Casts saturate.
            met.map_or(ENDLESS, |(way_m, _)| ((way_m / shortest_m).log2() * PER_OCTAVE) as u8)
        };
        let rise = |met: &Option<(f32, f32)>| {
            // Lower than everything: what has no height hides nothing, and what is met has some.
            met.map_or(RISE_CODE_MAX, |(_, rise)| ((rise / RISE_MAX * f32::from(RISE_CODE_MAX)) as u8).max(1))
        };
        let edges: [Option<Vec2>; SECTORS] =
            std::array::from_fn(|sector| open[sector].map(|(way_m, _)| direction_of(sector) * way_m));
        let mut rises = open.each_ref().map(rise);
        for (sector, rise) in rises.iter_mut().enumerate() {
            *rise |= if ends_in(&edges, sector) { SILHOUETTE } else { 0 };
        }
        Horizon { nearest, ways: open.each_ref().map(way), rises }
    }
}

/// How far the way lies open between two neighbouring hits, m, and the rise of the lower one; `None`: without end.
fn way_between(direction: Vec2, angle: f32, before: &Nearest, after: &Nearest) -> Option<(f32, f32)> {
    let [since, until] =
        [angle - before.angle, after.angle - angle].map(|difference| difference.rem_euclid(TAU));
    if let (Bin::Met { at: a, rise: rise_a }, Bin::Met { at: b, rise: rise_b }) = (before.met, after.met)
        && since + until < GAP_MAX
        && a != b
    {
        // On the line from one to the other.
        let way_m = a.perp_dot(b) / direction.perp_dot(b - a);
        if way_m > 0.0 {
            return Some((way_m, rise_a.min(rise_b)));
        }
    }
    // Where a wall ends, or is seen at too flat an angle, it is taken for a little longer.
    let met = [(before, since), (after, until)].into_iter().filter_map(|(nearest, away)| match nearest.met {
        Bin::Met { at, rise } if away < LENGTHENED => Some((at.length(), rise, away)),
        _ => None,
    });
    met.min_by(|a, b| a.2.total_cmp(&b.2)).map(|(way_m, rise, _)| (way_m, rise))
}

/// In a sector what stands there ends, and farther things are seen beside it: at the nearer of its two ends the line that joins all of them
/// turns away from the middle.
fn ends_in(edges: &[Option<Vec2>; SECTORS], sector: usize) -> bool {
    let at = |offset: usize| edges[(sector + offset) % SECTORS];
    let turns_away = |from: Vec2, by: Vec2, to: Vec2| {
        let (before, after) = (by - from, to - by);
        before.perp_dot(after) < -STRAIGHT_SIN * before.length() * after.length()
    };
    match (at(0), at(1)) {
        (None, None) => false,
        (Some(a), Some(b)) if a.length_squared() <= b.length_squared() => {
            at(SECTORS - 1).is_none_or(|before| turns_away(before, a, b))
        }
        (Some(a), Some(b)) => at(2).is_none_or(|after| turns_away(a, b, after)),
        _ => true,
    }
}

fn angle_of(at: Vec2) -> f32 {
    at.y.atan2(at.x).rem_euclid(TAU)
}

fn bin_of(along: Vec2) -> usize {
    ((angle_of(along) / TAU * BINS as f32) as usize).min(BINS - 1)
}

/// cos and sin of the angles of sectors.
const DIRECTIONS: [[f32; 2]; SECTORS] = {
    const HALF_ROOT_3: f32 = 0.866_025_4;
    let [c, s, h] = [HALF_ROOT_3, 0.5, 1.0];
    [
        [h, 0.0],
        [c, s],
        [s, c],
        [0.0, h],
        [-s, c],
        [-c, s],
        [-h, 0.0],
        [-c, -s],
        [-s, -c],
        [0.0, -h],
        [s, -c],
        [c, -s],
    ]
};

fn direction_of(sector: usize) -> Vec2 {
    Vec2::from(DIRECTIONS[sector % SECTORS])
}

/// The sector whose direction comes before that of a way, counter-clockwise.
fn sector_of(way: Vec2) -> usize {
    const TAN_30: f32 = 0.577_350_26;
    const TAN_60: f32 = 1.732_050_8;
    let [x, y] = [way.x.abs(), way.y.abs()];
    let third = usize::from(y >= TAN_30 * x) + usize::from(y >= TAN_60 * x);
    match (way.x >= 0.0, way.y >= 0.0) {
        (true, true) => third,
        (false, true) => 5 - third,
        (false, false) => 6 + third,
        (true, false) => 11 - third,
    }
}

/// Of a number that is not negative, rounded down to eight digits of two.
const fn upper_half(number: f32) -> u16 {
    (number.to_bits() >> 16) as u16
}

#[inline]
fn from_upper_half(half: u16) -> f32 {
    f32::from_bits(u32::from(half) << 16)
}

impl Horizon {
    /// Nothing stands anywhere.
    pub(super) const OPEN: Horizon = Horizon {
        nearest: upper_half(f32::INFINITY),
        ways: [ENDLESS; SECTORS],
        rises: [RISE_CODE_MAX; SECTORS],
    };

    /// Nothing is hidden up to here, m.
    #[inline]
    pub(super) fn nearest_m(&self) -> f32 {
        from_upper_half(self.nearest)
    }

    /// Codes of open ways and of rises, four directions a word.
    pub(super) fn words(&self) -> [[u32; SECTORS / 4]; 2] {
        [&self.ways, &self.rises].map(|codes| {
            let word_of = |word: usize| std::array::from_fn(|byte| codes[4 * word + byte]);
            std::array::from_fn(|word| u32::from_le_bytes(word_of(word)))
        })
    }

    /// Something stands between here and there.
    ///
    /// - `way`: to there, in the frame around the triangle's normal, m
    pub(super) fn hides(&self, way: Vec3) -> bool {
        let along = way.truncate();
        let along_m = along.length();
        if !(along_m > self.nearest_m()) {
            return false;
        }
        let sector = sector_of(along);
        let next = (sector + 1) % SECTORS;
        let rise = (self.rises[sector] & RISE_CODE_MAX).min(self.rises[next] & RISE_CODE_MAX);
        if way.z >= f32::from(rise) / f32::from(RISE_CODE_MAX) * RISE_MAX * along_m {
            return false;
        }
        let ways_m = [sector, next].map(|sector| self.way_m(sector));
        if self.rises[sector] & SILHOUETTE != 0 {
            // Where it ends is not known to a sector: what is seen beside it is left to who is nearer.
            let nearer_m = ways_m.into_iter().flatten().fold(f32::INFINITY, f32::min);
            return along_m > nearer_m;
        }
        // On the far side of the edge from one to the other.
        let [Some(a_m), Some(b_m)] = ways_m else { return false };
        let (a, b) = (direction_of(sector) * a_m, direction_of(next) * b_m);
        (b - a).perp_dot(along - a) < 0.0
    }

    /// Open way in a direction; `None`: without end.
    #[inline]
    fn way_m(&self, sector: usize) -> Option<f32> {
        let code = self.ways[sector];
        let octaves = f32::from_bits((u32::from(code) / STEPS.len() as u32 + 127) << 23);
        let way_m = || self.nearest_m() / BETWEEN * octaves * STEPS[usize::from(code) % STEPS.len()];
        (code != ENDLESS).then(way_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sobol::point;

    /// Low rays of which a wall stops some.
    ///
    /// - `towards`: the direction that it is in, rad
    fn before_wall(distance_m: f32, towards: f32, count: u32) -> LowHits {
        let mut hits = LowHits::NONE;
        for index in 0..count {
            let [u, v, ..] = point(31, index);
            let cos = (v * 0.17).sqrt();
            let along = Vec2::from_angle(TAU * (index as f32 + u) / count as f32) * (1.0 - cos * cos).sqrt();
            let approach = along.dot(Vec2::from_angle(towards));
            hits.add(along.extend(cos), (approach > 0.0).then(|| distance_m / approach));
        }
        hits
    }

    /// Nothing behind a wall is seen, and little before it taken for hidden, whichever way the wall stands, over twelve orders of
    /// magnitude.
    #[test]
    fn a_wall_hides_what_lies_behind_it() {
        for index in 0..300 {
            let [towards, ..] = point(32, index);
            let towards = TAU * towards;
            let distance_m = 10f32.powi(index as i32 % 13 - 6);
            let horizon = before_wall(distance_m, towards, 38).horizon();
            let (mut lost, mut all) = (0, 0);
            for index in 0..400 {
                let [across, along, ..] = point(33, index);
                let across = (across - 0.5) * 4.0;
                let at = |depth: f32| Vec2::from_angle(towards).rotate(Vec2::new(depth, across)) * distance_m;
                let behind = at(1.002 + 2.0 * along * along);
                // Beside the end of what its rays have met it may be that there is no wall.
                if across.abs() < 1.5 {
                    assert!(horizon.hides(behind.extend(0.0)), "{behind} behind {distance_m} m at {towards}");
                }
                lost += u32::from(horizon.hides(at(along).extend(0.0)));
                all += 1;
            }
            assert!(lost * 6 < all, "{lost} of {all} before {distance_m} m at {towards}");
        }
    }

    /// On the inside of a ball every place sees every other.
    #[test]
    fn vaults_hide_nothing_of_themselves() {
        let on_ball = |index: u32| {
            let [u, v, ..] = point(34, index);
            let cos = (v * 0.17).sqrt();
            let along = Vec2::from_angle(TAU * u) * (1.0 - cos * cos).sqrt();
            // A chord of a ball of radius 1 that touches the plane.
            (along.extend(cos), 2.0 * cos)
        };
        let mut hits = LowHits::NONE;
        for (direction, chord_m) in (0..40).map(on_ball) {
            hits.add(direction, Some(chord_m));
        }
        let horizon = hits.horizon();
        let hidden = (100..4_000).map(on_ball).filter(|(to, chord_m)| horizon.hides(*to * *chord_m)).count();
        assert!(hidden < 300, "{hidden} of 3900");
    }

    /// No rays, none that meets anything, and lengths that are no number hide nothing.
    #[test]
    fn what_is_not_known_hides_nothing() {
        let everywhere = |horizon: Horizon| {
            (0..100).all(|index| {
                let way = Vec2::from_angle(index as f32) * 10f32.powi(index % 30 - 15);
                !horizon.hides(way.extend(0.0)) && !horizon.hides(way.extend(-way.length()))
            })
        };
        assert!(everywhere(LowHits::NONE.horizon()) && everywhere(Horizon::OPEN));
        for distance_m in [None, Some(f32::INFINITY), Some(f32::NAN), Some(0.0)] {
            let mut hits = LowHits::NONE;
            for index in 0..40 {
                hits.add((Vec2::from_angle(index as f32) * 0.99).extend(0.14), distance_m);
            }
            assert!(everywhere(hits.horizon()), "{distance_m:?}");
        }
        // High rays say nothing.
        let mut hits = LowHits::NONE;
        hits.add(Vec3::new(0.8, 0.0, 0.6), Some(1.0));
        assert!(everywhere(hits.horizon()));
    }

    /// What lies to the open side is seen from however near the wall on the other.
    #[test]
    fn one_wall_hides_one_side() {
        for distance_m in [1e-6, 1e-3, 1.0] {
            let horizon = before_wall(distance_m, 0.3, 38).horizon();
            for index in 0..1_000 {
                let [turned, way, ..] = point(35, index);
                let angle = 0.3 + TAU * (0.3 + 0.4 * turned);
                let way_m = 10f32.powf(12.0 * way - 6.0);
                assert!(
                    !horizon.hides((Vec2::from_angle(angle) * way_m).extend(0.0)),
                    "{way_m} m at {angle}"
                );
            }
        }
    }

    /// Beside the end of a wall, where its rays go on, a record hardly counts behind the wall.
    #[test]
    fn walls_hide_up_to_their_ends() {
        let (mut leaked, mut behind) = (0, 0);
        for index in 0..200 {
            let [towards, end, ..] = point(36, index);
            let (towards, end) = (TAU * towards, 1.5 * end - 0.5);
            let turned = Vec2::from_angle(towards);
            let mut hits = LowHits::NONE;
            for ray in 0..38 {
                let [u, v, ..] = point(37 + u64::from(index), ray);
                let cos = (v * 0.17).sqrt();
                let along = Vec2::from_angle(TAU * (ray as f32 + u) / 38.0) * (1.0 - cos * cos).sqrt();
                let local = Vec2::from_angle(-towards).rotate(along);
                // A wall at x = 1 up to y = `end`, and one at x = 6 behind it.
                let meets = |x: f32| (local.x > 0.0).then(|| x / local.x);
                let before = meets(1.0).filter(|way| way * local.y < end);
                hits.add(along.extend(cos), before.or(meets(6.0)));
            }
            let horizon = hits.horizon();
            for number in 0..200 {
                let [depth, across, ..] = point(38, number);
                // What the wall hides of the first two metres behind it.
                let (depth, across) = (1.01 + 2.0 * depth, 5.0 * across - 4.0);
                if across / depth < end {
                    behind += 1;
                    let at = turned.rotate(Vec2::new(depth, across));
                    leaked += u32::from(!horizon.hides(at.extend(0.0)));
                }
            }
        }
        assert!(behind > 10_000 && leaked * 50 < behind, "{leaked} of {behind}");
    }

    #[test]
    fn steps_are_powers() {
        for (step, value) in STEPS.iter().enumerate() {
            assert!((value - (step as f32 / PER_OCTAVE).exp2()).abs() < 1e-6);
        }
        let nearest = upper_half(BETWEEN * 3.0);
        let shortest_m = from_upper_half(nearest) / BETWEEN;
        assert!(shortest_m <= 3.0 && shortest_m > 2.97, "{shortest_m}");
        let mut ways = [ENDLESS; SECTORS];
        ways[..3].copy_from_slice(&[0, 17, 254]);
        let horizon = Horizon { nearest, ways, ..Horizon::OPEN };
        for (sector, octaves) in [0.0, 17.0 / 16.0, 254.0 / 16.0].into_iter().enumerate() {
            let way_m = horizon.way_m(sector).unwrap();
            assert!((way_m / (shortest_m * f32::exp2(octaves)) - 1.0).abs() < 1e-5, "{way_m}");
        }
        assert_eq!(horizon.way_m(3), None);
    }

    #[test]
    fn sectors_are_found_without_angles() {
        for index in 0..10_000 {
            let angle = TAU * (index as f32 + 0.5) / 10_000.0;
            let expected = (angle / TAU * SECTORS as f32) as usize;
            assert_eq!(sector_of(Vec2::from_angle(angle) * (1.0 + index as f32)), expected, "{angle}");
        }
        for (sector, [x, y]) in DIRECTIONS.iter().enumerate() {
            let angle = TAU * sector as f32 / SECTORS as f32;
            assert!(Vec2::from_angle(angle).distance(Vec2::new(*x, *y)) < 1e-6);
        }
    }
}
