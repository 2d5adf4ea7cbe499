//! The hand: an electric gripper whose fingers move with a limited speed.
//!
//! | Controller_Execute, COBOTTA        | effect                                                |
//! |------------------------------------|-------------------------------------------------------|
//! | HandMoveH \[force, close\]         | closes or opens; answers when the fingers are at rest |
//! | HandMoveA \[place, speed\]         | moves to a place, 0 to 30 mm; HandMoveA and HandMoveH accept a third element `"Next"`, and then answer immediately |
//! | HandMoveR \[way, speed\]           | moves by a distance in mm; a negative distance closes |
//! | HandMoveAH \[place, speed, force\] | moves to a place; there is nothing to grip on the way |
//! | HandMoveVH \[power, on\]           | switches suction, of 0 to 100 percent, on or off      |
//! | HandHoldState                      | BOOL: always false, there is nothing to grip          |
//! | HandStop                           | stops; waiting calls get `E_ABORT`; `S_FALSE` at rest |
//! | HandCurPos                         | R8, mm between the fingers                            |
//! | HandCurLoad                        | R8, percent: always 0, there is nothing to grip       |
//!
//! | Extension_Execute of `Hand0`        | effect (RC8 provider guide, 5.2.36)                                  |
//! |-------------------------------------|----------------------------------------------------------------------|
//! | Motor state                         | switches the motor of the hand                                       |
//! | Org                                 | closes, and finds the origin; moves are refused before it            |
//! | Chuck, UnChuck point                | closes, opens                                                        |
//! | MoveP point                         | as the point says: points 0 to 31, the odd ones close, the even ones open |
//! | MoveA, MoveR \[mm, speed\]          | moves to a place, by a way; speed 20 to 100 percent                  |
//! | MoveAH, MoveRH \[mm, speed, force\] | likewise; force 30 to 100 percent                                    |
//! | MoveH \[speed, force, direction\]   | opens (0) or closes; speed 20 to 50 percent                          |
//! | MoveZH \[zone, zone, speed, force, direction\] | likewise, with a zone for get_ZonState                    |
//! | Stop                                | stops; waiting calls get `E_ABORT`                                   |
//! | CurPos                              | R4, mm                                                               |
//! | GetPoint \[point, element\]         | I4 mode, R4 mm, I4 speed, I4 force, R4 zone, R4 zone                 |
//! | get_EmgState, get_MotorState, get_OrgState | I4: 0 emergency stop; 0 off; 0 before Org                     |
//! | get_BusyState, get_InposState, get_ZonState | I4: 1 while it moves; after a move; within the zone          |
//! | get_HoldState, get_Error            | I4 0: there is nothing to grip                                       |
//!
//! Robot_Chuck and Robot_Unchuck close and open as well; they have no options and need no Org. Speeds are 1 to 100 percent of
//! [`SPEED`]. A force of a COBOTTA is 6 to 20 N; HandMoveH moves at a quarter of [`SPEED`]. There is one board, number 0. A move
//! before Org, or with the motor of the hand off, is refused with 0x83585200, the code of such states.
//!
//! Moving the hand requires Auto mode, the executable token and no error. While it moves, further motions of the hand are
//! refused with `E_ROBOTISBUSY`. An error stops it immediately, as does the end of the session of the client that moves it.
//! Numbers out of range are `E_INVALIDARG`. Of the hand's commands, Slave Mode allows only HandMoveA.

use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::rules;
use crate::table::Command;
use crate::value::{command_number, numbers, one_int, whole};
use crate::waits::{Wait, Waits};

/// The name of the extension.
pub(crate) const NAME: &str = "Hand0";

/// The largest distance between the fingers, in mm.
pub const STROKE: f64 = 30.0;

/// The full speed of the fingers, in mm per second.
pub const SPEED: f64 = 80.0;

/// The forces that HandMoveH accepts, in N.
const FORCES: std::ops::RangeInclusive<f64> = 6.0..=20.0;

/// The state of an electric hand forbids a command: no origin, or its motor is off. The last digit is the board.
const HAND_STATE: HResult = HResult::from_u32(0x8358_5200);

/// The number of points, and the speeds and forces of the moves of an electric hand, in percent.
const POINTS: std::ops::RangeInclusive<i32> = 0..=31;
const SPEEDS: std::ops::RangeInclusive<f64> = 20.0..=100.0;
const GRIP_SPEEDS: std::ops::RangeInclusive<f64> = 20.0..=50.0;
const GRIP_FORCES: std::ops::RangeInclusive<f64> = 30.0..=100.0;

type HandHandler = fn(&mut Hand, &mut Context<'_>, &Variant<'_>) -> Answered;

const fn command(name: &'static str, run: HandHandler) -> Command<HandHandler> {
    Command::new(name, run)
}

const POINT: &str = "one number, 0 to 31";
const MOVE: &str = "[mm, speed]: within 0 to 30 mm, 20 to 100 percent";
const MOVE_AND_GRIP: &str = "[mm, speed, force]: within 0 to 30 mm, 20 to 100 percent, 30 to 100 percent";

/// The commands of Extension_Execute.
pub(crate) const COMMANDS: &[Command<HandHandler>] = &[
    command("Chuck", |hand, ctx, param| hand.at_point(ctx, param, |_| 0.0)).accepts(POINT),
    command("UnChuck", |hand, ctx, param| hand.at_point(ctx, param, |_| STROKE)).accepts(POINT),
    command("Motor", |hand, ctx, param| {
        let on = one_int(param)? != 0;
        ctx.may(&rules::HAND)?;
        hand.motor = on && (hand.motor || !ctx.panel.emergency_stop);
        Ok(Answer::Done)
    })
    .accepts("one number: 0 off, otherwise on"),
    command("Org", |hand, ctx, _| {
        ctx.may(&rules::HAND)?;
        hand.origin = hand.motor;
        hand.drive(ctx, 0.0, 100.0)
    }),
    command("MoveP", |hand, ctx, param| hand.at_point(ctx, param, place_of_point)).accepts(POINT),
    command("MoveA", |hand, ctx, param| match numbers(param)?[..] {
        [place, speed] if SPEEDS.contains(&speed) => hand.drive(ctx, place, speed),
        _ => Err(HResult::E_INVALIDARG),
    })
    .accepts(MOVE),
    command("MoveR", |hand, ctx, param| match numbers(param)?[..] {
        [way, speed] if SPEEDS.contains(&speed) => hand.drive(ctx, hand.position(ctx.now) + way, speed),
        _ => Err(HResult::E_INVALIDARG),
    })
    .accepts(MOVE),
    command("MoveAH", |hand, ctx, param| match numbers(param)?[..] {
        [place, speed, force] if SPEEDS.contains(&speed) && GRIP_FORCES.contains(&force) => {
            hand.drive(ctx, place, speed)
        }
        _ => Err(HResult::E_INVALIDARG),
    })
    .accepts(MOVE_AND_GRIP),
    command("MoveRH", |hand, ctx, param| match numbers(param)?[..] {
        [way, speed, force] if SPEEDS.contains(&speed) && GRIP_FORCES.contains(&force) => {
            hand.drive(ctx, hand.position(ctx.now) + way, speed)
        }
        _ => Err(HResult::E_INVALIDARG),
    })
    .accepts(MOVE_AND_GRIP),
    command("MoveH", |hand, ctx, param| hand.until_grip(ctx, &numbers(param)?))
        .accepts("[speed, force, direction]: 20 to 50 percent, 30 to 100 percent, 0 opens"),
    command("MoveZH", |hand, ctx, param| match &numbers(param)?[..] {
        [first, second, others @ ..] if [first, second].iter().all(|place| (0.0..=STROKE).contains(*place)) => {
            let answer = hand.until_grip(ctx, others)?;
            hand.zone = Some((first.min(*second), first.max(*second)));
            Ok(answer)
        }
        _ => Err(HResult::E_INVALIDARG),
    })
    .accepts("[zone, zone, speed, force, direction]: two places in mm, then as MoveH"),
    command("Stop", |hand, ctx, _| {
        hand.stop(HResult::E_ABORT, ctx.now, ctx.waits);
        Ok(Answer::Done)
    }),
    command("CurPos", |hand, ctx, _| Answer::of(hand.position(ctx.now) as f32)),
    command("GetPoint", |_, _, param| match numbers(param)?[..] {
        [point, element] => element_of_point(whole(point)?, whole(element)?),
        _ => Err(HResult::E_INVALIDARG),
    })
    .accepts("[point, element]: point 0 to 31, element 0 to 5"),
    command("get_EmgState", |_, ctx, _| state(!ctx.panel.emergency_stop)),
    command("get_ZonState", |hand, ctx, _| {
        let place = hand.position(ctx.now);
        state(hand.zone.is_some_and(|(from, to)| (from..=to).contains(&place)))
    }),
    command("get_OrgState", |hand, _, _| state(hand.origin)),
    command("get_HoldState", |_, _, _| state(false)),
    command("get_InposState", |hand, ctx, _| state(hand.origin && hand.end(ctx.now).is_none())),
    command("get_Error", |_, _, _| state(false)),
    command("get_BusyState", |hand, ctx, _| state(hand.end(ctx.now).is_some())),
    command("get_MotorState", |hand, _, _| state(hand.motor)),
];

fn state(on: bool) -> Answered {
    Answer::of(i32::from(on))
}

/// Returns where the fingers are at a point: the odd ones close, the even ones open.
fn place_of_point(point: i32) -> f64 {
    if point % 2 == 0 { STROKE } else { 0.0 }
}

/// Returns an element of a point: the mode, the place, speed and force in percent, the zone.
fn element_of_point(point: i32, element: i32) -> Answered {
    if !POINTS.contains(&point) {
        return Err(HResult::E_INVALIDARG);
    }
    match element {
        0 => Answer::of(point % 2),
        1 => Answer::of(place_of_point(point) as f32),
        2 => Answer::of(100),
        3 => Answer::of(50),
        4 | 5 => Answer::of(0.0_f32),
        _ => Err(HResult::E_INVALIDARG),
    }
}

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
    /// The motor of an electric hand.
    motor: bool,
    /// An electric hand has found its origin.
    origin: bool,
    /// The zone of the last MoveZH, in mm.
    zone: Option<(f64, f64)>,
}

impl Hand {
    /// Creates a closed hand at rest.
    pub(crate) const fn new() -> Self {
        let (began, end) = (Instant::ZERO, Instant::ZERO);
        let (suction, motor, origin) = (false, false, false);
        Self { from: 0.0, to: 0.0, began, end, peer: PeerId(0), suction, motor, origin, zone: None }
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

    /// Moves an electric hand, which needs its motor and its origin.
    fn drive(&mut self, ctx: &mut Context<'_>, to: f64, percent: f64) -> Answered {
        ctx.may(&rules::HAND)?;
        if !self.motor || !self.origin {
            return Err(HAND_STATE);
        }
        self.move_to(ctx, to, percent)
    }

    /// Moves an electric hand to the place of a point.
    fn at_point(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>, place: fn(i32) -> f64) -> Answered {
        let point = Some(one_int(param)?).filter(|point| POINTS.contains(point)).ok_or(HResult::E_INVALIDARG)?;
        self.drive(ctx, place(point), 100.0)
    }

    /// Moves an electric hand to the end of its way, `[speed, force, direction]`.
    fn until_grip(&mut self, ctx: &mut Context<'_>, given: &[f64]) -> Answered {
        match given {
            [speed, force, direction] if GRIP_SPEEDS.contains(speed) && GRIP_FORCES.contains(force) => {
                self.drive(ctx, if *direction == 0.0 { STROKE } else { 0.0 }, *speed)
            }
            _ => Err(HResult::E_INVALIDARG),
        }
    }

    /// Executes HandMoveA, `[place, speed]`, optionally with `"Next"`.
    pub(crate) fn move_absolute(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        let ((place, percent), next) = pair_and_next(param)?;
        Ok(without_wait(self.move_to(ctx, place, percent)?, next))
    }

    /// Executes HandMoveR, `[way, speed]`.
    pub(crate) fn move_relative(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        let (way, percent) = pair(param)?;
        self.move_to(ctx, self.position(ctx.now) + way, percent)
    }

    /// Executes HandMoveH, `[force, close]`, optionally with `"Next"`.
    pub(crate) fn grip(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        let ((force, closes), next) = pair_and_next(param)?;
        if !FORCES.contains(&force) {
            return Err(HResult::E_INVALIDARG);
        }
        Ok(without_wait(self.move_to(ctx, if closes != 0.0 { 0.0 } else { STROKE }, 25.0)?, next))
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

/// Reads two numbers, and whether the text `Next` follows: the call does not wait for the fingers.
fn pair_and_next(param: &Variant<'_>) -> Result<((f64, f64), bool), HResult> {
    let items: Vec<_> = param.as_array().into_iter().flat_map(|array| array.iter()).collect();
    let [first, second, next] = &items[..] else { return Ok((pair(param)?, false)) };
    match next.flatten() {
        Variant::Bstr(text) if text.to_string().trim().eq_ignore_ascii_case("next") => {
            Ok(((command_number(first)?, command_number(second)?), true))
        }
        _ => Err(HResult::E_INVALIDARG),
    }
}

fn without_wait(answer: Answer, next: bool) -> Answer {
    if next { Answer::Done } else { answer }
}

fn pair(param: &Variant<'_>) -> Result<(f64, f64), HResult> {
    match numbers(param)?[..] {
        [first, second] => Ok((first, second)),
        _ => Err(HResult::E_INVALIDARG),
    }
}
