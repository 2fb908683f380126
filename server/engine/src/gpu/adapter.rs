//! Which adapter computes, and why that one.

use std::fmt;

use super::GpuError;

/// Storage buffers that one step may bind: trees, shading data and film of a path tracer. WebGPU promises 8, cards of the
/// last ten years have far more.
const STORAGE_BUFFERS_NEEDED: u32 = 25;

/// Which adapters may be taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AdapterChoice {
    /// Graphics cards only: a driver that computes on the CPU is slower than our own CPU code.
    #[default]
    Hardware,
    /// Graphics cards first, and software where there is none: for tests.
    Any,
}

/// What an adapter is, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AdapterKind {
    /// A graphics card with memory of its own.
    Discrete,
    /// A graphics unit that shares the CPU's memory.
    Integrated,
    /// A card lent to a virtual machine, or one that does not say what it is.
    Virtual,
    /// A driver that computes on the CPU.
    Software,
}

impl fmt::Display for AdapterKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            AdapterKind::Discrete => "discrete",
            AdapterKind::Integrated => "integrated",
            AdapterKind::Virtual => "virtual",
            AdapterKind::Software => "software",
        })
    }
}

/// Why an adapter was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdapterReason {
    /// It is the only one that may be taken.
    Only,
    /// Of several it is of the best kind, and the first of these.
    BestOf {
        /// How many may be taken.
        count: usize,
    },
    /// No hardware was found, and software is allowed.
    SoftwareAllowed,
}

impl fmt::Display for AdapterReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            AdapterReason::Only => f.write_str("the only adapter"),
            AdapterReason::BestOf { count } => write!(f, "the best of {count} adapters"),
            AdapterReason::SoftwareAllowed => f.write_str("no hardware found, and software is allowed"),
        }
    }
}

/// The adapter that computes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterReport {
    /// As its driver calls it.
    pub name: String,
    /// The driver with its version, as far as it says so.
    pub driver: String,
    /// `vulkan`, `metal` or `dx12`.
    pub api: String,
    /// What it is.
    pub kind: AdapterKind,
    /// Why it was taken.
    pub reason: AdapterReason,
}

/// An adapter before a device is opened.
pub(super) struct Chosen {
    pub(super) adapter: wgpu::Adapter,
    pub(super) report: AdapterReport,
}

/// The best adapter that may be taken and has what the shaders need.
pub(super) fn choose(choice: AdapterChoice) -> Result<Chosen, GpuError> {
    // Validation layers and debug names cost time and are for those who write drivers; `WGPU_*` switches them on.
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.flags = wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL;
    let instance = wgpu::Instance::new(descriptor.with_env());
    let found = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let kinds: Vec<AdapterKind> = found.iter().map(|adapter| kind_of(&adapter.get_info())).collect();
    let (index, reason) = best_of(&kinds, choice)?;
    let adapter = found.into_iter().nth(index).ok_or_else(|| none_of(&kinds))?;
    let info = adapter.get_info();
    check_limits(&info.name, &adapter.limits())?;
    let report = AdapterReport {
        driver: [info.driver.as_str(), &info.driver_info].join(" ").trim().to_string(),
        api: info.backend.to_str().to_string(),
        kind: kinds[index],
        reason,
        name: info.name,
    };
    Ok(Chosen { adapter, report })
}

fn kind_of(info: &wgpu::AdapterInfo) -> AdapterKind {
    match info.device_type {
        wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
        wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
        wgpu::DeviceType::VirtualGpu | wgpu::DeviceType::Other => AdapterKind::Virtual,
        wgpu::DeviceType::Cpu => AdapterKind::Software,
    }
}

/// The first of the best kind, by its place.
fn best_of(kinds: &[AdapterKind], choice: AdapterChoice) -> Result<(usize, AdapterReason), GpuError> {
    let allowed = |kind: AdapterKind| kind != AdapterKind::Software || choice == AdapterChoice::Any;
    let count = kinds.iter().filter(|kind| allowed(**kind)).count();
    let best = kinds.iter().enumerate().filter(|(_, kind)| allowed(**kind)).min_by_key(|(_, kind)| **kind);
    let (index, kind) = best.ok_or_else(|| none_of(kinds))?;
    let reason = match (kind, count) {
        (AdapterKind::Software, _) => AdapterReason::SoftwareAllowed,
        (_, 1) => AdapterReason::Only,
        _ => AdapterReason::BestOf { count },
    };
    Ok((index, reason))
}

fn none_of(kinds: &[AdapterKind]) -> GpuError {
    let reason = match kinds {
        [] => "the system names none".to_string(),
        _ => format!("{} found, all software", kinds.len()),
    };
    GpuError::NoAdapter { reason }
}

fn check_limits(adapter: &str, limits: &wgpu::Limits) -> Result<(), GpuError> {
    // A workgroup of 128, a tile that records are splatted onto, is what Vulkan promises and WebGPU even of old devices; bindings of 128 MiB
    // are its default.
    let needs = [
        (
            "storage buffers a shader",
            limits.max_storage_buffers_per_shader_stage.into(),
            STORAGE_BUFFERS_NEEDED.into(),
        ),
        ("groups of bindings", limits.max_bind_groups.into(), 4),
        ("bytes a storage buffer", limits.max_storage_buffer_binding_size, 128 << 20),
        ("invocations a workgroup", limits.max_compute_invocations_per_workgroup.into(), 128),
        ("workgroups a dispatch", limits.max_compute_workgroups_per_dimension.into(), 65_535),
    ];
    match needs.into_iter().find(|(_, found, needed)| found < needed) {
        None => Ok(()),
        Some((limit, found, needed)) => {
            Err(GpuError::Insufficient { adapter: adapter.to_string(), limit, found, needed })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{AdapterKind::*, *};

    /// Hardware before software whatever the order, software only where it may be.
    #[test]
    fn the_best_kind_is_taken_and_software_only_where_allowed() {
        let best = |kinds: &[AdapterKind], choice| best_of(kinds, choice);
        assert_eq!(
            best(&[Software, Integrated, Discrete], AdapterChoice::Hardware),
            Ok((2, AdapterReason::BestOf { count: 2 }))
        );
        assert_eq!(best(&[Software, Virtual], AdapterChoice::Hardware), Ok((1, AdapterReason::Only)));
        assert_eq!(best(&[Software], AdapterChoice::Any), Ok((0, AdapterReason::SoftwareAllowed)));
        assert_eq!(
            best(&[Discrete, Discrete], AdapterChoice::Any),
            Ok((0, AdapterReason::BestOf { count: 2 }))
        );
        for kinds in [&[][..], &[Software]] {
            let refused = best(kinds, AdapterChoice::Hardware).unwrap_err().to_string();
            assert!(refused.contains("take the CPU backend"), "{refused}");
        }
    }

    /// An adapter that has too little is refused by name.
    #[test]
    fn an_adapter_with_too_few_bindings_is_refused() {
        let refused = check_limits("old card", &wgpu::Limits::default()).unwrap_err();
        assert_eq!(
            refused.to_string(),
            "adapter \"old card\" has 8 storage buffers a shader, and 25 are needed; take the CPU backend"
        );
    }
}
