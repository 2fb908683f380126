//! Memory that bytes come back through.

use super::{super::session::locked, *};

/// Bytes and number of the buffers that are kept for later reads.
fn kept(session: &Session) -> (u64, usize) {
    let spare = locked(&session.spare);
    (spare.bytes(), spare.count())
}

/// What is kept from one read serves the next that fits, and shows nothing of what came through before.
#[test]
fn memory_is_used_again_and_shows_nothing_of_earlier_reads() {
    let Some(gpu) = open() else { return };
    let session = gpu.session().unwrap();
    let [ones, twos] = [1u8, 2].map(|byte| session.buffer("bytes", &[byte; 8000]).unwrap());
    assert_eq!(session.read(&ones, 0..4000).unwrap(), [1; 4000]);
    assert_eq!(kept(&session), (4000, 1));
    assert_eq!(session.read(&twos, 0..3000).unwrap(), [2; 3000]);
    assert_eq!(kept(&session), (4000, 1), "the same again");
    assert_eq!(session.read(&ones, 0..4000).unwrap(), [1; 4000]);
    assert_eq!(session.read(&twos, 0..0).unwrap(), Vec::<u8>::new());
    assert_eq!(kept(&session), (4256, 2), "few bytes come through a small one");
    assert_eq!(session.read(&twos, 0..8000).unwrap(), [2; 8000]);
    assert_eq!(kept(&session), (12_256, 3), "more need a larger one");
    let sum = |bytes: &[u8]| bytes.iter().map(|byte| u32::from(*byte)).sum::<u32>();
    assert_eq!(session.fetch(&ones, 0..5000).unwrap().read(sum).unwrap(), 5000);
    assert_eq!(kept(&session), (12_256, 3));
}

/// Reads that are on their way together do not share memory, also where one of them is never asked for.
#[test]
fn reads_on_their_way_keep_apart() {
    let Some(gpu) = open() else { return };
    let session = gpu.session().unwrap();
    let buffers = [1u8, 2, 3].map(|byte| session.buffer("bytes", &[byte; 1000]).unwrap());
    for _ in 0..2 {
        let [first, second, third] = buffers.each_ref().map(|buffer| session.fetch(buffer, 0..1000).unwrap());
        drop(second);
        assert_eq!(third.collect().unwrap(), [3; 1000]);
        assert_eq!(first.collect().unwrap(), [1; 1000]);
        assert_eq!(kept(&session), (2000, 2));
    }
    let mut late = session.batch("late").unwrap();
    drop(late.read_back(&buffers[1], 0..1000).unwrap());
    let read = session.fetch(&buffers[0], 0..1000).unwrap();
    late.submit().unwrap();
    assert_eq!(read.collect().unwrap(), [1; 1000]);
}

/// Memory that is kept counts in what a session may hold, and never takes the place of anything else.
#[test]
fn kept_memory_makes_way() {
    let options = GpuOptions { adapter: AdapterChoice::Any, bytes_max: 10_000, ..GpuOptions::default() };
    let Some(gpu) = open_with(&options) else { return };
    let session = gpu.session().unwrap();
    let read = session.buffer("read", &[7; 4000]).unwrap();
    assert_eq!(session.read(&read, 0..4000).unwrap(), [7; 4000]);
    assert_eq!((session.bytes_held(), session.budget.held()), (4000, 8000));
    let other = session.buffer_zeroed("other", 6000).unwrap();
    assert_eq!((session.bytes_held(), session.budget.held()), (10_000, 10_000));
    let refused = session.read(&read, 0..4).unwrap_err();
    assert!(matches!(refused, GpuError::OutOfMemory { bytes_allowed: 0, .. }), "{refused}");
    drop(other);
    assert_eq!(session.read(&read, 0..4000).unwrap(), [7; 4000]);
    // Sixteen bytes a pixel.
    let target = session.target("picture", [20, 15], crate::gpu::Overlap::Sum);
    assert!(matches!(target, Ok(_) | Err(GpuError::Insufficient { .. })), "{target:?}");
    drop(target);
    assert_eq!(session.read(&read, 0..4000).unwrap(), [7; 4000]);
    drop(read);
    assert_eq!((session.bytes_held(), session.budget.held()), (0, 4000));
}

/// However much is read at once, what is kept of it is bounded.
#[test]
fn what_is_kept_is_bounded() {
    let Some(gpu) = open() else { return };
    let session = gpu.session().unwrap();
    let small = session.buffer("small", &[1; 16]).unwrap();
    let reads: Vec<ReadBack> = (0..40).map(|_| session.fetch(&small, 0..16).unwrap()).collect();
    for read in reads {
        assert_eq!(read.collect().unwrap(), [1; 16]);
    }
    assert_eq!(kept(&session), (32 * 256, 32));
    let large = session.buffer_zeroed("large", 48 << 20).unwrap();
    let reads: Vec<ReadBack> = (0..3).map(|_| session.fetch(&large, 0..48 << 20).unwrap()).collect();
    for read in reads {
        read.read(|_| ()).unwrap();
    }
    assert_eq!(kept(&session), (96 << 20, 2), "those of before went first");
    let huge = session.buffer_zeroed("huge", 120 << 20).unwrap();
    session.fetch(&huge, 0..120 << 20).unwrap().read(|_| ()).unwrap();
    assert_eq!(kept(&session), (96 << 20, 2), "it drives nothing else out");
}
