//! Whether a stream of Slave Mode runs at the robot.
//!
//! A controller in Slave Mode refuses Variable_PutValue, or no source says that it executes it, and a refused call ends
//! Slave Mode ([`FunctionId::properties`](bcap_core::bcap::FunctionId::properties)). So the gateway opens the robot object once
//! in each session, sends `slvGetMode` before each PUT, and refuses the PUT unless no stream runs. A GET needs no such query.
//! The heartbeat is the same query, because Controller_GetName may also end a stream. A stream that begins between the query
//! and the PUT can still be ended.

use bcap_core::bcap::call::RobotHandle;

/// The availability of the query on this robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StreamCheck {
    /// The robot object is to be opened.
    Unopened,
    /// The robot refused to open its object. A stream may run; the next heartbeat tries again. PLCs that poll do not delay
    /// it, because only the reply to this call sets its time.
    Closed,
    /// The query uses this handle.
    Open(RobotHandle),
    /// The robot has no robot object, or no Slave Mode. The query is not repeated: each refusal may add an entry to the robot's
    /// log.
    Absent,
}
