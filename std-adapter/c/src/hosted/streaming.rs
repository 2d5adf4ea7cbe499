//! The thread of a stream: it turns the library's loop, which asks for poses, into one of the program, which gives them.
//!
//! ```text
//!  program   bcap_stream_start    bcap_stream_step(pose)      bcap_stream_step(pose)
//!                  ▲                 │          ▲                 │
//!            Cycle │                 ▼ Next     │ Cycle           ▼ Next
//!  thread    ──────┴─ waits ── sends the pose ──┴──── waits ── sends the pose
//! ```
//!
//! The thread runs [`Arm::stream`](bcap_std::blocking::Arm::stream), which paces the poses. It has the controller until the stream ends.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_std::blocking::Controller;
use bcap_std::core::slave::{AxisLimits, Cycle, Format, MoveReply, Next, Stats, Trajectory};
use bcap_std::core::time::Instant;

use super::{Failure, taken};
use crate::status::{BCAP_E_PANIC, BCAP_E_STREAM};

/// The number of joints of a pose.
pub(super) const JOINTS: usize = 8;

/// The outcome of the thread: the controller, unless it panicked, and the counts of the stream.
pub(super) type Outcome = (Option<Controller>, Result<Stats, Failure>);

/// A stream under way.
pub(super) struct Stream {
    /// The joints at the last cycle, which waits for a pose.
    cycles: Receiver<[f64; JOINTS]>,
    poses: SyncSender<Next>,
    thread: JoinHandle<(Controller, Result<Stats, Failure>)>,
}

/// Asks the program for poses.
struct Feeder {
    cycles: SyncSender<[f64; JOINTS]>,
    poses: Receiver<Next>,
    late: Duration,
    /// The joints of the last reply.
    joints: Option<[f64; JOINTS]>,
    /// Whether the program gave no pose in time.
    was_late: bool,
}

impl Trajectory for Feeder {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        let start = || cycle.start.numbers().try_into().unwrap_or_default();
        if self.cycles.send(self.joints.unwrap_or_else(start)).is_err() {
            return Next::Stop;
        }
        self.poses.recv_timeout(self.late).unwrap_or_else(|_| {
            self.was_late = true;
            Next::Stop
        })
    }

    fn moved(&mut self, reply: &MoveReply<'_>, _: Instant) {
        self.joints = reply.joints();
    }
}

impl Stream {
    pub(super) fn start(mut controller: Controller, format: Format, limits: AxisLimits, late: Duration) -> Self {
        let (cycle, cycles) = sync_channel(1);
        let (pose, poses) = sync_channel(1);
        let mut feeder = Feeder { cycles: cycle, poses, late, joints: None, was_late: false };
        let thread = thread::spawn(move || {
            let ended = taken(&mut controller).and_then(|mut arm| {
                let ended = arm.stream(format, limits, &mut feeder);
                arm.keep();
                ended.map_err(Failure::from)
            });
            let ended = match ended {
                Ok(_) if feeder.was_late => Err(Failure::new(BCAP_E_STREAM, late_text(late))),
                ended => ended,
            };
            (controller, ended)
        });
        Self { cycles, poses: pose, thread }
    }

    /// Waits until the next pose is needed, and returns the joints of that time; `None` if the stream has ended.
    pub(super) fn next_cycle(&self) -> Option<[f64; JOINTS]> {
        self.cycles.recv().ok()
    }

    /// Gives the next pose.
    pub(super) fn give(&self, next: Next) {
        // a stream that has ended takes none, and the next cycle says so
        let _ = self.poses.send(next);
    }

    /// Lets the robot come to rest at the last pose.
    pub(super) fn finish(self) -> Outcome {
        self.give(Next::Finish);
        self.join()
    }

    /// Waits for the end of the thread.
    pub(super) fn join(self) -> Outcome {
        drop((self.cycles, self.poses));
        match self.thread.join() {
            Ok((controller, ended)) => (Some(controller), ended),
            Err(_) => (None, Err(BCAP_E_PANIC.into())),
        }
    }

    /// Stops the robot in an orderly way, and ends the stream.
    pub(super) fn stop(self) -> Outcome {
        self.give(Next::Stop);
        self.join()
    }
}

fn late_text(late: Duration) -> String {
    format!("Slave Mode: the program gave no pose within {late:?}, so the robot was stopped")
}
