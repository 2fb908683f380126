//! The binary as users meet it: exit codes, what it prints where, and what a signal leaves behind.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::{
    io::{BufRead, BufReader, Read},
    path::Path,
    process::{Command, Output, Stdio},
    time::{Duration, Instant},
};

use lumicast::images::decode_exr;

fn lumicast(folder: &Path, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lumicast"));
    command.current_dir(folder).args(line.split_whitespace());
    command
}

fn run(folder: &Path, line: &str) -> (Option<i32>, String, String) {
    let Output { status, stdout, stderr } = lumicast(folder, line).output().unwrap();
    (status.code(), String::from_utf8(stdout).unwrap(), String::from_utf8(stderr).unwrap())
}

fn names_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

/// Facts go to standard output, as JSON when asked for; the exit code is 0.
#[test]
fn a_picture_is_rendered_and_described() {
    let folder = tempfile::tempdir().unwrap();
    let (code, stdout, _) =
        run(folder.path(), "render builtin:cornell-box --size 16x16 --samples 2 --out a.exr --json");
    assert_eq!(code, Some(0));
    let facts: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(facts["samples_per_pixel"], 2);
    assert_eq!(names_in(folder.path()), ["a.exr"]);
    let (code, stdout, _) = run(folder.path(), "info builtin:cornell-box --json");
    assert_eq!(code, Some(0));
    let facts: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(facts["cameras"][1]["name"], "corner");
}

/// What a file asks for and does not get is said beside its picture, not only by `info`.
#[test]
fn what_is_not_drawn_as_the_file_has_it_is_said() {
    let folder = tempfile::tempdir().unwrap();
    // A triangle of nine floats: (0, 0, 0), (1, 0, 0), (0, 1, 0).
    let corners = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
    let frosted = serde_json::json!({
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_transmission"],
        "buffers": [{"byteLength": 36, "uri": format!("data:application/octet-stream;base64,{corners}")}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
        "materials": [{
            "name": "frosted",
            "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.4},
            "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}}
        }],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0
    });
    std::fs::write(folder.path().join("pane.gltf"), frosted.to_string()).unwrap();
    let (code, _, stderr) = run(folder.path(), "render pane.gltf --size 16x16 --samples 1 --out a.png");
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        stderr.contains("warning: material \"frosted\": lets light through with roughness 0.4"),
        "{stderr}"
    );
    let (code, _, stderr) =
        run(folder.path(), "render builtin:cornell-box --size 16x16 --samples 1 --out a.png");
    assert_eq!((code, stderr.contains("warning")), (Some(0), false), "{stderr}");
}

/// A picture of a single sample of learnt light says how far off it is (in truth by 0.52), and the same on one thread and on two.
#[test]
fn single_samples_of_learnt_light_are_measured() {
    let folder = tempfile::tempdir().unwrap();
    let errors = [1, 2].map(|threads| {
        let line = format!(
            "render builtin:cornell-box --indirect octree --size 32x32 --samples 1 --threads {threads} --out a.exr --json"
        );
        let (code, stdout, stderr) = run(folder.path(), &line);
        assert_eq!(code, Some(0), "{stderr}");
        let facts: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        assert_eq!(facts["samples_per_pixel"], 1);
        let [low, high] = [0, 1].map(|end| facts["error_ci"][end].as_f64().unwrap());
        let error = facts["error"].as_f64().unwrap();
        assert!(low <= error && error <= high && (0.3..0.8).contains(&error), "{low} {error} {high}");
        error
    });
    assert_eq!(errors[0], errors[1]);
}

/// The octree's picture of so many samples is the same to the last byte on one thread and on two, has exactly those
/// samples, and says what it was made of.
#[test]
fn learnt_pictures_depend_on_no_clock_and_no_threads() {
    let folder = tempfile::tempdir().unwrap();
    let picture = |technique: &str, threads: u32| {
        let line = format!(
            "render builtin:cornell-box --indirect {technique} --size 32x32 --samples 2 --threads {threads} --out {threads}.exr --json"
        );
        let (code, stdout, stderr) = run(folder.path(), &line);
        assert_eq!(code, Some(0), "{stderr}");
        let facts: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        assert_eq!((&facts["samples_per_pixel"], &facts["technique"]), (&2.into(), &technique.into()));
        assert_eq!(facts["path_traced"], 0.0);
        assert!(facts["counts"]["voxels"].as_u64().unwrap() > 1000, "{facts}");
        assert_eq!(facts["counts"]["records"].as_u64().unwrap() > 0, technique == "irradiance");
        std::fs::read(folder.path().join(format!("{threads}.exr"))).unwrap()
    };
    for technique in ["octree", "irradiance"] {
        assert_eq!(picture(technique, 1), picture(technique, 2), "{technique}");
    }
}

/// An error that is asked for is reached by every technique that can, on one thread and two with the same bytes, snapshots or
/// not; one that cannot reach it stops and says so.
#[test]
fn an_error_is_reached_or_said_to_be_out_of_reach() {
    let folder = tempfile::tempdir().unwrap();
    let picture = |technique: &str, error: &str, more: &str| {
        let line = format!(
            "render builtin:boxes --indirect {technique} --size 48x27 --error {error} {more} --out a.exr --json"
        );
        let (code, stdout, stderr) = run(folder.path(), &line);
        assert_eq!(code, Some(0), "{stderr}");
        let facts: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        (facts, stderr, std::fs::read(folder.path().join("a.exr")).unwrap())
    };
    for technique in ["auto", "octree", "irradiance"] {
        let (facts, _, one) = picture(technique, "10%", "--threads 1");
        assert_eq!(facts["stopped_by"], "error", "{facts}");
        assert!(facts["error"].as_f64().unwrap() <= 0.1 && facts["error_ci"][1].as_f64().unwrap() <= 0.11);
        let (_, _, two) = picture(technique, "10%", "--threads 2 --snapshots shots");
        assert!(one == two, "{technique}: bytes differ");
    }
    let (facts, stderr, _) = picture("octree", "0.1%", "");
    assert_eq!(facts["stopped_by"], "best", "{facts}");
    assert!(facts["error"].as_f64().unwrap() > 0.001 && stderr.contains("auto"), "{stderr}");
}

/// A scene without light is black and done, by every technique.
#[test]
fn a_black_picture_has_no_error() {
    let folder = tempfile::tempdir().unwrap();
    let dark = "o floor\nv -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nf 1 4 3 2\n";
    std::fs::write(folder.path().join("dark.obj"), dark).unwrap();
    for technique in ["auto", "octree", "irradiance", "path"] {
        let line = format!("render dark.obj --indirect {technique} --size 8x8 --error 2% --out a.exr --json");
        let (code, stdout, stderr) = run(folder.path(), &line);
        assert_eq!(code, Some(0), "{technique}: {stderr}");
        let facts: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        assert_eq!((&facts["error"], &facts["stopped_by"]), (&0.0.into(), &"error".into()), "{technique}");
    }
}

/// Wrong usage exits with 2, a file that cannot be read with 1; both say what was wrong and print no facts.
#[test]
fn exit_codes_tell_what_kind_of_failure_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        ("render builtin:cornell-box --out a.exr --indirect lightmap", 2, "does not exist yet"),
        ("render builtin:cornell-box --out a.exr --backend tpu", 2, "auto, cpu or gpu"),
        ("render builtin:cornell-box --out a.exr --size 0x5", 2, "0×5"),
        ("render builtin:cornell-box --out a.exr --camera roof", 2, "main, corner"),
        ("render builtin:cornell-box", 2, "--out"),
        ("render none.glb --out a.exr", 1, "none.glb"),
        ("info none.glb", 1, "none.glb"),
        ("info builtin:none", 2, "builtin:cornell-box"),
    ];
    for (line, expected_code, expected) in cases {
        let (code, stdout, stderr) = run(folder.path(), line);
        assert_eq!(code, Some(expected_code), "{line}: {stderr}");
        assert!(stderr.contains(expected), "{line}: {stderr}");
        assert_eq!(stdout, "", "{line}");
    }
    assert!(names_in(folder.path()).is_empty());
}

/// Ends with the test, however that ends.
#[cfg(unix)]
struct Running(std::process::Child);

#[cfg(unix)]
impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A rendering that was sent a signal once `is_due`: its exit code, what it wrote on standard output, and what it said.
#[cfg(unix)]
fn interrupted(
    folder: &Path,
    line: &str,
    signal: &str,
    is_due: impl Fn() -> bool,
) -> (Option<i32>, String, String) {
    let child = lumicast(folder, line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut running = Running(child);
    let mut lines = BufReader::new(running.0.stderr.take().unwrap()).lines();
    // This line comes once signals are watched. Without it nothing would end the child.
    let first = lines.next().unwrap().unwrap();
    assert!(first.starts_with("rendering"), "{first}");
    let begun = Instant::now();
    while !is_due() {
        assert_eq!(running.0.try_wait().unwrap(), None);
        assert!(begun.elapsed() < Duration::from_secs(120), "it never came to that");
        std::thread::sleep(Duration::from_millis(5));
    }
    let kill = Command::new("kill").args([&format!("-{signal}"), &running.0.id().to_string()]).status();
    assert!(kill.unwrap().success());
    let said: Vec<String> = lines.map(Result::unwrap).collect();
    let mut stdout = String::new();
    running.0.stdout.take().unwrap().read_to_string(&mut stdout).unwrap();
    (running.0.wait().unwrap().code(), stdout, said.join("\n"))
}

/// A signal ends the rendering. Before there is a whole picture: no file, not even half, a sentence that says so, and the shell's exit
/// code.
#[cfg(unix)]
#[test]
fn a_signal_leaves_no_half_file() {
    for (signal, expected_code) in [("INT", 130), ("TERM", 143)] {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.exr"), "old").unwrap();
        // Large enough for the signal to come before its first pass is over.
        let line = "render builtin:cornell-box --size 1500x1500 --indirect path --time 1h --out a.exr";
        let (code, stdout, said) = interrupted(folder.path(), line, signal, || true);
        assert_eq!((code, stdout.as_str()), (Some(expected_code), ""));
        assert!(said.contains(&format!("SIG{signal}")) && said.contains("a.exr was not written"), "{said}");
        assert_eq!(names_in(folder.path()), ["a.exr"]);
        assert_eq!(std::fs::read(folder.path().join("a.exr")).unwrap(), b"old");
    }
}

/// A picture that is stopped by a signal is written as it is by then, with its facts.
#[cfg(unix)]
#[test]
fn a_signal_keeps_what_there_is() {
    for (signal, expected_code) in [("INT", 130), ("TERM", 143)] {
        let folder = tempfile::tempdir().unwrap();
        let line = "render builtin:cornell-box --size 64x64 --time 1h --snapshots shots --out a.exr --json";
        let shots = folder.path().join("shots");
        // A first snapshot is a whole picture.
        let is_due = || shots.is_dir() && names_in(&shots).iter().any(|name| name.ends_with(".exr"));
        let (code, stdout, said) = interrupted(folder.path(), line, signal, is_due);
        assert_eq!(code, Some(expected_code), "{said}");
        let expected =
            [&format!("SIG{signal}"), "a.exr is the picture as it was by then", "snapshots are in"];
        assert!(expected.iter().all(|expected| said.contains(*expected)), "{said}");
        let facts: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        assert_eq!(facts["stopped_by"], "signal");
        let (size, radiance) = decode_exr(&std::fs::read(folder.path().join("a.exr")).unwrap()).unwrap();
        assert_eq!([size.width(), size.height()], [64, 64]);
        assert!(radiance.iter().filter(|radiance| radiance.luminance() > 0.0).count() > 3000);
    }
}
