//! The buffer of slave mode and the cycle that empties it; no commands, no formats.
//!
//! ```text
//!   slvMove ──► waiting ──► buffer: 3, or the newest 1 ──► a cycle each 8 ms ──► the axes move evenly
//!               (mode 2)                                   speed, acceleration    for one cycle
//! ```

use std::collections::VecDeque;
use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::time::Instant;

use super::{CYCLE, Limits, SlaveCounters};
use crate::kinematics::Axes;

/// Positions that modes 0 and 2 buffer.
const BUFFER: usize = 3;

/// An axis below this speed, in degrees per second, stands: less than what a pose loses on its way through R4.
const REST: f64 = 0.01;

/// By how much a speed or an acceleration may exceed its limit, as a part of it: rounding is no excess.
const SLACK: f64 = 1e-6;

/// What is done with positions: the mode's hundreds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Buffering {
    /// Mode 0: buffered, refused when the buffer is full.
    Refuse,
    /// Mode 1: the newest replaces one that was not taken.
    Overwrite,
    /// Mode 2: buffered, not answered before there is room.
    Wait,
}

/// A mode: what slvChangeMode selects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SlaveMode {
    pub(crate) buffering: Buffering,
    /// The kind of poses: P, J or T.
    pub(crate) kind: Kind,
}

impl SlaveMode {
    /// Reads the number of a mode that is not 0.
    pub(crate) fn from_number(number: i32) -> Option<Self> {
        let buffering = match number & !0xF {
            0x000 => Buffering::Refuse,
            0x100 => Buffering::Overwrite,
            0x200 => Buffering::Wait,
            _ => return None,
        };
        let kind = match number & 0xF {
            1 => Kind::P,
            2 => Kind::J,
            3 => Kind::T,
            _ => return None,
        };
        Some(Self { buffering, kind })
    }

    pub(crate) fn number(self) -> i32 {
        let kind = match self.kind {
            Kind::P => 1,
            Kind::J => 2,
            _ => 3,
        };
        kind + match self.buffering {
            Buffering::Refuse => 0x000,
            Buffering::Overwrite => 0x100,
            Buffering::Wait => 0x200,
        }
    }
}

/// What became of a position that was offered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Offered {
    Stored,
    /// Stored, and mode 0 has no room for another.
    Full,
    /// Kept until there is room.
    Withheld,
}

/// What a cycle has done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ticked {
    /// It took a position; otherwise the axes hold theirs.
    pub(super) took: bool,
    /// The position that was withheld is in the buffer now.
    pub(super) stored: bool,
}

/// Slave mode while it is on.
#[derive(Clone, Debug)]
pub(crate) struct Stream {
    /// Whose slave mode it is.
    pub(crate) peer: PeerId,
    pub(crate) mode: SlaveMode,
    limits: Limits,
    buffer: VecDeque<Axes>,
    withheld: Option<Axes>,
    /// The client wants to leave; when the buffer is empty and the axes stand, slave mode is over.
    pub(crate) leaving: bool,
    /// Cycles since slave mode was entered.
    pub(crate) cycle: u64,
    /// When the present cycle began, and where the axes are at its beginning and at its end.
    began: Instant,
    from: Axes,
    to: Axes,
    /// In the present cycle, in degrees per second, and its change since the cycle before, per second.
    speed: Axes,
    acceleration: Axes,
}

impl Stream {
    pub(super) fn new(peer: PeerId, mode: SlaveMode, limits: Limits, here: Axes, now: Instant) -> Self {
        Self {
            peer,
            mode,
            limits,
            buffer: VecDeque::with_capacity(BUFFER),
            withheld: None,
            leaving: false,
            cycle: 0,
            began: now,
            from: here,
            to: here,
            speed: [0.0; 8],
            acceleration: [0.0; 8],
        }
    }

    /// Returns where the axes are.
    pub(crate) fn axes(&self, now: Instant) -> Axes {
        let passed = now.saturating_since(self.began).as_secs_f64() / CYCLE.as_secs_f64();
        let part = passed.min(1.0);
        each(|n| self.from[n] + (self.to[n] - self.from[n]) * part)
    }

    /// Returns where the axes are at the end of the present cycle.
    pub(crate) fn commanded(&self) -> Axes {
        self.to
    }

    /// Returns where the axes will be when all that has come was done.
    pub(super) fn destination(&self) -> Axes {
        self.withheld.or_else(|| self.buffer.back().copied()).unwrap_or(self.to)
    }

    /// Returns the speeds of the axes in this cycle, in degrees per second.
    pub(super) fn speed(&self) -> Axes {
        self.speed
    }

    /// Returns what the drives need, in percent: as much as they accelerate, and a tenth of their speed for friction.
    pub(super) fn current(&self) -> Axes {
        let part = |value: f64, limit: f64| if limit > 0.0 { value / limit * 100.0 } else { 0.0 };
        each(|n| {
            part(self.acceleration[n], self.limits.acceleration[n]) + part(self.speed[n], self.limits.speed[n]) / 10.0
        })
    }

    pub(crate) fn is_moving(&self) -> bool {
        self.speed.iter().any(|speed| speed.abs() > REST)
    }

    /// Tells whether everything was done and leaving is complete.
    pub(super) fn has_left(&self) -> bool {
        self.leaving && self.buffer.is_empty() && !self.is_moving()
    }

    /// Returns when the next cycle begins.
    pub(crate) fn next_cycle(&self) -> Instant {
        self.began.saturating_add(CYCLE)
    }

    /// Tells whether a cycle begins by this time.
    pub(super) fn is_due(&self, now: Instant) -> bool {
        now.saturating_since(self.began) >= CYCLE
    }

    /// Tells whether a position is to be refused now.
    pub(super) fn refuses(&self) -> bool {
        self.mode.buffering == Buffering::Refuse && self.is_full()
    }

    fn is_full(&self) -> bool {
        self.buffer.len() >= BUFFER
    }

    /// Takes a position that is not to be [refused](Self::refuses).
    pub(super) fn offer(&mut self, axes: Axes, counters: &mut SlaveCounters) -> Offered {
        match self.mode.buffering {
            Buffering::Overwrite => {
                counters.overwritten += self.buffer.len() as u64;
                self.buffer.clear();
            }
            Buffering::Wait if self.is_full() => {
                counters.withheld += 1;
                self.withheld = Some(axes);
                return Offered::Withheld;
            }
            _ => {}
        }
        self.buffer.push_back(axes);
        if self.mode.buffering == Buffering::Refuse && self.is_full() { Offered::Full } else { Offered::Stored }
    }

    /// Forgets the position that is withheld: nobody waits for it any more.
    pub(super) fn forget_withheld(&mut self) {
        self.withheld = None;
    }

    /// Begins the next cycle; the error is what releases slave mode, and the axes are where the last cycle ended.
    pub(super) fn tick(&mut self, counters: &mut SlaveCounters) -> Result<Ticked, HResult> {
        self.cycle += 1;
        counters.cycles += 1;
        let taken = self.buffer.pop_front();
        let holds = self.mode.buffering == Buffering::Overwrite || self.leaving || !self.is_moving();
        let to = match taken {
            Some(axes) => axes,
            None if holds => self.to,
            None => {
                counters.underflows += 1;
                return Err(HResult::E_COMMAND_BUFFER_EMPTY);
            }
        };
        let seconds = CYCLE.as_secs_f64();
        let speed = each(|n| (to[n] - self.to[n]) / seconds);
        let acceleration = each(|n| (speed[n] - self.speed[n]) / seconds);
        self.limits.check(&speed, &acceleration)?;
        (self.from, self.to) = (self.to, to);
        (self.speed, self.acceleration) = (speed, acceleration);
        self.began = self.next_cycle();
        *(if taken.is_some() { &mut counters.taken } else { &mut counters.held }) += 1;
        let withheld = self.withheld.take();
        self.buffer.extend(withheld);
        Ok(Ticked { took: taken.is_some(), stored: withheld.is_some() })
    }

    /// Lets the cycles pass in which nothing can happen: those that begin by `until`, and no more than `most`.
    pub(super) fn skip_idle(&mut self, until: Instant, most: u64, counters: &mut SlaveCounters) {
        if !self.buffer.is_empty() || self.is_moving() || self.leaving {
            return;
        }
        let cycles = until.saturating_since(self.began).as_micros() / CYCLE.as_micros();
        let cycles = u64::try_from(cycles).unwrap_or(u64::MAX).min(most);
        if cycles > 0 {
            self.from = self.to;
            (self.speed, self.acceleration) = ([0.0; 8], [0.0; 8]);
            // the product is not above `until`
            self.began = self.began.saturating_add(Duration::from_micros(cycles * micros(CYCLE)));
            self.cycle += cycles;
            counters.cycles += cycles;
            counters.held += cycles;
        }
    }
}

impl Limits {
    /// Checks the speeds of all axes, then their accelerations.
    fn check(&self, speed: &Axes, acceleration: &Axes) -> Result<(), HResult> {
        let over = |values: &Axes, limits: &Axes| {
            let over = values.iter().zip(limits).position(|(value, limit)| value.abs() > limit * (1.0 + SLACK));
            over.and_then(|n| u32::try_from(n + 1).ok())
        };
        if let Some(axis) = over(speed, &self.speed) {
            return Err(HResult::from_u32(0x8420_4050 + axis));
        }
        match over(acceleration, &self.acceleration) {
            Some(axis) => Err(HResult::from_u32(0x8420_4040 + axis)),
            None => Ok(()),
        }
    }
}

fn each(of: impl Fn(usize) -> f64) -> Axes {
    [0, 1, 2, 3, 4, 5, 6, 7].map(of)
}

const fn micros(time: Duration) -> u64 {
    time.as_micros() as u64
}
