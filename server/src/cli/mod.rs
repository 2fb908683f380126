//! The command line: what `lumicast` takes, and which file does it.
//!
//! Exit codes: 0 done, 1 it failed (one line on standard error says why), 2 the command line cannot be read.

mod edit;
mod serve;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

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
}

impl Arguments {
    /// Does what was asked.
    pub fn run(self) -> ExitCode {
        let done = match self.command {
            None => self.serve.run(),
            Some(Command::Serve(arguments)) => arguments.run(),
            Some(Command::Edit(arguments)) => arguments.run(),
        };
        match done {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("lumicast: {error}");
                ExitCode::FAILURE
            }
        }
    }
}
