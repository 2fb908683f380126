//! Table 8.1 of [Gautron2008], measured again: irradiance by one plane before a point, in its three variants, beside rays over the
//! whole hemisphere; and what planes cost, seen along rays and drawn on a card.

use std::{sync::Arc, time::Instant};

use lumicast_engine::{
    accel::{Hit, Ray, SurfacePoint},
    film::{PictureSize, compare},
    gpu::{AdapterChoice, AdapterKind, Gpu, GpuError},
    math::{
        Frame, Rgb,
        sobol::{self, PixelSampler},
        warp,
    },
    technique::{
        ArrivingLight, Counts, Lookout, View,
        irradiance::{Facing, HemiPlane, PastPlane},
        path::{GpuScene, PathSettings, PathTracer},
    },
    transport::World,
};
use rayon::prelude::*;

use super::{
    Effort, ReportError, light,
    light::{Photons, Shape},
    notebook::Notebook,
    subject::{Prepared, Subject},
    table::{Cell, Cells, Column, Table},
};

/// The paper's scene.
pub(super) const SCENES: [&str; 1] = ["sibenik"];

/// Pixels across the planes; table 8.1 is of [`SIDE`].
const SIDES: [u32; 4] = [8, 16, 32, 64];
const SIDE: u32 = 32;
/// Places for planes of other sizes, and for drawing on the CPU itself, over those of table 8.1.
const FEWER: usize = 10;

/// Ways to sample, with the paper's errors in percent.
const SAMPLINGS: [(&str, Sampling, Option<f64>); 4] = [
    ("plane alone", Sampling::Plane(PastPlane::Dark), Some(18.1)),
    ("divided by coverage", Sampling::Plane(PastPlane::Mean), Some(10.4)),
    ("borders stretched", Sampling::Plane(PastPlane::Border), Some(5.8)),
    ("as many rays", Sampling::Rays, None),
];

#[derive(Clone, Copy)]
enum Sampling {
    Plane(PastPlane),
    Rays,
}

/// Random numbers of rays, by what they are for: two for what the others are compared with.
const RAYS_SEQUENCE: u32 = 2;
const PLANE_SEQUENCE: u32 = 3;

const SCENE: Column = Column::given("scene", "scene");
const PIXELS: Column = Column::given("pixels_across", "pixels across the plane");
pub(super) const SAMPLING: Column = Column::given("sampling", "sampling");
const VALUES: Column = Column::here("values", "values", "");
const ERROR: Column = Column::here("rms_error_percent", "RMS error", "%");
const PAPER_ERROR: Column = Column::paper("paper_rms_error_percent", "RMS error in the paper", "%");
const BIAS: Column = Column::here("bias_percent", "bias", "%");
const NOISE: Column = Column::here("noise_percent", "noise of what it is compared with", "%");
const CLEAN: Column = Column::here("clean_rms_error_percent", "without that noise", "%");
const BY: Column = Column::given("by", "how it is seen");
const SEEING_US: Column = Column::here("seeing_us", "time to see, a value", "µs");
const LIGHT_US: Column = Column::here("light_us", "time to gather its light, a value", "µs");
const ALIKE: Column = Column::here("alike_percent", "pixels with the triangle that their ray meets", "%");

/// Measures both.
pub(super) fn measure(
    notebook: &mut Notebook,
    subjects: &[Subject],
    effort: Effort,
) -> Result<(), ReportError> {
    let about = format!(
        "Irradiance at what a grid of {} pixels of the first camera sees, by light that other surfaces scatter: light that falls straight \
         on them is sampled, the rest is looked up in an octree of {} photons. Planes reach {} times as far to all sides as they lie before \
         the point, and see {:.1} % of an even hemisphere; as many rays as a plane has pixels go over all of the hemisphere, by the cosine. \
         Error: √relMSE of the values, against {} rays a hemisphere that see the same light; bias: their mean over that of those, less one. \
         Pixels that see no diffuse surface have no value, and planes of other sizes than {SIDE} have a tenth of the places. The paper says \
         neither how many pixels its planes had nor what its errors are relative to: they stand beside ours of {SIDE}.",
        effort.hemispheres,
        effort.photons(PHOTONS),
        HemiPlane::HALF_SIDE,
        100.0 * HemiPlane::new(HemiPlane::HALF_SIDE, SIDE).coverage(),
        2 * effort.hemisphere_rays,
    );
    let columns = [SCENE, PIXELS, SAMPLING, VALUES, ERROR, PAPER_ERROR, NOISE, CLEAN, BIAS];
    notebook.begin(Table::new("table-8.1-hemisphere", "Table 8.1: hemispheres on planes", about, &columns));
    let mut known = None;
    for subject in subjects {
        for side in SIDES {
            for sampling in SAMPLINGS {
                notebook.row(&format!("{} {side} {}", subject.name, sampling.0), || {
                    Places::of(&mut known, subject, effort)?.errors(subject, side, sampling, effort)
                })?;
            }
        }
    }
    let about = format!(
        "What planes of {SIDE} × {SIDE} pixels see, along rays through their middles on the CPU and drawn triangle by triangle on a card \
         or a driver that computes on the CPU in its place, and the light of what is seen, gathered on the CPU. All threads together."
    );
    let columns = [SCENE, BY, VALUES, SEEING_US, LIGHT_US, ALIKE];
    notebook.begin(Table::new("hemisphere-cost", "What planes cost", about, &columns));
    let card = Gpu::open(AdapterChoice::Any);
    if let Err(error) = &card {
        notebook.note(format!("No plane was drawn on a card: {error}"));
    }
    let card = card.ok().map(Arc::new);
    for subject in subjects {
        notebook.row(&format!("{} rays", subject.name), || {
            Places::of(&mut known, subject, effort)?.cost(subject, None)
        })?;
        if let Some(card) = &card {
            let drawn = notebook.row(&format!("{} {}", subject.name, card.report().name), || {
                Places::of(&mut known, subject, effort)?.cost(subject, Some(card))
            });
            match drawn {
                // All else is known without it.
                Err(error @ ReportError::Card { .. }) => notebook.note(format!("{}: {error}", subject.name)),
                drawn => drawn?,
            }
        }
    }
    Ok(())
}

/// Photons of the octree that light is looked up in.
const PHOTONS: u32 = 600_000;

/// Where irradiance is wanted, and what it is.
struct Places {
    name: String,
    prepared: Prepared,
    arriving: PathTracer,
    places: Vec<(SurfacePoint, Facing)>,
    /// Irradiance by rays over whole hemispheres, by either half of them, once it was asked for.
    truth: Option<[Vec<Rgb>; 2]>,
    /// What is seen on planes of a size, with its light: the variants weigh it differently.
    on_planes: Option<(u32, Vec<Vec<Rgb>>)>,
}

impl Places {
    /// Those of a subject, found if they are not known.
    fn of<'a>(
        known: &'a mut Option<Places>,
        subject: &Subject,
        effort: Effort,
    ) -> Result<&'a mut Places, ReportError> {
        Ok(match known.take().filter(|places| places.name == subject.name) {
            Some(places) => known.insert(places),
            None => known.insert(Places::find(subject, effort)?),
        })
    }

    fn find(subject: &Subject, effort: Effort) -> Result<Places, ReportError> {
        let prepared = subject.prepare()?;
        let empty = |missing: &'static str| ReportError::Empty { name: subject.name.clone(), missing };
        let photons = Photons::about(&prepared.world, effort.photons(PHOTONS));
        let shape = Shape { depth: 7 - effort.levels_less, neighbour_count: 100, vdl_count: 4 };
        let octree =
            light::build(&prepared.world, &photons, shape, 1).ok_or_else(|| empty("surface"))?.octree;
        let arriving = PathTracer::with_secondary(PathSettings::all(None, 0), octree);
        let across = (f64::from(effort.hemispheres).sqrt().ceil() as u32).max(1);
        let size = PictureSize::new(across, across)
            .map_err(|error| ReportError::Text { what: "a picture", reason: error.to_string() })?;
        let view = View::new(&prepared.world, &prepared.view, size);
        let pixels = (0..across).flat_map(|y| (0..across).map(move |x| (x, y)));
        let seen = pixels.filter_map(|(x, y)| {
            let ray = view.ray(x as f32 + 0.5, y as f32 + 0.5);
            let surface = prepared.world.surface(&prepared.world.closest_hit(&ray)?, ray.direction);
            let facing = Facing::of(&surface, -ray.direction);
            surface.bsdf.has_diffuse().then_some((surface.point, facing))
        });
        let places: Vec<_> = seen.collect();
        if places.is_empty() {
            return Err(empty("diffuse surface where the camera looks"));
        }
        Ok(Places { name: subject.name.clone(), prepared, arriving, places, truth: None, on_planes: None })
    }

    /// Irradiance at some places by `count` rays of either half, and √relMSE of its noise.
    fn truth(&mut self, places: &[usize], count: u32) -> Result<(Vec<Rgb>, f64), ReportError> {
        let halves = match self.truth.take() {
            Some(halves) => halves,
            None => {
                let all = self.every(1);
                [0, 1].map(|half| self.by_rays(&all, half, count))
            }
        };
        let halves = self.truth.insert(halves);
        let [first, second] =
            halves.each_ref().map(|half| places.iter().map(|place| half[*place]).collect::<Vec<Rgb>>());
        let differ = compare(&first, &second).map_err(|_| ReportError::Empty {
            name: self.name.clone(),
            missing: "indirect light where the camera looks",
        })?;
        let mean = first.iter().zip(&second).map(|(a, b)| (*a + *b) * 0.5).collect();
        Ok((mean, 0.5 * differ.error()))
    }

    /// Numbers of every so many-th place.
    fn every(&self, step: usize) -> Vec<usize> {
        (0..self.places.len()).step_by(step).collect()
    }

    fn world(&self) -> &World {
        &self.prepared.world
    }

    /// Light that comes along the rays of a place.
    fn light(&self, place: usize, sequence: u32, rays: &[(Ray, Option<Hit>)]) -> Vec<Rgb> {
        let along = |(number, (ray, met)): (u32, &(Ray, Option<Hit>))| {
            let sampler = PixelSampler::new(0, sequence, place as u32, number);
            self.arriving.radiance(self.world(), ray, *met, &sampler, &mut Counts::default())
        };
        (0..).zip(rays).map(along).collect()
    }

    /// Irradiance by so many rays over the whole hemisphere of each of some places.
    fn by_rays(&self, places: &[usize], sequence: u32, count: u32) -> Vec<Rgb> {
        let of_place = |place: &usize| {
            let (point, facing) = &self.places[*place];
            let frame = Frame::around(facing.normal);
            let key = sobol::mix(u64::from(sequence) << 32 | *place as u64);
            let rays = (0..count).map(|number| {
                let [u, v, ..] = sobol::point(key, number);
                let direction = frame.to_world(warp::cosine_hemisphere([u, v])).normalize();
                let ray = point.ray_towards(direction);
                (ray, self.world().closest_hit(&ray))
            });
            let light = self.light(*place, sequence, &rays.collect::<Vec<_>>());
            let sum = light.iter().fold(Rgb::BLACK, |sum, radiance| sum + *radiance);
            sum * (std::f32::consts::PI / count as f32)
        };
        places.par_iter().map(of_place).collect()
    }

    fn lookout(&self, place: usize, side: u32) -> Result<Lookout, ReportError> {
        let (point, facing) = &self.places[place];
        let size = PictureSize::new(side, side)
            .map_err(|error| ReportError::Text { what: "a plane", reason: error.to_string() })?;
        Ok(Lookout::before(point, facing.normal, HemiPlane::HALF_SIDE as f32, size))
    }

    fn lookouts(&self, places: &[usize], side: u32) -> Result<Vec<Lookout>, ReportError> {
        places.iter().map(|place| self.lookout(*place, side)).collect()
    }

    /// What the pixels of a plane see, along rays.
    fn seen_along_rays(&self, lookout: &Lookout) -> Vec<(Ray, Option<Hit>)> {
        let rays: Vec<Ray> = lookout.rays().collect();
        let mut hits = vec![None; rays.len()];
        self.world().closest_hits(&rays, &mut hits);
        rays.into_iter().zip(hits).collect()
    }

    fn places_of(&self, side: u32) -> Vec<usize> {
        self.every(if side == SIDE { 1 } else { FEWER })
    }

    fn errors(
        &mut self,
        subject: &Subject,
        side: u32,
        (name, sampling, paper): (&'static str, Sampling, Option<f64>),
        effort: Effort,
    ) -> Result<Cells, ReportError> {
        let places = self.places_of(side);
        let found = match sampling {
            Sampling::Rays => self.by_rays(&places, RAYS_SEQUENCE, side * side),
            Sampling::Plane(past) => {
                let plane = HemiPlane::new(HemiPlane::HALF_SIDE, side);
                let light = match self.on_planes.take().filter(|(of, _)| *of == side) {
                    Some((_, light)) => light,
                    None => {
                        let lookouts = self.lookouts(&places, side)?;
                        let of_place = |(place, lookout): (&usize, &Lookout)| {
                            self.light(*place, PLANE_SEQUENCE, &self.seen_along_rays(lookout))
                        };
                        places.par_iter().zip(&lookouts).map(of_place).collect()
                    }
                };
                let found = light.iter().map(|light| plane.irradiance(light, past)).collect();
                self.on_planes = Some((side, light));
                found
            }
        };
        let (truth, noise) = self.truth(&places, effort.hemisphere_rays)?;
        let error = compare(&found, &truth).map_err(|error| ReportError::Text {
            what: "the comparison of irradiances",
            reason: format!("{}: {error}", self.name),
        })?;
        Ok([
            (SCENE, Cell::from(subject.name.as_str())),
            (PIXELS, f64::from(side).into()),
            (SAMPLING, name.into()),
            (VALUES, (places.len() as f64).into()),
            (ERROR, (100.0 * error.error()).into()),
            (PAPER_ERROR, paper.filter(|_| side == SIDE && self.name == SCENES[0]).into()),
            (NOISE, (100.0 * noise).into()),
            (CLEAN, (100.0 * (error.rel_mse - noise * noise).max(0.0).sqrt()).into()),
            (BIAS, (100.0 * error.bias).into()),
        ]
        .map(|(column, cell)| (column.key.to_string(), cell))
        .into())
    }

    /// - `card`: `None`: along rays
    fn cost(&self, subject: &Subject, card: Option<&Arc<Gpu>>) -> Result<Cells, ReportError> {
        let is_slow = card.is_some_and(|card| card.report().kind == AdapterKind::Software);
        let places = self.every(if is_slow { FEWER } else { 1 });
        let lookouts = self.lookouts(&places, SIDE)?;
        let start = Instant::now();
        let along_rays: Vec<Vec<(Ray, Option<Hit>)>> =
            lookouts.par_iter().map(|lookout| self.seen_along_rays(lookout)).collect();
        let mut seeing = start.elapsed();
        let (mut seen, mut by, mut alike) = (along_rays, "rays, on the CPU".to_string(), None);
        if let Some(card) = card {
            let scene = GpuScene::new(Arc::clone(card), Arc::clone(&self.prepared.world));
            let failed =
                |error: GpuError| ReportError::Card { name: card.report().name, reason: error.to_string() };
            // Brings the scene there and compiles.
            scene.visible(&lookouts[..lookouts.len().min(1)]).map_err(failed)?;
            let start = Instant::now();
            let drawn = scene.visible(&lookouts).map_err(failed)?;
            seeing = start.elapsed();
            let triangle = |hit: &Option<Hit>| hit.map(|hit| hit.triangle_id());
            let pixels = seen.iter_mut().flatten().zip(&drawn);
            let (mut same, mut all) = (0u64, 0u64);
            for ((_, met), hit) in pixels {
                // Where neither sees any, nothing is told.
                let is_told = met.is_some() || hit.is_some();
                all += u64::from(is_told);
                same += u64::from(is_told && triangle(met) == triangle(hit));
                *met = *hit;
            }
            alike = Some(100.0 * same as f64 / all.max(1) as f64);
            let report = card.report();
            by = format!("drawn on {} ({})", report.name, report.kind);
        }
        let start = Instant::now();
        places.par_iter().zip(&seen).for_each(|(place, seen)| {
            std::hint::black_box(self.light(*place, PLANE_SEQUENCE, seen));
        });
        let light = start.elapsed();
        let us = |duration: std::time::Duration| 1e6 * duration.as_secs_f64() / places.len().max(1) as f64;
        Ok([
            (SCENE, Cell::from(subject.name.as_str())),
            (BY, by.as_str().into()),
            (VALUES, (places.len() as f64).into()),
            (SEEING_US, us(seeing).into()),
            (LIGHT_US, us(light).into()),
            (ALIKE, alike.into()),
        ]
        .map(|(column, cell)| (column.key.to_string(), cell))
        .into())
    }
}
