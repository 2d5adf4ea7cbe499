//! The UDP socket of a board: it answers [`find`](crate::find), and sends messages of syslog.
//!
//! One socket, because each one takes memory.

use core::future::poll_fn;
use core::net::Ipv4Addr;
use core::task::Context;

use bcap_core::rac;
use embassy_executor::{SpawnError, Spawner};
use embassy_net::udp::{PacketMetadata, UdpMetadata, UdpSocket};
use embassy_net::{HardwareAddress, IpAddress, IpEndpoint, Stack};
use embassy_time::{Duration, Instant};
use static_cell::{ConstStaticCell, StaticCell};

use crate::Settings;
use crate::find::{Found, PORT, REQUEST, number};
use crate::identity::NAME;
#[cfg(feature = "health")]
use crate::page;
use crate::parts::{DATAGRAMS, Parts};
use crate::watchdog::watched;

/// The pause between two answers. Requests in it are dropped; a host repeats them.
const PAUSE: Duration = Duration::from_millis(50);

/// The memory of the socket: a request, and a message of syslog or an answer.
#[cfg(feature = "health")]
const SENT: usize = page::MESSAGE;
#[cfg(not(feature = "health"))]
const SENT: usize = REQUEST;

/// Starts the task.
pub(crate) fn start(
    spawner: Spawner,
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
    parts: &Parts,
) -> Result<(), SpawnError> {
    spawner.spawn(serve(stack, settings, parts.name)?);
    Ok(())
}

#[embassy_executor::task]
async fn serve(stack: Stack<'static>, settings: &'static Settings<'static>, name: &'static str) -> ! {
    static MEMORY: ConstStaticCell<([u8; REQUEST], [u8; SENT])> = ConstStaticCell::new(([0; REQUEST], [0; SENT]));
    // not a `ConstStaticCell`: the values are not all zero, and would lie in the flash as well
    static META: StaticCell<[[PacketMetadata; 1]; 2]> = StaticCell::new();
    let ((rx, tx), [rx_meta, tx_meta]) = (MEMORY.take(), META.init_with(|| [[PacketMetadata::EMPTY]; 2]));
    let socket = UdpSocket::new(stack, rx_meta, rx, tx_meta, tx);
    watched(DATAGRAMS, core::pin::pin!(run(stack, socket, settings, name))).await
}

async fn run(stack: Stack<'_>, mut socket: UdpSocket<'_>, settings: &Settings<'_>, name: &str) -> ! {
    let mut next_answer = Instant::MIN;
    loop {
        stack.wait_config_up().await;
        // fails if it is bound already
        let _ = socket.bind(PORT);
        #[cfg(feature = "health")]
        embassy_futures::select::select(socket.wait_recv_ready(), page::wait()).await;
        #[cfg(not(feature = "health"))]
        socket.wait_recv_ready().await;
        #[cfg(feature = "health")]
        if let Some(collector) = settings.syslog {
            page::send(&socket, collector, settings.hostname).await;
        }
        if socket.may_recv() {
            let asked = socket.recv_from_with(|datagram, meta| Some((number(datagram)?, meta))).await;
            if let Some((number, meta)) = asked.filter(|_| settings.find && Instant::now() >= next_answer) {
                next_answer = Instant::now().saturating_add(PAUSE);
                answer(stack, &socket, (number, meta), settings, name).await;
            }
        }
    }
}

/// Answers a host of the board's own network.
async fn answer(
    stack: Stack<'_>,
    socket: &UdpSocket<'_>,
    (number, meta): ([u8; 8], UdpMetadata),
    settings: &Settings<'_>,
    name: &str,
) {
    let (Some(config), HardwareAddress::Ethernet(mac)) = (stack.config_v4(), stack.hardware_address()) else { return };
    let IpEndpoint { addr: IpAddress::Ipv4(host), .. } = meta.endpoint;
    let own = (config.address.address(), config.address.prefix_len());
    if !may_ask(own, host) {
        return;
    }
    let name_of_host = settings.hostname.unwrap_or_default();
    let version = env!("CARGO_PKG_VERSION");
    // a project can have a longer name than a board
    let name = name.get(..name.len().min(NAME)).unwrap_or_default();
    let found = Found { name: name_of_host, board: name, version, address: own, port: rac::PORT, mac: mac.0 };
    // to the endpoint alone: the request may have been sent to the broadcast address, which is no source
    let send = |context: &mut Context<'_>| {
        let mut out = [0; REQUEST];
        let len = found.write(number, &mut out).unwrap_or_default();
        // not `send_to_with`: smoltcp 0.13.1 then finds no room in an empty buffer that was used before
        socket.poll_send_to(out.get(..len).unwrap_or_default(), meta.endpoint, context)
    };
    let _ = poll_fn(send).await;
}

/// Returns whether a host is another one of the board's network.
fn may_ask(own: (Ipv4Addr, u8), host: Ipv4Addr) -> bool {
    let (address, prefix) = own;
    let mask = u32::MAX.checked_shl(32 - u32::from(prefix)).unwrap_or_default();
    crate::host::is_host(host) && crate::host::is_other(own, host) && (address.to_bits() ^ host.to_bits()) & mask == 0
}
