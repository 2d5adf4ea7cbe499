//! What the sessions of both protocols have in common.

use bcap_core::handler::PeerId;
use bcap_core::storage::Storage;
use bcap_core::time::Instant;
use bcap_core::{bcap, rac};

/// A session of b-CAP or RAC, with a handler `H` behind it.
pub trait Session<H: ?Sized> {
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

    /// Tells whether the session is over and the link is to be closed.
    fn is_finished(&self) -> bool;

    /// Goes a step on; `false` when bytes must come, leave, or time pass.
    fn run(&mut self, handler: &mut H, peer: PeerId, now: Instant) -> bool;

    /// Ends the session and tells the handler.
    fn close(&mut self, handler: &mut H, peer: PeerId, now: Instant);
}

impl<H, T, R, const OBJECTS: usize> Session<H> for bcap::server::Session<T, R, OBJECTS>
where
    H: bcap::server::Handler + ?Sized,
    T: Storage,
    R: Storage,
{
    fn receive_buffer(&mut self) -> &mut [u8] {
        self.receive_buffer()
    }

    fn received(&mut self, count: usize) {
        self.received(count);
    }

    fn transmit(&self) -> &[u8] {
        self.transmit()
    }

    fn transmitted(&mut self, count: usize) {
        self.transmitted(count);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.poll_timeout()
    }

    fn is_running(&self) -> bool {
        self.is_running()
    }

    fn is_receiving(&self) -> bool {
        self.is_receiving()
    }

    fn is_finished(&self) -> bool {
        self.is_finished()
    }

    fn run(&mut self, handler: &mut H, peer: PeerId, now: Instant) -> bool {
        self.run(handler, peer, now).is_some()
    }

    fn close(&mut self, handler: &mut H, peer: PeerId, now: Instant) {
        self.close(handler, peer, now);
    }
}

impl<H, V> Session<H> for rac::server::Session<V>
where
    H: rac::server::Handler + ?Sized,
    V: Storage,
{
    fn receive_buffer(&mut self) -> &mut [u8] {
        self.receive_buffer()
    }

    fn received(&mut self, count: usize) {
        self.received(count);
    }

    fn transmit(&self) -> &[u8] {
        self.transmit()
    }

    fn transmitted(&mut self, count: usize) {
        self.transmitted(count);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.poll_timeout()
    }

    fn is_running(&self) -> bool {
        self.is_running()
    }

    fn is_receiving(&self) -> bool {
        self.is_receiving()
    }

    fn is_finished(&self) -> bool {
        // a line that is none costs an answer, never the session
        false
    }

    fn run(&mut self, handler: &mut H, peer: PeerId, now: Instant) -> bool {
        self.run(handler, peer, now).is_some()
    }

    fn close(&mut self, handler: &mut H, peer: PeerId, now: Instant) {
        self.close(handler, peer, now);
    }
}
