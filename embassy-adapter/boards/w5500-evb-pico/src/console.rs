//! The console, with updates if the image was built for them.

#[cfg(feature = "updates")]
#[path = "partitions.rs"]
mod partitions;

use bcap_board::slots::Slots;
use bcap_board::usb;
use cortex_m::peripheral::SCB;
use embassy_rp::peripherals::USB;
use embassy_rp::usb::Driver;

use crate::BoardFlash;

#[cfg(feature = "updates")]
static IDENTITY: bcap_board::identity::Identity =
    bcap_board::identity::Identity::new(partitions::BOARD, env!("CARGO_PKG_VERSION"));

pub(crate) async fn serve(driver: Driver<'static, USB>, slots: Slots<BoardFlash>) {
    #[cfg(feature = "updates")]
    usb::run_with_updates(driver, slots, Some((partitions::PARTITIONS, &IDENTITY)), || SCB::sys_reset()).await;
    #[cfg(not(feature = "updates"))]
    usb::run(driver, slots, || SCB::sys_reset()).await;
}
