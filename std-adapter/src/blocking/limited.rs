//! The calls of a session within a time limit.

use std::time::Duration;

use super::socket::{Blocking, ready};
use crate::session::Session;

/// A session that is borrowed, and the time limit of each call over it.
#[derive(Debug)]
pub(super) struct Limited<'a> {
    session: &'a mut Session<Blocking>,
    limit: Option<Duration>,
}

impl<'a> Limited<'a> {
    pub(super) const fn new(session: &'a mut Session<Blocking>) -> Self {
        Self { session, limit: None }
    }

    pub(super) const fn within(mut self, limit: Duration) -> Self {
        self.limit = Some(limit);
        self
    }

    pub(super) const fn unlimited(mut self) -> Self {
        self.limit = None;
        self
    }

    /// Returns the session, for calls without the time limit.
    pub(super) fn session(&mut self) -> &mut Session<Blocking> {
        self.session
    }

    /// Runs calls within the time limit.
    pub(super) fn run<T>(&mut self, calls: impl AsyncFnOnce(&mut Session<Blocking>) -> T) -> T {
        self.session.set_limit(self.limit);
        let reset = &mut Reset(self.session);
        ready(calls(reset.0))
    }
}

/// Removes the time limit at the end of the calls, even if the caller's encoder or conversion panics.
struct Reset<'a>(&'a mut Session<Blocking>);

impl Drop for Reset<'_> {
    fn drop(&mut self) {
        self.0.set_limit(None);
    }
}
