//! Devices: opened, watched, lost and opened again.

use std::{
    collections::HashMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use super::{
    AdapterChoice, AdapterReport, GpuError,
    adapter::{self, Chosen},
    buffer::{Budget, Layout, LayoutKey},
    pipeline::{Pipeline, PipelineKey},
    staging::Spare,
};

/// Bytes that buffers of a session may hold in all, where options say nothing else. No interface tells how much memory
/// there is; 2 GiB lie within what graphics cards of the last ten years have, and a driver asked for more than it has
/// may stop the whole desktop before it says so.
const BYTES_MAX: u64 = 2 << 30;
const SHADOW_MAP_BYTES_MAX: u64 = 64 << 20;

/// Seconds to wait for one submission, where options say nothing else: systems reset a card that is silent for two to ten
/// seconds, and software drivers take longer for a pass than a card, so that a minute means it hangs.
const SECONDS_MAX: f64 = 60.0;
/// How long the news of a device that is gone may be under way in another thread.
const NEWS_TAKE_AT_MOST: Duration = Duration::from_millis(100);

/// What a [`Gpu`] may take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GpuOptions {
    /// Which adapters may be taken.
    pub adapter: AdapterChoice,
    /// Bytes that the buffers of a session may hold together.
    pub bytes_max: u64,
    /// Bytes that maps of shadows of a scene may hold, of those; 0: none are drawn.
    pub shadow_map_bytes_max: u64,
    /// Seconds to wait for one submission before it counts as hanging.
    pub seconds_max: f64,
}

impl Default for GpuOptions {
    fn default() -> GpuOptions {
        GpuOptions {
            adapter: AdapterChoice::default(),
            bytes_max: BYTES_MAX,
            shadow_map_bytes_max: SHADOW_MAP_BYTES_MAX,
            seconds_max: SECONDS_MAX,
        }
    }
}

/// The graphics card, whatever happens to its devices. Shared by [`Arc`] between threads.
#[derive(Debug)]
pub struct Gpu {
    options: GpuOptions,
    current: Mutex<Arc<Session>>,
}

impl Gpu {
    /// Opens the best adapter that may be taken, with the default bounds.
    ///
    /// Errors: [`GpuError::NoAdapter`], [`GpuError::Insufficient`], [`GpuError::NoDevice`].
    pub fn open(choice: AdapterChoice) -> Result<Gpu, GpuError> {
        Gpu::open_with(&GpuOptions { adapter: choice, ..GpuOptions::default() })
    }

    /// [`Gpu::open`] with bounds of one's own.
    pub fn open_with(options: &GpuOptions) -> Result<Gpu, GpuError> {
        let first = Session::open(options, 0)?;
        Ok(Gpu { options: *options, current: Mutex::new(Arc::new(first)) })
    }

    /// The device that works: the one there is, or a new one where that was lost or failed.
    ///
    /// Errors: as [`Gpu::open`], when another has to be opened.
    pub fn session(&self) -> Result<Arc<Session>, GpuError> {
        let mut current = locked(&self.current);
        if current.check().is_err() {
            *current = Arc::new(Session::open(&self.options, current.generation + 1)?);
        }
        Ok(Arc::clone(&current))
    }

    /// The adapter that computes.
    pub fn report(&self) -> AdapterReport {
        locked(&self.current).report.clone()
    }

    /// What it may take.
    pub fn options(&self) -> GpuOptions {
        self.options
    }
}

/// What became of a device; written by wgpu's callbacks on any thread.
#[derive(Debug, Default)]
pub(super) struct Fate {
    is_lost: AtomicBool,
    /// The first error that nobody asked for.
    failure: Mutex<Option<String>>,
}

/// One device with its queue, its compiled pipelines and the bytes it holds.
#[derive(Debug)]
pub struct Session {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(crate) limits: wgpu::Limits,
    pub(super) budget: Arc<Budget>,
    pub(super) spare: Mutex<Spare>,
    pub(super) layouts: Mutex<HashMap<LayoutKey, Arc<Layout>>>,
    pub(super) pipelines: Mutex<HashMap<PipelineKey, Arc<Pipeline>>>,
    pub(super) shader_nanoseconds: AtomicU64,
    /// Nanoseconds a tick of the device's clock; `None` where it has no clock.
    pub(super) nanoseconds_per_tick: Option<f32>,
    pub(super) wait_max: Duration,
    fate: Arc<Fate>,
    generation: u64,
    report: AdapterReport,
}

impl Session {
    fn open(options: &GpuOptions, generation: u64) -> Result<Session, GpuError> {
        let Chosen { adapter, report } = adapter::choose(options.adapter)?;
        // What some adapters have, and nothing needs that all are to run.
        let wanted = wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::FLOAT32_BLENDABLE;
        let features = adapter.features() & wanted;
        let has_clock = features.contains(wgpu::Features::TIMESTAMP_QUERY);
        let limits = adapter.limits();
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("lumicast"),
            required_features: features,
            // All that the adapter has: WebGPU's defaults end at 8 storage buffers of 128 MiB.
            required_limits: limits.clone(),
            experimental_features: wgpu::ExperimentalFeatures::disabled(),
            memory_hints: wgpu::MemoryHints::Performance,
            trace: wgpu::Trace::Off,
        };
        let opened = pollster::block_on(adapter.request_device(&descriptor));
        let (device, queue) = opened
            .map_err(|error| GpuError::NoDevice { adapter: report.name.clone(), what: error.to_string() })?;
        let fate = Arc::new(Fate::default());
        let of_loss = Arc::clone(&fate);
        device.set_device_lost_callback(move |_, _| of_loss.is_lost.store(true, Ordering::Release));
        let of_errors = Arc::clone(&fate);
        device.on_uncaptured_error(Arc::new(move |error| of_errors.record(error.to_string())));
        Ok(Session {
            nanoseconds_per_tick: has_clock.then(|| queue.get_timestamp_period()),
            device,
            queue,
            limits,
            budget: Arc::new(Budget::new(options.bytes_max)),
            spare: Mutex::default(),
            layouts: Mutex::default(),
            pipelines: Mutex::default(),
            shader_nanoseconds: AtomicU64::new(0),
            wait_max: Duration::try_from_secs_f64(options.seconds_max).unwrap_or(Duration::MAX),
            fate,
            generation,
            report,
        })
    }

    /// Counts the devices that this [`Gpu`] opened, from 0. Buffers of another generation are gone.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// The adapter that this device is of.
    pub fn report(&self) -> &AdapterReport {
        &self.report
    }

    /// Seconds that compiling shaders took so far, as far as the driver compiles when asked to and not at first use.
    pub fn shader_seconds(&self) -> f64 {
        self.shader_nanoseconds.load(Ordering::Relaxed) as f64 * 1e-9
    }

    /// Bytes that buffers hold now, beside memory that is kept for later reads: that makes way for any of them.
    pub fn bytes_held(&self) -> u64 {
        let spare = locked(&self.spare);
        self.budget.held().saturating_sub(spare.bytes())
    }

    /// Whether the device still works.
    ///
    /// Errors: [`GpuError::Lost`], [`GpuError::Failed`]; both stay.
    pub fn check(&self) -> Result<(), GpuError> {
        if self.fate.is_lost.load(Ordering::Acquire) {
            return Err(GpuError::Lost);
        }
        let Some(what) = locked(&self.fate.failure).clone() else { return Ok(()) };
        Err(self.loss_or(GpuError::Failed { what }))
    }

    /// Throws the device away as a driver would, for tests of what happens then.
    pub fn lose_for_test(&self) {
        self.device.destroy();
        // The news of it arrive with a look at the device when it has no work left.
        let _ = self.poll(wgpu::PollType::Wait { submission_index: None, timeout: Some(self.wait_max) });
    }

    /// Runs `work` and returns the first error that the device reports of it.
    ///
    /// A device that is lost meanwhile reports nothing, so that is asked afterwards.
    pub(super) fn checked<T>(
        &self,
        work: impl FnOnce() -> T,
        error_of: impl FnOnce(wgpu::Error) -> GpuError,
    ) -> Result<T, GpuError> {
        self.check()?;
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let done = work();
        // Scopes end in reverse order, and each has to.
        let errors = [
            pollster::block_on(memory.pop()),
            pollster::block_on(internal.pop()),
            pollster::block_on(validation.pop()),
        ];
        self.check()?;
        match errors.into_iter().flatten().next() {
            None => Ok(done),
            Some(error) => {
                // The news of a device that is gone come when it has no work left; what refuses is looked at once, and can wait.
                let _ =
                    self.poll(wgpu::PollType::Wait { submission_index: None, timeout: Some(self.wait_max) });
                // Another thread that looks at the device may have them, and be about to tell.
                let asked = Instant::now();
                let mut error = self.loss_or(error_of(error));
                let is_open =
                    |error: &GpuError| !matches!(error, GpuError::Lost | GpuError::OutOfMemory { .. });
                while is_open(&error) && asked.elapsed() < NEWS_TAKE_AT_MOST {
                    std::thread::yield_now();
                    error = self.loss_or(error);
                }
                Err(error)
            }
        }
    }

    /// What an error is of: commands to a device that is gone are refused for other reasons before the news of it are here.
    pub(super) fn loss_or(&self, error: GpuError) -> GpuError {
        let _ = self.poll(wgpu::PollType::Poll);
        if self.fate.is_lost.load(Ordering::Acquire) { GpuError::Lost } else { error }
    }

    /// Looks at the device; `Ok(false)` when the time was up.
    pub(super) fn poll(&self, poll: wgpu::PollType) -> Result<bool, GpuError> {
        // wgpu panics where a device is lost while it is waited for, and has no other way to say so: this is the one place
        // where a panic is caught, and it becomes the error that it should have been.
        let polled = catch_unwind(AssertUnwindSafe(|| self.device.poll(poll)));
        match polled {
            Ok(Ok(_)) => Ok(true),
            Ok(Err(wgpu::PollError::Timeout)) => Ok(false),
            // A submission that came back with a number and is not known was refused meanwhile: by a device that is gone.
            Ok(Err(wgpu::PollError::WrongSubmissionIndex(..))) | Err(_) => {
                self.fate.is_lost.store(true, Ordering::Release);
                Err(GpuError::Lost)
            }
        }
    }
}

impl Fate {
    fn record(&self, what: String) {
        locked(&self.failure).get_or_insert(what);
    }
}

/// What a lock holds. A thread that panicked meanwhile left whole values behind: none is written in two steps.
pub(crate) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
