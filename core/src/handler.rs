//! The types that the handlers of both protocols share: the peer, the outcome of a request, and the value of the reply.
//!
//! A handler is the application behind a server, [`bcap::server::Handler`](crate::bcap::server::Handler) or
//! [`rac::server::Handler`](crate::rac::server::Handler). The server checks bytes, types and time limits, then calls the
//! handler. A handler must not block. It returns [`Outcome::Done`] with the result, or [`Outcome::Wait`] with the time at
//! which the server calls it again for the same request. Until then the server serves other peers, and sends keep-alives.

use crate::error::EncodeError;
use crate::hresult::HResult;
use crate::storage::Storage;
use crate::time::Instant;
use crate::variant::{Encode, Variant, Writer};

/// The number of a client for the duration of its session, assigned by the code that runs the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PeerId(pub u32);

/// The outcome of a handler's call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Outcome {
    /// The request was executed or refused. The reply carries this result and the value that was set.
    Done(HResult),
    /// The request is still being executed: call the handler again with the same request, at this time or earlier.
    ///
    /// [`Instant::FAR_FUTURE`] waits for an event, such as another request.
    Wait(Instant),
}

impl From<HResult> for Outcome {
    fn from(result: HResult) -> Self {
        Self::Done(result)
    }
}

/// The value of a reply, set by a handler.
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
    /// The position of the value in the memory, its maximum length, and the bytes needed after it.
    offset: usize,
    max: usize,
    tail: usize,
    /// The length of the value in bytes; 0 without a value.
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

    fn shrink(&mut self, len: usize) {
        match self {
            Self::Slice(_) => {}
            Self::Storage(storage) => storage.shrink(len),
        }
    }
}

impl<'b> ReplyValue<'b> {
    /// Makes room for a value of at most the size of `buffer`.
    #[must_use]
    pub const fn new(buffer: &'b mut [u8]) -> Self {
        let max = buffer.len();
        Self { memory: Memory::Slice(buffer), offset: 0, max, tail: 0, len: 0, overflow: false }
    }

    /// Makes room for a value of at most `max` bytes in memory that may grow, after `offset` bytes and before `tail` bytes.
    pub(crate) const fn within(storage: &'b mut dyn Storage, offset: usize, max: usize, tail: usize) -> Self {
        Self { memory: Memory::Storage(storage), offset, max, tail, len: 0, overflow: false }
    }

    /// Sets the value, and replaces an earlier one.
    ///
    /// Memory grows to the size that the value needs, if that much memory is available.
    ///
    /// # Errors
    ///
    /// An [`EncodeError`] when the value does not fit. The reply then has no value; its result is E_TOO_MUCH_DATA in b-CAP
    /// regardless of the outcome, and E_INVALIDSNDPACKET in RAC unless the outcome is an error.
    pub fn set<T: Encode + ?Sized>(&mut self, value: &T) -> Result<(), EncodeError> {
        self.clear();
        let before = self.memory.bytes().len();
        let encoded = loop {
            let mut out = Writer::new(self.room());
            match value.encode(&mut out) {
                Ok(()) => break Ok(out.len()),
                Err(EncodeError::Full) if self.grow() => {}
                Err(error) => break Err(error),
            }
        };
        let used = encoded.map_or(0, |len| self.offset.saturating_add(len).saturating_add(self.tail));
        // the sessions of a server share its memory, so memory that the value does not need is released
        if self.memory.bytes().len() > used.max(before) {
            self.memory.shrink(used.max(before));
        }
        self.overflow = encoded.is_err();
        self.len = encoded?;
        Ok(())
    }

    /// Returns the memory that the value may use without growing.
    fn room(&mut self) -> &mut [u8] {
        let memory = self.memory.bytes_mut();
        let end = memory.len().saturating_sub(self.tail).min(self.offset.saturating_add(self.max));
        memory.get_mut(self.offset..end).unwrap_or_default()
    }

    /// Doubles the memory, or grows it by as much as is available; `false` when it cannot grow.
    fn grow(&mut self) -> bool {
        let len = self.memory.bytes().len();
        let most = self.offset.saturating_add(self.max).saturating_add(self.tail);
        let mut more = len.max(64).min(most.saturating_sub(len));
        while more > 0 {
            if self.memory.grow(len.saturating_add(more)) {
                return true;
            }
            more /= 2;
        }
        false
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

    /// Returns the encoding of the value; empty without a value.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.memory.bytes().get(self.offset..).and_then(|rest| rest.get(..self.len)).unwrap_or_default()
    }

    /// Returns whether the last call of [`set`](Self::set) failed.
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

#[cfg(test)]
pub(crate) mod tests {
    #![allow(clippy::arithmetic_side_effects, reason = "lengths of a test")]

    extern crate std;

    use std::vec::Vec;

    use super::*;

    /// Memory that grows up to a limit.
    #[derive(Debug)]
    pub(crate) struct Capped {
        bytes: Vec<u8>,
        limit: usize,
    }

    impl Capped {
        pub(crate) fn new(len: usize, limit: usize) -> Self {
            Self { bytes: std::vec![0; len], limit }
        }
    }

    impl Storage for Capped {
        fn bytes(&self) -> &[u8] {
            &self.bytes
        }

        fn bytes_mut(&mut self) -> &mut [u8] {
            &mut self.bytes
        }

        fn grow(&mut self, len: usize) -> bool {
            let fits = len <= self.limit;
            if fits && len > self.bytes.len() {
                self.bytes.resize(len, 0);
            }
            fits
        }

        fn shrink(&mut self, len: usize) {
            self.bytes.truncate(len);
        }
    }

    #[test]
    fn a_value_fits_if_exactly_enough_memory_is_available() {
        const OFFSET: usize = 19;
        const TAIL: usize = 3;
        // type and count
        const HEAD: usize = 6;
        for limit in [64, 65, 100, 127, 128, 129, 1000, 1025, 5000] {
            for before in [0, 20, 64] {
                for (needed, fits) in [(limit - 1, true), (limit, true), (limit + 1, false), (2 * limit, false)] {
                    let mut memory = Capped::new(before, limit);
                    let value = std::vec![7_u8; needed - OFFSET - HEAD - TAIL];
                    let mut reply = ReplyValue::within(&mut memory, OFFSET, 1 << 20, TAIL);
                    let what = std::format!("{needed} bytes of {limit}, {before} before");
                    assert_eq!((reply.set(&value[..]).is_ok(), reply.is_overflow()), (fits, !fits), "{what}");
                    assert_eq!(reply.get().is_some(), fits, "{what}");
                    let kept = if fits { needed.max(before) } else { before };
                    assert_eq!(memory.bytes.len(), kept, "{what}: unneeded memory is released");
                }
            }
        }
    }

    #[test]
    fn a_value_of_the_largest_size_fits_and_no_larger_one() {
        for (max, fits) in [(105, false), (106, true), (107, true)] {
            let mut memory = Capped::new(0, 1000);
            let mut reply = ReplyValue::within(&mut memory, 19, max, 1);
            assert_eq!(reply.set(&[7_u8; 100]).is_ok(), fits, "{max}");
        }
    }
}
