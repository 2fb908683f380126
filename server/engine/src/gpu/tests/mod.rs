//! Laws of the room, on whatever adapter there is; [`open`] is for the tests of all rooms.

mod layout;
mod staging;

pub(crate) use layout::{assert_same_layout, layout, numbers_of};

use std::sync::Arc;

use lumicast_shaders::{Constant, Part, Step};

use super::*;

/// Any adapter, software too. On a machine without one the test is to return, having printed SKIPPED;
/// `LUMICAST_GPU=required` makes that a failure.
pub(crate) fn open() -> Option<Gpu> {
    open_with(&GpuOptions { adapter: AdapterChoice::Any, ..GpuOptions::default() })
}

/// [`open`] with bounds of one's own.
pub(crate) fn open_with(options: &GpuOptions) -> Option<Gpu> {
    match Gpu::open_with(options) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let is_required = std::env::var("LUMICAST_GPU").is_ok_and(|value| value == "required");
            assert!(!is_required, "LUMICAST_GPU=required, and {error}");
            eprintln!("SKIPPED: {error}");
            None
        }
    }
}

static TWICE: Step = Step {
    name: "tests/twice",
    entry_point: "twice",
    parts: &[&Part {
        name: "tests/twice",
        source: "
@group(0) @binding(0) var<storage, read> numbers: array<u32>;
@group(0) @binding(1) var<storage, read_write> products: array<u32>;
@group(0) @binding(2) var<uniform> addend: u32;
@compute @workgroup_size(64)
fn twice(
    @builtin(workgroup_id) workgroup: vec3u,
    @builtin(num_workgroups) workgroup_count: vec3u,
    @builtin(local_invocation_index) invocation: u32,
) {
    let index = (workgroup.y * workgroup_count.x + workgroup.x) * 64u + invocation;
    if index < arrayLength(&products) { products[index] = numbers[index] * FACTOR + addend; }
}",
    }],
    workgroup_size: [64, 1, 1],
};

static BROKEN: Step = Step {
    name: "tests/broken",
    entry_point: "broken",
    parts: &[&Part {
        name: "tests/broken",
        source: "@compute @workgroup_size(64) fn broken() { absent(); }",
    }],
    workgroup_size: [64, 1, 1],
};

const BINDINGS: [Binding; 3] = [Binding::Read, Binding::Write, Binding::Uniform];

fn numbers(count: u32) -> Vec<u32> {
    (0..count).collect()
}

/// `factor * n + 5` for the first `count` numbers, by the device.
fn computed(session: &Arc<Session>, factor: u32, count: u32) -> Result<Vec<u32>, GpuError> {
    let layout = session.layout(&BINDINGS)?;
    let pipeline = session.pipeline(&TWICE, &[("FACTOR", Constant::U32(factor))], &[&layout])?;
    let input = session.buffer("numbers", bytemuck::cast_slice(&numbers(count)))?;
    let output = session.buffer_zeroed("products", input.byte_count())?;
    let addend = session.buffer("addend", bytemuck::bytes_of(&5u32))?;
    let group = session.bind(&layout, &[&input, &output, &addend])?;
    let mut batch = session.batch("twice")?;
    batch.dispatch(&pipeline, &[&group], pipeline.workgroups(count.into()))?;
    let read_back = batch.read_back(&output, 0..output.byte_count())?;
    batch.submit()?;
    Ok(bytemuck::pod_collect_to_vec(&read_back.collect()?))
}

fn expected(factor: u32, count: u32) -> Vec<u32> {
    numbers(count).into_iter().map(|number| number * factor + 5).collect()
}

/// What is written is what is read, whatever its length, and nothing leaves 16 bytes that can be bound.
#[test]
fn bytes_come_back_as_they_went() {
    let Some(gpu) = open() else { return };
    let session = gpu.session().unwrap();
    for length in [1, 3, 4, 5, 16, 4095, 1 << 20] {
        let bytes: Vec<u8> = (0..length).map(|byte: u32| (byte * 7 % 251) as u8).collect();
        let buffer = session.buffer("bytes", &bytes).unwrap();
        let read = session.read(&buffer, 0..buffer.byte_count().next_multiple_of(4)).unwrap();
        assert_eq!(read[..bytes.len()], bytes);
        assert!(read[bytes.len()..].iter().all(|byte| *byte == 0), "padded by zeros");
    }
    let empty = session.buffer("empty", &[]).unwrap();
    assert_eq!((empty.byte_count(), session.bytes_held()), (0, 16));
    assert_eq!(session.read(&empty, 0..0).unwrap(), Vec::<u8>::new());
    let refused = session.read(&empty, 0..4).unwrap_err();
    assert!(matches!(refused, GpuError::Failed { .. }), "{refused}");
    session.check().expect("a refused range leaves the session as it was");
}

/// A step computes, with every size of dispatch, and is compiled once for its constants.
#[test]
fn a_step_computes_what_it_says() {
    let Some(gpu) = open() else { return };
    eprintln!("{:?}", gpu.report());
    let session = gpu.session().unwrap();
    for count in [1, 63, 64, 65, 100_000] {
        assert_eq!(computed(&session, 2, count).unwrap(), expected(2, count));
    }
    let seconds = session.shader_seconds();
    assert!(seconds > 0.0);
    assert_eq!(computed(&session, 2, 9).unwrap(), expected(2, 9));
    assert_eq!(session.shader_seconds(), seconds, "compiled once");
    assert_eq!(computed(&session, 3, 9).unwrap(), expected(3, 9));
    assert!(session.shader_seconds() > seconds, "another constant is another pipeline");
    assert_eq!(session.bytes_held(), 0, "buffers give back their bytes");
}

/// More workgroups than a dimension holds stand in rows, and none is missing.
#[test]
fn workgroups_beyond_one_dimension_stand_in_rows() {
    let Some(gpu) = open() else { return };
    let session = gpu.session().unwrap();
    let layout = session.layout(&BINDINGS).unwrap();
    let pipeline = session.pipeline(&TWICE, &[("FACTOR", Constant::U32(2))], &[&layout]).unwrap();
    for count in [0u64, 1, 64, 65, 65_535 * 64, 65_535 * 64 + 1, 1 << 31] {
        let [x, y, z] = pipeline.workgroups(count);
        assert!(x <= 65_535 && y <= 65_535 && z == 1);
        let held = u64::from(x) * u64::from(y) * 64;
        assert!(held >= count && held < count + 64 * u64::from(y) + 64, "{count}: {x} × {y}");
    }
    let count = 65_536 * 64 + 1;
    assert_eq!(computed(&session, 2, count).unwrap(), expected(2, count));
}

/// Commands run in order: a dispatch sees a copy before it, a clear comes after; sizes may come from a buffer.
#[test]
fn a_batch_runs_in_order() {
    let Some(gpu) = open() else { return };
    let session = gpu.session().unwrap();
    let layout = session.layout(&BINDINGS).unwrap();
    let pipeline = session.pipeline(&TWICE, &[("FACTOR", Constant::U32(2))], &[&layout]).unwrap();
    let source = session.buffer("source", bytemuck::cast_slice(&numbers(128))).unwrap();
    let [input, output, last] = ["input", "output", "last"].map(|n| session.buffer_zeroed(n, 512).unwrap());
    let addend = session.buffer("addend", bytemuck::bytes_of(&5u32)).unwrap();
    let sizes = session.buffer("sizes", bytemuck::cast_slice(&[9u32, 2, 1, 1])).unwrap();
    let group = session.bind(&layout, &[&input, &output, &addend]).unwrap();
    let back = session.bind(&layout, &[&output, &last, &addend]).unwrap();
    let mut batch = session.timed_batch("in order").unwrap();
    batch.copy(&source, 0..512, &input, 0).unwrap();
    batch.dispatch_indirect(&pipeline, &[&group], &sizes, 4).unwrap();
    batch.dispatch(&pipeline, &[&back], [2, 1, 1]).unwrap();
    batch.clear(&input).unwrap();
    let mut read = [&output, &last, &input].map(|buffer| batch.read_back(buffer, 0..512).unwrap());
    let submission = batch.submit().unwrap();
    if let Some(seconds) = submission.gpu_seconds().unwrap() {
        assert!(seconds > 0.0 && seconds < 60.0, "{seconds} s");
    }
    let [output, last, input] = read.each_mut().map(|read| {
        let bytes = read.try_collect().unwrap().expect("the batch is done");
        bytemuck::pod_collect_to_vec::<u8, u32>(&bytes)
    });
    assert_eq!(output, expected(2, 128));
    assert_eq!(last, expected(2, 128).into_iter().map(|number| 2 * number + 5).collect::<Vec<_>>());
    assert!(input.into_iter().all(|number| number == 0));
}

/// Each step of a batch is timed by itself, together they take what the batch takes, and what is not ended before is the last.
#[test]
fn steps_of_a_batch_are_timed() {
    let Some(gpu) = open() else { return };
    let session = gpu.session().unwrap();
    if session.nanoseconds_per_tick.is_none() {
        eprintln!("SKIPPED: the device has no clock");
        return;
    }
    let [large, small] = [1 << 26, 64].map(|bytes| session.buffer_zeroed("cleared", bytes).unwrap());
    let steps = |ended: u32| {
        let mut batch = session.batch_of_steps("steps", 3).unwrap();
        for buffer in [&small, &large, &small].into_iter().take(ended as usize) {
            batch.clear(buffer).unwrap();
            batch.end_step();
        }
        batch.submit().unwrap().step_seconds().unwrap().expect("a clock")
    };
    let [three, two] = [steps(3), steps(2)];
    assert_eq!((three.len(), two.len()), (3, 3));
    assert!(three[1] > three[0] && three[1] > three[2], "{three:?}");
    assert!(two[2] < two[1], "nothing was left to do: {two:?}");
    let refused = session.batch_of_steps("steps", 4096).unwrap_err();
    assert!(matches!(refused, GpuError::Failed { .. }), "{refused}");
    session.check().expect("a refused clock leaves the session as it was");
}

/// What exceeds the budget or the adapter is refused with names and numbers, and the session goes on.
#[test]
fn buffers_beyond_the_budget_are_refused() {
    let options = GpuOptions { adapter: AdapterChoice::Any, bytes_max: 1000, ..GpuOptions::default() };
    let Some(gpu) = open_with(&options) else { return };
    let session = gpu.session().unwrap();
    let first = session.buffer_zeroed("first", 600).unwrap();
    let refused = session.buffer_zeroed("photons", 404).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "buffer \"photons\" needs 404 bytes on the graphics card where 400 are allowed \
         (what is left of the bytes it may take); take the CPU backend"
    );
    drop(first);
    session.buffer_zeroed("photons", 404).unwrap();
    let refused = session.buffer_zeroed("huge", 1 << 60).unwrap_err();
    assert!(matches!(refused, GpuError::OutOfMemory { byte_count, .. } if byte_count == 1 << 60));
    assert_eq!(session.bytes_held(), 0);
    session.check().unwrap();
}

/// Shaders that do not compile, groups that do not fit and commands that are refused are errors; the session goes on.
#[test]
fn what_the_device_refuses_is_an_error() {
    let Some(gpu) = open() else { return };
    let session = gpu.session().unwrap();
    let error = session.pipeline(&BROKEN, &[], &[]).unwrap_err();
    assert!(
        matches!(&error, GpuError::Shader { step, what } if step == "tests/broken" && what.contains("absent"))
    );
    let layout = session.layout(&BINDINGS).unwrap();
    let missing = session.pipeline(&TWICE, &[], &[&layout]).unwrap_err();
    assert!(matches!(missing, GpuError::Shader { .. }), "a constant is missing: {missing}");
    let buffer = session.buffer_zeroed("one", 64).unwrap();
    let error = session.bind(&layout, &[&buffer]).unwrap_err();
    assert!(matches!(error, GpuError::Failed { .. }), "{error}");
    let mut batch = session.batch("bad copy").unwrap();
    batch.copy(&buffer, 0..4096, &buffer, 0).unwrap();
    let read = batch.read_back(&buffer, 0..64).unwrap();
    let error = batch.submit().unwrap_err();
    assert!(matches!(&error, GpuError::Failed { what } if what.contains("bad copy")), "{error}");
    assert!(matches!(read.collect(), Err(GpuError::Failed { .. })));
    assert_eq!(computed(&session, 2, 100).unwrap(), expected(2, 100));
}

/// Work that takes longer than it may is an error and not a hang; the device ends it all the same.
#[test]
fn waiting_has_an_end() {
    let options = GpuOptions { adapter: AdapterChoice::Any, seconds_max: 1e-3, ..GpuOptions::default() };
    let Some(gpu) = open_with(&options) else { return };
    let session = gpu.session().unwrap();
    let layout = session.layout(&BINDINGS).unwrap();
    let pipeline = session.pipeline(&TWICE, &[("FACTOR", Constant::U32(2))], &[&layout]).unwrap();
    let [input, output] = ["input", "output"].map(|n| session.buffer_zeroed(n, 64 << 20).unwrap());
    let addend = session.buffer("addend", bytemuck::bytes_of(&5u32)).unwrap();
    let group = session.bind(&layout, &[&input, &output, &addend]).unwrap();
    let mut batch = session.batch("long").unwrap();
    // 50 × 128 MiB are read and written: a second for this machine, several milliseconds for the fastest card there is.
    for _ in 0..50 {
        batch.dispatch(&pipeline, &[&group], pipeline.workgroups(16 << 20)).unwrap();
    }
    let mut read = batch.read_back(&output, 0..16).unwrap();
    let submission = batch.submit().unwrap();
    let error = submission.wait().unwrap_err();
    assert_eq!(error.to_string(), "the graphics device did not finish long within 0.001 s");
    let bytes = loop {
        if let Some(bytes) = read.try_collect().unwrap() {
            break bytes;
        }
        std::thread::yield_now();
    };
    assert_eq!(bytemuck::pod_collect_to_vec::<u8, u32>(&bytes), [5; 4]);
}

/// After a loss everything of the device says so, and the next session computes.
#[test]
fn a_lost_device_is_an_error_and_the_next_session_works() {
    let Some(gpu) = open() else { return };
    let session = gpu.session().unwrap();
    assert_eq!(session.generation(), 0);
    let layout = session.layout(&BINDINGS).unwrap();
    let buffer = session.buffer("kept", &[1; 64]).unwrap();
    let mut batch = session.batch("cut off").unwrap();
    let cut_off = batch.read_back(&buffer, 0..64).unwrap();
    let unsubmitted = session.batch("too late").unwrap();
    batch.submit().unwrap();
    session.lose_for_test();
    assert_eq!(session.check(), Err(GpuError::Lost));
    assert_eq!(cut_off.collect().unwrap_err(), GpuError::Lost);
    assert_eq!(unsubmitted.submit().unwrap_err(), GpuError::Lost);
    assert_eq!(session.buffer("new", &[1; 64]).unwrap_err(), GpuError::Lost);
    assert_eq!(session.read(&buffer, 0..64).unwrap_err(), GpuError::Lost);
    assert_eq!(session.write(&buffer, 0, &[2; 64]).unwrap_err(), GpuError::Lost);
    assert_eq!(session.layout(&BINDINGS).unwrap_err(), GpuError::Lost);
    assert_eq!(session.bind(&layout, &[&buffer]).unwrap_err(), GpuError::Lost);
    assert_eq!(computed(&session, 2, 10).unwrap_err(), GpuError::Lost);
    let next = gpu.session().unwrap();
    assert_eq!(next.generation(), 1);
    assert_eq!(next.read(&buffer, 0..64).unwrap_err(), GpuError::Lost, "a buffer of the lost device");
    assert_eq!(computed(&next, 2, 10).unwrap(), expected(2, 10));
    assert!(Arc::ptr_eq(&next, &gpu.session().unwrap()), "and stays the same");
}

/// Threads share a device, and each gets its own results; errors of one are not the other's.
#[test]
fn threads_share_a_gpu() {
    let Some(gpu) = open() else { return };
    let gpu = Arc::new(gpu);
    let threads = [2, 3].map(|factor| {
        let gpu = Arc::clone(&gpu);
        std::thread::spawn(move || {
            for count in 1..20 {
                let session = gpu.session().unwrap();
                assert_eq!(computed(&session, factor, count * 50).unwrap(), expected(factor, count * 50));
                assert!(session.pipeline(&BROKEN, &[], &[]).is_err());
            }
        })
    });
    for thread in threads {
        thread.join().unwrap();
    }
}
