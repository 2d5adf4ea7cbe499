//! `bcap wireshark`: prints a dissector for Wireshark, one Lua file.

use bcap_capture::wireshark::script;

use crate::error::Failure;
use crate::output::print_raw;

/// Prints the dissector.
pub(crate) fn wireshark() -> Result<(), Failure> {
    // it has no text from outside
    Ok(print_raw(script().trim_end())?)
}
