//! A server for tokio: b-CAP over TCP, UDP and serial lines, RAC over TCP, for any handler.
//!
//! ```text
//!   TCP listener ─► a task for each connection ─┐
//!   UDP socket ───► one task for all peers ─────┼─► the handler, one call at a time
//!   serial line ──► one task for its client ────┤
//!   RAC listener ─► a task for each connection ─┘
//! ```
//!
//! The protocol is the core's: a [`Session`](bcap_core::bcap::server::Session) for each peer. Nothing is polled: a task sleeps
//! until bytes arrive, a deadline of its session passes, or, while its handler waits, another request has changed
//! something.
//!
//! Connections take turns by bytes: after 256 KiB, or 32 small requests, other tasks run. A request of 256 KiB or more
//! is decoded and carried out by a thread of tokio's pool for blocking calls, so other calls need not wait for it. The
//! handler is locked for each call, not for decoding.
//!
//! [`Limits`] bounds the resources of one peer: its connections, partly received requests, objects, and the memory of all
//! peers. When slots are short a new connection gets the slot of an idle one, by the rules of
//! [`Slots`](bcap_core::peers::Slots); without such a connection it is answered E_MAX_CONNECT and closed.
//!
//! A handler that panics fails its call with E_UNEXPECTED; the server and the handler continue. With `panic = "abort"` a panic
//! ends the process.
//!
//! # Examples
//!
//! ```no_run
//! # use bcap_core::bcap::server::Handler;
//! # async fn example(controller: impl Handler + Send + 'static) -> std::io::Result<()> {
//! use bcap_std::server::Server;
//!
//! let server = Server::new(controller).bcap_tcp("0.0.0.0:5007").await?.bcap_udp("0.0.0.0:5007").await?;
//! println!("listening on {:?}", server.addresses());
//! server.run(async { tokio::signal_that_ends_it().await }).await
//! # }
//! # mod tokio { pub async fn signal_that_ends_it() {} }
//! ```

mod activity;
mod limits;
mod memory;
mod rac;
#[cfg(feature = "serial")]
mod serial;
mod shared;
mod stream;
mod tcp;
mod udp;

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Arc, Mutex};

use bcap_core::bcap::server::Handler;
use bcap_core::rac::server::Handler as RacHandler;
use tokio::net::{TcpListener, ToSocketAddrs, UdpSocket};
use tokio::sync::watch;
use tokio::task::JoinSet;

use memory::Pool;
use shared::ServerState;

pub use limits::Limits;
#[cfg(feature = "gateway")]
pub(crate) use limits::is_same_host;
#[cfg(feature = "serial")]
pub use serial::{LineEvent, LineReport};
pub use shared::{OnConnect, Tap};
#[cfg(feature = "gateway")]
pub(crate) use tcp::{REFUSAL_TIME, REFUSALS};

/// A server that listens, and serves while it runs.
///
/// # Examples
///
/// ```no_run
/// use bcap_std::core::device::{Device, DeviceVariable};
/// use bcap_std::server::Server;
///
/// # async fn example(ctrl_c: impl Future<Output = ()>) -> std::io::Result<()> {
/// // a device with one variable, I1: the number of parts
/// let parts = DeviceVariable::new("I1", |parts: &i32, reply| reply.set(parts));
/// let server = Server::new(Device::<i32, 1>::new(0, [parts]));
/// server.bcap_tcp("127.0.0.1:5007").await?.rac_tcp("127.0.0.1:5006").await?.run(ctrl_c).await;
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Server<H> {
    shared: Arc<ServerState<H>>,
    limits: Limits,
    bcap: Vec<TcpListener>,
    udp: Vec<UdpSocket>,
    #[cfg(feature = "serial")]
    serial: Vec<serial::Port>,
    rac: Vec<(TcpListener, ListenRac<H>)>,
}

/// Accepts connections of RAC. A function pointer, so that a handler needs to implement RAC only if it serves it.
type ListenRac<H> = fn(TcpListener, Arc<ServerState<H>>, Limits, watch::Receiver<()>) -> Listening;
type Listening = Pin<Box<dyn Future<Output = io::Result<()>> + Send>>;

/// The addresses that a server listens on.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Addresses {
    /// b-CAP over TCP.
    pub bcap_tcp: Vec<SocketAddr>,
    /// b-CAP over UDP.
    pub bcap_udp: Vec<SocketAddr>,
    /// RAC over TCP.
    pub rac_tcp: Vec<SocketAddr>,
}

impl<H: Handler + Send + 'static> Server<H> {
    /// Creates a server without listeners.
    #[must_use]
    pub fn new(handler: H) -> Self {
        Self::with_shared(Arc::new(Mutex::new(handler)))
    }

    /// Creates a server with a handler that other code also reads, such as a display of its state.
    ///
    /// The server holds the lock for the duration of one call; other code must hold it no longer.
    #[must_use]
    pub fn with_shared(handler: Arc<Mutex<H>>) -> Self {
        let shared = Arc::new(ServerState::new(handler));
        Self {
            shared,
            limits: Limits::default(),
            bcap: Vec::new(),
            udp: Vec::new(),
            #[cfg(feature = "serial")]
            serial: Vec::new(),
            rac: Vec::new(),
        }
    }

    /// Changes the limits.
    #[must_use]
    pub fn limits(self, limits: Limits) -> Self {
        Self { limits, ..self }
    }

    /// Calls a function with all data before it is sent, for example to record it. The function may change the data, such as to
    /// test clients over a bad link. Only the first tap of a server counts.
    ///
    /// It is called with each frame of b-CAP and each line of RAC, with the handler locked, so it must be short.
    /// UDP has no connection to close, so `Break` only sends nothing there.
    #[must_use]
    pub fn tap(self, tap: Tap<H>) -> Self {
        self.shared.set_tap(tap);
        self
    }

    /// Calls a function with the IP address of each client that connects over TCP or UDP, before the client's first call. Only
    /// the first function that a server is given counts. A client at a serial line has no address.
    #[must_use]
    pub fn on_connect(self, on_connect: OnConnect<H>) -> Self {
        self.shared.set_on_connect(on_connect);
        self
    }

    /// Listens for b-CAP over TCP; port 0 takes a free one.
    ///
    /// # Errors
    ///
    /// When listening on the address fails.
    pub async fn bcap_tcp<A: ToSocketAddrs>(mut self, address: A) -> io::Result<Self> {
        self.bcap.push(TcpListener::bind(address).await?);
        Ok(self)
    }

    /// Listens for b-CAP over UDP; port 0 takes a free one.
    ///
    /// # Errors
    ///
    /// When listening on the address fails.
    pub async fn bcap_udp<A: ToSocketAddrs>(mut self, address: A) -> io::Result<Self> {
        self.udp.push(UdpSocket::bind(address).await?);
        Ok(self)
    }

    /// Serves b-CAP on a serial line, for the one client at its other end.
    ///
    /// When the device fails, for example because it was unplugged, the server releases the client's objects and opens the
    /// device again as soon as that is possible. `report` is called at both events.
    ///
    /// # Errors
    ///
    /// When the device does not exist, is in use, or does not have these settings.
    ///
    /// # Panics
    ///
    /// Outside a tokio runtime with I/O enabled.
    #[cfg(feature = "serial")]
    pub fn bcap_serial(mut self, line: &crate::SerialLine, report: LineReport) -> io::Result<Self> {
        self.serial.push(serial::Port::open(line, report)?);
        Ok(self)
    }

    /// Listens for RAC over TCP; port 0 takes a free one.
    ///
    /// # Errors
    ///
    /// When listening on the address fails.
    pub async fn rac_tcp<A: ToSocketAddrs>(mut self, address: A) -> io::Result<Self>
    where
        H: RacHandler,
    {
        let listener = TcpListener::bind(address).await?;
        self.rac.push((listener, |listener, shared, limits, stopped| {
            Box::pin(rac::listen(listener, shared, limits, stopped))
        }));
        Ok(self)
    }

    /// Returns the addresses of the listeners.
    #[must_use]
    pub fn addresses(&self) -> Addresses {
        Addresses {
            bcap_tcp: self.bcap.iter().filter_map(|l| l.local_addr().ok()).collect(),
            bcap_udp: self.udp.iter().filter_map(|s| s.local_addr().ok()).collect(),
            rac_tcp: self.rac.iter().filter_map(|(l, _)| l.local_addr().ok()).collect(),
        }
    }

    /// Serves until `shutdown` is ready, then releases the objects of all peers and closes their connections. Shutdown does
    /// not wait for slow clients; unsent replies are lost.
    ///
    /// # Errors
    ///
    /// When a listening socket fails permanently.
    ///
    /// # Cancel safety
    ///
    /// When the future is dropped all connections end immediately, and the handler is not notified that its peers have gone.
    pub async fn run(self, shutdown: impl Future<Output = ()>) -> io::Result<()> {
        let (stop, stopped) = watch::channel(());
        let mut tasks = JoinSet::new();
        let pool = Pool::new(self.limits.memory);
        for listener in self.bcap {
            let shared = Arc::clone(&self.shared);
            tasks.spawn(tcp::listen(listener, shared, pool.clone(), self.limits, stopped.clone()));
        }
        for socket in self.udp {
            tasks.spawn(udp::serve(socket, Arc::clone(&self.shared), self.limits, stopped.clone()));
        }
        #[cfg(feature = "serial")]
        for port in self.serial {
            tasks.spawn(serial::serve(port, Arc::clone(&self.shared), self.limits, stopped.clone()));
        }
        for (listener, listen) in self.rac {
            tasks.spawn(listen(listener, Arc::clone(&self.shared), self.limits, stopped.clone()));
        }
        let mut result = tokio::select! {
            () = shutdown => Ok(()),
            ended = tasks.join_next(), if !tasks.is_empty() => outcome(ended),
        };
        // every task sees that the sender is dropped
        drop((stop, stopped));
        while let Some(ended) = tasks.join_next().await {
            result = result.and(outcome(Some(ended)));
        }
        result
    }
}

/// Returns the result of a listening task.
fn outcome(ended: Option<Result<io::Result<()>, tokio::task::JoinError>>) -> io::Result<()> {
    match ended {
        Some(Ok(result)) => result,
        Some(Err(error)) => Err(io::Error::other(error)),
        None => Ok(()),
    }
}
