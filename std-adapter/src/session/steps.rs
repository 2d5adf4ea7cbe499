//! A session for tasks: a motion in steps, so that the task can make other calls in between.

use std::io;
use std::ops::ControlFlow;

use bcap_core::io::asynch::{Running, Transport};
use bcap_core::procedure::{MotionQueue, Procedure, StepError, Until};
use bcap_core::time::Instant;

use super::{ROBOT, Session};
use crate::error::Error;
use crate::moves::Move;

impl<X: Transport<Error = io::Error>> Session<X> {
    /// Returns the transport.
    pub(crate) const fn transport(&mut self) -> &mut X {
        self.connection.transport()
    }

    /// Returns the time on the connection's clock.
    pub(crate) fn now(&mut self) -> Instant {
        self.connection.transport().now()
    }

    /// Returns the motions of a queue, with one more if there is one, that [`advance`](Self::advance) runs.
    pub(crate) async fn queue(
        &mut self,
        queue: MotionQueue,
        motion: Option<Move>,
        until: Until,
    ) -> Result<Running<impl Procedure<Output = MotionQueue, Error = StepError> + Send + use<X>, io::Error>, Error>
    {
        self.begin_queue(queue, motion, until).await.map(Running::new)
    }

    /// Makes the calls of a motion until it waits or ends.
    pub(crate) async fn advance<P: Procedure<Output = MotionQueue, Error = StepError>>(
        &mut self,
        running: &mut Running<P, io::Error>,
    ) -> ControlFlow<Result<MotionQueue, Error>, Instant> {
        match self.connection.advance(running).await {
            ControlFlow::Continue(at) => {
                self.observe(None);
                // a halt of another task may have ended the previous motion; this queue may have begun the next motion
                self.set_moving(true);
                ControlFlow::Continue(at)
            }
            ControlFlow::Break(ended) => {
                let ended = self.ended(ROBOT, ended);
                // after an error it is unknown whether the halt of the procedure succeeded
                self.set_moving(ended.as_ref().map_or(true, |queue| queue.ended().is_none()));
                ControlFlow::Break(ended)
            }
        }
    }
}
