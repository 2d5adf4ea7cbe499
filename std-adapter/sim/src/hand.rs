//! The hand: an electric gripper whose fingers move with a limited speed.
//!
//! | Extension_Execute of `Hand0` | Controller_Execute, COBOTTA  | effect                                             |
//! |------------------------------|------------------------------|----------------------------------------------------|
//! | Chuck                        | HandMoveH \[force, true\]    | closes; answers when the fingers are at rest       |
//! | UnChuck                      | HandMoveH \[force, false\]   | opens; likewise                                    |
//! | -                            | HandMoveA \[place, speed\]   | moves to a place, 0 to 30 mm                       |
//! | -                            | HandMoveR \[way, speed\]     | moves by so many mm; a negative way closes         |
//! | -                            | HandMoveAH \[place, speed, force\] | moves to a place; there is nothing to grip on the way |
//! | -                            | HandMoveVH \[power, on\]     | switches suction, of 0 to 100 percent, on or off   |
//! | -                            | HandHoldState                | BOOL: always false, there is nothing to grip       |
//! | -                            | HandStop                     | stops; waiting calls get `E_ABORT`; `S_FALSE` at rest |
//! | CurPos                       | HandCurPos                   | R8, mm between the fingers                         |
//! | -                            | HandCurLoad                  | R8, percent: always 0, there is nothing to grip    |
//!
//! Robot_Chuck and Robot_Unchuck close and open as well; they have no options. Speeds are 1 to 100 percent of
//! [`SPEED`]. A force is 6 to 20 N; HandMoveH moves at a quarter of [`SPEED`]. The parameter of Chuck and UnChuck, the
//! number of a way to grip, is ignored.
//!
//! To move the hand needs Auto mode, the executable token and no error. While it moves, another motion of it is refused
//! with `E_ROBOTISBUSY`. An error stops it at once, as does the end of the client that moves it. Numbers out of range
//! are `E_INVALIDARG`. In Slave Mode its commands are refused like others.

use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::rules;
use crate::table::Command;
use crate::value::{Value, numbers};
use crate::waits::{Wait, Waits};

/// The name of the extension.
pub(crate) const NAME: &str = "Hand0";

/// The largest distance between the fingers, in mm.
pub const STROKE: f64 = 30.0;

/// The full speed of the fingers, in mm per second.
pub const SPEED: f64 = 80.0;

/// The forces that HandMoveH accepts, in N.
const FORCES: std::ops::RangeInclusive<f64> = 6.0..=20.0;

type Run = fn(&mut Hand, &mut Context<'_>) -> Answered;

/// The commands of Extension_Execute.
pub(crate) const COMMANDS: &[Command<Run>] = &[
    Command::new("Chuck", Hand::close),
    Command::new("UnChuck", Hand::open),
    Command::new("CurPos", |hand, ctx| Ok(Value::R8(hand.position(ctx.now)).into())),
];

/// The fingers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hand {
    from: f64,
    to: f64,
    began: Instant,
    /// When the fingers arrive.
    end: Instant,
    /// The client that moved the fingers last.
    peer: PeerId,
    suction: bool,
}

impl Hand {
    /// Makes a closed hand at rest.
    pub(crate) const fn new() -> Self {
        Self { from: 0.0, to: 0.0, began: Instant::ZERO, end: Instant::ZERO, peer: PeerId(0), suction: false }
    }

    /// Returns the distance between the fingers, in mm.
    pub(crate) fn position(&self, now: Instant) -> f64 {
        let time = self.end.saturating_since(self.began).as_secs_f64();
        let passed = now.saturating_since(self.began).as_secs_f64();
        if passed < time { self.from + (self.to - self.from) * passed / time } else { self.to }
    }

    /// Returns when the fingers arrive; `None` at rest.
    pub(crate) fn end(&self, now: Instant) -> Option<Instant> {
        (now < self.end).then_some(self.end)
    }

    /// Ends the calls that wait for a hand at rest.
    pub(crate) fn advance(&self, now: Instant, waits: &mut Waits) {
        if self.end(now).is_none() {
            waits.end(Wait::Hand, HResult::S_OK);
        }
    }

    pub(crate) fn close(&mut self, ctx: &mut Context<'_>) -> Answered {
        self.move_to(ctx, 0.0, 100.0)
    }

    pub(crate) fn open(&mut self, ctx: &mut Context<'_>) -> Answered {
        self.move_to(ctx, STROKE, 100.0)
    }

    /// Executes HandMoveA, `[place, speed]`.
    pub(crate) fn move_absolute(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        let (place, percent) = pair(param)?;
        self.move_to(ctx, place, percent)
    }

    /// Executes HandMoveR, `[way, speed]`.
    pub(crate) fn move_relative(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        let (way, percent) = pair(param)?;
        self.move_to(ctx, self.position(ctx.now) + way, percent)
    }

    /// Executes HandMoveH, `[force, close]`.
    pub(crate) fn grip(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        let (force, closes) = pair(param)?;
        if !FORCES.contains(&force) {
            return Err(HResult::E_INVALIDARG);
        }
        self.move_to(ctx, if closes != 0.0 { 0.0 } else { STROKE }, 25.0)
    }

    /// Executes HandMoveAH, `[place, speed, force]`.
    pub(crate) fn move_and_grip(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        match numbers(param)?[..] {
            [place, percent, force] if FORCES.contains(&force) => self.move_to(ctx, place, percent),
            _ => Err(HResult::E_INVALIDARG),
        }
    }

    /// Executes HandMoveVH, `[power, on]`.
    pub(crate) fn suck(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        let (power, on) = pair(param)?;
        if !(0.0..=100.0).contains(&power) {
            return Err(HResult::E_INVALIDARG);
        }
        ctx.may(&rules::HAND)?;
        (self.suction, self.peer) = (on != 0.0, ctx.peer);
        Ok(Answer::Done)
    }

    /// Switches suction off; returns whether it was on.
    fn release(&mut self) -> bool {
        std::mem::take(&mut self.suction)
    }

    fn move_to(&mut self, ctx: &mut Context<'_>, to: f64, percent: f64) -> Answered {
        if !(0.0..=STROKE).contains(&to) || !(1.0..=100.0).contains(&percent) {
            return Err(HResult::E_INVALIDARG);
        }
        ctx.may(&rules::HAND)?;
        if self.end(ctx.now).is_some() {
            return Err(HResult::E_ROBOTISBUSY);
        }
        let from = self.position(ctx.now);
        let micros = (to - from).abs() / (SPEED * percent / 100.0) * 1e6;
        let end = ctx.now.saturating_add(Duration::from_micros(micros.ceil() as u64));
        *self = Self { from, to, began: ctx.now, end, peer: ctx.peer, ..*self };
        Ok(Answer::Until(Wait::Hand))
    }

    /// Stops the fingers and the suction; returns whether there was something to stop. Calls that wait for the fingers end
    /// with `code`.
    pub(crate) fn stop(&mut self, code: HResult, now: Instant, waits: &mut Waits) -> bool {
        let (moving, sucked) = (now < self.end, self.release());
        let here = self.position(now);
        (self.from, self.to, self.end) = (here, here, now);
        if moving {
            waits.end(Wait::Hand, code);
        }
        moving || sucked
    }

    /// Stops the fingers if this client moves them.
    pub(crate) fn forget(&mut self, peer: PeerId, now: Instant, waits: &mut Waits) {
        if self.peer == peer {
            self.stop(HResult::E_ABORT, now, waits);
        }
    }
}

fn pair(param: &Variant<'_>) -> Result<(f64, f64), HResult> {
    match numbers(param)?[..] {
        [first, second] => Ok((first, second)),
        _ => Err(HResult::E_INVALIDARG),
    }
}
