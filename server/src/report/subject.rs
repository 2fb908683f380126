//! Scenes to measure, and the references that pictures of them are compared with.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use lumicast_engine::{
    effects::EffectPlan,
    film::PictureSize,
    math::Rgb,
    scene::{CameraView, Scene},
    transport::World,
};
use serde::Serialize;

use super::{ReportError, ReportJob};
use crate::assets::BuiltinScene;
use crate::cli::{
    render::{default_size, find_camera},
    scene_source::SceneSource,
};
use crate::images::decode_exr;

/// A scene by name, not read yet.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Subject {
    /// Name in the report.
    pub(super) name: String,
    /// Where it comes from.
    #[serde(serialize_with = "as_text")]
    source: SceneSource,
    /// Of what its file holds: with another one, earlier rows say nothing.
    content: u64,
    /// Folder of references, and what those of this scene hold.
    references: PathBuf,
    reference_content: u64,
}

fn as_text<S: serde::Serializer>(source: &SceneSource, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(source)
}

/// A scene ready to be measured.
#[derive(Debug)]
pub(super) struct Prepared {
    /// With its trees and lights.
    pub(super) world: Arc<World>,
    /// What the scene calls for.
    pub(super) plan: EffectPlan,
    /// Name of its first camera.
    pub(super) camera: Option<String>,
    /// That camera; all of it from the front where it has none.
    pub(super) view: CameraView,
    /// The reference's size, or that of a picture when none is asked for.
    pub(super) size: PictureSize,
    /// What pictures are compared with.
    pub(super) reference: Option<Reference>,
    /// It has only Lambertian surfaces: light of the octree is the reference less its direct light.
    pub(super) is_diffuse: bool,
}

/// A picture by an independent renderer, `[h × w]`, W/(m² sr).
#[derive(Debug)]
pub(super) struct Reference {
    /// All light.
    pub(super) full: Vec<Rgb>,
    /// Light seen directly and direct light at the first surface.
    pub(super) direct: Vec<Rgb>,
    /// √relMSE that the noise of both makes together; `None` where nobody has measured it.
    pub(super) noise: Option<f64>,
}

/// A picture by an independent renderer alone.
#[derive(Debug)]
pub(super) struct FullReference {
    pub(super) size: PictureSize,
    /// `[h × w]`, W/(m² sr).
    pub(super) picture: Vec<Rgb>,
    /// √relMSE of its own noise.
    pub(super) noise: Option<f64>,
}

/// The scenes of `job`, or those of `wanted` that are there, and a line for each that is not.
///
/// - `wanted`: names; `boxes` is built in where the folder lacks it
/// - `instead`: taken when none is there
pub(super) fn find(
    job: &ReportJob,
    wanted: &[&str],
    instead: Option<SceneSource>,
) -> (Vec<Subject>, Vec<String>) {
    if !job.scenes.is_empty() {
        let subjects = job.scenes.iter().map(|source| Subject::new(name_of(source), source.clone(), job));
        return (subjects.collect(), Vec::new());
    }
    let mut left_out = Vec::new();
    let mut subjects = Vec::new();
    for name in wanted {
        let path = job.scenes_folder.join(format!("{name}.glb"));
        let source = match *name {
            _ if path.is_file() => SceneSource::File(path),
            "boxes" => SceneSource::Builtin(BuiltinScene::Boxes),
            _ => {
                left_out.push(format!("{name} is left out: put it at {} to measure it", path.display()));
                continue;
            }
        };
        subjects.push(Subject::new((*name).into(), source, job));
    }
    if let Some(source) = instead.filter(|_| subjects.is_empty()) {
        left_out.push(format!("{source} stands in for what was left out"));
        subjects.push(Subject::new(name_of(&source), source, job));
    }
    (subjects, left_out)
}

fn name_of(source: &SceneSource) -> String {
    match source {
        SceneSource::File(path) => {
            path.file_stem().map_or_else(|| "scene".into(), |stem| stem.to_string_lossy().into_owned())
        }
        SceneSource::Builtin(scene) => scene.name().into(),
    }
}

impl Prepared {
    /// The same scene for another picture, without its reference.
    ///
    /// - `size`: of the picture
    pub(super) fn again(&self, size: PictureSize) -> Prepared {
        let (world, plan, camera) = (self.world.clone(), self.plan.clone(), self.camera.clone());
        Prepared { world, plan, camera, size, reference: None, ..*self }
    }
}

impl Subject {
    fn new(name: String, source: SceneSource, job: &ReportJob) -> Subject {
        let content = match &source {
            SceneSource::File(path) => content_of(path),
            _ => 0,
        };
        let references = job.references_folder.clone();
        let entries = std::fs::read_dir(&references).into_iter().flatten().flatten();
        let start = format!("{name}-");
        let is_own = |name: &str| name.starts_with(&start) || name == "noise.json";
        let mut own: Vec<PathBuf> = entries
            .filter(|entry| is_own(&entry.file_name().to_string_lossy()))
            .map(|entry| entry.path())
            // What an earlier run drew here itself is no reference.
            .filter(|path| path.parent() != Some(job.out.as_path()))
            .collect();
        own.sort();
        let reference_content = own.iter().fold(0, |all: u64, path| all.rotate_left(7) ^ content_of(path));
        Subject { name, source, content, references, reference_content }
    }

    /// Its file is there and is a scene that can be read.
    pub(super) fn check(&self) -> Result<(), ReportError> {
        self.load().map(|_| ())
    }

    fn load(&self) -> Result<Arc<Scene>, ReportError> {
        let broken = |source| ReportError::Scene { name: self.name.clone(), source: Box::new(source) };
        Ok(self.source.load().map_err(broken)?.scene)
    }

    /// A picture that is called like a reference of this scene, and is of another.
    pub(super) fn namesake(&self, camera: &str) -> Option<PathBuf> {
        let path = self.reference_path(&format!("{}-{camera}", self.name));
        (!self.has_references() && path.is_file()).then_some(path)
    }

    fn reference_path(&self, name: &str) -> PathBuf {
        self.references.join(format!("{name}.exr"))
    }

    /// Built-in scenes have no references: what is called like one is another.
    fn has_references(&self) -> bool {
        matches!(self.source, SceneSource::File(_))
    }

    /// Reads the scene and its reference.
    pub(super) fn prepare(&self) -> Result<Prepared, ReportError> {
        let broken = |source| ReportError::Scene { name: self.name.clone(), source: Box::new(source) };
        let scene = self.load()?;
        let camera = find_camera(&scene, None).map_err(broken)?;
        let reference = match camera {
            Some((camera, _)) => self.reference(camera)?,
            None => None,
        };
        let view = camera.and_then(|(name, _)| scene.camera_view(Some(name)));
        let (size, reference) = match reference {
            Some((size, reference)) => (size, Some(reference)),
            None => (default_size(camera.map(|(_, camera)| camera)), None),
        };
        Ok(Prepared {
            camera: camera.map(|(name, _)| name.to_string()),
            view: view.unwrap_or_else(|| scene.default_view()),
            size,
            reference,
            is_diffuse: is_diffuse(&scene),
            plan: EffectPlan::of(&scene),
            world: Arc::new(World::prepare(scene)),
        })
    }

    /// The pair of pictures of a camera; both or none.
    fn reference(&self, camera: &str) -> Result<Option<(PictureSize, Reference)>, ReportError> {
        let name = format!("{}-{camera}", self.name);
        let [full, direct] = [&name, &format!("{name}-direct")].map(|name| self.reference_path(name));
        if !(self.has_references() && full.is_file() && direct.is_file()) {
            return Ok(None);
        }
        let (size, full) = read(&full)?;
        let (direct_size, direct_picture) = read(&direct)?;
        if direct_size != size {
            let reason = "it is not of the size of the full picture beside it".into();
            return Err(ReportError::Reference { path: direct, reason });
        }
        let noise = self.noise(&name).zip(self.noise(&format!("{name}-direct")));
        let noise = noise.map(|(full, direct)| (full + direct).sqrt());
        Ok(Some((size, Reference { full, direct: direct_picture, noise })))
    }

    /// The picture of a camera alone, with the √relMSE of its noise where that is known.
    pub(super) fn full_reference(&self, camera: &str) -> Result<Option<FullReference>, ReportError> {
        let name = format!("{}-{camera}", self.name);
        let path = self.reference_path(&name);
        if !(self.has_references() && path.is_file()) {
            return Ok(None);
        }
        let (size, picture) = read(&path)?;
        Ok(Some(FullReference { size, picture, noise: self.noise(&name).map(f64::sqrt) }))
    }

    /// relMSE of a picture's own noise, from `noise.json` beside it.
    fn noise(&self, name: &str) -> Option<f64> {
        let json = std::fs::read(self.references.join("noise.json")).ok()?;
        let json: serde_json::Value = serde_json::from_slice(&json).ok()?;
        json.get(name)?.get("noise_relMSE")?.as_f64()
    }
}

/// A number that another content of a file would hardly have; 0 where there is none.
fn content_of(path: &Path) -> u64 {
    use std::hash::{DefaultHasher, Hash, Hasher};
    let mut hasher = DefaultHasher::new();
    let Ok(bytes) = std::fs::read(path) else { return 0 };
    bytes.hash(&mut hasher);
    hasher.finish()
}

/// Nothing but Lambertian surfaces: no mirror, no glass, no Fresnel lobe.
fn is_diffuse(scene: &Scene) -> bool {
    scene
        .materials()
        .values()
        .all(|material| material.metallic == 0.0 && material.specular == 0.0 && material.transmission == 0.0)
}

/// The picture of an EXR file.
pub(super) fn read(path: &Path) -> Result<(PictureSize, Vec<Rgb>), ReportError> {
    let broken = |reason: String| ReportError::Reference { path: path.to_path_buf(), reason };
    let bytes = std::fs::read(path).map_err(|error| broken(error.to_string()))?;
    decode_exr(&bytes).map_err(|error| broken(error.to_string()))
}
