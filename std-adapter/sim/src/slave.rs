//! Slave mode: a pose each 8 ms, straight into the controller.
//!
//! ```text
//!   off ── slvChangeMode n ──► on: a cycle each 8 ms takes a pose from the buffer, the axes move to it evenly and are
//!    ▲                         │   there when the next cycle begins
//!    ├── slvChangeMode 0 ──────┤   the buffer is emptied, the axes stand, then the answer
//!    └── any error, Halt, the ─┘   at once; what is in the buffer is dropped
//!        client goes, motor off,
//!        not Auto any more
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
//! An axis stands below 0.01 degrees per second; while all do, an empty buffer is no error in any mode. A pose that
//! needs an axis n to exceed its limit is the error 0x8420405n (speed) or 0x8420404n (acceleration) of the cycle that
//! takes it, speeds first; that includes the first pose, seen from where the robot stands, and a sudden stop: holding
//! in mode 1, or leaving before the poses have slowed down. A pose out of reach is the error 0x8320407n at once.
//!
//! # Who may
//!
//! Entering needs, in this order: a mode of the table (`E_INVALIDARG`), the licence (`E_NO_LICENSE`), no slave mode
//! (`E_SLVMODE_ON`), and what every motion needs (see [`arm`](crate::arm)). slvMove while slave mode is off answers
//! `E_SLVMODE_OFF`, from another client `E_ARM_NOT_TAKEN`; it needs Auto mode and the executable token each time.
//!
//! The client in slave mode may call slvMove, slvGetMode, slvChangeMode 0, StoState, ManualReset, CurJnt, Robot_Halt
//! and what opens, names and releases objects; everything else answers it `E_SLVMODE_ON`, also the values of variables.
//! Other clients go on as ever; for what moves the robot they have not the arm.
//!
//! # Decisions, where the manuals are silent
//!
//! * Formats are kept for each client until it goes. Before they are set: no IO, and the answer in joints, as in the
//!   guide's example. A format that the controller has not (see [`SlaveFormats`]) is refused with `E_INVALIDARG`.
//! * Cycles count from entering slave mode; the answer's pose is where the axes are when the answer is made.
//! * IO are written when the pose is stored. MiniIO's bit n is IO n (written: 16 to 31), HandIO's bit n is IO 48 + n
//!   (written: 64 to 71, read: these and 48 to 55).
//! * A parameter that does not fit the formats is refused (`E_INVALIDARGTYPE`, `E_INVALIDARG`, `DISP_E_BADINDEX`) and
//!   changes nothing: refused calls are no errors of the controller, and release nothing.
//! * Poses are 7, 8 or 10 numbers, with an option element behind them that is 0 or `0x00400000 |` bits of joints; the
//!   bits of axes 7 and 8 (0x40, 0x80) make them move, in P and T to the numbers behind the option. Without its bit an
//!   axis stays. An axis that the arm has not ([`Config::extended_axes`](crate::Config::extended_axes)) is refused.
//! * While the last poses are worked off on leaving, an empty buffer is no underflow: the axes stop at the last pose.
//! * Halt brakes all axes together, at their limit of acceleration; errors stop them at once, as they stop any motion.
//! * Currents are percent: what an axis accelerates of its limit, and a tenth of what it moves of its limit.

mod format;
mod stream;

use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

use crate::controller::{Controller, Wait};
use crate::dispatch::{Answer, Answered};
use crate::kinematics::{AXIS_SPEEDS, Axes, OutOfReach, out_of_range, six};
use crate::motion::ACCELERATION_TIME;
use crate::pose::Pose;
use crate::robot::Percent;
use crate::value::{Value, one_int};
use format::{Order, State};
use stream::Offered;

pub(crate) use format::Formats;
pub use format::SlaveFormats;
pub(crate) use stream::{SlaveMode, Stream};

/// The time of a control cycle.
pub const CYCLE: Duration = Duration::from_millis(8);

/// The option element of a pose, without the bits of its joints.
const OPTION: i64 = 0x0040_0000;

/// What limits speed and acceleration in slave mode: the controller's parameter 153, "Speed setting for b-CAP Slave".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpeedSetting {
    /// What the drives can do: 1.2 times the command limit of speed, and 4 times that of acceleration.
    #[default]
    Servo = 0,
    /// The same by the external speed, and the external acceleration.
    ServoByExtSpeed = 1,
    /// What a motion command may do: [`SPEEDS`](crate::kinematics::SPEEDS), reached in [`ACCELERATION_TIME`].
    Command = 2,
    /// The same by the external speed, and the external acceleration.
    CommandByExtSpeed = 3,
}

/// How slave mode is set up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlaveConfig {
    /// Whether the controller has the licence.
    pub licensed: bool,
    /// Parameter 153.
    pub speed_setting: SpeedSetting,
    /// Limits of speed for J1 to J8 in degrees or mm per second, instead of those that `speed_setting` gives an axis.
    /// The external speed scales them too, where the setting says so.
    pub speed_limits: [Option<f64>; 8],
    /// Likewise of acceleration, in degrees or mm per second squared.
    pub acceleration_limits: [Option<f64>; 8],
    /// The formats that there are.
    pub formats: SlaveFormats,
    /// How many cycles [`Controller::slave_record`] keeps.
    pub record: usize,
}

impl Default for SlaveConfig {
    /// Licensed, with the drives' limits, all formats, and a record of two minutes.
    fn default() -> Self {
        Self {
            licensed: true,
            speed_setting: SpeedSetting::default(),
            speed_limits: [None; 8],
            acceleration_limits: [None; 8],
            formats: SlaveFormats::ALL,
            record: 15_000,
        }
    }
}

/// The limits of slave mode for J1 to J8.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// In degrees per second.
    pub speed: [f64; 8],
    /// In degrees per second squared.
    pub acceleration: [f64; 8],
}

/// What slave mode has done since the controller was switched on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlaveCounters {
    /// Cycles.
    pub cycles: u64,
    /// Cycles that took a pose.
    pub taken: u64,
    /// Cycles without one, in which the axes held their position.
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

/// A cycle of slave mode that took a pose, or in which the axes moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlaveCycle {
    /// Its number, from 1, since slave mode was entered.
    pub cycle: u64,
    /// When it began.
    pub at: Instant,
    /// Where the axes J1 to J8 are at its end.
    pub axes: [f64; 8],
    /// Whether it took a pose; otherwise the axes hold theirs.
    pub took: bool,
}

impl Controller {
    /// Returns slvGetMode's number; 0 while slave mode is off.
    #[must_use]
    pub fn slave_mode(&self) -> i32 {
        self.robot.slave.as_ref().map_or(0, |stream| stream.mode.number())
    }

    /// Returns the limits that slave mode has, or would have if it were entered now.
    #[must_use]
    pub fn slave_limits(&self) -> Limits {
        let slave = &self.config().slave;
        let (mut speed, mut acceleration) = match slave.speed_setting {
            SpeedSetting::Servo | SpeedSetting::ServoByExtSpeed => {
                (AXIS_SPEEDS.map(|limit| limit * 1.2), AXIS_SPEEDS.map(|limit| limit / ACCELERATION_TIME * 4.0))
            }
            SpeedSetting::Command | SpeedSetting::CommandByExtSpeed => {
                (AXIS_SPEEDS, AXIS_SPEEDS.map(|limit| limit / ACCELERATION_TIME))
            }
        };
        for (limits, own) in [(&mut speed, slave.speed_limits), (&mut acceleration, slave.acceleration_limits)] {
            limits.iter_mut().zip(own).for_each(|(limit, own)| *limit = own.unwrap_or(*limit));
        }
        if matches!(slave.speed_setting, SpeedSetting::ServoByExtSpeed | SpeedSetting::CommandByExtSpeed) {
            let Percent { speed: by_speed, accel, .. } = self.robot.external;
            speed = speed.map(|limit| limit * f64::from(by_speed) / 100.0);
            acceleration = acceleration.map(|limit| limit * f64::from(accel) / 100.0);
        }
        Limits { speed, acceleration }
    }

    /// Returns what slave mode has done.
    #[must_use]
    pub const fn slave_counters(&self) -> SlaveCounters {
        self.slave_counters
    }

    /// Iterates over the cycles in which something happened, oldest first, as far back as the record goes.
    pub fn slave_record(&self) -> impl Iterator<Item = SlaveCycle> {
        self.slave_record.iter().copied()
    }

    pub(crate) fn slave_send_format(&mut self, peer: PeerId, param: &Variant<'_>) -> Answered {
        let there = self.config().slave.formats;
        self.slave_formats.entry(peer).or_default().set_send(param, there)?;
        Ok(Value::Empty.into())
    }

    pub(crate) fn slave_receive_format(&mut self, peer: PeerId, param: &Variant<'_>) -> Answered {
        let there = self.config().slave.formats;
        self.slave_formats.entry(peer).or_default().set_receive(param, there)?;
        Ok(Value::Empty.into())
    }

    pub(crate) fn slave_change_mode(&mut self, peer: PeerId, param: &Variant<'_>) -> Answered {
        let number = one_int(param)?;
        if number == 0 {
            return self.leave_slave_mode(peer);
        }
        let mode = SlaveMode::from_number(number).ok_or(HResult::E_INVALIDARG)?;
        if !self.config().slave.licensed {
            return Err(HResult::E_NO_LICENSE);
        }
        if self.robot.slave.is_some() {
            return Err(self.refuse(HResult::E_SLVMODE_ON));
        }
        self.may_move(peer)?;
        self.robot.slave = Some(Stream::new(peer, mode, self.slave_limits(), self.axes(), self.now));
        Ok(Value::Empty.into())
    }

    /// Leaves slave mode when what is buffered has been done.
    fn leave_slave_mode(&mut self, peer: PeerId) -> Answered {
        let Some(stream) = &mut self.robot.slave else { return Ok(Value::Empty.into()) };
        if stream.peer != peer {
            return Err(self.refuse(HResult::E_ARM_NOT_TAKEN));
        }
        stream.leaving = true;
        self.waits.insert(peer, Wait::Left);
        if stream.has_left() {
            self.end_slave_mode(HResult::S_OK);
        }
        self.resume_execute(peer)
    }

    pub(crate) fn slave_move(&mut self, peer: PeerId, param: &Variant<'_>) -> Answered {
        let (owner, refuses) = match &self.robot.slave {
            Some(stream) if !stream.leaving => (stream.peer, stream.refuses()),
            _ => return Err(self.refuse(HResult::E_SLVMODE_OFF)),
        };
        if owner != peer {
            return Err(self.refuse(HResult::E_ARM_NOT_TAKEN));
        }
        self.may_command(peer)?;
        let order = self.order(peer, param)?;
        if refuses {
            // the ordinary course of mode 0, so it is not noted in the log
            self.slave_counters.refused += 1;
            return Err(HResult::E_BUF_FULL);
        }
        let axes = self.slave_target(&order.pose)?.map_err(|error| self.fail_reach(error))?;
        let Some(stream) = &mut self.robot.slave else { return Err(HResult::E_SLVMODE_OFF) };
        match stream.offer(axes, &mut self.slave_counters) {
            Offered::Withheld => {
                self.waits.insert(peer, Wait::Stored);
                self.resume(peer)
            }
            stored => {
                order.write(&mut self.variables);
                let value = self.slave_answer(peer, &order);
                let code = if stored == Offered::Full { HResult::S_BUF_FULL } else { HResult::S_OK };
                Ok(Answer::Coded(code, value))
            }
        }
    }

    /// Goes on with a slvMove whose answer was withheld.
    pub(crate) fn resume_slave_move(&mut self, peer: PeerId, param: &Variant<'_>) -> Answered {
        match self.resume(peer)? {
            Answer::Done => {
                let order = self.order(peer, param)?;
                order.write(&mut self.variables);
                Ok(self.slave_answer(peer, &order).into())
            }
            answer => Ok(answer),
        }
    }

    fn order(&self, peer: PeerId, param: &Variant<'_>) -> Result<Order, HResult> {
        let order = self.formats(peer).read(&param.flatten())?;
        order.check(&self.variables)?;
        Ok(order)
    }

    fn formats(&self, peer: PeerId) -> Formats {
        self.slave_formats.get(&peer).copied().unwrap_or_default()
    }

    fn slave_answer(&self, peer: PeerId, order: &Order) -> Value {
        let current = self.robot.slave.as_ref().map_or([0.0; 8], Stream::current);
        let state = State { micros: self.now.as_micros(), axes: self.axes(), current };
        self.formats(peer).answer(&state, order, &self.variables)
    }

    /// Finds the axes of a pose of slvMove.
    fn slave_target(&self, numbers: &[f64]) -> Result<Result<Axes, OutOfReach>, HResult> {
        let Some(stream) = &self.robot.slave else { return Err(HResult::E_SLVMODE_OFF) };
        let kind = stream.mode.kind;
        let (numbers, option) = numbers.split_at_checked(count(kind)).ok_or(HResult::E_INVALIDARG)?;
        let bits = joints_of_option(option.first().copied())?;
        let near = stream.destination();
        let mut axes = near;
        // in a J the values have their places, behind other poses they follow the option
        let mut values = if kind == Kind::J { &[] } else { option.get(1..).unwrap_or_default() }.iter();
        if kind == Kind::J && option.len() > 1 {
            return Err(HResult::E_INVALIDARG);
        }
        for axis in [6, 7] {
            if bits & 1 << axis != 0 {
                let value = if kind == Kind::J { numbers.get(axis) } else { values.next() };
                axes[axis] = value.copied().filter(|v| v.is_finite()).ok_or(HResult::E_INVALIDARG)?;
                if axis - 6 >= usize::from(self.config().extended_axes) {
                    return Err(HResult::E_INVALIDARG);
                }
            }
        }
        if values.next().is_some() {
            return Err(HResult::E_INVALIDARG);
        }
        let numbers = if kind == Kind::J { &numbers[..6] } else { numbers };
        let pose = Pose::new(kind, numbers)?;
        Ok(pose.joints(&six(&near)).and_then(|joints| {
            axes[..6].copy_from_slice(&joints);
            out_of_range(&axes).map_or(Ok(axes), |axis| Err(OutOfReach(axis)))
        }))
    }

    /// Lets the cycles of slave mode pass that begin by `until`.
    pub(crate) fn pass_slave_cycles(&mut self, until: Instant) {
        while let Some(stream) = &mut self.robot.slave {
            let most = self.scenario.quiet_cycles(stream.cycle);
            stream.skip_idle(until, most, &mut self.slave_counters);
            if !stream.is_due(until) {
                break;
            }
            self.now = self.now.max(stream.next_cycle());
            self.slave_cycle();
        }
    }

    fn slave_cycle(&mut self) {
        let Some(stream) = &mut self.robot.slave else { return };
        for effect in self.scenario.at_cycle(stream.cycle + 1) {
            self.happen(effect);
        }
        let Some(stream) = &mut self.robot.slave else { return };
        let ticked = match stream.tick(&mut self.slave_counters) {
            Ok(ticked) => ticked,
            Err(code) => return self.raise(code),
        };
        if ticked.took || stream.is_moving() {
            let cycle = SlaveCycle { cycle: stream.cycle, at: self.now, axes: stream.commanded(), took: ticked.took };
            self.slave_record.push_back(cycle);
            while self.slave_record.len() > self.config().slave.record {
                self.slave_record.pop_front();
            }
        }
        let has_left = self.robot.slave.as_ref().is_some_and(Stream::has_left);
        if ticked.stored {
            self.end_waits(|wait| wait == Wait::Stored, HResult::S_OK);
        }
        if has_left {
            self.end_slave_mode(HResult::S_OK);
        }
    }

    /// Ends slave mode where the axes are; who waits for it gets `code`.
    pub(crate) fn end_slave_mode(&mut self, code: HResult) -> Option<Stream> {
        let stream = self.robot.stop_slave(self.now)?;
        self.end_waits(|wait| matches!(wait, Wait::Stored | Wait::Left), code);
        Some(stream)
    }

    /// Ends slave mode, and brakes.
    pub(crate) fn halt_slave_mode(&mut self) -> bool {
        let Some(stream) = self.end_slave_mode(HResult::E_ABORT) else { return false };
        self.robot.brake(stream.peer, &stream.speed(), &self.slave_limits().acceleration, self.now);
        true
    }

    /// Forgets the pose whose answer nobody waits for any more.
    pub(crate) fn abandon_slave_move(&mut self, peer: PeerId) {
        if let Some(stream) = self.robot.slave.as_mut().filter(|stream| stream.peer == peer) {
            stream.forget_withheld();
        }
    }

    /// Checks what the client in slave mode may call.
    pub(crate) fn slave_mode_allows(&mut self, peer: PeerId, request: &Request<'_>) -> Result<(), HResult> {
        if self.robot.slave.as_ref().is_none_or(|stream| stream.peer != peer) || request.resumed {
            return Ok(());
        }
        let command = request.text(1).to_string();
        let one_of = |names: &[&str]| names.iter().any(|name| name.eq_ignore_ascii_case(command.trim()));
        let allowed = match request.function {
            FunctionId::ROBOT_EXECUTE => one_of(&["slvMove", "slvGetMode", "slvChangeMode", "CurJnt"]),
            FunctionId::CONTROLLER_EXECUTE => one_of(&["StoState", "ManualReset"]),
            FunctionId::ROBOT_HALT => true,
            function => function.opens().is_some(),
        };
        if allowed { Ok(()) } else { Err(self.refuse(HResult::E_SLVMODE_ON)) }
    }
}

/// Returns how many numbers a pose has.
fn count(kind: Kind) -> usize {
    match kind {
        Kind::P => 7,
        Kind::J => 8,
        _ => 10,
    }
}

/// Reads the option element of a pose: the bits of its joints.
fn joints_of_option(option: Option<f64>) -> Result<i64, HResult> {
    let Some(option) = option.filter(|option| *option != 0.0) else { return Ok(0) };
    let bits = option as i64 ^ OPTION;
    if option.fract() == 0.0 && (0..0x100).contains(&bits) { Ok(bits) } else { Err(HResult::E_INVALIDARG) }
}
