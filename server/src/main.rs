//! `lumicast`: reads arguments and nothing else.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    lumicast::cli::Arguments::parse().run()
}
