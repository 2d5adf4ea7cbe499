//! The PLC side of a gateway: sessions.

use core::cell::Cell;
use core::net::SocketAddrV4;

use bcap_core::handler::PeerId;
use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Timer;

use super::SharedGateway;
use crate::server::{Ended, Limits};

/// The size of the buffer through which bytes move; most lines are shorter.
pub(super) const CHUNK: usize = 64;

/// How long a client waits for the slot of an evicted one: this many pauses of this length.
const SLOT_TRIES: u32 = 100;
const SLOT_PAUSE_MS: u64 = 10;

/// Serves one PLC until its session ends, and returns the reason; `None` when all slots are in use.
///
/// When all slots are in use, it first ends the session of the client that has been idle for the longest time, at least
/// [`Limits::evict_after`], preferably one with the same address.
///
/// `client` is the PLC's address, for the log.
///
/// # Cancel safety
///
/// Dropping the future frees the slot and leaves the transport open.
pub async fn serve<X: Transport, M: RawMutex, const N: usize>(
    transport: &mut X,
    client: Option<SocketAddrV4>,
    shared: &SharedGateway<'_, M, N>,
    limits: &Limits,
) -> Option<Ended<X::Error>> {
    let slot = ClientSlot { peer: open(client, shared, limits).await?, shared, ended: Cell::new(None) };
    let ended = run_session(transport, &slot, limits).await.unwrap_or_else(Ended::Failed);
    slot.ended.set(Some(ended.reason()));
    Some(ended)
}

/// Opens a session, if need be in the slot of an idle client.
async fn open<M: RawMutex, const N: usize>(
    client: Option<SocketAddrV4>,
    shared: &SharedGateway<'_, M, N>,
    limits: &Limits,
) -> Option<PeerId> {
    if let Some(peer) = shared.open(client) {
        return Some(peer);
    }
    if !shared.evict(client, limits.evict_after?) {
        return None;
    }
    // the task of the evicted client frees its slot
    for _ in 0..SLOT_TRIES {
        Timer::after_millis(SLOT_PAUSE_MS).await;
        if let Some(peer) = shared.open(client) {
            return Some(peer);
        }
    }
    None
}

/// A client's slot in the gateway; dropping it frees the slot.
struct ClientSlot<'a, 'm, M: RawMutex, const N: usize> {
    peer: PeerId,
    shared: &'a SharedGateway<'m, M, N>,
    ended: Cell<Option<Ended<()>>>,
}

impl<M: RawMutex, const N: usize> Drop for ClientSlot<'_, '_, M, N> {
    fn drop(&mut self) {
        self.shared.close(self.peer, self.ended.get());
    }
}

/// The next step of a session.
enum Next {
    /// Send this number of bytes to the client.
    Send(usize),
    /// Receive up to this number of bytes; 0 while an answer is outstanding.
    Receive(usize),
}

/// Moves lines and answers until the session ends.
async fn run_session<X: Transport, M: RawMutex, const N: usize>(
    transport: &mut X,
    slot: &ClientSlot<'_, '_, M, N>,
    limits: &Limits,
) -> Result<Ended<X::Error>, X::Error> {
    let ClientSlot { peer, shared, .. } = *slot;
    let mut chunk = [0; CHUNK];
    let mut last_received = transport.now();
    // the arrival of the first byte of a partial line, and the start of sending an answer that is not yet accepted
    let (mut partial, mut unread) = (None, None);
    loop {
        shared.poll_for_client();
        if shared.is_evicted(peer) {
            return Ok(Ended::Evicted);
        }
        let now = transport.now();
        match next(slot, &mut chunk) {
            Next::Send(count) => {
                // a line was complete, so the timeout for a following partial line starts now
                partial = None;
                let until = unread.get_or_insert(now).saturating_add(limits.send);
                let answer = chunk.get(..count).unwrap_or_default();
                match transport.send(answer, until).await? {
                    Some(sent) => shared.with(|inner| inner.transmitted(peer, sent)),
                    None => return Ok(Ended::ReplyNotRead),
                };
                // one line a turn, so a client that sends many lines at once does not slow the others
                yield_now().await;
            }
            Next::Receive(room) => {
                unread = None;
                let receiving = shared.view(|gateway| gateway.is_receiving(peer)).unwrap_or_default();
                partial = (receiving || transport.is_receiving()).then(|| partial.unwrap_or(now));
                let late = partial.map(|since: Instant| since.saturating_add(limits.receive));
                let idle = limits.idle.filter(|_| room > 0).map(|idle| last_received.saturating_add(idle));
                let until = late.into_iter().chain(idle).min().unwrap_or(Instant::FAR_FUTURE);
                if now >= until {
                    return Ok(if late.is_some_and(|late| now >= late) { Ended::RequestTooSlow } else { Ended::Idle });
                }
                let room = chunk.get_mut(..room).unwrap_or_default();
                match wait_for_bytes(transport, room, until, slot).await? {
                    Some(0) => return Ok(Ended::Closed),
                    Some(count) => {
                        last_received = transport.now();
                        received(slot, chunk.get(..count).unwrap_or_default());
                    }
                    None => {}
                }
            }
        }
    }
}

/// Chooses the next step of a session; copies bytes to send into `chunk`.
fn next<M: RawMutex, const N: usize>(slot: &ClientSlot<'_, '_, M, N>, chunk: &mut [u8; CHUNK]) -> Next {
    let next = slot.shared.with(|inner| {
        let mut count = 0;
        for (to, from) in chunk.iter_mut().zip(inner.gateway.transmit(slot.peer)) {
            *to = *from;
            count += 1;
        }
        match count {
            0 => Next::Receive(inner.gateway.receive_buffer(slot.peer).len().min(CHUNK)),
            count => Next::Send(count),
        }
    });
    next.unwrap_or(Next::Receive(0))
}

/// Waits for bytes, for `until`, or for an event that concerns the client.
async fn wait_for_bytes<X: Transport, M: RawMutex, const N: usize>(
    transport: &mut X,
    room: &mut [u8],
    until: Instant,
    slot: &ClientSlot<'_, '_, M, N>,
) -> Result<Option<usize>, X::Error> {
    let notify = slot.shared.wait_for_client(slot.peer);
    if room.is_empty() {
        // further bytes wait until the request before them is answered
        notify.await;
        return Ok(None);
    }
    match select(transport.receive(room, until), notify).await {
        Either::First(received) => received,
        Either::Second(()) => Ok(None),
    }
}

/// Passes bytes from a client to the gateway.
///
/// They fit, because only this task adds bytes to the client's slot and answers only remove some.
fn received<M: RawMutex, const N: usize>(slot: &ClientSlot<'_, '_, M, N>, bytes: &[u8]) {
    slot.shared.with(|inner| inner.received(slot.peer, bytes));
}
