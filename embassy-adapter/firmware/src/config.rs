//! The block of settings in the flash; `bcap_board` describes it.

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

/// Reads the block, and passes invalid lines to `invalid`. To be called once.
///
/// Not inlined: the settings are made on the stack on their way into their place.
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
    defmt::error!("settings: cannot read \"{=[u8]:a}\", so nothing may be written", line);
}
