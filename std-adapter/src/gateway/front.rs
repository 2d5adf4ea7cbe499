//! The protocol of a listener's clients: RAC, or Modbus TCP, whose requests become lines of RAC.

use std::io;
use std::net::Ipv4Addr;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::{Request, Response};
use bcap_core::variant::Writer;
use bcap_gateway::Gateway;
use bcap_gateway::modbus::{self, Entry};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::server::{REFUSAL_TIME, refuse_rac};

/// Bytes that are read from a client of Modbus at once.
const CHUNK: usize = 512;

/// The protocol of a listener's clients; for Modbus, with the map of its registers and coils.
pub(super) type Map = Option<&'static [Entry]>;

/// The bytes of one client on their way from and to the gateway.
pub(super) enum Front {
    /// The gateway owns them.
    Rac,
    /// Lines of RAC are made of them; with the address of the client, to which rules for networks apply.
    Modbus(Box<modbus::Front<'static>>, Option<Ipv4Addr>),
}

impl Front {
    pub(super) fn new(map: Map, client: Option<Ipv4Addr>) -> Self {
        map.map_or(Self::Rac, |map| Self::Modbus(Box::new(modbus::Front::new(map)), client))
    }

    /// Moves lines and replies between a client of Modbus and the gateway. After `true` the gateway must be polled.
    pub(super) fn exchange(&mut self, gateway: &mut Gateway<'_>, peer: PeerId) -> bool {
        let Self::Modbus(front, client) = self else { return false };
        let rules = gateway.config().rules;
        let reply = gateway.transmit(peer);
        let replied = reply.len();
        if replied > 0 {
            front.replied(reply, |request: &Request<'_>| rules.permits(request, *client).is_ok());
            gateway.transmitted(peer, replied);
        }
        let count = gateway.receive_buffer(peer).iter_mut().zip(front.line()).map(|(to, from)| *to = *from).count();
        if count > 0 {
            front.line_taken(count);
            gateway.received(peer, count);
        }
        replied > 0 || count > 0
    }

    /// Returns the bytes to send to the client.
    pub(super) fn transmit<'a>(&'a self, gateway: &'a Gateway<'_>, peer: PeerId) -> &'a [u8] {
        match self {
            Self::Rac => gateway.transmit(peer),
            Self::Modbus(front, _) => front.transmit(),
        }
    }

    /// Records that the client's connection has taken some of these bytes.
    pub(super) fn transmitted(&mut self, gateway: &mut Gateway<'_>, peer: PeerId, count: usize) {
        match self {
            Self::Rac => gateway.transmitted(peer, count),
            Self::Modbus(front, client) => {
                front.transmitted(count);
                // the next request may have arrived
                receive(front, *client, gateway, &[]);
            }
        }
    }

    /// Tells whether there is room for bytes of the client.
    pub(super) fn has_room(&self, gateway: &mut Gateway<'_>, peer: PeerId) -> bool {
        match self {
            Self::Rac => !gateway.receive_buffer(peer).is_empty(),
            Self::Modbus(front, _) => front.room() > 0,
        }
    }

    /// Receives bytes of the client, calls `show` with them, and returns their number.
    ///
    /// Returns `None` while no bytes have arrived or the buffer is full.
    pub(super) fn receive(
        &mut self,
        stream: &TcpStream,
        gateway: &mut Gateway<'_>,
        peer: PeerId,
        show: impl FnOnce(&[u8]),
    ) -> io::Result<Option<usize>> {
        let mut chunk = [0; CHUNK];
        let room = match self {
            Self::Rac => gateway.receive_buffer(peer),
            Self::Modbus(front, _) => chunk.get_mut(..front.room().min(CHUNK)).unwrap_or_default(),
        };
        if room.is_empty() {
            return Ok(None);
        }
        let received = stream.try_read(room);
        if must_wait(&received) {
            return Ok(None);
        }
        let count = received?;
        let bytes = room.get(..count).unwrap_or_default();
        if !bytes.is_empty() {
            show(bytes);
        }
        match self {
            Self::Rac => gateway.received(peer, count),
            Self::Modbus(front, client) => receive(front, *client, gateway, chunk.get(..count).unwrap_or_default()),
        }
        Ok(Some(count))
    }

    /// Tells whether a request runs.
    pub(super) fn is_running(&self, gateway: &Gateway<'_>, peer: PeerId) -> bool {
        match self {
            Self::Rac => gateway.is_running(peer),
            Self::Modbus(front, _) => front.is_running(),
        }
    }

    /// Tells whether a request of a client of Modbus runs or bytes of its response are left to send. Its client keeps its slot
    /// meanwhile, also between two lines, while the gateway itself has nothing to do for it.
    pub(super) fn is_busy(&self) -> bool {
        matches!(self, Self::Modbus(front, _) if front.is_running() || !front.transmit().is_empty())
    }

    /// Tells whether a part of a request has arrived.
    pub(super) fn is_receiving(&self, gateway: &Gateway<'_>, peer: PeerId) -> bool {
        match self {
            Self::Rac => gateway.is_receiving(peer),
            Self::Modbus(front, _) => front.is_receiving(),
        }
    }

    /// Tells whether the client of Modbus sent other bytes.
    pub(super) fn is_broken(&self) -> bool {
        matches!(self, Self::Modbus(front, _) if front.is_broken())
    }
}

/// Tells whether a call on a socket has to wait; any other error is the end of the connection.
pub(super) fn must_wait<T>(result: &io::Result<T>) -> bool {
    matches!(result, Err(error) if error.kind() == io::ErrorKind::WouldBlock)
}

fn receive(front: &mut modbus::Front<'_>, client: Option<Ipv4Addr>, gateway: &Gateway<'_>, bytes: &[u8]) {
    let rules = gateway.config().rules;
    front.received(bytes, |request: &Request<'_>| rules.permits(request, client).is_ok());
}

/// Answers the first request of a client without a slot: E_MAX_CONNECT, or the exception "server device busy".
pub(super) async fn refuse(mut stream: TcpStream, map: Map) {
    let Some(map) = map else { return refuse_rac(stream).await };
    let answer = async {
        let mut front = modbus::Front::new(map);
        let mut chunk = [0; CHUNK];
        while front.line().is_empty() {
            let room = chunk.get_mut(..front.room().min(CHUNK))?;
            let count = stream.read(room).await.ok().filter(|count| *count > 0)?;
            front.received(chunk.get(..count)?, |_| true);
            if front.is_broken() {
                return None;
            }
        }
        let mut line = [0; 16];
        let mut out = Writer::new(&mut line);
        Response { result: HResult::E_MAX_CONNECT, value: None }.write_line(&mut out).ok()?;
        front.replied(out.as_bytes(), |_| true);
        stream.write_all(front.transmit()).await.ok()?;
        stream.shutdown().await.ok()
    };
    let _ = timeout(REFUSAL_TIME, answer).await;
}
