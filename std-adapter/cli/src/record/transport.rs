//! A client's socket that records its traffic, if the command has a recording.

use std::io;

use bcap_core::rac::MAX_VALUE;
use bcap_core::time::Instant;
use bcap_std::blocking::{Connection, RacClient, RacConnection, TcpTransport, Transport, UdpTransport};

use super::{Ends, Recorder, current};
use crate::frame::Role;

/// A socket whose ends are known.
pub(crate) trait HasEnds: Transport<Error = io::Error> {
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

/// A transport that records.
#[derive(Debug)]
pub(crate) struct Taped<X> {
    inner: X,
    /// `None` without a recording.
    tape: Option<(&'static Recorder, Ends)>,
}

impl<X: HasEnds> Taped<X> {
    fn new(inner: X) -> Self {
        let tape = current().zip(inner.ends());
        if let Some((recorder, ends)) = tape {
            recorder.opened(ends);
        }
        Self { inner, tape }
    }
}

impl<X> Taped<X> {
    fn record(&self, sender: Role, bytes: &[u8], count: Option<usize>) {
        if let Some((recorder, ends)) = self.tape {
            recorder.bytes(recorder.now(), ends, sender, bytes.get(..count.unwrap_or(0)).unwrap_or_default());
        }
    }
}

/// Records a connection from now on.
pub(crate) fn taped<X: HasEnds>(connection: Connection<X, Vec<u8>>) -> Connection<Taped<X>, Vec<u8>> {
    let (transport, client) = connection.into_parts();
    Connection::new(Taped::new(transport), client)
}

/// A TCP socket that records.
pub(crate) type TapedTcp = Taped<TcpTransport>;

/// A client of RAC that records.
pub(crate) type TapedRac = RacConnection<TapedTcp, [u8; MAX_VALUE]>;

/// Records a connection of RAC from now on.
pub(crate) fn taped_rac(connection: RacClient) -> TapedRac {
    let (transport, client) = connection.into_parts();
    RacConnection::new(Taped::new(transport), client)
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
        if let Some((recorder, ends)) = self.tape {
            recorder.closed(ends);
        }
    }
}
