//! The parameter and the answer of slvMove, as slvSendFormat and slvRecvFormat select their parts.
//!
//! ```text
//!   slvMove     pose R8 array, [MiniIO I4], [user IO: offset I4, size I4, data UI1 array],
//!               [user IO to be read: offset I4, size I4], [HandIO I4]       alone: the R8 array itself
//!   its answer  [time stamp I4], pose R8 array, [MiniIO I4], [user IO UI1 array], [HandIO I4],
//!               [currents R8 array of 8]                                    alone: the R8 array itself
//! ```
//!
//! An array of numbers may also be an array of VARIANT. A number may have any type that converts without loss.
//! An offset is the number of a user IO, a size is a number of bits; both are multiples of 8. Which IO are MiniIO, HandIO and
//! user IO is data of the [model](crate::model::SlaveIo).

use bcap_core::hresult::HResult;
use bcap_core::variant::{Array, VarType, Variant};

use crate::coordinates::Coordinates;
use crate::kinematics::{Axes, measured, six};
use crate::model::{SlaveFormats, SlaveIo, SlaveIoPart};
use crate::value::{ValueResult, numbers, numbers_of_array, one_int, owned, whole};
use crate::variables::Variables;

const TIME: i32 = 0x0010;
const HAND: i32 = 0x0020;
const CURRENT: i32 = 0x0040;
const MINI: i32 = 0x0100;
const USER: i32 = 0x0200;

/// The formats of slvSendFormat: MiniIO and user IO exclude each other.
const SEND: [i32; 6] = [0, HAND, MINI, MINI | HAND, USER, USER | HAND];

/// Returns whether a controller has all parts of a format.
fn has(parts: SlaveFormats, format: i32) -> bool {
    let parts = [(MINI, parts.mini_io), (HAND, parts.hand_io), (USER, parts.user_io), (CURRENT, parts.current)];
    parts.iter().all(|(part, exists)| *exists || format & part == 0)
}

/// The formats that slvSendFormat and slvRecvFormat have selected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Formats {
    send: i32,
    receive: i32,
    /// The time stamp is in µs, not ms.
    micros: bool,
}

impl Default for Formats {
    /// Poses alone; the answer in joints, as in the guide's example.
    fn default() -> Self {
        Self { send: 0, receive: 2, micros: false }
    }
}

impl Formats {
    pub(super) fn set_send(&mut self, param: &Variant<'_>, parts: SlaveFormats) -> Result<(), HResult> {
        let [format] = numbers(param)?[..] else { return Err(HResult::E_INVALIDARG) };
        let format = whole(format)?;
        if !SEND.contains(&format) || !has(parts, format) {
            return Err(HResult::E_INVALIDARG);
        }
        self.send = format;
        Ok(())
    }

    pub(super) fn set_receive(&mut self, param: &Variant<'_>, parts: SlaveFormats) -> Result<(), HResult> {
        let (format, unit) = match numbers(param)?[..] {
            [format] => (whole(format)?, 0),
            [format, unit] => (whole(format)?, whole(unit)?),
            _ => return Err(HResult::E_INVALIDARG),
        };
        let known = 0xF | TIME | HAND | CURRENT | MINI | USER;
        if format & !known != 0 || !(1..=5).contains(&(format & 0xF)) || !has(parts, format) || ![0, 1].contains(&unit)
        {
            return Err(HResult::E_INVALIDARG);
        }
        (self.receive, self.micros) = (format, unit == 1);
        Ok(())
    }

    /// Reads the parameter of slvMove.
    pub(super) fn read(self, param: &Variant<'_>) -> Result<SlvMove, HResult> {
        let mut order = SlvMove::default();
        let (sends, receives) = (self.send, self.receive & USER != 0);
        if sends == 0 && !receives {
            order.pose = numbers_of_array(param)?;
            return Ok(order);
        }
        let Variant::Array(array) = param else { return Err(HResult::E_INVALIDARGTYPE) };
        if array.element() != VarType::VARIANT {
            return Err(HResult::E_INVALIDARGTYPE);
        }
        let mut items = Items { array: *array, next: 0 };
        order.pose = numbers_of_array(&items.next()?)?;
        if sends & MINI != 0 {
            order.mini = Some(items.int()?);
        }
        if sends & USER != 0 {
            let (offset, size) = items.user_io()?;
            let data = bytes(&items.next()?)?;
            if data.len() != size {
                return Err(HResult::E_INVALIDARG);
            }
            order.user = Some((offset, data));
        }
        if receives {
            order.read_user = Some(items.user_io()?);
        }
        if sends & HAND != 0 {
            order.hand = Some(items.int()?);
        }
        if items.next != array.len() {
            return Err(HResult::E_INVALIDARG);
        }
        Ok(order)
    }

    /// Makes the answer of slvMove.
    pub(super) fn answer(self, state: &RobotState, order: &SlvMove, map: &SlaveIo, io: &Variables) -> ValueResult {
        let has = |part: i32| self.receive & part != 0;
        let mut items = Vec::new();
        if has(TIME) {
            let micros = state.micros;
            // it wraps as a 32-bit counter does
            items.push(owned(if self.micros { micros as i32 } else { (micros / 1000) as i32 })?);
        }
        items.push(owned(self.pose(&state.axes, &state.coordinates))?);
        if has(MINI) {
            items.push(owned(read_bits(io, &map.mini))?);
        }
        if let Some((offset, size)) = order.read_user {
            let bytes: Vec<_> = (0..size).map(|n| read_byte(io, offset + n * 8)).collect();
            items.push(owned(bytes)?);
        }
        if has(HAND) {
            items.push(owned(read_bits(io, &map.hand))?);
        }
        if has(CURRENT) {
            items.push(owned(state.current)?);
        }
        if items.len() == 1 { Ok(items.remove(0)) } else { owned(items) }
    }

    fn pose(self, axes: &Axes, coordinates: &Coordinates) -> Vec<f64> {
        let joints = six(axes);
        match self.receive & 0xF {
            1 => coordinates.position(&joints),
            3 => coordinates.trans(&joints),
            4 => [coordinates.position(&joints), measured(*axes)].concat(),
            5 => [coordinates.trans(&joints), measured(*axes)].concat(),
            _ => measured(*axes),
        }
    }
}

/// The state of the robot in the answer of slvMove.
pub(super) struct RobotState {
    pub(super) micros: u64,
    pub(super) axes: Axes,
    pub(super) coordinates: Coordinates,
    pub(super) current: Axes,
}

/// The parameter of slvMove.
#[derive(Debug, Default, PartialEq)]
pub(super) struct SlvMove {
    pub(super) pose: Vec<f64>,
    mini: Option<i32>,
    /// The first IO, and eight IO in each byte.
    user: Option<(usize, Vec<u8>)>,
    /// The first IO, and the number of bytes.
    read_user: Option<(usize, usize)>,
    hand: Option<i32>,
}

impl SlvMove {
    /// Checks that its user IO are user IO, and exist.
    pub(super) fn check(&self, map: &SlaveIo, io: &Variables) -> Result<(), HResult> {
        let written = self.user.as_ref().map(|(offset, data)| (*offset, data.len()));
        let user = || written.into_iter().chain(self.read_user);
        if user().any(|(offset, _)| offset < map.user) {
            return Err(HResult::E_INVALIDARG);
        }
        let mut ends = user().map(|(offset, size)| offset + size * 8);
        if ends.all(|end| end <= io.io_len()) { Ok(()) } else { Err(HResult::DISP_E_BADINDEX) }
    }

    /// Sets the IO.
    pub(super) fn write(&self, map: &SlaveIo, io: &mut Variables) {
        for (value, part) in [(self.mini, &map.mini), (self.hand, &map.hand)] {
            for n in value.iter().flat_map(|_| part.write.clone()) {
                io.set_io(n, value.unwrap_or(0) >> (n - part.first) & 1 != 0);
            }
        }
        let (offset, data) = self.user.as_ref().map_or((0, &[][..]), |(offset, data)| (*offset, data.as_slice()));
        for (n, byte) in data.iter().enumerate() {
            (0..8).for_each(|bit| io.set_io(offset + n * 8 + bit, byte >> bit & 1 != 0));
        }
    }
}

/// Reads the items of an array in order.
struct Items<'a> {
    array: Array<'a>,
    next: usize,
}

impl<'a> Items<'a> {
    fn next(&mut self) -> Result<Variant<'a>, HResult> {
        let item = self.array.get(self.next).ok_or(HResult::E_INVALIDARG)?;
        self.next += 1;
        Ok(item.flatten())
    }

    fn int(&mut self) -> Result<i32, HResult> {
        one_int(&self.next()?)
    }

    /// Reads the first user IO, and the number of bytes.
    fn user_io(&mut self) -> Result<(usize, usize), HResult> {
        let (offset, size) = (self.int()?, self.int()?);
        if offset % 8 != 0 || size < 0 || size % 8 != 0 {
            return Err(HResult::E_INVALIDARG);
        }
        let unsigned = |n: i32| usize::try_from(n).map_err(|_| HResult::E_INVALIDARG);
        Ok((unsigned(offset)?, unsigned(size / 8)?))
    }
}

/// Reads an array of UI1, or of whole numbers from 0 to 255.
fn bytes(value: &Variant<'_>) -> Result<Vec<u8>, HResult> {
    if let Variant::Array(array) = value
        && let Some(bytes) = array.items::<u8>()
    {
        return Ok(bytes.iter().collect());
    }
    let byte = |n: f64| u8::try_from(whole(n)?).map_err(|_| HResult::DISP_E_OVERFLOW);
    numbers_of_array(value)?.into_iter().map(byte).collect()
}

/// Reads the 32 IO of a part; IO outside the part are 0.
fn read_bits(io: &Variables, part: &SlaveIoPart) -> i32 {
    let is_on = |n: usize| (part.read.contains(&n) || part.write.contains(&n)) && io.io(n);
    (0..32).filter(|bit| is_on(part.first + bit)).fold(0_i32, |bits, bit| bits | 1 << bit)
}

/// Reads eight IO.
fn read_byte(io: &Variables, first: usize) -> u8 {
    (0..8).filter(|bit| io.io(first + bit)).fold(0, |byte, bit| byte | 1 << bit)
}
