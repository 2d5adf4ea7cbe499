//! Clients over the TCP and UDP of embassy-net.
//!
//! embassy-net's own task (`Runner::run`) must run concurrently, and its `StackResources` need one socket per client.
//!
//! # Examples
//!
//! A client over TCP that reads a variable and reconnects after a failure:
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

#[cfg(feature = "server")]
mod backlog;
mod link;
mod tcp;
mod udp;
mod usage;

pub use bcap_core::io::asynch::{Connection, Transport};

#[cfg(feature = "server")]
pub use self::backlog::Backlog;
#[cfg(feature = "server")]
pub(crate) use self::backlog::{Place, evicted};
pub use self::tcp::{Options, TcpTransport};
pub use self::udp::{UdpTransport, discard};
pub use self::usage::Usage;
pub use crate::error::NetError;

/// A client over TCP.
pub type TcpClient<'s, T, R = T> = Connection<TcpTransport<'s>, T, R>;
/// A client over UDP.
pub type UdpClient<'s, T, R = T> = Connection<UdpTransport<'s>, T, R>;
