//! One photon from its light to its end.

use super::{
    passed::CoarseGrid,
    paths::{PhotonHit, PhotonPath},
    sequence::Sequence,
};
use crate::{
    accel::Hit,
    technique::PHOTON_SURVIVAL_MAX,
    transport::{Flight, PathClass, Scatter, Source, Surface, World},
};

/// What photons need to know besides the scene.
#[derive(Clone, Copy)]
pub(super) struct PhotonTracer<'a> {
    pub(super) world: &'a World,
    pub(super) grid: &'a CoarseGrid,
    /// Most surfaces that a photon reaches; `None`: until absorbed.
    pub(super) bounces_max: Option<u32>,
}

/// Where the flux of some photons went: luminance, W, or in shares of a photon's flux while they are traced.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FluxTally {
    /// Sent out.
    pub emitted: f64,
    /// Left at surfaces: what arrived less what went on. Russian roulette makes single shares negative.
    pub absorbed: f64,
    /// Left in coloured glass.
    pub absorbed_on_the_way: f64,
    /// Out of the scene.
    pub escaped: f64,
    /// Carried by photons that were ended by the bound on bounces.
    pub cut_off: f64,
}

impl FluxTally {
    /// Of photons of `flux_w` each.
    pub(super) fn in_watts(self, flux_w: f64) -> FluxTally {
        FluxTally {
            emitted: self.emitted * flux_w,
            absorbed: self.absorbed * flux_w,
            absorbed_on_the_way: self.absorbed_on_the_way * flux_w,
            escaped: self.escaped * flux_w,
            cut_off: self.cut_off * flux_w,
        }
    }
}

impl std::ops::AddAssign for FluxTally {
    fn add_assign(&mut self, o: FluxTally) {
        self.emitted += o.emitted;
        self.absorbed += o.absorbed;
        self.absorbed_on_the_way += o.absorbed_on_the_way;
        self.escaped += o.escaped;
        self.cut_off += o.cut_off;
    }
}

/// Counts of tracing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct TraceTally {
    pub(super) rays: u64,
    pub(super) flux: FluxTally,
}

/// A photon on its way, and what came before.
struct Journey {
    flight: Flight,
    arriving: Arriving,
    bounce: u32,
}

/// Path class of light at the surface it falls on, if that surface scatters it diffusely to the eye.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Arriving {
    Straight,
    Focused,
    Scattered,
}

impl Arriving {
    fn class(self) -> PathClass {
        match self {
            Arriving::Straight => PathClass::Direct,
            Arriving::Focused => PathClass::Caustic,
            Arriving::Scattered => PathClass::Indirect,
        }
    }

    fn after(self, scatter: Scatter) -> Arriving {
        match (self, scatter) {
            (_, Scatter::Diffuse) | (Arriving::Scattered, _) => Arriving::Scattered,
            (_, Scatter::Specular) => Arriving::Focused,
        }
    }
}

impl PhotonTracer<'_> {
    /// Traces photon `number` of `source`, adds its hits to `hits` and returns its path, whose hits start at `first_hit`, and the
    /// cells of the grid that it passed.
    pub(super) fn trace(
        &self,
        source: &Source,
        sequence: &Sequence,
        number: u32,
        hits: &mut Vec<PhotonHit>,
        tally: &mut TraceTally,
    ) -> (PhotonPath, u64) {
        let first_hit = hits.len() as u32;
        let Some(emitted) = self.world.emit(source, &sequence.emission(number)) else {
            return PhotonTracer::nothing(hits);
        };
        let mut journey = Journey {
            flight: Flight::begin(emitted.ray, emitted.weight),
            arriving: Arriving::Straight,
            bounce: 0,
        };
        tally.flux.emitted += carried(&journey.flight);
        let mut path = PhotonPath::from(emitted.ray.origin, first_hit);
        let (mut from, mut passed) = (emitted.ray.origin, 0);
        loop {
            if journey.bounce >= self.bounces_max.unwrap_or(Flight::BOUNCES_END).min(Flight::BOUNCES_END) {
                tally.flux.cut_off += carried(&journey.flight);
                return (path, passed);
            }
            tally.rays += 1;
            let Some(hit) = self.world.closest_hit(&journey.flight.ray) else {
                tally.flux.escaped += carried(&journey.flight);
                let direction = journey.flight.ray.direction;
                path.escape_towards(direction);
                return (path, passed | self.grid.passed_towards(from, direction));
            };
            let numbers = sequence.four(journey.bounce + 1, number);
            let goes_on = self.advance(&mut journey, &hit, &numbers, hits, tally);
            let met = hits[hits.len() - 1].position;
            passed |= self.grid.passed(from, met);
            from = met;
            if !goes_on {
                return (path, passed);
            }
        }
    }

    /// Takes the photon to the surface it met and scatters it there. False when it was absorbed.
    fn advance(
        &self,
        journey: &mut Journey,
        hit: &Hit,
        numbers: &[f32; 4],
        hits: &mut Vec<PhotonHit>,
        tally: &mut TraceTally,
    ) -> bool {
        let flight = &mut journey.flight;
        let before = carried(flight);
        let surface = flight.arrive(self.world, hit);
        let arrived = carried(flight);
        tally.flux.absorbed_on_the_way += before - arrived;
        let class = journey.arriving.class();
        hits.push(PhotonHit::new(&surface, hit, -flight.ray.direction, flight.weight, class));
        let goes_on = arrived > 0.0 && scatter(journey, surface, numbers);
        tally.flux.absorbed += arrived - if goes_on { carried(&journey.flight) } else { 0.0 };
        goes_on
    }
}

/// Draws where the photon goes on; false when it is absorbed.
fn scatter(journey: &mut Journey, mut surface: Surface, [lobe, u, v, survival]: &[f32; 4]) -> bool {
    let flight = &journey.flight;
    let Some(drawn) = flight.draw(&mut surface, [*lobe, *u, *v]) else { return false };
    let Some(mut next) = flight.scattered(&surface, &drawn) else { return false };
    // Roulette by how much luminance is left: power stays nearly the same, but where next to nothing is lost.
    let survives = (next.weight.luminance() / flight.weight.luminance()).min(PHOTON_SURVIVAL_MAX);
    if !(survives > 0.0) || *survival >= survives {
        return false;
    }
    next.weight *= 1.0 / survives;
    journey.flight = next;
    journey.arriving = journey.arriving.after(drawn.scatter);
    journey.bounce += 1;
    true
}

fn carried(flight: &Flight) -> f64 {
    f64::from(flight.weight.luminance())
}
