//! One path at a time.

mod focused;
mod light;
mod noted;
#[cfg(feature = "gpu")]
mod underway;

use glam::Vec3;

pub(super) use noted::Sightline;
#[cfg(feature = "gpu")]
pub(super) use underway::Underway;

use super::{
    FirstSight, FocusedLight, Guidance, Guide, PathSettings, ScatteredLight, ScreenLight, SecondaryLight,
    Tally, View, guided,
};
use crate::{
    accel::{Hit, Ray},
    film::PixelSample,
    math::{Rgb, sobol::PixelSampler},
    transport::{Absorption, Bsdf, Passed, PathClass, Scatter, ShadowRay, Surface, World},
};

/// Scatterings before Russian roulette may end a path: the first ones carry most of the picture.
pub(super) const ROULETTE_FREE_BOUNCES: u32 = 2;
/// Highest chance of going on. Light trapped by total reflection leaves glass after hundreds of bounces: a lower
/// chance would turn those into rare, enormous samples (0.98: 14 % of the light of half-transparent glass was missing
/// from 64 samples). 0.998 ends a path that loses nothing after 500 bounces in the mean.
pub(super) const SURVIVAL_MAX: f32 = 0.998;
/// A path ends here whatever it carries: one in 3,600 of those that lose nothing at all gets so far.
pub(super) const BOUNCES_END: u32 = 4096;

/// Surfaces that rays of a gather meet nearer than so many times the blur of what is known there are looked past.
pub(super) const NEAR_BLURS: f32 = 2.0;
/// The first samples of each half of a pixel's, four in all, show known light as blurred as it is: until there are more, what lies
/// near is noise (Sponza's nave at 0.3 s: 36 % with two blurred samples, 33 with four; at 1 s 24 and 23), and their share of the
/// picture shrinks with every further one.
pub(super) const BLURRED_SAMPLES: u32 = 2;
/// First of the random numbers by which a direction of known light is drawn, far beyond those of all scatterings.
pub(super) const FROM_DIMENSION: u32 = 1 << 14;

/// Near surfaces that are looked past, one from another, at most: in corners the next is near again.
pub(super) const NEAR_MAX: u32 = 3;

/// What every path of a step shares.
#[derive(Clone, Copy)]
pub(super) struct Tracer<'a> {
    pub(super) world: &'a World,
    /// Whose picture it is; `None` for rays that do not begin at an eye.
    pub(super) view: Option<&'a View>,
    pub(super) settings: PathSettings,
    /// What answers for light that does not fall on the first diffuse surface straight from its source.
    pub(super) secondary: Option<&'a dyn SecondaryLight>,
    /// The same, for what the view sees straight.
    pub(super) screen: Option<&'a dyn ScreenLight>,
    /// What answers for caustics in its place; where all paths are traced, for those that cannot be found alone.
    pub(super) caustics: Option<&'a dyn FocusedLight>,
    pub(super) near: Near,
    /// What photons say of where light comes from, where all paths are traced.
    pub(super) guide: Option<&'a Guide>,
}

/// What is done about the blur of what is known of light, which hides what lies nearer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Near {
    /// Nothing.
    Blurred,
    /// A diffuse surface nearer to where the ray sets out than [`NEAR_BLURS`] blurs is not answered for itself, but what it sees
    /// in turn.
    LookedPast,
    /// Light known at the first diffuse surface from the eye is shadowed by what lies so near that it is lost in the blur; what
    /// that sends in turn is looked at. The far field is looked up and the near one traced, as in [Arikan2005].
    Shadowed,
}

/// Which rays go on from a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Followed {
    /// Those of classes that are asked for.
    Wanted,
    /// All.
    All,
    /// Those of other lobes than the diffuse one.
    Specular,
}

/// What a sample sees first, where that was found with its neighbours.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) sight: &'a FirstSight,
    /// What its diffuse lobe sends to the eye of indirect light, where that is known.
    pub(super) indirect: Option<Rgb>,
}

/// A path on its way.
struct Path<'a> {
    ray: Ray,
    /// Product of the weights so far.
    throughput: Rgb,
    class: PathClass,
    bounce: u32,
    /// Product of squared relative indices of the boundaries passed; see [`crate::transport::BsdfSample::eta_squared`].
    eta_squared: f32,
    /// Product of how much likelier guidance made its directions.
    guided: f32,
    /// The last surface scattered with a density there: what light sampling there competes with.
    last: Option<LastVertex>,
    /// What the ray crosses; `None` in air and clear glass.
    medium: Option<Absorption>,
    /// How near to the last surface what the ray meets hides some of what is known of the light there, m; 0: at no distance.
    lost_m: f32,
    /// The first diffuse surface was too near to be answered for, or what lies near it is looked at.
    is_near: bool,
    /// How many were.
    near_count: u32,
    /// It was sent on by a mirror or glass since.
    is_by_mirrors: bool,
    /// Scatterings since a broad gloss for which light by way of mirrors was gathered, that one included; 0 before there is one,
    /// and after a diffuse one.
    since_gathered: u32,
    /// By way of what it came from the eye.
    sightline: Sightline,
    /// What its first ray met.
    seen: Option<Seen<'a>>,
    sampler: &'a PixelSampler,
}

struct LastVertex {
    position: Vec3,
    n: Vec3,
    /// The direction that it scattered to, and its density.
    way: Vec3,
    pdf_solid_angle: f32,
    /// Since then: light sampling finds what lies straight ahead.
    passed: Passed,
}

impl<'a> Tracer<'a> {
    /// All paths of rays that need not begin at an eye, with nobody to ask.
    pub(super) fn of(world: &'a World, settings: PathSettings) -> Tracer<'a> {
        Tracer {
            world,
            view: None,
            settings,
            secondary: None,
            screen: None,
            caustics: None,
            near: Near::Blurred,
            guide: None,
        }
    }
}

/// The ray of one sample of the pixel (`x`, `y`).
pub(super) fn primary_ray(view: &View, x: u32, y: u32, sampler: &PixelSampler) -> Ray {
    let [dx, dy, ..] = sampler.four(0);
    view.ray(x as f32 + dx, y as f32 + dy)
}

impl Tracer<'_> {
    /// One sample of a pixel by its primary ray and what that met.
    pub(super) fn sample_pixel(
        &self,
        ray: &Ray,
        met: Option<Hit>,
        sampler: &PixelSampler,
        tally: &mut impl Tally,
    ) -> PixelSample {
        self.sample_seen(ray, (met, None), sampler, tally)
    }

    /// The same, where it may be known already what surface that is.
    pub(super) fn sample_seen(
        &self,
        ray: &Ray,
        (met, seen): (Option<Hit>, Option<Seen<'_>>),
        sampler: &PixelSampler,
        tally: &mut impl Tally,
    ) -> PixelSample {
        tally.path();
        let mut sample = PixelSample::BLACK;
        let mut path = Path {
            ray: *ray,
            throughput: Rgb::WHITE,
            class: PathClass::Emitted,
            bounce: 0,
            eta_squared: 1.0,
            guided: 1.0,
            last: None,
            medium: None,
            lost_m: 0.0,
            is_near: false,
            near_count: 0,
            is_by_mirrors: false,
            since_gathered: 0,
            sightline: Sightline::Straight,
            seen,
            sampler,
        };
        tally.ray(&path.ray);
        let mut met = met;
        while self.advance(&mut path, met, &mut sample, tally) {
            match self.goes_to(&path, tally) {
                Some(next) => met = next,
                None => break,
            }
        }
        // Classes that nobody asked for are met on the way to others.
        let unshown = PathClass::ALL.iter().filter(|class| !self.settings.shown.contains(**class));
        unshown.for_each(|class| sample.radiance[*class as usize] = Rgb::BLACK);
        sample
    }

    /// What the path's ray meets; `None` where nothing that it could meet would count. Most rays of a path that ends at its next
    /// surface anyway pass by all lights, and whether they do is known long before what they meet. It counts as a ray whatever
    /// answers it: counts set the pace where no clock may, and that must not depend on the backend.
    fn goes_to(&self, path: &Path<'_>, tally: &mut impl Tally) -> Option<Option<Hit>> {
        tally.ray(&path.ray);
        let lights = self.world.lights();
        // What shows its colour unlit is seen in mirrors, and is no light.
        let is_scattered = path.class.meets_diffuse();
        let ends_there = is_scattered && !path.is_beyond_near() && self.is_complete(path);
        if !ends_there || lights.may_meet(&path.ray) {
            return Some(self.world.closest_hit(&path.ray));
        }
        if path.lost_m > 0.0 {
            let near = self.world.closest_hit(&Ray { t_max: path.lost_m, ..path.ray });
            if near.is_some() {
                return Some(near);
            }
        }
        let shadow_ray = ShadowRay { ray: path.ray, light: None };
        (lights.has_environment() && !self.world.is_occluded(&shadow_ray)).then_some(None)
    }

    /// Takes the path to the surface that its ray met, collects light there and scatters. False when the path has ended.
    fn advance(
        &self,
        path: &mut Path<'_>,
        met: Option<Hit>,
        sample: &mut PixelSample,
        tally: &mut impl Tally,
    ) -> bool {
        let Some(hit) = met else {
            path.note_miss(sample);
            if !path.is_beyond_mirrors() && !self.has_gathered(path, 2) {
                self.add_environment(path, sample);
            }
            return false;
        };
        path.is_near |= hit.t < std::mem::take(&mut path.lost_m);
        let seen = path.seen.take();
        let surface =
            seen.map_or_else(|| self.world.surface(&hit, path.ray.direction), |seen| seen.sight.surface);
        // Glass met from inside says what the ray came through, also to a camera that stands in it; every other surface
        // is met in what the path entered last.
        let is_glass = matches!(surface.bsdf, Bsdf::Glass(_));
        if is_glass && path.ray.direction.dot(surface.frame.n) > 0.0 {
            path.medium = surface.inside;
        }
        if let Some(medium) = &path.medium {
            path.throughput *= medium.transmittance(hit.t);
        }
        self.note_surface(path, &surface, sample);
        if !path.is_beyond_mirrors() {
            self.add_emission(path, &hit, &surface, sample);
        }
        let is_beyond_near = path.is_beyond_near();
        let is_over = match is_beyond_near {
            true => path.bounce >= self.settings.bounces_max.unwrap_or(BOUNCES_END),
            false => self.is_complete(path),
        };
        if is_over {
            return false;
        }
        let known = self.known_at(path, &surface, seen.and_then(|seen| seen.indirect));
        let is_near = known.is_some_and(|known| {
            let is_too_near = self.near == Near::LookedPast && hit.t < NEAR_BLURS * known.blur_m;
            path.near_count < NEAR_MAX && (is_too_near || known.is_missing && self.settings.passes_missing())
        });
        let followed = match (is_beyond_near, is_near) {
            (false, _) => Followed::Wanted,
            // Past another near one.
            (true, true) => Followed::All,
            // What the diffuse lobe sends is known here.
            (true, false) => Followed::Specular,
        };
        let guidance = self.guidance(path, &surface);
        self.add_light_sample(path, &surface, (followed, guidance.as_ref()), sample, tally);
        if let Some(known) = known {
            // Beyond a near surface the path stays so, whatever it meets.
            path.is_near = is_near || is_beyond_near;
            path.near_count += u32::from(is_near);
            if !is_near {
                let seen = self.seen_past_the_near(path, &surface, &known, tally);
                sample.radiance[PathClass::Indirect as usize] += path.throughput * seen;
            }
            let class_of_caustic = path.class.after(Scatter::Diffuse).after(Scatter::Specular);
            sample.radiance[class_of_caustic as usize] += path.throughput * known.caustic;
        }
        let is_gathering = self.gather_focused(path, &surface, sample);
        if !self.scatter(path, &surface, (followed, guidance.as_ref())) {
            return false;
        }
        let goes_on = path.is_by_mirrors && (is_gathering || path.since_gathered > 0);
        path.since_gathered = if goes_on { path.since_gathered + 1 } else { 0 };
        true
    }

    /// True when no further scattering of the path is asked for.
    fn is_complete(&self, path: &Path<'_>) -> bool {
        !self.settings.traced.are_beyond(path.class)
            || path.bounce >= self.settings.bounces_max.unwrap_or(BOUNCES_END)
    }

    /// What is known of indirect light, less what something near hides of it, which the path goes on to look at.
    fn seen_past_the_near(
        &self,
        path: &mut Path<'_>,
        surface: &Surface,
        known: &ScatteredLight,
        tally: &mut impl Tally,
    ) -> Rgb {
        let Some(from) = known.from.filter(|from| from.lost_m > 0.0) else { return known.indirect };
        path.lost_m = from.lost_m;
        let ray = Ray { t_max: from.lost_m, ..surface.point.ray_towards(from.direction) };
        let shadow_ray = ShadowRay { ray, light: None };
        tally.shadow_ray(&shadow_ray);
        if !self.world.is_occluded(&shadow_ray) {
            return known.indirect;
        }
        // As much of each colour as the hidden light has of it, and no less than nothing: to leave all out or nothing would take
        // the colours of others.
        let hidden = Rgb::from([0, 1, 2].map(|k| known.indirect[k].min(from.share[k])));
        known.indirect - hidden
    }

    /// At the first diffuse surface seen from the eye, or by way of one that was looked past: what is known of the light there.
    ///
    /// - `indirect`: of it, where that was found already
    fn known_at(&self, path: &Path<'_>, surface: &Surface, indirect: Option<Rgb>) -> Option<ScatteredLight> {
        let secondary = self.secondary?;
        let is_asked = !path.class.meets_diffuse() || path.is_beyond_near();
        let wo = -path.ray.direction;
        (is_asked && self.asks_for_more(path) && surface.bsdf.has_diffuse()).then(|| {
            if let Some(indirect) = indirect {
                return ScatteredLight { indirect, ..ScatteredLight::default() };
            }
            let (_, sample_index) = path.sampler.name();
            let is_shadowed = self.near == Near::Shadowed
                && sample_index >= self.settings.shadowed_from()
                && !path.is_beyond_near();
            let draw = is_shadowed.then(|| {
                let [choice, u, v, _] = path.sampler.four(FROM_DIMENSION + path.bounce);
                [choice, u, v]
            });
            match self.caustics {
                None => secondary.scattered(surface, wo, draw),
                Some(_) => {
                    let known = secondary.scattered_but_caustics(surface, wo, draw);
                    ScatteredLight { caustic: Rgb::BLACK, ..known }
                }
            }
        })
    }

    /// One scattering less is asked for of what is known than of the whole path: that of the light on its way to where it is
    /// known.
    fn asks_for_more(&self, path: &Path<'_>) -> bool {
        self.settings.bounces_max.is_none_or(|bounces| path.bounce + 1 < bounces)
    }

    /// Where light comes from at a surface that scatters it diffusely, if photons say so.
    fn guidance(&self, path: &Path<'_>, surface: &Surface) -> Option<Guidance<'_>> {
        let guide = self.guide.filter(|_| surface.bsdf.has_diffuse())?;
        let n = surface.frame.n;
        guide.at(surface.point.position, if path.ray.direction.dot(n) > 0.0 { -n } else { n })
    }

    /// Draws where the path goes on. False when it ends here.
    fn scatter(
        &self,
        path: &mut Path<'_>,
        surface: &Surface,
        (followed, guidance): (Followed, Option<&Guidance<'_>>),
    ) -> bool {
        let [lobe, u, v, survival] = path.sampler.four(1 + 2 * path.bounce);
        let wo = -path.ray.direction;
        let wo_local = surface.frame.to_local(wo);
        let Some((drawn, ratio)) = guided::sample(surface, guidance, wo_local, [lobe, u, v]) else {
            return false;
        };
        let wi = surface.frame.to_world(drawn.wi);
        if !surface.may_scatter(wo, wi) {
            return false;
        }
        let class = path.class.after(drawn.scatter);
        let is_wanted = match followed {
            Followed::Wanted => {
                self.settings.traced.contains(class) || self.settings.traced.are_beyond(class)
            }
            Followed::All => true,
            Followed::Specular => drawn.scatter == Scatter::Specular,
        };
        if !is_wanted {
            return false;
        }
        path.is_by_mirrors = drawn.scatter == Scatter::Specular;
        if path.is_by_mirrors {
            path.lost_m = 0.0;
        }
        path.throughput *= drawn.weight;
        path.guided *= ratio;
        path.eta_squared *= drawn.eta_squared;
        path.class = class;
        path.bounce += 1;
        path.last = match drawn.pdf_solid_angle {
            Some(pdf_solid_angle) => Some(LastVertex {
                position: surface.point.position,
                n: if wo.dot(surface.frame.n) < 0.0 { -surface.frame.n } else { surface.frame.n },
                way: wi,
                pdf_solid_angle,
                passed: Passed::nothing(wi),
            }),
            None if self.competes_through_panes() => path.last.take().and_then(|last| {
                let passed = last.passed.after(wo_local, &drawn)?;
                Some(LastVertex { passed, ..last })
            }),
            None => None,
        };
        path.sightline = path.sightline.after(&surface.bsdf, wo_local, drawn.wi);
        if wo_local.z * drawn.wi.z < 0.0 {
            path.medium = if drawn.wi.z < 0.0 { surface.inside } else { None };
        }
        path.ray = surface.point.ray_towards(wi);
        path.survives_roulette(survival)
    }
}

impl Path<'_> {
    /// It went on from a diffuse surface that was too near to be answered for.
    fn is_beyond_near(&self) -> bool {
        self.is_near && self.class.meets_diffuse()
    }

    /// It went on from there past mirrors or glass: what lights send by way of those is known as the near surface's caustics.
    fn is_beyond_mirrors(&self) -> bool {
        self.is_beyond_near() && self.is_by_mirrors
    }

    /// Share of a light's radiance that the path's medium leaves on the way along `shadow_ray`.
    fn transmittance(&self, shadow_ray: &ShadowRay) -> Rgb {
        let ray = &shadow_ray.ray;
        match &self.medium {
            // A way without end leaves the medium somewhere, through a hole: nothing is taken, as from rays that hit nothing.
            Some(medium) if ray.t_max.is_finite() => medium.transmittance(ray.t_max * ray.direction.length()),
            _ => Rgb::WHITE,
        }
    }

    /// Ends the path with a chance that grows as it carries less, and makes up for it when it goes on. Roots make it hesitate for
    /// three scatterings more before it ends as many as carry less: with what is carried itself, light that finds its way into a
    /// room late came in few, heavy samples (variance times rays in two-rooms' dark one 145, 101 with the square root, 80 with the
    /// fourth; in Sponza 121, 105, 97; in Sibenik 8.4, 6.9, 6.4; in ten scenes nowhere more than before by more than chance). Where dark walls
    /// leave little to come and direct light is noise itself, longer paths cost up to 15 % more than they bring.
    fn survives_roulette(&mut self, u: f32) -> bool {
        if self.throughput.is_black() {
            return false;
        }
        if self.bounce <= ROULETTE_FREE_BOUNCES {
            return true;
        }
        // The scale of radiance inside glass comes back on the way out: it says nothing of what the path carries. And a path that was
        // sent to where light comes from carries less to bring as much; one that was not carries all that it says.
        let carried = self.throughput.max_component() * self.eta_squared * self.guided.max(1.0);
        let survival = carried.sqrt().sqrt().min(SURVIVAL_MAX);
        if u >= survival {
            return false;
        }
        self.throughput *= 1.0 / survival;
        true
    }
}
