//! The lengths of the frames of slvMove, for the time that a slow line takes for them.

use super::command::{HEAD, PARAMETER};
use super::format::{Format, ReceiveFormat, SendIo};
use super::reply::CURRENT_LEN;
use crate::bcap::{HEADER_LEN, Link};

/// Bytes of an I4.
const INT: usize = HEAD + 4;
/// The byte at the end of a frame.
const EOT: usize = 1;
/// Bytes of a reply before its value: the header and the value's length.
const REPLY: usize = HEADER_LEN + 4;

impl Format {
    /// Returns the lengths of slvMove and of its reply on this kind of link, in bytes.
    ///
    /// A serial line of 115200 baud takes 19 ms for both, so it cannot carry a pose every 8 ms.
    ///
    /// # Examples
    ///
    /// ```
    /// use bcap_core::bcap::Link;
    /// use bcap_core::slave::{Format, Mode, PoseType, ReceiveFormat, ReceivePose, SlaveMode};
    ///
    /// let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
    /// let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
    /// assert_eq!(format.frame_lengths(Link::Serial), [134, 92]);
    /// ```
    #[must_use]
    pub fn frame_lengths(&self, link: Link) -> [usize; 2] {
        let end = if link == Link::Serial { EOT + 2 } else { EOT };
        let io = match self.send.io {
            SendIo::None => 0,
            SendIo::Mini => INT,
            SendIo::User(range) => (2 * INT).wrapping_add(array(range.bytes().into(), 1)),
        };
        let range = if self.receive.user_io.is_some() { 2 * INT } else { 0 };
        let hand = if self.send.hand_io { INT } else { 0 };
        let outer = if self.items() > 1 { HEAD } else { 0 };
        let parameter = [outer, numbers(self.layout().len()), io, range, hand].into_iter().fold(0, usize::wrapping_add);
        [
            PARAMETER.wrapping_add(parameter).wrapping_add(end),
            REPLY.wrapping_add(value(&self.receive)).wrapping_add(end),
        ]
    }
}

/// Returns the bytes of the value of a reply.
fn value(format: &ReceiveFormat) -> usize {
    let pose = numbers(format.pose.len());
    if format.is_plain() {
        return pose;
    }
    let ints = [format.time.is_some(), format.mini_io, format.hand_io].into_iter().filter(|has| *has).count();
    let user = format.user_io.map_or(0, |range| array(range.bytes().into(), 1));
    let current = if format.current { numbers(CURRENT_LEN) } else { 0 };
    [HEAD, pose, ints.wrapping_mul(INT), user, current].into_iter().fold(0, usize::wrapping_add)
}

/// Returns the bytes of an array of R8.
const fn numbers(count: usize) -> usize {
    array(count, size_of::<f64>())
}

/// Returns the bytes of an array.
const fn array(elements: usize, size: usize) -> usize {
    HEAD.wrapping_add(elements.wrapping_mul(size))
}
