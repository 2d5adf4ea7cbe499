//! The settings: those that a host has written over the console, otherwise the block in the image. `bcap_board` documents them.

use bcap_board::{Settings, config};

pub use bcap_board::config::log;

/// Parses the settings; calls `invalid` with each invalid line. Call it once.
#[must_use]
pub fn load(invalid: fn(&[u8])) -> &'static Settings<'static> {
    #[cfg(feature = "console")]
    return config::load(crate::flash::slots().ok().as_mut(), invalid);
    #[cfg(not(feature = "console"))]
    config::load_image(invalid)
}
