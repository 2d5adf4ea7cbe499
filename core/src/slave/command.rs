//! The five commands of Slave Mode, and slvMove as a frame that is written once and then patched.
//!
//! ```text
//!  offset  slvMove of a pose alone            with anything else
//!      15  length | I4 robot                  (the same)
//!      29  length | BSTR "slvMove"            (the same)
//!      57  length                             length
//!      61  ARRAY|R8, count                    ARRAY|VARIANT, count
//!      67  numbers                            ARRAY|R8, count
//!      73                                     numbers, then the elements of the send format
//! ```
//!
//! The offsets are fixed for a stream; a cycle changes the numbers, the outputs and the serial.

use core::fmt;
use core::marker::PhantomData;

use super::format::{Format, FormatError, ReceiveFormat, SendFormat, SendIo, UserIo};
use super::mode::SlaveMode;
use super::pose::Pose;
use crate::bcap::call::{Any, Call, Int, Nothing, Reply, RobotHandle};
use crate::bcap::{FrameWriter, FunctionId, HEADER_LEN};
use crate::error::EncodeError;
use crate::variant::{Encode, VarType, Writer};

/// Creates the call that enters a mode, or leaves Slave Mode with `None`. The reply to leaving arrives when the buffer is
/// empty.
#[must_use]
pub fn change_mode(robot: RobotHandle, mode: Option<SlaveMode>) -> impl Call<Reply = Nothing> {
    ExecuteCall::new(robot, "slvChangeMode", mode.map_or(SlaveMode::OFF, SlaveMode::code))
}

/// Creates the call that reads the mode; [`SlaveMode::from_code`] decodes the reply.
#[must_use]
pub fn get_mode(robot: RobotHandle) -> impl Call<Reply = Int> {
    ExecuteCall::new(robot, "slvGetMode", ())
}

/// Creates the call that sets the layout of slvMove. Send it before Slave Mode is entered.
#[must_use]
pub fn send_format(robot: RobotHandle, format: SendFormat) -> impl Call<Reply = Nothing> {
    ExecuteCall::new(robot, "slvSendFormat", format.code())
}

/// Creates the call that sets the layout of the reply to slvMove. Send it before Slave Mode is entered.
#[must_use]
pub fn receive_format(robot: RobotHandle, format: ReceiveFormat) -> impl Call<Reply = Nothing> {
    ExecuteCall::new(robot, "slvRecvFormat", format)
}

/// Creates the call that moves the robot; [`ReceiveFormat::read`] decodes the reply.
///
/// For a stream, [`PreparedMove`] is faster: it does not write the whole frame for each pose.
///
/// # Errors
///
/// When the pose or the user IO does not have the layout of the format.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::call::RobotHandle;
/// use bcap_core::slave::{self, Format, Mode, Outputs, Pose, PoseType, ReceiveFormat, ReceivePose, SlaveMode};
///
/// let mode = SlaveMode { mode: Mode::Mode0, pose: PoseType::P };
/// let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
/// let pose = Pose::p([364.16, 0.0, 278.5, 180.0, 0.0, 180.0, 5.0]);
/// let call = slave::slv_move(RobotHandle(3), &format, &pose, Outputs::default())?;
/// # let _ = call;
/// assert!(slave::slv_move(RobotHandle(3), &format, &Pose::j([0.0; 8]), Outputs::default()).is_err());
/// # Ok::<(), slave::FormatError>(())
/// ```
pub fn slv_move<'a>(
    robot: RobotHandle,
    format: &'a Format,
    pose: &'a Pose,
    outputs: Outputs<'a>,
) -> Result<impl Call<Reply = Any> + use<'a>, FormatError> {
    check_shape(format, pose)?;
    match format.send.io {
        SendIo::User(range) => check_user_io(range, outputs.user_io)?,
        SendIo::None | SendIo::Mini => {}
    }
    Ok(ExecuteCall::<_, Any>::new(robot, MOVE, Parameter { format, pose, outputs }))
}

const MOVE: &str = "slvMove";

/// The outputs that slvMove sets in addition to the pose; those that the format does not send are ignored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Outputs<'a> {
    /// The bits of MiniIO.
    pub mini_io: i32,
    /// The bits of HandIO.
    pub hand_io: i32,
    /// The bytes of user IO.
    pub user_io: &'a [u8],
}

/// A call of Robot_Execute: a command with its parameter.
struct ExecuteCall<P, R> {
    robot: RobotHandle,
    name: &'static str,
    parameter: P,
    reply: PhantomData<R>,
}

impl<P, R> ExecuteCall<P, R> {
    const fn new(robot: RobotHandle, name: &'static str, parameter: P) -> Self {
        Self { robot, name, parameter, reply: PhantomData }
    }
}

impl<P: Encode, R: Reply> Call for ExecuteCall<P, R> {
    type Reply = R;

    fn function(&self) -> FunctionId {
        FunctionId::ROBOT_EXECUTE
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        frame.argument(&self.robot)?;
        frame.argument(self.name)?;
        frame.argument(&self.parameter)
    }
}

/// The parameter of slvMove.
struct Parameter<'a> {
    format: &'a Format,
    pose: &'a Pose,
    outputs: Outputs<'a>,
}

impl Encode for Parameter<'_> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        let Self { format, pose, outputs } = self;
        let items = format.items();
        if items > 1 {
            out.put(VarType::VARIANT.array_of().0.to_le_bytes())?;
            out.put(items.to_le_bytes())?;
        }
        pose.as_slice().encode(out)?;
        match format.send.io {
            SendIo::None => {}
            SendIo::Mini => outputs.mini_io.encode(out)?,
            SendIo::User(range) => {
                range.on_wire().iter().try_for_each(|n| n.encode(out))?;
                outputs.user_io.encode(out)?;
            }
        }
        if let Some(range) = format.receive.user_io {
            range.on_wire().iter().try_for_each(|n| n.encode(out))?;
        }
        if format.send.hand_io {
            outputs.hand_io.encode(out)?;
        }
        Ok(())
    }
}

fn check_shape(format: &Format, pose: &Pose) -> Result<(), FormatError> {
    let (expected, found) = (format.layout(), pose.layout());
    if expected == found { Ok(()) } else { Err(FormatError::Layout { expected, found }) }
}

fn check_user_io(range: UserIo, bytes: &[u8]) -> Result<(), FormatError> {
    let (expected, found) = (range.bytes(), bytes.len());
    if usize::from(expected) == found { Ok(()) } else { Err(FormatError::UserIoLength { expected, found }) }
}

/// Bytes of `u32 length | VARTYPE, count`.
const ARGUMENT_HEAD: usize = 4 + HEAD;
/// Bytes of VARTYPE and count.
pub(super) const HEAD: usize = 6;
/// The offset of the parameter of slvMove: after the header, the robot (I4), the name (BSTR of 7 characters) and the
/// parameter's length.
pub(super) const PARAMETER: usize = HEADER_LEN + (ARGUMENT_HEAD + 4) + (ARGUMENT_HEAD + 4 + 14) + 4;
/// The size of a buffer for a [`PreparedMove`] of any format without user IO to send, in bytes.
pub const MOVE_FRAME: usize = 256;

/// A slvMove whose frame is written once; each cycle patches numbers into it.
///
/// As a [`Call`] it costs one copy: the client copies the frame and sets the serial. `N` is the size of the buffer; 256
/// bytes suffice for every format with up to 20 bytes of user IO to send.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::call::RobotHandle;
/// use bcap_core::bcap::client::{Client, Config, Timing};
/// use bcap_core::endpoint::Endpoint;
/// use bcap_core::slave::{Format, Mode, Pose, PoseType, PreparedMove, ReceiveFormat, ReceivePose, SlaveMode};
/// use bcap_core::time::Instant;
///
/// let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
/// let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
/// let mut slv_move = PreparedMove::<256>::new(RobotHandle(3), &format)?;
/// let mut client = Client::new(Config::TCP, [0; 512], [0; 512]);
///
/// slv_move.set_pose(&Pose::j([0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0]))?;
/// client.start(&slv_move, Timing::TCP, Instant::ZERO)?;
/// assert_eq!(client.transmit().len(), 132);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct PreparedMove<const N: usize = MOVE_FRAME> {
    /// A complete frame without CRC, with serial 0.
    frame: [u8; N],
    len: usize,
    format: Format,
    robot: RobotHandle,
    /// The start and the end of the numbers of the pose.
    numbers: usize,
    end: usize,
}

impl<const N: usize> PreparedMove<N> {
    /// Writes the frame; the pose and the outputs are 0 until they are set.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] when the frame does not fit `N` bytes.
    pub fn new(robot: RobotHandle, format: &Format) -> Result<Self, EncodeError> {
        let layout = format.layout();
        let pose = Pose::zero(layout);
        let zeros = [0; 255];
        let user_io = match format.send.io {
            SendIo::User(range) => zeros.get(..usize::from(range.bytes())).unwrap_or_default(),
            SendIo::None | SendIo::Mini => &[],
        };
        let parameter = Parameter { format, pose: &pose, outputs: Outputs { mini_io: 0, hand_io: 0, user_io } };
        let call = ExecuteCall::<_, Any>::new(robot, MOVE, parameter);
        let mut frame = [0; N];
        let mut writer = FrameWriter::new(&mut frame)?;
        call.arguments(&mut writer)?;
        let len = writer.finish(0, 0, call.function().0)?.len();
        let outer = if format.items() > 1 { HEAD } else { 0 };
        let numbers = (PARAMETER + HEAD).wrapping_add(outer);
        let end = numbers.wrapping_add(layout.len().wrapping_mul(size_of::<f64>()));
        Ok(Self { frame, len, format: *format, robot, numbers, end })
    }

    /// Puts a pose into the frame.
    ///
    /// # Errors
    ///
    /// [`FormatError::Layout`] when its type or its extended joints differ from the format's.
    #[inline]
    pub fn set_pose(&mut self, pose: &Pose) -> Result<(), FormatError> {
        check_shape(&self.format, pose)?;
        let slots = self.frame.get_mut(self.numbers..self.end).unwrap_or_default().as_chunks_mut().0;
        // the layouts are equal, so the slots end where the numbers of the layout end
        for (slot, number) in slots.iter_mut().zip(pose.padded()) {
            *slot = number.to_le_bytes();
        }
        Ok(())
    }

    /// Sets the bits of MiniIO.
    ///
    /// # Errors
    ///
    /// [`FormatError::NoMiniIo`] when the format does not send it.
    pub fn set_mini_io(&mut self, bits: i32) -> Result<(), FormatError> {
        if self.format.send.io != SendIo::Mini {
            return Err(FormatError::NoMiniIo);
        }
        self.patch(self.end.wrapping_add(HEAD), &bits.to_le_bytes());
        Ok(())
    }

    /// Sets the bytes of user IO.
    ///
    /// # Errors
    ///
    /// [`FormatError::NoUserIo`] when the format does not send it, [`FormatError::UserIoLength`] when it sends another number
    /// of bytes.
    pub fn set_user_io(&mut self, bytes: &[u8]) -> Result<(), FormatError> {
        let SendIo::User(range) = self.format.send.io else { return Err(FormatError::NoUserIo) };
        check_user_io(range, bytes)?;
        // after offset and size, two I4
        self.patch(self.end.wrapping_add(2 * (HEAD + 4) + HEAD), bytes);
        Ok(())
    }

    /// Sets the bits of HandIO.
    ///
    /// # Errors
    ///
    /// [`FormatError::NoHandIo`] when the format does not send it.
    pub fn set_hand_io(&mut self, bits: i32) -> Result<(), FormatError> {
        if !self.format.send.hand_io {
            return Err(FormatError::NoHandIo);
        }
        // it is the last element, before EOT
        self.patch(self.len.wrapping_sub(1 + 4), &bits.to_le_bytes());
        Ok(())
    }

    /// Sets those outputs that the format sends.
    ///
    /// # Errors
    ///
    /// [`FormatError::UserIoLength`] when the user IO has another number of bytes than the format's.
    pub fn set_outputs(&mut self, outputs: Outputs<'_>) -> Result<(), FormatError> {
        match self.format.send.io {
            SendIo::None => {}
            SendIo::Mini => self.set_mini_io(outputs.mini_io)?,
            SendIo::User(_) => self.set_user_io(outputs.user_io)?,
        }
        if self.format.send.hand_io { self.set_hand_io(outputs.hand_io) } else { Ok(()) }
    }

    fn patch(&mut self, at: usize, bytes: &[u8]) {
        let target = self.frame.get_mut(at..).unwrap_or_default();
        for (slot, byte) in target.iter_mut().zip(bytes) {
            *slot = *byte;
        }
    }

    /// Returns the frame without CRC; its serial and reserved field are 0.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.frame.get(..self.len).unwrap_or_default()
    }

    /// Returns the format.
    #[must_use]
    pub const fn format(&self) -> &Format {
        &self.format
    }

    /// Views it as a call of a type without `N`.
    pub(super) fn view(&self) -> MoveCall<'_> {
        MoveCall { robot: self.robot, frame: self.as_bytes() }
    }
}

impl<const N: usize> fmt::Debug for PreparedMove<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PreparedMove")
            .field("robot", &self.robot)
            .field("format", &self.format)
            .field("len", &self.len)
            .finish_non_exhaustive()
    }
}

impl<const N: usize> Call for PreparedMove<N> {
    type Reply = Any;

    #[inline]
    fn function(&self) -> FunctionId {
        FunctionId::ROBOT_EXECUTE
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        self.view().arguments(frame)
    }

    #[inline]
    fn prepared(&self) -> Option<&[u8]> {
        Some(self.as_bytes())
    }
}

/// The frame of a [`PreparedMove`].
#[derive(Clone, Copy, Debug)]
pub(super) struct MoveCall<'a> {
    robot: RobotHandle,
    pub(super) frame: &'a [u8],
}

impl MoveCall<'_> {
    /// Appends the arguments, for serial lines, whose frames have a CRC.
    pub(super) fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        frame.argument(&self.robot)?;
        frame.argument(MOVE)?;
        let parameter = self.frame.get(PARAMETER..self.frame.len().saturating_sub(1)).unwrap_or_default();
        frame.argument(&Encoded(parameter))
    }
}

/// An encoded value.
struct Encoded<'a>(&'a [u8]);

impl Encode for Encoded<'_> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        out.put_slice(self.0)
    }
}

const _: () = assert!(PARAMETER == 61, "the table at the top of this file contains this offset");
