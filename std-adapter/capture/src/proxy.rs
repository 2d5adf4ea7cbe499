//! Forwards b-CAP and RAC to a robot, records the bytes, and injects faults.
//!
//! ```text
//!  tcp   a task for each direction of each connection ─┐
//!  udp   a socket to the robot for each client ────────┼─► the recorder
//!  RAC   as TCP                                        ┘
//! ```
//!
//! Bytes are forwarded before they are recorded, so that recording does not delay them.
//!
//! # Examples
//!
//! ```no_run
//! use std::net::SocketAddr;
//!
//! use bcap_capture::proxy::{Listeners, Proxy, Robot};
//! use bcap_capture::record::Recording;
//! use tokio::net::{TcpListener, UdpSocket};
//!
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! let recording = Recording::start(Some("session.pcapng".as_ref()), |_| {})?;
//! let listeners = Listeners {
//!     bcap: TcpListener::bind("127.0.0.1:5007").await?,
//!     udp: UdpSocket::bind("127.0.0.1:5007").await?,
//!     rac: None,
//! };
//! let address: SocketAddr = ([192, 168, 0, 1], 5007).into();
//! let robot = Robot { tcp: vec![address], udp: address, rac: vec![] };
//! let stop = tokio::time::sleep(std::time::Duration::from_secs(60));
//! Proxy::new(listeners, robot).run(&recording, stop).await;
//! recording.finish()?;
//! # Ok(())
//! # }
//! ```

mod shared;
mod tcp;
mod udp;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::{TcpListener, UdpSocket};
use tokio::time::sleep;

use self::shared::Shared;
use crate::faults::FaultPlan;
use crate::record::Recording;

/// The time between two checks whether the file can still be written.
const CHECK: Duration = Duration::from_millis(200);

/// The default time limit for connecting to the robot.
const CONNECT: Duration = Duration::from_secs(3);

/// The addresses of a robot.
#[derive(Clone, Debug)]
pub struct Robot {
    /// b-CAP over TCP: the addresses of a host, which are tried in turn.
    pub tcp: Vec<SocketAddr>,
    /// b-CAP over UDP.
    pub udp: SocketAddr,
    /// RAC: the addresses of a host, which are tried in turn.
    pub rac: Vec<SocketAddr>,
}

/// The sockets of a proxy.
#[derive(Debug)]
pub struct Listeners {
    /// b-CAP over TCP.
    pub bcap: TcpListener,
    /// b-CAP over UDP.
    pub udp: UdpSocket,
    /// RAC; `None` if the robot has none.
    pub rac: Option<TcpListener>,
}

/// A proxy.
#[derive(Debug)]
pub struct Proxy {
    listeners: Listeners,
    robot: Robot,
    connect_timeout: Duration,
    faults: FaultPlan,
    seed: u64,
    shows_listener: bool,
}

impl Proxy {
    /// A proxy without faults.
    #[must_use]
    pub fn new(listeners: Listeners, robot: Robot) -> Self {
        let faults = FaultPlan::default();
        Self { listeners, robot, connect_timeout: CONNECT, faults, seed: 0, shows_listener: false }
    }

    /// Limits the time for connecting to the robot.
    #[must_use]
    pub fn connect_timeout(self, connect_timeout: Duration) -> Self {
        Self { connect_timeout, ..self }
    }

    /// Injects faults, which a seed repeats for the same traffic.
    #[must_use]
    pub fn faults(self, faults: FaultPlan, seed: u64) -> Self {
        Self { faults, seed, ..self }
    }

    /// Records the address that a client connected to as the server's address, instead of the robot's: for a robot in this
    /// process.
    #[must_use]
    pub fn show_listener(self) -> Self {
        Self { shows_listener: true, ..self }
    }

    /// Forwards until `ended` or until the recording cannot be written, then closes all connections.
    pub async fn run(self, recording: &Recording, ended: impl Future<Output = ()>) {
        let shared = Shared::new(recording, self.connect_timeout, self.faults, self.seed, self.shows_listener);
        tokio::select! {
            () = ended => {}
            () = serve(self.listeners, &self.robot, &shared) => {}
            () = failed(recording) => {}
        }
    }
}

/// Returns when the recording has failed.
async fn failed(recording: &Recording) {
    while !recording.has_failed() {
        sleep(CHECK).await;
    }
}

/// Forwards until it is dropped, which closes all connections.
async fn serve(listeners: Listeners, robot: &Robot, shared: &Shared) {
    let (tcp, rac): (Arc<[SocketAddr]>, Arc<[SocketAddr]>) = (robot.tcp.as_slice().into(), robot.rac.as_slice().into());
    tokio::join!(
        tcp::listen(listeners.bcap, tcp, false, shared.clone()),
        udp::serve(listeners.udp, robot.udp, shared.clone()),
        async {
            if let Some(listener) = listeners.rac {
                tcp::listen(listener, rac, true, shared.clone()).await;
            }
        },
    );
}
