//! The common interface of the clients and sessions of both protocols, for code that moves their bytes.
//!
//! ```text
//!  link ──► receive_buffer, received ──► Endpoint ──► transmit, transmitted ──► link
//!                                           └──► poll_timeout: when to call it again without bytes
//! ```
//!
//! | trait              | implemented by                                     | used by                             |
//! |--------------------|----------------------------------------------------|-------------------------------------|
//! | [`Endpoint`]       | both clients and both sessions                     | any loop that moves bytes           |
//! | [`ServerEndpoint`] | both sessions                                      | servers that manage many sessions   |
//! | [`Serve`]          | both sessions, with a handler of their protocol    | servers that run them               |

use core::fmt::Debug;

use crate::handler::PeerId;
use crate::time::Instant;

/// One end of a link as a sans-IO state machine: it takes and returns bytes, and reports its next timeout.
pub trait Endpoint {
    /// Returns memory for received bytes; for datagrams, for one datagram. Drops the frames that were read before.
    ///
    /// An empty slice means that there is no room: the caller must leave the bytes of a stream unread, and drop datagrams.
    #[must_use]
    fn receive_buffer(&mut self) -> &mut [u8];

    /// Records that `count` bytes were put into [`receive_buffer`](Self::receive_buffer).
    fn received(&mut self, count: usize);

    /// Returns the bytes to send: one datagram, or the rest of a frame or line for a stream.
    #[must_use]
    fn transmit(&self) -> &[u8];

    /// Records that the link has taken `count` bytes of [`transmit`](Self::transmit).
    fn transmitted(&mut self, count: usize);

    /// Returns when it must be called even if no bytes arrive; `None` without a timeout.
    #[must_use]
    fn poll_timeout(&self) -> Option<Instant>;
}

/// A server's session with one peer.
pub trait ServerEndpoint: Endpoint {
    /// Returns whether a request runs, which the handler has not completed.
    #[must_use]
    fn is_running(&self) -> bool;

    /// Returns whether part of a request has arrived and its rest has not.
    #[must_use]
    fn is_receiving(&self) -> bool;

    /// Returns the length in bytes of the request that the next call of [`run`](Serve::run) decodes; 0 without one.
    ///
    /// The time of that call grows with this length, so a server of many peers can give a large one to another thread.
    #[must_use]
    fn next_request(&self) -> usize;

    /// Returns whether the session has ended: everything is sent, and the caller must close the link.
    #[must_use]
    fn is_finished(&self) -> bool;

    /// Returns the size of both buffers together, in bytes.
    #[must_use]
    fn memory(&self) -> usize;

    /// Releases memory above `room` bytes in each buffer, unless the buffers are in use.
    ///
    /// If the last reply was larger than that, the session cannot send it again for a copy of its call.
    fn shrink(&mut self, room: usize);
}

/// A session whose requests a handler of type `H` can execute.
pub trait Serve<H: ?Sized>: ServerEndpoint {
    /// The event of a step.
    type Event: Debug;

    /// Performs one step and returns its event; `None` when bytes must be received or sent, or time must pass.
    ///
    /// The caller repeats it until it returns `None`.
    fn run(&mut self, handler: &mut H, peer: PeerId, now: Instant) -> Option<Self::Event>;

    /// Ends the session: abandons the running call, releases the peer's objects in reverse order, and notifies the handler.
    fn close(&mut self, handler: &mut H, peer: PeerId, now: Instant);
}
