//! Damage to encoded frames.

use crate::frame::{TestFrame, field};

/// One change to an encoded frame; positions are fractions of 65536 of the length.
#[derive(Clone, Copy, Debug)]
pub enum Damage {
    /// Replaces a byte.
    Set(u16, u8),
    /// Adds to a byte, as off-by-one lengths and counts do.
    Add(u16, i8),
    /// Inserts a byte.
    Insert(u16, u8),
    /// Removes a byte.
    Remove(u16),
    /// Cuts the end off.
    Truncate(u16),
}

impl Damage {
    /// Damages `bytes`.
    pub fn apply(self, bytes: &mut Vec<u8>) {
        let place = |at: u16, len: usize| (usize::from(at) * len) >> 16;
        let len = bytes.len();
        match self {
            Self::Insert(at, byte) => bytes.insert(place(at, len + 1), byte),
            _ if bytes.is_empty() => {}
            Self::Set(at, byte) => bytes[place(at, len)] = byte,
            Self::Add(at, n) => bytes[place(at, len)] = bytes[place(at, len)].wrapping_add_signed(n),
            Self::Remove(at) => drop(bytes.remove(place(at, len))),
            Self::Truncate(at) => bytes.truncate(place(at, len)),
        }
    }
}

/// Encodes a frame and damages it. With `fixes_length` its first byte, length field and last byte are then corrected, so that a
/// decoder reaches the damage.
#[must_use]
pub fn damaged(frame: &TestFrame, damages: &[Damage], fixes_length: bool) -> Vec<u8> {
    let mut wire = frame.to_wire(false);
    damages.iter().for_each(|damage| damage.apply(&mut wire));
    if fixes_length && wire.len() >= 16 {
        let length = wire.len() as u32;
        wire[0] = 1;
        wire[field::LENGTH].copy_from_slice(&length.to_le_bytes());
        wire[length as usize - 1] = 4;
    }
    wire
}
