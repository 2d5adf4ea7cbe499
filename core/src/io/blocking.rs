//! Calls that block, over any [`Transport`].
//!
//! With the feature `embedded-io`, `Polled` makes a transport of anything that reads, writes and can say whether bytes
//! are there (a UART), and a clock.

mod stream;

use crate::bcap::Client;
use crate::bcap::call::{Call, Reply};
use crate::hresult::HResult;
use crate::io::{CallError, MAX_EARLY, Machine, RacError, Step};
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
    /// # Errors
    ///
    /// A [`CallError`]; [`is_recoverable`](CallError::is_recoverable) tells whether the connection is still good.
    pub fn call<C: Call>(&mut self, call: C) -> Result<<C::Reply as Reply>::Value<'_>, CallError<X::Error>> {
        flush(&mut self.transport, &mut self.client)?;
        drain(&mut self.transport, &mut self.client)?;
        self.client.start(&call, self.transport.now())?;
        wait(&mut self.transport, &mut self.client)?;
        Ok(self.client.value::<C::Reply>()?)
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
        flush(&mut self.transport, &mut self.client)?;
        drain(&mut self.transport, &mut self.client)?;
        self.client.start(request, self.transport.now())?;
        wait(&mut self.transport, &mut self.client)
    }
}

type Ended<X, M> = Result<(), CallError<<X as Transport>::Error, <M as Machine>::Error>>;
type Moved<X, M> = Result<bool, CallError<<X as Transport>::Error, <M as Machine>::Error>>;

/// Sends the rest of a call that was given up.
fn flush<X: Transport, M: Machine>(transport: &mut X, client: &mut M) -> Ended<X, M> {
    client.abandon();
    if client.transmit().is_empty() {
        return Ok(());
    }
    let until = transport.now().saturating_add(client.patience());
    while !client.transmit().is_empty() {
        if !send(transport, client, until)? {
            return Err(CallError::Client(M::BUSY));
        }
    }
    Ok(())
}

/// Receives what has arrived before a call, so that it is not taken for the reply.
fn drain<X: Transport, M: Machine>(transport: &mut X, client: &mut M) -> Ended<X, M> {
    for _ in 0..MAX_EARLY {
        if client.is_closed() {
            return Err(CallError::Client(M::CLOSED));
        }
        let now = transport.now();
        if !receive(transport, client, now)? {
            break;
        }
        while let Some(step) = client.poll(now) {
            if let Some(end @ Err(_)) = step.end() {
                return end;
            }
        }
    }
    Ok(())
}

/// Moves bytes and time until the call has ended.
fn wait<X: Transport, M: Machine>(transport: &mut X, client: &mut M) -> Ended<X, M> {
    while let Some(until) = client.poll_timeout() {
        let moved = match client.transmit() {
            [] => receive(transport, client, until)?,
            _ => send(transport, client, until)?,
        };
        let now = transport.now();
        while let Some(step) = client.poll(now) {
            if let Some(end) = step.end() {
                return end;
            }
        }
        // after the events, so that a reply that has just come counts
        if (!moved || now >= until)
            && let Some(end) = client.handle_timeout(now).and_then(Step::end)
        {
            return end;
        }
    }
    Err(CallError::Client(M::CLOSED))
}

/// Sends what it can; `false` when the time was over first.
fn send<X: Transport, M: Machine>(transport: &mut X, client: &mut M, until: Instant) -> Moved<X, M> {
    let sent = transport.send(client.transmit(), until).map_err(CallError::Io)?;
    client.transmitted(sent.unwrap_or(0));
    Ok(sent.is_some())
}

/// Receives what there is; `false` when the time was over first.
fn receive<X: Transport, M: Machine>(transport: &mut X, client: &mut M, until: Instant) -> Moved<X, M> {
    let received = transport.receive(client.receive_buffer(), until).map_err(CallError::Io)?;
    match received {
        Some(0) if !client.has_datagrams() => Err(CallError::Disconnected),
        Some(count) => {
            client.received(count);
            Ok(true)
        }
        None => Ok(false),
    }
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
}

#[cfg(test)]
mod tests;
