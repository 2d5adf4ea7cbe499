//! A UDP proxy that delays, duplicates and drops datagrams.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::net::UdpSocket;
use tokio::time::sleep;

use crate::background::{Background, until};
use bcap_testkit::network::{Faults, Random};

/// A network of datagrams, with one port per client, so that the server can distinguish the clients.
#[derive(Debug)]
pub struct UdpProxy {
    /// The address to which clients send.
    pub address: SocketAddr,
    /// The counts so far.
    pub counts: Arc<Counts>,
    _background: Background,
}

/// Counters of a proxy, both directions together.
#[derive(Debug, Default)]
pub struct Counts {
    /// Received datagrams.
    pub datagrams: AtomicU64,
    /// Dropped datagrams.
    pub lost: AtomicU64,
    /// Duplicated datagrams.
    pub repeated: AtomicU64,
    /// Datagrams sent after one that arrived later.
    pub overtaken: AtomicU64,
}

impl UdpProxy {
    /// Starts a proxy in front of a server.
    #[must_use]
    pub fn start(server: SocketAddr, faults: Faults, seed: u64) -> Self {
        let counts = Arc::<Counts>::default();
        let shared = Arc::clone(&counts);
        let (background, address) = Background::start(async move |stopped| {
            let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.expect("a port"));
            let address = socket.local_addr().expect("it has an address");
            (address, until(stopped, forward(socket, server, Network { faults, seed, counts: shared })))
        });
        Self { address, counts, _background: background }
    }
}

/// The state that all directions share.
#[derive(Clone, Debug)]
struct Network {
    faults: Faults,
    seed: u64,
    counts: Arc<Counts>,
}

/// Forwards the clients' datagrams to the server, and opens a return path for each client.
async fn forward(socket: Arc<UdpSocket>, server: SocketAddr, network: Network) {
    let mut known: HashMap<SocketAddr, Way> = HashMap::new();
    let mut buffer = [0; 2048];
    loop {
        // an error here means that a client has closed its port, which does not matter
        let Ok((count, client)) = socket.recv_from(&mut buffer).await else { continue };
        let seed = network.seed.wrapping_add(2 * known.len() as u64);
        let way = match known.entry(client) {
            Entry::Occupied(way) => way.into_mut(),
            Entry::Vacant(place) => {
                let out = Arc::new(UdpSocket::bind("127.0.0.1:0").await.expect("a port"));
                out.connect(server).await.expect("the loopback");
                let back = Way::new(&network, seed + 1, Arc::clone(&socket), Some(client));
                tokio::spawn(backward(Arc::clone(&out), back));
                place.insert(Way::new(&network, seed, out, None))
            }
        };
        way.pass(&buffer[..count]);
    }
}

/// Forwards the server's datagrams to one client.
async fn backward(from: Arc<UdpSocket>, mut way: Way) {
    let mut buffer = [0; 2048];
    loop {
        if let Ok(count) = from.recv(&mut buffer).await {
            way.pass(&buffer[..count]);
        }
    }
}

/// One direction between one client and the server.
#[derive(Debug)]
struct Way {
    network: Network,
    random: Random,
    socket: Arc<UdpSocket>,
    to: Option<SocketAddr>,
    /// The number of the newest datagram that has been sent on.
    newest: Arc<AtomicU64>,
    count: u64,
}

impl Way {
    fn new(network: &Network, seed: u64, socket: Arc<UdpSocket>, to: Option<SocketAddr>) -> Self {
        Self { network: network.clone(), random: Random(seed), socket, to, newest: Arc::default(), count: 0 }
    }

    /// Draws whether to drop, duplicate or delay a datagram.
    fn pass(&mut self, bytes: &[u8]) {
        let Network { faults, counts, .. } = &self.network;
        self.count += 1;
        counts.datagrams.fetch_add(1, Ordering::Relaxed);
        if self.random.happens(faults.loss) {
            counts.lost.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let mut bytes = bytes.to_vec();
        for byte in &mut bytes {
            if self.random.happens(faults.garble) {
                *byte ^= 1 << self.random.below(8);
            }
        }
        let copies = if self.random.happens(faults.repeat) { 2 } else { 1 };
        counts.repeated.fetch_add(copies - 1, Ordering::Relaxed);
        for _ in 0..copies {
            let delay = Duration::from_micros(self.random.below(faults.delay.as_micros() as u64 + 1));
            tokio::spawn(self.send(bytes.clone(), delay));
        }
    }

    /// Sends a datagram after a while.
    fn send(&self, bytes: Vec<u8>, delay: Duration) -> impl Future<Output = ()> + use<> {
        let (socket, to, number) = (Arc::clone(&self.socket), self.to, self.count);
        let (newest, counts) = (Arc::clone(&self.newest), Arc::clone(&self.network.counts));
        async move {
            if !delay.is_zero() {
                sleep(delay).await;
            }
            if newest.fetch_max(number, Ordering::Relaxed) > number {
                counts.overtaken.fetch_add(1, Ordering::Relaxed);
            }
            // a receiver that has gone does not matter
            let _ = match to {
                Some(to) => socket.send_to(&bytes, to).await,
                None => socket.send(&bytes).await,
            };
        }
    }
}
