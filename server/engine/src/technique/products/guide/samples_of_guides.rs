//! Guides of photons made up for tests.

use super::*;

/// By photons that fell on a surface with unit normal `n`, each with where it fell and where it was before, alike bright.
pub(in crate::technique) fn guide_of(n: Vec3, photons: impl Iterator<Item = (Vec3, Vec3)>) -> Guide {
    let flight = |(to, from)| Flight { from, to, normal: n, flux_w: 1.0, is_focused: false };
    let flights: Vec<Flight> = photons.map(flight).collect();
    let count = flights.len();
    let asked = (0..).zip(flights).filter(|(number, _)| Flight::is_asked(*number, count));
    Guide::of(asked.map(|(_, flight)| flight).collect()).unwrap()
}
