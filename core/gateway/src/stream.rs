//! Whether a stream of Slave Mode runs at the robot.
//!
//! A controller in Slave Mode refuses Variable_PutValue, or no source says that it executes it, and a refused call ends
//! Slave Mode ([`FunctionId::properties`](bcap_core::bcap::FunctionId::properties)). So the gateway opens the robot object once
//! in each session, asks `slvGetMode` before each PUT, and refuses the PUT unless no stream runs. A GET needs no question.
//! The heartbeat is the same question: Controller_GetName may end a stream too. A stream that begins between the question and
//! the PUT can still be ended.

use bcap_core::bcap::call::RobotHandle;

/// The question that the gateway can ask the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StreamCheck {
    /// The robot object is to be opened.
    Unopened,
    /// The robot refused to open its object. A stream may run; the next heartbeat tries again. PLCs that poll do not delay
    /// it, because only the reply to this call sets its time.
    Closed,
    /// The robot can be asked by this handle.
    Open(RobotHandle),
    /// The robot has no robot object, or no Slave Mode. It is not asked again: a refusal may be an entry in its log.
    Absent,
}
