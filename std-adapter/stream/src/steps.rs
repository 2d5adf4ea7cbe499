//! Streams whose loop the caller owns: the caller passes the poses one by one, instead of implementing a trajectory.
//!
//! ```text
//!  caller   Steps::start         send(pose)                send(pose)             finish
//!                ▲                 │     ▲                   │     ▲                │
//!           Step │                 ▼     │ Step              ▼     │ Step           ▼
//!  engine   ─────┴──── waits ── sends the pose ── waits ── sends the pose ── … ── ends
//! ```
//!
//! [`given`] creates the trajectory, for a program that runs the stream itself. [`Steps`] runs it on a thread, with a blocking
//! controller. If the caller gives no pose within the time limit, the robot stops with a ramp, and the stream fails.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_core::slave::{
    AxisLimits, Cycle, Format, Mode, MoveReply, Next, PoseType, ReceiveFormat, ReceivePose, SlaveMode, Stats,
    Trajectory,
};
use bcap_core::time::Instant;
use bcap_std::Error;
use bcap_std::blocking::Controller;

/// Returns the format of a stream in mode 0, 1 or 2, whose replies have poses of the same type; `None` for another number.
#[must_use]
pub fn format(mode: i32, pose: PoseType) -> Option<Format> {
    let code = SlaveMode { mode: Mode::Mode0, pose }.code() | mode.checked_mul(0x100)?;
    let slave_mode = SlaveMode::from_code(code)?;
    Some(Format::new(slave_mode, ReceiveFormat::pose(reply_pose(pose))))
}

/// Returns the part of a reply that has the same type as the poses.
pub(crate) const fn reply_pose(pose: PoseType) -> ReceivePose {
    match pose {
        PoseType::P => ReceivePose::P,
        PoseType::J => ReceivePose::J,
        PoseType::T => ReceivePose::T,
    }
}

/// The cycle that waits for a pose of the caller.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// The number of the pose, counted from 0.
    pub number: u32,
    /// The pose at the start of the stream, in mm and degrees.
    pub start: Vec<f64>,
    /// The pose in the last reply of the controller; the start before the first reply.
    pub actual: Vec<f64>,
}

/// Why a stream ended without being finished.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StepError {
    /// The caller gave no pose in time. The robot was stopped.
    #[error("Slave Mode: the program gave no pose within {0:?}, so the robot was stopped")]
    Late(Duration),
    /// The stream failed.
    #[error(transparent)]
    Failed(#[from] Error),
    /// The thread of the stream panicked. Its controller was dropped, which halts the robot.
    #[error("the thread of the stream panicked, and the robot was halted")]
    Panicked,
}

/// Gives the poses of a stream. Dropping it stops the robot.
#[derive(Clone, Debug)]
pub struct PoseSender {
    poses: Sender<Next>,
    pose_timeout: Duration,
    is_late: Arc<AtomicBool>,
}

impl PoseSender {
    /// Gives the next pose, or ends the stream. A stream that has ended drops it.
    pub fn send(&self, next: Next) {
        let _ = self.poses.send(next);
    }

    /// Returns the result of a stream: a stream that stopped because a pose was late has failed.
    ///
    /// # Errors
    ///
    /// [`StepError::Late`], or the error of the stream.
    pub fn judge(&self, ended: Result<Stats, Error>) -> Result<Stats, StepError> {
        match ended {
            Ok(_) if self.is_late.load(Relaxed) => Err(StepError::Late(self.pose_timeout)),
            ended => ended.map_err(StepError::Failed),
        }
    }
}

/// The trajectory of the caller's poses, from [`given`].
#[derive(Debug)]
pub struct GivenPoses<F> {
    poses: Receiver<Next>,
    wanted: F,
    /// The pose in the last reply.
    actual: Option<Vec<f64>>,
    pose_timeout: Duration,
    is_late: Arc<AtomicBool>,
}

/// Creates a trajectory of poses that the caller gives, each at most `pose_timeout` after its cycle was passed to `wanted`.
///
/// Its [`next`](Trajectory::next) blocks until the pose is available.
pub fn given<F: FnMut(Step)>(pose_timeout: Duration, wanted: F) -> (PoseSender, GivenPoses<F>) {
    let (sender, poses) = channel();
    let is_late = Arc::<AtomicBool>::default();
    let sender = PoseSender { poses: sender, pose_timeout, is_late: Arc::clone(&is_late) };
    (sender, GivenPoses { poses, wanted, actual: None, pose_timeout, is_late })
}

impl<F: FnMut(Step)> Trajectory for GivenPoses<F> {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        let start = cycle.start.numbers().to_vec();
        let actual = self.actual.clone().unwrap_or_else(|| start.clone());
        (self.wanted)(Step { number: cycle.number, start, actual });
        self.poses.recv_timeout(self.pose_timeout).unwrap_or_else(|error| {
            self.is_late.store(error == RecvTimeoutError::Timeout, Relaxed);
            Next::Stop
        })
    }

    fn moved(&mut self, reply: &MoveReply<'_>, _: Instant) {
        self.actual = Some(reply.pose().iter().collect());
    }
}

/// The controller after a stream, unless its thread panicked, and the result.
pub type Ended = (Option<Controller>, Result<Stats, StepError>);

/// A running stream, on a thread that owns the controller until the end. Dropping it stops the robot, and waits until the
/// session has ended.
#[derive(Debug)]
pub struct Steps {
    wanted: Receiver<Step>,
    poses: PoseSender,
    /// `None` after the end.
    thread: Option<JoinHandle<(Controller, Result<Stats, Error>)>>,
}

impl Steps {
    /// Starts a stream with the arm of a controller, which must be taken, with the motor on. The arm stays taken.
    #[must_use]
    pub fn start(mut controller: Controller, format: Format, limits: AxisLimits, pose_timeout: Duration) -> Self {
        let (sender, wanted) = channel();
        // if the caller has gone, there is no pose either
        let (poses, mut trajectory) = given(pose_timeout, move |step| drop(sender.send(step)));
        let thread = thread::spawn(move || {
            let ended = controller.arm().and_then(|mut arm| {
                let ended = arm.stream(format, limits, &mut trajectory);
                arm.keep();
                ended
            });
            (controller, ended)
        });
        Self { wanted, poses, thread: Some(thread) }
    }

    /// Waits for the cycle that needs the next pose; `None` if the stream has ended: [`end`](Self::end) returns the reason.
    #[must_use]
    pub fn wanted(&self) -> Option<Step> {
        self.wanted.recv().ok()
    }

    /// Gives the next pose.
    pub fn send(&self, next: Next) {
        self.poses.send(next);
    }

    /// Ends the stream, unless it has ended, and waits until the robot rests. [`Next::Finish`] ends it at the last pose,
    /// [`Next::Stop`] with a ramp.
    pub fn end(mut self, last: Next) -> Ended {
        match self.join(last) {
            Some(Ok((controller, ended))) => (Some(controller), self.poses.judge(ended)),
            Some(Err(_)) | None => (None, Err(StepError::Panicked)),
        }
    }

    fn join(&mut self, last: Next) -> Option<thread::Result<(Controller, Result<Stats, Error>)>> {
        let thread = self.thread.take()?;
        self.send(last);
        Some(thread.join())
    }
}

impl Drop for Steps {
    fn drop(&mut self) {
        drop(self.join(Next::Stop));
    }
}

#[cfg(test)]
mod tests {
    use bcap_core::slave::Pose;
    use bcap_sim::memory::Network;
    use bcap_sim::{Config, Profile};
    use bcap_std::Settings;

    use super::*;

    const HOUR: Duration = Duration::from_secs(3600);

    /// Starts a stream of joints to a controller in memory; a speed above 100 degrees per second is refused.
    fn started(network: &Network, pose_timeout: Duration) -> Steps {
        let mut cell = Controller::over(network.connect(), &Settings::rc8()).unwrap();
        let mut arm = cell.robot().unwrap().take_arm().unwrap();
        arm.motor_on().unwrap();
        arm.keep();
        Steps::start(cell, format(2, PoseType::J).unwrap(), AxisLimits::uniform(100.0, 800.0), pose_timeout)
    }

    fn joints(first: f64, step: &Step) -> Next {
        let mut joints: [f64; 8] = step.start.clone().try_into().unwrap();
        joints[0] = first;
        Next::Pose(Pose::j(joints))
    }

    fn network() -> Network {
        Network::new(Config::new(Profile::Rc8))
    }

    #[test]
    fn a_format_has_its_mode_and_the_same_type_in_replies() {
        let expected =
            Format::new(SlaveMode { mode: Mode::Mode1, pose: PoseType::T }, ReceiveFormat::pose(ReceivePose::T));
        assert_eq!(format(1, PoseType::T), Some(expected));
        assert_eq!([-1, 3, i32::MAX].map(|mode| format(mode, PoseType::J)), [None; 3]);
    }

    #[test]
    fn the_robot_follows_the_poses_of_the_caller_and_rests_at_the_last_one() {
        let network = network();
        let steps = started(&network, HOUR);
        for number in 0..250 {
            let step = steps.wanted().unwrap();
            assert_eq!(step.number, number);
            // the controller reports a pose that it has reached
            let before = 1.0 - (f64::from(number) / 250.0 * std::f64::consts::TAU).cos();
            assert!((step.actual[0] - step.start[0] - before).abs() < 0.5, "{step:?}");
            let part = f64::from(number + 1) / 250.0;
            steps.send(joints(1.0 - (part * std::f64::consts::TAU).cos(), &step));
        }
        let last = steps.wanted().unwrap();
        let (cell, ended) = steps.end(Next::Finish);
        assert!(ended.unwrap().cycles >= 250 && last.number == 250);
        assert!(network.controller().axes()[0].abs() < 1e-3);
        // the arm is still taken, until the end of the session
        assert!(cell.as_ref().is_some_and(Controller::has_arm));
        drop(cell);
        assert!(network.controller().arm_owner().is_none() && !network.controller().motor_is_on());
    }

    #[test]
    fn a_caller_that_gives_no_pose_stops_the_robot() {
        let network = network();
        let steps = started(&network, Duration::from_millis(1));
        assert_eq!(steps.wanted().unwrap().number, 0);
        assert_eq!(steps.wanted(), None);
        let (_cell, ended) = steps.end(Next::Finish);
        let error = ended.unwrap_err();
        assert_eq!(error.to_string(), "Slave Mode: the program gave no pose within 1ms, so the robot was stopped");
        assert!(!network.controller().is_moving());
    }

    #[test]
    fn a_pose_beyond_the_limits_ends_the_stream() {
        let network = network();
        let steps = started(&network, HOUR);
        let step = steps.wanted().unwrap();
        steps.send(joints(45.0, &step));
        assert_eq!(steps.wanted(), None);
        let (_cell, ended) = steps.end(Next::Finish);
        assert!(matches!(ended, Err(StepError::Failed(Error::Stream(_)))), "{ended:?}");
        assert!(network.controller().axes()[0].abs() < 1e-3);
    }

    #[test]
    fn a_caller_that_has_gone_or_stops_ends_the_stream() {
        let network = network();
        let steps = started(&network, HOUR);
        let step = steps.wanted().unwrap();
        steps.send(joints(0.01, &step));
        let (cell, ended) = steps.end(Next::Stop);
        assert!(ended.is_ok() && !network.controller().is_moving());
        drop(cell);
        let steps = started(&network, HOUR);
        steps.send(joints(0.01, &steps.wanted().unwrap()));
        drop(steps);
        assert!(network.controller().arm_owner().is_none() && !network.controller().motor_is_on());
        let (sender, mut trajectory) = given(HOUR, |_| ());
        drop(sender);
        let pose = Pose::j([0.0; 8]);
        let stats = Stats::default();
        let cycle =
            Cycle { number: 0, deadline: Instant::ZERO, start: &pose, last: &pose, margin: None, stats: &stats };
        assert_eq!(trajectory.next(&cycle), Next::Stop);
    }
}
