//! A transport that records.

use std::io;

use bcap_core::rac::MAX_VALUE;
use bcap_core::time::Instant;
use bcap_std::blocking::{Connection, RacConnection, TcpTransport, Transport, UdpTransport};

use super::{Ends, Recorder};
use crate::role::Role;

/// A client of RAC over a transport.
type Rac<X> = RacConnection<X, [u8; MAX_VALUE]>;

/// A socket whose ends are known.
pub trait HasEnds: Transport<Error = io::Error> {
    /// Returns the ends; `None` if the socket is not connected.
    fn ends(&self) -> Option<Ends>;
}

impl HasEnds for TcpTransport {
    fn ends(&self) -> Option<Ends> {
        let (client, server) = (self.stream().local_addr().ok()?, self.stream().peer_addr().ok()?);
        Some(Ends { is_tcp: true, client, server })
    }
}

impl HasEnds for UdpTransport {
    fn ends(&self) -> Option<Ends> {
        let (client, server) = (self.socket().local_addr().ok()?, self.socket().peer_addr().ok()?);
        Some(Ends { is_tcp: false, client, server })
    }
}

/// A transport that records its bytes; its drop records the end of the connection.
#[derive(Debug)]
pub struct Taped<X> {
    inner: X,
    /// `None` without a recording.
    tape: Option<(Recorder, Ends)>,
}

impl<X: HasEnds> Taped<X> {
    /// Records a connection from now on; without a recorder it passes all bytes.
    pub fn new(inner: X, recorder: Option<&Recorder>) -> Self {
        let tape = recorder.cloned().zip(inner.ends());
        if let Some((recorder, ends)) = &tape {
            recorder.opened(*ends);
        }
        Self { inner, tape }
    }

    /// Records a connection of b-CAP from now on.
    #[must_use]
    pub fn connection(connection: Connection<X, Vec<u8>>, recorder: Option<&Recorder>) -> Connection<Self, Vec<u8>> {
        let (transport, client) = connection.into_parts();
        Connection::new(Self::new(transport, recorder), client)
    }

    /// Records a connection of RAC from now on.
    #[must_use]
    pub fn rac_connection(connection: Rac<X>, recorder: Option<&Recorder>) -> Rac<Self> {
        let (transport, client) = connection.into_parts();
        RacConnection::new(Self::new(transport, recorder), client)
    }
}

impl<X> Taped<X> {
    fn record(&self, sender: Role, bytes: &[u8], count: Option<usize>) {
        if let Some((recorder, ends)) = &self.tape {
            recorder.bytes(recorder.now(), *ends, sender, bytes.get(..count.unwrap_or(0)).unwrap_or_default());
        }
    }
}

impl<X: Transport<Error = io::Error>> Transport for Taped<X> {
    type Error = io::Error;

    fn now(&self) -> Instant {
        self.inner.now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let sent = self.inner.send(bytes, until)?;
        self.record(Role::Request, bytes, sent);
        Ok(sent)
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let received = self.inner.receive(buffer, until)?;
        self.record(Role::Response, buffer, received);
        Ok(received)
    }

    fn sleep_until(&mut self, at: Instant) {
        self.inner.sleep_until(at);
    }
}

impl<X> Drop for Taped<X> {
    fn drop(&mut self) {
        if let Some((recorder, ends)) = &self.tape {
            recorder.closed(*ends);
        }
    }
}
