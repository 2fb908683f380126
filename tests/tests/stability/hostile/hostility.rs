//! What is done to rooms.

use lumicast_tests::Random;

use super::case::Case;
use super::{eye, geometry, light, material};

/// One thing that is done to a room.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hostility {
    pub(super) name: &'static str,
    pub(super) apply: fn(&mut Case, &mut Random),
    /// A few paths and photons still find what there is to be seen.
    pub(super) is_comparable: bool,
}

impl Hostility {
    pub(super) const fn mild(name: &'static str, apply: fn(&mut Case, &mut Random)) -> Hostility {
        Hostility { name, apply, is_comparable: true }
    }

    pub(super) const fn harsh(name: &'static str, apply: fn(&mut Case, &mut Random)) -> Hostility {
        Hostility { name, apply, is_comparable: false }
    }
}

const COUNT: usize = geometry::ALL.len() + light::ALL.len() + material::ALL.len() + eye::ALL.len();

/// All of them, in the order of their rooms.
pub(super) const ALL: [Hostility; COUNT] = {
    let mut all = [geometry::ALL[0]; COUNT];
    let lists: [&[Hostility]; 4] = [&geometry::ALL, &light::ALL, &material::ALL, &eye::ALL];
    let (mut list, mut next) = (0, 0);
    while list < lists.len() {
        let mut at = 0;
        while at < lists[list].len() {
            all[next] = lists[list][at];
            (at, next) = (at + 1, next + 1);
        }
        list += 1;
    }
    all
};
