//! What other renderers drew of the same scenes: files `series.json` with pictures by the clock.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::ReportError;

/// Largest file that is read, and most points that are taken from one.
const BYTES_MAX: u64 = 1 << 20;
const POINTS_MAX: usize = 1000;

/// Pictures of one scene by one renderer.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(super) struct Series {
    /// Name of the renderer.
    pub(super) peer: String,
    /// Name of the scene, as the report calls it.
    pub(super) scene: String,
    /// The pictures, in the order they came.
    pub(super) points: Vec<Point>,
}

/// One picture.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(super) struct Point {
    /// Seconds of drawing until then, without what came before the first sample.
    #[serde(rename = "t")]
    pub(super) seconds: f64,
    /// The picture, an EXR file; from the series' own folder where it is relative.
    pub(super) exr: PathBuf,
}

/// Reads a file of series: one, or a list.
pub(super) fn read(path: &Path) -> Result<Vec<Series>, ReportError> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum File {
        One(Series),
        Many(Vec<Series>),
    }
    let broken = |reason: String| ReportError::Peer { path: path.to_path_buf(), reason };
    let bytes = std::fs::metadata(path).map_err(|error| broken(error.to_string()))?.len();
    if bytes > BYTES_MAX {
        return Err(broken(format!("it has {bytes} bytes, more than {BYTES_MAX}")));
    }
    let text = std::fs::read(path).map_err(|error| broken(error.to_string()))?;
    let file: File = serde_json::from_slice(&text).map_err(|_| {
        broken(r#"it is not {"peer": NAME, "scene": NAME, "points": [{"t": SECONDS, "exr": FILE}]} or a list of such"#.into())
    })?;
    let mut all = match file {
        File::One(series) => vec![series],
        File::Many(all) => all,
    };
    let folder = path.parent().unwrap_or(Path::new("."));
    for series in &mut all {
        if series.points.len() > POINTS_MAX {
            return Err(broken(format!("{} has more than {POINTS_MAX} points", series.peer)));
        }
        for point in &mut series.points {
            if !(point.seconds > 0.0 && point.seconds.is_finite()) {
                return Err(broken(format!("{}: t must be above zero, not {}", series.peer, point.seconds)));
            }
            point.exr = folder.join(&point.exr);
            if !point.exr.is_file() {
                return Err(broken(format!("{}: there is no file {}", series.peer, point.exr.display())));
            }
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One series or several; what is none is refused by name.
    #[test]
    fn series_are_read_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("series.json");
        std::fs::write(folder.path().join("a.exr"), "").unwrap();
        let one = r#"{"peer": "other", "scene": "boxes", "setup_s": 1, "points": [{"t": 0.5, "cpu": 1, "exr": "a.exr"}]}"#;
        for text in [one.to_string(), format!("[{one}]")] {
            std::fs::write(&path, text).unwrap();
            let series = read(&path).unwrap();
            assert_eq!(series.len(), 1);
            assert_eq!(series[0].points[0].exr, folder.path().join("a.exr"));
        }
        for (text, part) in [
            ("{}", "points"),
            (r#"{"peer": "x", "scene": "y", "points": [{"t": 0, "exr": "a.exr"}]}"#, "above zero"),
            (r#"{"peer": "x", "scene": "y", "points": [{"t": 1, "exr": "b.exr"}]}"#, "b.exr"),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = read(&path).unwrap_err().to_string();
            assert!(message.contains(part) && message.contains("series.json"), "{message}");
        }
        assert!(read(&folder.path().join("none.json")).unwrap_err().to_string().contains("none.json"));
    }
}
