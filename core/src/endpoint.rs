//! What the clients and the sessions of both protocols have in common, for code that moves their bytes.
//!
//! ```text
//!  link ──► receive_buffer, received ──► Endpoint ──► transmit, transmitted ──► link
//!                                           └──► poll_timeout: when to call it again without bytes
//! ```
//!
//! | trait              | implemented by                                     | used by                             |
//! |--------------------|----------------------------------------------------|-------------------------------------|
//! | [`Endpoint`]       | both clients and both sessions                     | any loop that moves bytes           |
//! | [`ServerEndpoint`] | both sessions                                      | servers that watch over many of them |
//! | [`Serve`]          | both sessions, with a handler of their protocol    | servers that run them               |

use core::fmt::Debug;

use crate::handler::PeerId;
use crate::time::Instant;

/// One end of a link, without the link: bytes go in and out, and it says when it must be called again.
pub trait Endpoint {
    /// Returns memory for bytes that arrive; with datagrams, for one of them. What was read before is gone then.
    ///
    /// It is empty while there is no room: then a stream's bytes must wait, and datagrams be dropped.
    #[must_use]
    fn receive_buffer(&mut self) -> &mut [u8];

    /// Records that `count` bytes were put into [`receive_buffer`](Self::receive_buffer).
    fn received(&mut self, count: usize);

    /// Returns the bytes that are to be sent: one datagram, or the rest of a frame or line for a stream.
    #[must_use]
    fn transmit(&self) -> &[u8];

    /// Records that the link has taken `count` bytes of [`transmit`](Self::transmit).
    fn transmitted(&mut self, count: usize);

    /// Returns when it must be called even if no bytes arrive; `None` while nothing is waited for.
    #[must_use]
    fn poll_timeout(&self) -> Option<Instant>;
}

/// A server's session with one peer.
pub trait ServerEndpoint: Endpoint {
    /// Tells whether a request runs that its handler has not answered.
    #[must_use]
    fn is_running(&self) -> bool;

    /// Tells whether part of a request has arrived and its rest has not.
    #[must_use]
    fn is_receiving(&self) -> bool;

    /// Returns the length in bytes of the request that the next call of [`run`](Serve::run) decodes; 0 without one.
    ///
    /// The time of that call grows with this length, so a server of many peers can give a large one to another thread.
    #[must_use]
    fn next_request(&self) -> usize;

    /// Tells whether the session is over: everything is sent, and the link is to be closed.
    #[must_use]
    fn is_finished(&self) -> bool;

    /// Returns the bytes of memory that it has, both ways together.
    #[must_use]
    fn memory(&self) -> usize;

    /// Releases memory above `room` bytes each way, unless something is in it.
    ///
    /// A copy of the last call is not answered after that, if its reply was larger.
    fn shrink(&mut self, room: usize);
}

/// A session that a handler of type `H` can answer.
pub trait Serve<H: ?Sized>: ServerEndpoint {
    /// What it reports of a step.
    type Event: Debug;

    /// Performs one step and says what was done; `None` when bytes must arrive, leave, or time pass. Call it until then.
    fn run(&mut self, handler: &mut H, peer: PeerId, now: Instant) -> Option<Self::Event>;

    /// Ends the session: abandons what runs, releases the peer's objects in reverse order, and tells the handler.
    fn close(&mut self, handler: &mut H, peer: PeerId, now: Instant);
}
