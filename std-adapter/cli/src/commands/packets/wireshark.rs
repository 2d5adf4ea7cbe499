//! `bcap wireshark`: prints a dissector for Wireshark, one Lua file.

use bcap_capture::wireshark::script;
use clap::Args;

use crate::failure::Failure;
use crate::output::print_raw;

/// Prints a dissector for Wireshark, one Lua file
///
/// It decodes b-CAP over TCP and UDP, and RAC. docs/wireshark.md describes its fields and filters.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap wireshark >~/.local/lib/wireshark/plugins/bcap.lua
  bcap wireshark >bcap.lua && tshark -X lua_script:bcap.lua -r capture.pcapng")]
pub(crate) struct Wireshark {}

/// Prints the dissector.
pub(crate) fn wireshark() -> Result<(), Failure> {
    // it has no text from outside
    Ok(print_raw(script().trim_end())?)
}
