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
        // a panic of the caller's encoder or conversion leaves the limit of the call before
        self.session.set_limit(None);
        self.session
    }

    /// Runs calls within the time limit.
    pub(super) fn run<T>(&mut self, calls: impl AsyncFnOnce(&mut Session<Blocking>) -> T) -> T {
        self.session.set_limit(self.limit);
        let ended = ready(calls(self.session));
        self.session.set_limit(None);
        ended
    }
}
