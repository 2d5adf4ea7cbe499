//! The layout of slvMove and of its reply: slvSendFormat and slvRecvFormat.
//!
//! ```text
//!   slvMove carries                                     its reply carries
//!     pose              ARRAY|R8                          0x0010  time stamp   I4
//!     0x0100  MiniIO    I4                                 low 4  pose         ARRAY|R8
//!     0x0200  user IO   I4 offset, I4 size, ARRAY|UI1     0x0100  MiniIO       I4
//!     receive 0x0200    I4 offset, I4 size                0x0200  user IO      ARRAY|UI1
//!     0x0020  HandIO    I4                                0x0020  HandIO       I4
//!                                                         0x0040  current      ARRAY|R8, 8 elements
//! ```
//!
//! in this order (b-CAP specification, section 5.2). A pose alone is an ARRAY|R8; with other elements it becomes the first
//! element of an array of VARIANT. slvMove carries either MiniIO or user IO, not both.

use core::fmt;

use super::mode::{J_LEN, P_LEN, SlaveMode, T_LEN};
use super::pose::{ExtendedAxes, PoseLayout};
use crate::error::EncodeError;
use crate::variant::{Encode, Writer};

/// A range of user IO, in whole bytes.
///
/// On the wire, offset and size are numbers of ports (bits).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct UserIo {
    offset: u16,
    bytes: u8,
}

impl UserIo {
    /// Chooses `bytes` bytes (8 ports each) from port `offset` on.
    ///
    /// # Errors
    ///
    /// When the offset is below 128 or not a multiple of 8, or `bytes` is 0 (the rules of the vendor's open drivers).
    pub const fn new(offset: u16, bytes: u8) -> Result<Self, FormatError> {
        if offset < 128 || !offset.is_multiple_of(8) {
            return Err(FormatError::UserIoOffset(offset));
        }
        if bytes == 0 {
            return Err(FormatError::UserIoEmpty);
        }
        Ok(Self { offset, bytes })
    }

    /// Returns the first port.
    #[must_use]
    pub const fn offset(self) -> u16 {
        self.offset
    }

    /// Returns the number of bytes.
    #[must_use]
    pub const fn bytes(self) -> u8 {
        self.bytes
    }

    /// Returns offset and size on the wire, in ports.
    pub(super) fn on_wire(self) -> [i32; 2] {
        [i32::from(self.offset), i32::from(self.bytes).wrapping_mul(8)]
    }
}

/// MiniIO or user IO in slvMove.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SendIo {
    /// Neither.
    #[default]
    None,
    /// The MiniIO outputs.
    Mini,
    /// User IO.
    User(UserIo),
}

/// The elements of slvMove in addition to the pose: the parameter of slvSendFormat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SendFormat {
    /// MiniIO, user IO or neither.
    pub io: SendIo,
    /// The HandIO outputs.
    pub hand_io: bool,
}

impl SendFormat {
    /// The pose alone.
    pub const POSE: Self = Self { io: SendIo::None, hand_io: false };

    /// Returns the number that slvSendFormat takes: 0, 0x20, 0x100, 0x120, 0x200 or 0x220.
    #[must_use]
    pub const fn code(self) -> i32 {
        let io = match self.io {
            SendIo::None => 0,
            SendIo::Mini => MINI,
            SendIo::User(_) => USER,
        };
        io | if self.hand_io { HAND } else { 0 }
    }
}

/// The pose in the reply to slvMove.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ReceivePose {
    /// Position: 7 numbers.
    P,
    /// Joints: 8 numbers.
    J,
    /// Homogeneous transform: 10 numbers.
    T,
    /// Position and joints, 15 numbers in a row.
    PJ,
    /// Homogeneous transform and joints, 18 numbers in a row.
    TJ,
}

impl ReceivePose {
    /// Returns the number of values.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "no pose is empty")]
    pub const fn len(self) -> usize {
        match self {
            Self::P => P_LEN,
            Self::J => J_LEN,
            Self::T => T_LEN,
            Self::PJ => P_LEN + J_LEN,
            Self::TJ => T_LEN + J_LEN,
        }
    }

    /// Returns the index of the first joint, if it contains joints.
    pub(super) const fn joints_at(self) -> Option<usize> {
        match self {
            Self::P | Self::T => None,
            Self::J => Some(0),
            Self::PJ => Some(P_LEN),
            Self::TJ => Some(T_LEN),
        }
    }
}

/// The unit of the time stamp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TimeUnit {
    /// Milliseconds, the controller's default.
    #[default]
    Millis,
    /// Microseconds.
    Micros,
}

/// The elements of the reply to slvMove: the parameter of slvRecvFormat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ReceiveFormat {
    /// The pose, which every reply contains.
    pub pose: ReceivePose,
    /// The controller's time stamp, in this unit.
    pub time: Option<TimeUnit>,
    /// The MiniIO inputs and outputs.
    pub mini_io: bool,
    /// A range of user IO; every slvMove carries the range.
    pub user_io: Option<UserIo>,
    /// The HandIO inputs and outputs.
    pub hand_io: bool,
    /// The motor currents of 8 axes.
    pub current: bool,
}

impl ReceiveFormat {
    /// Returns the format of a pose alone.
    #[must_use]
    pub const fn pose(pose: ReceivePose) -> Self {
        Self { pose, time: None, mini_io: false, user_io: None, hand_io: false, current: false }
    }

    /// Returns the number that slvRecvFormat takes.
    #[must_use]
    pub const fn code(self) -> i32 {
        let pose = match self.pose {
            ReceivePose::P => 1,
            ReceivePose::J => 2,
            ReceivePose::T => 3,
            ReceivePose::PJ => 4,
            ReceivePose::TJ => 5,
        };
        pose | (if self.time.is_some() { TIME } else { 0 })
            | (if self.hand_io { HAND } else { 0 })
            | (if self.current { CURRENT } else { 0 })
            | (if self.mini_io { MINI } else { 0 })
            | (if self.user_io.is_some() { USER } else { 0 })
    }

    /// Returns whether the reply is a pose alone, not an array of VARIANT.
    pub(super) const fn is_plain(self) -> bool {
        self.time.is_none() && !self.mini_io && self.user_io.is_none() && !self.hand_io && !self.current
    }
}

/// The parameter of slvRecvFormat: an array of the number and the unit of the time stamp, 0 for milliseconds and 1 for
/// microseconds (b-CAP specification, table 5-1).
impl Encode for ReceiveFormat {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        [self.code(), i32::from(self.time == Some(TimeUnit::Micros))].encode(out)
    }
}

const TIME: i32 = 0x0010;
const HAND: i32 = 0x0020;
const CURRENT: i32 = 0x0040;
const MINI: i32 = 0x0100;
const USER: i32 = 0x0200;

/// The settings of a stream that determine the layout of every slvMove and its reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Format {
    /// The mode and the type of the poses.
    pub mode: SlaveMode,
    /// The extended joints that the poses command.
    pub extended: ExtendedAxes,
    /// The elements of slvMove in addition to the pose.
    pub send: SendFormat,
    /// The elements of the reply.
    pub receive: ReceiveFormat,
}

impl Format {
    /// Creates a format that sends poses alone, and receives `receive`.
    #[must_use]
    pub const fn new(mode: SlaveMode, receive: ReceiveFormat) -> Self {
        Self { mode, extended: ExtendedAxes::None, send: SendFormat::POSE, receive }
    }

    /// Returns the layout of its poses.
    #[must_use]
    pub const fn layout(&self) -> PoseLayout {
        PoseLayout { pose: self.mode.pose, extended: self.extended }
    }

    /// Returns the number of elements of the parameter of slvMove.
    #[must_use]
    pub const fn items(&self) -> u32 {
        let io = match self.send.io {
            SendIo::None => 0,
            SendIo::Mini => 1,
            SendIo::User(_) => 3,
        };
        let receive = if self.receive.user_io.is_some() { 2 } else { 0 };
        let hand = if self.send.hand_io { 1 } else { 0 };
        1_u32.wrapping_add(io).wrapping_add(receive).wrapping_add(hand)
    }
}

/// Data that does not agree with the format, or an invalid format; nothing was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FormatError {
    /// The offset of user IO is below 128 or not a multiple of 8.
    UserIoOffset(u16),
    /// User IO of 0 bytes.
    UserIoEmpty,
    /// The number of bytes of user IO differs from the format's.
    UserIoLength {
        /// The format's number of bytes.
        expected: u8,
        /// The number of bytes that were passed.
        found: usize,
    },
    /// The pose has another type or other extended joints than the format.
    Layout {
        /// The format's layout.
        expected: PoseLayout,
        /// The pose's layout.
        found: PoseLayout,
    },
    /// The send format has no MiniIO.
    NoMiniIo,
    /// The send format has no HandIO.
    NoHandIo,
    /// The send format has no user IO.
    NoUserIo,
}

impl fmt::Display for FormatError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UserIoOffset(offset) => {
                write!(f, "user IO cannot begin at port {offset}: it must be a multiple of 8, and at least 128")
            }
            Self::UserIoEmpty => f.write_str("user IO of 0 bytes: it must have at least one"),
            Self::UserIoLength { expected, found } => {
                write!(f, "the format has {expected} bytes of user IO, {found} were given")
            }
            Self::Layout { expected, found } => {
                write!(f, "the format has poses of type {expected}, this pose is {found}")
            }
            Self::NoMiniIo => f.write_str("the send format has no MiniIO: set its `io` to `SendIo::Mini`"),
            Self::NoHandIo => f.write_str("the send format has no HandIO: set its `hand_io`"),
            Self::NoUserIo => f.write_str("the send format has no user IO: set its `io` to `SendIo::User`"),
        }
    }
}

impl core::error::Error for FormatError {}
