//! The trial of an update: it is confirmed when the gateway has served a request, and rolled back when it has not in time.

use core::cell::Cell;
#[cfg(feature = "port")]
use core::cell::RefCell;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
#[cfg(feature = "port")]
use embassy_time::{Duration, with_timeout};
#[cfg(feature = "port")]
use embedded_storage::nor_flash::NorFlash;

#[cfg(feature = "port")]
use crate::console::Console;
use crate::record::Cause;
#[cfg(feature = "port")]
use crate::slots::Slots;
#[cfg(all(feature = "port", feature = "health"))]
use crate::update::shown;
#[cfg(feature = "port")]
use crate::update::{Phase, Updater, Updates};

static SERVED: Signal<CriticalSectionRawMutex, ()> = Signal::new();
static LAST_RESET: Mutex<CriticalSectionRawMutex, Cell<Cause>> = Mutex::new(Cell::new(Cause::PowerOn));

/// Sets the cause of the last reset, which may have ended a trial.
pub(crate) fn set_last_reset(cause: Cause) {
    LAST_RESET.lock(|last| last.set(cause));
}

/// Signals that the gateway has served a request: its networks and the session with the robot work.
pub(crate) fn has_served() {
    SERVED.signal(());
}

/// Creates a console that receives updates, if the image has partitions for them.
#[cfg(feature = "port")]
pub(crate) fn console<F: NorFlash>(mut slots: Slots<F>, updates: Option<Updates>) -> Console<'static, F> {
    let updater = updates.and_then(|(partitions, identity)| {
        let started = Updater::start(slots.flash(), partitions, identity, &LAST_RESET.lock(Cell::get));
        let started = started.map(|updater| updater.with_key(crate::signature::KEY));
        let status = started.and_then(|updater| Ok((updater.status(slots.flash())?, updater)));
        match status {
            Ok((status, updater)) => {
                defmt::info!("image {}", defmt::Display2Format(&status));
                #[cfg(feature = "health")]
                shown::show(&updater, slots.flash());
                Some(updater)
            }
            Err(error) => {
                defmt::error!("no updates: {}", defmt::Display2Format(&error));
                None
            }
        }
    });
    Console::new(slots, crate::memory::image()).with_updates(updater)
}

/// Confirms an update on trial when it has served a request. Without a request in the time of a trial, restarts the board, and
/// the boot loader swaps the earlier image in.
#[cfg(feature = "port")]
pub(crate) async fn judge<F: NorFlash>(console: &RefCell<Console<'_, F>>, trial: Duration, restart: fn() -> !) {
    let is_on_trial = console.borrow_mut().updater().is_some_and(|(updater, _)| updater.phase() == Phase::OnTrial);
    if !is_on_trial {
        return;
    }
    if with_timeout(trial, SERVED.wait()).await.is_err() {
        crate::watchdog::record(Cause::Unconfirmed);
        restart();
    }
    if let Some((updater, flash)) = console.borrow_mut().updater() {
        let confirmed = updater.confirm(flash);
        #[cfg(feature = "health")]
        shown::show(updater, flash);
        match confirmed {
            Ok(()) => defmt::info!("the update has served a request and is confirmed"),
            // it stays on trial, so the next start rolls it back
            Err(error) => defmt::error!("the update is not confirmed: {}", defmt::Display2Format(&error)),
        }
    }
}
