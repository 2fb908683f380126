//! `lumicast report`: what accuracy costs in time, as tables, plots and files.

use std::path::PathBuf;

use super::{CliError, SceneSource, output::print_line};
use crate::report::{Paper, ReportJob, measure};

/// Measure what accuracy costs in time: a paper's tables again on this machine, beside the paper's own figures.
///
/// Prints the tables as Markdown; writes report.html, report.csv and report.json. A run that is stopped goes on where it
/// was when it is started again with the same --out.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct ReportArgs {
    /// Scenes (.glb, .gltf, .obj, builtin:boxes, builtin:cornell-box) instead of the paper's
    #[arg(value_name = "SCENE")]
    pub(super) scene: Vec<SceneSource>,
    /// Paper whose tables are measured again; the general report over all techniques is planned
    #[arg(long, value_name = "PAPER")]
    pub(super) paper: Option<Paper>,
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
    let Some(paper) = args.paper else {
        let message = "report: the general report over all techniques is planned but does not exist yet: \
                       choose --paper octree, --paper larsen-maps, --paper irradiance or --paper caustics";
        return Err(CliError::Usage(message.into()));
    };
    if args.out.exists() && !args.out.is_dir() {
        return Err(CliError::Usage(format!("--out {}: this is not a folder", args.out.display())));
    }
    Ok(ReportJob {
        paper,
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

    fn args(out: PathBuf, paper: Option<Paper>) -> ReportArgs {
        ReportArgs { scene: Vec::new(), paper, out, scenes: "s".into(), references: "r".into() }
    }

    /// The report that does not exist yet is refused with those that do; a file is no folder.
    #[test]
    fn what_does_not_exist_yet_is_refused_with_what_does() {
        let folder = tempfile::tempdir().unwrap();
        let error = run(args(folder.path().join("out"), None)).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let message = error.to_string();
        assert!(message.contains("--paper octree") && message.contains("larsen-maps"), "{message}");
        assert!(!folder.path().join("out").exists());
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let error = run(args(file, Some(Paper::Octree))).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("not a folder"), "{error}");
    }

    /// Papers are named as documented; scenes are given by place and the folder by name.
    #[test]
    fn arguments_are_read_as_documented() {
        let parse = |words: &[&str]| Arguments::try_parse_from([&["lumicast", "report"], words].concat());
        for paper in ["octree", "larsen-maps", "irradiance", "caustics"] {
            assert!(parse(&["--paper", paper, "--out", "x", "a.glb", "builtin:boxes"]).is_ok());
            assert!(parse(&["--paper", paper, "--out", "x", "--scenes", "y", "--references", "z"]).is_ok());
        }
        assert!(parse(&["--paper", "other", "--out", "x"]).unwrap_err().to_string().contains("larsen-maps"));
        assert!(parse(&["--paper", "octree"]).is_err());
        assert!(parse(&["--paper", "octree", "--out", "x", "builtin:nothing"]).is_err());
    }
}
