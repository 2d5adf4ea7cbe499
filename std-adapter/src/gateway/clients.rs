//! The PLCs' side of a gateway: listeners, and a task for each connection.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::io::asynch::SendTransport;
use bcap_core::time::Instant;
use bcap_gateway::driver::{self, Front, Limits};
use bcap_gateway::modbus::{self, Entry};
use socket2::SockRef;
use tokio::io::AsyncWriteExt as _;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

use super::platform::SharedGateway;
use super::traffic::{Moved, TrafficTap};
use crate::asynch::TcpTransport;
use crate::connect::set_up_tcp;
use crate::server::{REFUSAL_TIME, REFUSALS};

/// The time to wait when a connection cannot be accepted, such as without a free file descriptor.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// The silence after which the operating system probes a PLC.
const KEEP_ALIVE: Duration = Duration::from_secs(60);

/// The size of a read, in bytes: larger than a line of RAC or a frame of Modbus.
const CHUNK: usize = 512;

/// The protocol of a listener's clients: RAC (`None`), or Modbus with the map of its registers and coils.
pub(super) type Map = Option<&'static [Entry]>;

/// The state that all connections of a listener share.
#[derive(Clone)]
pub(super) struct Plant {
    pub(super) shared: Arc<SharedGateway>,
    pub(super) tap: TrafficTap,
    pub(super) limits: Limits,
    pub(super) stopped: watch::Receiver<()>,
}

/// Accepts connections until the gateway stops, then waits until running requests are answered.
pub(super) async fn listen(listener: TcpListener, map: Map, mut plant: Plant) {
    let drain = plant.shared.view(|gateway| gateway.config().request_timeout).unwrap_or_default();
    let refusals = Arc::new(Semaphore::new(REFUSALS));
    let mut tasks = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = tasks.join_next() => continue,
            _ = plant.stopped.changed() => break,
        };
        let Ok((stream, client)) = accepted else {
            // the error of one connection is not the end of the listener
            sleep(ACCEPT_PAUSE).await;
            continue;
        };
        // before a slot is assigned, so that a client that is not admitted evicts no other client
        if plant.shared.admits(client) {
            tasks.spawn(serve(stream, client, map, plant.clone(), Arc::clone(&refusals)));
        } else {
            reset(&stream);
        }
    }
    drop(listener);
    let drained = timeout(drain, async { while tasks.join_next().await.is_some() {} });
    if drained.await.is_err() {
        tasks.shutdown().await;
    }
}

/// Sets a connection to close with a reset, which discards unsent bytes.
pub(super) fn reset(stream: &TcpStream) {
    // a socket that cannot be set up is closed already
    let _ = SockRef::from(stream).set_linger(Some(Duration::ZERO));
}

/// Serves a client until its connection ends or the gateway stops, or refuses it.
async fn serve(stream: TcpStream, client: SocketAddr, map: Map, mut plant: Plant, refusals: Arc<Semaphore>) {
    // a socket that cannot be set up is closed already, and its first read fails
    let _ = set_up_tcp(SockRef::from(&stream), Some(KEEP_ALIVE));
    let mut link = PlcLink { transport: TcpTransport::new(stream), tap: plant.tap.clone() };
    let shared = Arc::clone(&plant.shared);
    let mut modbus = map.map(|map| Box::new(modbus::Session::new(map)));
    let session =
        driver::serve::<_, _, CHUNK>(&mut link, front(&mut modbus), client, &shared, &plant.limits, io::Error::kind)
            .await;
    if session.is_some() {
        link.show(Moved::Closed);
    } else if let Ok(_permit) = refusals.try_acquire() {
        let mut chunk = [0; CHUNK];
        tokio::select! {
            () = driver::refuse(&mut link.transport, front(&mut modbus), REFUSAL_TIME, &mut chunk) => {}
            _ = plant.stopped.changed() => {}
        }
        // an error means that the client has gone
        let _ = link.transport.into_stream().shutdown().await;
    }
}

fn front<'a>(modbus: &'a mut Option<Box<modbus::Session<'static>>>) -> Front<'a, 'static> {
    modbus.as_deref_mut().map_or(Front::Rac, Front::Modbus)
}

/// The connection of a client, whose bytes are shown to the tap.
struct PlcLink {
    transport: TcpTransport,
    tap: TrafficTap,
}

impl PlcLink {
    fn show(&self, moved: Moved<'_>) {
        let stream = self.transport.stream();
        self.tap.show(|| Ok((true, stream.peer_addr()?, stream.local_addr()?)), moved);
    }
}

impl SendTransport for PlcLink {
    type Error = io::Error;

    fn now(&self) -> Instant {
        SendTransport::now(&self.transport)
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let sent = SendTransport::send(&mut self.transport, bytes, until).await?;
        if let Some(count) = sent {
            self.show(Moved::Reply(bytes.get(..count).unwrap_or(bytes)));
        }
        Ok(sent)
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let received = SendTransport::receive(&mut self.transport, buffer, until).await?;
        if let Some(count @ 1..) = received {
            self.show(Moved::Request(buffer.get(..count).unwrap_or_default()));
        }
        Ok(received)
    }

    async fn sleep_until(&mut self, at: Instant) {
        SendTransport::sleep_until(&mut self.transport, at).await;
    }
}
