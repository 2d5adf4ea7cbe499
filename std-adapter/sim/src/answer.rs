//! The result of a function or command that is not refused.

use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, OwnedVariant};

use crate::value::owned;
use crate::waits::Wait;

/// The result of a call.
#[derive(Debug, PartialEq)]
pub(crate) enum Answer {
    /// `S_OK` without a value.
    Done,
    /// `S_OK` with a value.
    Value(OwnedVariant),
    /// A code that is not a refusal: a success code other than `S_OK`, or the failure of an awaited event.
    Code(HResult),
    /// A success code with a value.
    Coded(HResult, OwnedVariant),
    /// The call has started something that takes time, and is answered when that ends.
    Until(Wait),
    /// The call is polled again at this time.
    Poll(Instant),
}

/// The result of a call, or the code with which it is refused.
pub(crate) type Answered = Result<Answer, HResult>;

impl From<OwnedVariant> for Answer {
    fn from(value: OwnedVariant) -> Self {
        Self::Value(value)
    }
}

impl Answer {
    /// Makes `S_OK` with a value.
    pub(crate) fn of(value: impl Encode) -> Answered {
        owned(value).map(Self::Value)
    }

    /// Creates an array of names.
    pub(crate) fn names<T: Into<String>>(list: impl IntoIterator<Item = T>) -> Answered {
        Self::of(list.into_iter().map(Into::into).collect::<Vec<String>>())
    }

    /// Creates `S_OK`, or `S_FALSE` for a call that had nothing to do.
    pub(crate) fn done_if(done: bool) -> Self {
        if done { Self::Done } else { Self::Code(HResult::S_FALSE) }
    }

    /// Adds the EMPTY value that commands answer and other functions do not.
    pub(crate) fn of_command(self) -> Self {
        match self {
            Self::Done => OwnedVariant::EMPTY.into(),
            answer => answer,
        }
    }
}
