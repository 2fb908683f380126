//! `lumicast report`: what accuracy costs in time, as tables, plots and files.

use std::path::PathBuf;
use std::time::Duration;

use lumicast_engine::render::Indirect;

use super::render::parse_indirect;
use super::{CliError, SceneSource, output::print_line};
use crate::duration::parse_duration;
use crate::report::{Cost, Paper, Question, ReportJob, measure};

/// Less than this a picture is not drawn for: the first look comes then.
const LEAST: Duration = Duration::from_millis(250);

/// Measure what accuracy costs in time: every technique against a reference; or a paper's tables again on this machine.
///
/// Each technique draws a scene's first camera twice, for --time each, and is compared with a reference on the way: another
/// renderer's picture from --references, or one that is drawn first. Prints the tables as Markdown; writes report.html,
/// report.csv and report.json. A run that is stopped goes on where it was when it is started again with the same --out.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct ReportArgs {
    /// Scenes (.glb, .gltf, .obj, builtin:boxes, builtin:cornell-box); the built-in Cornell box, or the paper's scenes,
    /// when none is named
    #[arg(value_name = "SCENE")]
    pub(super) scene: Vec<SceneSource>,
    /// Paper whose tables are measured again, instead of what accuracy costs
    #[arg(long, value_name = "PAPER", conflicts_with_all = ["indirect", "time", "peers"])]
    pub(super) paper: Option<Paper>,
    /// Techniques: any of auto, octree, irradiance, path, none
    #[arg(
        long, value_name = "LIST", value_delimiter = ',', default_value = "octree,irradiance,auto,path",
        value_parser = parse_indirect
    )]
    pub(super) indirect: Vec<Indirect>,
    /// How long each picture is drawn: 8s, 1m; 0.25s at least
    #[arg(long, value_name = "DURATION", allow_hyphen_values = true, default_value = "8s", value_parser = parse_duration)]
    pub(super) time: Duration,
    /// Other renderers' pictures by the clock, to stand beside ours:
    /// {"peer": NAME, "scene": NAME, "points": [{"t": SECONDS, "exr": FILE}]} or a list of such; may be given several times
    #[arg(long, value_name = "FILE")]
    pub(super) peers: Vec<PathBuf>,
    /// Folder for report.html, report.csv and report.json; made when there is none
    #[arg(long, value_name = "DIR")]
    pub(super) out: PathBuf,
    /// Folder of the paper's scenes, NAME.glb
    #[arg(long, value_name = "DIR", default_value = "../shared/scenes")]
    pub(super) scenes: PathBuf,
    /// Folder of references, NAME-CAMERA.exr and NAME-CAMERA-direct.exr of each scene's first camera
    #[arg(long, value_name = "DIR", default_value = "../shared/references")]
    pub(super) references: PathBuf,
}

/// Measures, writes the files and prints the tables.
pub(super) fn run(args: ReportArgs) -> Result<(), CliError> {
    let job = job_of(args)?;
    let report = measure(&job)?;
    print_line(report.markdown().trim_end())
}

fn job_of(args: ReportArgs) -> Result<ReportJob, CliError> {
    if args.time < LEAST {
        return Err(CliError::Usage(format!("--time: give each picture {} s at least", LEAST.as_secs_f64())));
    }
    let mut techniques: Vec<Indirect> = Vec::new();
    for technique in args.indirect {
        if !techniques.contains(&technique) {
            techniques.push(technique);
        }
    }
    let question = match args.paper {
        Some(paper) => Question::Paper(paper),
        None => Question::Cost(Cost { techniques, time: args.time, peers: args.peers }),
    };
    if args.out.exists() && !args.out.is_dir() {
        return Err(CliError::Usage(format!("--out {}: this is not a folder", args.out.display())));
    }
    Ok(ReportJob {
        question,
        scenes: args.scene,
        scenes_folder: args.scenes,
        references_folder: args.references,
        out: args.out,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Arguments;
    use clap::Parser;

    /// A file is no folder, and no time is too little.
    #[test]
    fn what_makes_no_report_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let args = |time_ms: u64, out: PathBuf| ReportArgs {
            scene: Vec::new(),
            paper: None,
            indirect: vec![Indirect::Path],
            time: Duration::from_millis(time_ms),
            peers: Vec::new(),
            out,
            scenes: "s".into(),
            references: "r".into(),
        };
        let error = run(args(1000, file)).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("not a folder"), "{error}");
        let error = run(args(100, folder.path().join("out"))).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("--time"), "{error}");
        assert!(!folder.path().join("out").exists());
    }

    /// Papers are named as documented; scenes are given by place and the folder by name.
    #[test]
    fn arguments_are_read_as_documented() {
        let parse = |words: &[&str]| Arguments::try_parse_from([&["lumicast", "report"], words].concat());
        for paper in ["octree", "larsen-maps", "irradiance", "hemisphere", "caustics"] {
            assert!(parse(&["--paper", paper, "--out", "x", "a.glb", "builtin:boxes"]).is_ok());
            assert!(parse(&["--paper", paper, "--out", "x", "--scenes", "y", "--references", "z"]).is_ok());
        }
        assert!(parse(&["--paper", "other", "--out", "x"]).unwrap_err().to_string().contains("larsen-maps"));
        assert!(
            parse(&["--out", "x", "a.glb", "--indirect", "auto,path", "--time", "2s", "--peers", "s.json"])
                .is_ok()
        );
        assert!(
            parse(&["--out", "x", "--indirect", "lightmap"]).unwrap_err().to_string().contains("planned")
        );
        assert!(parse(&["--out", "x", "--paper", "octree", "--time", "2s"]).is_err());
        assert!(parse(&["--paper", "octree"]).is_err());
        assert!(parse(&["--paper", "octree", "--out", "x", "builtin:nothing"]).is_err());
    }
}
