//! Reports: what accuracy costs in time on this machine, beside what the papers measured on theirs.
//!
//! A report is a list of tables (`table.rs`). A notebook (`notebook.rs`) fills them row by row and keeps every row on disk at once, so
//! that a run that was stopped goes on where it was. `octree.rs` measures figures 13, 14 and 17 of Vivanloc 2007 (light octree),
//! `maps.rs` and `crease.rs` tables 8.1, 8.2 and 14.1 of Larsen 2004, `irradiance.rs` table 8.2 and figure 8.11 of Gautron
//! 2008, `hemisphere.rs` its table 8.1, `caustics.rs` what caustics cost beside path tracing; `drawing.rs` draws pictures by the clock, `subject.rs` finds scenes and references,
//! `cost/` measures what accuracy costs with each technique, `peers.rs` reads what other renderers drew, `pictures.rs` shows where
//! the error sits. `light.rs` builds photons and octrees by the clock, `accuracy.rs` compares with a reference. `html.rs`, `plot.rs` and
//! `csv.rs` write. Imports the engine and the command line's way to name scenes.

mod accuracy;
mod caustics;
mod cost;
mod crease;
mod csv;
mod drawing;
mod hemisphere;
mod html;
mod irradiance;
mod light;
mod machine;
mod maps;
mod notebook;
mod octree;
mod peers;
mod pictures;
mod plot;
mod subject;
mod table;
#[cfg(test)]
mod tests;

use std::{num::NonZeroUsize, path::PathBuf, time::Duration};

use lumicast_engine::render::Indirect;
use serde::Serialize;

use crate::{
    assets::BuiltinScene,
    cli::{error::CliError, scene_source::SceneSource},
    images::FileError,
};
use notebook::Notebook;
pub use notebook::Report;
use subject::Subject;

/// A paper whose figures are measured again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Paper {
    /// Vivanloc 2007, light octree: figures 13, 14, 17
    Octree,
    /// Larsen 2004, many photon maps: tables 8.1, 8.2, 14.1
    LarsenMaps,
    /// Gautron et al. 2008, irradiance cache: table 8.2, figure 8.11
    Irradiance,
    /// Gautron et al. 2008, hemispheres sampled on planes: table 8.1
    Hemisphere,
    /// Larsen 2004, chapter 12: what a frame of caustics costs, and error over time
    Caustics,
}

impl Paper {
    /// Title of its report.
    fn title(self) -> &'static str {
        match self {
            Paper::Octree => "The light octree beside its paper",
            Paper::LarsenMaps => "Many photon maps beside their paper",
            Paper::Irradiance => "The irradiance cache beside its paper",
            Paper::Hemisphere => "Hemispheres on planes beside their paper",
            Paper::Caustics => "Caustics by photons beside the path tracer",
        }
    }

    /// The paper, and what its figures were measured on, as far as it says.
    fn source(self) -> &'static str {
        match self {
            Paper::Octree => {
                "Vivanloc, Hoelt, Binh, Paulin: Light octree: global illumination fast reconstruction and realtime \
                 navigation, WSCG 2007. Its seconds are of 4 threads on 2 GHz Opterons, its frames per second of a GPU \
                 of 2006; it gives no error against a reference."
            }
            Paper::LarsenMaps => {
                "B. D. Larsen: Real-time Global Illumination by Simulating Photon Mapping, thesis, DTU 2004. Its times \
                 are of one thread on a Pentium 4 portable of 1.7 GHz with 512 KiB of second-level cache; it gives no \
                 error against a reference."
            }
            Paper::Irradiance => {
                "P. Gautron, J. Křivánek, K. Bouatouch, S. Pattanaik: Hardware implementation, chapter 8 of Practical Global \
                 Illumination with Irradiance Caching, SIGGRAPH course 2008. Its times are of a Quadro FX 3400 and, for \
                 Radiance, of a Pentium 4 of 3.6 GHz; it gives no error against a reference."
            }
            Paper::Hemisphere => {
                "P. Gautron, J. Křivánek, K. Bouatouch, S. Pattanaik: Hardware implementation, chapter 8 of Practical Global \
                 Illumination with Irradiance Caching, SIGGRAPH course 2008. Its table 8.1 gives errors alone, no times."
            }
            Paper::Caustics => {
                "B. D. Larsen: Real-time Global Illumination by Simulating Photon Mapping, thesis, DTU 2004, chapter 12. It \
                 gives frames a second on a GPU of 2004 and no error against a reference."
            }
        }
    }
}

/// What a report answers.
#[derive(Clone, Debug, PartialEq)]
pub enum Question {
    /// A paper's tables, measured again.
    Paper(Paper),
    /// What accuracy costs in time.
    Cost(Cost),
}

/// What accuracy costs in time, by each technique.
#[derive(Clone, Debug, PartialEq)]
pub struct Cost {
    /// The techniques.
    pub techniques: Vec<Indirect>,
    /// How long each picture is drawn.
    pub time: Duration,
    /// Files `series.json` of other renderers' pictures, to be compared with the same references.
    pub peers: Vec<PathBuf>,
}

impl Question {
    fn paper(&self) -> Option<Paper> {
        match self {
            Question::Paper(paper) => Some(*paper),
            Question::Cost(_) => None,
        }
    }

    fn title(&self) -> &'static str {
        self.paper().map_or("What accuracy costs in time", Paper::title)
    }

    fn source(&self) -> &'static str {
        self.paper().map_or("", Paper::source)
    }
}

/// What to measure and where to put it.
#[derive(Clone, Debug)]
pub struct ReportJob {
    /// What it answers.
    pub question: Question,
    /// Scenes instead of those of the question.
    pub scenes: Vec<SceneSource>,
    /// Folder of the paper's scenes, `NAME.glb`.
    pub scenes_folder: PathBuf,
    /// Folder of references, `NAME-CAMERA.exr` and `NAME-CAMERA-direct.exr`.
    pub references_folder: PathBuf,
    /// Folder of the report; made when there is none.
    pub out: PathBuf,
}

/// How much is measured. Command lines get [`Effort::FULL`]; tests get by with less.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Effort {
    /// Photons relative to the paper's, and of what records are gathered from to those of pictures.
    photon_share: f64,
    /// Octrees are so many levels flatter.
    levels_less: u32,
    /// Samples per pixel of pictures drawn with an octree. At 32 what is left of the noise at edges is well below 1 %.
    passes: u32,
    /// Samples per pixel of pictures drawn with photon maps, whose look-ups take a hundred times longer.
    map_passes: u32,
    /// Times that trees are built for a median.
    repeats: usize,
    /// Times that an octree is built; the fastest counts.
    octree_builds: usize,
    /// Side of the pictures of one bounce, pixels; samples per pixel of the path tracer's and of those by records.
    cache_side: u32,
    one_bounce_passes: u32,
    cache_passes: u32,
    /// Looks at a picture while its records are made, each after twice the time of the one before.
    fill_steps: u32,
    /// Irradiances by planes, and rays of either half of what they are compared with.
    hemispheres: u32,
    hemisphere_rays: u32,
    /// Rays of a record; `None`: as many as pictures have.
    record_rays: Option<NonZeroUsize>,
}

impl Effort {
    const FULL: Effort = Effort {
        photon_share: 1.0,
        levels_less: 0,
        passes: 32,
        map_passes: 4,
        repeats: 5,
        octree_builds: 3,
        cache_side: 1000,
        one_bounce_passes: 32,
        cache_passes: 4,
        fill_steps: 7,
        hemispheres: 10_000,
        hemisphere_rays: 1024,
        record_rays: None,
    };

    /// The share of a number of photons.
    fn photons(&self, count: u32) -> u32 {
        ((f64::from(count) * self.photon_share).round() as u32).max(1)
    }
}

/// Why a report could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A scene that cannot be used.
    #[error("scene {name}: {source}")]
    Scene {
        /// Its name in the report.
        name: String,
        /// Why not.
        #[source]
        source: Box<CliError>,
    },
    /// A scene in which there is nothing to measure.
    #[error("scene {name}: it has no {missing}, so there is nothing to measure")]
    Empty {
        /// Its name in the report.
        name: String,
        /// What it lacks.
        missing: &'static str,
    },
    /// None of the scenes that a table needs is there.
    #[error(
        "none of the paper's scenes is there: name one on the command line, or give --scenes the folder of {wanted}"
    )]
    NoScene {
        /// Names of the files.
        wanted: String,
    },
    /// A reference that cannot be read.
    #[error("reference {}: {reason}", path.display())]
    Reference {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// A card that was opened, and does not draw.
    #[error("nothing was drawn on {name}: {reason}")]
    Card {
        /// The card.
        name: String,
        /// Why not.
        reason: String,
    },
    /// Two scenes of one name.
    #[error("two scenes are called {name}: rename the file of one, or make a report of each")]
    Twice {
        /// Their name.
        name: String,
    },
    /// Another renderer's pictures that cannot be read or compared.
    #[error("--peers {}: {reason}", path.display())]
    Peer {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// A folder that could not be made.
    #[error("making the folder {}: {source}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// Why not.
        #[source]
        source: std::io::Error,
    },
    /// An earlier report that could not be given another name.
    #[error("keeping the earlier report {}: {source}; name another folder with --out", path.display())]
    Aside {
        /// Its file.
        path: PathBuf,
        /// Why not.
        #[source]
        source: std::io::Error,
    },
    /// A part of the report that could not be written as text.
    #[error("writing {what}: {reason}")]
    Text {
        /// Which part.
        what: &'static str,
        /// Why not.
        reason: String,
    },
    /// A file that could not be written.
    #[error(transparent)]
    File(#[from] FileError),
}

/// Measures what `job` asks for on the rayon pool it is called in; writes `report.json` after every row, and
/// `report.html` and `report.csv` at the end.
///
/// Rows that `report.json` of the same version, machine and settings has are taken over.
pub fn measure(job: &ReportJob) -> Result<Report, ReportError> {
    measure_with(job, Effort::FULL)
}

fn measure_with(job: &ReportJob, effort: Effort) -> Result<Report, ReportError> {
    let wanted: &[&str] = match job.question.paper() {
        Some(Paper::Octree) => &octree::SCENES,
        Some(Paper::LarsenMaps) => &crease::SCENES,
        Some(Paper::Irradiance) => &irradiance::SCENES,
        Some(Paper::Hemisphere) => &hemisphere::SCENES,
        Some(Paper::Caustics) => &caustics::SCENES,
        None => &[],
    };
    // Boxes are among the octree's, and always there.
    let (subjects, left_out) =
        subject::find(job, wanted, Some(SceneSource::Builtin(BuiltinScene::CornellBox)));
    if let Some(twice) =
        subjects.iter().enumerate().find(|(at, one)| subjects[..*at].iter().any(|two| two.name == one.name))
    {
        return Err(ReportError::Twice { name: twice.1.name.clone() });
    }
    // Before anything is written, and before hours are spent on those before it.
    subjects.iter().try_for_each(Subject::check)?;
    let settings = match &job.question {
        Question::Paper(_) => serde_json::to_value(Settings { effort, subjects: &subjects }),
        Question::Cost(cost) => serde_json::to_value(cost::Settings::of(cost, &subjects)),
    };
    let settings =
        settings.map_err(|error| ReportError::Text { what: "the settings", reason: error.to_string() })?;
    let mut notebook = Notebook::open(job, settings)?;
    for missing in left_out {
        notebook.warn(missing);
    }
    if let Some(busy) = machine::busy() {
        notebook.warn(busy);
    }
    match &job.question {
        Question::Cost(cost) => cost::measure(&mut notebook, &subjects, cost)?,
        Question::Paper(Paper::Octree) => octree::measure(&mut notebook, &subjects, effort)?,
        Question::Paper(Paper::LarsenMaps) => {
            maps::measure_many(&mut notebook, effort)?;
            crease::measure(&mut notebook, &subjects, effort)?;
            maps::measure_small(&mut notebook, effort)?;
        }
        Question::Paper(Paper::Irradiance) => irradiance::measure(&mut notebook, &subjects, effort)?,
        Question::Paper(Paper::Hemisphere) => hemisphere::measure(&mut notebook, &subjects, effort)?,
        Question::Paper(Paper::Caustics) => caustics::measure(&mut notebook, &subjects, effort)?,
    }
    notebook.finish()
}

/// What figures depend on beside version and machine: rows of other settings are not taken over.
#[derive(Debug, Serialize)]
struct Settings<'a> {
    effort: Effort,
    subjects: &'a [Subject],
}
