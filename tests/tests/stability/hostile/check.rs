//! What is demanded of a picture of a hostile scene.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use lumicast_engine::effects::EffectPlan;
use lumicast_engine::math::{Rgb, RunningStatistics};
use lumicast_engine::render::{Indirect, Rendering};
use lumicast_engine::scene::{Environment, LightKind, Scene};
use lumicast_engine::transport::{PathClass, World};
use lumicast_tests::mean;

use super::case::Case;
use crate::drawing::{Drawn, Effort, TECHNIQUES, Technique, draw, name, techniques, tried};

/// A small picture of a case takes some tenths of a second.
const EFFORT: Effort = Effort {
    side: 24,
    passes: 6,
    photons: 4_000,
    neighbours: 16,
    rays: 50,
    patience: Duration::from_secs(30),
};
/// Cases of which one is also drawn by two threads.
const CASES_THREADED: u64 = 4;
/// Pictures of a case for its mean, and work that goes into them where few pictures and samples say that something is off.
const PICTURES: u64 = 3;
const HARDER: u32 = 12;
/// How far means of looked-up light may be from the path tracer's, in shares: 4,000 photons on a few square metres are blurred
/// over half of a small thing, and the next wall's light with it. Light that is counted twice, or lost, shows more.
const BIAS_MAX: f64 = 0.25;
/// How far above the closed form, in shares: what density estimates gain in corners with so few photons.
const ABOVE_MAX: f64 = 0.1;

/// How often what was checked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Checked {
    pub(crate) drawn: u32,
    pub(crate) dark: u32,
    pub(crate) bounded: u32,
    pub(crate) measured: u32,
    pub(crate) threaded: u32,
    pub(crate) compared: u32,
    /// Compared with more work, since chance did not explain what was off.
    pub(crate) again: u32,
}

impl std::ops::AddAssign for Checked {
    fn add_assign(&mut self, o: Checked) {
        self.drawn += o.drawn;
        self.dark += o.dark;
        self.bounded += o.bounded;
        self.measured += o.measured;
        self.threaded += o.threaded;
        self.compared += o.compared;
        self.again += o.again;
    }
}

/// Draws the case by every technique.
///
/// # Errors
/// All that is wrong, in words, technique by technique.
pub(crate) fn check(case: &Case) -> Result<[Checked; TECHNIQUES.len()], String> {
    let scene = case.draft.build().map_err(|error| format!("the scene is refused: {error}"))?;
    warnings_name_what_is_degenerate(case, &scene)?;
    let world = caught(|| Ok(Arc::new(World::prepare(Arc::new(scene)))))?;
    let subject = Subject {
        case,
        world: &world,
        is_dark: is_dark(world.scene()),
        radiance_max: radiance_max(world.scene()),
    };
    let mut all = [Checked::default(); TECHNIQUES.len()];
    let mut failures = Vec::new();
    for (checked, technique) in all.iter_mut().zip(techniques()) {
        let mut seen = |result: Result<(), String>| {
            failures.extend(result.err().map(|error| format!("{}: {error}", name(technique))))
        };
        seen(subject.is_sound(technique, checked));
        seen(subject.is_as_bright_as_paths_find(technique, checked));
    }
    if failures.is_empty() { Ok(all) } else { Err(failures.join("\n    ")) }
}

/// A case ready to be drawn, and what is known of its pictures beforehand.
struct Subject<'a> {
    case: &'a Case,
    world: &'a Arc<World>,
    is_dark: bool,
    /// No surface shows more, in the mean over many samples.
    radiance_max: Option<f64>,
}

impl Subject<'_> {
    fn draw(&self, technique: Technique, seed: u64, effort: &Effort) -> Result<Rendering, String> {
        let of = Drawn { technique, seed, bounces_max: self.case.bounces_max };
        let effort = Effort { photons: effort.photons / EFFORT.photons * self.case.photons, ..*effort };
        caught(|| draw(self.world, of, &effort))
    }

    /// One picture of it ends, and has nothing in it that cannot be.
    fn is_sound(&self, technique: Technique, checked: &mut Checked) -> Result<(), String> {
        let rendering = self.draw(technique, 0, &EFFORT)?;
        let picture = rendering.picture();
        let radiance = picture.radiance();
        checked.drawn += 1;
        let is_sound = |colour: &Rgb| colour.is_finite() && colour.is_non_negative();
        if let Some(at) = radiance.iter().position(|colour| !is_sound(colour)) {
            return Err(format!("pixel {at} is {:?}", radiance[at]));
        }
        for class in PathClass::ALL {
            if let Some(colour) = picture.layer(class).iter().find(|colour| !is_sound(colour)) {
                return Err(format!("{} holds {colour:?}", class.name()));
            }
        }
        if picture.albedo().iter().any(|colour| !is_sound(colour))
            || picture.depth().iter().any(|depth| !(depth.is_finite() && *depth >= 0.0))
        {
            return Err("albedo or depth are not finite and positive".into());
        }
        if picture.normal().iter().any(|normal| !normal.is_finite())
            || picture.variance().iter().any(|variance| !(*variance >= 0.0))
        {
            return Err("normals or variances are not numbers".into());
        }
        if rendering.dropped_samples() > 0 {
            return Err(format!("{} samples were no numbers", rendering.dropped_samples()));
        }
        if self.is_dark {
            checked.dark += 1;
            if let Some(at) = radiance.iter().position(|colour| !colour.is_black()) {
                return Err(format!("pixel {at} is {:?} where there is no light", radiance[at]));
            }
        }
        if let Some(error) = caught(|| Ok(rendering.measured_error()))? {
            checked.measured += 1;
            let [low, high] = error.interval_95;
            // Equal ends are rounded twice.
            let is_in_order = low <= error.rel_mse * (1.0 + 1e-9) && error.rel_mse <= high * (1.0 + 1e-9);
            if !(low >= 0.0 && high.is_finite() && is_in_order) {
                return Err(format!("the measured error is {error:?}"));
            }
        }
        if self.case.seed.is_multiple_of(CASES_THREADED) {
            checked.threaded += 1;
            let of_two = on_threads(2, || self.draw(technique, 0, &EFFORT))?;
            if of_two.picture().radiance() != radiance {
                return Err("two threads draw another picture than one".into());
            }
        }
        self.is_not_too_bright(&radiance, technique, checked)
    }

    fn is_not_too_bright(
        &self,
        radiance: &[Rgb],
        technique: Technique,
        checked: &mut Checked,
    ) -> Result<(), String> {
        let Some(most) = self.radiance_max else { return Ok(()) };
        checked.bounded += 1;
        if mean(radiance) <= (1.0 + ABOVE_MAX) * most {
            return Ok(());
        }
        // A mean of few samples may be above by chance.
        checked.again += 1;
        let found = self.mean(technique, &harder())?;
        let allowed = (1.0 + ABOVE_MAX) * most + 6.0 * found.standard_error();
        if found.mean() > allowed {
            return Err(format!("mean {:.4e} where no surface can show more than {most:.4e}", found.mean()));
        }
        Ok(())
    }

    /// Looked-up light is about what path tracing finds, where a few paths find it.
    fn is_as_bright_as_paths_find(&self, technique: Technique, checked: &mut Checked) -> Result<(), String> {
        let is_asked = self.case.is_comparable && !self.is_dark;
        if !is_asked
            || technique == Technique::on_cpu(Indirect::Path)
            || EffectPlan::of(self.world.scene()).facts.hides_light()
        {
            return Ok(());
        }
        checked.compared += 1;
        let mut off = self.off_from_paths(technique, &EFFORT)?;
        if off.is_some() {
            checked.again += 1;
            off = self.off_from_paths(technique, &harder())?;
        }
        off.map_or(Ok(()), Err)
    }

    fn off_from_paths(&self, technique: Technique, effort: &Effort) -> Result<Option<String>, String> {
        let expected = self.mean(Technique::on_cpu(Indirect::Path), effort)?;
        let found = self.mean(technique, effort)?;
        let chance = 6.0 * expected.standard_error().hypot(found.standard_error());
        let off = (found.mean() - expected.mean()).abs();
        let is_near = off <= BIAS_MAX * expected.mean() + chance;
        Ok((!is_near).then(|| {
            format!(
                "mean {:.4e} where path tracing finds {:.4e} (chance {chance:.1e})",
                found.mean(),
                expected.mean()
            )
        }))
    }

    fn mean(&self, technique: Technique, effort: &Effort) -> Result<RunningStatistics, String> {
        let mut means = RunningStatistics::default();
        for seed in 1..=PICTURES {
            means.add(mean(&self.draw(technique, seed, effort)?.picture().radiance()));
        }
        Ok(means)
    }
}

fn harder() -> Effort {
    Effort {
        passes: HARDER * EFFORT.passes,
        photons: HARDER * EFFORT.photons,
        rays: 4 * EFFORT.rays,
        ..EFFORT
    }
}

/// Runs `work` and turns a panic into words.
fn caught<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().cloned();
        let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| text.to_string()));
        Err(format!("panics: {}", text.unwrap_or_default()))
    })
}

/// On a pool of so many threads.
pub(crate) fn on_threads<T: Send>(count: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("threads").install(work)
}

/// Meshes with triangles that have no area are warned of by name.
fn warnings_name_what_is_degenerate(case: &Case, scene: &Scene) -> Result<(), String> {
    for thing in case.draft.things.iter().filter(|thing| thing.name.starts_with("degenerate")) {
        let object = format!("mesh {:?}", thing.name);
        if !scene.warnings().iter().any(|warning| warning.object == object) {
            return Err(format!("no warning names {object}: {:?}", scene.warnings()));
        }
    }
    Ok(())
}

/// Nothing in it sends out light.
fn is_dark(scene: &Scene) -> bool {
    let is_lit = |kind: &LightKind| match kind {
        LightKind::Point { intensity } | LightKind::Spot { intensity, .. } => !intensity.is_black(),
        LightKind::Directional { irradiance } => !irradiance.is_black(),
    };
    let has_sky = match scene.environment() {
        Environment::None => false,
        Environment::Constant(radiance) => !radiance.is_black(),
        Environment::Image { .. } => true,
    };
    let has_lamp = placed_materials(scene).any(|material| material.is_emissive());
    !has_sky && !has_lamp && !scene.lights().values().any(|light| is_lit(&light.kind))
}

/// Materials of surfaces that are there.
fn placed_materials(scene: &Scene) -> impl Iterator<Item = &lumicast_engine::scene::Material> {
    let meshes = scene.nodes().values().filter_map(|node| scene.meshes().get(node.mesh.as_ref()?));
    let primitives = meshes.flat_map(|mesh| mesh.primitives());
    primitives.filter_map(|primitive| scene.materials().get(&primitive.material)).map(|material| &**material)
}

/// Where only surfaces and surroundings send out light: with E the most that any sends out and ρ the most that any reflects, none
/// shows more than E / (1 − ρ), times n² for every glass that an eye may be in. Mirrors and glass only pass on what others show.
fn radiance_max(scene: &Scene) -> Option<f64> {
    if !scene.lights().is_empty() {
        return None;
    }
    let mut emitted = match scene.environment() {
        Environment::None => 0.0,
        Environment::Constant(radiance) => f64::from(radiance.max_component()),
        Environment::Image { .. } => return None,
    };
    let (mut reflected, mut denser) = (0.0f64, 1.0f64);
    for material in placed_materials(scene) {
        emitted = emitted.max(f64::from(material.emission.max_component()));
        match material.transmission > 0.0 {
            true => denser *= f64::from(material.ior).powi(2),
            false if material.metallic < 1.0 => {
                reflected = reflected.max(f64::from(material.base_color.max_component()));
            }
            false => {}
        }
        // A mirror that is also a lamp adds to what others show, again and again.
        if material.is_emissive() && (material.transmission > 0.0 || material.metallic > 0.0) {
            return None;
        }
    }
    (reflected < 1.0).then(|| denser * emitted / (1.0 - reflected))
}

/// What is demanded can be missed: a lit room is no dark one, none is brighter than it may be, and a panic is no picture.
#[test]
fn checks_see_what_is_wrong() {
    let case = Case::named("furnace", &["a hundred lights"], 1);
    let furnace = Case::named("furnace", &[], 1);
    let prepared = |case: &Case| Arc::new(World::prepare(Arc::new(case.draft.build().expect("a scene"))));
    let (world, lit) = (prepared(&furnace), prepared(&case));
    let most = radiance_max(world.scene()).expect("a furnace has a bound");
    assert!(radiance_max(lit.scene()).is_none() && !is_dark(world.scene()));
    let subject = |is_dark, radiance_max| Subject { case: &furnace, world: &world, is_dark, radiance_max };
    for technique in tried() {
        let checked = &mut Checked::default();
        assert_eq!(subject(false, Some(most)).is_sound(technique, checked), Ok(()), "{}", name(technique));
        assert!(subject(true, None).is_sound(technique, checked).is_err(), "{}", name(technique));
        assert!(
            subject(false, Some(0.7 * most)).is_sound(technique, checked).is_err(),
            "{}",
            name(technique)
        );
    }
    assert_eq!(caught(|| -> Result<(), String> { panic!("at {}", 7) }), Err("panics: at 7".to_string()));
}
