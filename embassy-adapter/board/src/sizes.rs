//! The sizes of a gateway's memory. The defaults serve four PLCs; variables of the build replace them.
//!
//! | variable              | size                                                        | default | range    |
//! |-----------------------|-------------------------------------------------------------|---------|----------|
//! | `BCAP_BOARD_PLCS`     | PLCs that are served simultaneously, RAC and Modbus together | 4      | 1-7      |
//! | `BCAP_BOARD_MODBUS`   | listeners for Modbus TCP                                    | 2       | 1-7      |
//! | `BCAP_BOARD_HANDLES`  | variables of the robot whose handles are kept               | 64      | 8-1024   |
//! | `BCAP_BOARD_PAGES`    | simultaneous clients of the page                            | 2       | 1-8      |
//! | `BCAP_BOARD_MESSAGES` | messages of syslog that wait for the network                | 4       | 1-64     |
//! | `BCAP_BOARD_LOG`      | bytes of the log that wait for its port, a power of two     | 2048    | 512-65536 |
//!
//! Set them in `[env]` of the image's `.cargo/config.toml`, next to the level of the log. A PLC takes 2.8 KB, a listener for
//! Modbus 2.8 KB, a client of the page 4.4 KB, a message 208 bytes, a handle 20.

/// The PLCs that are served simultaneously.
#[cfg(feature = "embassy")]
pub const PLCS: usize = size(option_env!("BCAP_BOARD_PLCS"), 4, 1, 7);
/// Listeners that serve clients of Modbus.
#[cfg(all(feature = "embassy", feature = "modbus"))]
pub(crate) const MODBUS: usize = size(option_env!("BCAP_BOARD_MODBUS"), 2, 1, 7);
/// The capacity of the LRU cache of handles.
#[cfg(feature = "embassy")]
pub(crate) const HANDLES: usize = size(option_env!("BCAP_BOARD_HANDLES"), 64, 8, 1024);
/// Listeners of the page: with two, one can close while the other answers.
#[cfg(all(feature = "embassy", feature = "health"))]
pub(crate) const PAGES: usize = size(option_env!("BCAP_BOARD_PAGES"), 2, 1, 8);
/// The messages that wait for the network; further ones are lost and counted.
#[cfg(all(feature = "embassy", feature = "health"))]
pub(crate) const MESSAGES: usize = size(option_env!("BCAP_BOARD_MESSAGES"), 4, 1, 64);

/// Returns the size that a variable of the build has.
pub(crate) const fn size(variable: Option<&str>, default: usize, least: usize, most: usize) -> usize {
    let Some(text) = variable else { return default };
    let digits = text.as_bytes();
    let (mut value, mut at) = (0_usize, 0);
    while at < digits.len() {
        assert!(digits[at].is_ascii_digit() && at < 6, "a size of the board is not a number of up to 6 digits");
        value = value * 10 + (digits[at] - b'0') as usize;
        at += 1;
    }
    assert!(
        least <= value && value <= most,
        "a size of the board is outside of its range, which bcap_board::sizes lists"
    );
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_variable_replaces_the_default_within_its_range() {
        assert_eq!(size(None, 4, 1, 7), 4);
        for (text, expected) in [("1", 1), ("7", 7), ("007", 7)] {
            assert_eq!(size(Some(text), 4, 1, 7), expected);
        }
        for text in ["", "0", "8", "-1", "4 ", "1000000"] {
            assert!(std::panic::catch_unwind(|| size(Some(text), 4, 1, 7)).is_err(), "{text:?}");
        }
    }
}
