//! The Python example reads the header that the Rust types write. Its conversation with a real server is tested where
//! the server is.

#![allow(clippy::unwrap_used, reason = "the helpers of a test may fail loudly")]

use lumicast_protocol::{FrameHeader, PayloadCodec, PayloadKind};
use std::process::Command;

/// Runs a program of Python lines beside the example; `None`, and a line that says so, where there is no Python.
fn python(program: &str) -> Option<(bool, String)> {
    let run = Command::new("python3")
        // -B: no `__pycache__` beside the sources.
        .args(["-B", "-c", program])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output();
    match run {
        Ok(output) => {
            let text = [output.stdout, output.stderr].concat();
            Some((output.status.success(), String::from_utf8_lossy(&text).into_owned()))
        }
        Err(error) => {
            println!("SKIPPED: python3 cannot be run: {error}");
            None
        }
    }
}

/// `message` as a Python literal.
fn literal(message: &[u8]) -> String {
    let hex: String = message.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("bytes.fromhex('{hex}')")
}

fn message() -> Vec<u8> {
    FrameHeader {
        kind: PayloadKind::Tile,
        codec: PayloadCodec::Png,
        converged: true,
        first_from_stamp: false,
        revision: 1 << 40,
        frame: 8,
        camera_stamp: 7,
        size: [3, 4],
        full_size: [640, 360],
        offset: [5, 6],
        error: Some(0.25),
        samples: 9,
        age_us: 1000,
    }
    .message(b"png")
    .unwrap()
}

#[test]
fn the_example_reads_every_field_of_the_header() {
    let program = format!(
        "from example_client import *\nheader, payload = split_frame({})\nprint(tuple(header), payload)",
        literal(&message())
    );
    let expected =
        "(b'LCF1', 2, 1, 2, 1, 1099511627776, 8, 7, 3, 4, 640, 360, 5, 6, 0.25, 9, 3, 1000, 0) b'png'";
    if let Some(answer) = python(&program) {
        assert_eq!(answer, (true, format!("{expected}\n")));
    }
}

#[test]
fn the_example_refuses_what_is_no_frame() {
    let good = message();
    let cut = &good[..good.len() - 1];
    let mut other_magic = good.clone();
    other_magic[3] = b'2';
    for bad in [&good[..63], cut, &other_magic] {
        let program = format!("from example_client import *\nsplit_frame({})", literal(bad));
        if let Some((accepted, text)) = python(&program) {
            assert!(!accepted && text.contains("Refused"), "{text}");
        }
    }
}
