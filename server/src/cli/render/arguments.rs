//! Values of `lumicast render`'s options: how they are written and what they mean.

use std::{
    path::{Path, PathBuf},
    str::FromStr,
    time::Duration,
};

use lumicast_engine::{
    effects::{EffectChoice, EffectChoices},
    film::{PictureSize, ToneMap},
    render::{Indirect, MeasuringShare},
    scene::{Camera, Scene},
};

use lumicast_protocol::Accuracy;

use super::super::{CliError, SceneSource};
use crate::duration::parse_duration;

/// Render one picture, without a server, with the same engine.
///
/// Stops at the first of --samples, --time and --error that is given and reached. When none is given, it stops
/// at 2 % error or after 60 seconds.
/// The same scene, seed and --samples or --error give the same bytes on the CPU, whatever the number of threads.
#[derive(Clone, Debug, clap::Args)]
pub struct RenderArgs {
    /// Scene file (.glb, .gltf, .obj), builtin:cornell-box or builtin:boxes
    pub scene: SceneSource,
    /// Picture to write: .exr (linear radiance), .png or .jpg (exposure, tone map, sRGB)
    #[arg(long, value_name = "IMG")]
    pub out: PathBuf,
    /// Camera by name; the scene's first when left out, a view of the whole scene when it has none
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// Picture size, such as 1280x720. When left out: 256x256 for a camera of aspect 1, else 180 rows at the
    /// camera's aspect, 320x180 for a camera without
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<PictureSize>,
    /// Technique of indirect light: auto (octree, irradiance and path, each as far as it makes the picture better; with
    /// --samples, path), octree, irradiance, path, none; lightmap is planned. path cannot find light of point, spot and
    /// directional lamps by way of mirrors and clear glass, but for the sun straight through panes; the others have photons
    /// for it
    #[arg(long, default_value = "auto", value_name = "TECHNIQUE", value_parser = parse_indirect)]
    pub indirect: Indirect,
    /// Stop after this long, such as 10s, 500ms, 2m; counts everything but reading the scene. Every pixel gets
    /// one sample in any case
    #[arg(long, value_name = "DURATION", allow_hyphen_values = true, value_parser = parse_duration)]
    pub time: Option<Duration>,
    /// Stop at this error (√relMSE, measured, the upper end of its 95 % interval not a tenth above, and found so again at
    /// pixels taken afresh), as a share or in percent: 0.02 or 2%. octree and irradiance stop above it where it is less than they can reach
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true, value_parser = parse_error)]
    pub error: Option<f64>,
    /// Percent of the time that measuring the error may take, such as 5%; whole, from 1% to 50%. Where --error is
    /// asked for and the picture comes near it, measuring takes at least 20%, and as much as drawing once only doubt
    /// is left of whether it is reached. path measures itself and takes nothing
    #[arg(long, value_name = "PERCENT", default_value = "5%", value_parser = parse_measuring)]
    pub measuring: MeasuringShare,
    /// Stop at this many samples per pixel. Without --time octree and irradiance learn all light first; irradiance, without
    /// --error too, only as well as that many samples are worth: 1 takes as long as 4
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub samples: Option<u32>,
    /// Most scatterings of a path: 1 is emission and direct light only, a pane of glass counts as two; no bound when left out. With --indirect auto,
    /// octree and irradiance the bound on what a surface receives takes no account of mirrors and glass between it and the eye
    #[arg(long, value_name = "N")]
    pub bounces: Option<u32>,
    /// Largest error that interpolating between records of irradiance may make, about (Ward's a), from 0.02 to 1; smaller takes more
    /// records, about as one over its square. octree and path have none
    #[arg(long, value_name = "A", default_value_t = Accuracy::default().irradiance_accuracy, value_parser = parse_irradiance_accuracy)]
    pub irradiance_accuracy: f32,
    /// Effects in place of the scene's plan, such as caustics=off,indirect=on: caustics and indirect may be auto, on or off.
    /// With off the picture lacks that light (what surfaces send on of caustics is indirect light, and stays); on costs time
    /// where there is something to follow, and changes nothing that is seen
    #[arg(long, value_name = "LIST", default_value = "", value_parser = parse_effects, hide_default_value = true)]
    pub effects: EffectChoices,
    /// Leave noise in pictures of looked-up light, instead of joining each pixel's with that of pixels around which show the same surface
    /// and differ by no more than their noise. What that blurs is in the error measured; path is never touched
    #[arg(long)]
    pub keep_noise: bool,
    /// Names the random numbers
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Threads; one per core when left out or 0
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=1024))]
    pub threads: Option<u16>,
    /// Where the picture is drawn: cpu; gpu (through Vulkan, Metal or DirectX 12; light for records of irradiance is gathered
    /// there, too); auto: the faster one by a short trial, where there is a graphics card
    #[arg(long, default_value = "auto", value_name = "BACKEND", value_parser = parse_backend)]
    pub backend: Backend,
    /// Add layers to the EXR: emitted, direct, caustics, indirect, specular, albedo, normal, depth, variance
    #[arg(long)]
    pub layers: bool,
    /// Exposure of PNG and JPEG in stops
    #[arg(long, value_name = "EV", default_value_t = 0.0, allow_negative_numbers = true, value_parser = parse_exposure)]
    pub exposure: f32,
    /// Tone map of PNG and JPEG: linear, reinhard, aces, agx
    #[arg(long, value_name = "NAME", default_value = "aces")]
    pub tone_map: ToneMap,
    /// Write 0001.exr, 0002.exr … at 0.1, 0.2, 0.5, 1, 2, 5 … seconds, as far as there is a picture by then and no pass under way,
    /// and at the end, and index.json, which tells each one's seconds
    #[arg(long, value_name = "DIR")]
    pub snapshots: Option<PathBuf>,
    /// Write times, counts, bytes, effects and the error as JSON
    #[arg(long, value_name = "FILE.json")]
    pub stats: Option<PathBuf>,
    /// Print the statistics as JSON instead of one line
    #[arg(long)]
    pub json: bool,
}

impl RenderArgs {
    /// The technique that is asked for. A number of samples is a question to the path tracer: of a picture that is looked up
    /// in what was learnt it says little.
    pub(super) fn technique(&self) -> Indirect {
        match (self.indirect, self.samples) {
            (Indirect::Auto, Some(_)) => Indirect::Path,
            (indirect, _) => indirect,
        }
    }
}

fn parse_effects(list: &str) -> Result<EffectChoices, String> {
    let mut choices = EffectChoices::default();
    let mut chosen = Vec::new();
    for item in list.split(',').map(str::trim).filter(|item| !item.is_empty()) {
        let (name, choice) = item
            .split_once('=')
            .ok_or_else(|| format!("{item:?}: write {item}=off, {item}=on or {item}=auto"))?;
        let kind =
            EffectChoices::KINDS.into_iter().find(|kind| kind.name() == name.trim()).ok_or_else(|| {
                format!(
                    "{name:?}: caustics and indirect can be chosen; the others come with materials and lights"
                )
            })?;
        if chosen.contains(&kind) {
            return Err(format!("{name} is chosen twice"));
        }
        chosen.push(kind);
        let choice = match choice.trim() {
            "auto" => EffectChoice::Plan,
            "on" => EffectChoice::On,
            "off" => EffectChoice::Off,
            _ => return Err(format!("{item:?}: auto, on or off, and a comma before the next effect")),
        };
        if let Some(place) = choices.choice_mut(kind) {
            *place = choice;
        }
    }
    Ok(choices)
}

/// Where light is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// The faster one.
    Auto,
    /// The CPU.
    Cpu,
    /// A graphics card, or what stands for one.
    Gpu,
}

/// What is written to `--out`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputFormat {
    /// Linear radiance.
    Exr,
    /// Display values, lossless.
    Png,
    /// Display values.
    Jpeg,
}

impl OutputFormat {
    /// The format that a file's extension stands for.
    pub fn of(path: &Path) -> Result<OutputFormat, CliError> {
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        match extension.to_ascii_lowercase().as_str() {
            "exr" => Ok(OutputFormat::Exr),
            "png" => Ok(OutputFormat::Png),
            "jpg" | "jpeg" => Ok(OutputFormat::Jpeg),
            _ => {
                let message =
                    format!("--out {}: the name must end in .exr, .png, .jpg or .jpeg", path.display());
                Err(CliError::Usage(message))
            }
        }
    }
}

fn parse_size(value: &str) -> Result<PictureSize, String> {
    let (width, height) = value.split_once('x').ok_or("expected WIDTHxHEIGHT, such as 1280x720")?;
    let side = |side: &str| {
        u32::from_str(side).map_err(|_| {
            format!("{side:?} is not a number of pixels: expected WIDTHxHEIGHT, such as 1280x720")
        })
    };
    PictureSize::new(side(width)?, side(height)?).map_err(|error| error.to_string())
}

pub(in crate::cli) fn parse_indirect(value: &str) -> Result<Indirect, String> {
    Indirect::ALL.into_iter().find(|technique| technique.name() == value).ok_or_else(|| {
        let choose = "choose auto, octree, irradiance, path or none";
        match value {
            "lightmap" => format!("{value} is planned but does not exist yet: {choose}"),
            _ => choose.into(),
        }
    })
}

fn parse_backend(value: &str) -> Result<Backend, String> {
    match value {
        "auto" => Ok(Backend::Auto),
        "cpu" => Ok(Backend::Cpu),
        "gpu" => Ok(Backend::Gpu),
        _ => Err("choose auto, cpu or gpu".into()),
    }
}

fn parse_error(value: &str) -> Result<f64, String> {
    Accuracy::read_target(value).ok_or_else(|| {
        let meant = Accuracy::percent_meant(value).map(|meant| format!("; did you mean {meant}?"));
        let must = "must be a number from 0.000001 on and below 1, or percent (0.02, 2% or 2.5%)";
        format!("{must}{}", meant.unwrap_or_default())
    })
}

fn parse_measuring(value: &str) -> Result<MeasuringShare, String> {
    let percents = MeasuringShare::PERCENTS;
    let number = value.trim().strip_suffix('%').unwrap_or(value).trim().parse().ok();
    number
        .and_then(MeasuringShare::of_percent)
        .ok_or_else(|| format!("whole percent from {}% to {}%", percents.start(), percents.end()))
}

fn parse_irradiance_accuracy(value: &str) -> Result<f32, String> {
    let [least, most] = Accuracy::IRRADIANCE_RANGE;
    let accuracy = value.trim().parse().ok().filter(|accuracy| (least..=most).contains(accuracy));
    accuracy.ok_or_else(|| format!("a number from {least} to {most}"))
}

/// Exposures, stops, either way: 2^±64 spans every radiance that a scene may hold.
pub(super) const EXPOSURE_MAX: f32 = 64.0;

fn parse_exposure(value: &str) -> Result<f32, String> {
    match f32::from_str(value) {
        Ok(stops) if stops.abs() <= EXPOSURE_MAX => Ok(stops),
        Ok(_) => Err("must be between -64 and 64 stops".into()),
        Err(_) => Err("not a number of stops".into()),
    }
}

/// The size of a picture when none is asked for: see [`RenderArgs::size`].
pub fn default_size(camera: Option<&Camera>) -> PictureSize {
    let aspect = camera.and_then(|camera| camera.aspect).unwrap_or(16.0 / 9.0);
    let (width, height) =
        if (aspect - 1.0).abs() < 1e-3 { (256.0, 256) } else { ((180.0 * aspect).round(), 180) };
    let width = width.clamp(1.0, f64::from(PictureSize::SIDE_MAX)) as u32;
    // Both sides are within bounds by construction; a pixel is the answer to the impossible.
    PictureSize::new(width, height).or_else(|_| PictureSize::new(1, 1)).unwrap_or_else(|_| unreachable!())
}

/// The camera called `name`, or the scene's first.
pub fn find_camera<'a>(
    scene: &'a Scene,
    name: Option<&str>,
) -> Result<Option<(&'a str, &'a Camera)>, CliError> {
    let Some(name) = name else {
        return Ok(scene.cameras().first().map(|(id, camera)| (id.as_str(), camera)));
    };
    if let Some((id, camera)) = scene.cameras().get_key_value(name) {
        return Ok(Some((id.as_str(), camera)));
    }
    let names: Vec<&str> = scene.cameras().keys().map(|id| id.as_str()).collect();
    let there_is =
        if names.is_empty() { "it has none".into() } else { format!("it has {}", names.join(", ")) };
    Err(CliError::Usage(format!("--camera {name}: the scene has no such camera: {there_is}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DAffine3;
    use lumicast_engine::scene::{Projection, samples};

    /// What is written is what is meant; what cannot be meant is refused.
    #[test]
    fn errors_and_sizes_are_read_in_their_units() {
        assert_eq!((parse_error("0.02"), parse_error("2%")), (Ok(0.02), Ok(0.02)));
        assert_eq!(parse_error(" 2 %"), Ok(0.02));
        for bad in ["0", "1", "100%", "-1", "nan", "x"] {
            assert!(parse_error(bad).is_err(), "{bad}");
        }
        assert_eq!(parse_irradiance_accuracy("0.1"), Ok(0.1));
        for bad in ["0", "0.01", "1.1", "nan", "10%", ""] {
            assert!(parse_irradiance_accuracy(bad).is_err(), "{bad}");
        }
        assert_eq!(parse_size("320x180").map(|size| (size.width(), size.height())), Ok((320, 180)));
        for bad in ["320", "320x", "x1", "0x1", "320X180", "99999x1", "-1x2"] {
            assert!(parse_size(bad).is_err(), "{bad}");
        }
    }

    /// The protocol cannot see the engine, but both mean the same records.
    #[test]
    fn the_default_accuracy_is_the_engines() {
        let engine = lumicast_engine::technique::irradiance::IrradianceSettings::default();
        assert_eq!(Accuracy::default().irradiance_accuracy, engine.weighing.accuracy);
    }

    /// Techniques that do not exist yet and backends that are none are refused with those that do.
    #[test]
    fn what_does_not_exist_yet_is_refused_with_what_does() {
        let message = parse_indirect("lightmap").unwrap_err();
        assert!(message.contains("does not exist yet"), "{message}");
        assert!(message.contains("auto, octree, irradiance, path or none"), "{message}");
        assert!(parse_backend("tpu").unwrap_err().contains("auto, cpu or gpu"));
    }

    /// The default size follows the camera's aspect.
    #[test]
    fn default_sizes_follow_the_aspect() {
        let size = |aspect| {
            let projection = Projection::Perspective { yfov_rad: 1.0 };
            let camera = Camera { parent: None, parent_from_camera: DAffine3::IDENTITY, projection, aspect };
            let size = default_size(Some(&camera));
            (size.width(), size.height())
        };
        assert_eq!(size(Some(1.0)), (256, 256));
        assert_eq!(size(Some(16.0 / 9.0)), (320, 180));
        assert_eq!(size(Some(1.7777)), (320, 180));
        assert_eq!(size(None), (320, 180));
        assert_eq!(size(Some(0.002)), (1, 180));
        assert_eq!(size(Some(999.0)), (PictureSize::SIDE_MAX, 180));
        let none = default_size(None);
        assert_eq!((none.width(), none.height()), (320, 180));
    }

    /// Cameras are found by name; a wrong name is answered with the right ones.
    #[test]
    fn cameras_are_found_by_name() {
        let scene = samples::cornell_box().unwrap();
        assert_eq!(find_camera(&scene, None).unwrap().unwrap().0, "main");
        assert_eq!(find_camera(&scene, Some("corner")).unwrap().unwrap().0, "corner");
        let message = find_camera(&scene, Some("roof")).unwrap_err().to_string();
        assert!(message.contains("main, corner"), "{message}");
        assert!(find_camera(&Scene::default(), None).unwrap().is_none());
        assert!(find_camera(&Scene::default(), Some("x")).unwrap_err().to_string().contains("it has none"));
    }

    /// The format is that of the extension.
    #[test]
    fn formats_are_told_by_the_extension() {
        let format = |name: &str| OutputFormat::of(Path::new(name));
        assert_eq!(format("a.EXR").unwrap(), OutputFormat::Exr);
        assert_eq!(format("a.b.png").unwrap(), OutputFormat::Png);
        assert_eq!(
            (format("x.jpg").unwrap(), format("x.jpeg").unwrap()),
            (OutputFormat::Jpeg, OutputFormat::Jpeg)
        );
        for bad in ["a", "a.tiff", ".exr", ""] {
            assert_eq!(format(bad).unwrap_err().exit_code(), 2, "{bad}");
        }
    }
}
