//! What a procedure is, and what it wants.

use super::failure::Failure;
use crate::bcap::call::Call;
use crate::bcap::client::Timing;
use crate::bcap::{Frame, Link};
use crate::time::Instant;

/// A sequence of calls.
pub trait Procedure {
    /// What it returns when it is done.
    type Output;
    /// Why it fails.
    type Error;

    /// Returns what to do next. The time counts as that of sending when this is a call.
    ///
    /// [`Action::Done`] is returned once; a procedure that is polled after that may return anything.
    fn poll(&mut self, now: Instant) -> Action<Result<Self::Output, Self::Error>>;

    /// Returns the call that [`poll`](Self::poll) has asked for, until its reply or failure is handed in.
    fn request(&self) -> Option<impl Call>;

    /// Returns the timing of that call, given the usual timing of the connection.
    fn timing(&self, link: Link, usual: Timing) -> Timing {
        let _ = link;
        usual
    }

    /// Takes the reply to the call, whatever its code.
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

/// What a procedure wants next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Action<T> {
    /// Make the call of [`Procedure::request`], and hand its reply or failure in. Until then this is repeated.
    Call(Channel),
    /// Poll again at this time.
    Wait(Instant),
    /// The procedure has ended.
    Done(T),
}

/// Which connection a call goes over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Channel {
    /// The first one; most procedures use no other.
    Motion,
    /// A second one, which watches while the first is busy. Without one, the call goes over the first.
    Watch,
}
