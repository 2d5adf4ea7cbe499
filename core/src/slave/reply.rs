//! The reply to slvMove, as a typed view of its bytes.
//!
//! Types and lengths are checked against the [`ReceiveFormat`]; after that no accessor fails. For joints that a robot does
//! not have, the controller may send any value, as the tiny numbers in the specification's example, so this module does not
//! compare them with 0.

use core::fmt;

use super::format::{ReceiveFormat, ReceivePose, TimeUnit};
use super::mode::{J_LEN, P_LEN, T_LEN};
use crate::variant::{Items, VarType, Variant};

/// The number of axes in the motor currents.
pub const CURRENT_LEN: usize = 8;

/// The reply to a slvMove.
///
/// # Examples
///
/// ```
/// use bcap_core::slave::{ReceiveFormat, ReceivePose};
/// use bcap_core::variant::VariantBuf;
///
/// let format = ReceiveFormat { mini_io: true, ..ReceiveFormat::pose(ReceivePose::J) };
/// let value = VariantBuf::<128>::new(&([10.0, 20.0, 30.0, 0.0, 0.0, 0.0, 1e-307, 3e-313], 0x0f_i32))?;
/// let reply = format.read(value.as_variant())?;
/// assert_eq!(reply.joints().map(|j| j[2]), Some(30.0));
/// assert_eq!((reply.mini_io(), reply.hand_io()), (Some(0x0f), None));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy)]
pub struct MoveReply<'a> {
    format: ReceiveFormat,
    time: Option<i32>,
    /// Exactly `format.pose.len()` numbers.
    pose: Items<'a, f64>,
    mini_io: Option<i32>,
    user_io: Option<&'a [u8]>,
    hand_io: Option<i32>,
    current: Option<[f64; CURRENT_LEN]>,
}

/// A time of the controller's clock, a counter of 32 bits that wraps. Only differences have a meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Timestamp {
    /// The counter.
    pub ticks: i32,
    /// The unit of a tick.
    pub unit: TimeUnit,
}

impl Timestamp {
    /// Returns the microseconds since `earlier`, which must lie less than one wrap of the counter in the past.
    #[must_use]
    pub fn micros_since(self, earlier: Self) -> u64 {
        let ticks = u64::from(self.ticks.wrapping_sub(earlier.ticks).cast_unsigned());
        match self.unit {
            TimeUnit::Millis => ticks.wrapping_mul(1000),
            TimeUnit::Micros => ticks,
        }
    }
}

/// An element of the reply to slvMove.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ReplyPart {
    /// The whole value.
    Whole,
    /// The time stamp.
    Time,
    /// The pose.
    Pose,
    /// MiniIO.
    MiniIo,
    /// User IO.
    UserIo,
    /// HandIO.
    HandIo,
    /// The motors' currents.
    Current,
}

/// The reply to slvMove does not have the layout that slvRecvFormat set: the peer's fault, or the formats differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct MoveReplyError {
    /// The invalid element.
    pub part: ReplyPart,
    /// Why it is invalid.
    pub kind: MoveReplyErrorKind,
}

/// Why an element is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MoveReplyErrorKind {
    /// It is missing.
    Missing,
    /// It has this type instead of the format's.
    Type(VarType),
    /// It has another number of elements.
    Length {
        /// The format's number of elements.
        expected: usize,
        /// The number of elements in the reply.
        found: usize,
    },
}

impl fmt::Display for MoveReplyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.part {
            ReplyPart::Whole => "the reply to slvMove",
            ReplyPart::Time => "the time stamp in the reply to slvMove",
            ReplyPart::Pose => "the pose in the reply to slvMove",
            ReplyPart::MiniIo => "MiniIO in the reply to slvMove",
            ReplyPart::UserIo => "user IO in the reply to slvMove",
            ReplyPart::HandIo => "HandIO in the reply to slvMove",
            ReplyPart::Current => "the current in the reply to slvMove",
        })?;
        match self.kind {
            MoveReplyErrorKind::Missing => f.write_str(" is missing"),
            MoveReplyErrorKind::Type(found) => write!(f, " is {found}, which does not match the receive format"),
            MoveReplyErrorKind::Length { expected, found } => write!(f, " has {found} elements instead of {expected}"),
        }
    }
}

impl core::error::Error for MoveReplyError {}

impl ReceiveFormat {
    /// Reads the value of a reply to slvMove.
    ///
    /// # Errors
    ///
    /// A [`MoveReplyError`] when the type or length of an element differs from this format.
    pub fn read<'a>(&self, value: Variant<'a>) -> Result<MoveReply<'a>, MoveReplyError> {
        if self.is_plain() {
            let pose = numbers(ReplyPart::Pose, Some(value), self.pose.len())?;
            return Ok(MoveReply {
                format: *self,
                time: None,
                pose,
                mini_io: None,
                user_io: None,
                hand_io: None,
                current: None,
            });
        }
        let array = value.as_array().filter(|array| array.element() == VarType::VARIANT);
        let mut elements = array.ok_or_else(|| wrong_type(ReplyPart::Whole, value))?.iter();
        let found = elements.len();
        let reply = MoveReply {
            format: *self,
            time: when(self.time.is_some(), || int(ReplyPart::Time, elements.next()))?,
            pose: numbers(ReplyPart::Pose, elements.next(), self.pose.len())?,
            mini_io: when(self.mini_io, || int(ReplyPart::MiniIo, elements.next()))?,
            user_io: match self.user_io {
                Some(range) => Some(bytes(elements.next(), usize::from(range.bytes()))?),
                None => None,
            },
            hand_io: when(self.hand_io, || int(ReplyPart::HandIo, elements.next()))?,
            current: when(self.current, || {
                numbers(ReplyPart::Current, elements.next(), CURRENT_LEN)
                    .map(|items| items.to_array().unwrap_or_default())
            })?,
        };
        match elements.len() {
            0 => Ok(reply),
            more => {
                let expected = found.saturating_sub(more);
                Err(MoveReplyError { part: ReplyPart::Whole, kind: MoveReplyErrorKind::Length { expected, found } })
            }
        }
    }
}

fn when<T>(selected: bool, read: impl FnOnce() -> Result<T, MoveReplyError>) -> Result<Option<T>, MoveReplyError> {
    if selected { read().map(Some) } else { Ok(None) }
}

fn int(part: ReplyPart, value: Option<Variant<'_>>) -> Result<i32, MoveReplyError> {
    match value {
        Some(Variant::I4(n)) => Ok(n),
        // these are bits, which some peers send as unsigned numbers
        Some(Variant::Ui4(n)) => Ok(n.cast_signed()),
        other => Err(wrong(part, other)),
    }
}

fn numbers(part: ReplyPart, value: Option<Variant<'_>>, expected: usize) -> Result<Items<'_, f64>, MoveReplyError> {
    let items = value.and_then(|v| v.as_array()).and_then(|a| a.items()).ok_or_else(|| wrong(part, value))?;
    check_length(part, expected, items.len())?;
    Ok(items)
}

fn bytes(value: Option<Variant<'_>>, expected: usize) -> Result<&[u8], MoveReplyError> {
    let array = value.and_then(|v| v.as_array()).filter(|array| array.element() == VarType::UI1);
    let array = array.ok_or_else(|| wrong(ReplyPart::UserIo, value))?;
    check_length(ReplyPart::UserIo, expected, array.len())?;
    Ok(array.as_bytes())
}

fn check_length(part: ReplyPart, expected: usize, found: usize) -> Result<(), MoveReplyError> {
    if found == expected {
        return Ok(());
    }
    Err(MoveReplyError { part, kind: MoveReplyErrorKind::Length { expected, found } })
}

fn wrong(part: ReplyPart, value: Option<Variant<'_>>) -> MoveReplyError {
    match value {
        Some(value) => wrong_type(part, value),
        None => MoveReplyError { part, kind: MoveReplyErrorKind::Missing },
    }
}

fn wrong_type(part: ReplyPart, value: Variant<'_>) -> MoveReplyError {
    MoveReplyError { part, kind: MoveReplyErrorKind::Type(value.vartype()) }
}

impl<'a> MoveReply<'a> {
    /// Returns the pose as it was received, with the length of the receive format's pose.
    #[must_use]
    pub const fn pose(&self) -> Items<'a, f64> {
        self.pose
    }

    /// Returns X, Y, Z, RX, RY, RZ and Fig, if the receive format has P or P+J.
    #[must_use]
    pub fn position(&self) -> Option<[f64; P_LEN]> {
        matches!(self.format.pose, ReceivePose::P | ReceivePose::PJ).then(|| self.part(0))
    }

    /// Returns X, Y, Z, both vectors and Fig, if the receive format has T or T+J.
    #[must_use]
    pub fn transform(&self) -> Option<[f64; T_LEN]> {
        matches!(self.format.pose, ReceivePose::T | ReceivePose::TJ).then(|| self.part(0))
    }

    /// Returns the joints, if the receive format has J, P+J or T+J; values of joints that the robot does not have may
    /// be other than 0.
    #[must_use]
    pub fn joints(&self) -> Option<[f64; J_LEN]> {
        self.format.pose.joints_at().map(|at| self.part(at))
    }

    fn part<const N: usize>(&self, at: usize) -> [f64; N] {
        let mut out = [0.0; N];
        for (slot, number) in out.iter_mut().zip(self.pose.iter().skip(at)) {
            *slot = number;
        }
        out
    }

    /// Returns the controller's time, if the receive format has it.
    #[must_use]
    pub fn timestamp(&self) -> Option<Timestamp> {
        Some(Timestamp { ticks: self.time?, unit: self.format.time? })
    }

    /// Returns the bits of MiniIO, if the receive format has them.
    #[must_use]
    pub const fn mini_io(&self) -> Option<i32> {
        self.mini_io
    }

    /// Returns the bytes of user IO, if the receive format has them.
    #[must_use]
    pub const fn user_io(&self) -> Option<&'a [u8]> {
        self.user_io
    }

    /// Returns the bits of HandIO, if the receive format has them.
    #[must_use]
    pub const fn hand_io(&self) -> Option<i32> {
        self.hand_io
    }

    /// Returns the motors' currents, if the receive format has them.
    #[must_use]
    pub const fn current(&self) -> Option<[f64; CURRENT_LEN]> {
        self.current
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for MoveReply<'_> {
    fn format(&self, f: defmt::Formatter<'_>) {
        let (joints, position) = (self.joints(), self.position());
        defmt::write!(f, "slvMove reply: time {}, joints {}, position {}", self.time, joints, position);
    }
}

impl fmt::Debug for MoveReply<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MoveReply")
            .field("time", &self.time)
            .field("pose", &self.pose)
            .field("mini_io", &self.mini_io)
            .field("user_io", &self.user_io)
            .field("hand_io", &self.hand_io)
            .field("current", &self.current)
            .finish()
    }
}
