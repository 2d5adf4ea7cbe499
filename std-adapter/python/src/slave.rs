//! Streams of Slave Mode whose loop the caller owns.
//!
//! ```text
//!  step(pose) ─► PoseSender ─► the trajectory of `bcap_stream::steps` ─► the engine ─► slvMove
//!      ▲                                     │
//!      └───────────── wanted ◄───────────────┘
//! ```

use std::sync::Arc;

use bcap_std::Error;
use bcap_std::core::slave::{AxisLimits, Cycle, Format, MoveReply, Next, Pose, PoseType, Stats, Trajectory};
use bcap_std::core::time::Instant;
use bcap_stream::steps::{PoseSender, Step, format, given};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::sync::{Mutex, watch};
use tokio::task::{JoinHandle, block_in_place};

use crate::call::Call;
use crate::error::{Failure, seconds, unknown};
use crate::runtime::Home;

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
    home: Arc<Home>,
    kind: PoseType,
    poses: PoseSender,
    wanted: watch::Receiver<Option<Step>>,
    /// One step at a time.
    turn: Arc<Mutex<()>>,
    task: Arc<Mutex<Option<StreamTask>>>,
}

/// The task of a stream.
type StreamTask = JoinHandle<Result<Stats, Failure>>;

impl Stream {
    /// Begins a stream, which `start` runs with the arm, and waits until the first pose is wanted.
    pub(crate) fn begin<F>(
        home: &Arc<Home>,
        config: StreamConfig,
        start: impl FnOnce(Format, AxisLimits, Blocking) -> F,
    ) -> PyResult<Call>
    where
        F: Future<Output = Result<Stats, Failure>> + Send + 'static,
    {
        let kind = match &*config.kind {
            "J" => PoseType::J,
            "P" => PoseType::P,
            "T" => PoseType::T,
            other => return Err(unknown("kind of pose", other, "J, P, T")),
        };
        let invalid = || PyValueError::new_err(format!("mode {} does not exist; 0 to 2 do", config.mode));
        let format = format(config.mode.into(), kind).ok_or_else(invalid)?;
        let (speed, acceleration) = (config.max_speed, config.max_acceleration);
        let limits = AxisLimits::uniform(speed.unwrap_or(f64::INFINITY), acceleration.unwrap_or(f64::INFINITY));
        let (sender, mut wanted) = watch::channel(None);
        let pose_timeout = seconds(config.pose_timeout)?;
        let (poses, trajectory) = given(pose_timeout, move |step| drop(sender.send_replace(Some(step))));
        let streaming = start(format, limits, Blocking(Box::new(trajectory)));
        let (stream_home, runtime) = (Arc::clone(home), home.handle()?.clone());
        let blocks = home.streams();
        Ok(Call::fallible(home, async move {
            let task = runtime.spawn(async move {
                let _blocks = blocks;
                streaming.await
            });
            if wanted.wait_for(Option::is_some).await.is_err() {
                return ended(&poses, &mut { task }).await.and(Err(Error::Closed.into()));
            }
            let task = Arc::new(Mutex::new(Some(task)));
            Ok(Self { home: stream_home, kind, poses, wanted, turn: Arc::default(), task })
        }))
    }
}

/// Waits for the end of a stream, and returns its statistics.
async fn ended(poses: &PoseSender, task: &mut StreamTask) -> Result<Stats, Failure> {
    let stats = task.await.unwrap_or(Err(Error::Closed.into()))?;
    Ok(poses.judge(Ok(stats))?)
}

#[pymethods]
impl Stream {
    /// Returns the cycle that is wanted now: its number, the start of the stream, and the pose in the last reply.
    fn wanted(&self) -> Option<(u32, Vec<f64>, Vec<f64>)> {
        self.wanted.borrow().clone().map(cycle)
    }

    /// Sends a pose, and waits until the next pose is wanted; None if the stream has ended before.
    fn step(&self, pose: Vec<f64>) -> PyResult<Call> {
        let pose = Pose::from_numbers(self.kind, &pose).ok_or_else(|| {
            PyValueError::new_err(format!("a pose {:?} does not have {} numbers", self.kind, pose.len()))
        })?;
        let (poses, mut wanted, turn) = (self.poses.clone(), self.wanted.clone(), Arc::clone(&self.turn));
        Ok(Call::new(&self.home, async move {
            let _turn = turn.lock().await;
            let number = wanted.borrow_and_update().as_ref().map(|wanted| wanted.number);
            // when the stream has ended, `wanted` says so
            poses.send(Next::Pose(pose));
            let next = wanted.wait_for(|wanted| wanted.as_ref().map(|wanted| wanted.number) > number).await;
            Ok(next.ok().and_then(|wanted| wanted.clone()).map(cycle))
        }))
    }

    /// Ends the stream: after the last pose, or immediately with a ramp. Returns the statistics.
    fn finish(&self, stop: bool) -> Call {
        let (poses, task) = (self.poses.clone(), Arc::clone(&self.task));
        Call::fallible(&self.home, async move {
            poses.send(if stop { Next::Stop } else { Next::Finish });
            let mut task = task.lock().await;
            // if this call is cancelled, the next call waits for the same task
            let ended = ended(&poses, task.as_mut().ok_or(Error::Closed)?).await;
            *task = None;
            let Stats { cycles, late, refused, underflows, .. } = ended?;
            Ok([("cycles", cycles), ("late", late), ("refused", refused), ("underflows", underflows)])
        })
    }
}

fn cycle(Step { number, start, actual }: Step) -> (u32, Vec<f64>, Vec<f64>) {
    (number, start, actual)
}

/// A trajectory that blocks. The other tasks of the shared runtime continue; the tasks of a session wait for the end of its
/// stream.
pub(crate) struct Blocking(Box<dyn Trajectory + Send>);

impl Trajectory for Blocking {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        match Handle::current().runtime_flavor() {
            RuntimeFlavor::MultiThread => block_in_place(|| self.0.next(cycle)),
            _ => self.0.next(cycle),
        }
    }

    fn moved(&mut self, reply: &MoveReply<'_>, now: Instant) {
        self.0.moved(reply, now);
    }
}
