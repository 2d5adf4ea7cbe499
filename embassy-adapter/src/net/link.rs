//! A wait that ends when the link goes down; shared by both transports.

use core::pin::pin;

use bcap_core::time::Instant;
use embassy_time::{Duration, TimeoutError, with_deadline};

use crate::clock::ticks;
use crate::error::NetError;

/// How often a waiting call checks that the link is up.
///
/// This polls because embassy-net wakes only one task when its link changes, and the application may use that wake-up.
const LINK_INTERVAL: Duration = Duration::from_millis(250);

/// Waits for `work`; returns `None` at `until`.
///
/// # Errors
///
/// [`NetError::Down`] when the network goes down.
pub(super) async fn wait<T>(
    stack: embassy_net::Stack<'_>,
    until: Instant,
    work: impl Future<Output = T>,
) -> Result<Option<T>, NetError> {
    let mut work = pin!(work);
    let until = ticks(until);
    loop {
        let check = embassy_time::Instant::now().saturating_add(LINK_INTERVAL).min(until);
        match with_deadline(check, work.as_mut()).await {
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
