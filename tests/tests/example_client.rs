//! The Python example beside the protocol document, against the real server: what the document says is enough.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use lumicast_tests::Server;

/// A Python that has what the example needs: the one that `LUMICAST_TEST_PYTHON` names, else `python3`. `None`, with
/// a word, when there is none; `LUMICAST_PYTHON_TESTS=required` makes that a failure.
fn python() -> Option<PathBuf> {
    let named = std::env::var_os("LUMICAST_TEST_PYTHON").map(PathBuf::from);
    let python = named.unwrap_or_else(|| "python3".into());
    let imports = Command::new(&python).args(["-c", "import websockets.sync.client, PIL"]).output();
    if imports.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    let needed = format!("{}: no Python with `websockets` and `pillow`", python.display());
    let is_required = std::env::var("LUMICAST_PYTHON_TESTS").is_ok_and(|value| value == "required");
    assert!(!is_required, "{needed}");
    println!("SKIPPED {needed} (tests/run makes one)");
    None
}

fn run_example(python: &Path, server: &Server, options: &[&str]) -> Output {
    Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../protocol/example_client.py"))
        .arg(server.url())
        .args(options)
        .output()
        .expect("Python runs")
}

/// Standard output of a run that succeeds.
fn said(output: &Output) -> String {
    let (out, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{}\n{out}\n{errors}", output.status);
    out.into_owned()
}

/// Mean red, green, blue of the columns of this part of the width.
fn mean_colour(picture: &image::RgbImage, columns: std::ops::Range<u32>) -> [f64; 3] {
    let mut sums = [0.0; 3];
    for (x, _, pixel) in picture.enumerate_pixels() {
        if columns.contains(&x) {
            for (sum, value) in sums.iter_mut().zip(pixel.0) {
                *sum += f64::from(value);
            }
        }
    }
    sums.map(|sum| sum / f64::from(columns.len() as u32 * picture.height()))
}

#[test]
fn the_example_client_gets_pictures_and_saves_the_last() {
    let Some(python) = python() else { return };
    let server = Server::start::<&str>(&[]);
    let folder = tempfile::tempdir().unwrap();
    for codec in ["auto", "float"] {
        let file = folder.path().join(format!("{codec}.png"));
        let options = [
            "--size",
            "96x96",
            "--frames",
            "6",
            "--codec",
            codec,
            "--camera",
            "main",
            "--out",
            file.to_str().unwrap(),
        ];
        let out = said(&run_example(&python, &server, &options));
        assert!(out.contains("connected to scene cornell-box at revision 1"), "{out}");
        assert!(out.lines().filter(|line| line.starts_with("frame ")).count() >= 1, "{out}");
        let picture = image::open(&file).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (96, 96));
        // The box has a red wall on the left and a green one on the right; they fill the outer sixths.
        let ([red, green, _], [red_right, green_right, _]) =
            (mean_colour(&picture, 2..16), mean_colour(&picture, 80..94));
        assert!(red > 1.3 * green, "{codec}: the left is not red: red {red}, green {green}");
        assert!(green_right > 1.1 * red_right, "{codec}: the right is not green: {red_right}, {green_right}");
    }
}

#[test]
fn the_example_client_edits_and_stays_until_a_picture_shows_it() {
    let Some(python) = python() else { return };
    let server = Server::start::<&str>(&[]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("brighter.json");
    std::fs::write(&file, r#"[{"op": "set_material", "material": "lamp", "emission": [30, 30, 30]}]"#)
        .unwrap();
    let options = ["--size", "64x64", "--frames", "2", "--edit", file.to_str().unwrap()];
    let out = said(&run_example(&python, &server, &options));
    assert!(out.contains("edit made revision 2"), "{out}");
    assert!(out.lines().any(|line| line.starts_with("frame ") && line.contains(" revision 2 ")), "{out}");
    assert_eq!(server.get("/v1/scenes/cornell-box").json()["revision"], 2);
}

#[test]
fn the_example_client_says_what_is_wrong_and_fails() {
    let Some(python) = python() else { return };
    let server = Server::start::<&str>(&[]);
    let cases: [(&[&str], &str); 3] = [
        (&["--scene", "no-such-scene"], "there is no scene \"no-such-scene\""),
        (&["--camera", "no-such-camera"], "no-such-camera"),
        (&["--size", "64x0"], "size"),
    ];
    for (options, reason) in cases {
        let output = run_example(&python, &server, &[options, &["--frames", "1"]].concat());
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{options:?} succeeded");
        assert!(errors.contains(reason) && !errors.contains("Traceback"), "{options:?}: {errors}");
    }
}
