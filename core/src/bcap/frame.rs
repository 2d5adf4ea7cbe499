//! The b-CAP frame.
//!
//! ```text
//!  offset  size  field
//!       0    15  header: SOH, length, serial, reserved, code, number of arguments (`header.rs`)
//!      15     …  arguments: u32 length of the value | value (VARIANT)
//!   end-3     2  CRC-16 over length..last argument; serial lines only
//!   end-1     1  EOT 0x04
//! ```
//!
//! All fields are little-endian (b-CAP specification, sections 4.1.1 to 4.1.5). [`Decoder::decode`] validates a frame
//! and its values in one pass; after that no accessor of [`Frame`] or [`Args`] fails or panics. [`FrameWriter`] writes
//! a frame into the caller's buffer.

use core::fmt;

use crate::bcap::FunctionId;
use crate::bcap::header::{COUNT_AT, HEADER_LEN, Header, LENGTH_AT, SOH};
use crate::error::{DecodeError, DecodeErrorKind, EncodeError, Layer};
use crate::hresult::HResult;
use crate::limits::{Limits, Strictness};
use crate::num::{to_u16, to_u32, to_usize};
use crate::variant::{self, Encode, Variant};
use crate::wire::{Reader, Writer};

/// The last byte of every frame.
pub const EOT: u8 = 0x04;
/// The length of the shortest frame: a header and EOT.
pub const MIN_FRAME: usize = HEADER_LEN + 1;

/// Decodes frames.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::{Decoder, FunctionId, Progress};
/// use bcap_core::variant::Variant;
///
/// // Variable_GetValue(3), then the first byte of the next frame
/// let bytes = *b"\x01\x1e\0\0\0\x04\0\0\0\x65\0\0\0\x01\0\x0a\0\0\0\x03\0\x01\0\0\0\x03\0\0\0\x04\x01";
/// let Progress::Complete(frame, used) = Decoder::TCP.decode(&bytes)? else { panic!("the frame is complete") };
/// assert_eq!(used, 30);
/// assert_eq!((frame.serial, frame.function()), (4, FunctionId::VARIABLE_GET_VALUE));
/// assert_eq!(frame.args.get(0), Some(Variant::I4(3)));
///
/// assert_eq!(Decoder::TCP.decode(&bytes[..7])?, Progress::NeedMore(30));
/// # Ok::<(), bcap_core::error::DecodeError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Decoder {
    /// The limits on frames and values.
    pub limits: Limits,
    /// Which deviations from the specification are accepted.
    pub strictness: Strictness,
    /// Whether frames carry a CRC, as on serial lines.
    pub crc: bool,
}

/// The result of decoding the bytes received so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Progress<'a> {
    /// A frame, and its length in bytes.
    Complete(Frame<'a>, usize),
    /// The bytes are valid so far, and the frame needs at least this many in total.
    NeedMore(usize),
}

/// Like [`Progress`], with the header of the frame.
pub(crate) enum Decoded<'a> {
    Complete(Header, Args<'a>),
    NeedMore(usize),
}

/// A validated frame, as a view of its bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct Frame<'a> {
    /// The serial number.
    pub serial: u16,
    /// The reserved field.
    pub reserved: u16,
    /// The function number of a request, or the HRESULT of a reply.
    pub code: i32,
    /// The arguments.
    pub args: Args<'a>,
}

impl Decoder {
    /// Strict decoding of TCP streams.
    pub const TCP: Self = Self { limits: Limits::STREAM, strictness: Strictness::Strict, crc: false };
    /// Strict decoding of datagrams.
    pub const UDP: Self = Self { limits: Limits::DATAGRAM, strictness: Strictness::Strict, crc: false };
    /// Strict decoding of serial lines.
    pub const SERIAL: Self = Self { limits: Limits::SERIAL, strictness: Strictness::Strict, crc: true };

    /// Returns the same decoder with another strictness.
    #[must_use]
    pub const fn strictness(self, strictness: Strictness) -> Self {
        Self { strictness, ..self }
    }

    /// Decodes the frame at the front of `bytes`.
    ///
    /// Errors are reported as early as possible: a wrong SOH at the first byte, a length above the limit at the fifth.
    ///
    /// # Errors
    ///
    /// A [`DecodeError`]; a stream can continue after the bytes that [`resync`](Self::resync) returns.
    #[inline]
    pub fn decode<'a>(&self, bytes: &'a [u8]) -> Result<Progress<'a>, DecodeError> {
        Ok(match self.decode_with_header(bytes)? {
            Decoded::Complete(header, args) => Progress::Complete(Frame::new(header, args), to_usize(header.length)),
            Decoded::NeedMore(needed) => Progress::NeedMore(needed),
        })
    }

    /// Decodes the frame at the front of `bytes`, and returns its header.
    #[inline]
    pub(crate) fn decode_with_header<'a>(&self, bytes: &'a [u8]) -> Result<Decoded<'a>, DecodeError> {
        let Some(length) = self.frame_length(bytes)? else { return Ok(Decoded::NeedMore(MIN_FRAME)) };
        match bytes.get(..length) {
            Some(frame) => self.check(frame).map(|(header, args)| Decoded::Complete(header, args)),
            None => Ok(Decoded::NeedMore(length)),
        }
    }

    /// Decodes `bytes` as exactly one frame, the content of a datagram.
    ///
    /// # Errors
    ///
    /// Same as [`decode`](Self::decode). Also fails if bytes are missing or follow the frame; a lenient decoder ignores the
    /// latter.
    pub fn decode_datagram<'a>(&self, bytes: &'a [u8]) -> Result<Frame<'a>, DecodeError> {
        let decoded = self.decode_with_header(bytes)?;
        self.check_datagram(decoded, bytes.len()).map(|(header, args)| Frame::new(header, args))
    }

    /// Checks that the frame at the front of a datagram of `len` bytes is its only content.
    pub(crate) fn check_datagram<'a>(
        &self,
        decoded: Decoded<'a>,
        len: usize,
    ) -> Result<(Header, Args<'a>), DecodeError> {
        match decoded {
            Decoded::Complete(header, args) => {
                let used = to_usize(header.length);
                if used < len && self.strictness == Strictness::Strict {
                    let unused = to_u32(len.wrapping_sub(used));
                    return Err(DecodeError::frame(DecodeErrorKind::Unused(unused), used));
                }
                Ok((header, args))
            }
            Decoded::NeedMore(needed) => {
                Err(DecodeError::frame(DecodeErrorKind::Incomplete { needed: to_u32(needed) }, len))
            }
        }
    }

    /// Returns the validated length of the frame at the front of `bytes`; `None` while its length field is incomplete.
    ///
    /// # Errors
    ///
    /// When the first byte or the length cannot begin a frame.
    #[inline]
    pub fn frame_length(&self, bytes: &[u8]) -> Result<Option<usize>, DecodeError> {
        if let Some(found) = bytes.first().filter(|first| **first != SOH) {
            return Err(DecodeError::frame(DecodeErrorKind::Soh(*found), 0));
        }
        let Some(length) = Header::read_length(bytes) else { return Ok(None) };
        if length < to_u32(self.min_frame()) {
            return Err(DecodeError::frame(DecodeErrorKind::FrameTooShort(length), LENGTH_AT));
        }
        if length > self.limits.frame {
            let limit = self.limits.frame;
            return Err(DecodeError::frame(DecodeErrorKind::FrameTooLong { length, limit }, LENGTH_AT));
        }
        Ok(Some(to_usize(length)))
    }

    /// Returns how many bytes to drop after an error, up to the next byte that may begin a frame: at least one, unless `bytes`
    /// is empty, and all of them if no byte may begin a frame.
    #[must_use]
    pub fn resync(&self, bytes: &[u8]) -> usize {
        let mut at = 1_usize;
        while let Some(rest) = bytes.get(at..) {
            if rest.is_empty() || self.frame_length(rest).is_ok() {
                break;
            }
            at = at.wrapping_add(1);
        }
        at.min(bytes.len())
    }

    const fn min_frame(&self) -> usize {
        if self.crc { MIN_FRAME + 2 } else { MIN_FRAME }
    }

    /// Validates a frame whose length is known to be right.
    #[inline]
    fn check<'a>(&self, frame: &'a [u8]) -> Result<(Header, Args<'a>), DecodeError> {
        // `frame_length` accepts no frame shorter than header and EOT; the fallback avoids a panic
        let short = DecodeError::frame(DecodeErrorKind::FrameTooShort(to_u32(frame.len())), LENGTH_AT);
        let Some((header, rest)) = frame.split_first_chunk::<HEADER_LEN>() else { return Err(short) };
        let Some((&eot, mut body)) = rest.split_last() else { return Err(short) };
        let header = Header::from_bytes(header);
        if eot != EOT {
            return Err(DecodeError::frame(DecodeErrorKind::Eot(eot), frame.len().wrapping_sub(1)));
        }
        if self.crc {
            body = check_crc(frame, body)?;
        }
        let Header { count, .. } = header;
        if count > self.limits.arguments {
            let limit = self.limits.arguments;
            return Err(DecodeError::frame(DecodeErrorKind::TooManyArguments { count, limit }, COUNT_AT));
        }
        let data = self.check_args(count, body)?;
        Ok((header, Args { count, data, strictness: self.strictness }))
    }

    /// Validates the arguments and returns their bytes.
    #[inline]
    fn check_args<'a>(&self, count: u16, body: &'a [u8]) -> Result<&'a [u8], DecodeError> {
        let mut reader = Reader::new(body);
        for index in 0..count {
            if let Err(error) = check_argument(&mut reader, &self.limits, self.strictness) {
                let layer = Layer::Argument(index.wrapping_add(1));
                return Err(error.at(HEADER_LEN.wrapping_add(body.len()), layer));
            }
        }
        let unused = reader.left();
        if unused > 0 && self.strictness == Strictness::Strict {
            let offset = HEADER_LEN.wrapping_add(body.len()).wrapping_sub(unused);
            return Err(DecodeError::frame(DecodeErrorKind::Unused(to_u32(unused)), offset));
        }
        Ok(body)
    }
}

/// Splits one argument off and validates it.
#[inline]
fn check_argument<'a>(
    r: &mut Reader<'a>,
    limits: &Limits,
    strictness: Strictness,
) -> Result<&'a [u8], variant::CheckError> {
    let Some(declared) = r.u32() else { return Err(truncated(*r, 4, 0)) };
    if strictness == Strictness::Lenient {
        return check_lenient(declared, r, limits);
    }
    let Some(value) = r.slice(to_usize(declared)) else { return Err(truncated(*r, declared, 4)) };
    let mut inner = Reader::new(value);
    match variant::check(&mut inner, limits, strictness) {
        Ok(()) if inner.left() == 0 => Ok(value),
        Ok(()) => {
            let used = to_u32(value.len().wrapping_sub(inner.left()));
            let left = r.left().wrapping_add(value.len()).wrapping_add(4);
            Err(variant::CheckError { kind: DecodeErrorKind::ArgumentLength { declared, used }, left })
        }
        // the error's position counts from the end of the argument; more bytes may follow that
        Err(error) => Err(variant::CheckError { left: error.left.wrapping_add(r.left()), ..error }),
    }
}

/// Splits one argument off by its value and ignores its length field, which only a value of unknown type needs.
///
/// Some peers write wrong length fields, and read by the values themselves.
fn check_lenient<'a>(declared: u32, r: &mut Reader<'a>, limits: &Limits) -> Result<&'a [u8], variant::CheckError> {
    let value = r.rest();
    if variant::is_opaque(value)
        && declared >= 6
        && let Some(opaque) = r.slice(to_usize(declared))
    {
        return Ok(opaque);
    }
    variant::check(r, limits, Strictness::Lenient)?;
    Ok(value.get(..value.len().wrapping_sub(r.left())).unwrap_or_default())
}

/// Returns the error for `needed` missing bytes in `r`, at the start of the argument, which is `read` bytes before them.
#[cold]
fn truncated(r: Reader<'_>, needed: u32, read: usize) -> variant::CheckError {
    let left = r.left();
    variant::CheckError {
        kind: DecodeErrorKind::Truncated { needed, left: to_u32(left) },
        left: left.wrapping_add(read),
    }
}

/// Splits the CRC off the end of `body` and compares it.
fn check_crc<'a>(frame: &[u8], body: &'a [u8]) -> Result<&'a [u8], DecodeError> {
    let end = frame.len().saturating_sub(3);
    let Some((args, found)) = body.split_last_chunk::<2>() else {
        return Err(DecodeError::frame(DecodeErrorKind::FrameTooShort(to_u32(frame.len())), LENGTH_AT));
    };
    let computed = crc16(frame.get(1..end).unwrap_or_default());
    let found = u16::from_le_bytes(*found);
    if found == computed { Ok(args) } else { Err(DecodeError::frame(DecodeErrorKind::Crc { found, computed }, end)) }
}

/// Returns the CRC-16 of serial frames: polynomial 0x1021, initial value 0xffff, no reflection, no final XOR.
#[must_use]
pub fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xffff, |crc, byte| {
        // four bits at a time: the table of 32 bytes is small enough for a board, and fast enough for a serial line
        let crc = step(crc, byte >> 4);
        step(crc, byte & 0xf)
    })
}

/// Feeds four bits, the high ones of a byte first.
fn step(crc: u16, nibble: u8) -> u16 {
    const TABLE: [u16; 16] = [
        0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50a5, 0x60c6, 0x70e7, 0x8108, 0x9129, 0xa14a, 0xb16b, 0xc18c, 0xd1ad,
        0xe1ce, 0xf1ef,
    ];
    let [top, _] = crc.to_be_bytes();
    let index = usize::from((top >> 4) ^ nibble);
    (crc << 4) ^ TABLE.get(index).copied().unwrap_or(0)
}

/// The arguments of a validated frame.
#[derive(Clone, Copy)]
pub struct Args<'a> {
    count: u16,
    /// `count` validated arguments; unused bytes may follow them when the decoder was lenient.
    data: &'a [u8],
    strictness: Strictness,
}

impl<'a> Args<'a> {
    /// No arguments.
    pub const NONE: Self = Self { count: 0, data: &[], strictness: Strictness::Strict };

    /// Views arguments that a decoder of this strictness has validated.
    pub(crate) const fn from_checked(count: u16, data: &'a [u8], strictness: Strictness) -> Self {
        Self { count, data, strictness }
    }

    /// Returns the number of arguments.
    #[must_use]
    pub fn len(self) -> usize {
        usize::from(self.count)
    }

    /// Returns whether there are no arguments.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.count == 0
    }

    /// Returns the bytes of the arguments, and unused bytes after them if the decoder was lenient.
    pub(crate) const fn as_bytes(self) -> &'a [u8] {
        self.data
    }

    /// Returns an argument, counted from 0.
    #[must_use]
    pub fn get(self, index: usize) -> Option<Variant<'a>> {
        self.iter().nth(index)
    }

    /// Returns the first argument.
    #[cfg_attr(not(target_os = "none"), inline)]
    pub(crate) fn first(self) -> Option<Variant<'a>> {
        self.iter().next()
    }

    /// Iterates over the arguments.
    #[must_use]
    pub const fn iter(self) -> ArgsIter<'a> {
        ArgsIter { left: self.count, reader: Reader::new(self.data), strictness: self.strictness }
    }
}

impl<'a> IntoIterator for Args<'a> {
    type Item = Variant<'a>;
    type IntoIter = ArgsIter<'a>;

    fn into_iter(self) -> ArgsIter<'a> {
        self.iter()
    }
}

impl PartialEq for Args<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.iter().eq(other.iter())
    }
}

impl Eq for Args<'_> {}

impl fmt::Debug for Args<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(*self).finish()
    }
}

/// Iterates over the arguments of a frame.
#[derive(Clone)]
pub struct ArgsIter<'a> {
    left: u16,
    reader: Reader<'a>,
    strictness: Strictness,
}

impl<'a> Iterator for ArgsIter<'a> {
    type Item = Variant<'a>;

    #[inline]
    fn next(&mut self) -> Option<Variant<'a>> {
        self.left = self.left.checked_sub(1)?;
        // in a validated strict frame the lengths are right, so the value is not parsed again
        let value = match self.strictness {
            Strictness::Strict => crate::wire::length_prefixed(&mut self.reader)?,
            Strictness::Lenient => self.next_lenient()?,
        };
        Some(Variant::from_checked(value))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (usize::from(self.left), Some(usize::from(self.left)))
    }
}

impl<'a> ArgsIter<'a> {
    #[cold]
    fn next_lenient(&mut self) -> Option<&'a [u8]> {
        check_argument(&mut self.reader, &DEEPEST, Strictness::Lenient).ok()
    }
}

const DEEPEST: Limits = Limits { depth: crate::limits::MAX_DEPTH, ..Limits::STREAM };

impl ExactSizeIterator for ArgsIter<'_> {}
impl core::iter::FusedIterator for ArgsIter<'_> {}

impl fmt::Debug for ArgsIter<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.clone()).finish()
    }
}

impl<'a> Frame<'a> {
    pub(crate) const fn new(header: Header, args: Args<'a>) -> Self {
        Self { serial: header.serial, reserved: header.reserved, code: header.code, args }
    }

    /// Returns the function of a request.
    #[must_use]
    pub const fn function(&self) -> FunctionId {
        FunctionId(self.code)
    }

    /// Returns the result of a reply.
    #[must_use]
    pub const fn hresult(&self) -> HResult {
        HResult(self.code)
    }

    /// Returns the value of a reply.
    #[must_use]
    #[cfg_attr(not(target_os = "none"), inline)]
    pub fn value(&self) -> Option<Variant<'a>> {
        self.args.first()
    }
}

impl fmt::Debug for Frame<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Frame")
            .field("serial", &self.serial)
            .field("reserved", &self.reserved)
            .field("code", &format_args!("{:#x}", self.code))
            .field("args", &self.args)
            .finish()
    }
}

/// Writes one frame into the caller's buffer, in canonical form.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::{FrameWriter, FunctionId};
///
/// let mut buffer = [0; 64];
/// let mut frame = FrameWriter::new(&mut buffer)?;
/// frame.argument(&3_i32)?;
/// let frame = frame.finish(4, 0, FunctionId::VARIABLE_GET_VALUE.0)?;
/// assert_eq!(frame, b"\x01\x1e\0\0\0\x04\0\0\0\x65\0\0\0\x01\0\x0a\0\0\0\x03\0\x01\0\0\0\x03\0\0\0\x04");
/// # Ok::<(), bcap_core::error::EncodeError>(())
/// ```
#[derive(Debug)]
pub struct FrameWriter<'b> {
    out: Writer<'b>,
    arguments: usize,
    crc: bool,
}

impl<'b> FrameWriter<'b> {
    /// Starts a frame without CRC, for TCP and UDP.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] when the header does not fit.
    #[inline]
    pub fn new(buffer: &'b mut [u8]) -> Result<Self, EncodeError> {
        let mut out = Writer::new(buffer);
        // `finish` writes the header, whose length and count are not known yet
        out.put([0; HEADER_LEN])?;
        Ok(Self { out, arguments: 0, crc: false })
    }

    /// Chooses whether the frame ends with a CRC, for serial lines.
    #[must_use]
    pub const fn with_crc(self, crc: bool) -> Self {
        Self { crc, ..self }
    }

    /// Appends an argument.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] when it does not fit.
    #[inline]
    pub fn argument<T: Encode + ?Sized>(&mut self, value: &T) -> Result<(), EncodeError> {
        self.argument_of_any_type(&value)
    }

    /// Appends an argument. It is not generic, so an image contains one copy of it.
    // inlined on a PC, where the call costs more than the copies
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn argument_of_any_type(&mut self, value: &dyn Encode) -> Result<(), EncodeError> {
        self.arguments = self.arguments.wrapping_add(1);
        self.out.length_prefixed(&|out| value.encode(out))
    }

    /// Writes the header, the CRC if chosen and EOT, and returns the bytes of the frame.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] when the CRC or EOT does not fit.
    #[inline]
    pub fn finish(mut self, serial: u16, reserved: u16, code: i32) -> Result<&'b [u8], EncodeError> {
        let tail = if self.crc { 3 } else { 1 };
        let length = to_u32(self.out.len().wrapping_add(tail));
        let header = Header { length, serial, reserved, code, count: to_u16(self.arguments) };
        self.out.patch(0, header.to_bytes());
        if self.crc {
            let crc = crc16(self.out.as_bytes().get(1..).unwrap_or_default());
            self.out.put(crc.to_le_bytes())?;
        }
        self.out.put([EOT])?;
        Ok(self.out.into_bytes())
    }
}

/// Changes serial and reserved field of a finished frame, and its CRC, for another attempt.
pub(crate) fn renumber(frame: &mut [u8], serial: u16, reserved: u16, crc: bool) {
    Header::renumber(frame, serial, reserved);
    if crc {
        seal(frame);
    }
}

/// Writes the CRC of a finished frame.
pub(crate) fn seal(frame: &mut [u8]) {
    let Some(end) = frame.len().checked_sub(3) else { return };
    let sum = crc16(frame.get(LENGTH_AT..end).unwrap_or_default());
    if let Some(slot) = frame.get_mut(end..).and_then(<[u8]>::first_chunk_mut::<2>) {
        *slot = sum.to_le_bytes();
    }
}

#[cfg(test)]
mod tests;
