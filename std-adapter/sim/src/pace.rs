//! A controller whose clock runs faster or slower than the clock of its server.
//!
//! The times of calls are converted to the controller's clock, and the times until which calls wait are converted back. Time
//! limits of clients and of the server stay in their own time.

use core::time::Duration;

use bcap_core::bcap::server as bcap;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::{Request as RacRequest, server as rac};
use bcap_core::time::Instant;

use crate::controller::Controller;

/// The accepted factors.
const FACTORS: std::ops::RangeInclusive<f64> = 0.1..=10.0;

/// Maximum time after which a waiting call is resumed, by the server's clock.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

/// A controller with a time factor.
///
/// # Examples
///
/// ```
/// use bcap_core::time::Instant;
/// use bcap_sim::pace::Paced;
/// use bcap_sim::{Config, Controller};
///
/// let mut paced = Paced::new(Controller::new(Config::default()));
/// paced.set_factor(2.0, Instant::from_millis(1000))?;
/// assert_eq!(paced.time(Instant::from_millis(1500)), Instant::from_millis(2000));
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug)]
pub struct Paced {
    controller: Controller,
    factor: f64,
    /// When the factor was set, by the server's clock and by the controller's.
    since: (Instant, Instant),
}

impl Paced {
    /// Returns the controller with the factor 1.
    #[must_use]
    pub const fn new(controller: Controller) -> Self {
        Self { controller, factor: 1.0, since: (Instant::ZERO, Instant::ZERO) }
    }

    /// Returns the factor: 2 is twice as fast.
    #[must_use]
    pub const fn factor(&self) -> f64 {
        self.factor
    }

    /// Changes the factor from the server's time `now` on.
    ///
    /// # Errors
    ///
    /// A text for a factor outside of 0.1 to 10.
    pub fn set_factor(&mut self, factor: f64, now: Instant) -> Result<(), String> {
        if !FACTORS.contains(&factor) {
            return Err(format!("{factor}: the time factor is {} to {}", FACTORS.start(), FACTORS.end()));
        }
        self.since = (now, self.time(now));
        self.factor = factor;
        Ok(())
    }

    /// Converts a time of the server to the controller's clock.
    #[must_use]
    pub fn time(&self, now: Instant) -> Instant {
        let (server, controller) = self.since;
        controller.saturating_add(now.saturating_since(server).mul_f64(self.factor))
    }

    /// Returns the controller, and the time on its clock.
    pub fn at(&mut self, now: Instant) -> (&mut Controller, Instant) {
        let time = self.time(now);
        (&mut self.controller, time)
    }

    /// Returns the controller.
    pub const fn controller(&mut self) -> &mut Controller {
        &mut self.controller
    }

    /// Converts the time of a waiting call to the server's clock. A call is resumed early, because the factor may change.
    fn converted(&self, outcome: Outcome, now: Instant) -> Outcome {
        match outcome {
            Outcome::Wait(time) if time != Instant::FAR_FUTURE => {
                let (server, controller) = self.since;
                let time = server.saturating_add(time.saturating_since(controller).div_f64(self.factor));
                Outcome::Wait(time.min(now.saturating_add(LONGEST_WAIT)))
            }
            outcome => outcome,
        }
    }
}

impl bcap::Handler for Paced {
    fn call(&mut self, peer: PeerId, request: &bcap::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let (controller, time) = self.at(now);
        let outcome = bcap::Handler::call(controller, peer, request, reply, time);
        self.converted(outcome, now)
    }

    fn resume(
        &mut self,
        peer: PeerId,
        request: &bcap::Request<'_>,
        reply: &mut ReplyValue<'_>,
        now: Instant,
    ) -> Outcome {
        let (controller, time) = self.at(now);
        let outcome = bcap::Handler::resume(controller, peer, request, reply, time);
        self.converted(outcome, now)
    }

    fn release(&mut self, peer: PeerId, request: &bcap::Request<'_>, now: Instant) {
        let (controller, time) = self.at(now);
        bcap::Handler::release(controller, peer, request, time);
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        let (controller, time) = self.at(now);
        bcap::Handler::abandoned(controller, peer, time);
    }

    fn refused(&mut self, peer: PeerId, request: &bcap::Request<'_>, code: HResult, now: Instant) {
        let (controller, time) = self.at(now);
        bcap::Handler::refused(controller, peer, request, code, time);
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        let (controller, time) = self.at(now);
        bcap::Handler::left(controller, peer, time);
    }
}

impl rac::Handler for Paced {
    fn call(&mut self, peer: PeerId, request: &RacRequest<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let (controller, time) = self.at(now);
        let outcome = rac::Handler::call(controller, peer, request, reply, time);
        self.converted(outcome, now)
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        let (controller, time) = self.at(now);
        rac::Handler::left(controller, peer, time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Config;

    #[test]
    fn times_go_to_the_controllers_clock_and_back() {
        let mut paced = Paced::new(Controller::new(Config::default()));
        let at = Instant::from_millis;
        paced.set_factor(0.5, at(100)).unwrap();
        assert_eq!(paced.time(at(300)), at(200));
        assert_eq!(paced.converted(Outcome::Wait(at(200)), at(250)), Outcome::Wait(at(300)));
        // a call that waits for 2 s is resumed within 100 ms, because the factor may have changed by then
        assert_eq!(paced.converted(Outcome::Wait(at(2200)), at(300)), Outcome::Wait(at(400)));
        paced.set_factor(10.0, at(300)).unwrap();
        assert_eq!(paced.time(at(400)), at(1200), "the clock does not jump");
        assert_eq!(paced.converted(Outcome::Wait(at(1200)), at(350)), Outcome::Wait(at(400)));
        assert_eq!(paced.converted(Outcome::Wait(at(2200)), at(400)), Outcome::Wait(at(500)), "not after 2100");
        assert_eq!(paced.converted(Outcome::Wait(Instant::FAR_FUTURE), at(400)), Outcome::Wait(Instant::FAR_FUTURE));
        for factor in [0.0, -1.0, 11.0, f64::NAN] {
            assert!(paced.set_factor(factor, at(400)).is_err(), "{factor}");
        }
        assert_eq!(paced.factor(), 10.0);
    }
}
