//! Slave Mode: a pose every 8 ms, straight into the controller.
//!
//! ```text
//!   off -- slvChangeMode n --> on: a cycle every 8 ms takes a pose from the buffer; the axes move to it evenly and
//!    ^                         |   arrive when the next cycle begins
//!    +-- slvChangeMode 0 ------+   the buffer is emptied, the axes come to rest, then the call is answered
//!    +-- an error, Halt, ------+   immediately; buffered poses are dropped
//!        the client disconnects,
//!        motor off, mode not Auto
//! ```
//!
//! | command       | parameter                           | answer          |
//! |---------------|-------------------------------------|-----------------|
//! | slvSendFormat | 0, 0x20, 0x100, 0x120, 0x200, 0x220 | EMPTY           |
//! | slvRecvFormat | format, or \[format, unit\]         | EMPTY           |
//! | slvChangeMode | 0x001-3, 0x101-3, 0x201-3; 0        | EMPTY           |
//! | slvGetMode    | -                                   | I4, 0 while off |
//! | slvMove       | by the formats                      | by the formats  |
//!
//! | mode | buffer    | slvMove answers                                                   | underflow in motion |
//! |------|-----------|-------------------------------------------------------------------|---------------------|
//! | 0    | 3         | `S_OK`; `S_BUF_FULL` with the third; `E_BUF_FULL` when not stored | 0x84201482          |
//! | 1    | 1, newest | `S_OK`                                                            | holds the position  |
//! | 2    | 3         | `S_OK`, as soon as it is stored                                   | 0x84201482          |
//!
//! An axis is at rest below 0.01 degrees per second; while all axes are at rest, an empty buffer is not an error in any mode. A
//! pose for which axis n would exceed its limit is the error 0x8420405n (speed) or 0x8420404n (acceleration) of the cycle that
//! takes it; speeds are checked first. The check includes the first pose, relative to the robot's position, and a sudden stop:
//! holding in mode 1, or leaving before the poses have slowed down. A pose out of reach is the error 0x83201501 or 0x8320407n
//! immediately.
//!
//! # Required state
//!
//! Entering needs, in this order: a mode of the table (`E_INVALIDARG`), the licence (`E_NO_LICENSE`), Slave Mode off
//! (`E_SLVMODE_ON`), and the requirements of every motion (see [`arm`](crate::arm)). While Slave Mode is off, slvMove
//! answers `E_SLVMODE_OFF`; from another client it answers `E_ARM_NOT_TAKEN`. Each slvMove needs Auto mode and the
//! executable token.
//!
//! The properties of a call ([`FunctionId::properties`](bcap_core::bcap::FunctionId::properties)) say whether Slave Mode allows
//! it, from any client. Another call answers `E_SLVMODE_ON`, which is an error of the controller and ends Slave Mode. The next
//! slvMove answers `E_SLVMODE_OFF`, which is an error too. Real controllers were seen to behave like this.
//!
//! # Decisions of this model, where the manuals are silent
//!
//! * Formats belong to a client until it disconnects. By default there is no IO and the answer is in joints, as in the guide's
//!   example. A format that the controller does not have (see [`SlaveFormats`]) is refused with `E_INVALIDARG`.
//! * Cycles count from entering Slave Mode. The answer's pose is the position of the axes when the answer is made.
//! * IO are written when the pose is stored. Bit n of MiniIO is IO n (written: 16 to 31). Bit n of HandIO is IO 48 + n
//!   (written: 64 to 71, read: these and 48 to 55).
//! * A parameter that does not fit the formats is refused (`E_INVALIDARGTYPE`, `E_INVALIDARG`, `DISP_E_BADINDEX`) and
//!   changes nothing: these codes are not errors of the controller, so Slave Mode stays on.
//! * Poses are 7, 8 or 10 numbers, followed by an option element that is 0 or `0x00400000 |` bits of joints. The bits
//!   of axes 7 and 8 (0x40, 0x80) make them move; in P and T, their values follow the option. Without its bit an
//!   axis keeps its position. An axis that the arm lacks ([`Config::extended_axes`](crate::Config::extended_axes)) is
//!   refused.
//! * While the client leaves and the last poses are executed, an empty buffer is not an underflow: the axes stop at the last
//!   pose.
//! * Halt brakes all axes together, at their limit of acceleration; errors stop them immediately, like any motion.
//! * Currents are percent: the acceleration of an axis relative to its limit, plus a tenth of its speed relative to its
//!   limit.

mod format;

use std::collections::{BTreeMap, VecDeque};

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

use crate::answer::{Answer, Answered};
use crate::config::Config;
use crate::context::Context;
use crate::coordinates::Coordinates;
use crate::kinematics::{Axes, OutOfReach, six};
use crate::pose::Pose;
use crate::robot::{Percent, Robot};
use crate::rules;
use crate::stream::{Offered, SlaveMode, Stream};
use crate::value::{ValueResult, one_int};
use crate::waits::{Wait, Waits};
use format::{Formats, RobotState, SlvMove};

pub use crate::config::{SlaveConfig, SpeedSetting};
pub use crate::model::SlaveFormats;
pub use crate::stream::{CYCLE, Limits, SlaveCounters, SlaveCycle};

/// The option element of a pose, without the bits of its joints.
const OPTION: i64 = 0x0040_0000;

/// The formats of the clients, and a record of past cycles. The stream itself belongs to the [`Robot`], which it moves.
#[derive(Clone, Debug, Default)]
pub(crate) struct Slave {
    formats: BTreeMap<PeerId, Formats>,
    counters: SlaveCounters,
    record: VecDeque<SlaveCycle>,
}

impl Slave {
    pub(crate) const fn counters(&self) -> SlaveCounters {
        self.counters
    }

    /// Iterates over the recorded cycles, the oldest first.
    pub(crate) fn record(&self) -> impl Iterator<Item = SlaveCycle> {
        self.record.iter().copied()
    }

    /// Drops the formats of a client.
    pub(crate) fn forget(&mut self, peer: PeerId) {
        self.formats.remove(&peer);
    }

    pub(crate) fn send_format(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        self.formats.entry(ctx.peer).or_default().set_send(param, ctx.config.slave.formats)?;
        Ok(Answer::Done)
    }

    pub(crate) fn receive_format(&mut self, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        self.formats.entry(ctx.peer).or_default().set_receive(param, ctx.config.slave.formats)?;
        Ok(Answer::Done)
    }

    pub(crate) fn do_move(&mut self, robot: &mut Robot, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        let (owner, refuses) = match robot.stream() {
            Some(stream) if !stream.leaving => (stream.peer, stream.refuses()),
            _ => return Err(HResult::E_SLVMODE_OFF),
        };
        if owner != ctx.peer {
            return Err(HResult::E_ARM_NOT_TAKEN);
        }
        ctx.may(&rules::SLAVE_MOVE)?;
        let order = self.order(ctx, param)?;
        if refuses {
            // normal in mode 0, so it is not an error of the controller
            self.counters.refused += 1;
            return Ok(Answer::Code(HResult::E_BUF_FULL));
        }
        let coordinates = robot.coordinates();
        let Some(stream) = robot.stream_mut() else { return Err(HResult::E_SLVMODE_OFF) };
        let axes = target(stream, &coordinates, ctx.config, &order.pose)?.map_err(OutOfReach::on_path)?;
        match stream.offer(axes, &mut self.counters) {
            Offered::Withheld => Ok(Answer::Until(Wait::Stored)),
            stored => {
                order.write(&ctx.config.model.slave_io, ctx.variables);
                let value = self.answer(robot, ctx, &order)?;
                let code = if stored == Offered::Full { HResult::S_BUF_FULL } else { HResult::S_OK };
                Ok(Answer::Coded(code, value))
            }
        }
    }

    /// Answers a slvMove whose pose was withheld and is now stored.
    pub(crate) fn stored(&self, robot: &Robot, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
        let order = self.order(ctx, param)?;
        order.write(&ctx.config.model.slave_io, ctx.variables);
        self.answer(robot, ctx, &order).map(Answer::Value)
    }

    fn order(&self, ctx: &Context<'_>, param: &Variant<'_>) -> Result<SlvMove, HResult> {
        let order = self.formats(ctx.peer).read(&param.flatten())?;
        order.check(&ctx.config.model.slave_io, ctx.variables)?;
        Ok(order)
    }

    fn formats(&self, peer: PeerId) -> Formats {
        self.formats.get(&peer).copied().unwrap_or_default()
    }

    fn answer(&self, robot: &Robot, ctx: &Context<'_>, order: &SlvMove) -> ValueResult {
        let current = robot.stream().map_or([0.0; 8], Stream::current);
        let state = RobotState {
            micros: ctx.now.as_micros(),
            axes: robot.axes(ctx.now),
            coordinates: robot.coordinates(),
            current,
        };
        self.formats(ctx.peer).answer(&state, order, &ctx.config.model.slave_io, ctx.variables)
    }

    /// Skips idle cycles, at most `most`. Returns the number and the time of the next cycle, if it begins by `until`.
    pub(crate) fn next_cycle(&mut self, robot: &mut Robot, until: Instant, most: u64) -> Option<(u64, Instant)> {
        let stream = robot.stream_mut()?;
        stream.skip_idle(until, most, &mut self.counters);
        stream.has_cycle_by(until).then(|| (stream.cycle + 1, stream.next_cycle()))
    }

    /// Executes a cycle.
    ///
    /// # Errors
    ///
    /// The error that ends Slave Mode.
    pub(crate) fn cycle(
        &mut self,
        robot: &mut Robot,
        config: &Config,
        now: Instant,
        waits: &mut Waits,
    ) -> Result<(), HResult> {
        let Some(stream) = robot.stream_mut() else { return Ok(()) };
        let ticked = stream.tick(&mut self.counters)?;
        if ticked.took || stream.is_moving() {
            self.record.push_back(SlaveCycle {
                cycle: stream.cycle,
                at: now,
                axes: stream.commanded(),
                took: ticked.took,
            });
            let excess = self.record.len().saturating_sub(config.slave.record);
            self.record.drain(..excess);
        }
        if ticked.stored {
            waits.end(Wait::Stored, HResult::S_OK);
        }
        if stream.has_left() {
            robot.leave(HResult::S_OK, now, waits);
        }
        Ok(())
    }
}

/// Returns the number of slvGetMode; 0 while Slave Mode is off.
pub(crate) fn mode(robot: &Robot) -> i32 {
    robot.stream().map_or(0, |stream| stream.mode.number())
}

/// Returns the limits of Slave Mode, if it is entered now.
pub(crate) fn limits(robot: &Robot, config: &Config) -> Limits {
    let (slave, speeds, accelerations) = (&config.slave, robot.geometry().speeds, robot.geometry().accelerations());
    let (mut speed, mut acceleration) = match slave.speed_setting {
        SpeedSetting::Servo | SpeedSetting::ServoByExtSpeed => {
            (speeds.map(|limit| limit * 1.2), accelerations.map(|limit| limit * 4.0))
        }
        SpeedSetting::Command | SpeedSetting::CommandByExtSpeed => (speeds, accelerations),
    };
    for (limits, own) in [(&mut speed, slave.speed_limits), (&mut acceleration, slave.acceleration_limits)] {
        limits.iter_mut().zip(own).for_each(|(limit, own)| *limit = own.unwrap_or(*limit));
    }
    if matches!(slave.speed_setting, SpeedSetting::ServoByExtSpeed | SpeedSetting::CommandByExtSpeed) {
        let Percent { speed: by_speed, accel, .. } = robot.settings().external;
        speed = speed.map(|limit| limit * f64::from(by_speed) / 100.0);
        acceleration = acceleration.map(|limit| limit * f64::from(accel) / 100.0);
    }
    Limits { speed, acceleration }
}

pub(crate) fn change_mode(robot: &mut Robot, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let number = one_int(param)?;
    if number == 0 {
        return leave(robot, ctx);
    }
    let mode = SlaveMode::from_number(number).ok_or(HResult::E_INVALIDARG)?;
    if !ctx.config.slave.licensed {
        return Err(HResult::E_NO_LICENSE);
    }
    if robot.stream().is_some() {
        return Err(HResult::E_SLVMODE_ON);
    }
    robot.may(ctx, &rules::ENTER_SLAVE_MODE)?;
    // seen on a COBOTTA: only group 0 streams
    if robot.group_of(ctx.peer) != Some(0) {
        return Err(HResult::E_ARM_NOT_TAKEN);
    }
    let limits = limits(robot, ctx.config);
    robot.enter(Stream::new(ctx.peer, mode, limits, robot.axes(ctx.now), ctx.now));
    Ok(Answer::Done)
}

/// Leaves Slave Mode when the buffered poses are done.
fn leave(robot: &mut Robot, ctx: &mut Context<'_>) -> Answered {
    let Some(stream) = robot.stream_mut() else { return Ok(Answer::Done) };
    if stream.peer != ctx.peer {
        return Err(HResult::E_ARM_NOT_TAKEN);
    }
    stream.leaving = true;
    if stream.has_left() {
        robot.leave(HResult::S_OK, ctx.now, ctx.waits);
        return Ok(Answer::Done);
    }
    Ok(Answer::Until(Wait::Left))
}

/// Ends Slave Mode and brakes; returns whether it was on.
pub(crate) fn halt(robot: &mut Robot, config: &Config, now: Instant, waits: &mut Waits) -> bool {
    let Some(stream) = robot.leave(HResult::E_ABORT, now, waits) else { return false };
    robot.brake(stream.peer, &stream.speed(), &limits(robot, config).acceleration, now);
    true
}

/// Drops the withheld pose of a client that abandoned its call.
pub(crate) fn abandon(robot: &mut Robot, peer: PeerId) {
    if let Some(stream) = robot.stream_mut().filter(|stream| stream.peer == peer) {
        stream.forget_withheld();
    }
}

/// Finds the axes of a pose of slvMove.
fn target(
    stream: &Stream,
    coordinates: &Coordinates,
    config: &Config,
    numbers: &[f64],
) -> Result<Result<Axes, OutOfReach>, HResult> {
    let kind = stream.mode.kind;
    let (numbers, option) = numbers.split_at_checked(count(kind)).ok_or(HResult::E_INVALIDARG)?;
    let bits = joints_of_option(option.first().copied())?;
    let near = stream.destination();
    let mut axes = near;
    // in a J the values of J7 and J8 have their own places; in other poses they follow the option
    let mut values = if kind == Kind::J { &[] } else { option.get(1..).unwrap_or_default() }.iter();
    if kind == Kind::J && option.len() > 1 {
        return Err(HResult::E_INVALIDARG);
    }
    for axis in [6, 7] {
        if bits & 1 << axis != 0 {
            let value = if kind == Kind::J { numbers.get(axis) } else { values.next() };
            axes[axis] = value.copied().filter(|v| v.is_finite()).ok_or(HResult::E_INVALIDARG)?;
            if axis - 6 >= usize::from(config.extended_axes) {
                return Err(HResult::E_INVALIDARG);
            }
        }
    }
    if values.next().is_some() {
        return Err(HResult::E_INVALIDARG);
    }
    let numbers = if kind == Kind::J { &numbers[..6] } else { numbers };
    let pose = coordinates.flange(Pose::new(kind, numbers)?);
    Ok(pose.joints(&coordinates.arm, &six(&near)).and_then(|joints| {
        axes[..6].copy_from_slice(&joints);
        coordinates.arm.out_of_range(&axes).map_or(Ok(axes), Err)
    }))
}

/// Returns the number of elements of a pose.
fn count(kind: Kind) -> usize {
    match kind {
        Kind::P => 7,
        Kind::J => 8,
        _ => 10,
    }
}

/// Reads the bits of the joints from the option element of a pose.
fn joints_of_option(option: Option<f64>) -> Result<i64, HResult> {
    let Some(option) = option.filter(|option| *option != 0.0) else { return Ok(0) };
    let bits = option as i64 ^ OPTION;
    if option.fract() == 0.0 && (0..0x100).contains(&bits) { Ok(bits) } else { Err(HResult::E_INVALIDARG) }
}
