//! The shared scenes with independent ground truth, where a checkout has them beside it.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use crate::assets::{AssetLimits, load_scene};

/// Scene, its cameras in order, triangles: from the README beside the files.
const SCENES: [(&str, &[&str], u64); 12] = [
    ("cornell-box", &["main", "corner"], 32),
    ("cornell-glass", &["main", "corner"], 10_252),
    ("cornell-glossy", &["main", "corner"], 5_152),
    ("cornell-bumpy-8k", &["main", "corner"], 7_968),
    ("cornell-bumpy-13k", &["main", "corner"], 12_830),
    ("two-rooms", &["roomB", "roomA"], 1_378),
    ("sponza", &["nave", "gallery", "arcade"], 66_453),
    ("sponza-flat", &["nave"], 66_453),
    ("sibenik", &["nave", "aisle"], 75_279),
    ("bunny-room", &["main", "close"], 69_463),
    ("dragon-room", &["main", "close"], 100_012),
    ("modern-hall", &["main"], 28_655),
];

/// `$LUMICAST_SHARED/scenes`, or `shared/scenes` beside any folder above this crate.
pub(super) fn scenes_folder() -> Option<PathBuf> {
    let named = std::env::var_os("LUMICAST_SHARED").map(|shared| PathBuf::from(shared).join("scenes"));
    let above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().map(|folder| folder.join("shared/scenes"));
    named.into_iter().chain(above).find(|folder| folder.is_dir())
}

/// Every shared scene loads without a warning, with all its triangles and with its cameras by their names.
#[test]
fn shared_scenes_load_whole_and_without_warnings() {
    let Some(folder) = scenes_folder() else {
        println!("SKIPPED: no shared/scenes above this crate and no LUMICAST_SHARED");
        return;
    };
    for (name, cameras, triangle_count) in SCENES {
        let start = Instant::now();
        let scene = load_scene(&folder.join(format!("{name}.glb")), &AssetLimits::default()).expect(name);
        let elapsed = start.elapsed();
        println!("{name}: {triangle_count} triangles in {elapsed:?}");
        assert!(scene.warnings().is_empty(), "{name}: {:?}", scene.warnings());
        assert_eq!(scene.instanced_triangle_count(), triangle_count, "{name}");
        assert_eq!(scene.cameras().keys().map(|id| id.as_str()).collect::<Vec<_>>(), cameras, "{name}");
        assert!(
            scene.materials().values().any(|m| m.is_emissive()) || !scene.lights().is_empty(),
            "{name} is dark"
        );
    }
}
