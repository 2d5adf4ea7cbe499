//! The peers of a b-CAP server over UDP, without I/O: their sessions, by address.
//!
//! ```text
//!  datagram ─► receive ─┬─► the session of its sender ─► Peer::step, Peer::transmit ─► reply
//!                       └─► Refused: E_MAX_CONNECT, if a valid frame of a new peer gets no slot
//! ```
//!
//! A datagram of an unknown sender that is not a valid frame takes no slot and gets no answer, so a forged sender address gains
//! nothing.

use super::{Admission, Holder, SlotState, Slots};
use crate::bcap::Decoder;
use crate::bcap::server::{Config, Session};
use crate::endpoint::{Endpoint, ServerEndpoint};
use crate::handler::PeerId;
use crate::limits::{UDP_RECEIVE_MAX, UDP_SEND_MAX};
use crate::time::Instant;

/// Bytes for a running request and one that arrives during it.
const RECEIVE_BUFFER: usize = 2 * UDP_RECEIVE_MAX;

/// The session of a peer with up to `OBJECTS` handles.
pub type UdpSession<const OBJECTS: usize> = Session<[u8; UDP_SEND_MAX], [u8; RECEIVE_BUFFER], OBJECTS>;

/// The state that the peers of a server share: the handler and the numbers of peers.
pub trait SharedState<S> {
    /// The address of a peer.
    type Address: Copy + PartialEq;

    /// Returns whether two peers are on one host.
    fn is_same_host(one: Self::Address, other: Self::Address) -> bool;

    /// Returns the number of a new peer.
    fn connect(&self, address: Self::Address) -> PeerId;

    /// Performs one step of a session with the handler; returns whether it made progress.
    fn step(&self, session: &mut S, peer: PeerId, now: Instant) -> bool;

    /// Ends a session, and notifies the handler that the peer left.
    fn close(&self, session: &mut S, peer: PeerId, now: Instant);
}

/// A peer with its session: about 1.6 KiB, and 8 bytes for each of its `OBJECTS`.
#[derive(Debug)]
pub struct Peer<A, const OBJECTS: usize> {
    address: A,
    id: PeerId,
    last_received: Instant,
    session: UdpSession<OBJECTS>,
}

impl<A: Copy, const OBJECTS: usize> Peer<A, OBJECTS> {
    /// Returns its address.
    #[must_use]
    pub const fn address(&self) -> A {
        self.address
    }

    /// Returns its number.
    #[must_use]
    pub const fn id(&self) -> PeerId {
        self.id
    }

    /// Returns when its last datagram arrived.
    #[must_use]
    pub const fn last_received(&self) -> Instant {
        self.last_received
    }

    /// Returns whether a request runs.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.session.is_running()
    }

    /// Returns when it must be run again even if no datagram arrives.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.session.poll_timeout()
    }

    /// Performs one step of its session; returns whether it made progress. Send the pending bytes after each step.
    pub fn step(&mut self, shared: &impl SharedState<UdpSession<OBJECTS>>, now: Instant) -> bool {
        shared.step(&mut self.session, self.id, now)
    }

    /// Returns the datagram to send.
    #[must_use]
    pub fn transmit(&self) -> &[u8] {
        self.session.transmit()
    }

    /// Records that the datagram was sent, or that it is lost.
    pub fn transmitted(&mut self) {
        self.session.transmitted(usize::MAX);
    }

    /// Ends its session.
    pub fn close(&mut self, shared: &impl SharedState<UdpSession<OBJECTS>>, now: Instant) {
        shared.close(&mut self.session, self.id, now);
    }

    /// A peer has a service from Service_Start to Service_Stop. Without one it is kept only to answer retransmissions.
    fn state(&self) -> SlotState {
        if self.session.is_running() {
            SlotState::Busy
        } else if self.session.open_objects() == 0 {
            SlotState::Over
        } else {
            SlotState::Idle(self.last_received)
        }
    }
}

/// The outcome of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// It was passed to the peer in this slot, which must be run.
    Passed(usize),
    /// It is the first datagram of a peer for which there is no slot. Answer it with the [`refusal`](super::refusal) for this
    /// serial.
    Refused(u16),
    /// It is not a valid frame, or the buffer of its peer is full: the peer retransmits it.
    Dropped,
}

/// Passes a datagram to the session of its sender, which is created if `rules` give it a slot.
pub fn receive<H: SharedState<UdpSession<OBJECTS>>, const OBJECTS: usize>(
    peers: &mut [Option<Peer<H::Address, OBJECTS>>],
    (bytes, from): (&[u8], H::Address),
    (rules, config): (&Slots, Config),
    shared: &H,
    now: Instant,
) -> Received {
    let is_sender = |slot: &Option<Peer<H::Address, OBJECTS>>| slot.as_ref().is_some_and(|peer| peer.address == from);
    let index = match peers.iter().position(is_sender) {
        Some(index) => index,
        None => {
            let Ok(frame) = Decoder::UDP.decode_datagram(bytes) else { return Received::Dropped };
            match open(peers, from, (rules, config), shared, now) {
                Some(index) => index,
                None => return Received::Refused(frame.serial),
            }
        }
    };
    let Some(Some(peer)) = peers.get_mut(index) else { return Received::Dropped };
    peer.last_received = now;
    match peer.session.receive_buffer().get_mut(..bytes.len()) {
        Some(room) => {
            room.copy_from_slice(bytes);
            peer.session.received(bytes.len());
            Received::Passed(index)
        }
        None => Received::Dropped,
    }
}

/// Creates a session in a free slot, or in the slot of the peer that `rules` name; returns the slot.
///
/// Not inlined: otherwise the temporary session would take stack or future memory while datagrams are received.
#[inline(never)]
fn open<H: SharedState<UdpSession<OBJECTS>>, const OBJECTS: usize>(
    peers: &mut [Option<Peer<H::Address, OBJECTS>>],
    address: H::Address,
    (rules, config): (&Slots, Config),
    shared: &H,
    now: Instant,
) -> Option<usize> {
    let taken = peers.iter().enumerate().filter_map(|(key, slot)| {
        let peer = slot.as_ref()?;
        Some(Holder { key, is_same_host: H::is_same_host(peer.address, address), state: peer.state() })
    });
    let index = match rules.admit(taken, now) {
        Admission::Free => peers.iter().position(Option::is_none)?,
        Admission::Instead(index) => index,
        Admission::Refused => return None,
    };
    let slot = peers.get_mut(index)?;
    if let Some(old) = slot {
        old.close(shared, now);
    }
    let session = Session::new(config, [0; UDP_SEND_MAX], [0; RECEIVE_BUFFER]);
    *slot = Some(Peer { address, id: shared.connect(address), last_received: now, session });
    Some(index)
}

#[cfg(test)]
mod tests {
    use core::cell::{Cell, RefCell};
    use core::time::Duration;

    use super::*;
    use crate::bcap::server::{Handler, Request};
    use crate::bcap::{FrameWriter, FunctionId};
    use crate::handler::{Outcome, ReplyValue};
    use crate::hresult::HResult;

    /// Counts the peers that have left.
    struct Answer {
        left: usize,
    }

    impl Handler for Answer {
        fn call(&mut self, _: PeerId, _: &Request<'_>, _: &mut ReplyValue<'_>, _: Instant) -> Outcome {
            HResult::S_OK.into()
        }

        fn left(&mut self, _: PeerId, _: Instant) {
            self.left = self.left.saturating_add(1);
        }
    }

    struct Bench {
        handler: RefCell<Answer>,
        next: Cell<u32>,
    }

    impl<const OBJECTS: usize> SharedState<UdpSession<OBJECTS>> for Bench {
        type Address = (u8, u8);

        fn is_same_host(one: (u8, u8), other: (u8, u8)) -> bool {
            one.0 == other.0
        }

        fn connect(&self, _: (u8, u8)) -> PeerId {
            self.next.set(self.next.get().saturating_add(1));
            PeerId(self.next.get())
        }

        fn step(&self, session: &mut UdpSession<OBJECTS>, peer: PeerId, now: Instant) -> bool {
            use crate::endpoint::Serve as _;
            session.run(&mut *self.handler.borrow_mut(), peer, now).is_some()
        }

        fn close(&self, session: &mut UdpSession<OBJECTS>, peer: PeerId, now: Instant) {
            use crate::endpoint::Serve as _;
            session.close(&mut *self.handler.borrow_mut(), peer, now);
        }
    }

    const RULES: Slots = Slots { total: 2, per_host: 2, evict_after: Some(Duration::from_secs(10)) };

    #[test]
    fn a_datagram_reaches_the_session_of_its_sender_and_slots_are_given_by_the_rules() {
        let bench = Bench { handler: RefCell::new(Answer { left: 0 }), next: Cell::new(0) };
        let mut peers: [Option<Peer<(u8, u8), 4>>; 2] = [None, None];
        let mut buffer = [0; 64];
        let start = FrameWriter::new(&mut buffer).expect("room");
        let start = start.finish(5, 0, FunctionId::SERVICE_START.0).expect("room");
        let mut receive = |bytes: &[u8], from, secs: u64| {
            let now = Instant::from_millis(secs.saturating_mul(1000));
            let received = super::receive(&mut peers, (bytes, from), (&RULES, Config::UDP), &bench, now);
            if let Received::Passed(index) = received
                && let Some(Some(peer)) = peers.get_mut(index)
            {
                while peer.step(&bench, now) {}
                assert_eq!((peer.address(), peer.last_received()), (from, now));
                peer.transmitted();
            }
            received
        };
        assert_eq!(receive(b"no frame", (1, 0), 0), Received::Dropped, "it takes no slot");
        assert_eq!(receive(start, (1, 0), 0), Received::Passed(0));
        assert_eq!(receive(start, (2, 0), 1), Received::Passed(1));
        assert_eq!(receive(start, (1, 0), 2), Received::Passed(0));
        assert_eq!(receive(start, (3, 0), 10), Received::Refused(5), "no peer was idle for 10 s");
        assert_eq!(bench.handler.borrow().left, 0);
        assert_eq!(receive(start, (1, 1), 13), Received::Passed(0), "a peer of the same host is replaced first");
        assert_eq!(receive(start, (3, 0), 13), Received::Passed(1));
        assert_eq!((bench.handler.borrow().left, bench.next.get()), (2, 4));
    }
}
