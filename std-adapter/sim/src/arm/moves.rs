//! What moves the robot: which pose, by which path, and what a motion needs (the tables are in [`arm`](super)).

use bcap_core::bcap::server::Request;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use crate::controller::{Controller, Wait};
use crate::dispatch::{Answer, Answered, with_value};
use crate::drive::Drive;
use crate::kinematics::{Axes, OutOfReach, figure, forward, out_of_range, six, with_joints};
use crate::motion::Path;
use crate::options::options;
use crate::pose::Pose;
use crate::robot::{Percent, percent};

/// How a motion is to run.
struct MoveOptions {
    internal: Percent,
    /// Answer at once.
    next: bool,
}

impl Controller {
    pub(super) fn robot_move(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let option = request.text(3).to_string();
        let interpolation = request.int(1);
        if ![1, 2].contains(&interpolation) {
            return Err(if [3, 4].contains(&interpolation) { HResult::E_NOTIMPL } else { HResult::E_INVALIDARG });
        }
        let (pose, drive) = Pose::parse_target(&request.value(2), &self.variables)?;
        if let Some(drive) = &drive {
            drive.check(self.config().extended_axes)?;
        }
        let extended = |here: &Axes| drive.as_ref().map_or(*here, |drive| drive.apply(here));
        if interpolation == 1 {
            return self.move_axes(peer, &option, |here| Ok(with_joints(&pose.joints(&six(here))?, &extended(here))));
        }
        let options = self.move_options(&option, self.robot.hand)?;
        self.may_move(peer)?;
        let here = self.axes();
        let path = line(here, &pose, &extended(&here))?.map_err(|e| self.fail_reach(e))?;
        self.start_motion(peer, path, options)
    }

    pub(super) fn robot_drive(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let drive = Drive::relative(request.int(1), request.float(2))?;
        self.drive(peer, &drive, &request.text(3).to_string())
    }

    /// Executes DriveEx or DriveAEx, whose parameter is `[pairs, option]` or the pairs as text.
    pub(super) fn drive_command(&mut self, peer: PeerId, absolute: bool, param: &Variant<'_>) -> Answered {
        let param = param.flatten();
        let (pairs, option) = match param {
            Variant::Array(array) => match array.get(1).map(|item| item.flatten()) {
                Some(Variant::Bstr(option)) if array.len() == 2 => (array.get(0).unwrap_or(param), option.to_string()),
                _ => (param, String::new()),
            },
            _ => (param, String::new()),
        };
        let drive = Drive::parse(absolute, &pairs)?;
        self.drive(peer, &drive, &option).map(with_value)
    }

    /// Turns single axes.
    fn drive(&mut self, peer: PeerId, drive: &Drive, option: &str) -> Answered {
        drive.check(self.config().extended_axes)?;
        self.move_axes(peer, option, |here| Ok(drive.apply(here)))
    }

    /// Moves the axes to where `target` says, seen from where they are.
    pub(super) fn move_axes(
        &mut self,
        peer: PeerId,
        option: &str,
        target: impl FnOnce(&Axes) -> Result<Axes, OutOfReach>,
    ) -> Answered {
        let options = self.move_options(option, self.robot.joint)?;
        self.may_move(peer)?;
        let here = self.axes();
        let reached = target(&here).and_then(in_range);
        let there = reached.map_err(|e| self.fail_reach(e))?;
        self.start_motion(peer, Path::axes(here, there), options)
    }

    /// Starts a motion and, without NEXT, waits for its end.
    fn start_motion(&mut self, peer: PeerId, path: Path, options: MoveOptions) -> Answered {
        let id = self.robot.start(peer, path, options.internal, self.now);
        if !options.next {
            self.waits.insert(peer, Wait::Motion(id));
        }
        // one without length has ended already
        self.advance(self.now);
        if options.next { Ok(Answer::Done) } else { self.resume(peer) }
    }

    /// Checks everything that a motion needs, in the order that the codes are documented in.
    pub(crate) fn may_move(&mut self, peer: PeerId) -> Result<(), HResult> {
        self.may_execute(peer)?;
        if self.arm_owner() != Some(peer) {
            return Err(self.refuse(HResult::E_ARM_NOT_TAKEN));
        }
        if !self.motor_is_on() {
            return Err(self.refuse(HResult::E_MOTOR_OFF));
        }
        if self.is_moving() || self.robot.slave.is_some() {
            return Err(HResult::E_ROBOTISBUSY);
        }
        Ok(())
    }

    fn move_options(&self, text: &str, internal: Percent) -> Result<MoveOptions, HResult> {
        let mut read = MoveOptions { internal, next: false };
        for (key, value) in options(text) {
            let scaled = |base: f32| -> Result<f32, HResult> {
                let value = self.variables.number_of_text(value.ok_or(HResult::E_INVALIDARG)?)?;
                Ok(base * percent(value)? / 100.0)
            };
            match key.to_ascii_uppercase().as_str() {
                "NEXT" if value.is_none() => read.next = true,
                "SPEED" | "S" => read.internal.speed = scaled(internal.speed)?,
                "ACCEL" => read.internal.accel = scaled(internal.accel)?,
                "DECEL" => read.internal.decel = scaled(internal.decel)?,
                _ => return Err(HResult::E_INVALIDARG),
            }
        }
        Ok(read)
    }

    /// Makes an error of a pose that cannot be reached.
    pub(crate) fn fail_reach(&mut self, error: OutOfReach) -> HResult {
        let code = out_of_reach(error);
        self.raise(code);
        code
    }
}

fn in_range(axes: Axes) -> Result<Axes, OutOfReach> {
    out_of_range(&axes).map_or(Ok(axes), |axis| Err(OutOfReach(axis)))
}

/// Plans a line, which cannot change the posture on its way; J7 and J8 move to those of `extended`.
fn line(here: Axes, pose: &Pose, extended: &Axes) -> Result<Result<Path, OutOfReach>, HResult> {
    let (frame, fig) = match pose {
        Pose::Joints(joints) => (forward(joints), None),
        Pose::Frame(frame, fig) => (*frame, *fig),
    };
    let end = with_joints(&six(&here), extended);
    let path = in_range(end).and_then(|end| Path::line(here, &forward(&six(&here)), &frame, &end));
    // shoulder, elbow and wrist; how often J4 and J6 have turned is left to the line
    const POSTURE: u8 = 7;
    match (&path, fig) {
        (Ok(path), Some(fig)) if (figure(&six(&path.end())) ^ fig) & POSTURE != 0 => Err(HResult::E_INVALIDARG),
        _ => Ok(path),
    }
}

/// Returns the controller's code for an axis that would have to leave its range.
pub(super) fn out_of_reach(OutOfReach(axis): OutOfReach) -> HResult {
    HResult::from_u32(0x8320_4070 + u32::from(axis))
}
