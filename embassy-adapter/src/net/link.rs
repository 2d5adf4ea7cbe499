//! What both transports need of the network: its errors, and waiting that ends when the link is lost.

use core::fmt;
use core::pin::pin;

use bcap_core::time::Instant;
use embassy_time::{Duration, TimeoutError, with_deadline};

use crate::clock::ticks;

/// Why a connection cannot be opened, or used any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum NetError {
    /// The board has no link, or no address.
    Down,
    /// There is no route to the peer.
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

/// How often a waiting call checks that the link is up.
///
/// embassy-net wakes only one task when its link changes, and the application may need that wake-up.
const LINK_INTERVAL: Duration = Duration::from_millis(250);

/// Waits for `work` until it is `until`, or the network is down.
pub(super) async fn wait<T>(
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
pub(super) fn is_down(stack: embassy_net::Stack<'_>) -> bool {
    !(stack.is_link_up() && stack.is_config_up())
}
