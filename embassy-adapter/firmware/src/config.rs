//! The block of settings in the flash; what it can say stands in `bcap_board`.

use bcap_board::{BLOCK, MAGIC, Settings};
use static_cell::StaticCell;

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

/// Reads the block; `unreadable` is told the lines that are no settings. To be called once.
///
/// Not inlined: the settings are made on the stack on their way into their place.
#[inline(never)]
#[must_use]
pub fn load(unreadable: fn(&[u8])) -> &'static Settings<'static> {
    static PLACE: StaticCell<Settings<'static>> = StaticCell::new();
    let text = mmio::patched(&SETTINGS).get(MAGIC.len()..).unwrap_or_default();
    PLACE.init_with(|| Settings::read(text, unreadable))
}

/// Logs a line that is no setting.
pub fn log(line: &[u8]) {
    defmt::error!("settings: cannot read \"{=[u8]:a}\", so nothing may be written", line);
}
