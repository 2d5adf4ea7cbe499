//! The state of updates, which the page of the board shows.

use core::cell::RefCell;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embedded_storage::nor_flash::NorFlash;

use super::status::Status;
use super::updater::Updater;

static STATUS: Mutex<CriticalSectionRawMutex, RefCell<Option<Status>>> = Mutex::new(RefCell::new(None));

/// Shows the state after a change.
pub(crate) fn show<F: NorFlash>(updater: &Updater, flash: &mut F) {
    // a flash that cannot be read leaves the earlier state
    let Ok(status) = updater.status(flash) else { return };
    STATUS.lock(|shown| {
        if let Ok(mut shown) = shown.try_borrow_mut() {
            *shown = Some(status);
        }
    });
}

/// Returns the state, if the image receives updates.
pub(crate) fn status() -> Option<Status> {
    STATUS.lock(|shown| shown.try_borrow().ok()?.clone())
}
