//! `lumicast`: reads the arguments and leaves the rest to the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    match lumicast::cli::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}
