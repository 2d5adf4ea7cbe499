//! Findings, and how duplicates are detected.

use std::fmt;

use bcap_core::bcap::FunctionId;

/// A kind of finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// No new connection is possible.
    Crash,
    /// No reply arrived, and the connection did not end.
    Hang,
    /// The device closed the connection after a valid frame or line.
    Reset,
    /// A reply that the protocol does not allow.
    WrongReply,
    /// A handle that is not open is valid.
    Handle,
    /// An object or a client that was served before is refused.
    Leak,
}

impl Kind {
    /// Returns the word for file names and output.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Crash => "crash",
            Self::Hang => "hang",
            Self::Reset => "reset",
            Self::WrongReply => "wrong-reply",
            Self::Handle => "handle",
            Self::Leak => "leak",
        }
    }
}

/// A finding.
#[derive(Clone, Debug)]
pub struct Finding {
    /// Its kind.
    pub kind: Kind,
    /// The request: a function, `bytes` or `RAC`.
    pub subject: String,
    /// The fault in words.
    pub detail: String,
}

impl Finding {
    pub(super) fn new(kind: Kind, subject: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { kind, subject: subject.into(), detail: detail.into() }
    }

    pub(super) fn of_function(kind: Kind, function: i32, detail: impl Into<String>) -> Self {
        Self::new(kind, FunctionId(function).to_string(), detail)
    }

    /// Returns whether both are probably the same fault. A crash is detected only after its session, so all crashes count as
    /// the same.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        self.kind == other.kind && (self.kind == Kind::Crash || self.subject == other.subject)
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}: {}", self.kind.name(), self.subject, self.detail)
    }
}
