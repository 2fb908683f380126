//! Where the sky shows from places in the scene, found out where somebody asks.
//!
//! In a room most of the directions that a sky sends light from end at a wall, and a sky sample that does brings nothing. So cubes are
//! cut from around the scene, and of each, for surfaces in it that face one of six ways, it is learnt by rays through which part of the
//! hemisphere the sky shows. A cube is cut in eight where what is seen from its ends differs too much; its eighths look where the
//! whole cube saw the sky, so that a window that fills a hundredth of the hemisphere is seen as sharply as one that fills half of it.
//!
//! For who samples it there it shows through panes of glass as well, as far as they let it through (`transport/panes.rs`); others would
//! send to a window what finds the sky through a door. Both are learnt by themselves.
//!
//! What is learnt depends on the scene and the place alone, whoever asks first. A sky is drawn from by it with a fixed chance and else as
//! it would be without, as paths are guided by photons [Jensen1995; Mueller2017] (`products/guide.rs`): whatever it says, what is found is right.
//!
//! Nothing is kept of cubes that nobody asks about. At most, where all 32,768 parts of a cube had surfaces that face all six ways and see a
//! little of the sky, 81 MB would be; a room and the ground around it hold 0.4.

mod opening;
#[cfg(test)]
mod tests;

use std::sync::OnceLock;

use glam::{UVec3, Vec3};

pub use self::opening::Opening;
use self::opening::Spot;
use crate::{
    accel::Accel,
    scene::{NestedBounds, Scene},
    transport::World,
};

/// Parts along each axis that are learnt by themselves: rays sent all over a scene would rarely begin in any one room.
const ROOTS: u32 = 4;
/// Times that these are cut in eight at most. Cubes are then a thirty-second of what lies around: 0.4 m about a room of 6 m on wide
/// ground, where twice that has 1.14 times the variance of a sky's direct light and four times that 3.2 times.
const CUTS_MAX: u32 = 3;

/// What the sky counts as shown through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Through {
    /// Holes alone: for who samples no sky through glass.
    Holes,
    /// Holes, and panes of glass as far as they let it through.
    HolesAndPanes,
}

/// Where the sky shows from places in a scene.
pub(in crate::transport) struct Openings {
    /// Low corner and side in render space, m; each within the one before. A place is told of by the last that holds it.
    cubes: Vec<(Vec3, f32)>,
    through: Through,
    /// `[cube][z][y][x][face]`.
    roots: Vec<OnceLock<Place>>,
}

/// What is known of surfaces in a cube that face one way.
#[derive(Debug)]
enum Place {
    /// Nothing that would help: the sky shows nowhere, or enough of it.
    Plain,
    /// As much as there is to know.
    Known(Box<Opening>),
    /// The parts of it see too different things.
    Cut { whole: Box<Opening>, eighths: Box<[OnceLock<Place>; 8]> },
}

impl std::fmt::Debug for Openings {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Openings").field("cubes", &self.cubes).finish_non_exhaustive()
    }
}

impl Openings {
    /// Nothing is known yet. `None` for a scene without surface, of no extent, or with corners beyond all numbers.
    pub(in crate::transport) fn of(
        scene: &Scene,
        nested: Option<&NestedBounds>,
        accel: &Accel,
        through: Through,
    ) -> Option<Openings> {
        let cubes: Vec<(Vec3, f32)> = match nested {
            Some(nested) => nested.boxes.iter().map(|bounds| accel.cube_around(bounds)).collect(),
            None => vec![accel.cube_around(&scene.bounds()?)],
        };
        let are_whole = cubes.iter().all(|(low, side_m)| low.is_finite() && *side_m > 0.0);
        let count = cubes.len() * (ROOTS * ROOTS * ROOTS) as usize * Spot::FACES;
        are_whole.then(|| Openings { cubes, through, roots: (0..count).map(|_| OnceLock::new()).collect() })
    }

    /// Where the sky shows about `p` from a surface that faces `n`; `None` where to know would not help.
    pub(in crate::transport) fn at(&self, world: &World, p: Vec3, n: Vec3) -> Option<&Opening> {
        let holds = |(low, side_m): &(Vec3, f32)| p.cmpge(*low).all() && p.cmple(*low + *side_m).all();
        let cube = self.cubes.iter().rposition(holds)?;
        let (low, side_m) = self.cubes[cube];
        let in_roots = (p - low) * (ROOTS as f32 / side_m);
        let root = in_roots.as_uvec3().min(UVec3::splat(ROOTS - 1));
        let face = Spot::face_of(n);
        let number = (root.z * ROOTS + root.y) * ROOTS + root.x;
        let index = (cube * (ROOTS * ROOTS * ROOTS) as usize + number as usize) * Spot::FACES + face;
        let root_m = side_m / ROOTS as f32;
        let (through, name) = (self.through, index as u64);
        let mut spot = Spot { low: low + root.as_vec3() * root_m, side_m: root_m, face, through, name };
        let mut place = self.roots[index].get_or_init(|| Place::root(world, &spot));
        // Where it is in the cube, from 0 to 1.
        let mut within = in_roots - root.as_vec3();
        let mut cuts_left = CUTS_MAX;
        loop {
            let (whole, eighths) = match place {
                Place::Plain => return None,
                Place::Known(opening) => return Some(opening),
                Place::Cut { whole, eighths } => (whole, eighths),
            };
            let upper = within.cmpge(Vec3::splat(0.5));
            let upper_half = Vec3::select(upper, Vec3::ONE, Vec3::ZERO);
            within = 2.0 * within - upper_half;
            let eighth = upper.bitmask();
            spot = spot.eighth(eighth, upper_half);
            cuts_left -= 1;
            place = eighths[eighth as usize].get_or_init(|| Place::within(world, &spot, whole, cuts_left));
        }
    }

    /// Memory.
    pub(in crate::transport) fn bytes(&self) -> usize {
        self.roots.len() * size_of::<OnceLock<Place>>()
            + self.roots.iter().filter_map(OnceLock::get).map(Place::bytes).sum::<usize>()
    }
}

impl Place {
    /// Of a cube that nothing is known about.
    fn root(world: &World, spot: &Spot) -> Place {
        let Some(seen) = spot.look_everywhere(world) else { return Place::Plain };
        if seen.is_open_all_over() { Place::Plain } else { Place::cut(Opening::of(&seen)) }
    }

    /// - `whole`: what is seen from the cube that this is an eighth of
    fn within(world: &World, spot: &Spot, whole: &Opening, cuts_left: u32) -> Place {
        let Some(seen) = spot.look_through(world, whole) else { return Place::Plain };
        if seen.is_open() {
            return Place::Plain;
        }
        let opening = Opening::of(&seen);
        let is_known = cuts_left == 0 || opening.share_of_sky(&seen) >= Opening::SHARE_ENOUGH;
        if is_known { Place::Known(Box::new(opening)) } else { Place::cut(opening) }
    }

    fn cut(whole: Opening) -> Place {
        Place::Cut { whole: Box::new(whole), eighths: Box::new(std::array::from_fn(|_| OnceLock::new())) }
    }

    fn bytes(&self) -> usize {
        match self {
            Place::Plain => 0,
            Place::Known(_) => size_of::<Opening>(),
            Place::Cut { eighths, .. } => {
                let below = eighths.iter().filter_map(OnceLock::get).map(Place::bytes);
                size_of::<Opening>() + size_of_val(&**eighths) + below.sum::<usize>()
            }
        }
    }
}
