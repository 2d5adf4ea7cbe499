//! The contents of a capture: connections, calls and remarks.

use bcap_core::hresult::HResult;

use bcap_core::variant::OwnedVariant as Value;

/// An entry of the output, at nanoseconds since 1970.
#[derive(Clone, Debug)]
pub enum Event {
    /// A connection, or a pair of UDP ports, with its first packet.
    Link(Link),
    /// A call of b-CAP, or a request of RAC.
    Call(Call),
    /// A remark on the capture.
    Note(Note),
}

impl Event {
    /// Returns the time, in nanoseconds since 1970.
    #[must_use]
    pub fn at(&self) -> u64 {
        match self {
            Self::Link(link) => link.at,
            Self::Call(call) => call.at,
            Self::Note(note) => note.at,
        }
    }
}

/// A connection between a client and a server.
#[derive(Clone, Debug)]
pub struct Link {
    /// The time of its first packet, in nanoseconds since 1970.
    pub at: u64,
    /// `tcp1`, `udp2`.
    pub name: String,
    /// `b-CAP` or `RAC`.
    pub protocol: &'static str,
    /// The client's address.
    pub client: String,
    /// The server's address.
    pub server: String,
}

/// A remark on the capture, such as missing bytes.
#[derive(Clone, Debug)]
pub struct Note {
    /// The time, in nanoseconds since 1970.
    pub at: u64,
    /// The name of the connection.
    pub link: String,
    /// The remark, for people.
    pub text: String,
}

/// A call of b-CAP, or a request of RAC.
#[derive(Clone, Debug)]
pub struct Call {
    /// The time of the first attempt.
    pub at: u64,
    /// The name of the connection.
    pub link: String,
    /// The number of requests of the connection before it.
    pub number: u64,
    /// The serial number of the first attempt; `None` for RAC.
    pub serial: Option<u16>,
    /// `Variable_GetValue`, or `GET` and `PUT` of RAC.
    pub function: String,
    /// The command of a function that executes one.
    pub command: Option<String>,
    /// The arguments of the request.
    pub arguments: Vec<Argument>,
    /// The number of requests that were sent, with retransmissions.
    pub attempts: u32,
    /// The number of keep-alives: the server reported that the call was still running.
    pub executing: u32,
    /// `None` if the capture has no reply.
    pub reply: Option<Reply>,
}

/// An argument of a call.
#[derive(Clone, Debug)]
pub struct Argument {
    /// Its name in the specification.
    pub name: Option<&'static str>,
    /// `None` for the variable of a RAC request, which has no value on the wire.
    pub value: Option<Value>,
    /// The name of the object, if the argument is its handle.
    pub object: Option<String>,
}

/// The reply to a call.
#[derive(Clone, Debug)]
pub struct Reply {
    /// Nanoseconds since the first attempt.
    pub after: u64,
    /// The result.
    pub code: HResult,
    /// The value, if the reply has one.
    pub value: Option<Value>,
    /// The name of the object that the call opened.
    pub opened: Option<String>,
}

impl Call {
    /// Returns the function, with the command if it executes one: `Robot_Execute slvMove`.
    #[must_use]
    pub fn full_name(&self) -> String {
        match &self.command {
            Some(command) => format!("{} {command}", self.function),
            None => self.function.clone(),
        }
    }

    /// Returns the names of all objects that the call names, uses or opens.
    pub fn objects(&self) -> impl Iterator<Item = &str> {
        let opened = self.reply.iter().filter_map(|reply| reply.opened.as_deref());
        self.arguments.iter().filter_map(|argument| argument.object.as_deref()).chain(opened)
    }

    /// Returns the code of a call that failed.
    #[must_use]
    pub fn error(&self) -> Option<HResult> {
        self.reply.as_ref().map(|reply| reply.code).filter(|code| code.is_err())
    }
}
