//! Cases: a small room and what is done to it, both drawn from a seed.

use lumicast_tests::Random;

use super::hostility::{ALL, Hostility};
use super::rooms::ROOMS;
use crate::draft::Draft;

/// Most hostilities of a case.
const HOSTILITIES_MAX: usize = 4;

/// A scene to be drawn, and how.
#[derive(Clone, Debug)]
pub(crate) struct Case {
    pub(crate) seed: u64,
    /// The room and what was done to it.
    pub(crate) names: Vec<&'static str>,
    pub(crate) draft: Draft,
    /// Photons sent out.
    pub(crate) photons: u32,
    pub(crate) bounces_max: Option<u32>,
    /// What techniques find should be about the same: nothing was done that a few paths or photons may miss.
    pub(crate) is_comparable: bool,
}

impl Case {
    /// The case of a seed.
    pub(crate) fn of(seed: u64) -> Case {
        // Neighbouring seeds begin apart.
        let mut random = Random::new(seed.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ 0x0073_7461_626c_6500);
        let (room, draft) = ROOMS[random.below(ROOMS.len())];
        let draft = draft(&mut random);
        let mut case =
            Case { seed, names: vec![room], draft, photons: 4_000, bounces_max: None, is_comparable: true };
        let mut chosen: Vec<&Hostility> = Vec::new();
        let count = 1 + random.below(HOSTILITIES_MAX);
        while chosen.len() < count {
            let other = &ALL[random.below(ALL.len())];
            if chosen.iter().all(|chosen| chosen.name != other.name) {
                chosen.push(other);
            }
        }
        for hostility in chosen {
            case.suffer(hostility, &mut random);
        }
        case
    }

    /// A room with hostilities by name: for tests that say what they are about.
    pub(crate) fn named(room: &str, hostilities: &[&str], seed: u64) -> Case {
        let mut random = Random::new(seed);
        let (name, draft) = ROOMS.iter().find(|(name, _)| *name == room).expect("a room of that name");
        let draft = draft(&mut random);
        let mut case =
            Case { seed, names: vec![name], draft, photons: 4_000, bounces_max: None, is_comparable: true };
        for name in hostilities {
            let hostility =
                ALL.iter().find(|hostility| hostility.name == *name).expect("a hostility of that name");
            case.suffer(hostility, &mut random);
        }
        case
    }

    fn suffer(&mut self, hostility: &Hostility, random: &mut Random) {
        self.names.push(hostility.name);
        self.is_comparable &= hostility.is_comparable;
        (hostility.apply)(self, random);
    }

    /// What it is, and how to see it again.
    pub(crate) fn described(&self) -> String {
        format!(
            "seed {}: {}\n    LUMICAST_STABILITY_SEED={} cargo test -p lumicast-tests --test stability hostile -- --nocapture",
            self.seed,
            self.names.join(", "),
            self.seed
        )
    }
}
