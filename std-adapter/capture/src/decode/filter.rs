//! Selects events of a capture.

use std::str::FromStr;
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;

use super::call::{Call, Event};

/// Selects events. The default selects all of them.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    /// Only calls of this function, as [`function_name`] returns it.
    pub function: Option<String>,
    /// Only calls that use or open this object, such as `I1`, `robot` or `task:Pro1`.
    pub object: Option<String>,
    /// Only calls with these results.
    pub error: Option<ErrorFilter>,
    /// Only events at this time since the first event or later.
    pub from: Option<Duration>,
    /// Only events before this time since the first event.
    pub until: Option<Duration>,
}

/// The results that a filter accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorFilter {
    /// Calls that failed or have no reply.
    Any,
    /// Calls with this code, even a success code.
    Code(HResult),
}

impl Filter {
    /// Returns whether an event is selected, of a capture that began at nanoseconds since 1970. Connections and remarks are
    /// selected only by time.
    #[must_use]
    pub fn accepts(&self, event: &Event, began: u64) -> bool {
        let after = Duration::from_nanos(event.at().saturating_sub(began));
        if self.from.is_some_and(|from| after < from) || self.until.is_some_and(|until| after >= until) {
            return false;
        }
        match event {
            Event::Call(call) => self.accepts_call(call),
            Event::Link(_) | Event::Note(_) => self.function.is_none() && self.object.is_none() && self.error.is_none(),
        }
    }

    fn accepts_call(&self, call: &Call) -> bool {
        let has = |wanted: &String| call.objects().any(|name| is_object(name, wanted));
        self.function.as_ref().is_none_or(|name| *name == call.function)
            && self.object.as_ref().is_none_or(has)
            && match self.error {
                None => true,
                Some(ErrorFilter::Any) => call.reply.is_none() || call.error().is_some(),
                Some(ErrorFilter::Code(code)) => call.reply.as_ref().is_some_and(|reply| reply.code == code),
            }
    }
}

/// `any`, the name of a code, or its number.
impl FromStr for ErrorFilter {
    type Err = String;

    fn from_str(code: &str) -> Result<Self, String> {
        if code.eq_ignore_ascii_case("any") {
            return Ok(Self::Any);
        }
        let digits = code.strip_prefix("0x").or_else(|| code.strip_prefix("0X"));
        let number = match digits {
            Some(digits) => u32::from_str_radix(digits, 16).ok().map(HResult::from_u32),
            None => code.parse().ok().map(HResult).or_else(|| HResult::from_name(code)),
        };
        number.map(Self::Code).ok_or_else(|| {
            format!("no result code is named {code:?}; write a name, a number such as 0x80070057, or any")
        })
    }
}

/// Returns the name of a function as captures have it, from its name in any notation or its number; GET and PUT are those of RAC.
///
/// # Errors
///
/// When no function has the name.
pub fn function_name(name: &str) -> Result<String, String> {
    if ["GET", "PUT"].iter().any(|verb| name.eq_ignore_ascii_case(verb)) {
        return Ok(name.to_ascii_uppercase());
    }
    let known = FunctionId::parse(name).map(|function| function.to_string());
    known.ok_or_else(|| format!("no function is named {name:?}; write a name of `bcap call --list`, GET or PUT"))
}

/// Returns whether an object is the wanted object, or belongs to it.
pub(crate) fn is_object(name: &str, wanted: &str) -> bool {
    name.eq_ignore_ascii_case(wanted)
        || name.split('/').any(|part| part.eq_ignore_ascii_case(wanted))
        || name.split(['/', ':']).any(|part| part.eq_ignore_ascii_case(wanted))
}
