//! Slave Mode: a pose every cycle, straight into the controller (S2:979-1456).
//!
//! ```text
//!  formats ─► TakeArm ─► Motor ─► position ─► slvChangeMode m ─► slvMove, slvMove, ... ─► slvChangeMode 0 ─► GiveArm
//!                                                                    │ any error: Slave Mode is off
//!                                                                    ▼
//!                                     slvGetMode ─► (slvChangeMode 0) ─► errors ─► emergency stop? ─► Fault
//! ```
//!
//! Three layers, each of use without the next:
//!
//! * **Types** for what can be sent and received: [`SlaveMode`], [`Pose`], [`SendFormat`], [`ReceiveFormat`],
//!   [`MoveReply`]. What the specification does not allow cannot be written with them, or is a [`FormatError`] before
//!   anything is sent.
//! * **Calls**: [`change_mode`], [`get_mode`], [`send_format`], [`receive_format`], [`slv_move`], and [`PreparedMove`],
//!   the slvMove of a stream, whose frame is written once and then patched.
//! * The **[`Engine`]**, which runs a whole stream without socket or clock: it says which call to make next, when to wait,
//!   and when it wants a pose. It keeps the pace of each mode, sends again what E_BUF_FULL refused, checks [`AxisLimits`]
//!   before anything is sent, stops in an orderly way, and after an error finds out what the controller says came first.
//!
//! [`Engine::stream`] joins an engine and a [`Trajectory`] to a [`Procedure`](crate::procedure::Procedure), which the loops of
//! [`io`](crate::io) run, blocking and asynchronous.
//!
//! Of Slave Mode the controller wants: its licence, Auto mode, the executable token, no error, and that the robot stands
//! still at the start; two robots and the virtual fence are not supported (S2:1454).

mod command;
mod config;
mod engine;
mod fault;
mod format;
mod limits;
mod mode;
mod pacer;
mod pose;
mod reply;
mod request;
mod stats;
mod stream;
mod trajectory;

pub use self::command::{
    MOVE_FRAME, Outputs, PreparedMove, change_mode, get_mode, receive_format, send_format, slv_move,
};
pub use self::config::{Config, ConfigError};
pub use self::engine::{Action, Engine};
pub use self::fault::{Cause, ControllerError, ERRORS_MAX, Fault, RecoverError, Released};
pub use self::format::{Format, FormatError, ReceiveFormat, ReceivePose, SendFormat, SendIo, TimeUnit, UserIo};
pub use self::limits::{AxisLimits, PoseError};
pub use self::mode::{J_LEN, Mode, P_LEN, PoseType, SlaveMode, T_LEN};
pub use self::pose::{Extended, ExtendedAxes, Pose, Shape};
pub use self::reply::{CURRENT_LEN, MoveReply, MoveReplyError, MoveReplyErrorKind, ReplyPart, Timestamp};
pub use self::request::{Request, Step};
pub use self::stats::{Histogram, Stats};
pub use self::stream::{Stream, StreamError};
pub use self::trajectory::{Cycle, Next, Trajectory};

pub use crate::procedure::{Channel, Failure, Handles};

#[cfg(test)]
mod tests;
