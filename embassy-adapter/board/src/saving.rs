//! Passes the settings from a page to the task that has the flash.
//!
//! ```text
//!  page: save ─► JOB, with the memory of the page ─► the task with the flash: Console::replace ─► DONE ─► page
//! ```

use core::cell::{Cell, RefCell};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Timer};
use embedded_storage::nor_flash::NorFlash;

use crate::Settings;
use crate::console::{Console, NotSaved};

/// The time for the answer to leave before the board restarts.
const LEAVE: Duration = Duration::from_secs(1);

/// Settings in the memory of a page, and those that the board runs with.
struct Job {
    memory: &'static mut [u8],
    len: usize,
    running: &'static Settings<'static>,
}

/// The state of the task with the flash.
#[derive(Clone, Copy, PartialEq, Eq)]
enum TaskState {
    Absent,
    Free,
    /// It has a job, or the board restarts.
    Busy,
}

static STATE: Mutex<CriticalSectionRawMutex, Cell<TaskState>> = Mutex::new(Cell::new(TaskState::Absent));
static JOB: Signal<CriticalSectionRawMutex, Job> = Signal::new();
static DONE: Signal<CriticalSectionRawMutex, (&'static mut [u8], Result<(), NotSaved>)> = Signal::new();

/// Why a page cannot save settings.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum SaveError {
    /// Another page saves settings, or the board restarts.
    Busy,
    /// The text is not UTF-8.
    Text,
    NotSaved(NotSaved),
}

/// Returns whether the board has a console.
pub(crate) fn is_possible() -> bool {
    STATE.lock(Cell::get) != TaskState::Absent
}

/// Saves the settings in the first `len` bytes of a memory, and returns the memory.
pub(crate) async fn save(
    memory: &'static mut [u8],
    len: usize,
    running: &'static Settings<'static>,
) -> (&'static mut [u8], Result<(), SaveError>) {
    if memory.get(..len).is_none_or(|text| core::str::from_utf8(text).is_err()) {
        return (memory, Err(SaveError::Text));
    }
    // one job at a time; with two, the memory of one would be lost
    let is_free =
        STATE.lock(|state| state.get() == TaskState::Free && state.replace(TaskState::Busy) == TaskState::Free);
    if !is_free {
        return (memory, Err(SaveError::Busy));
    }
    JOB.signal(Job { memory, len, running });
    // the task with the flash does a job without waiting for anything
    let (memory, result) = DONE.wait().await;
    if result.is_err() {
        // not before: another page would take this result
        STATE.lock(|state| state.set(TaskState::Free));
    }
    (memory, result.map_err(SaveError::NotSaved))
}

/// Performs the jobs, in the task that has the flash; restarts the board after settings were saved.
pub(crate) async fn attend<F: NorFlash>(console: &RefCell<Console<'_, F>>, restart: fn() -> !) {
    STATE.lock(|state| state.set(TaskState::Free));
    loop {
        let Job { memory, len, running } = JOB.wait().await;
        let result = replace(console, memory.get(..len).unwrap_or_default(), running);
        let is_saved = result.is_ok();
        DONE.signal((memory, result));
        if is_saved {
            defmt::info!("settings saved over the page");
            Timer::after(LEAVE).await;
            restart();
        }
    }
}

/// Not inlined: the settings are parsed on the call stack.
#[inline(never)]
fn replace<F: NorFlash>(
    console: &RefCell<Console<'_, F>>,
    text: &[u8],
    running: &Settings<'_>,
) -> Result<(), NotSaved> {
    let text = core::str::from_utf8(text).unwrap_or_default();
    // the name of the field of a form precedes its text
    let text = text.strip_prefix(FIELD).unwrap_or(text);
    // other tasks of the port borrow it between two bytes only
    console.borrow_mut().replace(text, running)
}

/// The name of the field with the settings in the form, and its `=`.
pub(crate) const FIELD: &str = "settings=";
