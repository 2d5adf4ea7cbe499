//! The boot loader of WIZnet's W5500-EVB-Pico: swaps an update in, and back if it was not confirmed, then starts the image.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

#[path = "../../w5500-evb-pico/src/partitions.rs"]
mod partitions;

use core::cell::RefCell;
use core::ops::Range;
use core::panic::PanicInfo;

use bcap_board::signature::KEY;
use bcap_board::update::{StateFlash, check_pending};
use cortex_m::peripheral::SCB;
use embassy_boot_rp::{BootLoader, BootLoaderConfig, WatchdogFlash};
use embassy_embedded_hal::flash::partition::BlockingPartition;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::Duration;

use self::partitions::{BOARD, PARTITIONS};

const FLASH_SIZE: usize = 2 * 1024 * 1024;
/// The address at which the processor maps the flash.
const FLASH_ADDRESS: u32 = 0x1000_0000;
/// An image that does not start the watchdog again in this time is rolled back.
const WATCHDOG_TIME: Duration = Duration::from_secs(8);

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    SCB::sys_reset()
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let p = embassy_rp::init(Default::default());
    let mut flash = WatchdogFlash::<FLASH_SIZE>::start(p.FLASH, p.WATCHDOG, WATCHDOG_TIME);
    // an update without a valid signature is cancelled; a flash error is retried after the reset
    if KEY.is_some_and(|key| check_pending(&mut flash, &PARTITIONS, BOARD, &key).is_err()) {
        SCB::sys_reset()
    }
    let flash = Mutex::<NoopRawMutex, _>::new(RefCell::new(flash));
    let part = |range: &Range<u32>| BlockingPartition::new(&flash, range.start, range.end - range.start);
    // the offsets of the state count from the start of the flash
    let Ok(state) = StateFlash::new(part(&(0..PARTITIONS.state.end)), PARTITIONS.state) else { SCB::sys_reset() };
    let config = BootLoaderConfig { active: part(&PARTITIONS.active), dfu: part(&PARTITIONS.other), state };
    let loader = BootLoader::<4096>::prepare(config);
    start(loader)
}

#[expect(unsafe_code, reason = "another program is started, at an address that the compiler does not know")]
fn start(loader: BootLoader<4096>) -> ! {
    // SAFETY: the active partition starts with the vector table of an image; without one the watchdog resets the board
    unsafe { loader.load(FLASH_ADDRESS + PARTITIONS.active.start) }
}
