//! How much is asked of a card at once by whoever asks it for slices, and whether it still answers.

use std::sync::{Mutex, atomic::Ordering};

use bytemuck::NoUninit;

use super::{
    GpuPassHeader, GpuScene, LOSSES_MAX,
    known::LightBeside,
    tracing::{PathStart, SLICE_MIN, Slice},
};
use crate::gpu::{GpuError, locked};

/// Asked for at once, over those of a slice: while one slice is on the card others wait, so that slices are as large as they
/// may be.
const SLICES_AT_ONCE: usize = 2;

/// Of one who asks.
#[derive(Debug)]
pub(super) struct Slices {
    from: PathStart,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    /// Paths of the next slice.
    slice: u32,
    /// Of all that were answered and used.
    path_count: u64,
    /// Nothing more is asked.
    is_over: bool,
    failure: Option<GpuError>,
}

impl Slices {
    /// Nothing asked yet.
    pub(super) fn new(from: PathStart) -> Slices {
        let state = State { slice: SLICE_MIN, path_count: 0, is_over: false, failure: None };
        Slices { from, state: Mutex::new(state) }
    }

    /// Nothing more is asked.
    pub(super) fn stop(&self) {
        locked(&self.state).is_over = true;
    }

    /// The same, and why.
    pub(super) fn fail(&self, error: GpuError) {
        let mut state = locked(&self.state);
        (state.is_over, state.failure) = (true, Some(error));
    }

    /// Why nothing more is asked.
    pub(super) fn failure(&self) -> Option<GpuError> {
        locked(&self.state).failure.clone()
    }

    /// Paths that were answered.
    pub(super) fn path_count(&self) -> u64 {
        locked(&self.state).path_count
    }

    /// How many are best asked for together; `None` where nothing more is asked.
    pub(super) fn at_once(&self) -> Option<usize> {
        self.next().map(|slice| SLICES_AT_ONCE * slice)
    }

    /// Paths of the next slice at most; `None` where nothing more is asked.
    pub(super) fn next(&self) -> Option<usize> {
        let state = locked(&self.state);
        (!state.is_over).then_some(state.slice as usize)
    }

    /// So many were answered, and are used.
    pub(super) fn count(&self, path_count: u64) {
        locked(&self.state).path_count += path_count;
    }

    /// A slice of so many was answered, whose first batch took so long.
    pub(super) fn answered(&self, scene: &GpuScene, path_count: u32, first_seconds: f64) {
        let mut state = locked(&self.state);
        state.slice = scene.slice_after(self.from, state.slice, path_count, first_seconds);
    }
}

impl GpuScene {
    /// Traces a slice of paths that begin with `starts`, and takes what it brings; once more where the device is lost under it.
    ///
    /// - `header`: of the slice, but for its places
    /// - `room`: paths that there are to be places for
    /// - `take`: as for [`GpuScene::take`]
    pub(super) fn slice_of<S: NoUninit, T>(
        &self,
        from: PathStart,
        starts: &[S],
        header: &GpuPassHeader,
        room: usize,
        light: LightBeside<'_>,
        take: impl Fn(&[u8]) -> T,
    ) -> Result<(T, Slice), GpuError> {
        self.through_losses(|| {
            let (slice, brought) = self.trace_with(from, room, light, |tracing| {
                tracing.write_starts(starts)?;
                let header = GpuPassHeader { capacity: tracing.capacity(), ..*header };
                let slice = tracing.trace_all(&header, true)?;
                let brought = tracing.bring(&slice)?;
                Ok((slice, brought))
            })?;
            Ok((self.take(brought, &take)?, slice))
        })
    }

    /// Does a piece of work as often as devices are lost under it, within reason.
    pub(super) fn through_losses<T>(&self, work: impl FnMut() -> Result<T, GpuError>) -> Result<T, GpuError> {
        let done = self.through_counted_losses(work)?;
        self.losses.store(0, Ordering::Relaxed);
        Ok(done)
    }

    /// The same for what is so little that a card which does it may still fail at passes: losses before it count on.
    pub(super) fn through_counted_losses<T>(
        &self,
        mut work: impl FnMut() -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        loop {
            match work() {
                Err(GpuError::Lost) if self.losses.fetch_add(1, Ordering::Relaxed) < LOSSES_MAX => {}
                done => return done,
            }
        }
    }
}
