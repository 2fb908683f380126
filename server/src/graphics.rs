//! Whether to look for a graphics card at all.

use std::path::Path;

/// Device files of graphics cards on Linux: of Mesa's drivers, NVIDIA's, AMD's compute driver, and Windows's in a Linux on it.
const DEVICE_FILES: [&str; 4] = ["/dev/dri", "/dev/nvidiactl", "/dev/kfd", "/dev/dxg"];

/// False where the system has no graphics card for sure. Asking a graphics driver takes tens of milliseconds, and on machines
/// without a screen Mesa complains about that on standard error: who did not ask for a card shall not read it.
pub(crate) fn may_have_card() -> bool {
    !cfg!(target_os = "linux") || DEVICE_FILES.iter().any(|file| Path::new(file).exists())
}
