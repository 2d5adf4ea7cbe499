//! Calls that are awaited, over any [`Transport`].
//!
//! With the feature `embedded-io-async`, `Timed` makes a transport of anything that reads and writes and a timer.
//! Nothing is allocated and no executor is assumed; all futures here may be dropped at any point.

use crate::bcap::call::{Call, Reply};
use crate::bcap::client::ClientError;
use crate::bcap::{Client, Link};
use crate::hresult::HResult;
use crate::io::{CallError, ends};
use crate::storage::Storage;
use crate::time::Instant;

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
    ///
    /// # Cancel safety
    ///
    /// A future that is dropped before it is ready has sent nothing.
    fn send(&mut self, bytes: &[u8], until: Instant) -> impl Future<Output = Result<Option<usize>, Self::Error>>;

    /// Receives a datagram, or what is there of a stream; `None` when it is `until` before that. On a stream, 0 bytes
    /// mean that the peer has closed it.
    ///
    /// # Errors
    ///
    /// When the connection cannot be used any more.
    ///
    /// # Cancel safety
    ///
    /// A future that is dropped before it is ready has received nothing.
    fn receive(
        &mut self,
        buffer: &mut [u8],
        until: Instant,
    ) -> impl Future<Output = Result<Option<usize>, Self::Error>>;
}

/// A client with its transport.
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
    ///
    /// # Cancel safety
    ///
    /// When the future is dropped the call is given up: what had begun to be sent is finished before the next call,
    /// and the reply, if it comes, is dropped. Whether the controller has executed the call is then unknown.
    pub async fn call<C: Call>(&mut self, call: C) -> Result<<C::Reply as Reply>::Value<'_>, CallError<X::Error>> {
        self.flush().await?;
        self.client.start(&call, self.transport.now())?;
        self.wait().await?;
        Ok(self.client.value::<C::Reply>()?)
    }

    /// Sends the rest of a call that was given up.
    async fn flush(&mut self) -> Result<(), CallError<X::Error>> {
        self.client.abandon();
        if self.client.transmit().is_empty() {
            return Ok(());
        }
        let until = self.transport.now().saturating_add(self.client.config().attempt_timeout);
        while !self.client.transmit().is_empty() {
            if !self.send(until).await? {
                return Err(CallError::Client(ClientError::Busy));
            }
        }
        Ok(())
    }

    /// Moves bytes and time until the call has ended.
    async fn wait(&mut self) -> Result<(), CallError<X::Error>> {
        while let Some(until) = self.client.poll_timeout() {
            let idle = self.client.transmit().is_empty();
            let moved = if idle { self.receive(until).await? } else { self.send(until).await? };
            let now = self.transport.now();
            while let Some(event) = self.client.poll_event(now) {
                if let Some(end) = ends(event) {
                    return end;
                }
            }
            // after the events, so that a reply that has just come counts
            if (!moved || now >= until)
                && let Some(end) = self.client.handle_timeout(now).and_then(ends)
            {
                return end;
            }
        }
        Err(CallError::Client(ClientError::Closed))
    }

    /// Sends what it can; `false` when the time was over first.
    async fn send(&mut self, until: Instant) -> Result<bool, CallError<X::Error>> {
        let sent = self.transport.send(self.client.transmit(), until).await.map_err(CallError::Io)?;
        self.client.transmitted(sent.unwrap_or(0));
        Ok(sent.is_some())
    }

    /// Receives what there is; `false` when the time was over first.
    async fn receive(&mut self, until: Instant) -> Result<bool, CallError<X::Error>> {
        let received = self.transport.receive(self.client.receive_buffer(), until).await.map_err(CallError::Io)?;
        match received {
            Some(0) if self.client.config().link != Link::Datagram => Err(CallError::Disconnected),
            Some(count) => {
                self.client.received(count);
                Ok(true)
            }
            None => Ok(false),
        }
    }
}

/// A timer for [`Timed`].
#[cfg(feature = "embedded-io-async")]
pub trait Timer: crate::time::Clock {
    /// Waits until it is `at`.
    fn sleep_until(&mut self, at: Instant) -> impl Future<Output = ()>;
}

/// A transport made of something that reads and writes, and a timer.
///
/// Its `read` and `write` must lose nothing when their futures are dropped, as `embedded_io_async` asks for.
#[cfg(feature = "embedded-io-async")]
#[derive(Debug)]
pub struct Timed<D, C> {
    device: D,
    timer: C,
}

#[cfg(feature = "embedded-io-async")]
impl<D, C: Timer> Timed<D, C> {
    /// Joins a device and a timer.
    #[must_use]
    pub const fn new(device: D, timer: C) -> Self {
        Self { device, timer }
    }
}

#[cfg(feature = "embedded-io-async")]
impl<D, C> Transport for Timed<D, C>
where
    D: embedded_io_async::Read + embedded_io_async::Write,
    C: Timer,
{
    type Error = D::Error;

    fn now(&self) -> Instant {
        self.timer.now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, D::Error> {
        let Self { device, timer } = self;
        first(device.write(bytes), timer.sleep_until(until)).await.transpose()
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, D::Error> {
        let Self { device, timer } = self;
        // a device with a buffer of its own may hold the request back for ever otherwise
        let read = async {
            device.flush().await?;
            device.read(buffer).await
        };
        first(read, timer.sleep_until(until)).await.transpose()
    }
}

/// Waits for `work`, or for `end`; `None` when `end` was first.
#[cfg(feature = "embedded-io-async")]
async fn first<T>(work: impl Future<Output = T>, end: impl Future<Output = ()>) -> Option<T> {
    use core::task::Poll;
    let mut work = core::pin::pin!(work);
    let mut end = core::pin::pin!(end);
    core::future::poll_fn(|cx| match work.as_mut().poll(cx) {
        Poll::Ready(done) => Poll::Ready(Some(done)),
        Poll::Pending => end.as_mut().poll(cx).map(|()| None),
    })
    .await
}

#[cfg(test)]
mod tests;
