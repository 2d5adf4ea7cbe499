//! The settings block in the flash; `bcap_board` documents its contents.

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

/// Parses the block; calls `invalid` with each invalid line. Call it once.
///
/// Not inlined, because the settings are built on the stack before they move into their static.
#[inline(never)]
#[must_use]
pub fn load(invalid: fn(&[u8])) -> &'static Settings<'static> {
    static PLACE: StaticCell<Settings<'static>> = StaticCell::new();
    let text = mmio::patched(&SETTINGS).get(MAGIC.len()..).unwrap_or_default();
    // `configure` tells the reason; here it would cost flash
    PLACE.init_with(|| Settings::read(text, |line, _| invalid(line)))
}

/// Logs an invalid line.
pub fn log(line: &[u8]) {
    defmt::error!("settings: invalid line \"{=[u8]:a}\", so every PUT is refused", line);
}
