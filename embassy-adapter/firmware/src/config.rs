//! The block of settings in the flash; what it can say stands in `bcap_board`.

use bcap_board::{BLOCK, MAGIC, Settings};

use crate::mmio;

#[used]
static SETTINGS: [u8; BLOCK] = {
    let mut block = [0; BLOCK];
    let mut i = 0;
    while i < MAGIC.len() {
        block[i] = MAGIC[i];
        i += 1;
    }
    block
};

/// Reads the block; `unreadable` is told the lines that are no settings.
///
/// Not inlined: the settings are made on the stack on their way into their place.
#[inline(never)]
#[must_use]
pub fn load(unreadable: fn(&[u8])) -> Settings<'static> {
    Settings::read(mmio::patched(&SETTINGS).get(MAGIC.len()..).unwrap_or_default(), unreadable)
}

/// Logs a line that is no setting.
pub fn log(line: &[u8]) {
    defmt::error!("settings: cannot read \"{=[u8]:a}\", so nothing may be written", line);
}
