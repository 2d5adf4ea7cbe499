//! The buffer of Slave Mode and the cycle that empties it, without commands and formats.
//!
//! ```text
//!   slvMove --> waiting --> buffer: 3, or the newest 1 --> a cycle every 8 ms --> the axes move evenly
//!               (mode 2)                                   speed, acceleration    for one cycle
//! ```

use std::collections::VecDeque;
use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::time::Instant;

use crate::kinematics::Axes;

/// The time of a control cycle.
pub const CYCLE: Duration = Duration::from_millis(8);

/// Positions that modes 0 and 2 buffer.
const BUFFER: usize = 3;

/// An axis below this speed, in degrees per second, is at rest. It is less than the rounding of a pose to R4.
const REST: f64 = 0.01;

/// Relative tolerance of the speed and acceleration limits, for rounding.
const SLACK: f64 = 1e-6;

/// The limits of Slave Mode for J1 to J8.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// In degrees or mm per second.
    pub speed: [f64; 8],
    /// In degrees or mm per second squared.
    pub acceleration: [f64; 8],
}

/// The counters of Slave Mode since the controller was switched on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlaveCounters {
    /// Cycles.
    pub cycles: u64,
    /// Cycles that took a pose.
    pub taken: u64,
    /// Cycles without a pose, in which the axes held their position.
    pub held: u64,
    /// Underflows while the axes were moving.
    pub underflows: u64,
    /// Poses of mode 0 that were not stored: `E_BUF_FULL`.
    pub refused: u64,
    /// Poses of mode 1 that a newer one has replaced.
    pub overwritten: u64,
    /// Poses of mode 2 whose answer was withheld.
    pub withheld: u64,
}

/// A cycle of Slave Mode that took a pose, or in which the axes moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlaveCycle {
    /// Its number, from 1, since Slave Mode was entered.
    pub cycle: u64,
    /// When it began.
    pub at: Instant,
    /// The position of the axes J1 to J8 at its end.
    pub axes: [f64; 8],
    /// Whether it took a pose; otherwise the axes hold their position.
    pub took: bool,
}

/// How positions are buffered: the hundreds of the mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Buffering {
    /// Mode 0: a full buffer refuses the position.
    Refuse,
    /// Mode 1: a new position replaces one that no cycle has taken.
    Overwrite,
    /// Mode 2: the call waits until the buffer has room.
    Wait,
}

/// The mode that slvChangeMode selects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SlaveMode {
    pub(crate) buffering: Buffering,
    /// The kind of poses: P, J or T.
    pub(crate) kind: Kind,
}

impl SlaveMode {
    /// Reads the number of a mode other than 0.
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

/// The result of [`Stream::offer`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Offered {
    Stored,
    /// Stored; mode 0 has no room for another.
    Full,
    /// Kept until the buffer has room.
    Withheld,
}

/// The result of a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ticked {
    /// It took a position; otherwise the axes hold their position.
    pub(crate) took: bool,
    /// It moved the withheld position into the buffer.
    pub(crate) stored: bool,
}

/// Slave Mode while it is on.
#[derive(Clone, Debug)]
pub(crate) struct Stream {
    /// The client in Slave Mode.
    pub(crate) peer: PeerId,
    pub(crate) mode: SlaveMode,
    limits: Limits,
    buffer: VecDeque<Axes>,
    withheld: Option<Axes>,
    /// The client is leaving: Slave Mode ends when the buffer is empty and the axes are at rest.
    pub(crate) leaving: bool,
    /// The number of cycles since Slave Mode was entered.
    pub(crate) cycle: u64,
    /// The start time of the current cycle, and the position of the axes at its beginning and at its end.
    began: Instant,
    from: Axes,
    to: Axes,
    /// The speed in the current cycle, in degrees per second, and its change since the previous cycle, per second.
    speed: Axes,
    acceleration: Axes,
}

impl Stream {
    pub(crate) fn new(peer: PeerId, mode: SlaveMode, limits: Limits, here: Axes, now: Instant) -> Self {
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

    /// Returns the position of the axes.
    pub(crate) fn axes(&self, now: Instant) -> Axes {
        let passed = now.saturating_since(self.began).as_secs_f64() / CYCLE.as_secs_f64();
        let part = passed.min(1.0);
        each(|n| self.from[n] + (self.to[n] - self.from[n]) * part)
    }

    /// Returns the position of the axes at the end of the current cycle.
    pub(crate) fn commanded(&self) -> Axes {
        self.to
    }

    /// Returns the position of the axes after all buffered positions.
    pub(crate) fn destination(&self) -> Axes {
        self.withheld.or_else(|| self.buffer.back().copied()).unwrap_or(self.to)
    }

    /// Returns the speeds of the axes in this cycle, in degrees per second.
    pub(crate) fn speed(&self) -> Axes {
        self.speed
    }

    /// Returns the currents in percent: the part of the limit at which an axis accelerates, and for friction a tenth of
    /// the part at which it moves.
    pub(crate) fn current(&self) -> Axes {
        let part = |value: f64, limit: f64| if limit > 0.0 { value / limit * 100.0 } else { 0.0 };
        each(|n| {
            part(self.acceleration[n], self.limits.acceleration[n]) + part(self.speed[n], self.limits.speed[n]) / 10.0
        })
    }

    pub(crate) fn is_moving(&self) -> bool {
        self.speed.iter().any(|speed| speed.abs() > REST)
    }

    /// Returns whether the client has left: all poses are done and the axes are at rest.
    pub(crate) fn has_left(&self) -> bool {
        self.leaving && self.buffer.is_empty() && !self.is_moving()
    }

    /// Returns when the next cycle begins.
    pub(crate) fn next_cycle(&self) -> Instant {
        self.began.saturating_add(CYCLE)
    }

    /// Returns whether a cycle begins by this time.
    pub(crate) fn has_cycle_by(&self, now: Instant) -> bool {
        now.saturating_since(self.began) >= CYCLE
    }

    /// Returns whether [`offer`](Self::offer) would have no room for a position.
    pub(crate) fn refuses(&self) -> bool {
        self.mode.buffering == Buffering::Refuse && self.is_full()
    }

    fn is_full(&self) -> bool {
        self.buffer.len() >= BUFFER
    }

    /// Takes a position, unless the stream [refuses](Self::refuses) it.
    pub(crate) fn offer(&mut self, axes: Axes, counters: &mut SlaveCounters) -> Offered {
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

    /// Drops the withheld position, because its client abandoned the call.
    pub(crate) fn forget_withheld(&mut self) {
        self.withheld = None;
    }

    /// Begins the next cycle. An error ends Slave Mode; the axes stay where the last cycle ended.
    pub(crate) fn tick(&mut self, counters: &mut SlaveCounters) -> Result<Ticked, HResult> {
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

    /// Skips cycles in which nothing can happen: those that begin by `until`, at most `most` of them.
    pub(crate) fn skip_idle(&mut self, until: Instant, most: u64, counters: &mut SlaveCounters) {
        if !self.buffer.is_empty() || self.is_moving() || self.leaving {
            return;
        }
        let cycles = until.saturating_since(self.began).as_micros() / CYCLE.as_micros();
        let cycles = u64::try_from(cycles).unwrap_or(u64::MAX).min(most);
        if cycles > 0 {
            self.from = self.to;
            (self.speed, self.acceleration) = ([0.0; 8], [0.0; 8]);
            // the result is not after `until`
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
