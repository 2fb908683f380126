//! What of a whole surface faces a direction, kept for all directions that are about the same.
//!
//! Beside a gather that reaches ten times as far as a cushion, it hardly matters by some degrees how that lies, and a hall has three
//! thousand: tables hold what faces the middle of each of 256 parts of the sphere, made when it is first asked for.

use std::sync::OnceLock;

use glam::Vec3;

use super::{
    super::gather::{ALIKE_COS, FACING_COS},
    Facets,
};
use crate::math::octahedral;

/// The cosines that gathers ask for, but for that which all directions have.
const COSINES: [f32; 2] = [FACING_COS, ALIKE_COS];
/// Bits of each coordinate of a direction on the unfolded octahedron that name a part of it. A direction is 15° off its middle at most,
/// 5° in the mean.
const BITS: u32 = 4;
const PARTS: usize = 1 << (2 * BITS);

/// By cosine and part of the sphere.
#[derive(Debug, Default)]
pub(super) struct FacingTables {
    of_cosine: [OnceLock<Box<[OnceLock<Facets>]>>; COSINES.len()],
}

impl FacingTables {
    /// What faces a direction, within a cosine of it, about; `None` of cosines that gathers do not ask for.
    ///
    /// - `facing`: what faces a direction, exactly
    pub(super) fn facing(
        &self,
        direction: Vec3,
        cosine: f32,
        facing: impl FnOnce(Vec3) -> Facets,
    ) -> Option<Facets> {
        let table = COSINES.iter().position(|known| *known == cosine)?;
        let parts = self.of_cosine[table].get_or_init(|| (0..PARTS).map(|_| OnceLock::new()).collect());
        let part = part_of(direction);
        Some(*parts[part].get_or_init(|| facing(middle_of(part))))
    }

    /// Memory.
    pub(super) fn bytes(&self) -> usize {
        self.of_cosine.iter().filter_map(OnceLock::get).map(|parts| size_of_val(&**parts)).sum()
    }
}

/// The part of the sphere that a direction lies in.
fn part_of(direction: Vec3) -> usize {
    let code = octahedral::encode(direction);
    // Signed coordinates, from the lowest.
    let [u, v] = [code as u16, (code >> 16) as u16].map(|half| (half ^ 0x8000) >> (16 - BITS));
    usize::from(v) << BITS | usize::from(u)
}

/// The direction in the middle of a part.
fn middle_of(part: usize) -> Vec3 {
    let half = 1 << (15 - BITS);
    let [u, v] =
        [part, part >> BITS].map(|of| ((of as u32 & ((1 << BITS) - 1)) << (16 - BITS) | half) ^ 0x8000);
    octahedral::decode(v << 16 | u)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{sobol::point, warp};

    /// Every direction is in a part whose middle is near, and is that part's.
    #[test]
    fn directions_are_near_the_middle_of_their_part() {
        let (mut worst, mut sum) = (0.0f32, 0.0);
        const COUNT: u32 = 20_000;
        for index in 0..COUNT {
            let [u, v, ..] = point(21, index);
            let direction = warp::sphere([u, v]);
            let middle = middle_of(part_of(direction));
            assert_eq!(part_of(middle), part_of(direction));
            let degrees = direction.angle_between(middle).to_degrees();
            worst = worst.max(degrees);
            sum += degrees;
        }
        assert!(worst < 15.0 && sum / (COUNT as f32) < 5.5, "{worst}, {}", sum / COUNT as f32);
    }

    /// What is asked again is not computed again, each cosine has a table of its own, and others have none.
    #[test]
    fn tables_are_filled_once() {
        let tables = FacingTables::default();
        assert_eq!(tables.bytes(), 0);
        let of = |area_m2| move |n| Facets::flat(area_m2, n);
        let first = tables.facing(Vec3::Y, FACING_COS, of(1.0)).unwrap();
        assert_eq!(tables.facing(Vec3::Y, FACING_COS, |_| unreachable!()), Some(first));
        assert_eq!(tables.facing(Vec3::Y, ALIKE_COS, of(2.0)).unwrap().area_m2, 2.0);
        assert_eq!(tables.facing(-Vec3::Y, FACING_COS, of(3.0)).unwrap().area_m2, 3.0);
        assert_eq!(tables.facing(Vec3::Y, 0.6, of(4.0)), None);
        assert!(tables.bytes() > 0);
    }
}
