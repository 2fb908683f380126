//! What the bench is asked for.

use std::path::PathBuf;

use lumicast_engine::film::PictureSize;

/// Rounds, where options say nothing: an odd number, so that one of them is the median.
const ROUNDS: usize = 5;

/// The command line.
#[derive(Debug)]
pub(crate) struct Options {
    pub(crate) mode: Mode,
    pub(crate) is_software_allowed: bool,
    /// Of pictures; what suits the adapter where it is left out.
    pub(crate) size: Option<PictureSize>,
    pub(crate) rounds: usize,
}

/// What is to be done.
#[derive(Debug)]
pub(crate) enum Mode {
    /// All scenes where none is named.
    Measure { scenes: Vec<String> },
    /// Name the adapter.
    Adapter,
    /// Hold the first picture against the second.
    Compare { name: String, pictures: [PathBuf; 2] },
}

impl Options {
    pub(crate) fn read(arguments: impl Iterator<Item = String>) -> Result<Options, String> {
        let mut options =
            Options { mode: Mode::Adapter, is_software_allowed: false, size: None, rounds: ROUNDS };
        let mut words = Vec::new();
        let mut arguments = arguments;
        while let Some(argument) = arguments.next() {
            let mut value = || arguments.next().ok_or_else(|| format!("{argument}: a value is missing"));
            match argument.as_str() {
                "--software" => options.is_software_allowed = true,
                "--size" => options.size = Some(size(&value()?)?),
                "--rounds" => options.rounds = rounds(&value()?)?,
                // Cargo says so to every bench.
                "--bench" => {}
                _ if argument.starts_with("--") => return Err(format!("{argument}: no such option")),
                _ => words.push(argument),
            }
        }
        options.mode = mode(words)?;
        Ok(options)
    }
}

fn mode(words: Vec<String>) -> Result<Mode, String> {
    match words.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["adapter"] => Ok(Mode::Adapter),
        ["compare", name, ours, theirs] => {
            Ok(Mode::Compare { name: (*name).into(), pictures: [ours.into(), theirs.into()] })
        }
        ["adapter" | "compare", ..] => Err("write adapter, or compare NAME A.exr B.exr".into()),
        _ => Ok(Mode::Measure { scenes: words }),
    }
}

fn size(text: &str) -> Result<PictureSize, String> {
    let refused = || format!("--size {text}: write it as 1280x720");
    let (width, height) = text.split_once('x').ok_or_else(refused)?;
    let [width, height] = [width, height].map(|side| side.parse().map_err(|_| refused()));
    PictureSize::new(width?, height?).map_err(|error| format!("--size {text}: {error}"))
}

fn rounds(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|rounds| *rounds > 0).ok_or_else(|| format!("--rounds {text}: write 1, 2, 3 …"))
}
