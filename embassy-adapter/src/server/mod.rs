//! Servers of b-CAP and RAC, over any transport.
//!
//! ```text
//!   Listener (TCP)  ─► serve ─┐
//!   UdpServer ────────────────┼─► Shared: the handler, one call at a time
//!   a serial line   ─► serve ─┘
//! ```
//!
//! The core has the session of each peer ([`Serve`]). Each connection that is to be served at the same time needs a task, a
//! session and a socket's memory, which the caller places; a peer for whom there is none is refused by the network.
//!
//! # Examples
//!
//! A controller with one number, served to RAC clients over embassy-net:
//!
//! ```
//! use bcap_core::handler::{Outcome, PeerId, ReplyValue};
//! use bcap_core::hresult::HResult;
//! use bcap_core::rac::server::{Config, Handler, Session};
//! use bcap_core::rac::{Request, VariableKind};
//! use bcap_core::time::Instant;
//! use bcap_embassy::server::{Limits, Shared};
//! use embassy_sync::blocking_mutex::raw::NoopRawMutex;
//!
//! struct Answer;
//!
//! impl Handler for Answer {
//!     fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
//!         match request {
//!             Request::Get(variable) if variable.kind == VariableKind::I && reply.set(&42).is_ok() => HResult::S_OK.into(),
//!             _ => HResult::E_ACCESSDENIED.into(),
//!         }
//!     }
//! }
//!
//! # #[cfg(feature = "embassy-net")]
//! async fn serve(stack: embassy_net::Stack<'_>, shared: &Shared<NoopRawMutex, Answer, 4>) -> ! {
//!     let (mut rx, mut tx) = ([0; 512], [0; 512]);
//!     let mut listener = bcap_embassy::server::Listener::new(stack, bcap_core::rac::PORT, &mut rx, &mut tx);
//!     let mut session = None;
//!     listener.run(&mut session, || Session::new(Config::TCP, [0; 64]), shared, &Limits::default()).await
//! }
//! ```

mod limits;
mod shared;
#[cfg(feature = "embassy-net")]
mod tcp;
#[cfg(feature = "embassy-net")]
mod udp;

use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Timer;

pub use self::limits::Limits;
use self::limits::{Due, TooLong};
pub use self::shared::Shared;
use self::shared::Visit;
#[cfg(feature = "embassy-net")]
pub use self::tcp::Listener;
#[cfg(feature = "embassy-net")]
pub use self::udp::{UdpPeer, UdpServer};
use crate::clock::ticks;
pub use bcap_core::endpoint::Serve;

/// Why a session has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Ended<E> {
    /// The peer has closed the connection.
    Closed,
    /// The peer sent bytes that are no request.
    Malformed,
    /// A request took too long to arrive.
    RequestTooSlow,
    /// The peer was silent for too long.
    Idle,
    /// The peer did not read its replies.
    ReplyNotRead,
    /// The transport failed: the peer vanished, or the network did.
    Failed(E),
}

impl<E> Ended<E> {
    /// Returns the reason without what the transport said.
    #[cfg(feature = "gateway")]
    pub(crate) const fn reason(&self) -> Ended<()> {
        match self {
            Self::Closed => Ended::Closed,
            Self::Malformed => Ended::Malformed,
            Self::RequestTooSlow => Ended::RequestTooSlow,
            Self::Idle => Ended::Idle,
            Self::ReplyNotRead => Ended::ReplyNotRead,
            Self::Failed(_) => Ended::Failed(()),
        }
    }
}

/// Serves one peer until its session ends, and tells the handler that it has gone.
///
/// # Cancel safety
///
/// When the future is dropped the session is closed and the handler learns it; the transport is as it was.
pub async fn serve<X, S, M, H, const N: usize>(
    transport: &mut X,
    session: &mut S,
    shared: &Shared<M, H, N>,
    limits: &Limits,
) -> Ended<X::Error>
where
    X: Transport,
    S: Serve<H>,
    M: RawMutex,
{
    let mut visit = Visit::new(session, shared, transport.now());
    loop {
        // noted before the handler is asked, so that what others change meanwhile is not missed
        let seen = shared.changes();
        visit.run(transport.now());
        if !visit.session.transmit().is_empty() {
            match send(transport, visit.session, limits).await {
                Some(ended) => return ended,
                // what came behind the request can be looked at now
                None => continue,
            }
        }
        if visit.session.is_finished() {
            return Ended::Malformed;
        }
        let heard = match visit.due(limits, transport.now()) {
            Due::Ended(ended) => return ended.into(),
            Due::At(at) => wait(transport, visit.session, shared, seen, at).await,
        };
        match heard {
            Ok(Heard::Bytes(0)) => return Ended::Closed,
            Ok(Heard::Bytes(count)) => visit.received(count, transport.now()),
            Ok(Heard::Nothing) => {}
            Err(error) => return Ended::Failed(error),
        }
    }
}

impl<E> From<TooLong> for Ended<E> {
    fn from(reason: TooLong) -> Self {
        match reason {
            TooLong::Request => Self::RequestTooSlow,
            TooLong::Silence => Self::Idle,
        }
    }
}

enum Heard {
    Bytes(usize),
    /// It is time to look at the session again.
    Nothing,
}

/// Sends what the session has to say; returns how it ended if that cannot be done.
async fn send<X, H, S>(transport: &mut X, session: &mut S, limits: &Limits) -> Option<Ended<X::Error>>
where
    X: Transport,
    H: ?Sized,
    S: Serve<H> + ?Sized,
{
    let until = transport.now().saturating_add(limits.send);
    while !session.transmit().is_empty() {
        match transport.send(session.transmit(), until).await {
            Ok(Some(count)) => session.transmitted(count),
            Ok(None) => return Some(Ended::ReplyNotRead),
            Err(error) => return Some(Ended::Failed(error)),
        }
    }
    None
}

/// Waits for bytes, for the time, or for something that a waiting handler may be waiting for.
async fn wait<X, S, M, H, const N: usize>(
    transport: &mut X,
    session: &mut S,
    shared: &Shared<M, H, N>,
    seen: u32,
    due: Instant,
) -> Result<Heard, X::Error>
where
    X: Transport,
    S: Serve<H>,
    M: RawMutex,
{
    let listening = session.is_running();
    let room = session.receive_buffer();
    let bytes = async {
        if room.is_empty() {
            // what comes must wait until the handler is done with the request before it
            Timer::at(ticks(due)).await;
            return Ok(None);
        }
        transport.receive(room, due).await
    };
    let heard = match listening {
        true => match select(bytes, shared.changed(seen)).await {
            Either::First(heard) => heard,
            Either::Second(()) => Ok(None),
        },
        false => bytes.await,
    };
    heard.map(|count| count.map_or(Heard::Nothing, Heard::Bytes))
}
