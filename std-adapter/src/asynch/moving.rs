//! Running motions as an object for tokio.

use bcap_core::procedure::{Motion, MotionQueue, Until};
use tokio::sync::oneshot;

use super::actor::{MoveRequest, Request};
use super::handle::Handle;
use crate::error::Error;
use crate::moves::Move;
use crate::session::{ArmId, Halted};

/// Motions in sequence; the last one has begun. [`Arm::start`](super::Arm::start) returns it.
///
/// **Dropping it halts the robot**, and so does dropping the future of any of its functions. Other calls of the controller run
/// during the motion.
///
/// # Outcome
///
/// Only the end of the last motion can be waited for. [`Motion::Arrived`] means that the robot rests there. If the robot was
/// stopped before, [`then`](Self::then) sends nothing, and [`wait`](Self::wait) returns how it ended.
///
/// One halt can go unseen: it stops the robot completely in the moment before the controller accepts the next motion, which
/// the robot then carries out. Real controllers have an error after a halt, and refuse that motion.
///
/// The end of a rotation cannot be compared, nor can a destination whose text the library cannot parse. If such a motion is
/// shorter than two polls (some 10 ms), the outcome is [`Motion::Unknown`], and so is the outcome of a sequence that ends where
/// it began, if no poll saw the robot elsewhere.
#[derive(Debug)]
#[must_use = "dropping it halts the robot"]
pub struct Moving<'a> {
    pub(super) handle: &'a Handle,
    pub(super) arm: ArmId,
    pub(super) queue: MotionQueue,
}

impl<'a> Moving<'a> {
    /// Lets a motion follow, and returns when it has begun.
    ///
    /// The controller receives it immediately, during the previous motion. With [`Pass::Near`](crate::Pass::Near) or
    /// [`Pass::Within`](crate::Pass::Within) for the previous motion, the robot does not stop between them. Only one motion
    /// waits at a time: with more, the controller could not be queried for where they end.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot was halted, unless the connection is lost.
    ///
    /// # Cancel safety
    ///
    /// **Dropping the future halts the robot.**
    pub fn then(self, motion: &Move) -> impl Future<Output = Result<Self, Error>> + Send + use<'a> {
        self.run(Some(motion.clone()), Until::Begun)
    }

    /// Waits until the last motion ends, at most until the time limit of all motions; the robot is halted then.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot was halted, unless the connection is lost.
    ///
    /// # Cancel safety
    ///
    /// **Dropping the future halts the robot.**
    pub async fn wait(self) -> Result<Motion, Error> {
        Ok(self.run(None, Until::Ended).await?.queue.ended().unwrap_or(Motion::Unknown))
    }

    /// Halts the robot, as a drop does, and waits until it rests.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot may still move.
    ///
    /// # Cancel safety
    ///
    /// The robot is halted even if the future is dropped.
    pub async fn halt(self) -> Result<Halted, Error> {
        self.handle.run_always(|session| Box::pin(session.halt_and_verify())).await
    }

    pub(super) async fn run(mut self, motion: Option<Move>, until: Until) -> Result<Self, Error> {
        self.queue = run_queue(self.handle, self.arm, self.queue, motion, until).await?;
        Ok(self)
    }
}

/// Runs the motions of a queue in the task, with one more if there is one. A drop of the future halts the robot.
pub(super) async fn run_queue(
    handle: &Handle,
    arm: ArmId,
    queue: MotionQueue,
    motion: Option<Move>,
    until: Until,
) -> Result<MotionQueue, Error> {
    // the robot moves already: its time limit does not wait for other callers
    let permit = if queue.is_new() { handle.slot().await } else { None };
    let (reply, ended) = oneshot::channel();
    handle.send(Request::Move(Box::new(MoveRequest { arm, queue, motion, until, reply, permit })))?;
    ended.await.map_err(|_| Error::Closed)?
}

impl Drop for Moving<'_> {
    fn drop(&mut self) {
        // when the task has ended, it has given the arm back
        let _ = self.handle.send(Request::GiveUp(self.arm));
    }
}
