//! What the servers of both protocols ask of an application: who calls, what, and what the answer is.
//!
//! A server checks bytes, types and time limits, then passes the request to a handler: the application's own code. A
//! handler never blocks. It answers at once with [`Outcome::Done`], or says with [`Outcome::Wait`] when it wants to be
//! asked again about the same request; in between the server serves others and keeps the caller patient.

use crate::error::EncodeError;
use crate::hresult::HResult;
use crate::storage::Storage;
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
///
/// # Examples
///
/// ```
/// use bcap_core::handler::ReplyValue;
/// use bcap_core::variant::Variant;
///
/// let mut buffer = [0; 64];
/// let mut reply = ReplyValue::new(&mut buffer);
/// reply.set(&7_i32)?;
/// assert_eq!(reply.get(), Some(Variant::I4(7)));
/// # Ok::<(), bcap_core::error::EncodeError>(())
/// ```
pub struct ReplyValue<'b> {
    memory: Memory<'b>,
    /// Where in the memory the value begins, and how large it may get.
    offset: usize,
    max: usize,
    /// Bytes of the value; 0 while there is none.
    len: usize,
    overflow: bool,
}

enum Memory<'b> {
    Slice(&'b mut [u8]),
    Storage(&'b mut dyn Storage),
}

impl Memory<'_> {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Slice(slice) => slice,
            Self::Storage(storage) => storage.bytes(),
        }
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        match self {
            Self::Slice(slice) => slice,
            Self::Storage(storage) => storage.bytes_mut(),
        }
    }

    fn grow(&mut self, len: usize) -> bool {
        match self {
            Self::Slice(slice) => slice.len() >= len,
            Self::Storage(storage) => storage.grow(len),
        }
    }
}

impl<'b> ReplyValue<'b> {
    /// Makes a place for a value of at most the size of `buffer`.
    #[must_use]
    pub const fn new(buffer: &'b mut [u8]) -> Self {
        let max = buffer.len();
        Self { memory: Memory::Slice(buffer), offset: 0, max, len: 0, overflow: false }
    }

    /// Makes a place for a value of at most `max` bytes, behind `offset` bytes of memory that may grow.
    pub(crate) const fn behind(storage: &'b mut dyn Storage, offset: usize, max: usize) -> Self {
        Self { memory: Memory::Storage(storage), offset, max, len: 0, overflow: false }
    }

    /// Sets the value; one that was set before is replaced.
    ///
    /// # Errors
    ///
    /// An [`EncodeError`] when the value does not fit; there is no value then, and the server will answer
    /// E_TOO_MUCH_DATA whatever the outcome says.
    pub fn set<T: Encode + ?Sized>(&mut self, value: &T) -> Result<(), EncodeError> {
        self.clear();
        loop {
            let end = self.offset.saturating_add(self.max);
            let memory = self.memory.bytes_mut();
            let room = memory.len().min(end);
            let mut out = Writer::new(memory.get_mut(self.offset..room).unwrap_or_default());
            match value.encode(&mut out) {
                Ok(()) => {
                    self.len = out.len();
                    return Ok(());
                }
                Err(EncodeError::Full) if room < end && self.memory.grow(room.saturating_mul(2).max(64).min(end)) => {}
                Err(error) => {
                    self.overflow = true;
                    return Err(error);
                }
            }
        }
    }

    /// Removes the value.
    pub const fn clear(&mut self) {
        self.len = 0;
        self.overflow = false;
    }

    /// Views the value.
    #[must_use]
    pub fn get(&self) -> Option<Variant<'_>> {
        let bytes = self.as_bytes();
        (!bytes.is_empty()).then(|| Variant::from_checked(bytes))
    }

    /// Returns the value's encoding, empty while there is none.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.memory.bytes().get(self.offset..).and_then(|rest| rest.get(..self.len)).unwrap_or_default()
    }

    /// Tells whether the last value that was to be set did not fit.
    #[must_use]
    pub const fn is_overflow(&self) -> bool {
        self.overflow
    }
}

impl core::fmt::Debug for ReplyValue<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_tuple("ReplyValue").field(&self.get()).finish()
    }
}
