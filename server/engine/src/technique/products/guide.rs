//! Where the light comes from that falls on surfaces, as photons tell it: for paths that look for light.
//!
//! Photons that other surfaces sent on are sorted into a tree by where they fell and which way that surface faces. Those of a leaf say how much
//! light comes through which part of the hemisphere there [Jensen1995], as a tree of quarters like that of [Mueller2017]: it is the
//! finer the more photons came through, and quarters that few came through share what they brought with their neighbours. A direction is
//! drawn by it with a fixed chance and else by the cosine, so that none is left out: what follows it is right whatever photons say, and
//! where they say nothing of use little is lost.

#[cfg(test)]
pub(in crate::technique) mod samples_of_guides;
#[cfg(test)]
mod tests;

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};

use crate::math::{Frame, sobol::mix, warp};

/// Flights of indirect and of focused light that are asked at most, each, drawn evenly of more. With a quarter of them path tracing's
/// variance times its rays was a tenth to a quarter higher (two-rooms, spots, a corridor); four times as many are no better and take twice
/// as long to sort.
const FLIGHTS_MAX: usize = 1 << 17;
/// Flights of either kind of a leaf at most, unless they ended at one point. Half as many or twice as many change variances by less than chance.
const LEAF_FLIGHTS_MAX: usize = 256;
/// Halvings of the tree at most: three times what as many flights need that lie evenly.
const LEAF_DEPTH_MAX: u32 = 32;
/// Share of directions that photons draw: what they say wrongly costs at most twice the variance, and what they say rightly takes at least half
/// of what an even draw has. With three fifths modern-hall lost 15 % by guidance for 10, with two fifths the spots gained a tenth less.
pub const GUIDED_SHARE: f32 = 0.5;
/// Even light that quarters are taken to have beside what their photons brought, as so many photons in all: chance makes them uneven as
/// well. With 4 in place of 16 paths in Sponza and modern-hall had more variance guided than without.
const EVEN_PHOTONS: f32 = 16.0;
/// A part of the hemisphere is cut in four where it is sent so many photons: of fewer its quarters would hold one each.
const CUT_PHOTONS: f32 = 4.0;
/// Times that it is cut at most. Parts are then 64 × 64, of two degrees: what is smaller leaf by leaf looks different from its ends.
const CUTS_MAX: u32 = 6;
/// Light is even where the mean square of its density over that of the cosine, with the part of it that chance makes taken off, is less: at
/// best a direction drawn by it would have so much less variance, and paths do better without asking.
const EVEN_SQUARE: f32 = 1.3;
/// Parts along the sides of the hemisphere's square that it is told by, from those that many photons share to those that a small spot fills.
const EVEN_PARTS: [usize; 4] = [8, 16, 32, 64];
/// Standard deviations by which it must be more: in small parts few photons meet by chance.
const EVEN_DEVIATIONS: f32 = 3.0;
/// A leaf says nothing of a surface whose normal is more than 60° off its own: from there on a quarter and more of even light would lie below
/// its horizon.
const FACING_COS: f32 = 0.5;
/// A right angle between normals sets flights apart by as much as so many times the length of where they ended: faces of a box are told
/// apart before places are, however normals are rounded.
const TURN_LENGTHS: f32 = 2.0;

/// What photons say of where light comes from, all over the scene.
pub struct Guide {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    quarters: Vec<Quarters>,
    /// Where the flights of indirect light of each leaf began, in its turn, and their flux, W.
    told: Vec<(Vec3, f32)>,
}

impl std::fmt::Debug for Guide {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Guide").field("leaves", &self.leaves.len()).finish()
    }
}

#[derive(Clone, Copy, Debug)]
enum Node {
    /// What has less than `at` follows next.
    Halved {
        axis: Axis,
        at: f32,
        above: u32,
        /// In all below: paths need go no further.
        is_even: bool,
    },
    Leaf(u32),
}

/// Which leaves are of use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Need {
    /// Whose light is not even.
    Uneven,
    /// Whose flights are looked at.
    Any,
}

/// What photons are sorted by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Axis {
    Position(u8),
    Normal(u8),
}

impl Axis {
    const ALL: [Axis; 6] = [
        Axis::Position(0),
        Axis::Position(1),
        Axis::Position(2),
        Axis::Normal(0),
        Axis::Normal(1),
        Axis::Normal(2),
    ];

    fn of(self, position: Vec3, normal: Vec3) -> f32 {
        match self {
            Axis::Position(axis) => position[axis as usize],
            Axis::Normal(axis) => normal[axis as usize],
        }
    }
}

/// The last flight of a photon that another surface sent on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flight {
    /// Where it began, in render space.
    pub from: Vec3,
    /// Where it ended, in render space.
    pub to: Vec3,
    /// Normal of the surface there, on the side it fell on: a unit vector.
    pub normal: Vec3,
    /// Mean flux of the channels, W.
    pub flux_w: f32,
    /// Only mirrors and glass sent it on: paths look for such light, records of irradiance do not hold it.
    pub is_focused: bool,
}

impl Flight {
    /// The flight of some number, of so many of its kind, is one of those that a [`Guide`] is made of; drawn by their numbers, for not every
    /// so-many-th, which might be the first of every path.
    pub fn is_asked(number: u64, count: usize) -> bool {
        mix(number) <= (Flight::asked_share(count) * 2f64.powi(64)) as u64
    }

    /// Share of so many that are asked.
    pub fn asked_share(count: usize) -> f64 {
        (FLIGHTS_MAX as f64 / count.max(1) as f64).min(1.0)
    }

    fn along(&self, axis: Axis) -> f32 {
        axis.of(self.to, self.normal)
    }
}

#[derive(Clone, Copy, Debug)]
struct Leaf {
    frame: Frame,
    /// Of its quarters, those of the whole hemisphere; `None` where light is even.
    whole: Option<u32>,
    /// Its flights of indirect light: first and end.
    told: [u32; 2],
    /// Where it answers: around where they ended, as far again.
    low: Vec3,
    high: Vec3,
}

/// How the light of a part of the hemisphere comes through its quarters.
#[derive(Clone, Copy, Debug)]
struct Quarters {
    /// Of all, `[x + 2 y]` of the square that the hemisphere is spread out on, each more than 0; they sum to 1.
    shares: [f32; 4],
    /// Where a quarter is cut again; 0 where it is not.
    cut: [u32; 4],
}

/// Where light comes from around one place.
#[derive(Clone, Copy, Debug)]
pub struct Guidance<'a> {
    quarters: &'a [Quarters],
    frame: &'a Frame,
    /// The whole hemisphere's.
    whole: u32,
}

impl Guide {
    /// By some flights, see [`Flight::is_asked`]; `None` where there are none that brought light.
    pub fn of(mut flights: Vec<Flight>) -> Option<Guide> {
        flights.retain(|flight| flight.flux_w > 0.0 && flight.flux_w.is_finite());
        flights.truncate(2 * FLIGHTS_MAX);
        if flights.is_empty() {
            return None;
        }
        let mut guide =
            Guide { nodes: Vec::new(), leaves: Vec::new(), quarters: Vec::new(), told: Vec::new() };
        guide.sort(&mut flights, LEAF_DEPTH_MAX);
        Some(guide)
    }

    /// Memory.
    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>()
            + self.leaves.len() * size_of::<Leaf>()
            + self.quarters.len() * size_of::<Quarters>()
            + self.told.len() * size_of::<(Vec3, f32)>()
    }

    /// Adds a node of some flights, and all below it; returns whether light is even in all of it.
    fn sort(&mut self, flights: &mut [Flight], depth_left: u32) -> bool {
        let halves = (are_many(flights) && depth_left > 0).then(|| halve(flights)).flatten();
        let Some((axis, at, below)) = halves else {
            self.nodes.push(Node::Leaf(self.leaves.len() as u32));
            let leaf = self.leaf_of(flights);
            let is_even = leaf.whole.is_none();
            self.leaves.push(leaf);
            return is_even;
        };
        let (below, above) = flights.split_at_mut(below);
        let node = self.nodes.len();
        self.nodes.push(Node::Halved { axis, at, above: 0, is_even: false });
        let is_even_below = self.sort(below, depth_left - 1);
        let place_above = self.nodes.len() as u32;
        let is_even = self.sort(above, depth_left - 1) && is_even_below;
        self.nodes[node] = Node::Halved { axis, at, above: place_above, is_even };
        is_even
    }

    fn leaf_of(&mut self, flights: &[Flight]) -> Leaf {
        let n = flights.iter().map(|flight| flight.normal).sum::<Vec3>().normalize_or(Vec3::Z);
        let frame = Frame::around(n);
        // Few bright ones among many say as little as few do.
        let (sum, squares) = flights.iter().fold((0.0f64, 0.0f64), |(sum, squares), flight| {
            let flux = f64::from(flight.flux_w);
            (sum + flux, squares + flux * flux)
        });
        let photons_per_w = if squares > 0.0 { sum / squares } else { 0.0 };
        let mut seen: Vec<(Vec2, f32)> = flights
            .iter()
            .filter_map(|flight| {
                let direction = frame.to_local(flight.from - flight.to).normalize_or_zero();
                let weight = (f64::from(flight.flux_w) * photons_per_w) as f32;
                (direction.z > 0.0).then(|| (warp::square_of_hemisphere(direction), weight))
            })
            .collect();
        let first = self.told.len() as u32;
        // Of those that fell on one point some say as much as all.
        let some = flights.iter().filter(|flight| !flight.is_focused).take(LEAF_FLIGHTS_MAX);
        self.told.extend(some.map(|flight| (flight.from, flight.flux_w)));
        let told = [first, self.told.len() as u32];
        let ends = || flights.iter().map(|flight| flight.to);
        let low = ends().fold(Vec3::INFINITY, Vec3::min);
        let high = ends().fold(Vec3::NEG_INFINITY, Vec3::max);
        let reach = Vec3::splat((high - low).length());
        Leaf {
            frame,
            whole: (!is_even(&seen)).then(|| self.cut(&mut seen, (Vec2::ZERO, 1.0), CUTS_MAX)),
            told,
            low: low - reach,
            high: high + reach,
        }
    }

    /// Cuts a part of the hemisphere's square in four; returns its place.
    ///
    /// - `seen`: photons in it, and how many each stands for
    /// - `part`: low corner and side
    fn cut(&mut self, seen: &mut [(Vec2, f32)], (low, side): (Vec2, f32), cuts_left: u32) -> u32 {
        let half = 0.5 * side;
        let quarter_of = |at: Vec2| usize::from(at.x >= low.x + half) + 2 * usize::from(at.y >= low.y + half);
        seen.sort_unstable_by_key(|(at, _)| quarter_of(*at));
        let place = self.quarters.len();
        self.quarters.push(Quarters { shares: [0.25; 4], cut: [0; 4] });
        let all: f32 = seen.iter().map(|(_, weight)| weight).sum();
        let mut rest = seen;
        for quarter in 0..4 {
            let end = rest.partition_point(|(at, _)| quarter_of(*at) <= quarter);
            let (within, beyond) = rest.split_at_mut(end);
            rest = beyond;
            let weight: f32 = within.iter().map(|(_, weight)| weight).sum();
            self.quarters[place].shares[quarter] = (weight + 0.25 * EVEN_PHOTONS) / (all + EVEN_PHOTONS);
            if weight >= CUT_PHOTONS && cuts_left > 1 {
                let corner = low + half * Vec2::new((quarter % 2) as f32, (quarter / 2) as f32);
                self.quarters[place].cut[quarter] = self.cut(within, (corner, half), cuts_left - 1);
            }
        }
        place as u32
    }

    /// Where light comes from at `p`, if anything is known of surfaces thereabouts that face like `n` and it is not even.
    pub fn at(&self, p: Vec3, n: Vec3) -> Option<Guidance<'_>> {
        let leaf = self.leaf_at(p, n, Need::Uneven)?;
        Some(Guidance { quarters: &self.quarters, frame: &leaf.frame, whole: leaf.whole? })
    }

    /// Where flights of indirect light began that ended about `p` on surfaces that face like `n`, in render space, and their flux, W.
    pub fn flights_at(&self, p: Vec3, n: Vec3) -> &[(Vec3, f32)] {
        let told = self.leaf_at(p, n, Need::Any).map_or([0, 0], |leaf| leaf.told);
        &self.told[told[0] as usize..told[1] as usize]
    }

    /// The leaf that answers there.
    fn leaf_at(&self, p: Vec3, n: Vec3, need: Need) -> Option<&Leaf> {
        let mut place = 0;
        loop {
            match self.nodes[place] {
                Node::Halved { is_even: true, .. } if need == Need::Uneven => return None,
                Node::Halved { axis, at, above, .. } => {
                    place = if axis.of(p, n) < at { place + 1 } else { above as usize };
                }
                Node::Leaf(leaf) => {
                    let leaf = &self.leaves[leaf as usize];
                    let is_near = p.cmpge(leaf.low).all() && p.cmple(leaf.high).all();
                    let is_alike = leaf.frame.n.dot(n) > FACING_COS;
                    return (is_near && is_alike).then_some(leaf);
                }
            }
        }
    }
}

/// More than a leaf has: of either kind, but focused light does not part the last of what is told of indirect light.
fn are_many(flights: &[Flight]) -> bool {
    let focused = flights.iter().filter(|flight| flight.is_focused).count();
    let indirect = flights.len() - focused;
    let may_part = indirect == 0 || indirect >= LEAF_FLIGHTS_MAX / 2;
    indirect > LEAF_FLIGHTS_MAX || focused > LEAF_FLIGHTS_MAX && may_part
}

/// Photons say no more of where light comes from than the cosine does.
///
/// - `seen`: places on the hemisphere's square, and how many photons each stands for
fn is_even(seen: &[(Vec2, f32)]) -> bool {
    let (all, alone) =
        seen.iter().fold((0.0, 0.0), |(all, alone), (_, weight)| (all + weight, alone + weight * weight));
    // As many photons as weigh alike.
    let photons = all * all / f32::max(alone, f32::MIN_POSITIVE);
    let pairs = all * all - alone;
    EVEN_PARTS.into_iter().all(|side| {
        let mut parts = vec![0.0f32; side * side];
        for (at, weight) in seen {
            let [x, y] = (*at * side as f32).to_array().map(|at| (at as usize).min(side - 1));
            parts[y * side + x] += weight;
        }
        // Pairs of two photons in one part, over those of all: of each with itself chance alone makes as many.
        let paired = parts.iter().map(|weight| weight * weight).sum::<f32>() - alone;
        let count = parts.len() as f32;
        // Of even light one in so many pairs meets, as often as chance has it.
        let deviation = (2.0 * count).sqrt() / photons.max(1.0);
        paired * count <= (EVEN_SQUARE + EVEN_DEVIATIONS * deviation) * pairs
    })
}

/// Sorts flights into two by what sets them apart most: what that is, where the second begins, and with which of them. `None` where all lie
/// together.
fn halve(flights: &mut [Flight]) -> Option<(Axis, f32, usize)> {
    let [mut low, mut high] = [[f32::INFINITY; 6], [f32::NEG_INFINITY; 6]];
    for flight in flights.iter() {
        for (index, axis) in Axis::ALL.into_iter().enumerate() {
            let at = flight.along(axis);
            (low[index], high[index]) = (low[index].min(at), high[index].max(at));
        }
    }
    let size_m = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f32::max);
    let apart =
        |index: usize| (high[index] - low[index]) * if index < 3 { 1.0 } else { TURN_LENGTHS * size_m };
    let index = (0..6).max_by(|a, b| apart(*a).total_cmp(&apart(*b)))?;
    let axis = Axis::ALL[index];
    let at = match axis {
        Axis::Position(_) => {
            let middle = flights.len() / 2;
            flights.select_nth_unstable_by(middle, |a, b| a.along(axis).total_cmp(&b.along(axis)));
            let at = flights[middle].along(axis);
            // Most may end in one plane, below all others: those are parted from it.
            let beyond =
                || flights.iter().map(|flight| flight.along(axis)).filter(|along| *along > low[index]);
            if at > low[index] { at } else { beyond().fold(f32::INFINITY, f32::min) }
        }
        // Most surfaces face one of a few ways: the one in the middle would part those that face alike.
        Axis::Normal(_) => 0.5 * (low[index] + high[index]),
    };
    flights.sort_unstable_by_key(|flight| flight.along(axis) >= at);
    let below = flights.partition_point(|flight| flight.along(axis) < at);
    (0 < below && below < flights.len()).then_some((axis, at, below))
}

impl Guidance<'_> {
    /// Density of drawing `wi` by the cosine or, with the chance of [`GUIDED_SHARE`], by photons, over that by the cosine alone.
    ///
    /// - `wi`: a unit vector
    /// - `cos`: with the normal that directions are drawn around by the cosine. Where it vanishes the ratio is as large as numbers are, in
    ///   place of infinite: what the surface sends on from there vanishes as well
    pub fn ratio(&self, wi: Vec3, cos: f32) -> f32 {
        let density = self.density(wi);
        let by_cosine = (cos * FRAC_1_PI).max(f32::MIN_POSITIVE);
        (1.0 - GUIDED_SHARE + GUIDED_SHARE * density / by_cosine).min(f32::MAX)
    }

    /// Density of [`Guidance::draw`], 1/sr.
    fn density(&self, wi: Vec3) -> f32 {
        let direction = self.frame.to_local(wi);
        if direction.z <= 0.0 {
            return 0.0;
        }
        let mut at = warp::square_of_hemisphere(direction);
        let mut density = warp::cosine_hemisphere_pdf(direction.z);
        let mut place = self.whole;
        loop {
            let quarters = &self.quarters[place as usize];
            at *= 2.0;
            let outer = at.cmpge(Vec2::ONE);
            at -= Vec2::select(outer, Vec2::ONE, Vec2::ZERO);
            let quarter = outer.bitmask() as usize;
            density *= 4.0 * quarters.shares[quarter];
            place = quarters.cut[quarter];
            if place == 0 {
                return density;
            }
        }
    }

    /// A direction drawn by photons alone, a unit vector.
    ///
    /// - `u`: from 0 to 1
    pub fn draw(&self, u: Vec2) -> Vec3 {
        let (mut u, mut low, mut side) = (u, Vec2::ZERO, 1.0);
        let mut place = self.whole;
        loop {
            let quarters = &self.quarters[place as usize];
            let [a, b, c, d] = quarters.shares;
            let (is_right, x) = part(u.x, a + c, b + d);
            let (is_upper, y) = if is_right { part(u.y, b, d) } else { part(u.y, a, c) };
            u = Vec2::new(x, y);
            side *= 0.5;
            low += side * Vec2::new(f32::from(u8::from(is_right)), f32::from(u8::from(is_upper)));
            place = quarters.cut[usize::from(is_right) + 2 * usize::from(is_upper)];
            if place == 0 {
                return self.frame.to_world(warp::cosine_hemisphere((low + side * u).to_array()));
            }
        }
    }
}

/// Which of two, as likely as they are large, and where in it, from 0 to 1.
fn part(u: f32, first: f32, second: f32) -> (bool, f32) {
    let share = first / (first + second);
    if u < share { (false, u / share) } else { (true, ((u - share) / (1.0 - share)).min(1.0)) }
}
