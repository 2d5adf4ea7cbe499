//! Blocking calls over any [`Transport`].
//!
//! With the feature `embedded-io`, `Polled` is a transport over an `embedded_io` device with `ReadReady`, such as a UART,
//! and a clock.

use crate::bcap::Client;
use crate::bcap::call::{Call, Reply};
use crate::bcap::client::Timing;
use crate::hresult::HResult;
use crate::io::{CallError, Direction, MAX_EARLY, Machine, RacError, RunError, hand_in, moved, next, sent};
use crate::procedure::{Action, Channel, Failure, Procedure};
use crate::rac::{self, Request, Variable};
use crate::storage::Storage;
use crate::time::Instant;
use crate::variant::Variant;

/// A connection that carries the bytes of a client, with a clock.
pub trait Transport {
    /// The error of the connection.
    type Error;

    /// Returns the current time.
    fn now(&self) -> Instant;

    /// Sends a datagram, or as many bytes of a stream as possible, and returns their count; `None` at `until`.
    ///
    /// # Errors
    ///
    /// When the connection failed.
    fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, Self::Error>;

    /// Receives a datagram, or available bytes of a stream, and returns their count; `None` at `until`. On a stream, 0
    /// bytes mean that the peer has closed it.
    ///
    /// If `until` has passed, it returns bytes that have arrived, without waiting. Before each request the loops call it with
    /// [`Instant::ZERO`], for which it need not read the clock.
    ///
    /// # Errors
    ///
    /// When the connection failed.
    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Self::Error>;

    /// Waits until `at`, and reads no bytes.
    fn sleep_until(&mut self, at: Instant);
}

/// A b-CAP client with its transport.
#[derive(Debug)]
pub struct Connection<X, T, R = T> {
    transport: X,
    client: Client<T, R>,
}

impl<X: Transport, T: Storage, R: Storage> Connection<X, T, R> {
    /// Combines a transport and a client.
    #[must_use]
    pub const fn new(transport: X, client: Client<T, R>) -> Self {
        Self { transport, client }
    }

    /// Returns the client, to read its last reply or to change its timing.
    pub const fn client(&mut self) -> &mut Client<T, R> {
        &mut self.client
    }

    /// Returns the transport.
    pub const fn transport(&mut self) -> &mut X {
        &mut self.transport
    }

    /// Returns transport and client, to wrap the transport in another one, such as one that records the bytes.
    #[must_use]
    pub fn into_parts(self) -> (X, Client<T, R>) {
        (self.transport, self.client)
    }

    /// Returns the code of the last reply, such as a success other than S_OK.
    #[must_use]
    pub fn last_result(&self) -> Option<HResult> {
        self.client.reply().map(|frame| frame.hresult())
    }

    /// Makes a call, waits for its reply and returns the value, which borrows from the client's buffer.
    ///
    /// It uses the timing of the client's configuration; [`call_with`](Self::call_with) takes another one.
    ///
    /// # Errors
    ///
    /// A [`CallError`]; [`is_recoverable`](CallError::is_recoverable) tells whether the connection can still be used.
    pub fn call<C: Call>(&mut self, call: C) -> Result<<C::Reply as Reply>::Value<'_>, CallError<X::Error>> {
        let timing = self.client.timing();
        self.call_with(call, timing)
    }

    /// Makes a call as [`call`](Self::call) does, with its own timing.
    ///
    /// # Errors
    ///
    /// As [`call`](Self::call).
    pub fn call_with<C: Call>(
        &mut self,
        call: C,
        timing: Timing,
    ) -> Result<<C::Reply as Reply>::Value<'_>, CallError<X::Error>> {
        self.exchange(&call, timing)?;
        Ok(self.client.value::<C::Reply>()?)
    }

    fn exchange<C: Call>(&mut self, call: &C, timing: Timing) -> Result<(), CallError<X::Error>> {
        clear(&mut self.transport, &mut self.client)?;
        self.client.start(call, timing, self.transport.now())?;
        wait(&mut self.transport, &mut self.client)
    }

    /// Runs a procedure over this connection until it is done.
    ///
    /// # Errors
    ///
    /// A [`RunError`]: the procedure's own error, and that of the first call without a reply.
    pub fn run<P: Procedure>(&mut self, procedure: P) -> Result<P::Output, RunError<P::Error, X::Error>> {
        run(procedure, self, None::<&mut Self>)
    }

    /// Runs a procedure over this connection, its calls of [`Channel::Watch`] over another one.
    ///
    /// # Errors
    ///
    /// As [`run`](Self::run).
    pub fn run_beside<P, Y, U, S>(
        &mut self,
        watch: &mut Connection<Y, U, S>,
        procedure: P,
    ) -> Result<P::Output, RunError<P::Error, X::Error>>
    where
        P: Procedure,
        Y: Transport<Error = X::Error>,
        U: Storage,
        S: Storage,
    {
        run(procedure, self, Some(watch))
    }

    /// Makes the call of a procedure, and passes in its reply or failure; returns the error of a call without a reply.
    fn perform<P: Procedure>(&mut self, procedure: &mut P) -> Option<CallError<X::Error>> {
        let timing = procedure.timing(self.client.link(), self.client.timing());
        let ended = match procedure.request() {
            Some(request) => self.exchange(&request, timing),
            None => return None,
        };
        hand_in(procedure, &self.client, ended, self.transport.now())
    }
}

/// Runs a procedure over one connection or two.
fn run<P, X, T, R, Y, U, S>(
    mut procedure: P,
    motion: &mut Connection<X, T, R>,
    mut watch: Option<&mut Connection<Y, U, S>>,
) -> Result<P::Output, RunError<P::Error, X::Error>>
where
    P: Procedure,
    X: Transport,
    Y: Transport<Error = X::Error>,
    T: Storage,
    R: Storage,
    U: Storage,
    S: Storage,
{
    let mut lost = None;
    if procedure.request().is_some() {
        // an earlier run ended with a call in flight
        procedure.handle_failure(Failure::Timeout, motion.transport.now());
    }
    loop {
        let error = match (procedure.poll(motion.transport.now()), &mut watch) {
            (Action::Call(Channel::Watch), Some(watch)) => watch.perform(&mut procedure),
            (Action::Call(_), _) => motion.perform(&mut procedure),
            (Action::Wait(at), _) => {
                motion.transport.sleep_until(at);
                None
            }
            (Action::Done(result), _) => return result.map_err(|error| RunError { error, call: lost }),
        };
        lost = lost.or(error);
    }
}

/// A RAC client with its transport.
#[derive(Debug)]
pub struct RacConnection<X, V> {
    transport: X,
    client: rac::Client<V>,
}

impl<X: Transport, V: Storage> RacConnection<X, V> {
    /// Combines a transport and a client.
    #[must_use]
    pub const fn new(transport: X, client: rac::Client<V>) -> Self {
        Self { transport, client }
    }

    /// Returns the client, to change its time limit.
    pub const fn client(&mut self) -> &mut rac::Client<V> {
        &mut self.client
    }

    /// Returns the transport.
    pub const fn transport(&mut self) -> &mut X {
        &mut self.transport
    }

    /// Returns transport and client, to wrap the transport in another one, such as one that records the bytes.
    #[must_use]
    pub fn into_parts(self) -> (X, rac::Client<V>) {
        (self.transport, self.client)
    }

    /// Reads a variable; EMPTY if the reply has no value.
    ///
    /// # Errors
    ///
    /// A [`RacError`]; [`is_recoverable`](RacError::is_recoverable) tells whether the connection can still be used.
    pub fn get(&mut self, variable: Variable) -> Result<Variant<'_>, RacError<X::Error>> {
        self.request(&Request::Get(variable))?;
        Ok(self.client.reply().and_then(|reply| reply.value).unwrap_or(Variant::Empty))
    }

    /// Writes a variable.
    ///
    /// # Errors
    ///
    /// As [`get`](Self::get), and [`Request`](rac::client::ClientError::Request) for a value that has no text.
    pub fn put(&mut self, variable: Variable, value: Variant<'_>) -> Result<(), RacError<X::Error>> {
        self.request(&Request::Put(variable, value))
    }

    fn request(&mut self, request: &Request<'_>) -> Result<(), RacError<X::Error>> {
        clear(&mut self.transport, &mut self.client)?;
        self.client.start(request, self.transport.now())?;
        wait(&mut self.transport, &mut self.client)
    }
}

type Ended<X, M> = Result<(), CallError<<X as Transport>::Error, <M as Machine>::Error>>;

/// Clears the link for a call: sends the rest of one that was given up, and drops what arrived before this one, so that it
/// is not taken for the reply.
fn clear<X: Transport, M: Machine>(transport: &mut X, client: &mut M) -> Ended<X, M> {
    client.give_up();
    if !client.transmit().is_empty() {
        let until = transport.now().saturating_add(client.flush_timeout());
        while !client.transmit().is_empty() {
            let sent = transport.send(client.transmit(), until).map_err(CallError::Io)?;
            client.transmitted(sent.ok_or(CallError::Client(M::BUSY))?);
        }
    }
    for _ in 0..MAX_EARLY {
        if client.is_over() {
            return Err(CallError::Client(M::CLOSED));
        }
        let count = transport.receive(client.receive_buffer(), Instant::ZERO).map_err(CallError::Io)?;
        if count.is_none() {
            break;
        }
        if let Some(end @ Err(_)) = moved(client, Direction::Receive, count, Instant::FAR_FUTURE, transport.now()) {
            return end;
        }
    }
    Ok(())
}

/// Runs the client until the call has ended.
fn wait<X: Transport, M: Machine>(transport: &mut X, client: &mut M) -> Ended<X, M> {
    while let Some((direction, until)) = next(client) {
        let count = match direction {
            Direction::Send => transport.send(client.transmit(), until),
            Direction::Receive => transport.receive(client.receive_buffer(), until),
        };
        let count = count.map_err(CallError::Io)?;
        if direction == Direction::Send && sent(client, count) {
            continue;
        }
        if let Some(end) = moved(client, direction, count, until, transport.now()) {
            return end;
        }
    }
    Err(CallError::Client(M::CLOSED))
}

/// A transport over a device that can be polled, such as a UART, and a clock.
///
/// It waits in a busy loop; to sleep instead, implement [`Transport`]. An error of a read means lost bytes, except one that says
/// that the connection has ended.
#[cfg(feature = "embedded-io")]
#[derive(Debug)]
pub struct Polled<D, C> {
    device: D,
    clock: C,
}

#[cfg(feature = "embedded-io")]
impl<D, C: crate::time::Clock> Polled<D, C> {
    /// Combines a device and a clock.
    #[must_use]
    pub const fn new(device: D, clock: C) -> Self {
        Self { device, clock }
    }
}

#[cfg(feature = "embedded-io")]
impl<D: embedded_io::Read + embedded_io::ReadReady, C> Polled<D, C> {
    /// Reads what has arrived; `None` when nothing has.
    fn read_available(&mut self, buffer: &mut [u8]) -> Result<Option<usize>, D::Error> {
        if self.device.read_ready()? { self.device.read(buffer).map(Some) } else { Ok(None) }
    }
}

#[cfg(feature = "embedded-io")]
impl<D, C> Transport for Polled<D, C>
where
    D: embedded_io::Read + embedded_io::Write + embedded_io::ReadReady,
    C: crate::time::Clock,
{
    type Error = D::Error;

    fn now(&self) -> Instant {
        self.clock.now()
    }

    fn send(&mut self, bytes: &[u8], _until: Instant) -> Result<Option<usize>, D::Error> {
        // a write waits for the device, never for the peer
        let count = self.device.write(bytes)?;
        self.device.flush()?;
        Ok(Some(count))
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, D::Error> {
        use embedded_io::Error as _;
        loop {
            match self.read_available(buffer) {
                Err(error) if super::ends_connection(error.kind()) => return Err(error),
                Ok(Some(count)) => return Ok(Some(count)),
                Ok(None) | Err(_) if self.clock.now() >= until => return Ok(None),
                Ok(None) | Err(_) => core::hint::spin_loop(),
            }
        }
    }

    fn sleep_until(&mut self, at: Instant) {
        while self.clock.now() < at {
            core::hint::spin_loop();
        }
    }
}

#[cfg(test)]
mod tests;
