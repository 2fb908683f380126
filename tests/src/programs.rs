//! Where things lie on this machine: the shared scenes and the programs under test.

use std::path::{Path, PathBuf};

/// The folder of shared scenes and references, when it stands beside the project (or where `LUMICAST_SHARED` says).
pub fn shared_folder() -> Option<PathBuf> {
    if let Some(folder) = std::env::var_os("LUMICAST_SHARED") {
        return Some(PathBuf::from(folder)).filter(|folder| folder.join("scenes").is_dir());
    }
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .map(|ancestor| ancestor.join("shared"))
        .find(|folder| folder.join("scenes").is_dir())
}

/// The built program `lumicast` or `lumicast-viewer`: where `LUMICAST_BIN` or `LUMICAST_VIEWER_BIN` says, else beside
/// the test that is running (`target/debug` or `target/release`).
///
/// # Panics
/// When it has not been built: a skip would let a whole suite pass without having looked at anything.
pub fn program(name: &str) -> PathBuf {
    let variable = format!("{}_BIN", name.to_uppercase().replace('-', "_"));
    if let Some(path) = std::env::var_os(&variable) {
        return PathBuf::from(path);
    }
    let this = std::env::current_exe().expect("the path of the running test");
    let folder = this.ancestors().nth(2).expect("tests run from target/PROFILE/deps");
    let path = folder.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    let release = if folder.ends_with("release") { " --release" } else { "" };
    assert!(
        path.is_file(),
        "{} is missing: run `cargo build{release} -p {name} --bins` first (or say where it is with {variable})",
        path.display()
    );
    path
}
