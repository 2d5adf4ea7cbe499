//! Connections, written once for both loops.
//!
//! The macro expands in [`asynch`](super::asynch) and in [`blocking`](super::blocking), next to their `Transport`. A blocking
//! function is not an async one that is polled by an executor, because the compiler puts a panic into every `async fn`, for a
//! poll after its end. A firmware that only blocks must have no panic (`tests/no-panic`).

/// Expands to the connections of b-CAP and RAC over the `Transport` of the module.
///
/// `$async` and `$await` are empty in blocking functions, and so is `$cancel_safety`, the heading of the section about dropped
/// futures. The body is not indented, because the test of cancel safety finds its functions by line.
macro_rules! connections {
    ({$($async:ident)?} {$($await:tt)*} $($cancel_safety:literal)?) => {
use core::ops::ControlFlow;
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

    /// Returns transport and client, to wrap the transport in another transport, such as one that records the bytes.
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
    /// It uses the timing of the client's configuration; [`call_with`](Self::call_with) takes another timing.
    ///
    /// # Errors
    ///
    /// A [`CallError`]; [`is_recoverable`](CallError::is_recoverable) tells whether the connection can still be used.
    $(
    ///
    #[doc = $cancel_safety]
    ///
    /// Dropping the future abandons the call: the next call first sends the rest of a partly sent request, and a late reply
    /// is dropped. The controller may or may not execute the abandoned call; a motion that it started continues, and a halt on
    /// this connection waits for the end of that call. Use [`move_and_wait`](crate::procedure::move_and_wait) for motions.
    )?
    pub $($async)? fn call<C: Call>(&mut self, call: C) -> Result<<C::Reply as Reply>::Value<'_>, CallError<X::Error>> {
        // not through `call_with`, whose future would hold the call twice and its timing
        clear(&mut self.transport, &mut self.client)$($await)*?;
        self.client.start_as_configured(&call, self.transport.now())?;
        wait(&mut self.transport, &mut self.client)$($await)*?;
        Ok(self.client.value::<C::Reply>()?)
    }

    /// Makes a call like [`call`](Self::call), and keeps its reply in the [client](Self::client), which also reports after a
    /// failure whether the call [was sent](Client::was_sent).
    ///
    /// # Errors
    ///
    /// Same as [`call`](Self::call).
    $(
    ///
    #[doc = $cancel_safety]
    ///
    /// Same as [`call`](Self::call).
    )?
    pub $($async)? fn exchange<C: Call>(&mut self, call: C) -> Result<(), CallError<X::Error>> {
        clear(&mut self.transport, &mut self.client)$($await)*?;
        self.client.start_as_configured(&call, self.transport.now())?;
        wait(&mut self.transport, &mut self.client)$($await)*
    }

    /// Makes a call like [`call`](Self::call), with its own timing.
    ///
    /// # Errors
    ///
    /// Same as [`call`](Self::call).
    $(
    ///
    #[doc = $cancel_safety]
    ///
    /// Same as [`call`](Self::call).
    )?
    pub $($async)? fn call_with<C: Call>(
        &mut self,
        call: C,
        timing: Timing,
    ) -> Result<<C::Reply as Reply>::Value<'_>, CallError<X::Error>> {
        clear(&mut self.transport, &mut self.client)$($await)*?;
        self.client.start(&call, timing, self.transport.now())?;
        wait(&mut self.transport, &mut self.client)$($await)*?;
        Ok(self.client.value::<C::Reply>()?)
    }

    /// Runs a procedure over this connection until it is done.
    ///
    /// # Errors
    ///
    /// A [`RunError`]: the procedure's own error, and the error of the first call without a reply.
    $(
    ///
    #[doc = $cancel_safety]
    ///
    /// Dropping the future abandons the call in flight, as in [`call`](Self::call), and the procedure keeps its state. When
    /// it is run again, it first handles the failure of that call.
    )?
    pub $($async)? fn run<P: Procedure>(&mut self, procedure: P) -> Result<P::Output, RunError<P::Error, X::Error>> {
        run(procedure, self, None::<&mut Self>)$($await)*
    }

    /// Runs a procedure over this connection, and its calls of [`Channel::Watch`] over another connection.
    ///
    /// # Errors
    ///
    /// Same as [`run`](Self::run).
    $(
    ///
    #[doc = $cancel_safety]
    ///
    /// Same as [`run`](Self::run).
    )?
    pub $($async)? fn run_watched<P, Y, U, S>(
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
        run(procedure, self, Some(watch))$($await)*
    }

    /// Makes the calls of a procedure until it waits or ends, so that other calls can be made while it waits.
    ///
    /// Returns the time of the next call, or the result.
    $(
    ///
    #[doc = $cancel_safety]
    ///
    /// Same as [`run`](Self::run).
    )?
    pub $($async)? fn advance<P: Procedure>(
        &mut self,
        running: &mut Running<P, X::Error>,
    ) -> ControlFlow<Result<P::Output, RunError<P::Error, X::Error>>, Instant> {
        advance(running, self, None::<&mut Self>)$($await)*
    }

    /// Makes the call of a procedure, and passes in its reply or failure; returns the error of a call without a reply.
    $($async)? fn perform<P: Procedure>(&mut self, procedure: &mut P) -> Option<CallError<X::Error>> {
        let ended = self.carry(procedure)$($await)*;
        hand_in(procedure, &self.client, ended, self.transport.now())
    }

    /// Makes the call of a procedure. The call does not exist across an await, so the future is `Send` when the procedure
    /// is.
    $($async)? fn carry<P: Procedure>(&mut self, procedure: &mut P) -> Result<(), CallError<X::Error>> {
        clear(&mut self.transport, &mut self.client)$($await)*?;
        let timing = procedure.timing(self.client.link(), self.client.timing());
        if let Some(request) = procedure.request() {
            self.client.start(&request, timing, self.transport.now())?;
        }
        wait(&mut self.transport, &mut self.client)$($await)*
    }
}

/// A procedure for [`Connection::advance`].
#[derive(Debug)]
pub struct Running<P, E> {
    procedure: P,
    /// The error of its first call without a reply.
    lost: Option<CallError<E>>,
}

impl<P, E> Running<P, E> {
    /// Begins a procedure.
    #[must_use]
    pub const fn new(procedure: P) -> Self {
        Self { procedure, lost: None }
    }
}

/// Runs a procedure over one connection or two.
$($async)? fn run<P, X, T, R, Y, U, S>(
    procedure: P,
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
    let mut running = Running::new(procedure);
    loop {
        match advance(&mut running, motion, watch.as_deref_mut())$($await)* {
            ControlFlow::Continue(at) => motion.transport.sleep_until(at)$($await)*,
            ControlFlow::Break(result) => return result,
        }
    }
}

/// Makes the calls of a procedure until it waits or ends.
$($async)? fn advance<P, X, T, R, Y, U, S>(
    running: &mut Running<P, X::Error>,
    motion: &mut Connection<X, T, R>,
    mut watch: Option<&mut Connection<Y, U, S>>,
) -> ControlFlow<Result<P::Output, RunError<P::Error, X::Error>>, Instant>
where
    P: Procedure,
    X: Transport,
    Y: Transport<Error = X::Error>,
    T: Storage,
    R: Storage,
    U: Storage,
    S: Storage,
{
    let Running { procedure, lost } = running;
    if procedure.request().is_some() {
        // a dropped run ended with a call in flight
        procedure.handle_failure(Failure::Timeout, motion.transport.now());
    }
    loop {
        let error = match (procedure.poll(motion.transport.now()), &mut watch) {
            (Action::Call(Channel::Watch), Some(watch)) => watch.perform(procedure)$($await)*,
            (Action::Call(_), _) => motion.perform(procedure)$($await)*,
            (Action::Wait(at), _) => return ControlFlow::Continue(at),
            (Action::Done(result), _) => {
                return ControlFlow::Break(result.map_err(|error| RunError { error, call: lost.take() }));
            }
        };
        *lost = lost.take().or(error);
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

    /// Returns transport and client, to wrap the transport in another transport, such as one that records the bytes.
    #[must_use]
    pub fn into_parts(self) -> (X, rac::Client<V>) {
        (self.transport, self.client)
    }

    /// Reads a variable; EMPTY if the reply has no value.
    ///
    /// # Errors
    ///
    /// A [`RacError`]; [`is_recoverable`](RacError::is_recoverable) tells whether the connection can still be used.
    $(
    ///
    #[doc = $cancel_safety]
    ///
    /// Dropping the future abandons the request: the next request first sends the rest of a partly sent one, and waits for
    /// its reply, which is dropped. The controller may or may not execute the abandoned request.
    )?
    pub $($async)? fn get(&mut self, variable: Variable) -> Result<Variant<'_>, RacError<X::Error>> {
        self.request(&Request::Get(variable))$($await)*?;
        Ok(self.client.reply().and_then(|reply| reply.value).unwrap_or(Variant::Empty))
    }

    /// Writes a variable.
    ///
    /// # Errors
    ///
    /// Same as [`get`](Self::get), or [`Request`](rac::client::ClientError::Request) for a value that has no text.
    $(
    ///
    #[doc = $cancel_safety]
    ///
    /// Dropping the future abandons the request: the next request first sends the rest of a partly sent one, and waits for
    /// its reply, which is dropped. The controller may or may not execute the abandoned request.
    )?
    pub $($async)? fn put(&mut self, variable: Variable, value: Variant<'_>) -> Result<(), RacError<X::Error>> {
        self.request(&Request::Put(variable, value))$($await)*
    }

    $($async)? fn request(&mut self, request: &Request<'_>) -> Result<(), RacError<X::Error>> {
        clear(&mut self.transport, &mut self.client)$($await)*?;
        self.client.start(request, self.transport.now())?;
        wait(&mut self.transport, &mut self.client)$($await)*
    }
}

type Ended<X, M> = Result<(), CallError<<X as Transport>::Error, <M as Machine>::Error>>;

/// Clears the link for a call: sends the rest of an abandoned call, and drops the bytes that arrived before this call, so that
/// they are not taken for the reply.
$($async)? fn clear<X: Transport, M: Machine>(transport: &mut X, client: &mut M) -> Ended<X, M> {
    client.give_up();
    if !client.transmit().is_empty() {
        let until = transport.now().saturating_add(client.flush_timeout());
        while !client.transmit().is_empty() {
            let sent = transport.send(client.transmit(), until)$($await)*.map_err(CallError::Io)?;
            client.transmitted(sent.ok_or(CallError::Client(M::BUSY))?);
        }
    }
    for _ in 0..MAX_EARLY {
        if client.is_over() {
            return Err(CallError::Client(M::CLOSED));
        }
        let count = transport.receive(client.receive_buffer(), Instant::ZERO)$($await)*.map_err(CallError::Io)?;
        if count.is_none() {
            break;
        }
        if let Some(end @ Err(_)) = moved(client, Direction::Receive, count, Instant::FAR_FUTURE, &|| transport.now()) {
            return end;
        }
    }
    Ok(())
}

/// Runs the client until the call has ended.
$($async)? fn wait<X: Transport, M: Machine>(transport: &mut X, client: &mut M) -> Ended<X, M> {
    while let Some((direction, until)) = next(client) {
        let count = match direction {
            Direction::Send => transport.send(client.transmit(), until)$($await)*,
            Direction::Receive => transport.receive(client.receive_buffer(), until)$($await)*,
        };
        let count = count.map_err(CallError::Io)?;
        if direction == Direction::Send && sent(client, count) {
            continue;
        }
        if let Some(end) = moved(client, direction, count, until, &|| transport.now()) {
            return end;
        }
    }
    Err(CallError::Client(M::CLOSED))
}
    };
}
