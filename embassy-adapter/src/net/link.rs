//! A wait that ends when the link goes down; shared by both transports.

use core::future::poll_fn;
use core::pin::pin;
use core::task::{Context, Poll};

use embassy_time::{Duration, Instant, Timer};

use crate::clock::ticks;
use crate::error::NetError;

/// The interval at which a waiting call checks that the link is up.
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
    until: bcap_core::time::Instant,
    work: impl Future<Output = T>,
) -> Result<Option<T>, NetError> {
    let mut work = pin!(work);
    let mut limit = Limit { until: ticks(until), check: Instant::MAX };
    poll_fn(move |cx| match work.as_mut().poll(cx) {
        Poll::Ready(done) => Poll::Ready(Ok(Some(done))),
        // the clock is read and a timer set only now: often the work completes immediately
        Poll::Pending => limit.poll(stack, cx).map(|ended| ended.map(|()| None)),
    })
    .await
}

/// The end of a wait.
struct Limit {
    until: Instant,
    /// The time of the next check of the link; `MAX` before the first poll.
    check: Instant,
}

impl Limit {
    /// Returns `Ok` at the time limit. Not generic, so an image contains one copy of it.
    #[inline(never)]
    fn poll(&mut self, stack: embassy_net::Stack<'_>, cx: &mut Context<'_>) -> Poll<Result<(), NetError>> {
        let now = Instant::now();
        let next = now.saturating_add(LINK_INTERVAL).min(self.until);
        if now >= self.check.min(self.until) {
            match is_down(stack) {
                true => return Poll::Ready(Err(NetError::Down)),
                false if now >= self.until => return Poll::Ready(Ok(())),
                false => self.check = next,
            }
        }
        self.check = self.check.min(next);
        // its first poll sets the time to wake this task, which stays set without the timer
        let _ = pin!(Timer::at(self.check)).poll(cx);
        Poll::Pending
    }
}

/// Returns whether the board has no link or no address.
pub(super) fn is_down(stack: embassy_net::Stack<'_>) -> bool {
    !(stack.is_link_up() && stack.is_config_up())
}
