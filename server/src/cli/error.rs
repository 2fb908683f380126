//! Why a command ended without doing what was asked, and with which exit code.

use std::io;

use crate::{
    assets::AssetError,
    images::{EncodeError, FileError},
    report::ReportError,
};

/// A command's failure. Printed once, by `main`, as one line on standard error.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// The command line asks for something that does not exist or does not fit together.
    #[error("{0}")]
    Usage(String),
    /// A scene file that cannot be used.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// A picture that could not be encoded.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// A file that could not be written.
    #[error(transparent)]
    File(#[from] FileError),
    /// A report that could not be made.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The system refused something else.
    #[error("{doing}: {source}")]
    System {
        /// What was being done.
        doing: String,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// Ended by a signal.
    #[error("stopped by {name} after {done}: {left}")]
    Signal {
        /// Name of the signal.
        name: &'static str,
        /// Its number.
        number: u8,
        /// How far it got.
        done: String,
        /// What it leaves behind.
        left: String,
    },
}

impl CliError {
    /// 2 for a wrong command line, 128 + number for a signal (as shells have it), else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            CliError::Usage(_) => 2,
            CliError::Signal { number, .. } => 128 + number,
            _ => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Exit codes are the documented ones.
    #[test]
    fn exit_codes_tell_usage_failure_and_signals_apart() {
        let signal = |name, number| CliError::Signal { name, number, done: "".into(), left: "".into() };
        let system = CliError::System { doing: "x".into(), source: io::Error::other("y") };
        let codes = [CliError::Usage("".into()), system, signal("SIGINT", 2), signal("SIGTERM", 15)];
        assert_eq!(codes.map(|error| error.exit_code()), [2, 1, 130, 143]);
    }
}
