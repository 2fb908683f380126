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
    entries: Vec<Entry>,
}

impl Stack {
    /// With room for at least `need` entries, whatever they hold.
    #[inline(always)]
    pub(super) fn of_thread(need: usize) -> Stack {
        let mut entries = KEPT.take();
        if entries.len() < need {
            grow(&mut entries, need);
        }
        Stack { entries }
    }

    #[inline(always)]
    pub(super) fn entries(&mut self) -> &mut [Entry] {
        &mut self.entries
    }
}

impl Drop for Stack {
    #[inline(always)]
    fn drop(&mut self) {
        KEPT.set(std::mem::take(&mut self.entries));
    }
}

#[cold]
#[inline(never)]
fn grow(entries: &mut Vec<Entry>, need: usize) {
    entries.resize(need, Entry::default());
}
