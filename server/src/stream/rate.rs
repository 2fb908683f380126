//! Messages a second, counted as a bucket that drips.

use std::time::Instant;

/// What becomes of one more message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Within the rate.
    Take,
    /// Over it.
    Refuse,
    /// Far over it, for long.
    Disconnect,
}

/// Lets `per_second` messages through, in bursts of up to one second's worth.
#[derive(Debug)]
pub(super) struct Rate {
    per_second: f64,
    level: f64,
    refused: f64,
    at: Instant,
}

impl Rate {
    pub(super) fn new(per_second: u32, now: Instant) -> Rate {
        Rate { per_second: per_second.into(), level: 0.0, refused: 0.0, at: now }
    }

    /// Counts one message. Refused ones fill a second bucket: ten seconds' worth of them disconnect.
    pub(super) fn one_more(&mut self, now: Instant) -> Verdict {
        let dripped = now.saturating_duration_since(self.at).as_secs_f64() * self.per_second;
        self.at = now;
        self.level = (self.level - dripped).max(0.0);
        self.refused = (self.refused - dripped).max(0.0);
        if self.level + 1.0 <= self.per_second {
            self.level += 1.0;
            return Verdict::Take;
        }
        self.refused += 1.0;
        if self.refused > 10.0 * self.per_second { Verdict::Disconnect } else { Verdict::Refuse }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_steady_rate_passes_and_a_flood_is_refused_then_disconnected() {
        let start = Instant::now();
        let mut rate = Rate::new(100, start);
        for n in 0..1000 {
            assert_eq!(rate.one_more(start + Duration::from_millis(n * 10)), Verdict::Take);
        }
        let now = start + Duration::from_secs(10);
        let verdicts: Vec<Verdict> = (0..2000).map(|_| rate.one_more(now)).collect();
        assert_eq!(verdicts.iter().filter(|v| **v == Verdict::Take).count(), 100);
        assert_eq!(verdicts[200], Verdict::Refuse);
        assert_eq!(*verdicts.last().unwrap(), Verdict::Disconnect);
    }
}
