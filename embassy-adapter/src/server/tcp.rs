//! A TCP listener that serves one connection after another.

use embassy_net::Stack;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Timer;

use super::{Ended, Limits, Serve, SharedHandler, serve};
use crate::net::{NetError, Options, TcpTransport};

/// A TCP listener that serves one connection at a time.
///
/// Use several listeners on the same port, with one [`Backlog`](crate::net::Backlog), to serve several connections
/// concurrently.
#[derive(Debug)]
pub struct Listener<'s> {
    transport: TcpTransport<'s>,
    port: u16,
}

/// The pause before listening again, after listening failed.
const PAUSE_MS: u64 = 100;

impl<'s> Listener<'s> {
    /// Creates a listener; `rx` and `tx` are its socket's buffers.
    #[must_use]
    pub fn new(stack: Stack<'s>, port: u16, rx: &'s mut [u8], tx: &'s mut [u8]) -> Self {
        Self::with_options(stack, port, rx, tx, Options::default())
    }

    /// Creates a listener with other timeouts of its connections.
    #[must_use]
    pub fn with_options(stack: Stack<'s>, port: u16, rx: &'s mut [u8], tx: &'s mut [u8], options: Options) -> Self {
        Self { transport: TcpTransport::new(stack, rx, tx, options), port }
    }

    /// Serves connections forever; `make` creates the session of each, which is stored in `slot`.
    pub async fn run<S, M, H, const N: usize>(
        &mut self,
        slot: &mut Option<S>,
        mut make: impl FnMut() -> S,
        shared: &SharedHandler<M, H, N>,
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
                    defmt::debug!("port {=u16}: session ended: {}", self.port, _ended);
                }
                Err(_) => Timer::after_millis(PAUSE_MS).await,
            }
        }
    }

    /// Waits for a connection and serves it until it ends.
    ///
    /// # Errors
    ///
    /// A [`NetError`] when the port is 0.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future closes the session. The next use of the listener resets its connection.
    pub async fn serve_one<S, M, H, const N: usize>(
        &mut self,
        session: &mut S,
        shared: &SharedHandler<M, H, N>,
        limits: &Limits,
    ) -> Result<Ended<NetError>, NetError>
    where
        S: Serve<H>,
        M: RawMutex,
    {
        // its place is free after the handshake
        drop(self.transport.accept(self.port).await?);
        let ended = serve(&mut self.transport, session, shared, limits).await;
        self.transport.close().await;
        Ok(ended)
    }
}

/// Stores a new session in the slot.
///
/// Not inlined: otherwise the temporary session would take stack or future memory for as long as the connection.
#[inline(never)]
fn renew<'s, S>(slot: &'s mut Option<S>, make: &mut impl FnMut() -> S) -> &'s mut S {
    slot.insert(make())
}
