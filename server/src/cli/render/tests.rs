//! Laws of the command, on the built-in scene.

use super::*;
use crate::images::decode_exr;
use clap::Parser;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    args: RenderArgs,
}

/// The arguments of a command line into `folder`; `OUT` stands for a file there.
fn arguments(folder: &Path, line: &str) -> RenderArgs {
    let line = line.replace("OUT", folder.to_str().unwrap());
    let words = ["render", "builtin:cornell-box"].into_iter().chain(line.split_whitespace());
    Line::try_parse_from(words).unwrap_or_else(|error| panic!("{error}")).args
}

fn render(folder: &Path, line: &str) {
    run(arguments(folder, line)).unwrap_or_else(|error| panic!("{line}: {error}"));
}

fn read(folder: &Path, name: &str) -> Vec<u8> {
    std::fs::read(folder.join(name)).unwrap()
}

/// The same command gives the same bytes on any number of threads, layers and snapshots or not.
#[test]
fn bytes_do_not_depend_on_threads() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    render(folder, "--size 40x40 --samples 4 --layers --threads 1 --out OUT/one.exr");
    render(
        folder,
        "--size 40x40 --samples 4 --layers --threads 3 --out OUT/three.exr --snapshots OUT/snapshots",
    );
    assert_eq!(read(folder, "one.exr"), read(folder, "three.exr"));
    render(folder, "--size 40x40 --samples 4 --layers --seed 1 --out OUT/other.exr");
    assert_ne!(read(folder, "one.exr"), read(folder, "other.exr"));
}

/// The last snapshot is the picture, and the index has the contract's keys.
#[test]
fn the_last_snapshot_is_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    render(folder, "--size 20x20 --time 250ms --out OUT/a.exr --snapshots OUT/s");
    let index: serde_json::Value = serde_json::from_slice(&read(folder, "s/index.json")).unwrap();
    let entries = index.as_array().unwrap();
    let last = entries.last().unwrap();
    let keys: Vec<&String> = last.as_object().unwrap().keys().collect();
    assert_eq!(keys, ["error", "error_ci", "file", "seconds", "technique"]);
    assert!(last["seconds"].as_f64().unwrap() > 0.0);
    let last_file = read(folder, &format!("s/{}", last["file"].as_str().unwrap()));
    assert_eq!(decode_exr(&last_file).unwrap(), decode_exr(&read(folder, "a.exr")).unwrap());
}

/// Every key of the contract is in the statistics; those of parts that did not run are 0 and listed.
#[test]
fn statistics_have_every_key() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    render(folder, "--size 20x20 --samples 2 --threads 2 --out OUT/a.png --stats OUT/a.json");
    let stats: serde_json::Value = serde_json::from_slice(&read(folder, "a.json")).unwrap();
    for key in ["load", "bvh", "photons", "octree", "gather", "splat", "frame", "total"] {
        assert!(stats["seconds"][key].is_number(), "seconds.{key}");
    }
    for key in ["rays", "photons_stored", "voxels", "vdls", "records", "texels"] {
        assert!(stats["counts"][key].is_number(), "counts.{key}");
    }
    for key in ["bytes", "effects", "error", "error_ci", "backend", "adapter", "threads", "version"] {
        assert!(stats.get(key).is_some(), "{key}");
    }
    for name in stats["not_run"].as_array().unwrap() {
        let (group, key) = name.as_str().unwrap().split_once('.').unwrap();
        assert_eq!(stats[group][key].as_f64(), Some(0.0), "{group}.{key}");
    }
    assert_eq!((&stats["threads"], &stats["samples_per_pixel"]), (&2.into(), &2.into()));
    assert_eq!((&stats["technique"], stats["path_traced"].as_f64()), (&"path".into(), Some(1.0)));
    assert_eq!(
        (stats["counts"]["paths"].as_u64(), stats["stopped_by"].as_str()),
        (Some(800), Some("samples"))
    );
}

/// One scattering shows no more light than all of them, and none of it indirect.
#[test]
fn one_bounce_is_direct_light_only() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mean = |name: &str| {
        let (_, radiance) = decode_exr(&read(folder, name)).unwrap();
        radiance.iter().map(|colour| f64::from(colour.mean())).sum::<f64>() / radiance.len() as f64
    };
    render(folder, "--size 24x24 --samples 16 --out OUT/all.exr");
    render(folder, "--size 24x24 --samples 16 --bounces 1 --out OUT/one.exr");
    assert!(mean("one.exr") < 0.8 * mean("all.exr"), "{} {}", mean("one.exr"), mean("all.exr"));
}

/// An error bound is kept, and the picture says so.
#[test]
fn an_error_bound_is_reached() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    render(folder, "--size 16x16 --bounces 1 --error 20% --out OUT/a.jpg --stats OUT/a.json");
    let stats: serde_json::Value = serde_json::from_slice(&read(folder, "a.json")).unwrap();
    assert_eq!(stats["stopped_by"], "error");
    assert!(stats["error"].as_f64().unwrap() <= 0.2);
}

/// A command that cannot work is refused before any work, with exit code 2 and no file.
#[test]
fn impossible_commands_are_refused_first() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let cases = [
        ("--out OUT/a.tiff", ".exr, .png"),
        ("--out OUT/a.png --layers", "only EXR"),
        ("--out OUT/none/a.exr", "no folder"),
        ("--out OUT/a.exr --stats OUT/none/a.json", "no folder"),
        ("--out OUT/a.exr --camera roof", "main, corner"),
        ("--out OUT/a.exr --size 16384x16384 --samples 1", "memory"),
    ];
    for (line, expected) in cases {
        if expected == "memory" && available_bytes().is_none_or(|bytes| bytes > 60_000_000_000) {
            continue;
        }
        let error = run(arguments(folder, line)).unwrap_err();
        assert!(error.to_string().contains(expected), "{line}: {error}");
        assert_eq!(error.exit_code(), 2, "{line}");
    }
    assert_eq!(std::fs::read_dir(folder).unwrap().count(), 0);
}

/// Options that the technique has no use for are told, and only those.
#[test]
fn options_without_effect_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let idle = |line: &str| {
        let args = arguments(folder.path(), &format!("--out OUT/a.png {line}"));
        without_effect(&args).collect::<Vec<_>>()
    };
    let both = "--irradiance-accuracy 0.1 --keep-noise";
    assert_eq!(idle(&format!("--indirect path {both}")), ["--irradiance-accuracy", "--keep-noise"]);
    assert_eq!(idle(&format!("--indirect none {both}")), ["--irradiance-accuracy", "--keep-noise"]);
    assert_eq!(idle(&format!("--indirect octree {both}")), ["--irradiance-accuracy"]);
    // So many samples of the best chain are samples of paths.
    assert_eq!(idle(&format!("--samples 2 {both}")), ["--irradiance-accuracy", "--keep-noise"]);
    for none in ["--indirect path", both, &format!("--indirect irradiance {both}")] {
        assert!(idle(none).is_empty(), "{none}");
    }
}

/// 0 threads are one per core, as in the settings of `serve`.
#[test]
fn no_threads_are_one_per_core() {
    let folder = tempfile::tempdir().unwrap();
    render(folder.path(), "--size 8x8 --samples 1 --threads 0 --out OUT/a.png --stats OUT/a.json");
    let statistics: serde_json::Value = serde_json::from_slice(&read(folder.path(), "a.json")).unwrap();
    assert_eq!(statistics["threads"].as_u64().unwrap(), core_count() as u64);
    assert_eq!(
        (statistics["indirect"].as_str(), statistics["technique"].as_str()),
        (Some("auto"), Some("path"))
    );
}
