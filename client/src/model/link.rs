//! The connection as a state machine: connecting, open, lost, waiting to try again. No sockets, no clock of its own.

/// First pause after a lost connection, doubled up to [`PAUSE_MAX_S`]: the protocol's figures.
const PAUSE_MIN_S: f64 = 0.5;
const PAUSE_MAX_S: f64 = 10.0;
/// Pauses vary by this share either way, so that a server that comes back is not stormed.
const JITTER: f64 = 0.25;
/// A ping this often: it measures the way there and back, and finds lines that are dead without saying so.
const PING_INTERVAL_S: f64 = 2.0;
/// Nothing heard for this long in spite of pings: the line is dead. Above the server's slowest honest answer (a large
/// scene's import does not block its sockets).
const SILENCE_MAX_S: f64 = 12.0;
/// A socket that neither opens nor fails in this time is given up.
const CONNECT_MAX_S: f64 = 10.0;

/// Where the connection stands.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum LinkState {
    /// Nobody asked for one.
    #[default]
    Idle,
    /// On its way.
    Connecting,
    /// Open, and the server has said hello.
    Open,
    /// Lost; the next try comes by itself.
    Waiting {
        /// When.
        until_s: f64,
        /// What broke it.
        reason: String,
    },
    /// Trying again would not help.
    Refused {
        /// Why.
        reason: String,
    },
}

/// State of the connection with its back-off.
#[derive(Debug, Clone, Default)]
pub struct Link {
    state: LinkState,
    /// Failures since the last hello.
    failures: u32,
    /// Hello was heard at least once since [`Link::start`].
    was_open: bool,
    heard_s: f64,
    pinged_s: f64,
}

impl Link {
    /// Where it stands.
    pub fn state(&self) -> &LinkState {
        &self.state
    }

    /// Whether messages can go out.
    pub fn is_open(&self) -> bool {
        self.state == LinkState::Open
    }

    /// Whether it once was open and is being mended.
    pub fn is_mending(&self) -> bool {
        self.was_open && matches!(self.state, LinkState::Connecting | LinkState::Waiting { .. })
    }

    /// Tries since it was last open.
    pub fn failures(&self) -> u32 {
        self.failures
    }

    pub(super) fn heard_s(&self) -> f64 {
        self.heard_s
    }

    pub(super) fn start(&mut self, now_s: f64) {
        *self = Self { state: LinkState::Connecting, heard_s: now_s, ..Self::default() };
    }

    pub(super) fn heard(&mut self, now_s: f64) {
        self.heard_s = now_s;
    }

    pub(super) fn opened(&mut self, now_s: f64) {
        (self.state, self.failures, self.was_open) = (LinkState::Open, 0, true);
        (self.heard_s, self.pinged_s) = (now_s, now_s);
    }

    /// `random` in [0, 1).
    pub(super) fn lost(&mut self, reason: String, now_s: f64, random: f64) {
        let doublings = self.failures.min(16) as i32;
        let pause_s = (PAUSE_MIN_S * 2f64.powi(doublings)).min(PAUSE_MAX_S);
        self.failures += 1;
        let until_s = now_s + pause_s * (1.0 + JITTER * (2.0 * random - 1.0));
        self.state = LinkState::Waiting { until_s, reason };
    }

    pub(super) fn refused(&mut self, reason: String) {
        self.state = LinkState::Refused { reason };
    }

    /// Whether to open a socket now; says so once.
    pub(super) fn take_retry(&mut self, now_s: f64) -> bool {
        let due = matches!(self.state, LinkState::Waiting { until_s, .. } if now_s >= until_s);
        if due {
            (self.state, self.heard_s) = (LinkState::Connecting, now_s);
        }
        due
    }

    /// Ends the waiting.
    pub(super) fn retry_now(&mut self, now_s: f64) {
        if let LinkState::Waiting { until_s, .. } = &mut self.state {
            *until_s = now_s;
        }
    }

    /// Whether to ping now; says so once.
    pub(super) fn take_ping(&mut self, now_s: f64) -> bool {
        let due = self.is_open() && now_s - self.pinged_s >= PING_INTERVAL_S;
        if due {
            self.pinged_s = now_s;
        }
        due
    }

    /// Why the line counts as dead, if it does.
    pub(super) fn silence(&self, now_s: f64) -> Option<String> {
        let silent_s = now_s - self.heard_s;
        match self.state {
            LinkState::Open if silent_s > SILENCE_MAX_S => {
                Some(format!("nothing heard from the server for {silent_s:.0} s"))
            }
            LinkState::Connecting if silent_s > CONNECT_MAX_S => {
                Some(format!("the server did not answer within {CONNECT_MAX_S:.0} s"))
            }
            _ => None,
        }
    }

    /// When something has to be looked at again.
    pub(super) fn due_s(&self) -> Option<f64> {
        match self.state {
            LinkState::Waiting { until_s, .. } => Some(until_s),
            LinkState::Open => Some(self.pinged_s + PING_INTERVAL_S),
            LinkState::Connecting => Some(self.heard_s + CONNECT_MAX_S + 0.01),
            LinkState::Idle | LinkState::Refused { .. } => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pause_s(link: &mut Link, random: f64) -> f64 {
        link.lost("gone".into(), 100.0, random);
        let LinkState::Waiting { until_s, .. } = link.state else { panic!("not waiting") };
        until_s - 100.0
    }

    #[test]
    fn pauses_double_to_ten_seconds_and_start_again_after_a_hello() {
        let mut link = Link::default();
        link.start(0.0);
        let pauses: Vec<f64> = (0..7).map(|_| pause_s(&mut link, 0.5)).collect();
        assert_eq!(pauses, [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]);
        link.opened(200.0);
        assert_eq!(pause_s(&mut link, 0.5), 0.5);
        let mut other = link.clone();
        assert!(pause_s(&mut link, 0.0) < pause_s(&mut other, 0.99), "no jitter");
    }

    #[test]
    fn a_retry_is_taken_once_and_not_before_its_time() {
        let mut link = Link::default();
        link.start(0.0);
        link.lost("gone".into(), 0.0, 0.5);
        assert!(!link.take_retry(0.4));
        assert!(link.take_retry(0.6));
        assert!(!link.take_retry(0.7));
        assert_eq!(*link.state(), LinkState::Connecting);
    }

    #[test]
    fn a_silent_line_counts_as_dead_and_a_talking_one_does_not() {
        let mut link = Link::default();
        link.start(0.0);
        assert!(link.silence(5.0).is_none());
        assert!(link.silence(11.0).is_some());
        link.opened(11.0);
        for second in 11..100 {
            link.heard(f64::from(second));
            assert!(link.silence(f64::from(second) + 1.0).is_none());
        }
        assert!(link.silence(120.0).unwrap().contains("nothing heard"));
    }
}
