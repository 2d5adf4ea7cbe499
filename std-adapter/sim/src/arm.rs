//! The functions of the robot: Robot_Execute and the motions.
//!
//! | function                     | effect in the virtual controller                                                 |
//! |------------------------------|----------------------------------------------------------------------------------|
//! | Robot_Move                   | interpolation 1 (joints), 2 (line), 3 (arc), 4 (a curve through the points of a path) |
//! | Robot_Drive                  | turns one axis by degrees or mm                                                  |
//! | Robot_GoHome                 | moves the joints to [`Config::home`](crate::Config::home)                        |
//! | Robot_Halt                   | brakes, and answers when the arm is at rest; of any client; see below            |
//! | Robot_Hold                   | brakes until Unhold; of any client; `S_FALSE` when nothing runs                  |
//! | Robot_Unhold                 | continues; needs Auto mode, the token and no error                               |
//! | Robot_Speed                  | axis -1 sets the internal speed of lines and joints, 0 of joints only            |
//! | Robot_Accelerate             | likewise the internal acceleration and deceleration                              |
//! | Robot_Change                 | `ToolN` and `WorkN` select a definition; all are zero until they are set         |
//! | Robot_Chuck, Unchuck         | closes and opens the [`hand`](crate::hand)                                       |
//! | Robot_Rotate                 | moves on a circle in a plane (XY, YZ, ZX, of the tool XYH, YZH, ZXH, or three V) about a point |
//!
//! Speeds and accelerations are percent, 0.0001 to 100, and apply from the next motion on. Internal speeds, tool and
//! work coordinates belong to the arm: while one client owns it, Speed, Accelerate, Change and the variables of these
//! answer another client `E_ARM_NOT_TAKEN`. Any client may set the external speed.
//!
//! # Motions
//!
//! A command that cannot be parsed is refused first. Then a motion needs, in this order: a released emergency stop
//! (0x8150101A), Auto mode (0x81501012), the executable token (`E_TOKEN_NOT_ETHERNET`, `E_TOKEN_ADDRESS`), no error
//! (`E_ERROR_PRESENT`, or 0x82501009 after one of level 5), the arm authority of this client (`E_ARM_NOT_TAKEN`), the motor on
//! (`E_MOTOR_OFF`), and no motion of another client, no full queue and no Slave Mode (`E_ROBOTISBUSY`). A refusal with a code
//! of the controller is an error, which must be cleared.
//!
//! The call answers when the motion has ended: with `S_OK`, or with `E_MOTION_STOPPED` after Halt, the end of Auto mode, the
//! emergency stop, switching the motor off, or, 20 ms later, an error. `E_MOTION_STOPPED` is an error of the client that moved
//! the robot, even after `NEXT` and after the end of its connection. After a pass the call answers when the motion begins to
//! brake. With the option `NEXT` it answers immediately. Further options are `SPEED=` (or `S=`), `ACCEL=` and `DECEL=`, in
//! percent of the internal values, each a number or a variable (`SPEED=F2`), and `TIME=`, which has no effect, because its unit
//! is not documented; any other option is refused. A wrong argument of a motion is the error
//! [`WRONG_ARGUMENT`](crate::codes::WRONG_ARGUMENT) of the controller. A motion that the arm cannot make is an error of the
//! controller; its [codes](crate::codes) say why.
//!
//! Approach ends before its pose, and Depart before the current pose, by the length in mm against the approach vector,
//! the z of the flange. In an arc the flange turns evenly from the start orientation to the end orientation; the
//! orientation of the point on the circle has no effect. Three points on one line are refused. Robot_Rotate
//! turns right-handed about an axis of the base, by at most 3600 degrees; with `Pose=1` the flange turns with it, with
//! `Pose=2`, the default, it keeps its orientation. RotateH turns the tool right-handed about its approach vector, in place.
//!
//! Halt answers when the arm is at rest, so that it does not refuse a motion that follows. If the arm is at rest
//! already, Halt answers `S_FALSE`. The halted motion leaves the error
//! `E_MOTION_STOPPED`. While a task owns the arm, Halt is refused (0x83500079).
//!
//! # Commands of Robot_Execute
//!
//! | command                         | parameter                   | answer                                           |
//! |---------------------------------|-----------------------------|--------------------------------------------------|
//! | TakeArm                         | \[group, keep\] or nothing  | EMPTY; `E_ARM_NOT_TAKEN` while another has it    |
//! | GiveArm                         | -                           | EMPTY, when the arm is at rest; `S_FALSE` without it |
//! | TakeArmState                    | group or -1                 | I4: 1 if this client owns it, 0 if not           |
//! | Motor                           | \[state, no wait\] or state | EMPTY when the motor is on; immediately with no wait |
//! | ExtSpeed                        | \[speed, accel, decel\]     | EMPTY; accel, decel: -1 keeps, -2 speed² / 100   |
//! | DriveEx, DriveAEx               | \[pairs, option\] or pairs  | EMPTY; turns axes by, or to, a value             |
//! | Approach                        | \[1 or 2, pose, length\]     | EMPTY; to a pose before this one                 |
//! | Depart                          | \[1 or 2, length\]          | EMPTY; away from the current pose                |
//! | RotateH                         | angle or \[angle, option\]   | EMPTY; turns the tool in place                   |
//! | Draw                            | \[1 or 2, vector\]          | EMPTY; by a vector in work coordinates           |
//! | ArchMove                        | \[pose, height, rise, fall\] | EMPTY; half a sine above the line, height in z of the work |
//! | Arrive                          | percent                     | EMPTY, when the motion has covered this part     |
//! | MotionSkip                      | \[group, mode\] or nothing  | EMPTY immediately; `S_FALSE` without a motion    |
//! | MotionComplete                  | \[group, mode\] or nothing  | BOOL: 0 commands complete, 1 robot at rest       |
//! | CurPos, DestPos, HighCurPos     | -                           | R8\[7\]: X Y Z RX RY RZ Fig                      |
//! | CurJnt, DestJnt, HighCurJnt     | -                           | R8\[8\]: J1 to J8; 0 for an axis that it lacks   |
//! | CurTrn, DestTrn, HighCurTrn     | -                           | R8\[10\]: position, orient, approach, Fig        |
//! | CurPosEx, CurJntEx, CurTrnEx    | -                           | the same after the time in ms                    |
//! | HighCurPosEx, HighCurJntEx, HighCurTrnEx | -                  | likewise                                         |
//! | DestPosEx, DestJntEx, DestTrnEx | -                           | likewise                                         |
//! | CurSpd, CurAcc, CurDec          | -                           | R4: internal, of lines                           |
//! | CurJSpd, CurJAcc, CurJDec       | -                           | R4: internal, of joints                          |
//! | CurExtSpd, CurExtAcc, CurExtDec | -                           | R4: external                                     |
//! | CurFig, CurTool, CurWork        | -                           | I4                                               |
//! | GetRobotTypeName                | -                           | BSTR: the robot's type                           |
//! | RobInfo                         | I4: 0, 1, 2                 | I4 0; BSTR: likewise; R8\[8\] 0                  |
//! | J2P J2T P2J P2T T2J T2P         | a pose                      | R8 array                                         |
//! | Dev, DevH                       | \[pose, offset\]            | R8\[7\]: offset in the base, in the flange       |
//! | OutRange                        | pose or \[pose, -1, -1\]    | I4: 0, bits of axes, -1 no reach, -2 singular    |
//! | TMul, TInv, TNorm               | \[T, T\], T                 | R8\[10\], with the Fig of the first              |
//! | MPS, RPM, DPS                   | mm/s, \[axis, rpm\], deg/s or \[axis, deg/s\] | R4: percent of the largest speed |
//! | GetToolDef                      | I4, 0 to 63                 | R8\[6\]: X Y Z RX RY RZ                          |
//! | GetWorkDef, GetBaseDef          | I4, 0 to 7                  | R8\[7\]: likewise, and the attribute             |
//! | SetToolDef                      | \[1 to 63, pose\]           | EMPTY; needs the arm authority                   |
//! | SetWorkDef, SetBaseDef          | \[1 to 7, pose, attribute\] | EMPTY; likewise. Bases have no effect            |
//! | WorkAttribute                   | I4, 0 to 7                  | I4: 0, or 1 for a fixed tool, without an effect  |
//! | SetHandIO, GetHandIO            | \[first, value, count\], \[first, count\] | EMPTY; I4: IO as the bits of a number |
//! | ClearLog                        | -                           | EMPTY; empties the control log and records       |
//! | StartLog, StopLog               | -                           | EMPTY; the log ends when it is full, or now; needs ClearLog |
//! | GetCtrlLogMaxTime, GetCtrlLogInterval | -                     | I4: 10 s, 8 ms                                   |
//! | SetCtrlLogMaxTime, SetCtrlLogInterval | 10 to 240 s, 8 to 32 ms | EMPTY                                          |
//! | GetLogCount                     | -                           | I4, at most 1,250 with a length of 10 s          |
//! | GetLogRecord                    | I4 index, 0 is the oldest   | an array of 39, see below                        |
//! | PayLoad                         | \[g, centre, inertia\]      | EMPTY; kept, without an effect on motions        |
//! | SpeedMode                       | I4, 0 to 3                  | EMPTY; kept, without an effect on motions        |
//! | ConvertPosWork                  | \[pose, from, to\]          | R8\[7\]: the pose in other work coordinates      |
//! | CheckVirtualFence               | a pose                      | I4: 0, because there are no fences               |
//! | GetSrvData                      | I4                          | R8\[8\]: see below                               |
//! | GetAllSrvData                   | -                           | array of 8 R4\[8\]: see below                    |
//! | GetSrvJntData                   | \[1, 2, 4, 5 or 8, axis\]   | R4: the same of one axis                         |
//! | slvMove, slvChangeMode, ...     | see [`slave`]               |                                                  |
//! | MotionPreparation, ...          | see [`preparation`](crate::preparation) |                                      |
//!
//! # Logs and servo data
//!
//! ```text
//! GetLogRecord  of J1 to J8: commanded position, position R8, current, load R8;
//!               user data, program number I4, file name BSTR, line I4, ms since the start of the controller I4,
//!               tool, work I4
//! GetSrvData    1 speed of each axis; 2 deviation, which is not 0 while the motor is on; 4 and 5 current and torque, 7 load of
//!               each axis; 8 position;
//!               17 speed of the tool centre point in x, y, z of the work coordinates, in mm per second; 18 the same with the
//!               angles; 19, 20 zero
//! ```
//!
//! The arm follows its commands exactly and has no mass: deviations, torques, currents and loads are 0. A record does not
//! fit a datagram: over UDP, GetLogRecord answers `E_TOO_MUCH_DATA`.
//!
//! # Queue and pass
//!
//! While a motion runs, further motions of its client join a queue of at most 16 motions, including the running one. A motion
//! is planned from the end of the queue, and refused immediately if that is impossible. A motion of another client, a 17th
//! motion and a motion while Halt brakes are refused with `E_ROBOTISBUSY`.
//!
//! `@0` and `@E` come to rest at the pose. With `@P` the next motion begins while this one brakes, and the path passes
//! the pose at a distance; with `@n` it begins at n mm from the pose, but not before the motion brakes. Without a next
//! motion, a pass motion also ends at its pose. While two motions move, no axis exceeds its speed or leaves its range.
//!
//! Halt, errors and the end of Auto mode empty the queue. Hold and Unhold keep it. MotionSkip brakes the running motion, whose
//! call answers `S_OK`; the queue continues from the place where the arm comes to rest.
//!
//! TakeArm answers `E_ERROR_PRESENT` while an error is present, 0x83500042 for a group other than the one that the client owns,
//! 0x83500003 for an undefined group, and 0x83503010 for a second number other than 0 or 1. GiveArm waits for the end of the
//! motions. The groups 0 to 31 of TakeArm differ in extended joints, which this model always moves. Commands of real
//! controllers that this model does not implement answer `E_NOTIMPL`, other names `E_INVALID_CMD_NAME`.

mod area_commands;
mod call;
mod measures;
mod moves;
mod path_point_commands;
mod poses;
mod readings;
pub(crate) mod robot_execute;
pub(crate) mod robot_variables;
mod settings;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::answer::{Answer, Answered};
use crate::areas::Areas;
use crate::codes::EMERGENCY_STOP;
use crate::config::Config;
use crate::context::Context;
use crate::hand::Hand;
use crate::kinematics::six;
use crate::levels::Effects;
use crate::model::Functions;
use crate::path_points::PathPoints;
use crate::preparation::Preparation;
use crate::robot::{Robot, Servo};
use crate::rules;
use crate::slave::{self, Limits, Slave};
use crate::trace::{Trace, TracePoint};
use crate::waits::{Wait, Waits};

/// The arm: the robot with its hand, its preparation and its Slave Mode.
#[derive(Clone, Debug)]
pub(crate) struct Arm {
    robot: Robot,
    hand: Hand,
    preparation: Preparation,
    slave: Slave,
    trace: Trace,
    areas: Areas,
    paths: PathPoints,
}

impl Arm {
    pub(crate) fn new(config: &Config) -> Self {
        Self {
            robot: Robot::new(config),
            hand: Hand::new(),
            preparation: Preparation::new(config.model.functions),
            slave: Slave::default(),
            trace: Trace::default(),
            areas: Areas::new(),
            paths: PathPoints::new(),
        }
    }

    pub(crate) fn robot(&self) -> &Robot {
        &self.robot
    }

    pub(crate) fn hand(&self) -> &Hand {
        &self.hand
    }

    pub(crate) fn hand_mut(&mut self) -> &mut Hand {
        &mut self.hand
    }

    pub(crate) fn preparation(&self) -> Preparation {
        self.preparation
    }

    pub(crate) fn preparation_mut(&mut self) -> &mut Preparation {
        &mut self.preparation
    }

    pub(crate) const fn slave(&self) -> &Slave {
        &self.slave
    }

    /// Returns the limits of Slave Mode, if it is entered now.
    pub(crate) fn slave_limits(&self, config: &Config) -> Limits {
        slave::limits(&self.robot, config)
    }

    /// Advances motor, motion and hand to `now`, and ends the calls that wait for them. Cycles of Slave Mode are
    /// executed by [`cycle`](Self::cycle).
    pub(crate) fn advance(&mut self, now: Instant, waits: &mut Waits) {
        self.robot.advance(now, waits);
        self.hand.advance(now, waits);
    }

    /// Returns the time of the next point of the trace, if it is not after `until`.
    pub(crate) fn next_point(&mut self, config: &Config, until: Instant) -> Option<Instant> {
        let rest = self.is_at_rest();
        self.trace.next(&config.recorder, until, rest)
    }

    /// Records a point of the trace, if its time has been reached.
    pub(crate) fn take_point(&mut self, config: &Config, at: Instant) {
        let point = self.point(at);
        let rest = self.is_at_rest();
        self.trace.take(&config.recorder, &point, rest);
    }

    /// Returns where the arm is.
    pub(crate) fn point(&self, at: Instant) -> TracePoint {
        let axes = self.robot.axes(at);
        let settings = self.robot.settings();
        let (tool, work) = (settings.tool, settings.work);
        let position = self.robot.coordinates().place(&six(&axes)).to_xyz_rpy();
        TracePoint { at, axes, position, tool, work }
    }

    /// Returns whether nothing moves the arm.
    fn is_at_rest(&self) -> bool {
        !self.robot.is_moving() && self.robot.stream().is_none()
    }

    /// Returns the number of the current cycle of Slave Mode.
    pub(crate) fn present_cycle(&self) -> Option<u64> {
        self.robot.stream().map(|stream| stream.cycle)
    }

    /// Skips idle cycles, at most `most`. Returns the number and the time of the next cycle, if it begins by `until`.
    pub(crate) fn next_cycle(&mut self, until: Instant, most: u64) -> Option<(u64, Instant)> {
        self.slave.next_cycle(&mut self.robot, until, most)
    }

    /// Executes a cycle of Slave Mode.
    ///
    /// # Errors
    ///
    /// The error that ends Slave Mode.
    pub(crate) fn cycle(&mut self, config: &Config, now: Instant, waits: &mut Waits) -> Result<(), HResult> {
        self.slave.cycle(&mut self.robot, config, now, waits)
    }

    /// Returns when to poll a call that waits for this event; `None` if the time is unknown.
    pub(crate) fn end_of(&self, wait: Wait, now: Instant) -> Option<Instant> {
        match wait {
            Wait::Motion(_) | Wait::Rest | Wait::Tasks => self.robot.motion_end(now),
            Wait::Part(id, part) => self.robot.end_of_part(id, f64::from(part) / 1e5, now),
            Wait::Servo => match self.robot.servo() {
                Servo::TurningOn(at) => Some(at),
                _ => None,
            },
            Wait::Hand => self.hand.end(now),
            Wait::Stored | Wait::Left => self.robot.stream().map(|stream| stream.next_cycle()),
            Wait::Stopped(at) => Some(at),
            Wait::Over(_) => Some(now),
        }
    }

    /// Returns how the event has ended that a command without a waiting call has started; `None` if it has not.
    pub(crate) fn outcome(&self, wait: Wait, now: Instant) -> Option<Result<(), HResult>> {
        match (wait, self.robot.servo()) {
            (Wait::Servo, Servo::On) => Some(Ok(())),
            (Wait::Servo, Servo::Off) => Some(Err(HResult::E_MOTOR_OFF)),
            (Wait::Hand, _) if self.hand.end(now).is_none() => Some(Ok(())),
            (Wait::Rest, _) if !self.robot.is_moving() => Some(Ok(())),
            _ => None,
        }
    }

    /// Switches the motor off or stops the hand, if a command has started it. A command that stops tasks has started nothing.
    pub(crate) fn cancel(&mut self, wait: Wait, now: Instant, waits: &mut Waits) {
        match wait {
            Wait::Servo => self.robot.turn_off(HResult::E_CANCEL, now, waits),
            Wait::Hand => drop(self.hand.stop(HResult::E_CANCEL, now, waits)),
            _ => {}
        }
    }

    /// Stops everything without braking because of an error, as far as its effects say.
    pub(crate) fn fail(&mut self, code: HResult, effects: Effects, now: Instant, waits: &mut Waits) {
        if effects.stops {
            self.robot.stop(code, now, waits);
            self.hand.stop(code, now, waits);
        }
        if effects.motor_off {
            self.robot.turn_off(code, now, waits);
        }
    }

    /// Stops everything without braking, and switches the motor off, because of the emergency stop.
    pub(crate) fn emergency_stop(&mut self, functions: Functions, now: Instant, waits: &mut Waits) {
        self.preparation.emergency_stop(functions);
        self.hand.stop(EMERGENCY_STOP, now, waits);
        self.robot.turn_off(EMERGENCY_STOP, now, waits);
    }

    /// Brakes the motion or Slave Mode; returns whether there was one.
    pub(crate) fn halt(&mut self, config: &Config, now: Instant, waits: &mut Waits) -> bool {
        slave::halt(&mut self.robot, config, now, waits) || self.robot.halt_motion(now, waits)
    }

    /// Drops the pose that a client waited to store. Its motion continues.
    pub(crate) fn abandon(&mut self, peer: PeerId) {
        slave::abandon(&mut self.robot, peer);
    }

    /// Halts a client's motion and frees the arm.
    pub(crate) fn forget(&mut self, peer: PeerId, config: &Config, now: Instant, waits: &mut Waits) {
        self.slave.forget(peer);
        self.hand.forget(peer, now, waits);
        if self.robot.mover() == Some(peer) {
            self.halt(config, now, waits);
        }
        if self.robot.owner() == Some(peer) {
            self.robot.set_owner(None);
        }
    }

    /// Gives the arm to a client, or frees it. A motion stops.
    pub(crate) fn give_to(&mut self, owner: Option<PeerId>, now: Instant, waits: &mut Waits) {
        self.robot.stop(HResult::E_ABORT, now, waits);
        self.robot.set_owner(owner.map(|peer| (peer, 0)));
    }

    /// Switches the motor on immediately, prepared or not.
    pub(crate) fn force_on(&mut self) {
        self.preparation.complete();
        self.robot.force_on();
    }

    /// Starts to switch the motor on, if its preparation is complete.
    pub(crate) fn turn_on(&mut self, at: Instant) {
        if self.preparation.is_motion_ready() && !self.preparation.is_torque_off() {
            self.robot.turn_on(at);
        }
    }

    /// Switches the motor off. Calls that wait for it end with `code`.
    pub(crate) fn turn_off(&mut self, code: HResult, now: Instant, waits: &mut Waits) {
        self.robot.turn_off(code, now, waits);
    }

    /// Switches the motor for a client. With `wait`, the call is answered when it is on.
    pub(crate) fn switch_motor(&mut self, ctx: &mut Context<'_>, on: bool, wait: bool) -> Answered {
        if !on {
            ctx.may(&rules::MOTOR_OFF)?;
            ctx.record("motor off");
            self.robot.turn_off(HResult::E_MOTOR_OFF, ctx.now, ctx.waits);
            return Ok(Answer::Done);
        }
        ctx.may(&rules::MOTOR_ON)?;
        if !self.preparation.is_motion_ready() {
            return Err(HResult::E_MOTION_UNPREPARED);
        }
        if self.preparation.is_torque_off() {
            return Err(HResult::E_ACCESSDENIED);
        }
        ctx.record("motor on");
        self.turn_on(ctx.now.saturating_add(ctx.config.motor_on_delay));
        self.robot.advance(ctx.now, ctx.waits);
        Ok(if wait && !self.robot.motor_is_on() { Answer::Until(Wait::Servo) } else { Answer::Done })
    }
}
