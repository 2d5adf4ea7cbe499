//! What the server sessions of both protocols have in common, for those who run them.
//!
//! Whoever moves the bytes of a link need not know which protocol they are of: the adapters' loops are written once, over
//! [`Session`].

use core::fmt::Debug;

use crate::handler::PeerId;
use crate::storage::Storage;
use crate::time::Instant;
use crate::{bcap, rac};

/// A session of b-CAP or RAC, with a handler `H` behind it.
pub trait Session<H: ?Sized> {
    /// What it reports of a step.
    type Event: Debug;

    /// Returns memory for bytes that arrive; empty while there is no room.
    fn receive_buffer(&mut self) -> &mut [u8];

    /// Takes note of bytes that have been put there.
    fn received(&mut self, count: usize);

    /// Returns the bytes that are to be sent.
    fn transmit(&self) -> &[u8];

    /// Takes note of bytes that were sent.
    fn transmitted(&mut self, count: usize);

    /// Returns when [`run`](Self::run) is to be called even if no bytes come.
    fn poll_timeout(&self) -> Option<Instant>;

    /// Tells whether a request runs.
    fn is_running(&self) -> bool;

    /// Tells whether part of a request has come and its rest has not.
    fn is_receiving(&self) -> bool;

    /// Returns the length in bytes of the request that the next call of [`run`](Self::run) decodes; 0 without one.
    fn next_request(&self) -> usize;

    /// Tells whether the session is over and the link is to be closed.
    fn is_finished(&self) -> bool;

    /// Returns the bytes of memory that it has, both ways together.
    fn memory(&self) -> usize;

    /// Gives back memory over `room` bytes each way, unless something is in it.
    fn shrink(&mut self, room: usize);

    /// Goes a step on and says what was done; `None` when bytes must come, leave, or time pass.
    fn run(&mut self, handler: &mut H, peer: PeerId, now: Instant) -> Option<Self::Event>;

    /// Ends the session and tells the handler.
    fn close(&mut self, handler: &mut H, peer: PeerId, now: Instant);
}

/// The methods that both sessions have under the same names.
macro_rules! session {
    ($session:path, $handler:ident) => {
        fn receive_buffer(&mut self) -> &mut [u8] {
            <$session>::receive_buffer(self)
        }

        fn received(&mut self, count: usize) {
            <$session>::received(self, count);
        }

        fn transmit(&self) -> &[u8] {
            <$session>::transmit(self)
        }

        fn transmitted(&mut self, count: usize) {
            <$session>::transmitted(self, count);
        }

        fn poll_timeout(&self) -> Option<Instant> {
            <$session>::poll_timeout(self)
        }

        fn is_running(&self) -> bool {
            <$session>::is_running(self)
        }

        fn is_receiving(&self) -> bool {
            <$session>::is_receiving(self)
        }

        fn memory(&self) -> usize {
            <$session>::memory(self)
        }

        fn shrink(&mut self, room: usize) {
            <$session>::shrink(self, room);
        }

        fn run(&mut self, handler: &mut $handler, peer: PeerId, now: Instant) -> Option<Self::Event> {
            <$session>::run(self, handler, peer, now)
        }

        fn close(&mut self, handler: &mut $handler, peer: PeerId, now: Instant) {
            <$session>::close(self, handler, peer, now);
        }
    };
}

impl<H, T, R, const OBJECTS: usize> Session<H> for bcap::server::Session<T, R, OBJECTS>
where
    H: bcap::server::Handler + ?Sized,
    T: Storage,
    R: Storage,
{
    type Event = bcap::server::Event;

    fn next_request(&self) -> usize {
        self.next_request()
    }

    fn is_finished(&self) -> bool {
        self.is_finished()
    }

    session!(bcap::server::Session<T, R, OBJECTS>, H);
}

impl<H, V> Session<H> for rac::server::Session<V>
where
    H: rac::server::Handler + ?Sized,
    V: Storage,
{
    type Event = rac::server::Event;

    fn next_request(&self) -> usize {
        // lines are short
        0
    }

    fn is_finished(&self) -> bool {
        // a line that is none costs an answer, never the session
        false
    }

    session!(rac::server::Session<V>, H);
}
