//! The settings that an image starts with: those in its flash, otherwise those in the image.

#[cfg(all(feature = "health", feature = "port"))]
use core::cell::Cell;

#[cfg(all(feature = "health", feature = "port"))]
use embassy_sync::blocking_mutex::{Mutex, raw::CriticalSectionRawMutex};
use embedded_storage::nor_flash::NorFlash;
use static_cell::{ConstStaticCell, StaticCell};

use crate::slots::{Slots, TEXT};
use crate::{Settings, memory};

/// Reads and parses the settings; calls `invalid` with each invalid line. Call it once.
///
/// Not inlined, because the settings are built on the stack before they move into their static.
#[inline(never)]
#[must_use]
pub fn load<F: NorFlash>(slots: Option<&mut Slots<F>>, invalid: fn(&[u8])) -> &'static Settings<'static> {
    static TEXT_MEMORY: ConstStaticCell<[u8; TEXT]> = ConstStaticCell::new([0; TEXT]);
    let stored = slots.and_then(|slots| slots.read(TEXT_MEMORY.take()).ok().flatten());
    parse(stored.unwrap_or_else(memory::image), invalid)
}

/// Parses the settings of the image, for a board without settings in flash. Call it once.
#[must_use]
pub fn load_image(invalid: fn(&[u8])) -> &'static Settings<'static> {
    parse(memory::image(), invalid)
}

/// The text of the settings that the board runs with.
#[cfg(all(feature = "health", feature = "port"))]
static RUNNING: Mutex<CriticalSectionRawMutex, Cell<&str>> = Mutex::new(Cell::new(""));

/// Returns the text of the settings that the board runs with.
#[cfg(all(feature = "health", feature = "port"))]
pub(crate) fn running() -> &'static str {
    RUNNING.lock(Cell::get)
}

#[inline(never)]
fn parse(text: &'static [u8], invalid: fn(&[u8])) -> &'static Settings<'static> {
    static PLACE: StaticCell<Settings<'static>> = StaticCell::new();
    #[cfg(all(feature = "health", feature = "port"))]
    {
        let end = text.iter().position(|byte| *byte == 0).unwrap_or(text.len());
        let text = text.get(..end).and_then(|text| core::str::from_utf8(text).ok());
        RUNNING.lock(|running| running.set(text.unwrap_or_default()));
    }
    // `configure` reports the reason; here it would cost flash
    PLACE.init_with(|| Settings::read(text, |line, _| invalid(line)))
}

/// Logs an invalid line.
pub fn log(line: &[u8]) {
    defmt::error!("settings: invalid line \"{=[u8]:a}\", so every PUT is refused", line);
}
