//! Clients over the TCP and UDP of embassy-net.
//!
//! embassy-net's own task (`Runner::run`) must run beside, and needs one socket for each client.
//!
//! # Examples
//!
//! A client over TCP that reads a variable, and connects again when the connection breaks:
//!
//! ```
//! use bcap_core::bcap::client::Config;
//! use bcap_core::bcap::{Client, call};
//! use bcap_core::io::CallError;
//! use bcap_embassy::net::{Connection, NetError, Options, TcpClient, TcpTransport};
//! use embassy_net::{IpEndpoint, Stack};
//! use embassy_time::Timer;
//!
//! async fn watch(stack: Stack<'_>, robot: IpEndpoint) -> ! {
//!     let (mut rx, mut tx) = ([0; 1024], [0; 1024]);
//!     let (mut reply, mut request) = ([0; 512], [0; 512]);
//!     let transport = TcpTransport::new(stack, &mut rx, &mut tx, Options::default());
//!     let client = Client::new(Config::TCP, &mut request[..], &mut reply[..]);
//!     let mut robot_link = Connection::new(transport, client);
//!     loop {
//!         if robot_link.transport().connect(robot).await.is_ok() {
//!             robot_link.client().reset();
//!             let _ended = read(&mut robot_link).await;
//!         }
//!         Timer::after_secs(1).await;
//!     }
//! }
//!
//! async fn read(robot: &mut TcpClient<'_, &mut [u8]>) -> Result<(), CallError<NetError>> {
//!     robot.call(call::service_start("WDT=400")).await?;
//!     let controller = robot.call(call::controller_connect("", "CaoProv.DENSO.VRC9", "localhost", "")).await?;
//!     let variable = robot.call(call::controller_get_variable(controller, "I1", "")).await?;
//!     loop {
//!         let _value = robot.call(call::variable_get_value(variable)).await?;
//!         Timer::after_millis(100).await;
//!     }
//! }
//! ```

mod tcp;
mod udp;

use core::fmt;
use core::pin::pin;

pub use bcap_core::io::asynch::{Connection, Transport};
use bcap_core::time::Instant;
use embassy_time::{Duration, TimeoutError, with_deadline};

pub use self::tcp::{Options, TcpTransport};
pub use self::udp::UdpTransport;
use crate::clock::{now, ticks};

/// A client over TCP.
pub type TcpClient<'s, T, R = T> = Connection<TcpTransport<'s>, T, R>;
/// A client over UDP.
pub type UdpClient<'s, T, R = T> = Connection<UdpTransport<'s>, T, R>;

/// Why a connection cannot be had, or used any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum NetError {
    /// The board has no link, or no address.
    Down,
    /// No way leads to the peer.
    NoRoute,
    /// The peer refused the connection, or ended it.
    Reset,
    /// The peer did not answer in time.
    Timeout,
    /// The datagram is larger than the socket's memory.
    TooLarge,
}

impl fmt::Display for NetError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Down => "the network is down",
            Self::NoRoute => "there is no route to the peer",
            Self::Reset => "the peer refused or ended the connection",
            Self::Timeout => "the peer did not answer",
            Self::TooLarge => "the datagram does not fit the socket's memory",
        })
    }
}

impl core::error::Error for NetError {}

/// How often what waits looks whether the link is still there.
///
/// embassy-net can wake one task when its link changes, and that one is not ours to take.
const LINK_INTERVAL: Duration = Duration::from_millis(250);

/// Waits for `work` until it is `until`, or the network is down.
async fn wait<T>(
    stack: embassy_net::Stack<'_>,
    until: Instant,
    work: impl Future<Output = T>,
) -> Result<Option<T>, NetError> {
    let mut work = pin!(work);
    let until = ticks(until);
    loop {
        let look = embassy_time::Instant::now().saturating_add(LINK_INTERVAL).min(until);
        match with_deadline(look, work.as_mut()).await {
            Ok(done) => return Ok(Some(done)),
            Err(TimeoutError) if is_down(stack) => return Err(NetError::Down),
            Err(TimeoutError) if embassy_time::Instant::now() >= until => return Ok(None),
            Err(TimeoutError) => {}
        }
    }
}

/// Tells whether the board has no link or no address.
fn is_down(stack: embassy_net::Stack<'_>) -> bool {
    !(stack.is_link_up() && stack.is_config_up())
}
