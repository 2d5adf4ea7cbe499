//! Blocking calls over any [`Transport`].
//!
//! With the feature `embedded-io`, `Polled` is a transport over an `embedded_io` device with `ReadReady`, such as a UART,
//! and a clock.

connections! { {} {} }

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

/// A transport over a device that can be polled, such as a UART, and a clock.
///
/// It waits in a busy loop; to sleep instead, implement [`Transport`]. An error of a read means lost bytes, except one that
/// says that the connection has ended.
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
    /// Reads without waiting; `None` if no bytes have arrived.
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
