//! The PLCs' side of a gateway.

use core::cell::Cell;

use bcap_core::handler::PeerId;
use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
use embassy_futures::select::{Either, select};
use embassy_net::{IpEndpoint, Stack};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Timer;

use super::Shared;
use crate::net::{Options, TcpTransport};
use crate::server::{Ended, Limits};

/// Bytes that are moved at once; most lines are shorter.
const CHUNK: usize = 64;

/// How long a port that cannot be listened to, or a client that there is no seat for, is left alone.
const PAUSE_MS: u64 = 100;

/// A port that takes one PLC at a time; for more at the same time there are more listeners on the same port.
#[derive(Debug)]
pub struct Listener<'s> {
    transport: TcpTransport<'s>,
    port: u16,
}

impl<'s> Listener<'s> {
    /// Makes a listener; `rx` and `tx` are its socket's memory.
    #[must_use]
    pub fn new(stack: Stack<'s>, port: u16, rx: &'s mut [u8], tx: &'s mut [u8]) -> Self {
        Self { transport: TcpTransport::new(stack, rx, tx, Options::default()), port }
    }

    /// Serves PLCs for ever, one after the other.
    pub async fn run<M: RawMutex, const N: usize>(&mut self, shared: &Shared<'_, M, N>, limits: &Limits) -> ! {
        loop {
            if self.transport.accept(self.port).await.is_err() {
                Timer::after_millis(PAUSE_MS).await;
                continue;
            }
            let client = self.transport.socket().remote_endpoint();
            if serve(&mut self.transport, client, shared, limits).await.is_none() {
                Timer::after_millis(PAUSE_MS).await;
            }
            self.transport.close().await;
        }
    }
}

/// Serves one PLC until it goes, and says why it did; `None` when there was no seat for it.
///
/// `client` is its address, for the log.
///
/// # Cancel safety
///
/// When the future is dropped the seat is free again; the transport is as it was.
pub async fn serve<X: Transport, M: RawMutex, const N: usize>(
    transport: &mut X,
    client: Option<IpEndpoint>,
    shared: &Shared<'_, M, N>,
    limits: &Limits,
) -> Option<Ended<X::Error>> {
    let seat = Seat { peer: shared.open(client)?, shared, ended: Cell::new(None) };
    let ended = converse(transport, &seat, limits).await.unwrap_or_else(Ended::Failed);
    seat.ended.set(Some(ended.reason()));
    Some(ended)
}

/// A client's seat, which is free again however its session ends.
struct Seat<'a, 'm, M: RawMutex, const N: usize> {
    peer: PeerId,
    shared: &'a Shared<'m, M, N>,
    ended: Cell<Option<Ended<()>>>,
}

impl<M: RawMutex, const N: usize> Drop for Seat<'_, '_, M, N> {
    fn drop(&mut self) {
        self.shared.close(self.peer, self.ended.get());
    }
}

/// What a session waits for.
enum Next {
    /// The client is to take so many bytes.
    Send(usize),
    /// The client may send so many bytes; 0 while it has to wait for an answer.
    Receive(usize),
}

/// Moves lines and answers until the client goes.
async fn converse<X: Transport, M: RawMutex, const N: usize>(
    transport: &mut X,
    seat: &Seat<'_, '_, M, N>,
    limits: &Limits,
) -> Result<Ended<X::Error>, X::Error> {
    let Seat { peer, shared, .. } = *seat;
    let mut chunk = [0; CHUNK];
    let mut heard = transport.now();
    // when the first byte of an unfinished line came, and when an answer began that the client does not read
    let (mut partial, mut unread) = (None, None);
    loop {
        shared.step_for_client();
        let now = transport.now();
        match next(seat, &mut chunk) {
            Next::Send(count) => {
                // a line was whole, so what there is of another has only just come
                partial = None;
                let until = unread.get_or_insert(now).saturating_add(limits.send);
                let answer = chunk.get(..count).unwrap_or_default();
                match transport.send(answer, until).await? {
                    Some(sent) => shared.with(|inner| inner.gateway.transmitted(peer, sent)),
                    None => return Ok(Ended::ReplyNotRead),
                };
            }
            Next::Receive(room) => {
                unread = None;
                let receiving = shared.view(|gateway| gateway.is_receiving(peer)).unwrap_or_default();
                partial = receiving.then(|| partial.unwrap_or(now));
                let late = partial.map(|since: Instant| since.saturating_add(limits.receive));
                let idle = limits.idle.filter(|_| room > 0).map(|idle| heard.saturating_add(idle));
                let until = late.into_iter().chain(idle).min().unwrap_or(Instant::FAR_FUTURE);
                if now >= until {
                    return Ok(if late.is_some_and(|late| now >= late) { Ended::RequestTooSlow } else { Ended::Idle });
                }
                let room = chunk.get_mut(..room).unwrap_or_default();
                match hear(transport, room, until, seat).await? {
                    Some(0) => return Ok(Ended::Closed),
                    Some(count) => {
                        heard = transport.now();
                        received(seat, chunk.get(..count).unwrap_or_default());
                    }
                    None => {}
                }
            }
        }
    }
}

/// Says what is to be done for a client; the bytes that it is to take are in `chunk`.
fn next<M: RawMutex, const N: usize>(seat: &Seat<'_, '_, M, N>, chunk: &mut [u8; CHUNK]) -> Next {
    let next = seat.shared.with(|inner| {
        let mut sends = 0;
        for (to, from) in chunk.iter_mut().zip(inner.gateway.transmit(seat.peer)) {
            *to = *from;
            sends += 1;
        }
        match sends {
            0 => Next::Receive(inner.gateway.receive_buffer(seat.peer).len().min(CHUNK)),
            sends => Next::Send(sends),
        }
    });
    next.unwrap_or(Next::Receive(0))
}

/// Waits for bytes, for the time, or for something that concerns the client.
async fn hear<X: Transport, M: RawMutex, const N: usize>(
    transport: &mut X,
    room: &mut [u8],
    until: Instant,
    seat: &Seat<'_, '_, M, N>,
) -> Result<Option<usize>, X::Error> {
    let bell = seat.shared.wait_for_client(seat.peer);
    if room.is_empty() {
        // what comes must wait until the request before it is answered
        bell.await;
        return Ok(None);
    }
    match select(transport.receive(room, until), bell).await {
        Either::First(received) => received,
        Either::Second(()) => Ok(None),
    }
}

/// Gives a client's bytes to the gateway.
///
/// They fit: nobody but this task puts bytes into the client's seat, and an answer only makes room.
fn received<M: RawMutex, const N: usize>(seat: &Seat<'_, '_, M, N>, bytes: &[u8]) {
    seat.shared.with(|inner| {
        if let Some(room) = inner.gateway.receive_buffer(seat.peer).get_mut(..bytes.len()) {
            room.copy_from_slice(bytes);
            inner.gateway.received(seat.peer, bytes.len());
        }
    });
}
