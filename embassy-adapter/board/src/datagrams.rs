//! The UDP socket of a board: it answers [`find`](crate::find), sends messages of syslog, and requests the time.
//!
//! One socket, because each one takes memory.

use core::future::poll_fn;
use core::net::Ipv4Addr;
use core::task::Context;

use bcap_core::rac;
use bcap_embassy::net::discard;
use bcap_gateway::Network;
use embassy_executor::{SpawnError, Spawner};
use embassy_futures::select::{Either, select};
#[cfg(feature = "health")]
use embassy_futures::select::{Either3, select3};
use embassy_net::udp::{PacketMetadata, UdpMetadata, UdpSocket};
use embassy_net::{HardwareAddress, IpAddress, IpEndpoint, Stack};
#[cfg(feature = "health")]
use embassy_time::Timer;
use embassy_time::{Duration, Instant, with_timeout};
use static_cell::{ConstStaticCell, StaticCell};

use crate::Settings;
use crate::find::{Found, PORT, REQUEST, number};
use crate::host::{is_host, is_other};
use crate::identity::NAME;
#[cfg(feature = "health")]
use crate::messages;
use crate::network;
use crate::parts::DATAGRAMS;
#[cfg(feature = "health")]
use crate::sntp::{self, Refused};
use crate::watchdog::watched;

/// The pause between two answers. Requests in it are dropped; a host repeats them.
const PAUSE: Duration = Duration::from_millis(50);

/// How long a datagram may wait until the address of its host is resolved. smoltcp sends one ARP request a second in total, so
/// the request for this address can be delayed by a second.
const UNSENT: Duration = Duration::from_millis(1500);

/// The pauses between requests for the time: without an answer, and after one.
#[cfg(feature = "health")]
const RETRY: Duration = Duration::from_secs(64);
#[cfg(feature = "health")]
const RENEWAL: Duration = Duration::from_secs(1024);

/// The memory of the socket: a request, and a message of syslog or an answer.
#[cfg(feature = "health")]
const SENT: usize = messages::MESSAGE;
#[cfg(not(feature = "health"))]
const SENT: usize = REQUEST;

/// Starts the task.
pub(crate) fn start(
    spawner: Spawner,
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
) -> Result<(), SpawnError> {
    spawner.spawn(serve(stack, settings)?);
    Ok(())
}

#[embassy_executor::task]
async fn serve(stack: Stack<'static>, settings: &'static Settings<'static>) -> ! {
    static MEMORY: ConstStaticCell<([u8; REQUEST], [u8; SENT])> = ConstStaticCell::new(([0; REQUEST], [0; SENT]));
    // not a `ConstStaticCell`: the values are not all zero, and would lie in the flash as well
    static META: StaticCell<[[PacketMetadata; 1]; 2]> = StaticCell::new();
    let ((rx, tx), [rx_meta, tx_meta]) = (MEMORY.take(), META.init_with(|| [[PacketMetadata::EMPTY]; 2]));
    let socket = UdpSocket::new(stack, rx_meta, rx, tx_meta, tx);
    watched(DATAGRAMS, core::pin::pin!(run(stack, socket, settings))).await
}

async fn run(stack: Stack<'_>, mut socket: UdpSocket<'_>, settings: &Settings<'_>) -> ! {
    let mut next_answer = Instant::MIN;
    // whether the last datagram is a message of syslog
    let mut is_message = false;
    #[cfg(feature = "health")]
    let mut clock = Clock::default();
    loop {
        stack.wait_config_up().await;
        // fails if it is bound already
        let _ = socket.bind(PORT);
        discard_unsent(&mut socket, &mut is_message).await;
        #[cfg(feature = "health")]
        serve_others(&mut socket, settings, &mut clock, &mut is_message).await;
        #[cfg(not(feature = "health"))]
        socket.wait_recv_ready().await;
        if !socket.may_recv() {
            continue;
        }
        let receive = |datagram: &[u8], meta: UdpMetadata| {
            #[cfg(feature = "health")]
            clock.receive(datagram, meta.endpoint, settings);
            Some((number(datagram)?, meta))
        };
        let asked = socket.recv_from_with(receive).await;
        if let Some((number, meta)) = asked.filter(|_| settings.find && Instant::now() >= next_answer) {
            next_answer = Instant::now().saturating_add(PAUSE);
            answer(stack, &mut socket, (number, meta), settings, &mut is_message).await;
        }
    }
}

/// Waits until the last datagram has left or a request arrives, and discards a datagram that does not leave.
///
/// smoltcp keeps a datagram to an address that it cannot resolve or reach, and sends no other datagram of the socket before it.
async fn discard_unsent(socket: &mut UdpSocket<'_>, is_message: &mut bool) {
    // the socket has room for one datagram, so there is room once it has left
    let left = with_timeout(UNSENT, socket.wait_send_ready());
    let ended = select(socket.wait_recv_ready(), left).await;
    if matches!(ended, Either::Second(Err(_))) {
        give_up(socket, is_message);
    }
}

/// Discards the unsent datagram, and counts a message as lost.
fn give_up(socket: &mut UdpSocket<'_>, is_message: &mut bool) {
    discard(socket);
    if core::mem::take(is_message) {
        #[cfg(feature = "health")]
        messages::lose();
    }
}

/// Waits for a datagram, and sends a message or a request for the time before that.
#[cfg(feature = "health")]
async fn serve_others(socket: &mut UdpSocket<'_>, settings: &Settings<'_>, clock: &mut Clock, is_message: &mut bool) {
    let message = async {
        match settings.syslog {
            Some(_) => messages::wait().await,
            None => core::future::pending().await,
        }
    };
    let time = async {
        match settings.ntp {
            Some(_) => Timer::at(clock.next.unwrap_or(Instant::MIN)).await,
            None => core::future::pending().await,
        }
    };
    // the time first: the board seldom requests it, and there may always be a message
    match select3(socket.wait_recv_ready(), time, message).await {
        Either3::First(()) => {}
        Either3::Second(()) => {
            if let Some(server) = settings.ntp {
                let _ = socket.send_to(&clock.ask(), server).await;
                *is_message = false;
            }
        }
        Either3::Third(()) => {
            if let Some(collector) = settings.syslog {
                messages::send(socket, collector, settings.hostname).await;
                *is_message = true;
            }
        }
    }
}

/// The requests for the time: one every 17 minutes, and one a minute as long as there is no answer.
#[cfg(feature = "health")]
#[derive(Default)]
struct Clock {
    next: Option<Instant>,
    /// The number of the request that was not answered yet.
    number: Option<[u8; 8]>,
    /// The refusal that was last logged.
    told: Option<Refused>,
}

#[cfg(feature = "health")]
impl Clock {
    fn ask(&mut self) -> [u8; sntp::SIZE] {
        let number = network::random().to_be_bytes();
        (self.number, self.next) = (Some(number), Some(Instant::now().saturating_add(RETRY)));
        sntp::request(number)
    }

    /// Sets the clock from an answer of the configured server; each request accepts one answer.
    fn receive(&mut self, datagram: &[u8], from: IpEndpoint, settings: &Settings<'_>) {
        let (Some(number), Some(server)) = (self.number, settings.ntp) else { return };
        if from != IpEndpoint::from(server) {
            return;
        }
        match sntp::read(datagram, number) {
            Ok(utc) => {
                messages::set_clock(utc);
                *self = Self { next: Some(Instant::now().saturating_add(RENEWAL)), number: None, told: None };
            }
            Err(refused) => {
                if self.told.replace(refused) != Some(refused) {
                    defmt::warn!("SNTP: refused an answer: {=str}", refused.text());
                }
            }
        }
    }
}

/// Answers a host of the board's own network.
async fn answer(
    stack: Stack<'_>,
    socket: &mut UdpSocket<'_>,
    (number, meta): ([u8; 8], UdpMetadata),
    settings: &Settings<'_>,
    is_message: &mut bool,
) {
    let (Some(config), HardwareAddress::Ethernet(mac)) = (stack.config_v4(), stack.hardware_address()) else { return };
    let IpEndpoint { addr: IpAddress::Ipv4(host), .. } = meta.endpoint;
    let own = (config.address.address(), config.address.prefix_len());
    if !may_ask(own, host) {
        return;
    }
    // the datagram before this one may never leave, and the host does not wait long
    if !socket.may_send() {
        give_up(socket, is_message);
    }
    *is_message = false;
    let name_of_host = settings.hostname.unwrap_or_default();
    let [name, version] = network::description();
    // a project can have a longer name than a board
    let name = name.get(..name.len().min(NAME)).unwrap_or_default();
    let found = Found { name: name_of_host, board: name, version, address: own, port: rac::PORT, mac: mac.0 };
    // to the endpoint alone: the request may have been sent to the broadcast address, which is not a valid source
    let send = |context: &mut Context<'_>| {
        let mut out = [0; REQUEST];
        let len = found.write(number, &mut out).unwrap_or_default();
        // not `send_to_with`: smoltcp 0.13.1 then finds no room in an empty buffer that was used before
        socket.poll_send_to(out.get(..len).unwrap_or_default(), meta.endpoint, context)
    };
    let _ = poll_fn(send).await;
}

/// Returns whether a host is another host of the board's network.
fn may_ask(own: (Ipv4Addr, u8), host: Ipv4Addr) -> bool {
    let is_near = Network::new(own.0, own.1).is_some_and(|network| network.contains(Some(host)));
    is_near && is_host(host) && is_other(own, host)
}
