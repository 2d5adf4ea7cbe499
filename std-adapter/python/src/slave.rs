//! Streams of Slave Mode whose loop the caller owns.
//!
//! ```text
//!  step(pose) ── poses ──► Source ──► the engine ──► slvMove
//!      ▲                     │ moved                   │
//!      └───── Wanted ────────┴──────── reply ◄─────────┘
//! ```
//!
//! The engine asks [`Source`] for each pose. It waits for the pose of the caller until a timeout; then it stops the
//! robot with a ramp.

use std::sync::{Arc, mpsc};
use std::time::Duration;

use bcap_std::Error;
use bcap_std::core::slave::{
    AxisLimits, Cycle, Format, Mode, MoveReply, Next, Pose, PoseType, ReceiveFormat, ReceivePose, SlaveMode, Stats,
    Trajectory,
};
use bcap_std::core::time::Instant;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tokio::sync::{Mutex, watch};
use tokio::task::{JoinHandle, block_in_place};

use crate::arm::Arm;
use crate::call::Call;
use crate::controller::{seconds, unknown};
use crate::runtime::runtime;

/// The settings of a stream, as a dictionary.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct StreamConfig {
    mode: u8,
    kind: String,
    max_speed: Option<f64>,
    max_acceleration: Option<f64>,
    pose_timeout: f64,
}

/// A stream of Slave Mode. Dropping it stops the robot.
#[pyclass(frozen)]
pub(crate) struct Stream {
    kind: PoseType,
    poses: mpsc::Sender<Next>,
    wanted: watch::Receiver<Option<Wanted>>,
    /// One step at a time.
    turn: Arc<Mutex<()>>,
    task: Arc<Mutex<Option<Streaming>>>,
}

/// The task of a stream.
type Streaming = JoinHandle<Result<Stats, Error>>;

/// The pose that the engine waits for: its number, and the pose that the robot had at the reply to the one before.
#[derive(Clone, IntoPyObject)]
pub(crate) struct Wanted {
    number: u32,
    start: Vec<f64>,
    received: Vec<f64>,
}

impl Stream {
    /// Begins a stream, and waits until the first pose is wanted.
    pub(crate) fn begin(arm: &Arm, config: StreamConfig) -> PyResult<Call> {
        let (kind, receive) = match &*config.kind {
            "J" => (PoseType::J, ReceivePose::J),
            "P" => (PoseType::P, ReceivePose::P),
            "T" => (PoseType::T, ReceivePose::T),
            other => return Err(unknown("kind of pose", other, "J, P, T")),
        };
        let mode = match config.mode {
            0 => Mode::Mode0,
            1 => Mode::Mode1,
            2 => Mode::Mode2,
            other => return Err(PyValueError::new_err(format!("mode {other} does not exist; 0 to 2 do"))),
        };
        let format = Format::new(SlaveMode { mode, pose: kind }, ReceiveFormat::pose(receive));
        let (speed, acceleration) = (config.max_speed, config.max_acceleration);
        let limits = AxisLimits::uniform(speed.unwrap_or(f64::INFINITY), acceleration.unwrap_or(f64::INFINITY));
        let (poses, receiver) = mpsc::channel();
        let (sender, mut wanted) = watch::channel(None);
        let pose_timeout = seconds(config.pose_timeout)?;
        let source = Source { poses: receiver, wanted: sender, received: Vec::new(), pose_timeout };
        let streaming = arm.run(move |arm| Box::pin(arm.stream(format, limits, source)));
        let runtime = runtime()?;
        Ok(Call::new(async move {
            let task = runtime.spawn(streaming);
            if wanted.wait_for(Option::is_some).await.is_err() {
                return ended(task).await.and(Err(Error::Closed));
            }
            let task = Arc::new(Mutex::new(Some(task)));
            Ok(Self { kind, poses, wanted, turn: Arc::default(), task })
        }))
    }
}

/// Returns the statistics of a stream that has ended.
async fn ended(task: Streaming) -> Result<Stats, Error> {
    task.await.unwrap_or(Err(Error::Closed))
}

#[pymethods]
impl Stream {
    /// Returns the pose that is wanted now.
    fn wanted(&self) -> Option<Wanted> {
        self.wanted.borrow().clone()
    }

    /// Sends a pose, and waits until the next one is wanted; None if the stream has ended before.
    fn step(&self, pose: Vec<f64>) -> PyResult<Call> {
        let pose = Pose::from_numbers(self.kind, &pose).ok_or_else(|| {
            PyValueError::new_err(format!("a pose {:?} does not have {} numbers", self.kind, pose.len()))
        })?;
        let (poses, mut wanted, turn) = (self.poses.clone(), self.wanted.clone(), Arc::clone(&self.turn));
        Ok(Call::new(async move {
            let _turn = turn.lock().await;
            let number = wanted.borrow_and_update().as_ref().map(|wanted| wanted.number);
            // when the stream has ended, `wanted` says so
            let _ = poses.send(Next::Pose(pose));
            let next = wanted.wait_for(|wanted| wanted.as_ref().map(|wanted| wanted.number) > number).await;
            Ok(next.ok().and_then(|wanted| wanted.clone()))
        }))
    }

    /// Ends the stream: after the last pose, or at once with a ramp. Returns the statistics.
    fn finish(&self, stop: bool) -> Call {
        let (poses, task) = (self.poses.clone(), Arc::clone(&self.task));
        Call::new(async move {
            let _ = poses.send(if stop { Next::Stop } else { Next::Finish });
            let task = task.lock().await.take().ok_or(Error::Closed)?;
            let Stats { cycles, late, refused, underflows, .. } = ended(task).await?;
            Ok([("cycles", cycles), ("late", late), ("refused", refused), ("underflows", underflows)])
        })
    }
}

/// The trajectory of the engine: the poses of the caller.
struct Source {
    poses: mpsc::Receiver<Next>,
    wanted: watch::Sender<Option<Wanted>>,
    received: Vec<f64>,
    pose_timeout: Duration,
}

impl Trajectory for Source {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        let received = if self.received.is_empty() { cycle.start.numbers().to_vec() } else { self.received.clone() };
        let start = cycle.start.numbers().to_vec();
        self.wanted.send_replace(Some(Wanted { number: cycle.number, start, received }));
        // the other tasks of the runtime go on
        block_in_place(|| self.poses.recv_timeout(self.pose_timeout)).unwrap_or(Next::Stop)
    }

    fn moved(&mut self, reply: &MoveReply<'_>, _now: Instant) {
        self.received = reply.pose().iter().collect();
    }
}
