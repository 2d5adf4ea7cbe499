//! RAC: lines of text that read and write the variables of a controller, over TCP port 5006.

/// The port of RAC.
pub const PORT: u16 = 5006;
