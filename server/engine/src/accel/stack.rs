//! Where nodes and leaves wait while a ray is walked: one stack a thread, kept from ray to ray.
//!
//! A fresh one for every ray cost a tenth of its time, as it has to be filled with zeros before it may be used.

use std::cell::Cell;

/// What waits; its owner knows how to read it.
pub(super) type Entry = u64;

thread_local! {
    static KEPT: Cell<Vec<Entry>> = const { Cell::new(Vec::new()) };
}

/// The thread's stack while it is in use. Who takes it again meanwhile, as a walk does that is asked for in the middle
/// of another, gets a new one.
pub(super) struct Stack {
    /// As many as any walk of this thread has needed yet.
    entries: Vec<Entry>,
    need: usize,
}

impl Stack {
    /// With room for `need` entries, whatever they hold.
    #[inline(always)]
    pub(super) fn of_thread(need: usize) -> Stack {
        // Nothing is kept where the thread is ending and destructors ask for rays.
        let mut entries = KEPT.try_with(Cell::take).unwrap_or_default();
        if entries.len() < need {
            grow(&mut entries, need);
        }
        Stack { entries, need }
    }

    /// No more than were asked for, though more may be there: a walk that needs more than it said always panics, rather
    /// than only on threads that have walked nothing deeper before.
    #[inline(always)]
    pub(super) fn entries(&mut self) -> &mut [Entry] {
        &mut self.entries[..self.need]
    }
}

impl Drop for Stack {
    #[inline(always)]
    fn drop(&mut self) {
        let entries = std::mem::take(&mut self.entries);
        // Where the thread is ending nobody wants them any more.
        let _ = KEPT.try_with(|kept| kept.set(entries));
    }
}

#[cold]
#[inline(never)]
fn grow(entries: &mut Vec<Entry>, need: usize) {
    entries.resize(need, Entry::default());
}
