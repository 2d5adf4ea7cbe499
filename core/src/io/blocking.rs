//! Calls that block, over any [`Transport`].
//!
//! With the feature `embedded-io`, `Polled` makes a transport of anything that reads, writes and can say whether bytes
//! are there (a UART), and a clock.

use crate::bcap::Client;
use crate::bcap::call::{Call, Reply};
use crate::bcap::client::Timing;
use crate::hresult::HResult;
use crate::io::{CallError, Direction, MAX_EARLY, Machine, RacError, RunError, hand_in, moved, next};
use crate::procedure::{Action, Channel, Failure, Procedure};
use crate::rac::{self, Request, Variable};
use crate::storage::Storage;
use crate::time::Instant;
use crate::variant::Variant;

/// What carries the bytes of a client, and knows the time.
pub trait Transport {
    /// Why it fails.
    type Error;

    /// Returns the time, for deadlines.
    fn now(&self) -> Instant;

    /// Sends a datagram, or as much of a stream's bytes as can be taken; `None` when it is `until` before that.
    ///
    /// # Errors
    ///
    /// When the connection cannot be used any more.
    fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, Self::Error>;

    /// Receives a datagram, or what is there of a stream; `None` when it is `until` before that. On a stream, 0 bytes
    /// mean that the peer has closed it.
    ///
    /// When `until` has passed, it returns what has arrived without waiting: this is called once before each request.
    ///
    /// # Errors
    ///
    /// When the connection cannot be used any more.
    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Self::Error>;

    /// Waits until it is `at`; received bytes stay where they are.
    fn sleep_until(&mut self, at: Instant);
}

/// A client of b-CAP with its transport.
#[derive(Debug)]
pub struct Connection<X, T, R = T> {
    transport: X,
    client: Client<T, R>,
}

impl<X: Transport, T: Storage, R: Storage> Connection<X, T, R> {
    /// Joins the two.
    #[must_use]
    pub const fn new(transport: X, client: Client<T, R>) -> Self {
        Self { transport, client }
    }

    /// Returns the client, to look at its last reply or to change its time limits.
    pub const fn client(&mut self) -> &mut Client<T, R> {
        &mut self.client
    }

    /// Returns the transport.
    pub const fn transport(&mut self) -> &mut X {
        &mut self.transport
    }

    /// Takes the two apart, to put something between them, such as a transport that writes down what passes.
    #[must_use]
    pub fn into_parts(self) -> (X, Client<T, R>) {
        (self.transport, self.client)
    }

    /// Returns the code of the last reply; one of success can mean more than S_OK.
    #[must_use]
    pub fn last_result(&self) -> Option<HResult> {
        self.client.reply().map(|frame| frame.hresult())
    }

    /// Makes a call, waits for its reply and returns the value, which borrows from the client's buffer.
    ///
    /// Its timing is that of the client's configuration; [`call_with`](Self::call_with) takes another one.
    ///
    /// # Errors
    ///
    /// A [`CallError`]; [`is_recoverable`](CallError::is_recoverable) tells whether the connection is still good.
    pub fn call<C: Call>(&mut self, call: C) -> Result<<C::Reply as Reply>::Value<'_>, CallError<X::Error>> {
        let timing = self.client.timing();
        self.call_with(call, timing)
    }

    /// Makes a call as [`call`](Self::call) does, with its own time limits and attempts.
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

    /// Makes the call that a procedure wants, and hands its reply or failure in; returns why there is no reply.
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
        // an earlier run has left a call without a reply
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

/// A client of RAC with its transport.
#[derive(Debug)]
pub struct RacConnection<X, V> {
    transport: X,
    client: rac::client::Client<V>,
}

impl<X: Transport, V: Storage> RacConnection<X, V> {
    /// Joins the two.
    #[must_use]
    pub const fn new(transport: X, client: rac::client::Client<V>) -> Self {
        Self { transport, client }
    }

    /// Returns the client, to change its time limit.
    pub const fn client(&mut self) -> &mut rac::client::Client<V> {
        &mut self.client
    }

    /// Returns the transport.
    pub const fn transport(&mut self) -> &mut X {
        &mut self.transport
    }

    /// Takes the two apart, to put something between them, such as a transport that writes down what passes.
    #[must_use]
    pub fn into_parts(self) -> (X, rac::client::Client<V>) {
        (self.transport, self.client)
    }

    /// Reads a variable; a reply without a value stands for EMPTY.
    ///
    /// # Errors
    ///
    /// A [`RacError`]; [`is_recoverable`](RacError::is_recoverable) tells whether the connection is still good.
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
    let until = transport.now().saturating_add(client.flush_timeout());
    while !client.transmit().is_empty() {
        let sent = transport.send(client.transmit(), until).map_err(CallError::Io)?;
        client.transmitted(sent.ok_or(CallError::Client(M::BUSY))?);
    }
    for _ in 0..MAX_EARLY {
        if client.is_over() {
            return Err(CallError::Client(M::CLOSED));
        }
        let now = transport.now();
        let count = transport.receive(client.receive_buffer(), now).map_err(CallError::Io)?;
        if count.is_none() {
            break;
        }
        if let Some(end @ Err(_)) = moved(client, Direction::Receive, count, Instant::FAR_FUTURE, now) {
            return end;
        }
    }
    Ok(())
}

/// Moves bytes and time until the call has ended.
fn wait<X: Transport, M: Machine>(transport: &mut X, client: &mut M) -> Ended<X, M> {
    while let Some((direction, until)) = next(client) {
        let count = match direction {
            Direction::Send => transport.send(client.transmit(), until),
            Direction::Receive => transport.receive(client.receive_buffer(), until),
        };
        let count = count.map_err(CallError::Io)?;
        if let Some(end) = moved(client, direction, count, until, transport.now()) {
            return end;
        }
    }
    Err(CallError::Client(M::CLOSED))
}

/// A transport made of something that can be asked whether it has bytes, such as a UART, and a clock.
///
/// While it waits it asks again and again; where that is too much, implement [`Transport`] with a better wait.
#[cfg(feature = "embedded-io")]
#[derive(Debug)]
pub struct Polled<D, C> {
    device: D,
    clock: C,
}

#[cfg(feature = "embedded-io")]
impl<D, C: crate::time::Clock> Polled<D, C> {
    /// Joins a device and a clock.
    #[must_use]
    pub const fn new(device: D, clock: C) -> Self {
        Self { device, clock }
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
        // a write waits for the device alone, never for the peer
        let count = self.device.write(bytes)?;
        self.device.flush()?;
        Ok(Some(count))
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, D::Error> {
        while !self.device.read_ready()? {
            if self.clock.now() >= until {
                return Ok(None);
            }
            core::hint::spin_loop();
        }
        self.device.read(buffer).map(Some)
    }

    fn sleep_until(&mut self, at: Instant) {
        while self.clock.now() < at {
            core::hint::spin_loop();
        }
    }
}

#[cfg(test)]
mod tests;
