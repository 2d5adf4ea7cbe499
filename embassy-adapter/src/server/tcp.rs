//! A port of TCP that is served, one connection after the other.

use embassy_net::Stack;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Timer;

use super::{Ended, Limits, Serve, Shared, serve};
use crate::net::{NetError, Options, TcpTransport};

/// A port that takes one connection at a time; for more at the same time there are more listeners on the same port.
#[derive(Debug)]
pub struct Listener<'s> {
    transport: TcpTransport<'s>,
    port: u16,
}

/// How long a port that cannot be listened to is left alone.
const PAUSE_MS: u64 = 100;

impl<'s> Listener<'s> {
    /// Makes a listener; `rx` and `tx` are its socket's memory.
    #[must_use]
    pub fn new(stack: Stack<'s>, port: u16, rx: &'s mut [u8], tx: &'s mut [u8]) -> Self {
        Self { transport: TcpTransport::new(stack, rx, tx, Options::default()), port }
    }

    /// Serves connections for ever; each has a session of `make`, which lives in `slot`.
    pub async fn run<S, M, H, const N: usize>(
        &mut self,
        slot: &mut Option<S>,
        mut make: impl FnMut() -> S,
        shared: &Shared<M, H, N>,
        limits: &Limits,
    ) -> !
    where
        S: Serve<H>,
        M: RawMutex,
    {
        loop {
            let session = renew(slot, &mut make);
            match self.serve_one(session, shared, limits).await {
                Ok(_ended) => {
                    #[cfg(feature = "defmt")]
                    defmt::debug!("port {=u16}: the session has ended: {}", self.port, _ended);
                }
                Err(_) => Timer::after_millis(PAUSE_MS).await,
            }
        }
    }

    /// Waits for a connection and serves it until it ends.
    ///
    /// # Errors
    ///
    /// A [`NetError`] when the peer was gone before there was a connection, or the port is 0.
    ///
    /// # Cancel safety
    ///
    /// When the future is dropped the session is closed, and its connection is reset with the next use.
    pub async fn serve_one<S, M, H, const N: usize>(
        &mut self,
        session: &mut S,
        shared: &Shared<M, H, N>,
        limits: &Limits,
    ) -> Result<Ended<NetError>, NetError>
    where
        S: Serve<H>,
        M: RawMutex,
    {
        self.transport.accept(self.port).await?;
        let ended = serve(&mut self.transport, session, shared, limits).await;
        self.transport.close().await;
        Ok(ended)
    }
}

/// Puts a new session into its place.
///
/// Not inlined: a session is made on the stack, and would stay there as long as it is served.
#[inline(never)]
fn renew<'s, S>(slot: &'s mut Option<S>, make: &mut impl FnMut() -> S) -> &'s mut S {
    slot.insert(make())
}
