//! The interface of a procedure, and its actions.

use super::failure::Failure;
use crate::bcap::call::Call;
use crate::bcap::client::Timing;
use crate::bcap::{Frame, Link};
use crate::time::Instant;

/// A sequence of calls.
pub trait Procedure {
    /// The result of a success.
    type Output;
    /// The error of a failure.
    type Error;

    /// Returns the next action. If it is a call, `now` is the time of sending.
    ///
    /// [`Action::Done`] is returned once; a procedure that is polled after that may return anything.
    fn poll(&mut self, now: Instant) -> Action<Result<Self::Output, Self::Error>>;

    /// Returns the call that [`poll`](Self::poll) has requested, until its reply or failure is passed in.
    fn request(&self) -> Option<impl Call>;

    /// Returns the timing of that call, given the usual timing of the connection.
    fn timing(&self, link: Link, usual: Timing) -> Timing {
        let _ = link;
        usual
    }

    /// Handles the reply to the call, also one with an error code.
    fn handle_reply(&mut self, reply: &Frame<'_>, now: Instant);

    /// Records that the call has no reply. Whether the controller has executed it is unknown, except after
    /// [`Failure::NotSent`].
    fn handle_failure(&mut self, failure: Failure, now: Instant);
}

impl<P: Procedure + ?Sized> Procedure for &mut P {
    type Output = P::Output;
    type Error = P::Error;

    fn poll(&mut self, now: Instant) -> Action<Result<Self::Output, Self::Error>> {
        (**self).poll(now)
    }

    fn request(&self) -> Option<impl Call> {
        (**self).request()
    }

    fn timing(&self, link: Link, usual: Timing) -> Timing {
        (**self).timing(link, usual)
    }

    fn handle_reply(&mut self, reply: &Frame<'_>, now: Instant) {
        (**self).handle_reply(reply, now);
    }

    fn handle_failure(&mut self, failure: Failure, now: Instant) {
        (**self).handle_failure(failure, now);
    }
}

/// The next action of a procedure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Action<T> {
    /// Make the call of [`Procedure::request`], and pass in its reply or failure. Until then, this action is repeated.
    Call(Channel),
    /// Poll again at this time.
    Wait(Instant),
    /// The procedure has ended.
    Done(T),
}

/// The connection for a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Channel {
    /// The first connection; most procedures use no other.
    Motion,
    /// A second connection, for queries while the first is busy. Without one, the call uses the first.
    Watch,
}
