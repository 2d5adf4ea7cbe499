//! The language of cases: requests, and conditions for the replies.

use std::fmt;

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use serde::Serialize;

/// The effect of a case on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Changes nothing on the device: it opens, reads and releases objects, and sends invalid frames.
    Read,
    /// Writes the scratch variables and restores them.
    Write,
    /// Takes the arm, switches the motor on and moves the robot a little.
    Motion,
}

/// The subject of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Group {
    /// The bytes of a frame.
    Frames,
    /// The number and the types of arguments.
    Arguments,
    /// The encoding of values, and the types of the values in replies.
    Types,
    /// Service_Start to Service_Stop.
    Sessions,
    /// Pauses within frames, time limits and keep-alives.
    Timeouts,
    /// Copies of calls over UDP.
    Udp,
    /// The handles of objects.
    Handles,
    /// User variables and system variables.
    Variables,
    /// Task objects.
    Tasks,
    /// Slave Mode.
    Slave,
    /// The text protocol.
    Rac,
    /// Answers of real controllers that no specification describes. A difference is not a failure.
    Seen,
}

impl Group {
    /// All groups, in the order in which they run.
    pub const ALL: [Self; 12] = [
        Self::Frames,
        Self::Arguments,
        Self::Types,
        Self::Sessions,
        Self::Timeouts,
        Self::Udp,
        Self::Handles,
        Self::Variables,
        Self::Tasks,
        Self::Slave,
        Self::Rac,
        Self::Seen,
    ];

    /// Returns the name, as in the names of its cases.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Arguments => "arguments",
            Self::Types => "types",
            Self::Sessions => "sessions",
            Self::Timeouts => "timeouts",
            Self::Udp => "udp",
            Self::Handles => "handles",
            Self::Variables => "variables",
            Self::Tasks => "tasks",
            Self::Slave => "slave",
            Self::Rac => "rac",
            Self::Seen => "seen",
        }
    }
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A model of controller on which answers were observed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Model {
    /// RC8 or RC8A.
    Rc8,
    Rc9,
    Cobotta,
    CobottaPro,
}

impl Model {
    /// All models, with their words in the tables.
    pub(crate) const WORDS: [(&'static str, Self); 4] =
        [("rc8", Self::Rc8), ("rc9", Self::Rc9), ("cobotta", Self::Cobotta), ("cobotta-pro", Self::CobottaPro)];
}

impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Rc8 => "RC8",
            Self::Rc9 => "RC9",
            Self::Cobotta => "COBOTTA",
            Self::CobottaPro => "COBOTTA PRO",
        })
    }
}

/// The objects that exist before the steps of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Setup {
    /// Nothing: the case speaks RAC.
    Rac,
    /// A connection.
    Connected,
    /// A session.
    Started,
    /// The handle of the controller.
    Controller,
    /// The handles of controller and robot.
    Robot,
    /// The handles of controller and task.
    Task,
    /// Controller and robot; the arm is taken and the motor on.
    Arm,
}

/// A slot that stores a handle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Slot {
    Controller,
    Robot,
    Task,
    A,
    B,
}

impl Slot {
    pub(crate) const COUNT: usize = 5;
}

/// An argument of a call.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Arg {
    /// The handle in a slot, as I4.
    H(Slot),
    /// The handle in a slot, as UI4.
    Unsigned(Slot),
    I(i32),
    S(&'static str),
    /// A value in the text of RAC.
    V(&'static str),
    /// The name of the scratch variable of a kind.
    Scratch(&'static str),
}

/// The condition for a reply.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Want {
    /// Success.
    Ok,
    /// Success without a value, or with EMPTY.
    NoValue,
    /// Success with a value of this VARTYPE.
    Type(u16),
    /// Success with an array of elements of this VARTYPE; any number of them if it is 0.
    Array(u16, usize),
    /// Success with this value, in the text of RAC.
    Value(&'static str),
    /// One of these codes.
    Code(&'static [HResult]),
    /// Any error.
    Refused,
}

/// One step of a case.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Step {
    /// Makes a call and checks its reply. A function that the device does not have skips the case.
    Call(FunctionId, &'static [Arg], Want),
    /// The same, but a device without this function fails the case.
    Must(FunctionId, &'static [Arg], Want),
    /// Makes a call that returns a handle, and stores the handle.
    Open(Slot, FunctionId, &'static [Arg]),
    /// Two handles must differ.
    Differ(Slot, Slot),
    /// Sends Service_Start with changed bytes.
    Edited(&'static [Edit], Reaction),
    /// Makes a call whose request is sent in pieces of these numbers of bytes.
    Pieces(&'static [usize]),
    /// Sends the last request again: with the next serial and the serial of the first attempt, or unchanged. The reply
    /// must equal the reply to the first attempt.
    Copy { renumbered: bool },
    /// Ends the connection and starts another session; handles keep their slots.
    Reconnect,
    /// Ends the connection, starts another session and connects to the controller.
    ReconnectController,
    /// Connects to the controller once more.
    ConnectController,
    /// Saves the value of the scratch variable of a kind, to restore it after the case.
    Save(&'static str),
    /// Sends a line of RAC and checks the answer.
    Line(&'static str, LineWant),
    /// Executes a step as another client, in a new session with controller and robot.
    Other(&'static Step),
    /// Stores the current joints.
    Here,
    /// Sends the stored joints as a pose of Slave Mode.
    SlvMove(Want),
}

/// A change of a valid Service_Start.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Edit {
    /// Sets the function.
    Function(FunctionId),
    /// Appends raw bytes as the arguments, with this number of arguments; the length is adjusted.
    Body(u16, &'static [u8]),
    /// Sets a byte, counted from the start.
    Byte(usize, u8),
    /// Sets the last byte.
    Last(u8),
    /// Sets the length field.
    Length(u32),
    /// Adds to the length field.
    Longer(i32),
    /// Sets the number of arguments.
    Count(u16),
    /// Sets the reserved field.
    Reserved(u16),
    /// Sets the serial.
    Serial(u16),
    /// Sends bytes before the frame.
    Before(&'static [u8]),
    /// Sends bytes after the frame.
    After(&'static [u8]),
    /// Sends only the first bytes.
    Cut(usize),
    /// Makes the argument a value nested to this depth.
    Nested(usize),
}

/// The permitted reactions to an edited frame. In all cases the device must serve the next session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reaction {
    /// A reply of success with the serial of the request.
    Served,
    /// An error, or the end of the connection; over UDP also silence.
    Refused,
    /// An error or the end of the connection within the time limit; or a reply of success.
    Ends,
    /// The stream continues with the next frame, or ends; over UDP silence.
    Resync,
}

/// The condition for the answer to a line.
#[derive(Clone, Copy, Debug)]
pub(crate) enum LineWant {
    /// Success with a value of this VARTYPE and number of elements; 0 for a scalar.
    Type(u16, usize),
    /// Success without a value.
    Done,
    /// One of these codes.
    Code(&'static [HResult]),
    /// Any error.
    Refused,
}
