//! The slots of clients.

use bcap_core::handler::PeerId;
use bcap_core::peers::SlotState;
use bcap_core::time::Instant;

use super::notify::Notify;
use crate::Gateway;

/// The slot of a client, in the memory of a [`Platform`](super::Platform).
#[derive(Debug)]
pub struct Client<A> {
    pub(super) connected: Option<Connected<A>>,
    pub(super) notify: Notify,
}

/// The client in a slot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Connected<A> {
    pub(super) peer: PeerId,
    pub(super) address: A,
    /// The time of its connection, or of the last bytes from it or to it.
    pub(super) last_active: Instant,
    /// Whether it waits for an answer or receives it.
    pub(super) is_busy: bool,
}

impl<A> Connected<A> {
    /// A client that waits for an answer or receives it keeps its slot.
    pub(super) fn state(&self, gateway: &Gateway<'_>) -> SlotState {
        if self.is_busy || gateway.is_running(self.peer) || !gateway.transmit(self.peer).is_empty() {
            SlotState::Busy
        } else {
            SlotState::Idle(self.last_active)
        }
    }
}

impl<A> Default for Client<A> {
    fn default() -> Self {
        Self { connected: None, notify: Notify::default() }
    }
}
