//! The path tracer on a card beside that of the CPU: the same samples, the same laws, and what happens when a card fails.

mod behaviour;
mod cameras;
mod first_pictures;
mod first_shown;
mod focused;
mod followed;
mod gathering;
mod handed;
mod known_light;
mod laws;
mod layouts;
mod lights;
mod lookouts;
mod materials;
mod photons;
mod shadow_maps;
mod sketches;
mod splats;
mod textures;

use std::{
    ops::Range,
    sync::{Arc, OnceLock, atomic::AtomicBool},
};

use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;

use super::{scene::*, tracing::*, world::*, *};
use crate::{
    film::{PictureSize, PixelSample},
    gpu::{Gpu, tests::open},
    scene::{
        CameraView, Light, LightKind, Material, MeshSource, Scene,
        samples::{Stage, quad},
    },
    technique::{
        Products,
        path::{BLURRED_SAMPLES, Near, Tracer, closed_forms::SQUARE, primary_ray},
    },
    transport::{PathClasses, World},
};

/// Radiance, albedo and normals within these are the same path's. WGSL lets sine and cosine be off by 2⁻¹¹ = 4.9e-4 and
/// leaves roundings to the card; two of those are allowed for. A path that decided otherwise differs by far more.
const OFF_MAX: f32 = 1e-3;
/// Depths depend on no such function: 2⁻²⁴ for each of some forty roundings, ten times over for grazing surfaces.
const DEPTH_OFF_MAX: f32 = 3e-5;
/// Cards note normals of what is beyond mirrors and glass in bytes: half a 127th off by each axis, and as much as other normals.
const BEYOND_TURN_MAX: f32 = 0.0069 + OFF_MAX;
/// Radiances are compared as shares of themselves, but of no less than this share of the picture's mean.
const DARKEST: f32 = 0.01;
/// Share of paths that may take another decision: those whose numbers fall within a rounding of one. Of 165,000 paths in these
/// tests nine did on a software adapter: six under a sky of few texels, three in glass.
const OTHERS_MAX: f64 = 4e-3;
/// By how much the sums of all samples that are the same paths' may differ: what is off there is rounding, which has no
/// direction.
const SUMS_OFF_MAX: f64 = 1e-5;

/// A card for all tests here, so that what several need is compiled once. None: the test is to return.
fn shared() -> Option<Arc<Gpu>> {
    static SHARED: OnceLock<Option<Arc<Gpu>>> = OnceLock::new();
    let shared = SHARED.get_or_init(|| open().map(Arc::new)).clone();
    // Each test that is skipped says so.
    shared.or_else(|| open().map(Arc::new))
}

fn size(width: u32, height: u32) -> PictureSize {
    PictureSize::new(width, height).unwrap()
}

/// A picture that is drawn on both.
#[derive(Clone)]
struct Shot {
    world: Arc<World>,
    camera: CameraView,
    size: PictureSize,
    settings: PathSettings,
    passes: Range<u32>,
    known: Option<Arc<dyn SecondaryLight>>,
    focused: Option<Arc<dyn FocusedLight>>,
}

/// Two passes, an even one and an odd one, by the scene's first camera.
fn shot(scene: Scene) -> Shot {
    let camera = scene.camera_view(None).unwrap_or_else(|| scene.default_view());
    Shot {
        world: Arc::new(World::prepare(Arc::new(scene))),
        camera,
        size: size(40, 30),
        settings: PathSettings::all(None, 1),
        passes: 0..2,
        known: None,
        focused: None,
    }
}

/// A pass, pixel by pixel in rows.
struct Pass {
    samples: Vec<PixelSample>,
    counts: Counts,
}

impl Shot {
    fn on_cpu(&self, pass: u32) -> Pass {
        self.on_cpu_as(pass, Near::Shadowed)
    }

    fn on_cpu_as(&self, pass: u32, near: Near) -> Pass {
        let view = View::new(&self.world, &self.camera, self.size);
        let tracer = Tracer {
            view: Some(&view),
            secondary: self.known.as_deref(),
            caustics: self.focused.as_deref(),
            near,
            ..Tracer::of(&self.world, self.settings)
        };
        let width = self.size.width();
        let (samples, counts): (Vec<_>, Vec<_>) = (0..self.size.pixel_count() as u32)
            .into_par_iter()
            .map(|pixel| {
                let sampler = PixelSampler::new(self.settings.seed, pass & 1, pixel, pass >> 1);
                let ray = primary_ray(&view, pixel % width, pixel / width, &sampler);
                let mut counts = Counts::default();
                let met = self.world.closest_hit(&ray);
                (tracer.sample_pixel(&ray, met, &sampler, &mut counts), counts)
            })
            .unzip();
        Pass { samples, counts: counts.into_iter().sum() }
    }

    fn tracer(&self, scene: &Arc<GpuScene>) -> GpuPathTracer {
        GpuPathTracer {
            secondary: self.known.clone(),
            ..GpuPathTracer::new(Arc::clone(scene), self.settings)
        }
    }

    fn begin(&self, tracer: &mut GpuPathTracer, pass: u32) -> Running {
        let view = View::new(&self.world, &self.camera, self.size);
        let header = tracer.header_of(&view, &Film::new(self.size), pass, self.focused.as_deref());
        tracer.make_room(self.size.pixel_count()).unwrap();
        let begun = Begun {
            header,
            pass,
            focused: self.focused.clone(),
            shadows: Shadows::ByRays,
            has_asked_maps: false,
            taken: 0,
        };
        Running::new(begun)
    }

    /// - `slice`: paths at a time
    fn on_card_by(&self, scene: &Arc<GpuScene>, pass: u32, slice: u32) -> (Vec<GpuPixelSample>, Counts) {
        let mut tracer = self.tracer(scene);
        let mut running = self.begin(&mut tracer, pass);
        while running.traced() < self.size.pixel_count() {
            tracer.slice = slice;
            tracer.trace_slice(&mut running, self.size.pixel_count(), None).unwrap();
        }
        tracer.take_rest(&mut running).unwrap();
        (tracer.samples, running.counts)
    }

    fn on_card(&self, scene: &Arc<GpuScene>, pass: u32) -> Pass {
        let (samples, counts) = self.on_card_by(scene, pass, SLICE_MIN);
        let shown = |packed: &GpuPixelSample| {
            let mut sample = packed.unpacked();
            for class in PathClass::ALL.into_iter().filter(|class| !self.settings.shown.contains(*class)) {
                sample.radiance[class as usize] = Rgb::BLACK;
            }
            sample
        };
        Pass { samples: samples.iter().map(shown).collect(), counts }
    }

    /// Draws both and asserts that they are alike, but for paths that take another decision.
    fn is_alike(&self, gpu: &Arc<Gpu>, name: &str) {
        let scene = Arc::new(GpuScene::new(Arc::clone(gpu), Arc::clone(&self.world)));
        let mut found = Likeness::default();
        for pass in self.passes.clone() {
            found.add(&self.on_cpu(pass), &self.on_card(&scene, pass));
        }
        found.check(name);
    }
}

/// How like two pictures are, sample by sample.
#[derive(Default)]
struct Likeness {
    samples: usize,
    /// That took another decision.
    others: usize,
    /// Most that others differ in radiance, albedo, normal and depth.
    largest: [f32; 4],
    /// Sums of radiance over all others, by the CPU and the card.
    sums: [f64; 2],
    counts: [Counts; 2],
}

/// Share by which the larger of two numbers is above the other; 0 where both are below `least`.
fn off(a: f32, b: f32, least: f32) -> f32 {
    if a == b { 0.0 } else { (a - b).abs() / a.abs().max(b.abs()).max(least) }
}

fn off_rgb(a: Rgb, b: Rgb, least: f32) -> f32 {
    let of_channels = a.to_array().into_iter().zip(b.to_array()).map(|(a, b)| off(a, b, least));
    // A NaN stays: `max` would drop it.
    of_channels.fold(0.0, |most, off| if off <= most { most } else { off })
}

/// Largest difference of a channel.
fn apart(a: Rgb, b: Rgb) -> f32 {
    (a - b).map(f32::abs).max_component()
}

impl Likeness {
    fn add(&mut self, cpu: &Pass, card: &Pass) {
        assert_eq!(cpu.samples.len(), card.samples.len());
        let mean = cpu.samples.iter().map(|sample| f64::from(sample.total().mean())).sum::<f64>()
            / cpu.samples.len() as f64;
        let least = (DARKEST * mean as f32).max(f32::MIN_POSITIVE);
        for (a, b) in cpu.samples.iter().zip(&card.samples) {
            assert!(a.is_sound() && b.is_sound(), "{a:?} {b:?}");
            let radiance = (0..PathClass::COUNT)
                .map(|class| off_rgb(a.radiance[class], b.radiance[class], least))
                .fold(0.0, f32::max);
            let (is_other_beyond, beyond_off) = match (a.beyond, b.beyond) {
                (Some(a), Some(b)) => {
                    (a.normal.distance(b.normal) > BEYOND_TURN_MAX, apart(a.albedo, b.albedo))
                }
                (a, b) => (a.is_some() != b.is_some(), 0.0),
            };
            let differences = [
                radiance,
                apart(a.albedo, b.albedo).max(beyond_off),
                a.normal.distance(b.normal),
                off(a.depth_m, b.depth_m, f32::MIN_POSITIVE),
            ];
            let limits = [OFF_MAX, OFF_MAX, OFF_MAX, DEPTH_OFF_MAX];
            self.samples += 1;
            let is_other = a.is_shining != b.is_shining || is_other_beyond;
            if is_other || differences.iter().zip(limits).any(|(off, limit)| *off > limit) {
                self.others += 1;
                continue;
            }
            for (largest, off) in self.largest.iter_mut().zip(differences) {
                *largest = largest.max(off);
            }
            self.sums[0] += f64::from(a.total().mean());
            self.sums[1] += f64::from(b.total().mean());
        }
        self.counts[0] += cpu.counts;
        self.counts[1] += card.counts;
    }

    fn check(&self, name: &str) {
        let share = self.others as f64 / self.samples as f64;
        let [cpu, card] = self.sums;
        eprintln!(
            "{name}: {} of {} took another decision, the others are off by {:?} at most, their sum by {:.1e}; rays {:?}",
            self.others,
            self.samples,
            self.largest,
            if cpu == card { 0.0 } else { card / cpu - 1.0 },
            self.counts.map(|counts| (counts.rays, counts.shadow_rays)),
        );
        assert!(self.others <= 1 || share <= OTHERS_MAX, "{name}: {share} took another decision");
        assert!((card - cpu).abs() <= SUMS_OFF_MAX * cpu, "{name}: {card} for {cpu}");
        let [of_cpu, of_card] = self.counts;
        assert_eq!(of_card.paths, of_cpu.paths);
        // A path that decided otherwise is longer or shorter by itself: by 50 rays where it is caught in glass. Rays to lamps in
        // the surface's own plane bring nothing, and are cast as rounding has it.
        let rays_off = of_card.all_rays().abs_diff(of_cpu.all_rays());
        let idle_max = 50 + of_cpu.all_rays() / 100;
        assert!(rays_off <= idle_max + 50 * self.others as u64, "{name}: {of_card:?} for {of_cpu:?}");
    }
}

/// A stage with a floor, a back wall, a lamp and a camera that looks at what stands in the middle.
fn room() -> Stage {
    let mut stage = Stage::default();
    let grey = stage.material("grey", Material::lambert(Rgb::new(0.7, 0.6, 0.5))).unwrap();
    let lamp = stage.material("room's lamp", Material::emitter(Rgb::new(9.0, 8.0, 7.0))).unwrap();
    let floor = SQUARE.map(|c| DVec3::new(2.0 * c.x, -1.0, -2.0 * c.y));
    let wall = SQUARE.map(|c| 2.0 * c - 2.0 * DVec3::Z);
    let ceiling = SQUARE.map(|c| DVec3::new(0.6 * c.x, 2.5, 0.6 * c.y + 0.5));
    for (name, corners, material) in
        [("floor", floor, &grey), ("wall", wall, &grey), ("lamp", ceiling, &lamp)]
    {
        stage.place(name, quad(corners, material), DAffine3::IDENTITY).unwrap();
    }
    let view = CameraView::look_at(DVec3::new(0.3, 0.6, 4.2), DVec3::new(0.0, -0.1, 0.0), DVec3::Y, 0.6);
    stage.camera("main", view, 4.0 / 3.0).unwrap();
    stage
}

fn placed(stage: &mut Stage, name: &str, mesh: MeshSource) {
    stage.place(name, mesh, DAffine3::IDENTITY).unwrap();
}

fn lit_by(stage: &mut Stage, name: &str, position: DVec3, direction: DVec3, kind: LightKind) {
    let light = Light { parent: None, position, direction: direction.normalize(), kind };
    stage.light(name, light).unwrap();
}

/// Passes on a film, as a technique draws them.
fn film_by(technique: &mut dyn Technique, shot: &Shot, passes: u32) -> Film {
    let mut film = Film::new(shot.size);
    for _ in 0..passes {
        assert!(step(technique, shot, &mut film, false).complete);
    }
    film
}

fn step(technique: &mut dyn Technique, shot: &Shot, film: &mut Film, is_cancelled: bool) -> Progress {
    let view = View::new(&shot.world, &shot.camera, shot.size);
    let canvas = Some(Canvas { view: &view, film });
    let mut products = Products { caustics: shot.focused.clone(), ..Products::default() };
    let (products, cancel) = (&mut products, &AtomicBool::new(is_cancelled));
    technique.step(&mut Step { world: &shot.world, products, canvas, cancel })
}

impl Shot {
    /// The passes on a card, on a film.
    fn film_on_card(&self, gpu: &Arc<Gpu>, passes: u32) -> Film {
        let scene = Arc::new(GpuScene::new(Arc::clone(gpu), Arc::clone(&self.world)));
        film_by(&mut self.tracer(&scene), self, passes)
    }
}

/// Every layer of two films has the same bits.
fn assert_same_bits(a: &Film, b: &Film) {
    assert_eq!([a.passes_min(), a.passes_max()], [b.passes_min(), b.passes_max()]);
    for class in PathClass::ALL {
        assert_eq!(a.layer(class), b.layer(class), "{}", class.name());
    }
    assert_eq!((a.albedo(), a.normal(), a.depth()), (b.albedo(), b.normal(), b.depth()));
    assert_eq!(a.variance(), b.variance());
}

/// The layers of two films are alike, each pixel's share of other decisions counted once for every pass.
fn assert_alike(cpu: &Film, card: &Film) {
    assert_eq!([cpu.passes_min(), cpu.passes_max()], [card.passes_min(), card.passes_max()]);
    assert_eq!((cpu.dropped_samples(), card.dropped_samples()), (0, 0));
    let others_max = 1 + (card.sample_count() as f64 * OTHERS_MAX) as usize;
    for class in PathClass::ALL {
        let (a, b) = (cpu.layer(class), card.layer(class));
        let mean = a.iter().map(|rgb| rgb.mean()).sum::<f32>() / a.len() as f32;
        let least = (DARKEST * mean).max(f32::MIN_POSITIVE);
        let others = a.iter().zip(&b).filter(|(a, b)| off_rgb(**a, **b, least) > OFF_MAX).count();
        assert!(others <= others_max, "{}: {others}", class.name());
    }
    let depths = cpu.depth().into_iter().zip(card.depth());
    let depth_off = depths.map(|(a, b)| off(a, b, f32::MIN_POSITIVE)).fold(0.0, f32::max);
    assert!(depth_off < DEPTH_OFF_MAX, "{depth_off}");
}
