//! The command line: one file per command, each with its arguments and `run`.

mod error;
pub mod info;
mod output;
pub mod render;
mod scene_source;

pub use error::CliError;
pub use scene_source::{LoadedScene, SceneSource};

use clap::Parser;

#[derive(Debug, Parser)]
#[command(name = "lumicast", version, about = "Interactive global-illumination server")]
enum Command {
    Render(render::RenderArgs),
    Info(info::InfoArgs),
}

/// Runs the command line of this process. Clap itself answers wrong usage, with exit code 2.
pub fn run() -> Result<(), CliError> {
    match Command::parse() {
        Command::Render(args) => render::run(args),
        Command::Info(args) => info::run(args),
    }
}
