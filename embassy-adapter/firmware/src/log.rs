//! defmt's logger: frames in the buffer of the serial port.
//!
//! A frame is encoded inside a critical section, which lasts as long as copying its bytes. A frame without room is dropped
//! and counted; [`dropped`] returns the count.
#![expect(unsafe_code, reason = "defmt's logger is an unsafe trait")]

use core::cell::RefCell;

use critical_section::{Mutex, RestoreState};

use crate::uart;
use bcap_board::ring::Frame;

static STATE: Mutex<RefCell<State>> =
    Mutex::new(RefCell::new(State { encoder: defmt::Encoder::new(), frame: None, restore: None }));

struct State {
    encoder: defmt::Encoder,
    /// The frame being written.
    frame: Option<Frame<'static, 4096>>,
    /// The critical section around a frame.
    restore: Option<RestoreState>,
}

/// Returns the number of frames that were dropped since the start, because the buffer was full.
#[must_use]
pub fn dropped() -> u32 {
    uart::ring().dropped()
}

#[defmt::global_logger]
struct Logger;

// SAFETY: each frame is written inside one critical section, so frames do not interleave
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: `release` ends the section
        let restore = unsafe { critical_section::acquire() };
        with(|State { encoder, frame, restore: restored }| {
            *restored = Some(restore);
            let frame = frame.insert(uart::ring().begin());
            encoder.start_frame(|bytes| frame.extend(bytes));
        });
    }

    unsafe fn flush() {
        uart::flush();
    }

    unsafe fn release() {
        let restore = with(|State { encoder, frame, restore }| {
            if let Some(mut frame) = frame.take() {
                encoder.end_frame(|bytes| frame.extend(bytes));
                frame.end();
            }
            restore.take()
        });
        uart::start();
        if let Some(Some(restore)) = restore {
            // SAFETY: this is the state that `acquire` returned
            unsafe { critical_section::release(restore) };
        }
    }

    unsafe fn write(bytes: &[u8]) {
        with(|State { encoder, frame, .. }| {
            if let Some(frame) = frame {
                encoder.write(bytes, |bytes| frame.extend(bytes));
            }
        });
    }
}

/// Returns the state; `None` when a log statement is nested in another, whose bytes are then lost.
fn with<T>(work: impl FnOnce(&mut State) -> T) -> Option<T> {
    critical_section::with(|cs| STATE.borrow(cs).try_borrow_mut().ok().map(|mut state| work(&mut state)))
}

defmt::timestamp!("{=u64:us}", embassy_time::Instant::now().as_micros());
