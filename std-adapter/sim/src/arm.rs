//! The functions of the robot: Robot_Execute, and what moves it.
//!
//! | function                     | what it does here                                                                |
//! |------------------------------|----------------------------------------------------------------------------------|
//! | Robot_Move                   | interpolation 1 (joints) and 2 (line); 3, 4 (arc, free curve) answer `E_NOTIMPL` |
//! | Robot_Drive                  | turns one axis by degrees or mm                                                  |
//! | Robot_GoHome                 | moves the joints to [`Config::home`](crate::Config::home)                        |
//! | Robot_Halt                   | brakes, and answers when the arm is at rest; any client may; see below           |
//! | Robot_Hold                   | brakes until Unhold; any client may; `S_FALSE` when nothing runs                 |
//! | Robot_Unhold                 | goes on; any client with the token may, in Auto mode and without an error        |
//! | Robot_Speed                  | axis -1 sets the internal speed of lines and joints, 0 that of joints only       |
//! | Robot_Accelerate             | likewise the internal acceleration and deceleration                              |
//! | Robot_Change                 | `ToolN` and `WorkN` select a number; the definitions are all zero                |
//! | Robot_Chuck, Unchuck         | closes and opens the [`hand`]                                                    |
//! | Robot_Rotate                 | `E_NOTIMPL`                                                                      |
//!
//! Speeds and accelerations are percent, 0.0001 to 100, and count from the next motion on. Internal speeds, tool and
//! work coordinates are the arm's: while one client has it, Speed, Accelerate, Change and the variables of these answer
//! another one `E_ARM_NOT_TAKEN`. The external speed is anybody's.
//!
//! # Motions
//!
//! A command that cannot be understood is refused first. Then, what moves the robot needs, in this order: Auto mode
//! (`E_ACCESSDENIED`; no code of the controller's own is publicly known), the executable token
//! (`E_TOKEN_NOT_ETHERNET`, `E_TOKEN_ADDRESS`), no error (`E_ERROR_PRESENT`), the arm authority of this client
//! (`E_ARM_NOT_TAKEN`), the motor on (`E_MOTOR_OFF`), and the robot not moving (`E_ROBOTISBUSY`). Refusals with a code
//! of the controller are in the error log, but are no errors that must be cleared.
//!
//! The call answers when the motion has ended: with `S_OK`, with `E_ABORT` after Halt or the end of Auto mode, with
//! the error's code after an error. With the option `NEXT` it answers at once. Further options are `SPEED=` (or `S=`),
//! `ACCEL=` and `DECEL=`, in percent of the internal values, each a number or a variable (`SPEED=F2`); another option
//! is refused with `E_INVALIDARG`. A pose that axis n would have to leave its range for is the controller's error
//! 0x8320407n, as is a line through a singularity.
//!
//! Halt answers when the arm is at rest, so a motion that follows is not refused; at rest already, it answers
//! `S_FALSE`. The halted call ends with `E_ABORT`.
//!
//! # Commands of Robot_Execute
//!
//! | command                         | parameter                   | answer                                           |
//! |---------------------------------|-----------------------------|--------------------------------------------------|
//! | TakeArm                         | \[group, keep\] or nothing  | EMPTY; `E_ARM_NOT_TAKEN` while another has it    |
//! | GiveArm                         | -                           | EMPTY; `S_FALSE` without it                      |
//! | TakeArmState                    | group or -1                 | I4: the group this client holds, -1 for none     |
//! | Motor                           | \[state, no wait\] or state | EMPTY when the motor is on; at once with no wait |
//! | ExtSpeed                        | \[speed, accel, decel\]     | EMPTY; accel, decel default to speed² / 100      |
//! | DriveEx, DriveAEx               | \[pairs, option\] or pairs  | EMPTY; turns axes by, or to, a value             |
//! | CurPos, DestPos, HighCurPos     | -                           | R8\[7\]: X Y Z RX RY RZ Fig                      |
//! | CurJnt, DestJnt, HighCurJnt     | -                           | R8\[8\]: J1 to J8; an axis it has not is 0       |
//! | CurTrn, DestTrn, HighCurTrn     | -                           | R8\[10\]: position, orient, approach, Fig        |
//! | CurPosEx, HighCurPosEx, ...     | -                           | the same behind the time in ms                   |
//! | CurSpd, CurAcc, CurDec          | -                           | R4: internal, of lines                           |
//! | CurJSpd, CurJAcc, CurJDec       | -                           | R4: internal, of joints                          |
//! | CurExtSpd, CurExtAcc, CurExtDec | -                           | R4: external                                     |
//! | CurFig, CurTool, CurWork        | -                           | I4                                               |
//! | GetRobotTypeName, RobInfo       | -; I4: 1                    | BSTR: the robot's type; other numbers `E_NOTIMPL` |
//! | J2P J2T P2J P2T T2J T2P         | a pose                      | R8 array                                         |
//! | slvMove, slvChangeMode, ...     | see [`slave`](crate::slave) |                                                  |
//! | MotionPreparation, ...          | see [`preparation`](crate::preparation), COBOTTA |                             |
//!
//! A motion while another one runs is refused with `E_ROBOTISBUSY`. The client that started the running motion with
//! `NEXT` is not refused: its next motion begins, and its reply comes, after that motion; Halt and errors end both. Public
//! sample programs send motions like that. There is no other queue, and nothing for a pass motion to blend with.
//!
//! TakeArm while an error is present answers `E_ERROR_PRESENT`. GiveArm while the robot moves answers `E_ROBOTISBUSY`.
//! Commands that real controllers have and this one has not answer `E_NOTIMPL`, other names `E_INVALID_CMD_NAME`.

mod moves;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::Variant;

use crate::controller::{Controller, Wait};
use crate::dispatch::{Answer, Answered, names, system_names, with_value};
use crate::hand;
use crate::kinematics::{figure, six, with_joints};
use crate::pose::Pose;
use crate::robot::{Percent, Servo, angle, percent, pose_numbers, position, trans};
use crate::system::{Owner, coordinates};
use crate::value::{Value, numbers, one_int, whole};
use moves::out_of_reach;

/// Commands of real controllers that this one has not.
const NOT_HERE: &[&str] = &[
    "GetSrvData",
    "OutRange",
    "Dev",
    "DevH",
    "Approach",
    "Depart",
    "ConvertPosWork",
    "GetToolDef",
    "SetToolDef",
    "GetWorkDef",
    "SetWorkDef",
    "PayLoad",
    "SpeedMode",
    "MotionSkip",
    "MotionComplete",
    "GetAreaDef",
    "GetAreaEnabled",
    "SetAreaEnabled",
    "CheckVirtualFence",
    "ForceSensor",
    "ForceValue",
    "ForceCtrl",
    "ForceParam",
    "StartLog",
    "StopLog",
    "ClearLog",
    "GetLogCount",
    "GetLogRecord",
    "SyncTimeStart",
    "SyncTimeEnd",
    "SyncMoveStart",
    "SyncMoveEnd",
    "RotateH",
];

impl Controller {
    pub(crate) fn robot_call(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let turn = request.resumed && self.waits.get(&peer) == Some(&Wait::Turn);
        if turn && self.robot.motion().is_some() {
            return self.resume(peer);
        }
        let answered = if turn {
            self.waits.remove(&peer);
            self.robot_function(peer, &Request { resumed: false, ..*request })
        } else {
            self.robot_function(peer, request)
        };
        match answered {
            Err(HResult::E_ROBOTISBUSY) if is_motion(request) && self.moves_next(peer) => {
                self.waits.insert(peer, Wait::Turn);
                self.resume(peer)
            }
            answered => answered,
        }
    }

    /// Tells whether a motion runs whose end its client, this one, did not wait for.
    fn moves_next(&self, peer: PeerId) -> bool {
        self.robot.motion().is_some_and(|motion| motion.peer == peer && !motion.is_halting())
    }

    /// Calls a function of the robot; a motion of a client whose own motion still runs is `E_ROBOTISBUSY`.
    fn robot_function(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::ROBOT_EXECUTE
                if request.resumed && request.text(1).to_string().trim().eq_ignore_ascii_case("slvMove") =>
            {
                self.resume_slave_move(peer, &request.value(2))
            }
            FunctionId::ROBOT_EXECUTE if request.resumed => self.resume_execute(peer),
            _ if request.resumed => self.resume(peer),
            FunctionId::ROBOT_GET_VARIABLE => self.open_variable(peer, Owner::Robot, &request.text(1).to_string()),
            FunctionId::ROBOT_GET_VARIABLE_NAMES => Ok(names(system_names(Owner::Robot))),
            FunctionId::ROBOT_EXECUTE => {
                self.robot_execute(peer, request.text(1).to_string().trim(), &request.value(2))
            }
            FunctionId::ROBOT_MOVE => self.robot_move(peer, request),
            FunctionId::ROBOT_DRIVE => self.robot_drive(peer, request),
            FunctionId::ROBOT_GO_HOME => {
                let home = self.config().home;
                self.move_axes(peer, "", |here| Ok(with_joints(&home, here)))
            }
            FunctionId::ROBOT_HALT => self.robot_halt(peer),
            FunctionId::ROBOT_HOLD => {
                let now = self.now;
                Ok(done_if(self.robot.motion_mut().is_some_and(|m| m.hold(now))))
            }
            FunctionId::ROBOT_UNHOLD => {
                self.may_execute(peer)?;
                let now = self.now;
                Ok(done_if(self.robot.motion_mut().is_some_and(|m| m.unhold(now))))
            }
            FunctionId::ROBOT_SPEED => self.set_speed(peer, request.int(1), request.float(2)),
            FunctionId::ROBOT_ACCELERATE => {
                self.set_acceleration(peer, request.int(1), request.float(2), request.float(3))
            }
            FunctionId::ROBOT_CHUCK | FunctionId::ROBOT_UNCHUCK if !request.text(1).to_string().trim().is_empty() => {
                Err(HResult::E_INVALIDARG)
            }
            FunctionId::ROBOT_CHUCK => self.move_hand(peer, 0.0, 100.0).map(without_value),
            FunctionId::ROBOT_UNCHUCK => self.move_hand(peer, hand::STROKE, 100.0).map(without_value),
            FunctionId::ROBOT_CHANGE => self.change(peer, &request.text(1).to_string()),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    /// Brakes, and answers when the arm is at rest: a motion that follows at once is not refused.
    fn robot_halt(&mut self, peer: PeerId) -> Answered {
        if !self.halt() {
            return Ok(Answer::Code(HResult::S_FALSE));
        }
        self.waits.insert(peer, Wait::Rest);
        self.advance(self.now);
        self.resume(peer)
    }

    fn robot_execute(&mut self, peer: PeerId, command: &str, param: &Variant<'_>) -> Answered {
        if let Some(value) = self.read_out(command) {
            return Ok(value.into());
        }
        if let Some((from, to)) = conversion(command) {
            return Ok(Value::R8s(self.convert(from, to, param)?).into());
        }
        if let Some(answered) = self.preparation_command(peer, command) {
            return answered;
        }
        match command.to_ascii_lowercase().as_str() {
            "robinfo" => match one_int(param)? {
                1 => Ok(Value::from(self.config().robot_type.as_str()).into()),
                _ => Err(HResult::E_NOTIMPL),
            },
            "takearm" => self.take_arm(peer, param),
            "givearm" => self.give_arm(peer),
            "takearmstate" => {
                let wanted = if param.is_empty() { -1 } else { one_int(param)? };
                let held = self.robot.arm.filter(|(owner, group)| *owner == peer && [-1, *group].contains(&wanted));
                Ok(Value::I4(held.map_or(-1, |(_, group)| group)).into())
            }
            "motor" => self.motor_command(peer, param),
            "driveex" => self.drive_command(peer, false, param),
            "driveaex" => self.drive_command(peer, true, param),
            "extspeed" => self.set_external_speed(param),
            "slvchangemode" => self.slave_change_mode(peer, param),
            "slvgetmode" => Ok(Value::I4(self.slave_mode()).into()),
            "slvmove" => self.slave_move(peer, param),
            "slvsendformat" => self.slave_send_format(peer, param),
            "slvrecvformat" => self.slave_receive_format(peer, param),
            _ if NOT_HERE.iter().any(|name| name.eq_ignore_ascii_case(command)) => Err(HResult::E_NOTIMPL),
            _ => Err(HResult::E_INVALID_CMD_NAME),
        }
    }

    /// Answers the commands that only tell something.
    fn read_out(&self, command: &str) -> Option<Value> {
        let robot = &self.robot;
        let command = command.to_ascii_lowercase();
        let (here, there) = (self.joints(), robot.destination());
        let timed = |rest: Vec<f64>| {
            let millis = self.now.as_micros() as f64 / 1000.0;
            Value::R8s([vec![millis], rest].concat())
        };
        Some(match command.as_str() {
            "curpos" | "highcurpos" => Value::R8s(position(&here)),
            "curjnt" | "highcurjnt" => Value::R8s(self.axes().to_vec()),
            "curtrn" | "highcurtrn" => Value::R8s(trans(&here)),
            "curposex" | "highcurposex" => timed(position(&here)),
            "curjntex" | "highcurjntex" => timed(self.axes().to_vec()),
            "curtrnex" | "highcurtrnex" => timed(trans(&here)),
            "destpos" => Value::R8s(position(&six(&there))),
            "destjnt" => Value::R8s(there.to_vec()),
            "desttrn" => Value::R8s(trans(&six(&there))),
            "curspd" => Value::R4(robot.hand.speed),
            "curacc" => Value::R4(robot.hand.accel),
            "curdec" => Value::R4(robot.hand.decel),
            "curjspd" => Value::R4(robot.joint.speed),
            "curjacc" => Value::R4(robot.joint.accel),
            "curjdec" => Value::R4(robot.joint.decel),
            "curextspd" => Value::R4(robot.external.speed),
            "curextacc" => Value::R4(robot.external.accel),
            "curextdec" => Value::R4(robot.external.decel),
            "curfig" => Value::I4(figure(&here).into()),
            "getrobottypename" => Value::from(self.config().robot_type.as_str()),
            "curtool" => Value::I4(robot.tool),
            "curwork" => Value::I4(robot.work),
            _ => return None,
        })
    }

    /// Converts a pose from one kind to another, near to where the robot is.
    fn convert(&self, from: Kind, to: Kind, param: &Variant<'_>) -> Result<Vec<f64>, HResult> {
        let near = self.joints();
        let pose = Pose::parse_as(from, param, &self.variables)?;
        let joints = pose.joints(&near).map_err(out_of_reach)?;
        Ok(match (to, pose) {
            (Kind::P, Pose::Frame(frame, _)) => pose_numbers(&frame, figure(&joints)),
            (Kind::P, Pose::Joints(_)) => position(&joints),
            (Kind::T, _) => trans(&joints),
            _ => angle(&joints),
        })
    }

    fn take_arm(&mut self, peer: PeerId, param: &Variant<'_>) -> Answered {
        let (group, keep) = match numbers(param)?.as_slice() {
            [] => (0, 0),
            [group] => (whole(*group)?, 0),
            [group, keep] => (whole(*group)?, whole(*keep)?),
            _ => return Err(HResult::E_INVALIDARG),
        };
        // there is one arm, and group 0 is the arm; -1 is TRUE
        if group != 0 || ![-1, 0, 1].contains(&keep) {
            return Err(HResult::E_INVALIDARG);
        }
        self.may_execute(peer)?;
        if self.arm_owner().is_some_and(|owner| owner != peer) {
            return Err(self.refuse(HResult::E_ARM_NOT_TAKEN));
        }
        self.robot.arm = Some((peer, group));
        if keep == 0 {
            self.robot.hand = Percent::FULL;
            self.robot.joint = Percent::FULL;
            self.robot.tool = 0;
            self.robot.work = 0;
        }
        Ok(Value::Empty.into())
    }

    fn give_arm(&mut self, peer: PeerId) -> Answered {
        if self.arm_owner() != Some(peer) {
            return Ok(Answer::Code(HResult::S_FALSE));
        }
        if self.is_moving() {
            return Err(HResult::E_ROBOTISBUSY);
        }
        self.robot.arm = None;
        Ok(Value::Empty.into())
    }

    pub(crate) fn motor_command(&mut self, peer: PeerId, param: &Variant<'_>) -> Answered {
        let (state, no_wait) = match numbers(param)?.as_slice() {
            [state] => (whole(*state)?, 0),
            [state, no_wait] => (whole(*state)?, whole(*no_wait)?),
            _ => return Err(HResult::E_INVALIDARG),
        };
        self.switch_motor(peer, state != 0, no_wait == 0).map(with_value)
    }

    /// Switches the motor. With `wait`, the answer comes when it is on.
    pub(crate) fn switch_motor(&mut self, peer: PeerId, on: bool, wait: bool) -> Answered {
        self.motor(peer, on)?;
        if !on || !wait || self.motor_is_on() {
            return Ok(Answer::Done);
        }
        self.waits.insert(peer, Wait::Servo);
        self.resume(peer)
    }

    /// Begins to switch the motor; on, it is on some time later.
    fn motor(&mut self, peer: PeerId, on: bool) -> Result<(), HResult> {
        self.may_command(peer)?;
        if !on {
            self.motor_off(HResult::E_MOTOR_OFF);
            return Ok(());
        }
        self.may_execute(peer)?;
        if self.emergency_stopped() {
            return Err(HResult::E_ACCESSDENIED);
        }
        if !self.preparation.motion {
            return Err(self.refuse(HResult::E_MOTION_UNPREPARED));
        }
        if self.torque_off {
            return Err(HResult::E_ACCESSDENIED);
        }
        self.turn_motor_on();
        self.advance(self.now);
        Ok(())
    }

    /// Begins to switch the motor on, unless the emergency stop or the lack of torque keeps it off.
    pub(crate) fn turn_motor_on(&mut self) {
        let ready = self.preparation.motion && !self.torque_off;
        let prevented = self.emergency_stopped() || !ready || self.errors.code().is_err();
        if self.robot.servo == Servo::Off && !prevented {
            self.robot.servo = Servo::TurningOn(self.now.saturating_add(self.config().motor_on_delay));
        }
    }

    fn set_external_speed(&mut self, param: &Variant<'_>) -> Answered {
        let given = numbers(param)?;
        let [speed, rest @ ..] = given.as_slice() else { return Err(HResult::E_INVALIDARG) };
        let mut external = Percent::of_speed(percent(*speed)?);
        match rest {
            [] => {}
            [accel] => external.accel = percent(*accel)?,
            [accel, decel] => (external.accel, external.decel) = (percent(*accel)?, percent(*decel)?),
            _ => return Err(HResult::E_INVALIDARG),
        }
        self.robot.external = external;
        Ok(Value::Empty.into())
    }

    fn set_speed(&mut self, peer: PeerId, axis: i32, speed: f64) -> Answered {
        let speed = percent(speed)?;
        self.may_set_arm(peer)?;
        match axis {
            -1 => self.robot.hand.speed = speed,
            0 => {}
            _ => return Err(HResult::E_INVALIDARG),
        }
        self.robot.joint.speed = speed;
        Ok(Answer::Done)
    }

    fn set_acceleration(&mut self, peer: PeerId, axis: i32, accel: f64, decel: f64) -> Answered {
        let (accel, decel) = (percent(accel)?, percent(decel)?);
        self.may_set_arm(peer)?;
        let set = |of: &mut Percent| (of.accel, of.decel) = (accel, decel);
        match axis {
            -1 => set(&mut self.robot.hand),
            0 => {}
            _ => return Err(HResult::E_INVALIDARG),
        }
        set(&mut self.robot.joint);
        Ok(Answer::Done)
    }

    fn change(&mut self, peer: PeerId, name: &str) -> Answered {
        self.may_set_arm(peer)?;
        let upper = name.trim().to_ascii_uppercase();
        let number = |digits: &str| digits.parse().map_err(|_| HResult::E_INVALIDARG).and_then(coordinates);
        if let Some(digits) = upper.strip_prefix("TOOL") {
            self.robot.tool = number(digits)?;
        } else if let Some(digits) = upper.strip_prefix("WORK") {
            self.robot.work = number(digits)?;
        } else {
            return Err(HResult::E_INVALIDARG);
        }
        Ok(Answer::Done)
    }

    /// Checks that no other client has the arm, whose speeds, tool and work coordinates these are.
    pub(crate) fn may_set_arm(&mut self, peer: PeerId) -> Result<(), HResult> {
        match self.arm_owner() {
            Some(owner) if owner != peer => Err(self.refuse(HResult::E_ARM_NOT_TAKEN)),
            _ => Ok(()),
        }
    }
}

/// Tells whether a call moves the arm along a path.
fn is_motion(request: &Request<'_>) -> bool {
    match request.function {
        FunctionId::ROBOT_MOVE | FunctionId::ROBOT_DRIVE | FunctionId::ROBOT_GO_HOME => true,
        FunctionId::ROBOT_EXECUTE => {
            let command = request.text(1).to_string();
            ["DriveEx", "DriveAEx"].iter().any(|name| name.eq_ignore_ascii_case(command.trim()))
        }
        _ => false,
    }
}

/// Finds what a command such as `J2P` converts.
fn conversion(command: &str) -> Option<(Kind, Kind)> {
    let kind = |letter: &str| [Kind::P, Kind::J, Kind::T].into_iter().find(|k| k.name().eq_ignore_ascii_case(letter));
    let (from, to) = command.split_once('2')?;
    let (from, to) = (kind(from)?, kind(to)?);
    (from != to).then_some((from, to))
}

/// Drops the empty value that commands answer and functions do not.
fn without_value(answer: Answer) -> Answer {
    match answer {
        Answer::Value(_) => Answer::Done,
        answer => answer,
    }
}

fn done_if(done: bool) -> Answer {
    if done { Answer::Done } else { Answer::Code(HResult::S_FALSE) }
}
