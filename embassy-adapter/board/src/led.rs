//! The state of a board on one LED.

use embassy_time::{Duration, Timer};
use embedded_hal::digital::OutputPin;

/// What the LED shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// No link or no address: three short flashes, then a pause.
    NoNetwork,
    /// An address, but no robot: a second on, a second off.
    NoRobot,
    /// The robot is connected: on, with a short gap every 2 s, so that a board that hangs looks different.
    Up,
}

impl State {
    /// Returns the pattern: times in milliseconds, starting with the LED on and alternating.
    #[must_use]
    pub const fn pattern(self) -> &'static [u64] {
        match self {
            Self::NoNetwork => &[100, 150, 100, 150, 100, 1400],
            Self::NoRobot => &[1000, 1000],
            Self::Up => &[1900, 100],
        }
    }
}

/// Shows the state on a pin that switches the LED on when it is high.
pub async fn run(mut pin: impl OutputPin, state: impl Fn() -> State) -> ! {
    loop {
        for (number, time) in state().pattern().iter().enumerate() {
            // an LED that cannot be switched is no reason to stop
            let _ = pin.set_state((number % 2 == 0).into());
            Timer::after(Duration::from_millis(*time)).await;
        }
    }
}
