//! The hand: an electric gripper whose fingers take their time.
//!
//! | Extension_Execute of `Hand0` | Controller_Execute, COBOTTA  | what it does                                      |
//! |------------------------------|------------------------------|---------------------------------------------------|
//! | Chuck                        | HandMoveH \[force, true\]    | closes; answers when the fingers stand            |
//! | UnChuck                      | HandMoveH \[force, false\]   | opens; likewise                                   |
//! | -                            | HandMoveA \[place, speed\]   | goes to a place, 0 to 30 mm                       |
//! | -                            | HandMoveR \[way, speed\]     | goes so many mm on, with a negative way to close  |
//! | -                            | HandStop                     | stops; who waits gets `E_ABORT`; `S_FALSE` at rest |
//! | CurPos                       | HandCurPos                   | R8, mm between the fingers                        |
//! | -                            | HandCurLoad                  | R8, percent: always 0, they have nothing to grip  |
//!
//! Robot_Chuck and Robot_Unchuck close and open as well; they know no options. Speeds are 1 to 100 percent of
//! [`SPEED`], a force is 6 to 20 N and closes and opens at a quarter of that speed. The parameter of Chuck and UnChuck,
//! the number of a way to grip, is not looked at.
//!
//! To move the hand needs Auto mode, the executable token and no error; while it moves, another motion of it is refused
//! with `E_ROBOTISBUSY`. An error stops it where it is, as does its client when it goes. Numbers out of range are
//! `E_INVALIDARG`. It has no part in slave mode, in which its commands are refused as others are.

use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

use crate::config::Profile;
use crate::controller::{Controller, Wait};
use crate::dispatch::{Answer, Answered};
use crate::value::{Value, numbers};

/// The name of the extension.
pub(crate) const NAME: &str = "Hand0";

/// How far the fingers open, in mm.
pub const STROKE: f64 = 30.0;

/// The full speed of the fingers, in mm per second.
pub const SPEED: f64 = 80.0;

/// The forces that HandMoveH takes, in N.
const FORCES: std::ops::RangeInclusive<f64> = 6.0..=20.0;

/// The commands of the controller that only a COBOTTA has.
pub(crate) const COMMANDS: [&str; 6] = ["HandMoveA", "HandMoveR", "HandMoveH", "HandStop", "HandCurPos", "HandCurLoad"];

/// The fingers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hand {
    from: f64,
    to: f64,
    began: Instant,
    /// When they arrive.
    end: Instant,
    /// Who has moved them last.
    peer: PeerId,
}

impl Hand {
    /// Closed, at rest.
    pub(crate) const fn new() -> Self {
        Self { from: 0.0, to: 0.0, began: Instant::ZERO, end: Instant::ZERO, peer: PeerId(0) }
    }

    pub(crate) fn position(&self, now: Instant) -> f64 {
        let time = self.end.saturating_since(self.began).as_secs_f64();
        let passed = now.saturating_since(self.began).as_secs_f64();
        if passed < time { self.from + (self.to - self.from) * passed / time } else { self.to }
    }

    /// Returns when it will stand; `None` when it does.
    pub(crate) fn end(&self, now: Instant) -> Option<Instant> {
        (now < self.end).then_some(self.end)
    }

    fn start(&mut self, peer: PeerId, to: f64, percent: f64, now: Instant) {
        let from = self.position(now);
        let micros = (to - from).abs() / (SPEED * percent / 100.0) * 1e6;
        let end = now.saturating_add(Duration::from_micros(micros.ceil() as u64));
        *self = Self { from, to, began: now, end, peer };
    }

    /// Stands at once; `false` when it stood already.
    fn stop(&mut self, now: Instant) -> bool {
        let moving = now < self.end;
        let here = self.position(now);
        (self.from, self.to, self.end) = (here, here, now);
        moving
    }
}

impl Controller {
    /// Returns how far the fingers of the hand were open when time was last heard of, in mm.
    #[must_use]
    pub fn hand_position(&self) -> f64 {
        self.hand.position(self.now)
    }

    /// Executes a command of the extension.
    pub(crate) fn hand_execute(&mut self, peer: PeerId, command: &str) -> Answered {
        match command.trim().to_ascii_lowercase().as_str() {
            "chuck" => self.move_hand(peer, 0.0, 100.0),
            "unchuck" => self.move_hand(peer, STROKE, 100.0),
            "curpos" => Ok(Value::R8(self.hand_position()).into()),
            _ => Err(HResult::E_INVALID_CMD_NAME),
        }
    }

    /// Executes a command that a COBOTTA's controller has for its hand; `None` for another one.
    pub(crate) fn hand_command(&mut self, peer: PeerId, command: &str, param: &Variant<'_>) -> Option<Answered> {
        let command = COMMANDS.iter().find(|name| name.eq_ignore_ascii_case(command))?;
        if self.config().profile != Profile::Cobotta {
            return None;
        }
        let pair = || match numbers(param)?[..] {
            [first, second] => Ok((first, second)),
            _ => Err(HResult::E_INVALIDARG),
        };
        Some(match *command {
            "HandMoveA" => pair().and_then(|(place, percent)| self.move_hand(peer, place, percent)),
            "HandMoveR" => pair().and_then(|(way, percent)| self.move_hand(peer, self.hand_position() + way, percent)),
            "HandMoveH" => pair().and_then(|(force, closes)| match FORCES.contains(&force) {
                true => self.move_hand(peer, if closes != 0.0 { 0.0 } else { STROKE }, 25.0),
                false => Err(HResult::E_INVALIDARG),
            }),
            "HandStop" => Ok(match self.stop_hand(HResult::E_ABORT) {
                true => Value::Empty.into(),
                false => Answer::Code(HResult::S_FALSE),
            }),
            "HandCurPos" => Ok(Value::R8(self.hand_position()).into()),
            _ => Ok(Value::R8(0.0).into()),
        })
    }

    /// Moves the fingers, and waits until they stand.
    pub(crate) fn move_hand(&mut self, peer: PeerId, to: f64, percent: f64) -> Answered {
        if !(0.0..=STROKE).contains(&to) || !(1.0..=100.0).contains(&percent) {
            return Err(HResult::E_INVALIDARG);
        }
        self.may_execute(peer)?;
        if self.hand.end(self.now).is_some() {
            return Err(HResult::E_ROBOTISBUSY);
        }
        self.hand.start(peer, to, percent, self.now);
        self.waits.insert(peer, Wait::Hand);
        // where they are already they arrive at once
        self.advance(self.now);
        self.resume_execute(peer)
    }

    /// Stops the fingers; who waits for them gets `code`.
    pub(crate) fn stop_hand(&mut self, code: HResult) -> bool {
        let stopped = self.hand.stop(self.now);
        if stopped {
            self.end_waits(|wait| wait == Wait::Hand, code);
        }
        stopped
    }

    /// Stops the fingers if this client moves them.
    pub(crate) fn forget_hand(&mut self, peer: PeerId) {
        if self.hand.peer == peer {
            self.stop_hand(HResult::E_ABORT);
        }
    }
}
