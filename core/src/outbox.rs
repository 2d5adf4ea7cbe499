//! The sending side of a link: how many bytes of a buffer to send, and how many were sent.
//!
//! ```text
//!  buffer  [ sent | unsent | free ... ]
//!                 ^`sent`  ^`len`
//! ```

/// The outgoing bytes of a buffer. The buffer itself belongs to the client or session.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Outbox {
    /// Bytes of the buffer to send.
    len: usize,
    /// Number of them that the link has accepted; never above `len`.
    sent: usize,
}

impl Outbox {
    /// Nothing to send.
    pub(crate) const EMPTY: Self = Self { len: 0, sent: 0 };

    /// The first `len` bytes of the buffer, all unsent.
    pub(crate) const fn new(len: usize) -> Self {
        Self { len, sent: 0 }
    }

    /// Returns the unsent bytes.
    pub(crate) fn unsent<'b>(&self, buffer: &'b [u8]) -> &'b [u8] {
        buffer.get(self.sent..self.len).unwrap_or_default()
    }

    /// Returns all the bytes, sent or not.
    pub(crate) fn whole<'b>(&self, buffer: &'b mut [u8]) -> &'b mut [u8] {
        buffer.get_mut(..self.len).unwrap_or_default()
    }

    /// Records that the link has taken `count` bytes; returns whether any unsent bytes were taken.
    pub(crate) fn transmitted(&mut self, count: usize) -> bool {
        let before = self.sent;
        self.sent = self.sent.saturating_add(count).min(self.len);
        self.sent > before
    }

    /// Sends everything again.
    pub(crate) const fn rewind(&mut self) {
        self.sent = 0;
    }

    /// Marks everything as sent; [`rewind`](Self::rewind) sends it again.
    pub(crate) const fn skip(&mut self) {
        self.sent = self.len;
    }

    pub(crate) const fn len(&self) -> usize {
        self.len
    }

    /// Returns whether there are unsent bytes.
    pub(crate) const fn is_sending(&self) -> bool {
        self.sent < self.len
    }

    /// Returns whether no byte was sent.
    pub(crate) const fn is_unsent(&self) -> bool {
        self.sent == 0
    }

    /// Returns whether a part was sent: on a stream, the rest must follow it.
    pub(crate) const fn is_partial(&self) -> bool {
        0 < self.sent && self.sent < self.len
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_sent_in_pieces_and_can_be_sent_again() {
        let mut buffer = *b"abcdef..";
        let mut outbox = Outbox::new(6);
        assert!(outbox.is_sending() && outbox.is_unsent() && !outbox.is_partial());
        assert!(!outbox.transmitted(0));
        assert!(outbox.transmitted(2) && outbox.is_partial());
        assert_eq!(outbox.unsent(&buffer), b"cdef");
        assert!(outbox.transmitted(usize::MAX) && !outbox.is_sending());
        assert_eq!(outbox.unsent(&buffer), b"");
        assert_eq!(outbox.whole(&mut buffer), b"abcdef");
        assert!(!outbox.transmitted(1));
        outbox.rewind();
        assert_eq!(outbox.unsent(&buffer), b"abcdef");
        outbox.skip();
        assert!(!outbox.is_sending() && !outbox.is_partial());
        assert_eq!(Outbox::EMPTY.unsent(&buffer), b"");
    }

    #[test]
    fn a_buffer_that_was_shrunk_has_no_unsent_bytes() {
        assert_eq!(Outbox::new(6).unsent(b"abc"), b"");
    }
}
