//! The direction of a frame.

use std::str::FromStr;

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;

/// The role of a frame, which determines the meaning of its code. The bytes do not show it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// A client's request: the code is a function.
    #[default]
    Request,
    /// A server's response: the code is an HRESULT.
    Response,
}

impl Role {
    /// Returns the name of a code; `None` if it has no name.
    #[must_use]
    pub fn name_of(self, code: i32) -> Option<&'static str> {
        match self {
            Self::Request => FunctionId(code).name(),
            Self::Response => HResult(code).name(),
        }
    }

    /// Returns the code of a name; `None` if no code has it.
    #[must_use]
    pub fn code_of(self, name: &str) -> Option<i32> {
        match self {
            Self::Request => FunctionId::parse(name).map(|function| function.0),
            Self::Response => HResult::from_name(name).map(|code| code.0),
        }
    }

    /// Returns the arrow of the direction, as seen from the client.
    #[must_use]
    pub const fn arrow(self) -> &'static str {
        match self {
            Self::Request => "->",
            Self::Response => "<-",
        }
    }

    pub(crate) const fn sender(self) -> &'static str {
        match self {
            Self::Request => "client",
            Self::Response => "server",
        }
    }

    pub(crate) const fn index(self) -> usize {
        match self {
            Self::Request => 0,
            Self::Response => 1,
        }
    }
}

/// `request` or `response`.
impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "request" => Ok(Self::Request),
            "response" => Ok(Self::Response),
            _ => Err("it is request or response".into()),
        }
    }
}
