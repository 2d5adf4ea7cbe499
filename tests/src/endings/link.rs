//! A link between a program and the controller, over TCP and UDP, that can be cut.
//!
//! A cut concerns the connections that exist. Later the link accepts new ones again; datagrams then pass again.

use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;

use socket2::SockRef;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::watch;

use super::draw::Cut;

/// The state of the link.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    /// How often the link was cut.
    cuts: u64,
    /// How it was cut last.
    cut: Option<Cut>,
    /// Whether new connections and datagrams pass.
    open: bool,
    /// The trial is over.
    ended: bool,
}

/// A link.
#[derive(Debug)]
pub(super) struct Link {
    /// Where a program connects over TCP.
    pub(super) tcp: SocketAddr,
    /// Where a program connects over UDP.
    pub(super) udp: SocketAddr,
    state: watch::Sender<State>,
    thread: Option<JoinHandle<()>>,
}

impl Link {
    /// Starts a link to a controller.
    ///
    /// # Panics
    ///
    /// When the machine has no socket for it.
    #[must_use]
    pub(super) fn start(tcp: SocketAddr, udp: SocketAddr) -> Self {
        let (state, seen) = watch::channel(State { open: true, ..State::default() });
        let (tell, told) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(async {
                let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port for TCP");
                let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.expect("a port for UDP"));
                let addresses = (listener.local_addr(), socket.local_addr());
                tell.send((addresses.0.expect("an address"), addresses.1.expect("an address")))
                    .expect("the trial waits");
                let mut end = seen.clone();
                tokio::spawn(accept(listener, tcp, seen.clone()));
                tokio::spawn(relay(socket, udp, seen));
                let _ = end.wait_for(|state| state.ended).await;
            });
        });
        let (tcp, udp) = told.recv().expect("the link starts");
        Self { tcp, udp, state, thread: Some(thread) }
    }

    /// Cuts all connections.
    pub(super) fn cut(&self, cut: Cut) {
        self.state.send_modify(|state| {
            *state = State { cuts: state.cuts + 1, cut: Some(cut), open: false, ..*state };
        });
    }

    /// Lets new connections and datagrams pass.
    pub(super) fn heal(&self) {
        self.state.send_modify(|state| state.open = true);
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.state.send_modify(|state| state.ended = true);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
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

/// Passes bytes on; after a silent cut of this direction it keeps the sockets open and passes nothing.
async fn pump(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, state: watch::Receiver<State>, (born, way): (u64, Cut)) {
    let stalls = |state: &State| state.cuts > born && state.cut.is_some_and(|cut| cut == Cut::Silent || cut == way);
    let mut buffer = vec![0; 4096];
    loop {
        let Ok(len) = from.read(&mut buffer).await else { return };
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

/// Tells whether datagrams are lost, unless only the direction `other` is cut.
fn blocks(state: &watch::Receiver<State>, other: Cut) -> bool {
    let state = *state.borrow();
    !state.open && state.cut != Some(other)
}
