//! Asynchronous calls over any [`Transport`].
//!
//! With the feature `embedded-io-async`, `Timed` is a transport over an `embedded_io_async` device and a timer. The loops
//! do not allocate, need no particular executor, and their futures may be dropped at any point.

connections! { {async} {.await} "# Cancel safety" }

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
    ///
    /// # Cancel safety
    ///
    /// A future that is dropped before it is ready has sent nothing.
    fn send(&mut self, bytes: &[u8], until: Instant) -> impl Future<Output = Result<Option<usize>, Self::Error>>;

    /// Receives a datagram, or available bytes of a stream, and returns their count; `None` at `until`. On a stream, 0
    /// bytes mean that the peer has closed it.
    ///
    /// If `until` has passed, it returns bytes that have arrived, without waiting. Before each request the loops call it with
    /// [`Instant::ZERO`], for which it need not read the clock.
    ///
    /// # Errors
    ///
    /// When the connection failed.
    ///
    /// # Cancel safety
    ///
    /// A future that is dropped before it is ready has received nothing.
    fn receive(
        &mut self,
        buffer: &mut [u8],
        until: Instant,
    ) -> impl Future<Output = Result<Option<usize>, Self::Error>>;

    /// Waits until `at`, and reads no bytes.
    fn sleep_until(&mut self, at: Instant) -> impl Future<Output = ()>;
}

/// A [`Transport`] whose futures are `Send`, so that code over any transport can be spawned on several threads.
///
/// Implement this trait for a transport that uses the standard library; it then also implements [`Transport`].
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::call::{VariableHandle, variable_get_value};
/// use bcap_core::io::asynch::{Connection, SendTransport};
///
/// fn is_send<T: Send>(future: T) -> T {
///     future
/// }
///
/// fn driver<X: SendTransport + Send>(mut robot: Connection<X, [u8; 512]>) -> impl Future<Output = bool> + Send {
///     is_send(async move { robot.call(variable_get_value(VariableHandle(1))).await.is_ok() })
/// }
/// ```
pub trait SendTransport {
    /// Same as [`Transport::Error`].
    type Error: Send;

    /// Same as [`Transport::now`].
    fn now(&self) -> Instant;

    /// Same as [`Transport::send`].
    ///
    /// # Errors
    ///
    /// When the connection failed.
    fn send(&mut self, bytes: &[u8], until: Instant)
    -> impl Future<Output = Result<Option<usize>, Self::Error>> + Send;

    /// Same as [`Transport::receive`].
    ///
    /// # Errors
    ///
    /// When the connection failed.
    fn receive(
        &mut self,
        buffer: &mut [u8],
        until: Instant,
    ) -> impl Future<Output = Result<Option<usize>, Self::Error>> + Send;

    /// Same as [`Transport::sleep_until`].
    fn sleep_until(&mut self, at: Instant) -> impl Future<Output = ()> + Send;
}

impl<X: SendTransport> Transport for X {
    type Error = X::Error;

    fn now(&self) -> Instant {
        SendTransport::now(self)
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> impl Future<Output = Result<Option<usize>, Self::Error>> {
        SendTransport::send(self, bytes, until)
    }

    fn receive(
        &mut self,
        buffer: &mut [u8],
        until: Instant,
    ) -> impl Future<Output = Result<Option<usize>, Self::Error>> {
        SendTransport::receive(self, buffer, until)
    }

    fn sleep_until(&mut self, at: Instant) -> impl Future<Output = ()> {
        SendTransport::sleep_until(self, at)
    }
}

/// The pause after lost bytes, so that a device that only fails does not keep its task running.
#[cfg(feature = "embedded-io-async")]
const LINE_ERROR_PAUSE: core::time::Duration = core::time::Duration::from_millis(1);

/// A timer for [`Timed`].
#[cfg(feature = "embedded-io-async")]
pub trait Timer: crate::time::Clock {
    /// Waits until `at`.
    fn sleep_until(&mut self, at: Instant) -> impl Future<Output = ()>;
}

/// A transport over a device that reads and writes, and a timer.
///
/// `read` and `write` of the device must be cancel-safe, as `embedded_io_async` requires. An error of a read means lost bytes,
/// except one that says that the connection has ended.
#[cfg(feature = "embedded-io-async")]
#[derive(Debug)]
pub struct Timed<D, C> {
    device: D,
    timer: C,
}

#[cfg(feature = "embedded-io-async")]
impl<D, C: Timer> Timed<D, C> {
    /// Combines a device and a timer.
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
        use embedded_io_async::Error as _;
        let Self { device, timer } = self;
        loop {
            // a device with a buffer may otherwise never send the request
            let read = async {
                device.flush().await?;
                device.read(buffer).await
            };
            match first(read, timer.sleep_until(until)).await {
                Some(Err(error)) if !super::ends_connection(error.kind()) => {}
                received => return received.transpose(),
            }
            let now = timer.now();
            if now >= until {
                return Ok(None);
            }
            timer.sleep_until(until.min(now.saturating_add(LINE_ERROR_PAUSE))).await;
        }
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.timer.sleep_until(at).await;
    }
}

/// Waits for `work` or `end`; `None` when `end` is ready first.
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
