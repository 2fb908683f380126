//! The real viewer, in a window on a display without a screen, against the real server: what a person would see.
//!
//! Needs the server's binary (`LUMICAST_BIN`, or `lumicast` in the target folder of this test) and `Xvfb` with Mesa's
//! software OpenGL (Debian: xvfb libgl1-mesa-dri libxkbcommon-x11-0). Without them it prints SKIPPED;
//! `LUMICAST_DISPLAY_TESTS=required` makes that a failure.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// The window: square, as the Cornell box's camera was composed for.
const SIDE: u32 = 480;
/// Enough that noise averages out over a wall, little enough for a debug build on a busy machine.
const SAMPLES: &str = "4";

/// A program that ends with the test, passed or not.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn skip(reason: &str) {
    assert!(
        std::env::var("LUMICAST_DISPLAY_TESTS").as_deref() != Ok("required"),
        "LUMICAST_DISPLAY_TESTS=required, but {reason}"
    );
    println!("SKIPPED: {reason}");
}

fn server_binary() -> Option<PathBuf> {
    let named = std::env::var_os("LUMICAST_BIN").map(PathBuf::from);
    // target/debug/deps/xvfb-… → target/debug/lumicast
    let beside = || Some(std::env::current_exe().ok()?.parent()?.parent()?.join("lumicast"));
    named.or_else(beside).filter(|path| path.is_file())
}

/// A display of its own number, which Xvfb finds free.
fn display() -> Option<(Running, String)> {
    let mut xvfb = Command::new("Xvfb");
    xvfb.args(["-displayfd", "1", "-nolisten", "tcp", "-screen", "0", "1280x900x24"]);
    let mut child = xvfb.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().ok()?;
    let output = child.stdout.take();
    let running = Running(child);
    let mut number = String::new();
    BufReader::new(output?).read_line(&mut number).ok()?;
    let number = number.trim();
    (!number.is_empty()).then(|| (running, format!(":{number}")))
}

/// The server on a port of its own, and its address.
fn server(binary: &Path) -> (Running, String) {
    let mut command = Command::new(binary);
    command.args(["serve", "--listen", "127.0.0.1:0"]).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut child = command.spawn().expect("the server starts");
    let output = child.stdout.take().expect("its output is piped");
    let running = Running(child);
    let mut lines = BufReader::new(output).lines();
    let address = lines.by_ref().map_while(Result::ok).find_map(|line| {
        let start = line.find("http://")?;
        line[start..].split_whitespace().next().map(|url| url.trim_end_matches('/').to_owned())
    });
    // Read on, or the server would stop at a full pipe.
    std::thread::spawn(move || lines.for_each(drop));
    (running, address.expect("the server says where it listens"))
}

/// Mean colour of a part of the picture, given in fractions `[left, top, right, bottom]`.
fn mean(picture: &image::RgbImage, part: [f64; 4]) -> [f64; 3] {
    let (width, height) = (f64::from(picture.width()), f64::from(picture.height()));
    let [left, top, right, bottom] = [part[0] * width, part[1] * height, part[2] * width, part[3] * height];
    let mut sum = [0.0; 3];
    let mut count = 0.0;
    for y in top as u32..bottom as u32 {
        for x in left as u32..right as u32 {
            let pixel = picture.get_pixel(x, y);
            (0..3).for_each(|channel| sum[channel] += f64::from(pixel[channel]));
            count += 1.0;
        }
    }
    sum.map(|channel| channel / count)
}

#[test]
fn the_cornell_box_stands_in_the_window_with_red_left_and_green_right() {
    let Some(binary) = server_binary() else { return skip("there is no server binary (LUMICAST_BIN)") };
    let Some((_xvfb, display)) = display() else { return skip("Xvfb is not installed") };
    let (_server, address) = server(&binary);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("window.png");
    let mut viewer = Command::new(env!("CARGO_BIN_EXE_lumicast-viewer"));
    viewer
        .args([address.as_str(), "--picture-only", "--size", &format!("{SIDE}x{SIDE}")])
        .args(["--screenshot-after-samples", SAMPLES, "--screenshot"])
        .arg(&file)
        .env("DISPLAY", &display)
        .env_remove("WAYLAND_DISPLAY")
        .env("LIBGL_ALWAYS_SOFTWARE", "1")
        .stderr(Stdio::piped());
    let mut viewer = Running(viewer.spawn().expect("the viewer starts"));
    // It gives up by itself after two minutes.
    let status = viewer.0.wait().unwrap();
    let mut said = String::new();
    viewer.0.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(status.success(), "the viewer ended with {status}: {said}");

    let picture = image::open(&file).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), (SIDE, SIDE));
    // The walls cover the outer fifth of the picture on either side, at half height.
    let [red, green, _] = mean(&picture, [0.06, 0.35, 0.16, 0.6]);
    assert!(red > 2.0 * green && red > 20.0, "the left wall is {red:.0} red and {green:.0} green");
    let [red, green, _] = mean(&picture, [0.84, 0.35, 0.94, 0.6]);
    assert!(green > 1.5 * red && green > 15.0, "the right wall is {red:.0} red and {green:.0} green");
    // The lamp under the ceiling is by far the brightest thing.
    let lamp = mean(&picture, [0.45, 0.12, 0.55, 0.14]);
    assert!(lamp.iter().all(|channel| *channel > 200.0), "the lamp is {lamp:?}");
    let wall = mean(&picture, [0.4, 0.25, 0.6, 0.35]);
    assert!(wall.iter().all(|channel| (10.0..220.0).contains(channel)), "the back wall is {wall:?}");
}
