//! The contents of a capture: connections, calls and remarks.

use bcap_core::hresult::HResult;

use crate::value::Value;

/// An entry of the output, at nanoseconds since 1970.
#[derive(Debug)]
pub(crate) enum Event {
    /// A connection, or a pair of UDP ports, with its first packet.
    Link(Link),
    Call(Call),
    Note(Note),
}

impl Event {
    pub(crate) fn at(&self) -> u64 {
        match self {
            Self::Link(link) => link.at,
            Self::Call(call) => call.at,
            Self::Note(note) => note.at,
        }
    }
}

/// A connection between a client and a server.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    pub(crate) at: u64,
    /// `tcp1`, `udp2`.
    pub(crate) name: String,
    pub(crate) protocol: &'static str,
    pub(crate) client: String,
    pub(crate) server: String,
}

/// A remark on the capture, such as missing bytes.
#[derive(Debug)]
pub(crate) struct Note {
    pub(crate) at: u64,
    pub(crate) link: String,
    pub(crate) text: String,
}

/// A call of b-CAP, or a request of RAC.
#[derive(Clone, Debug)]
pub(crate) struct Call {
    /// The time of the first attempt.
    pub(crate) at: u64,
    pub(crate) link: String,
    /// Its place among the requests of its connection.
    pub(crate) number: u64,
    /// The serial number of the first attempt; `None` for RAC.
    pub(crate) serial: Option<u16>,
    /// `Variable_GetValue`, or `GET` and `PUT` of RAC.
    pub(crate) function: String,
    /// The command of a function that executes one.
    pub(crate) command: Option<String>,
    pub(crate) arguments: Vec<Argument>,
    pub(crate) attempts: u32,
    /// How often the server said that the call is still running.
    pub(crate) executing: u32,
    pub(crate) reply: Option<Reply>,
}

/// An argument of a call.
#[derive(Clone, Debug)]
pub(crate) struct Argument {
    pub(crate) name: Option<&'static str>,
    /// `None` for the variable of a RAC request, which has no value on the wire.
    pub(crate) value: Option<Value>,
    /// The name of the object, if the argument is its handle.
    pub(crate) object: Option<String>,
}

/// The reply to a call.
#[derive(Clone, Debug)]
pub(crate) struct Reply {
    /// Nanoseconds since the first attempt.
    pub(crate) after: u64,
    pub(crate) code: HResult,
    pub(crate) value: Option<Value>,
    /// The name of the object that the call opened.
    pub(crate) opened: Option<String>,
}

impl Call {
    /// Returns the function, with the command if it executes one: `Robot_Execute slvMove`.
    pub(crate) fn title(&self) -> String {
        match &self.command {
            Some(command) => format!("{} {command}", self.function),
            None => self.function.clone(),
        }
    }

    /// Returns the names of all objects that the call names, uses or opens.
    pub(crate) fn objects(&self) -> impl Iterator<Item = &str> {
        let opened = self.reply.iter().filter_map(|reply| reply.opened.as_deref());
        self.arguments.iter().filter_map(|argument| argument.object.as_deref()).chain(opened)
    }

    /// Returns the code of a call that failed.
    pub(crate) fn error(&self) -> Option<HResult> {
        self.reply.as_ref().map(|reply| reply.code).filter(|code| code.is_err())
    }
}
