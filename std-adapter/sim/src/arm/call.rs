//! The functions of the robot object.

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use super::poses::{self, FrameKind};
use super::robot_execute::{COMMANDS, RobotHandler};
use super::{Arm, moves};
use crate::answer::{Answer, Answered};
use crate::codes::CHANGE_IN_MOTION;
use crate::command_name::command_of;
use crate::context::Context;
use crate::drive::Drive;
use crate::objects::DefinitionKind;
use crate::robot::{Percent, percent, tool, work};
use crate::rules;
use crate::table::Command;
use crate::value::{ValueResult, owned};
use crate::waits::Wait;

/// The interpolation of Robot_Move along the points of a path.
const PATH: i32 = 4;

impl Arm {
    /// Executes a function of the robot that concerns the arm.
    pub(crate) fn call(&mut self, ctx: &mut Context<'_>, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::ROBOT_EXECUTE => {
                let name = command_of(request).unwrap_or_default();
                let handler = Command::handler(COMMANDS, &name, ctx.config.model.functions)?;
                self.run(handler, ctx, request)
            }
            FunctionId::ROBOT_MOVE if request.int(1) == PATH => {
                let option = request.text(3).to_string();
                moves::follow(&mut self.robot, &self.paths, ctx, &request.value(2), &option)
            }
            FunctionId::ROBOT_MOVE => {
                let option = request.text(3).to_string();
                moves::move_to(&mut self.robot, ctx, request.int(1), &request.value(2), &option)
            }
            FunctionId::ROBOT_DRIVE => {
                let drive = Drive::relative(request.int(1), request.float(2))?;
                moves::drive(&mut self.robot, ctx, drive, &request.text(3).to_string())
            }
            FunctionId::ROBOT_ROTATE => moves::rotate(&mut self.robot, ctx, request),
            FunctionId::ROBOT_GO_HOME => moves::go_home(&mut self.robot, ctx),
            FunctionId::ROBOT_HALT => Ok(match self.halt(ctx.config, ctx.now, ctx.waits) {
                // answered at rest, so that a motion that follows is not refused
                true => Answer::Until(Wait::Rest),
                false => Answer::Code(HResult::S_FALSE),
            }),
            FunctionId::ROBOT_HOLD => Ok(Answer::done_if(self.robot.hold(ctx.now))),
            FunctionId::ROBOT_UNHOLD => {
                ctx.may(&rules::UNHOLD)?;
                Ok(Answer::done_if(self.robot.unhold(ctx.now)))
            }
            FunctionId::ROBOT_SPEED => self.set_speed(ctx, request.int(1), request.float(2)),
            FunctionId::ROBOT_ACCELERATE => {
                self.set_acceleration(ctx, request.int(1), request.float(2), request.float(3))
            }
            FunctionId::ROBOT_CHUCK | FunctionId::ROBOT_UNCHUCK if !request.text(1).to_string().trim().is_empty() => {
                Err(HResult::E_INVALIDARG)
            }
            FunctionId::ROBOT_CHUCK => self.hand.close(ctx),
            FunctionId::ROBOT_UNCHUCK => self.hand.open(ctx),
            FunctionId::ROBOT_CHANGE => self.change(ctx, &request.text(1).to_string()),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    /// Returns the numbers of a definition.
    pub(crate) fn numbers(&self, kind: DefinitionKind, number: i32) -> ValueResult {
        match kind {
            DefinitionKind::Tool => poses::numbers_of(self, FrameKind::Tool, number),
            DefinitionKind::Work => poses::numbers_of(self, FrameKind::Work, number),
            DefinitionKind::Area => owned(self.areas.get(number)?),
        }
    }

    /// Writes the numbers of a definition.
    pub(crate) fn put_numbers(
        &mut self,
        ctx: &mut Context<'_>,
        kind: DefinitionKind,
        number: i32,
        given: &[f64],
    ) -> Answered {
        match kind {
            DefinitionKind::Tool => poses::put_numbers(self, ctx, FrameKind::Tool, number, given),
            DefinitionKind::Work => poses::put_numbers(self, ctx, FrameKind::Work, number, given),
            DefinitionKind::Area => {
                self.robot.may(ctx, &rules::SETTING)?;
                self.areas.set(number, given).map(|()| Answer::Done)
            }
        }
    }

    /// Starts a motion of a task, which takes the arm if it is free.
    pub(crate) fn move_for_task(
        &mut self,
        ctx: &mut Context<'_>,
        interpolation: i32,
        pose: &Variant<'_>,
        option: &str,
    ) -> Answered {
        if self.robot.owner().is_none() {
            self.robot.set_owner(Some((ctx.peer, 0)));
        }
        moves::move_to(&mut self.robot, ctx, interpolation, pose, option)
    }

    /// Makes the answer of a call that has waited successfully.
    pub(crate) fn resumed(&mut self, ctx: &mut Context<'_>, request: &Request<'_>) -> Answered {
        let name = command_of(request).unwrap_or_default();
        match Command::find(COMMANDS, &name).and_then(Command::resumed) {
            Some(handler) => self.run(handler, ctx, request),
            None => Ok(Answer::Done),
        }
    }

    fn run(&mut self, handler: RobotHandler, ctx: &mut Context<'_>, request: &Request<'_>) -> Answered {
        match handler {
            RobotHandler::Read(reading) => reading(self, ctx).map(Answer::Value),
            RobotHandler::Execute(execute) => execute(self, ctx, &request.value(2)),
        }
    }

    fn set_speed(&mut self, ctx: &mut Context<'_>, axis: i32, speed: f64) -> Answered {
        let speed = percent(speed)?;
        self.robot.may(ctx, &rules::SETTING)?;
        let settings = self.robot.settings_mut();
        match axis {
            -1 => settings.line.speed = speed,
            0 => {}
            _ => return Err(HResult::E_INVALIDARG),
        }
        settings.joint.speed = speed;
        Ok(Answer::Done)
    }

    fn set_acceleration(&mut self, ctx: &mut Context<'_>, axis: i32, accel: f64, decel: f64) -> Answered {
        // -1 keeps the value
        let chosen = |value: f64| if value == -1.0 { Ok(None) } else { percent(value).map(Some) };
        let (accel, decel) = (chosen(accel)?, chosen(decel)?);
        self.robot.may(ctx, &rules::SETTING)?;
        let settings = self.robot.settings_mut();
        let set = |of: &mut Percent| (of.accel, of.decel) = (accel.unwrap_or(of.accel), decel.unwrap_or(of.decel));
        match axis {
            -1 => set(&mut settings.line),
            0 => {}
            _ => return Err(HResult::E_INVALIDARG),
        }
        set(&mut settings.joint);
        Ok(Answer::Done)
    }

    /// Executes Robot_Change, which selects a tool or work coordinates while the arm is at rest.
    fn change(&mut self, ctx: &mut Context<'_>, name: &str) -> Answered {
        self.robot.may(ctx, &rules::SETTING)?;
        if self.robot.is_moving() {
            return Err(CHANGE_IN_MOTION);
        }
        let upper = name.trim().to_ascii_uppercase();
        let number = |digits: &str| match digits {
            "" => Ok(0),
            digits => digits.parse().map_err(|_| HResult::E_INVALIDARG),
        };
        let settings = self.robot.settings_mut();
        if let Some(digits) = upper.strip_prefix("TOOL") {
            settings.tool = number(digits).and_then(tool)?;
        } else if let Some(digits) = upper.strip_prefix("WORK") {
            settings.work = number(digits).and_then(work)?;
        } else {
            return Err(HResult::E_INVALIDARG);
        }
        Ok(Answer::Done)
    }
}
