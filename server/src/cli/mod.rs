//! The command line: what `lumicast` takes, and which file does it.
//!
//! Exit codes: 0 done, 1 it failed (one line on standard error says why), 2 the command line cannot be read
//! or asks for what does not exist, 130 and 143 ended by SIGINT and SIGTERM while rendering a picture.

mod edit;
pub mod error;
pub mod info;
mod output;
pub mod render;
mod report;
pub mod scene_source;
mod serve;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

use error::CliError;
use scene_source::SceneSource;

/// Interactive global-illumination server.
///
/// Without a command it serves: `lumicast` alone shows a built-in Cornell box at http://127.0.0.1:7171.
#[derive(Debug, Parser)]
#[command(name = "lumicast", version, args_conflicts_with_subcommands = true)]
pub struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    serve: serve::ServeArgs,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serves scenes to viewers.
    Serve(serve::ServeArgs),
    /// Sends a batch of edits to a server.
    Edit(edit::EditArgs),
    Render(render::RenderArgs),
    Info(info::InfoArgs),
    Report(report::ReportArgs),
}

impl Arguments {
    /// Does what was asked.
    pub fn run(self) -> ExitCode {
        let done = match self.command {
            None => self.serve.run().map_err(|error| (error.to_string(), 1)),
            Some(Command::Serve(arguments)) => arguments.run().map_err(|error| (error.to_string(), 1)),
            Some(Command::Edit(arguments)) => arguments.run().map_err(|error| (error.to_string(), 1)),
            Some(Command::Render(arguments)) => render::run(arguments).map_err(with_code),
            Some(Command::Info(arguments)) => info::run(arguments).map_err(with_code),
            Some(Command::Report(arguments)) => report::run(arguments).map_err(with_code),
        };
        match done {
            Ok(()) => ExitCode::SUCCESS,
            Err((message, code)) => {
                eprintln!("lumicast: {message}");
                ExitCode::from(code)
            }
        }
    }
}

fn with_code(error: CliError) -> (String, u8) {
    (error.to_string(), error.exit_code())
}
