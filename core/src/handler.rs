//! What the servers of both protocols ask of an application: who calls, what, and what the answer is.
//!
//! A server checks bytes, types and time limits, then passes the request to a handler: the application's own code. A
//! handler never blocks. It answers at once with [`Outcome::Done`], or says with [`Outcome::Wait`] when it wants to be
//! asked again about the same request; in between the server serves others and keeps the caller patient.

use crate::error::EncodeError;
use crate::hresult::HResult;
use crate::time::Instant;
use crate::variant::{Encode, Variant, Writer};

/// A client of a server, as long as its session lasts; whoever runs the server numbers them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PeerId(pub u32);

/// What a handler says about a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Outcome {
    /// The request has been carried out, or refused; the reply goes out with the value that was set.
    Done(HResult),
    /// The request is still being carried out: ask again, with the same request, at this time or earlier.
    ///
    /// [`Instant::FAR_FUTURE`] waits for another request to change something.
    Wait(Instant),
}

impl From<HResult> for Outcome {
    fn from(result: HResult) -> Self {
        Self::Done(result)
    }
}

/// Where a handler puts the value of its reply; at most one.
#[derive(Debug)]
pub struct ReplyValue<'b> {
    buffer: &'b mut [u8],
    /// Bytes of the value in `buffer`; 0 while there is none.
    len: usize,
}

impl<'b> ReplyValue<'b> {
    /// Makes a place for a value of at most the size of `buffer`.
    #[must_use]
    pub const fn new(buffer: &'b mut [u8]) -> Self {
        Self { buffer, len: 0 }
    }

    /// Sets the value; one that was set before is replaced.
    ///
    /// # Errors
    ///
    /// An [`EncodeError`] when the value does not fit; there is no value then.
    pub fn set<T: Encode + ?Sized>(&mut self, value: &T) -> Result<(), EncodeError> {
        self.len = 0;
        let mut out = Writer::new(self.buffer);
        value.encode(&mut out)?;
        self.len = out.len();
        Ok(())
    }

    /// Removes the value.
    pub const fn clear(&mut self) {
        self.len = 0;
    }

    /// Views the value.
    #[must_use]
    pub fn get(&self) -> Option<Variant<'_>> {
        let bytes = self.buffer.get(..self.len)?;
        (!bytes.is_empty()).then(|| Variant::from_checked(bytes))
    }

    /// Returns the value's encoding, empty while there is none.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.buffer.get(..self.len).unwrap_or_default()
    }
}
