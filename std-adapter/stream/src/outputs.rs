//! The outputs that a pose sets: MiniIO, user IO and HandIO.

use bcap_core::slave::{SendFormat, SendIo};

/// The outputs that a line of a file or the command line sets; `None` leaves them as they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OutputBits {
    /// MiniIO.
    pub mini: Option<u64>,
    /// User IO.
    pub user: Option<u64>,
    /// HandIO.
    pub hand: Option<u64>,
}

/// Checks that slvMove carries MiniIO, user IO and HandIO, where they have a value, and that the value fits. The names in
/// `names` are the sources of the values, for errors.
///
/// # Errors
///
/// The name of the value, and the fault.
pub fn check(send: SendFormat, names: [&str; 3], values: [Option<u64>; 3]) -> Result<(), String> {
    let SendFormat { io, hand_io } = send;
    let parts = [
        ("mini", if io == SendIo::Mini { 32 } else { 0 }),
        ("user:PORT:BYTES", if let SendIo::User(range) = io { u32::from(range.bytes()) * 8 } else { 0 }),
        ("hand", if hand_io { 32 } else { 0 }),
    ];
    for (((part, bits), name), value) in parts.into_iter().zip(names).zip(values) {
        let Some(value) = value else { continue };
        if bits == 0 {
            return Err(format!(
                "{name}: slvMove does not carry it; add {part} to the send format, or leave {name} out"
            ));
        }
        // a shift by 64 bits leaves nothing
        if value.checked_shr(bits).unwrap_or(0) != 0 {
            return Err(format!("{name}: {value:#x} does not fit the {bits} bits of {part} in the send format"));
        }
    }
    Ok(())
}
/// Parses bits as a number, decimal or with `0x`.
///
/// # Errors
///
/// When the text is not such a number.
pub fn parse_bits(text: &str) -> Result<u64, String> {
    let number = match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => u64::from_str_radix(digits, 16),
        None => text.parse(),
    };
    number.map_err(|_| "write a number, such as 48 or 0x30".into())
}
