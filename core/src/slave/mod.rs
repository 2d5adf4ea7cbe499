//! Slave Mode: streams one pose per control cycle to the controller (b-CAP specification, section 5).
//!
//! ```text
//!  slvGetMode ─► formats ─► TakeArm ─► Motor ─► position ─► slvChangeMode m ─► slvMove, slvMove, ...
//!      │ a stream runs: Fault                                                      │         └─► slvChangeMode 0 ─► Motor 0 ─► GiveArm
//!                                                                                  │ any error: Slave Mode ends
//!                                                                                  ▼
//!                                                   slvGetMode ─► (slvChangeMode 0) ─► errors ─► emergency stop? ─► Fault
//! ```
//!
//! Three layers; each can be used without the next:
//!
//! * **Types** of the data: [`SlaveMode`], [`Pose`], [`SendFormat`], [`ReceiveFormat`], [`MoveReply`]. Data that the
//!   specification does not allow cannot be expressed, or is a [`FormatError`] before anything is sent.
//! * **Calls**: [`change_mode`], [`get_mode`], [`send_format`], [`receive_format`], [`slv_move`], and [`PreparedMove`],
//!   the slvMove of a stream, whose frame is written once and then patched.
//! * The **[`Engine`]**, a sans-IO state machine that runs a stream. It reports which call to make next, when to wait, and
//!   when it needs a pose. It follows the timing of each mode, sends a pose again after E_BUF_FULL, checks [`AxisLimits`]
//!   before a pose is sent, stops in an orderly way, and after an error reads the first cause from the controller.
//!
//! [`Engine::stream`] combines an engine and a [`Trajectory`] into a [`Procedure`](crate::procedure::Procedure), which the
//! loops of [`io`](crate::io) run, blocking and asynchronous.
//!
//! For Slave Mode the controller requires its licence, Auto mode, the executable token, no error, and a robot at rest
//! at the start; two robots and the virtual fence are not supported (b-CAP specification, section 5.10).

mod call;
mod command;
mod config;
mod engine;
mod fault;
mod format;
mod length;
mod limits;
mod mode;
mod pacer;
mod pose;
mod reply;
mod stats;
mod stream;
mod trajectory;

pub use self::call::{EngineCall, Step};
pub use self::command::{
    MOVE_FRAME, Outputs, PreparedMove, change_mode, get_mode, receive_format, send_format, slv_move,
};
pub use self::config::{Config, ConfigError};
pub use self::engine::{Engine, EngineAction};
pub use self::fault::{Cause, ControllerError, ERRORS_MAX, Fault, RecoverError, Released};
pub use self::format::{Format, FormatError, ReceiveFormat, ReceivePose, SendFormat, SendIo, TimeUnit, UserIo};
pub use self::limits::{AxisLimits, PoseError};
pub use self::mode::{J_LEN, Mode, P_LEN, PoseType, SlaveMode, T_LEN};
pub use self::pose::{Extended, ExtendedAxes, Pose, PoseLayout};
pub use self::reply::{CURRENT_LEN, MoveReply, MoveReplyError, MoveReplyErrorKind, ReplyPart, Timestamp};
pub use self::stats::{Histogram, Stats};
pub use self::stream::{Stream, StreamError};
pub use self::trajectory::{Cycle, Next, Trajectory};

pub use crate::procedure::{Channel, Failure, Handles};

#[cfg(test)]
mod tests;
