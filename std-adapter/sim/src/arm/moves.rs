//! What moves the robot: which pose, by which path, and what a motion needs (the tables are in [`arm`](super)).

use bcap_core::bcap::server::Request;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;

use crate::controller::{Controller, Wait};
use crate::dispatch::{Answer, Answered};
use crate::kinematics::{Joints, OutOfReach, figure, forward};
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
        let pose = Pose::parse(&request.value(2), &self.variables)?;
        if interpolation == 1 {
            return self.move_joints(peer, &option, |near| pose.joints(near));
        }
        let options = self.move_options(&option, self.robot.hand)?;
        self.may_move(peer)?;
        let here = self.joints();
        let path = line(here, &pose)?.map_err(|e| self.fail_reach(e))?;
        self.start_motion(peer, path, options)
    }

    pub(super) fn robot_drive(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let axis = usize::try_from(request.int(1)).ok().filter(|n| (1..=6).contains(n)).ok_or(HResult::E_INVALIDARG)?;
        let turn = request.float(2);
        if !turn.is_finite() {
            return Err(HResult::E_INVALIDARG);
        }
        self.move_joints(peer, &request.text(3).to_string(), |near| {
            let mut joints = *near;
            joints[axis - 1] += turn;
            Pose::Joints(joints).joints(near)
        })
    }

    /// Moves the joints to where `target` says, seen from where they are.
    pub(super) fn move_joints(
        &mut self,
        peer: PeerId,
        option: &str,
        target: impl FnOnce(&Joints) -> Result<Joints, OutOfReach>,
    ) -> Answered {
        let options = self.move_options(option, self.robot.joint)?;
        self.may_move(peer)?;
        let here = self.joints();
        let there = target(&here).map_err(|e| self.fail_reach(e))?;
        self.start_motion(peer, Path::joints(here, there), options)
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
                let value = value.and_then(|v| v.parse().ok()).ok_or(HResult::E_INVALIDARG)?;
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

/// Plans a line, which cannot change the posture on its way.
fn line(here: Joints, pose: &Pose) -> Result<Result<Path, OutOfReach>, HResult> {
    let (frame, fig) = match pose {
        Pose::Joints(joints) => (forward(joints), None),
        Pose::Frame(frame, fig) => (*frame, *fig),
    };
    let path = Path::line(here, &forward(&here), &frame);
    // shoulder, elbow and wrist; how often J4 and J6 have turned is left to the line
    const POSTURE: u8 = 7;
    match (&path, fig) {
        (Ok(path), Some(fig)) if (figure(&path.end()) ^ fig) & POSTURE != 0 => Err(HResult::E_INVALIDARG),
        _ => Ok(path),
    }
}

/// Returns the controller's code for an axis that would have to leave its range.
pub(super) fn out_of_reach(OutOfReach(axis): OutOfReach) -> HResult {
    HResult::from_u32(0x8320_4070 + u32::from(axis))
}
