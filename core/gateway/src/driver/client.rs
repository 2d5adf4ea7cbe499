//! The slots of clients.

use bcap_core::handler::PeerId;
use bcap_core::time::Instant;

use super::notify::Notify;

/// The slot of a client, in the memory of a [`Platform`](super::Platform).
#[derive(Debug)]
pub struct Client<A> {
    pub(super) holder: Option<Holder<A>>,
    pub(super) notify: Notify,
}

/// The client in a slot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Holder<A> {
    pub(super) peer: PeerId,
    pub(super) address: A,
    /// The time of its connection, or of the last bytes from it or to it.
    pub(super) last_active: Instant,
    /// Whether its front is busy.
    pub(super) is_busy: bool,
}

impl<A> Default for Client<A> {
    fn default() -> Self {
        Self { holder: None, notify: Notify::default() }
    }
}
