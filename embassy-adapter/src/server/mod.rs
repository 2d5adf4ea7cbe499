//! Servers of b-CAP and RAC, over any transport.
//!
//! ```text
//!   Listener (TCP)  ─► serve ─┐
//!   UdpServer ────────────────┼─► SharedHandler: one call at a time
//!   serial line     ─► serve ─┘
//! ```
//!
//! The core implements the session of each peer ([`Serve`]). Each connection that is served concurrently needs a task, a
//! session and socket buffers, which the caller provides. The network stack refuses connections beyond those.
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
//! use bcap_embassy::server::{Limits, SharedHandler};
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
//! async fn serve(stack: embassy_net::Stack<'_>, shared: &SharedHandler<NoopRawMutex, Answer, 4>) -> ! {
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
use bcap_core::peers::{Exceeded, StreamTimes};
use bcap_core::time::Instant;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Timer;

pub use self::limits::Limits;
use self::shared::ActiveSession;
pub use self::shared::SharedHandler;
#[cfg(feature = "embassy-net")]
pub use self::tcp::Listener;
#[cfg(feature = "embassy-net")]
pub use self::udp::{UdpPeer, UdpServer};
use crate::clock::ticks;
pub use bcap_core::endpoint::Serve;

/// Why a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Ended<E> {
    /// The peer closed the connection.
    Closed,
    /// The peer sent bytes that are not a valid request.
    Malformed,
    /// A request took longer to arrive than [`Limits::receive`].
    RequestTooSlow,
    /// The peer was idle for longer than [`Limits::idle`].
    Idle,
    /// The peer did not accept a reply within [`Limits::send`].
    ReplyNotRead,
    /// The transport failed, because the peer stopped responding or the network is down.
    Failed(E),
}

/// Serves one peer until its session ends, and notifies the handler that the peer left.
///
/// # Cancel safety
///
/// Dropping the future closes the session, notifies the handler and leaves the transport open.
pub async fn serve<X, S, M, H, const N: usize>(
    transport: &mut X,
    session: &mut S,
    shared: &SharedHandler<M, H, N>,
    limits: &Limits,
) -> Ended<X::Error>
where
    X: Transport,
    S: Serve<H>,
    M: RawMutex,
{
    let mut active = ActiveSession::new(session, shared);
    let mut times = StreamTimes::new(transport.now());
    loop {
        // read before the handler is called, so that a change by another task in between is not missed
        let seen = shared.changes();
        if active.run(transport.now()) {
            times.ran();
        }
        if !active.session.transmit().is_empty() {
            match send(transport, active.session, limits).await {
                Some(ended) => return ended,
                // bytes after the request can be processed now
                None => {
                    times.moved(transport.now());
                    continue;
                }
            }
        }
        if active.session.is_finished() {
            return Ended::Malformed;
        }
        let deadline = match times.deadline(active.session, limits.times(), transport.now()) {
            Ok(deadline) => deadline.unwrap_or(Instant::FAR_FUTURE),
            Err(exceeded) => return exceeded.into(),
        };
        match wait(transport, active.session, shared, seen, deadline).await {
            Ok(Wake::Bytes(0)) => return Ended::Closed,
            Ok(Wake::Bytes(count)) => {
                times.moved(transport.now());
                active.session.received(count);
            }
            Ok(Wake::Poll) => {}
            Err(error) => return Ended::Failed(error),
        }
    }
}

impl<E> From<Exceeded> for Ended<E> {
    fn from(limit: Exceeded) -> Self {
        match limit {
            Exceeded::Receive => Self::RequestTooSlow,
            Exceeded::Idle => Self::Idle,
        }
    }
}

enum Wake {
    Bytes(usize),
    /// No bytes; the session must be polled.
    Poll,
}

/// Sends the session's pending bytes; returns why the session ended if that fails.
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

/// Waits for bytes, for the deadline, or, while the handler has a waiting request, for a change.
async fn wait<X, S, M, H, const N: usize>(
    transport: &mut X,
    session: &mut S,
    shared: &SharedHandler<M, H, N>,
    seen: u32,
    deadline: Instant,
) -> Result<Wake, X::Error>
where
    X: Transport,
    S: Serve<H>,
    M: RawMutex,
{
    let waiting = session.is_running();
    let room = session.receive_buffer();
    let bytes = async {
        if room.is_empty() {
            // further bytes wait until the handler has completed the request before them
            Timer::at(ticks(deadline)).await;
            return Ok(None);
        }
        transport.receive(room, deadline).await
    };
    let wake = match waiting {
        true => match select(bytes, shared.changed(seen)).await {
            Either::First(wake) => wake,
            Either::Second(()) => Ok(None),
        },
        false => bytes.await,
    };
    wake.map(|count| count.map_or(Wake::Poll, Wake::Bytes))
}
