//! The light of a board: one LED whose blinking shows the fault.
//!
//! | pattern                | state                                              |
//! |------------------------|----------------------------------------------------|
//! | on, a short gap every 2 s | the robot answers; a light without gaps: the board hangs |
//! | short flash every 2 s  | no link: the cable or the switch                   |
//! | slow blinking, 1 s     | a link, no address: DHCP does not answer           |
//! | two flashes every 2 s  | an address, no robot: its address, or it is off    |
//! | fast blinking, 5 Hz    | an error: invalid settings, or a reset after a fault |
//!
//! An error hides the other states until the next reset without one.
//!
//! # Examples
//!
//! ```
//! use bcap_board::led::LedState;
//! use core::time::Duration;
//!
//! let state = LedState { link: true, address: true, robot: false, error: false };
//! let pattern = state.pattern();
//! // a task calls it again after `Pattern::STEP`
//! assert!(pattern.is_on(Duration::from_millis(0)));
//! assert!(!pattern.is_on(Duration::from_millis(1500)));
//! ```

use core::time::Duration;

#[cfg(feature = "embassy")]
use embassy_time::Timer;
#[cfg(feature = "embassy")]
use embedded_hal::digital::OutputPin;

/// The state that the LED shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LedState {
    /// Whether the Ethernet link is up.
    pub link: bool,
    /// Whether the board has an address.
    pub address: bool,
    /// Whether there is a session with the robot.
    pub robot: bool,
    /// Whether a setting is invalid or the last reset was a fault.
    pub error: bool,
}

/// How the light blinks: a step for each bit, repeated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pattern {
    /// The first step is the lowest bit; a set bit is on.
    steps: u32,
}

/// The number of steps of a pattern: it takes 2 s.
const STEPS: u32 = 20;

impl Pattern {
    /// The time of a step.
    pub const STEP: Duration = Duration::from_millis(100);

    const ON: Self = Self { steps: 0b0111_1111_1111_1111_1111 };
    const FLASH: Self = Self { steps: 0b1 };
    const SLOW: Self = Self { steps: 0b0000_0000_0011_1111_1111 };
    const TWICE: Self = Self { steps: 0b1001 };
    const FAST: Self = Self { steps: 0b0101_0101_0101_0101_0101 };

    /// Returns whether the light is on at a time since the start.
    #[must_use]
    pub fn is_on(self, uptime: Duration) -> bool {
        let step = uptime.as_millis() / Self::STEP.as_millis() % u128::from(STEPS);
        u32::try_from(step).is_ok_and(|step| self.steps & 1_u32.wrapping_shl(step) != 0)
    }
}

impl LedState {
    /// Returns how the light blinks in this state.
    #[must_use]
    pub const fn pattern(self) -> Pattern {
        match self {
            Self { error: true, .. } => Pattern::FAST,
            Self { link: false, .. } => Pattern::FLASH,
            Self { address: false, .. } => Pattern::SLOW,
            Self { robot: false, .. } => Pattern::TWICE,
            Self { .. } => Pattern::ON,
        }
    }
}

/// Shows the state on a pin that switches the LED on when it is high.
#[cfg(feature = "embassy")]
pub async fn run(mut pin: impl OutputPin, state: impl Fn() -> LedState) -> ! {
    loop {
        let uptime = Duration::from_micros(bcap_embassy::clock::now().as_micros());
        // an LED that cannot be switched must not stop the board
        let _ = pin.set_state(state().pattern().is_on(uptime).into());
        Timer::after_millis(100).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::String;

    /// Shows a pattern: a `#` for each 100 ms in which the light is on.
    fn shown(link: bool, address: bool, robot: bool, error: bool) -> String {
        let pattern = LedState { link, address, robot, error }.pattern();
        // the second round is as the first
        let light =
            |round: u64| (0..20).map(move |step| pattern.is_on(Duration::from_millis(round * 2000 + step * 100 + 99)));
        assert!(light(0).eq(light(1)) && light(0).eq(light(2_147_484)), "after 49 days, too");
        light(0).map(|on| if on { '#' } else { '.' }).collect()
    }

    #[test]
    fn each_state_has_its_pattern() {
        assert_eq!(shown(true, true, true, false), "###################.");
        assert_eq!(shown(false, true, true, false), "#...................", "the robot's session ends later");
        assert_eq!(shown(false, false, false, false), "#...................");
        assert_eq!(shown(true, false, false, false), "##########..........");
        assert_eq!(shown(true, true, false, false), "#..#................");
        for others in [true, false] {
            assert_eq!(shown(others, others, others, true), "#.#.#.#.#.#.#.#.#.#.");
        }
    }
}
