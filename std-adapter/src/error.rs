//! The errors of [`Controller`](crate::blocking::Controller) and its objects.

use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::client::ClientError;
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_core::procedure::{Halt, HaltAnswer, NotRecovered, StepCause, StepError};
use bcap_core::slave::{Cause, ConfigError, Failure, StreamError};
use bcap_core::variant::{ConvertError, OwnedVariant};

use crate::address::AddressError;
use crate::connect::ConnectError;
use crate::path::ObjectPathError;
use crate::recovery::Recovery;
use crate::{CallError, RunError};

/// Why an operation on a controller failed.
///
/// # Examples
///
/// ```no_run
/// use bcap_std::Error;
/// use bcap_std::core::hresult::HResult;
/// # use bcap_std::{Settings, blocking::Controller};
/// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
///
/// match cell.write("I1", 5) {
///     Ok(()) => {}
///     Err(Error::NotConnected { .. }) => println!("not written: connect, and write it"),
///     Err(Error::NoReply { .. }) => println!("perhaps written: read I1 before it is written again"),
///     Err(error) if error.code() == Some(HResult::E_ACCESSDENIED) => println!("this client may not write I1"),
///     Err(error) => println!("{error}"),
/// }
/// # Ok::<(), Error>(())
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The address of the controller cannot be read.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// A controller over a stream of the caller has no address to connect to again.
    #[error("a controller over the caller's own stream has no address; make the stopper with Stopper::over")]
    NoAddress,
    /// A stopper needs a second connection, which a serial line does not have.
    #[error("a serial line carries one session, so it has no stopper; halt over TCP or UDP")]
    NoSecondSession,
    /// The arm was taken before over the same session.
    #[error("the arm is taken already over this session; give it back before it is taken again")]
    ArmTaken,
    /// The session in which the arm was taken was lost, and with it the arm.
    #[error("the arm was lost with the connection; look where the robot is, and take the arm again")]
    ArmLost,
    /// A scan or a kept motion was used with another controller than its own. No call was sent.
    #[error("this scan or motion belongs to another session; use it with the controller that it is from")]
    OtherSession,
    /// The path of a variable is invalid. No call was made.
    #[error(transparent)]
    Path(#[from] ObjectPathError),
    /// There is no session with the controller, or it was lost before the whole call was sent. The controller has not executed
    /// the call.
    #[error("not connected: {reason}")]
    NotConnected {
        /// Why.
        reason: String,
    },
    /// The configuration of a stream of Slave Mode is invalid. No call was made.
    #[error(transparent)]
    StreamConfig(ConfigError),
    /// A stream of Slave Mode failed.
    #[error("Slave Mode: {0}")]
    Stream(StreamError),
    /// The robot still moves after the halt, or the controller refuses Robot_Halt, so that the robot may move at any time.
    #[error("{0}; use the emergency stop")]
    NotHalted(Halt),
    /// The connection was lost, and a new connection could not verify that all effects of the session on the robot have ended.
    #[error("the connection was lost; over a new one {0}")]
    NotEnded(Recovery),
    /// A recovery or a preparation ended before its last step. It names the step, the controller's code, and what to do.
    #[error("not recovered: {0}")]
    NotRecovered(NotRecovered),
    /// A value has no VARIANT. The call was not sent.
    #[error("the value cannot be sent: {0}")]
    Argument(#[from] EncodeError),
    /// The controller was closed. The call was not sent.
    #[error("the controller was closed")]
    Closed,
    /// The controller did not accept the connection.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The controller refused a call, which had no effect. The exception is [`E_TIMEOUT`](HResult::E_TIMEOUT): the controller
    /// abandoned the call, and may still execute it.
    #[error("{function} of {object}: the controller refused: {}", explained(*code))]
    Refused {
        /// The called function.
        function: FunctionId,
        /// The object that it was called on.
        object: String,
        /// The controller's code.
        code: HResult,
    },
    /// A call has no reply. Unless it was not sent, the controller may have executed it: a motion may be in progress.
    #[error("{function} of {object}: {source}")]
    NoReply {
        /// The called function.
        function: FunctionId,
        /// The object that it was called on.
        object: String,
        /// The failure of the call.
        source: CallError,
    },
    /// The reply to a call has another type than the function returns.
    #[error("{function} of {object}: {reason}")]
    Reply {
        /// The called function.
        function: FunctionId,
        /// The object that it was called on.
        object: String,
        /// The fault in the reply.
        reason: String,
    },
    /// The value of a variable did not meet a condition in time.
    #[error("{object} did not meet the condition within {limit:?}; its last value was {last:?}")]
    NotMet {
        /// The variable.
        object: String,
        /// The time limit.
        limit: Duration,
        /// The last value that was read.
        last: OwnedVariant,
    },
    /// A value does not have the requested type.
    #[error("the value of {object}: {source}")]
    Value {
        /// The variable or the command.
        object: String,
        /// The found type and the expected type.
        source: ConvertError,
    },
}

/// Writes code, meaning and hint.
fn explained(code: HResult) -> String {
    let meaning = code.meaning().map(|meaning| format!(": {meaning}")).unwrap_or_default();
    let hint = code.hint().map(|hint| format!(" Hint: {hint}")).unwrap_or_default();
    format!("{code}{meaning}{hint}")
}

impl Error {
    /// Returns the controller's code, if it refused a call.
    #[must_use]
    pub const fn code(&self) -> Option<HResult> {
        match self {
            Self::Refused { code, .. } | Self::NotHalted(Halt { answer: HaltAnswer::Refused(code), .. }) => Some(*code),
            Self::NotRecovered(error) => error.code(),
            Self::Stream(StreamError::Fault { cause: Cause::Refused(code), .. }) => Some(*code),
            _ => None,
        }
    }

    /// Returns whether the controller may have executed the failed call: it has no reply, or a reply that does not exclude it. A
    /// motion may then be in progress.
    #[must_use]
    pub const fn may_have_run(&self) -> bool {
        use ClientError::{Busy, Encode, TooLarge};
        match self {
            Self::Refused { code, .. } => matches!(*code, HResult::E_TIMEOUT),
            Self::NoReply { source, .. } => !matches!(source, CallError::Client(Encode(_) | TooLarge { .. } | Busy)),
            Self::Stream(_)
            | Self::NotHalted(_)
            | Self::NotEnded(_)
            | Self::NotRecovered(_)
            | Self::Reply { .. }
            | Self::Value { .. } => true,
            _ => false,
        }
    }

    /// Returns whether the connection is lost, so that a new [`Controller`](crate::blocking::Controller) is needed.
    #[must_use]
    pub const fn is_lost(&self) -> bool {
        match self {
            Self::NoReply { source, .. } => !source.is_recoverable(),
            Self::NotConnected { .. } => true,
            Self::Stream(StreamError::Fault { cause: Cause::Failed(failure), .. }) => {
                matches!(failure, Failure::Lost | Failure::Closed)
            }
            _ => false,
        }
    }

    /// Returns whether a halt must be made over a new session: the connection is lost, the halt has no reply, or the session no
    /// longer exists on the controller, as after the eviction of an idle peer over UDP.
    pub(crate) const fn ends_session(&self) -> bool {
        match self {
            Self::NoReply { .. } | Self::NotConnected { .. } => true,
            Self::Refused { code, .. } => matches!(*code, HResult::E_HANDLE | HResult::E_NOT_CONNECTED),
            _ => false,
        }
    }

    pub(crate) fn call(function: FunctionId, object: &str, error: CallError) -> Self {
        let object = object.to_owned();
        match error {
            CallError::Refused(code) => Self::Refused { function, object, code },
            CallError::Client(ClientError::Encode(error)) => Self::Argument(error),
            source => Self::NoReply { function, object, source },
        }
    }

    pub(crate) fn run(object: &str, error: RunError) -> Self {
        let RunError { error: StepError { function, cause, .. }, call, .. } = error;
        match (cause, call) {
            (StepCause::Refused(code), _) => Self::call(function, object, CallError::Refused(code)),
            (_, Some(call)) => Self::call(function, object, call),
            (cause, None) => Self::Reply { function, object: object.to_owned(), reason: cause.to_string() },
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use bcap_core::bcap::client::Timeout;
    use bcap_core::slave::{PoseError, Step};
    use bcap_core::variant::Variant;

    use super::*;
    use crate::Address;

    fn call(error: CallError) -> Error {
        Error::call(FunctionId::VARIABLE_GET_VALUE, "I1", error)
    }

    #[test]
    fn a_failed_stream_tells_of_a_lost_connection_and_a_refusal() {
        let stream = |cause| Error::Stream(StreamError::Fault { step: Step::Move, cause, code: None });
        let lost =
            [Failure::Lost, Failure::Closed, Failure::Timeout].map(|failure| stream(Cause::Failed(failure)).is_lost());
        assert_eq!(lost, [true, true, false]);
        let refused = stream(Cause::Refused(HResult::E_FAIL));
        assert_eq!((refused.code(), refused.is_lost()), (Some(HResult::E_FAIL), false));
    }

    /// The text of every variant.
    #[test]
    fn each_error_says_what_is_wrong_where_and_what_to_do() {
        let address = "robot".parse::<Address>().unwrap_err();
        let source = Variant::Bool(true).convert::<i32>().unwrap_err();
        let refused = HResult::E_CAO_OBJECT_NOTFOUND;
        let function = FunctionId::ROBOT_MOVE;
        let reset = io::Error::from(io::ErrorKind::ConnectionReset);
        for (error, text) in [
            (
                Error::from(address),
                "robot: write tcp:HOST[:PORT], udp:HOST[:PORT] or serial:PATH, such as tcp:192.168.0.1",
            ),
            (
                Error::NoAddress,
                "a controller over the caller's own stream has no address; make the stopper with Stopper::over",
            ),
            (Error::ArmTaken, "the arm is taken already over this session; give it back before it is taken again"),
            (Error::ArmLost, "the arm was lost with the connection; look where the robot is, and take the arm again"),
            (
                Error::OtherSession,
                "this scan or motion belongs to another session; use it with the controller that it is from",
            ),
            (Error::NotConnected { reason: "no route".into() }, "not connected: no route"),
            (Error::Closed, "the controller was closed"),
            (
                Error::NotEnded(Recovery { halted: Some(true), motor_off: Some(false), arm_free: false }),
                "the connection was lost; over a new one the robot was halted, the motor was NOT switched off, and the arm \
                 was not seen to be free",
            ),
            (
                call(CallError::Refused(refused)),
                "Variable_GetValue of I1: the controller refused: 0x80000204 (E_CAO_OBJECT_NOTFOUND): There is no such \
                 object. Hint: check the name against what the matching Get...Names function lists",
            ),
            (
                call(CallError::Client(ClientError::Timeout(Timeout::Attempt))),
                "Variable_GetValue of I1: no reply and no keep-alive within the timeout",
            ),
            (call(CallError::Disconnected), "Variable_GetValue of I1: the peer has closed the connection"),
            (call(CallError::Io(reset)), "Variable_GetValue of I1: the connection failed: connection reset"),
            (
                Error::Reply { function, object: "the robot".into(), reason: "it has no value".into() },
                "Robot_Move of the robot: it has no value",
            ),
            (Error::Value { object: "I1".into(), source }, "the value of I1: "),
            (Error::StreamConfig(ConfigError::Cycle), "the cycle"),
            (ConnectError::Setup(io::Error::from(io::ErrorKind::PermissionDenied)).into(), "cannot "),
            (Error::Argument(EncodeError::Full), "the value cannot be sent: "),
            (
                Error::Stream(StreamError::Pose { number: 3, error: PoseError::NotFinite { number: 1 } }),
                "Slave Mode: pose 3: ",
            ),
        ] {
            let shown = error.to_string();
            assert!(shown.starts_with(text), "{shown}");
        }
    }
}
