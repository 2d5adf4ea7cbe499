//! The time limits of a session on a stream.

use core::time::Duration;

use crate::endpoint::ServerEndpoint;
use crate::time::{Instant, earliest};

/// The time limits of a session on a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeLimits {
    /// How long a request may take from its first byte to its last.
    pub receive: Duration,
    /// How long a session without a running request may move no bytes; `None` means forever.
    pub idle: Option<Duration>,
}

/// A time limit that a session has exceeded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exceeded {
    /// [`TimeLimits::receive`].
    Receive,
    /// [`TimeLimits::idle`].
    Idle,
}

/// The times of a session on a stream.
///
/// The server reports its actions on the session, and requests the next deadline before it waits.
#[derive(Clone, Copy, Debug)]
pub struct StreamTimes {
    last_active: Instant,
    /// When the first byte of a partial request arrived.
    partial_since: Option<Instant>,
}

impl StreamTimes {
    /// Begins with a new connection.
    #[must_use]
    pub const fn new(now: Instant) -> Self {
        Self { last_active: now, partial_since: None }
    }

    /// Returns when bytes were received or sent last.
    #[must_use]
    pub const fn last_active(&self) -> Instant {
        self.last_active
    }

    /// Records that bytes were received or sent.
    pub const fn moved(&mut self, now: Instant) {
        self.last_active = now;
    }

    /// Records that the session has run a request. The time limit of the next request starts anew.
    pub const fn ran(&mut self) {
        self.partial_since = None;
    }

    /// Returns when the session must be polled again; `None` if only bytes are a reason.
    ///
    /// # Errors
    ///
    /// The limit that the session has exceeded. The server must close the connection.
    pub fn deadline<S: ServerEndpoint + ?Sized>(
        &mut self,
        session: &S,
        limits: TimeLimits,
        now: Instant,
    ) -> Result<Option<Instant>, Exceeded> {
        self.partial_since = session.is_receiving().then(|| self.partial_since.unwrap_or(now));
        let partial = self.partial_since.map(|since| since.saturating_add(limits.receive));
        if partial.is_some_and(|until| now >= until) {
            return Err(Exceeded::Receive);
        }
        let idle = limits.idle.filter(|_| !session.is_running()).map(|idle| self.last_active.saturating_add(idle));
        if idle.is_some_and(|until| now >= until) {
            return Err(Exceeded::Idle);
        }
        Ok(earliest(session.poll_timeout(), earliest(partial, idle)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rac::server::{Config, Session};

    const LIMITS: TimeLimits =
        TimeLimits { receive: Duration::from_millis(30), idle: Some(Duration::from_millis(100)) };

    fn at(millis: u64) -> Instant {
        Instant::from_millis(millis)
    }

    fn receive(session: &mut Session<[u8; 64]>, bytes: &[u8]) {
        use crate::endpoint::Endpoint as _;
        session.receive_buffer().get_mut(..bytes.len()).expect("room").copy_from_slice(bytes);
        session.received(bytes.len());
    }

    #[test]
    fn silence_and_a_partial_request_have_separate_limits() {
        let mut session = Session::new(Config::TCP, [0; 64]);
        let mut times = StreamTimes::new(at(0));
        assert_eq!(times.deadline(&session, LIMITS, at(10)), Ok(Some(at(100))));
        assert_eq!(times.deadline(&session, TimeLimits { idle: None, ..LIMITS }, at(1000)), Ok(None));
        receive(&mut session, b"GE");
        times.moved(at(90));
        assert_eq!(times.deadline(&session, LIMITS, at(90)), Ok(Some(at(120))), "30 ms for the rest");
        times.moved(at(110));
        assert_eq!(times.deadline(&session, LIMITS, at(110)), Ok(Some(at(120))), "more bytes do not extend it");
        assert_eq!(times.deadline(&session, LIMITS, at(120)), Err(Exceeded::Receive));
        times.ran();
        assert_eq!(times.deadline(&session, LIMITS, at(120)), Ok(Some(at(150))), "the next request starts anew");
        let session = Session::new(Config::TCP, [0; 64]);
        assert_eq!(times.deadline(&session, LIMITS, at(210)), Err(Exceeded::Idle));
    }
}
