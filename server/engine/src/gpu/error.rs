//! What can go wrong on a graphics card.

/// Something the graphics card, its driver or a shader did not do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// No adapter that the choice allows.
    #[error(
        "no graphics adapter can be used: {reason}; install a driver for Vulkan, Metal or DirectX 12, or take the CPU backend"
    )]
    NoAdapter {
        /// Which were found and why none was taken.
        reason: String,
    },
    /// The adapter has less of something than the shaders need.
    #[error("adapter {adapter:?} has {found} {limit}, and {needed} are needed; take the CPU backend")]
    Insufficient {
        /// The adapter's name.
        adapter: String,
        /// What there is too little of.
        limit: &'static str,
        /// How much the adapter has.
        found: u64,
        /// How much the shaders need.
        needed: u64,
    },
    /// The adapter opened no device.
    #[error("adapter {adapter:?} opens no device: {what}")]
    NoDevice {
        /// The adapter's name.
        adapter: String,
        /// What the driver said.
        what: String,
    },
    /// The device is gone, and every buffer with it; [`crate::gpu::Gpu::session`] opens another.
    #[error("the graphics device was lost")]
    Lost,
    /// A buffer is larger than allowed, or than what is left.
    #[error(
        "buffer {name:?} needs {byte_count} bytes on the graphics card where {bytes_allowed} are allowed \
         ({limit}); take the CPU backend"
    )]
    OutOfMemory {
        /// The buffer's name.
        name: String,
        /// What it needs.
        byte_count: u64,
        /// What it may take.
        bytes_allowed: u64,
        /// What sets the limit.
        limit: &'static str,
    },
    /// Light that a picture asks for has no room beside the scene, which stays where it is.
    #[error("what is known of the light has no room beside the scene: {source}")]
    LightTooLarge {
        /// Which of it, and where the limit is.
        source: Box<GpuError>,
    },
    /// A shader that the device does not take.
    #[error("shader {step} does not compile: {what}")]
    Shader {
        /// The step's name.
        step: String,
        /// What the compiler said.
        what: String,
    },
    /// The device did not finish in time; it may hang.
    #[error("the graphics device did not finish {what} within {seconds_max} s")]
    TimedOut {
        /// What was waited for.
        what: String,
        /// How long.
        seconds_max: f64,
    },
    /// A command that the device refused. The session does not work any more; the next one does.
    #[error("the graphics device failed: {what}")]
    Failed {
        /// What it said.
        what: String,
    },
}
