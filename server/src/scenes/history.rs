//! What happened to a scene lately: accepted batches for `GET edits?since=`, and idempotency keys. Both bounded.

use lumicast_protocol::{Edit, EventEntry};
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use crate::store::KeptKey;

/// The last batches, up to a number and a size.
#[derive(Debug)]
pub(super) struct History {
    entries: VecDeque<(Arc<EventEntry>, u64)>,
    bytes: u64,
    entries_max: usize,
    bytes_max: u64,
}

impl History {
    pub(super) fn new(entries_max: usize, bytes_max: u64) -> History {
        History { entries: VecDeque::new(), bytes: 0, entries_max, bytes_max }
    }

    /// Adds the newest batch.
    ///
    /// - `bytes`: its length as JSON
    pub(super) fn push(&mut self, entry: Arc<EventEntry>, bytes: u64) {
        self.entries.push_back((entry, bytes));
        self.bytes += bytes;
        while self.entries.len() > self.entries_max || self.bytes > self.bytes_max {
            let Some((_, bytes)) = self.entries.pop_front() else { break };
            self.bytes -= bytes;
        }
    }

    /// The batches after `since`, oldest first; `None` where some of them are no longer kept.
    ///
    /// - `revision`: the scene's revision now
    pub(super) fn since(&self, since: u64, revision: u64) -> Option<Vec<Arc<EventEntry>>> {
        let wanted = usize::try_from(revision.saturating_sub(since)).unwrap_or(usize::MAX);
        let skipped = self.entries.len().checked_sub(wanted)?;
        Some(self.entries.iter().skip(skipped).map(|(entry, _)| entry.clone()).collect())
    }

    /// How many are kept.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }
}

/// The last idempotency keys.
#[derive(Debug)]
pub(super) struct Keys {
    order: VecDeque<String>,
    kept: HashMap<String, (u64, u64)>,
    keys_max: usize,
}

impl Keys {
    pub(super) fn new(keys_max: usize) -> Keys {
        Keys { order: VecDeque::new(), kept: HashMap::new(), keys_max }
    }

    /// Digest and revision of the batch that came with this key.
    pub(super) fn get(&self, key: &str) -> Option<(u64, u64)> {
        self.kept.get(key).copied()
    }

    pub(super) fn insert(&mut self, key: String, digest: u64, revision: u64) {
        if self.kept.insert(key.clone(), (digest, revision)).is_none() {
            self.order.push_back(key);
        }
        while self.order.len() > self.keys_max {
            let Some(oldest) = self.order.pop_front() else { break };
            self.kept.remove(&oldest);
        }
    }

    /// All of them, oldest first, for the store.
    pub(super) fn to_kept(&self) -> Vec<KeptKey> {
        let kept = |key: &String| {
            let (digest, revision) = self.get(key)?;
            Some(KeptKey { key: key.clone(), digest, revision })
        };
        self.order.iter().filter_map(kept).collect()
    }
}

/// Digest of a batch, the same in every version and on every machine: FNV-1a of its JSON. It tells a repetition from
/// another batch under the same key; it need not withstand an attacker, who may send what batch he likes anyway.
pub(super) fn digest(edits: &[Edit]) -> u64 {
    struct Fnv(u64);
    impl std::io::Write for Fnv {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            for byte in bytes {
                self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
            }
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let mut fnv = Fnv(0xcbf2_9ce4_8422_2325);
    // Edits always have a JSON form (the log relies on it too), and this writer never fails.
    let _ = serde_json::to_writer(&mut fnv, edits);
    fnv.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(revision: u64) -> Arc<EventEntry> {
        Arc::new(EventEntry { revision, seconds_since_epoch: 0.0, edits: Vec::new() })
    }

    #[test]
    fn history_keeps_the_newest_and_knows_its_gap() {
        let mut history = History::new(3, 1000);
        for revision in 2..=6 {
            history.push(entry(revision), 1);
        }
        let since =
            |revision| history.since(revision, 6).map(|list| list.iter().map(|e| e.revision).collect());
        assert_eq!(since(3), Some(vec![4, 5, 6]));
        assert_eq!(since(5), Some(vec![6]));
        assert_eq!(since(6), Some(Vec::new()));
        assert_eq!(since(99), Some(Vec::new()));
        assert_eq!(since(2), None);
    }

    #[test]
    fn history_is_bounded_in_bytes() {
        let mut history = History::new(100, 10);
        for revision in 2..=50 {
            history.push(entry(revision), 4);
        }
        assert_eq!(history.len(), 2);
        history.push(entry(51), 11);
        assert_eq!(history.len(), 0);
    }

    #[test]
    fn keys_forget_the_oldest() {
        let mut keys = Keys::new(2);
        for (n, key) in ["a", "b", "a", "c"].into_iter().enumerate() {
            keys.insert(key.into(), n as u64, n as u64);
        }
        assert_eq!(keys.get("a"), None);
        assert_eq!(keys.get("c"), Some((3, 3)));
        assert_eq!(keys.to_kept().len(), 2);
    }
}
