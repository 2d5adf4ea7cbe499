//! Running motions as an object.

use bcap_core::procedure::{Motion, MotionQueue, Until};

use super::ending;
use super::socket::{Blocking, ready};
use crate::error::Error;
use crate::moves::Move;
use crate::session::{Halted, Session};

/// Motions in sequence; the last one has begun. [`Arm::start`](super::Arm::start) returns it.
///
/// **Dropping it halts the robot**, even by an error or a panic.
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
    pub(super) session: &'a mut Session<Blocking>,
    pub(super) queue: MotionQueue,
}

/// Running motions, from [`Moving::keep`]; [`Controller::resume`](super::Controller::resume) takes them.
#[derive(Debug)]
#[must_use = "only the end of the session halts the robot"]
pub struct KeptMotion {
    pub(super) session: u64,
    pub(super) queue: MotionQueue,
}

impl Moving<'_> {
    /// Ends the use of this object without halting the robot, for programs that cannot keep a borrow, such as bindings to other
    /// languages. The motions continue; the end of the session halts them.
    pub fn keep(self) -> KeptMotion {
        let kept = KeptMotion { session: self.session.id, queue: self.queue };
        std::mem::forget(self);
        kept
    }

    /// Lets a motion follow, and returns when it has begun.
    ///
    /// The controller receives it immediately, during the previous motion. With [`Pass::Near`](crate::Pass::Near) or
    /// [`Pass::Within`](crate::Pass::Within) for the previous motion, the robot does not stop between them. Only one motion
    /// waits at a time: with more, the controller could not be queried for where they end.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot was halted, unless the connection is lost.
    pub fn then(self, motion: &Move) -> Result<Self, Error> {
        self.run(Some(motion), Until::Begun)
    }

    /// Waits until the last motion ends, at most until the time limit of all motions; the robot is halted then.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot was halted, unless the connection is lost.
    pub fn wait(self) -> Result<Motion, Error> {
        Ok(self.run(None, Until::Ended)?.queue.ended().unwrap_or(Motion::Unknown))
    }

    /// Halts the robot, as a drop does, and waits until it rests.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot may still move.
    pub fn halt(self) -> Result<Halted, Error> {
        ready(self.session.halt_and_verify())
    }

    pub(super) fn run(mut self, motion: Option<&Move>, until: Until) -> Result<Self, Error> {
        self.queue = ready(self.session.run_queue(self.queue, motion.cloned(), until))?;
        Ok(self)
    }
}

impl Drop for Moving<'_> {
    fn drop(&mut self) {
        if self.session.is_moving()
            && let Err(error) = ending::within_limit(self.session, |session| ready(session.halt()))
        {
            tracing::warn!(%error, "a motion was dropped, and the robot was not halted");
        }
    }
}
