//! The settings: those that a host has written over the console, otherwise the block in the image. `bcap_board` documents them.

#[cfg(feature = "console")]
use bcap_board::slots::TEXT;
use bcap_board::{BLOCK, MAGIC, Settings};
#[cfg(feature = "console")]
use static_cell::ConstStaticCell;
use static_cell::StaticCell;

#[cfg(feature = "console")]
use crate::flash;
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

/// Parses the settings; calls `invalid` with each invalid line. Call it once.
///
/// Not inlined, because the settings are built on the stack before they move into their static.
#[inline(never)]
#[must_use]
pub fn load(invalid: fn(&[u8])) -> &'static Settings<'static> {
    static PLACE: StaticCell<Settings<'static>> = StaticCell::new();
    let text = stored().unwrap_or_else(image);
    // `configure` tells the reason; here it would cost flash
    PLACE.init_with(|| Settings::read(text, |line, _| invalid(line)))
}

/// Returns the text of the settings in the image, up to the end of its block.
#[must_use]
pub fn image() -> &'static [u8] {
    mmio::patched(&SETTINGS).get(MAGIC.len()..).unwrap_or_default()
}

/// Returns the settings that a host has written over the console.
#[cfg(feature = "console")]
fn stored() -> Option<&'static [u8]> {
    static MEMORY: ConstStaticCell<[u8; TEXT]> = ConstStaticCell::new([0; TEXT]);
    flash::slots().ok()?.read(MEMORY.take()).ok().flatten()
}

/// Without a console the flash has no settings.
#[cfg(not(feature = "console"))]
const fn stored() -> Option<&'static [u8]> {
    None
}

/// Logs an invalid line.
pub fn log(line: &[u8]) {
    defmt::error!("settings: invalid line \"{=[u8]:a}\", so every PUT is refused", line);
}
