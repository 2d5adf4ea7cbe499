//! defmt's logger: frames in a ring buffer, whose destination is up to the image.
//!
//! A frame is encoded inside a critical section, which lasts as long as copying its bytes. A frame without room is dropped
//! and counted; [`dropped`] returns the count. An image sends the bytes in an interrupt ([`ring`], [`on_frame`]) or in a task
//! ([`read`]).
#![expect(unsafe_code, reason = "defmt's logger is an unsafe trait")]

use core::cell::{Cell, RefCell};
use core::future::poll_fn;
use core::task::Poll;

use critical_section::{Mutex, RestoreState};
use embassy_sync::waitqueue::AtomicWaker;

use crate::ring::{Frame, Ring};
use crate::sizes::size;

/// The size of the buffer, in bytes.
pub const SIZE: usize = size(option_env!("BCAP_BOARD_LOG"), 2048, 512, 65536);

static RING: Ring<SIZE> = Ring::new();
static READER: AtomicWaker = AtomicWaker::new();
static ON_FRAME: Mutex<Cell<FrameHook>> = Mutex::new(Cell::new(None));

/// The function that is called after each frame.
type FrameHook = Option<fn()>;

static STATE: Mutex<RefCell<LoggerState>> =
    Mutex::new(RefCell::new(LoggerState { encoder: defmt::Encoder::new(), frame: None, restore: None }));

struct LoggerState {
    encoder: defmt::Encoder,
    /// The frame being written.
    frame: Option<Frame<'static, SIZE>>,
    /// The critical section around a frame.
    restore: Option<RestoreState>,
}

/// Returns the buffer. It has one reader: the image or [`read`].
#[must_use]
pub const fn ring() -> &'static Ring<SIZE> {
    &RING
}

/// Returns the number of frames that were dropped since the start, because the buffer was full.
#[must_use]
pub fn dropped() -> u32 {
    RING.dropped()
}

/// Sets the function that is called after each frame, for example to start an interrupt that sends it.
pub fn on_frame(start: fn()) {
    critical_section::with(|cs| ON_FRAME.borrow(cs).set(Some(start)));
}

/// Waits for bytes of the log and moves them into a buffer; returns their number, which is above 0.
///
/// Cancel-safe: a dropped future has moved no bytes.
pub async fn read(buffer: &mut [u8]) -> usize {
    poll_fn(|context| {
        READER.register(context.waker());
        let mut count = 0;
        for (to, from) in buffer.iter_mut().zip(core::iter::from_fn(|| RING.pop())) {
            *to = from;
            count += 1;
        }
        if count > 0 { Poll::Ready(count) } else { Poll::Pending }
    })
    .await
}

#[defmt::global_logger]
struct Logger;

// SAFETY: each frame is written inside one critical section, so frames do not interleave
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: `release` ends the section
        let restore = unsafe { critical_section::acquire() };
        with(|LoggerState { encoder, frame, restore: restored }| {
            *restored = Some(restore);
            let frame = frame.insert(RING.begin());
            encoder.start_frame(|bytes| frame.extend(bytes));
        });
    }

    /// Does nothing: the destination of the bytes is up to the image.
    unsafe fn flush() {}

    unsafe fn release() {
        let restore = with(|LoggerState { encoder, frame, restore }| {
            if let Some(mut frame) = frame.take() {
                encoder.end_frame(|bytes| frame.extend(bytes));
                frame.end();
            }
            restore.take()
        });
        READER.wake();
        if let Some(start) = critical_section::with(|cs| ON_FRAME.borrow(cs).get()) {
            start();
        }
        if let Some(Some(restore)) = restore {
            // SAFETY: this is the state that `acquire` returned
            unsafe { critical_section::release(restore) };
        }
    }

    unsafe fn write(bytes: &[u8]) {
        with(|LoggerState { encoder, frame, .. }| {
            if let Some(frame) = frame {
                encoder.write(bytes, |bytes| frame.extend(bytes));
            }
        });
    }
}

/// Returns the state; `None` when a log statement is nested in another, whose bytes are then lost.
fn with<T>(work: impl FnOnce(&mut LoggerState) -> T) -> Option<T> {
    critical_section::with(|cs| STATE.borrow(cs).try_borrow_mut().ok().map(|mut state| work(&mut state)))
}

defmt::timestamp!("{=u64:us}", embassy_time::Instant::now().as_micros());
