//! The status that functions return: 0, a positive code of this library, or the negative code of a controller.

use bcap_core::bcap::client::{ClientError, Timeout};
use bcap_core::error::EncodeError;
use bcap_core::variant::{ConvertError, ConvertErrorKind};

/// The result of a function: `BCAP_OK`, a positive code `BCAP_E_...` of this library, or the negative HRESULT of the controller.
/// `bcap_status_text` explains all of them.
pub type bcap_status = i32;
pub(crate) use bcap_status as Status;

/// Defines the codes with the text that `bcap_status_text` prints.
macro_rules! codes {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $text:literal;)*) => {
        $(
            $(#[$doc])*
            #[cfg_attr(not(feature = "hosted"), allow(dead_code, reason = "of the hosted client"))]
            pub(crate) const $name: Status = $code;
        )*

        /// The codes with their names and texts.
        pub(crate) const CODES: &[(Status, &str, &str)] = &[$(($code, stringify!($name), $text),)*];
    };
}

codes! {
    BCAP_OK = 0, "success";
    BCAP_E_POINTER = 1, "a pointer is null or misaligned, or buffers overlap; pass memory of its own for each argument";
    BCAP_E_HANDLE = 2, "the object was not initialised, was closed, or was copied; open it, and use it where it was opened";
    BCAP_E_SHORT = 3, "the buffer is too short for the result; pass a longer one";
    BCAP_E_VALUE = 4, "the value is null, not UTF-8 or of a type that cannot be sent; make it with a function such as bcap_i4";
    BCAP_E_TEXT = 5, "the text is not UTF-8, or not in the required form";
    BCAP_E_TYPE = 6, "the value has another type than was asked for; its field `type` names it";
    BCAP_E_RANGE = 7, "a number is out of range, or the value does not fit the type that was asked for without loss";
    BCAP_E_BUSY = 8, "another call is in flight; wait for its end";
    BCAP_E_TOO_LARGE = 9, "the call does not fit the largest frame of the link, or the transmit buffer; nothing was sent";
    BCAP_E_TIMEOUT = 10, "no reply in time; the controller may have executed the call";
    BCAP_E_MALFORMED = 11, "the peer sent invalid bytes; is it a b-CAP server? On a stream the session has ended";
    BCAP_E_FLOODED = 12, "the peer floods this client with replies; the session has ended";
    BCAP_E_REPLY_TOO_LARGE = 13, "the reply does not fit the receive buffer; the controller executed the call";
    BCAP_E_CLOSED = 14, "the session has ended, or the connection is lost; the controller has not executed the call; connect again";
    BCAP_E_LOST = 15, "the connection was lost during the call, which the controller may have executed; connect again";
    BCAP_E_ADDRESS = 16, "the address is invalid; write tcp:HOST[:PORT], udp:HOST[:PORT] or serial:PATH";
    BCAP_E_CONNECT = 17, "the connection failed; are address, port and cable right, and is the controller on?";
    BCAP_E_PATH = 18, "the name of the variable or object is invalid; write I1, robot/@SERVO_ON or task:Pro1/@STATUS";
    BCAP_E_ARM = 19, "the arm is not taken, or was lost with the connection; call bcap_take_arm";
    BCAP_E_HALTED = 20, "the robot was halted and rests elsewhere; recover before the next motion";
    BCAP_E_UNSURE = 21, "the robot rests, and whether at the destination is unknown; read its position";
    BCAP_E_MOTION_TIMEOUT = 22, "the motion took longer than its time limit, and the robot was halted";
    BCAP_E_NOT_HALTED = 23, "the robot may still move; use the emergency stop";
    BCAP_E_NO_MOTION = 24, "no motion was started; call bcap_start";
    BCAP_E_STREAM = 25, "Slave Mode failed; bcap_message says why. The robot does not follow poses";
    BCAP_E_STREAMING = 26, "a stream of Slave Mode runs on this connection; end it with bcap_stream_finish";
    BCAP_E_NO_STREAM = 27, "no stream of Slave Mode runs; call bcap_stream_start";
    BCAP_E_RECOVERY = 28, "the robot is not ready; bcap_message names the step that failed, and what to do";
    BCAP_E_REENTRANT = 29, "a log callback called the library; return from it first";
    BCAP_E_PANIC = 30, "a defect of the library; the object is closed and its robot halted. Please report bcap_message";
    BCAP_E_NO_REPLY = 31, "there is no reply to read; poll until BCAP_EVENT_REPLIED";
    BCAP_E_FAILED = 32, "the call failed; bcap_message says why";
}

/// Returns the status of a call that was not sent, or has no reply.
pub(crate) fn client(error: ClientError) -> Status {
    match error {
        ClientError::Encode(error) => encode(error),
        ClientError::TooLarge { .. } => BCAP_E_TOO_LARGE,
        ClientError::Busy => BCAP_E_BUSY,
        ClientError::Timeout(Timeout::Attempt | Timeout::Deadline | Timeout::KeepAlive) => BCAP_E_TIMEOUT,
        ClientError::Malformed(_) => BCAP_E_MALFORMED,
        ClientError::Flooded => BCAP_E_FLOODED,
        ClientError::ReplyTooLarge { .. } => BCAP_E_REPLY_TOO_LARGE,
        ClientError::Reply(_) => BCAP_E_TYPE,
        ClientError::Closed => BCAP_E_CLOSED,
        _ => BCAP_E_FAILED,
    }
}

/// Returns the status of a value that has no VARIANT.
pub(crate) fn encode(error: EncodeError) -> Status {
    match error {
        EncodeError::Full => BCAP_E_SHORT,
        _ => BCAP_E_VALUE,
    }
}

/// Returns the status of a value that has another type.
pub(crate) fn convert(error: ConvertError) -> Status {
    match error.kind {
        ConvertErrorKind::OutOfRange(_) | ConvertErrorKind::Inexact(_) => BCAP_E_RANGE,
        _ => BCAP_E_TYPE,
    }
}
