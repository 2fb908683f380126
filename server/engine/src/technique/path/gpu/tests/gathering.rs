//! Light gathered along rays, on both.

use std::{
    num::{NonZeroU32, NonZeroUsize},
    time::Duration,
};

use super::{
    known_light::{LOOKED_UP_OFF_MAX, with_known},
    *,
};
use crate::{
    gpu::{AdapterChoice, GpuOptions, tests::open_with},
    render::{Backend, BackendTrial, IlluminationSettings, Indirect, RenderSettings, Rendering},
    scene::samples,
    technique::{Arrived, ArrivingLight, GatherRay, irradiance::Visits, path::cpu::Near},
};

/// Rays from each point that a pixel sees.
const RAYS: u32 = 8;

fn rays_of(shot: &Shot) -> Vec<GatherRay> {
    let view = View::new(&shot.world, &shot.camera, shot.size);
    rays_over_a_picture(&shot.world, &view, shot.size, RAYS)
}

/// A ray on the CPU.
struct OnCpu {
    arrived: Arrived,
    /// How much of the radiance may be looked up.
    looked_up: f32,
    rays: u64,
}

impl Shot {
    fn arriving(&self) -> PathTracer {
        match &self.known {
            Some(known) => PathTracer::with_secondary(self.settings, Arc::clone(known)),
            None => PathTracer::new(self.settings),
        }
    }

    fn along_on_cpu(&self, rays: &[GatherRay], near: Near) -> Vec<OnCpu> {
        let tracer =
            Tracer { secondary: self.known.as_deref(), near, ..Tracer::of(&self.world, self.settings) };
        let along = |GatherRay { ray, sampler }: &GatherRay| {
            let mut counts = Counts::default();
            let met = self.world.closest_hit(ray);
            let sample = tracer.sample_pixel(ray, met, sampler, &mut counts);
            let [_, direct, caustic, indirect, _] = sample.radiance;
            let arrived = Arrived { radiance: direct + caustic + indirect, distance_m: met.map(|hit| hit.t) };
            OnCpu { arrived, looked_up: (caustic + indirect).max_component(), rays: counts.rays }
        };
        rays.par_iter().map(along).collect()
    }

    fn along_on_card(&self, gpu: &Arc<Gpu>, rays: &[GatherRay]) -> (Vec<Arrived>, Counts) {
        let scene = Arc::new(GpuScene::new(Arc::clone(gpu), Arc::clone(&self.world)));
        let gatherer = Arc::new(GpuGatherer::new(scene));
        let card = ArrivingByGpu::new(self.arriving(), Arc::clone(&gatherer));
        let mut counts = Counts::default();
        let arrived = card.along(&self.world, rays, &AtomicBool::new(false), &mut counts).unwrap();
        assert_eq!((gatherer.failure(), gatherer.ray_count()), (None, rays.len() as u64));
        (arrived, counts)
    }
}

/// A shot with light that is known roughly, so that much is near.
fn known(scene: Scene) -> Shot {
    Shot { size: size(28, 21), ..with_known(scene, None) }
}

/// Light of every kind on what is textured, bent, mirrored and seen through.
pub(super) fn cabinet() -> Scene {
    let mut stage = super::textures::bent_and_textured();
    let glass = Material { transmission: 1.0, roughness: 0.0, ..Material::default() };
    let glass = stage.material("clear glass", glass).unwrap();
    placed(&mut stage, "glass ball", samples::sphere(DVec3::new(1.2, -0.5, 0.6), 0.4, 14, &glass));
    let mirror = Material { metallic: 1.0, roughness: 0.0, ..Material::default() };
    let mirror = stage.material("a mirror", mirror).unwrap();
    placed(&mut stage, "mirror ball", samples::sphere(DVec3::new(-1.2, -0.5, 0.6), 0.4, 14, &mirror));
    let position = DVec3::new(0.8, 2.0, 1.5);
    let intensity = Rgb::new(3.0, 4.0, 5.0);
    let point = LightKind::Point { intensity };
    lit_by(&mut stage, "a bulb", position, DVec3::NEG_Y, point);
    let sun = LightKind::Directional { irradiance: Rgb::new(2.0, 1.8, 1.5) };
    lit_by(&mut stage, "a sun", DVec3::ZERO, DVec3::new(0.3, -1.0, -0.4), sun);
    stage.finish()
}

/// Every ray brings the same radiance from the same distance, but for rounding;
/// also where near surfaces are looked past.
#[test]
fn rays_bring_the_same_on_a_card() {
    let Some(gpu) = shared() else { return };
    let alone = |scene: Scene| {
        let settings = PathSettings::all(Some(3), 4);
        Shot { settings, size: size(28, 21), ..shot(scene) }
    };
    // One scattering, a pane, and one more.
    let of_panes = PathSettings::all(Some(4), 4);
    let panes = Shot { settings: of_panes, ..alone(focused::lacquered()) };
    for (name, shot, looks_past) in [
        ("boxes", known(samples::boxes().unwrap()), true),
        ("cornell box", known(samples::cornell_box().unwrap()), true),
        ("cabinet", known(cabinet()), true),
        ("cornell box, three bounces", alone(samples::cornell_box().unwrap()), false),
        ("cabinet, three bounces", alone(cabinet()), false),
        ("room with a pane, four bounces", panes, false),
    ] {
        let rays = rays_of(&shot);
        let near = if looks_past { Near::LookedPast } else { Near::Blurred };
        let cpu = shot.along_on_cpu(&rays, near);
        let (card, counts) = shot.along_on_card(&gpu, &rays);
        assert_eq!((cpu.len(), counts.paths), (card.len(), rays.len() as u64));
        let mean =
            cpu.iter().map(|ray| f64::from(ray.arrived.radiance.mean())).sum::<f64>() / cpu.len() as f64;
        let least = (DARKEST * mean as f32).max(f32::MIN_POSITIVE);
        let (mut others, mut largest, mut farthest, mut sums) = (0, 0.0f32, 0.0f32, [0.0f64; 2]);
        for (cpu, card) in cpu.iter().zip(&card) {
            let (a, b) = (cpu.arrived.radiance, card.radiance);
            assert!(b.is_finite() && b.is_non_negative(), "{name}: {b:?}");
            let difference = (a - b).map(f32::abs).max_component();
            let allowed = OFF_MAX * a.max_component().max(least) + LOOKED_UP_OFF_MAX * cpu.looked_up;
            let distance_off = match (cpu.arrived.distance_m, card.distance_m) {
                (Some(a), Some(b)) => off(a, b, f32::MIN_POSITIVE),
                (None, None) => 0.0,
                _ => 1.0,
            };
            if !(difference <= allowed) || distance_off > DEPTH_OFF_MAX {
                others += 1;
                continue;
            }
            largest = largest.max(difference / allowed);
            farthest = farthest.max(distance_off);
            sums[0] += f64::from(a.mean());
            sums[1] += f64::from(b.mean());
        }
        let mut past = 0;
        if looks_past {
            let not_past = shot.along_on_cpu(&rays, Near::Blurred);
            past = cpu.iter().zip(&not_past).filter(|(a, b)| a.rays != b.rays).count();
            // Rays that look past nothing would pass no test of looking past.
            assert!(past > rays.len() / 20, "{name}: {past} look past something");
        }
        let cpu_rays: u64 = cpu.iter().map(|ray| ray.rays).sum();
        eprintln!(
            "{name}: {others} of {} rays took another decision, the others are off by {largest} of what is allowed and {farthest} \
             of the distance at most, their sum by {:.1e}; {past} look past something; rays {cpu_rays} and {}",
            rays.len(),
            sums[1] / sums[0] - 1.0,
            counts.rays,
        );
        assert!(others as f64 <= 1.0 + OTHERS_MAX * rays.len() as f64, "{name}: {others}");
        assert!((sums[1] / sums[0] - 1.0).abs() <= SUMS_OFF_MAX, "{name}: {sums:?}");
        assert!(counts.rays.abs_diff(cpu_rays) <= 50 * (1 + others) as u64, "{name}: {counts:?}, {cpu_rays}");
    }
}

/// A picture of records, that much of the light being learnt.
fn by_records(shot: &Shot, scene: Option<&Arc<GpuScene>>, mut step: impl FnMut(&mut Rendering)) -> Rendering {
    let settings =
        RenderSettings { indirect: Indirect::Irradiance, backend: Backend::Gpu, ..RenderSettings::default() };
    let mut of = IlluminationSettings::of(&settings);
    of.photons.emitted_count = 80_000;
    of.octree.photon_count = 80_000;
    of.octree.depth = 5;
    of.irradiance.visits = Visits::exactly(NonZeroU32::new(2).unwrap());
    // As on a card.
    of.irradiance.records_per_batch = NonZeroUsize::new(1_000).unwrap();
    let mut rendering =
        Rendering::learning_by((Arc::clone(&shot.world), of), shot.camera, shot.size, settings);
    if let Some(scene) = scene {
        rendering.draw_and_gather_on(Arc::clone(scene));
    }
    while rendering.passes() < 1 {
        step(&mut rendering);
    }
    assert!(rendering.knows_its_light() && rendering.records().count > 0);
    rendering
}

fn undisturbed(rendering: &mut Rendering) {
    rendering.step(&AtomicBool::new(false));
}

fn of_cornell() -> Shot {
    Shot { size: size(40, 32), ..shot(samples::cornell_box().unwrap()) }
}

/// Records gathered on a card are those of the CPU, but for records that rounding lets fall elsewhere; so is the
/// picture, which it draws as well.
#[test]
fn records_gathered_on_a_card_show_the_same_picture() {
    let Some(gpu) = shared() else { return };
    let lit = |name: &str, scene: Scene| {
        let shot = Shot { size: size(40, 32), ..shot(scene) };
        let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
        let [cpu, card] = [None, Some(&scene)].map(|scene| by_records(&shot, scene, undisturbed));
        assert_eq!((cpu.gpu_gathered_rays(), card.gpu_failure()), (0, None));
        let [of_cpu, of_card] = [&cpu, &card].map(|drawn| drawn.records().count);
        let layers = [&cpu, &card].map(|drawn| drawn.film().layer(PathClass::Indirect));
        let mean = layers[0].iter().map(|rgb| rgb.mean()).sum::<f32>() / layers[0].len() as f32;
        let offs = layers[0].iter().zip(&layers[1]).map(|(a, b)| off_rgb(*a, *b, DARKEST * mean));
        let others = offs.clone().filter(|off| *off > LOOKED_UP_OFF_MAX).count();
        let sums = layers.each_ref().map(|layer| layer.iter().map(|rgb| f64::from(rgb.mean())).sum::<f64>());
        eprintln!(
            "{name}: {of_cpu} and {of_card} records, {others} of {} pixels are off by more than rounding takes, the farthest by {}, \
             their sum by {:.1e}; {} rays on the card",
            layers[0].len(),
            offs.fold(0.0, f32::max),
            sums[1] / sums[0] - 1.0,
            card.gpu_gathered_rays(),
        );
        assert!(card.gpu_gathered_rays() > 200 * of_card);
        assert!(of_cpu.abs_diff(of_card) <= 1 + of_cpu / 100, "{name}: {of_cpu} and {of_card} records");
        // A record that falls elsewhere shows over the pixels that it counts for.
        assert!(others <= layers[0].len() / 20, "{name}: {others} pixels");
        assert!((sums[1] / sums[0] - 1.0).abs() <= 1e-3, "{name}: {sums:?}");
        assert_eq!((cpu.gpu_passes(), card.gpu_passes()), (0, 1), "{name}");
        for class in [PathClass::Emitted, PathClass::Specular, PathClass::Direct] {
            let [of_cpu, of_card] = [&cpu, &card].map(|drawn| drawn.film().layer(class));
            let others = of_cpu.iter().zip(&of_card).filter(|(a, b)| off_rgb(**a, **b, DARKEST) > OFF_MAX);
            assert!(others.count() <= 2, "{name}: {class:?}");
        }
    };
    lit("boxes", samples::boxes().unwrap());
    lit("cornell box", samples::cornell_box().unwrap());
    lit("cabinet", cabinet());
}

/// Devices that are lost between steps and within them, and steps that are cancelled, change no bit of the picture.
#[test]
fn lost_devices_and_cancelled_steps_change_no_record() {
    let Some(gpu) = open().map(Arc::new) else { return };
    let shot = of_cornell();
    let scene = Arc::new(GpuScene::new(Arc::clone(&gpu), Arc::clone(&shot.world)));
    let expected = by_records(&shot, Some(&scene), undisturbed);
    let mut steps = 0;
    let disturbed = by_records(&shot, Some(&scene), |rendering| {
        steps += 1;
        let lost = (steps % 7 == 0 && steps < 30).then(|| gpu.session().unwrap());
        let cancel = AtomicBool::new(false);
        std::thread::scope(|scope| {
            // Somewhere in the step, or after it: wherever that is, the next bring the same.
            scope.spawn(|| {
                std::thread::park_timeout(Duration::from_millis(4));
                lost.inspect(|lost| lost.lose_for_test());
                cancel.store(steps % 3 == 0, Ordering::Relaxed);
            });
            rendering.step(&cancel);
        });
        // A pass that was cut short is ended by the next.
    });
    assert!(gpu.session().unwrap().generation() > 0);
    assert_eq!(disturbed.gpu_failure(), None);
    assert_eq!(disturbed.records().count, expected.records().count);
    assert_same_bits(expected.film(), disturbed.film());
    let card = ArrivingByGpu::new(shot.arriving(), Arc::new(GpuGatherer::new(scene)));
    let (rays, mut counts) = (rays_of(&shot), Counts::default());
    assert_eq!(card.along(&shot.world, &rays, &AtomicBool::new(true), &mut counts), None);
    assert_eq!(counts, Counts::default());
}

/// Where a card cannot hold the scene, the CPU makes the same records, from the first bit on, and the card is given up with a word.
#[test]
fn records_are_the_cpus_where_the_card_fails() {
    let options = GpuOptions { adapter: AdapterChoice::Any, bytes_max: 200_000, ..GpuOptions::default() };
    let Some(gpu) = open_with(&options).map(Arc::new) else { return };
    let shot = of_cornell();
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let by_cpu = by_records(&shot, None, undisturbed);
    let by_both = by_records(&shot, Some(&scene), undisturbed);
    assert!(
        matches!(by_both.gpu_failure(), Some(GpuError::OutOfMemory { .. })),
        "{:?}",
        by_both.gpu_failure()
    );
    assert!(!by_both.is_on_gpu() && by_both.gpu_gathered_rays() == 0);
    assert_eq!(by_cpu.records().count, by_both.records().count);
    assert_same_bits(by_cpu.film(), by_both.film());
}

/// The trial of drawing and gathering times both, whatever the adapter.
#[test]
fn gathering_is_tried_on_both() {
    let Some(gpu) = shared() else { return };
    let shot = of_cornell();
    let scene = Arc::new(GpuScene::new(gpu, Arc::clone(&shot.world)));
    let settings = RenderSettings { indirect: Indirect::Irradiance, ..RenderSettings::default() };
    settings.make_ready(&scene).unwrap();
    let trial = BackendTrial::run(&scene, &shot.camera, shot.size, &settings).unwrap();
    for seconds in [trial.cpu_seconds, trial.gpu_seconds] {
        assert!(seconds > 0.0 && seconds.is_finite(), "{trial:?}");
    }
}
