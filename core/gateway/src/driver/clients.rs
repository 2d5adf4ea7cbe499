//! The PLC side of a gateway: sessions.

use core::net::Ipv4Addr;
use core::pin::pin;
use core::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;

use super::notify::{first, yield_now};
use super::{Ended, Front, Limits, Platform, SharedGateway};

/// The answer to the first line of a client without a slot, E_MAX_CONNECT.
const FULL: &[u8] = b"-2147481333\r";

/// Serves one PLC until its session ends, and returns the reason; `None` if it gets no slot, because all are in use, the rules
/// do not allow it to connect, or the gateway stops.
///
/// A listener calls [`SharedGateway::admits`] first, to reset the connection of a client that the rules do not allow. A caller
/// that serves a line again after `None` should wait first.
///
/// When all slots are in use, it first ends the session of the client that has been idle for the longest time, at least
/// [`Limits::evict_after`], preferably a client of the same host.
///
/// Each transfer moves at most `CHUNK` bytes. `failure` returns the reported part of an error of the transport.
///
/// # Cancel safety
///
/// Dropping the future frees the slot and leaves the transport open.
pub async fn serve<X: Transport, P: Platform, const CHUNK: usize>(
    transport: &mut X,
    mut front: Front<'_, '_>,
    client: P::Address,
    shared: &SharedGateway<'_, P>,
    limits: &Limits,
    failure: impl FnOnce(&X::Error) -> P::Failure,
) -> Option<Ended<X::Error>> {
    let Some(peer) = shared.open(client, limits) else {
        // a caller that tries again immediately must not keep other tasks from running
        yield_now().await;
        return None;
    };
    let mut slot = ClientSlot { peer, shared, ended: None };
    let ended = run_session(transport, &mut front, shared, (slot.peer, P::ipv4(client)), limits, &mut [0; CHUNK]).await;
    let ended = ended.unwrap_or_else(Ended::Failed);
    slot.ended = Some(ended.map(failure));
    Some(ended)
}

/// A client's slot in the gateway; dropping it frees the slot.
struct ClientSlot<'a, 'm, P: Platform> {
    peer: PeerId,
    shared: &'a SharedGateway<'m, P>,
    ended: Option<Ended<P::Failure>>,
}

impl<P: Platform> Drop for ClientSlot<'_, '_, P> {
    fn drop(&mut self) {
        self.shared.close(self.peer, self.ended);
    }
}

/// The next action of a session.
enum Next {
    /// Move lines or events first.
    Poll,
    /// Send this number of bytes to the client.
    Send(usize),
    /// Receive up to this number of bytes; 0 while an answer is outstanding.
    Receive(usize),
}

/// The kind of a client's time limit.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Limited {
    No,
    Sending,
    Receiving,
    Idle,
}

impl Limited {
    /// Returns the limit and the reason to end after it.
    fn limit<E>(self, limits: &Limits) -> Option<(Duration, Ended<E>)> {
        match self {
            Self::No => None,
            Self::Sending => Some((limits.send, Ended::ReplyNotRead)),
            Self::Receiving => Some((limits.receive, Ended::RequestTooSlow)),
            Self::Idle => limits.idle.map(|idle| (idle, Ended::Idle)),
        }
    }
}

/// The time limit that applies to a client, and when it began.
struct Timer {
    limited: Limited,
    since: Instant,
}

impl Timer {
    const STOPPED: Self = Self { limited: Limited::No, since: Instant::ZERO };

    /// Returns when the limit ends, which begins now if another limit applied before; an error if it has ended.
    fn until<E>(&mut self, limited: Limited, now: Instant, limits: &Limits) -> Result<Instant, Ended<E>> {
        if limited != self.limited {
            *self = Self { limited, since: now };
        }
        let Some((limit, ended)) = limited.limit(limits) else { return Ok(Instant::FAR_FUTURE) };
        let until = self.since.saturating_add(limit);
        if now >= until { Err(ended) } else { Ok(until) }
    }
}

/// Moves lines and answers until the session ends.
async fn run_session<X: Transport, P: Platform>(
    transport: &mut X,
    front: &mut Front<'_, '_>,
    shared: &SharedGateway<'_, P>,
    (peer, address): (PeerId, Option<Ipv4Addr>),
    limits: &Limits,
    chunk: &mut [u8],
) -> Result<Ended<X::Error>, X::Error> {
    let mut timer = Timer::STOPPED;
    // whether an answer was sent since the task last waited
    let mut had_turn = false;
    loop {
        shared.poll_for_client();
        let (next, limited) = match plan(shared, front, (peer, address), chunk) {
            Ok(plan) => plan,
            Err(ended) => return Ok(ended.map(|never| match *never {})),
        };
        if matches!(next, Next::Poll) {
            continue;
        }
        // one line a turn, so a client that sends many lines together does not slow other clients
        if had_turn && matches!(next, Next::Send(_)) {
            had_turn = false;
            yield_now().await;
            continue;
        }
        let until = match timer.until(limited, transport.now(), limits) {
            Ok(until) => until,
            Err(ended) => return Ok(ended),
        };
        match next {
            Next::Poll => {}
            Next::Send(count) => {
                had_turn = true;
                let answer = front.answer(chunk.get(..count).unwrap_or_default());
                if let Some(sent) = transport.send(answer, until).await? {
                    shared.with(|shared| shared.transmitted(front, (peer, address), sent));
                    timer = Timer::STOPPED;
                }
            }
            Next::Receive(room) => {
                let room = chunk.get_mut(..room).unwrap_or_default();
                let received = {
                    let notify = pin!(shared.wait_for_client(peer));
                    if room.is_empty() {
                        // further bytes wait until the request before them is answered
                        first(pin!(transport.sleep_until(until)), notify).await;
                        None
                    } else {
                        first(pin!(transport.receive(room, until)), notify).await.transpose()?.flatten()
                    }
                };
                match received {
                    Some(0) => return Ok(Ended::Closed),
                    Some(count) => {
                        let bytes = chunk.get(..count).unwrap_or_default();
                        // they fit, because only this task adds bytes, and answers only remove some
                        shared.with(|shared| shared.received(front, (peer, address), bytes));
                        // an idle client was active
                        if limited == Limited::Idle {
                            timer = Timer::STOPPED;
                        }
                    }
                    // the task has waited: bytes that are there would have been received
                    None => had_turn = false,
                }
            }
        }
    }
}

/// Returns the next action of a session and the limit that applies; copies bytes to send to a client of RAC into `chunk`.
fn plan<P: Platform>(
    shared: &SharedGateway<'_, P>,
    front: &mut Front<'_, '_>,
    (peer, address): (PeerId, Option<Ipv4Addr>),
    chunk: &mut [u8],
) -> Result<(Next, Limited), Ended<core::convert::Infallible>> {
    let planned = shared.with(|shared| {
        if shared.address(peer).is_none() {
            return Err(Ended::Evicted);
        }
        let moved = front.exchange(&mut shared.gateway, peer, address);
        shared.exchanged(peer, front);
        if moved {
            return Ok((Next::Poll, Limited::No));
        }
        if front.is_broken() {
            return Err(Ended::NotModbus);
        }
        let to_send = front.to_send(&shared.gateway, peer);
        if to_send > 0 {
            let copied = chunk.iter_mut().zip(shared.gateway.transmit(peer)).map(|(to, from)| *to = *from).count();
            return Ok((Next::Send(if matches!(front, Front::Rac) { copied } else { to_send }), Limited::Sending));
        }
        let is_running = front.is_running(&shared.gateway, peer);
        if shared.is_stopping() && !is_running {
            return Err(Ended::Stopped);
        }
        let limited = match (is_running, front.is_receiving(&shared.gateway, peer)) {
            (true, _) => Limited::No,
            (false, true) => Limited::Receiving,
            (false, false) => Limited::Idle,
        };
        let room = if shared.is_stopping() { 0 } else { front.room(&mut shared.gateway, peer).min(chunk.len()) };
        Ok((Next::Receive(room), limited))
    });
    planned.unwrap_or(Ok((Next::Receive(0), Limited::No)))
}

/// Answers the first request of a client without a slot, for at most `limit`: a line with E_MAX_CONNECT, a request of Modbus
/// with the exception "server device busy".
///
/// # Cancel safety
///
/// Dropping the future leaves the transport open.
pub async fn refuse<X: Transport>(transport: &mut X, mut front: Front<'_, '_>, limit: Duration, chunk: &mut [u8]) {
    let until = transport.now().saturating_add(limit);
    // not before its line arrives, because a line that arrives after the close would reset the connection
    loop {
        match transport.receive(chunk, until).await {
            Ok(Some(count @ 1..)) => {
                if is_request(&mut front, chunk.get(..count).unwrap_or_default()) {
                    break;
                }
            }
            Ok(None) if transport.now() < until => {}
            _ => return,
        }
    }
    // a client that does not read it has no slot either
    let _ = transport.send(front.answer(FULL), until).await;
}

/// Returns whether the bytes complete a request of Modbus, or end a line, and prepares the answer.
fn is_request(front: &mut Front<'_, '_>, bytes: &[u8]) -> bool {
    let Front::Modbus(session) = front else { return bytes.contains(&b'\r') };
    let bytes = bytes.get(..session.room()).unwrap_or(bytes);
    session.received(bytes, |_| true);
    if !session.line().is_empty() {
        session.replied(FULL, |_| true);
    }
    session.is_broken() || !session.transmit().is_empty()
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use bcap_core::hresult::HResult;

    #[test]
    fn a_full_gateway_answers_e_max_connect() {
        assert_eq!(std::format!("{}\r", HResult::E_MAX_CONNECT.0).as_bytes(), FULL);
    }
}
