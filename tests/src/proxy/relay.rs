//! A relay between clients and a server, over TCP and UDP, that can be cut or held.
//!
//! A cut affects the existing connections. Later the relay accepts new connections again, and datagrams pass again. While it is
//! held, bytes of streams are queued in it.

use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use socket2::SockRef;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::watch;

use crate::background::Background;

/// How a relay is cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Cut {
    /// No byte passes any more, and neither side is notified.
    Silent,
    /// No byte passes to the server.
    Up,
    /// No byte passes to the client.
    Down,
    /// Both connections are closed in order.
    Fin,
    /// Both connections are reset.
    Reset,
}

/// The state of the relay.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    /// Number of times the relay was cut.
    cuts: u64,
    /// The kind of the last cut.
    cut: Option<Cut>,
    /// Whether new connections and datagrams pass.
    open: bool,
    /// Whether bytes to the server wait.
    holds_up: bool,
    /// Whether bytes to the client wait.
    holds_down: bool,
}

/// A relay, until it is dropped.
#[derive(Debug)]
pub struct Relay {
    /// Where a client connects over TCP.
    pub tcp: SocketAddr,
    /// Where a client connects over UDP.
    pub udp: SocketAddr,
    state: watch::Sender<State>,
    _background: Background,
}

impl Relay {
    /// Starts a relay to a server of TCP.
    ///
    /// # Panics
    ///
    /// When the machine has no socket for it.
    #[must_use]
    pub fn tcp(server: SocketAddr) -> Self {
        Self::start(server, server)
    }

    /// Starts a relay to a server of TCP and UDP.
    ///
    /// # Panics
    ///
    /// When the machine has no socket for it.
    #[must_use]
    pub fn start(tcp: SocketAddr, udp: SocketAddr) -> Self {
        let (state, seen) = watch::channel(State { open: true, ..State::default() });
        let (background, (tcp, udp)) = Background::start(async move |stopped| {
            let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port for TCP");
            let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.expect("a port for UDP"));
            let (here, there) = (listener.local_addr().expect("an address"), socket.local_addr().expect("an address"));
            tokio::spawn(accept(listener, tcp, seen.clone()));
            tokio::spawn(relay(socket, udp, seen));
            ((here, there), async { drop(stopped.await) })
        });
        Self { tcp, udp, state, _background: background }
    }

    /// Cuts all connections, and allows no new ones until [`heal`](Self::heal).
    pub fn cut(&self, cut: Cut) {
        self.state.send_modify(|state| {
            *state = State { cuts: state.cuts + 1, cut: Some(cut), open: false, ..*state };
        });
    }

    /// Lets new connections and datagrams pass.
    pub fn heal(&self) {
        self.state.send_modify(|state| state.open = true);
    }

    /// Closes all connections; bytes that are held are lost. New connections pass.
    pub fn disconnect(&self) {
        // in one step, so that a client that connects again at once is accepted
        self.state.send_modify(|state| {
            *state = State { cuts: state.cuts + 1, cut: Some(Cut::Fin), open: true, ..*state };
        });
    }

    /// Lets bytes in both directions wait, or pass again.
    pub fn hold(&self, holds: bool) {
        self.state.send_modify(|state| (state.holds_up, state.holds_down) = (holds, holds));
    }

    /// Lets bytes to the server wait, or pass again.
    pub fn hold_up(&self, holds: bool) {
        self.state.send_modify(|state| state.holds_up = holds);
    }
}

async fn accept(listener: TcpListener, server: SocketAddr, mut state: watch::Receiver<State>) {
    loop {
        // while the link is cut silently, a connection is not answered
        let passes = |state: &State| state.open || matches!(state.cut, Some(Cut::Fin | Cut::Reset));
        if state.wait_for(passes).await.is_err() {
            return;
        }
        let Ok((client, _)) = listener.accept().await else { continue };
        let seen = *state.borrow();
        if !seen.open && matches!(seen.cut, Some(Cut::Fin | Cut::Reset)) {
            continue;
        }
        tokio::spawn(carry(client, server, state.clone()));
    }
}

/// Carries a connection to its end or its cut.
async fn carry(client: TcpStream, server: SocketAddr, mut state: watch::Receiver<State>) -> io::Result<()> {
    let born = state.borrow().cuts;
    let _ = state.wait_for(|state| state.open).await;
    let server = TcpStream::connect(server).await?;
    client.set_nodelay(true)?;
    server.set_nodelay(true)?;
    let linger = [SockRef::from(&client).try_clone()?, SockRef::from(&server).try_clone()?];
    let ((from_client, to_client), (from_server, to_server)) = (client.into_split(), server.into_split());
    let cut = {
        let mut up = std::pin::pin!(pump(from_client, to_server, state.clone(), (born, Cut::Up)));
        let mut down = std::pin::pin!(pump(from_server, to_client, state.clone(), (born, Cut::Down)));
        tokio::select! {
            seen = state.wait_for(|state| state.cuts > born && matches!(state.cut, Some(Cut::Fin | Cut::Reset))) => {
                seen.ok().and_then(|seen| seen.cut)
            }
            // an end of one side ends the other, as when the process has died
            () = &mut up => None,
            () = &mut down => None,
        }
    };
    if cut == Some(Cut::Reset) {
        for socket in &linger {
            socket.set_linger(Some(Duration::ZERO))?;
        }
    }
    Ok(())
}

/// Passes bytes on; after a silent cut of this direction it keeps the sockets open and passes no bytes.
async fn pump(
    mut from: OwnedReadHalf,
    mut to: OwnedWriteHalf,
    mut state: watch::Receiver<State>,
    (born, way): (u64, Cut),
) {
    let stalls = |state: &State| state.cuts > born && state.cut.is_some_and(|cut| cut == Cut::Silent || cut == way);
    let mut buffer = vec![0; 4096];
    loop {
        let Ok(len) = from.read(&mut buffer).await else { return };
        let passes = |state: &State| if way == Cut::Up { !state.holds_up } else { !state.holds_down };
        let _ = state.wait_for(passes).await;
        let stalled = stalls(&state.borrow());
        if stalled {
            std::future::pending::<()>().await;
        }
        if len == 0 || to.write_all(&buffer[..len]).await.is_err() {
            return;
        }
    }
}

/// Passes datagrams on, with a socket to the server for each client.
async fn relay(socket: Arc<UdpSocket>, server: SocketAddr, state: watch::Receiver<State>) {
    let mut clients: HashMap<SocketAddr, Arc<UdpSocket>> = HashMap::new();
    let mut buffer = vec![0; 65_536];
    loop {
        let Ok((len, client)) = socket.recv_from(&mut buffer).await else { continue };
        if blocks(&state, Cut::Down) {
            continue;
        }
        let known = clients.get(&client).cloned();
        let upstream = match known {
            Some(upstream) => upstream,
            None => {
                let Ok(upstream) = UdpSocket::bind("127.0.0.1:0").await else { continue };
                if upstream.connect(server).await.is_err() {
                    continue;
                }
                let upstream = Arc::new(upstream);
                clients.insert(client, Arc::clone(&upstream));
                tokio::spawn(answers(Arc::clone(&upstream), Arc::clone(&socket), client, state.clone()));
                upstream
            }
        };
        let _ = upstream.send(&buffer[..len]).await;
    }
}

async fn answers(upstream: Arc<UdpSocket>, socket: Arc<UdpSocket>, client: SocketAddr, state: watch::Receiver<State>) {
    let mut buffer = vec![0; 65_536];
    loop {
        let Ok(len) = upstream.recv(&mut buffer).await else { continue };
        if !blocks(&state, Cut::Up) {
            let _ = socket.send_to(&buffer[..len], client).await;
        }
    }
}

/// Returns whether datagrams are lost, unless only the direction `other` is cut.
fn blocks(state: &watch::Receiver<State>, other: Cut) -> bool {
    let state = *state.borrow();
    !state.open && state.cut != Some(other)
}
