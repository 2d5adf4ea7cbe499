//! The console and the log as two serial ports (CDC ACM) over USB; on Linux `/dev/ttyACM0` and `/dev/ttyACM1`.

use embassy_futures::join::join4;
use embassy_time::{Duration, with_timeout};
use embassy_usb::class::cdc_acm::{CdcAcmClass, State};
use embassy_usb::driver::Driver;
use embassy_usb::{Builder, Config};
use embedded_storage::nor_flash::NorFlash;
use static_cell::{ConstStaticCell, StaticCell};

use crate::console::Console;
use crate::packets::Packets;
use crate::port;
use crate::slots::Slots;
#[cfg(feature = "update")]
use crate::update::Updates;

/// The test pair of pid.codes; a product needs its own pair.
const VENDOR: u16 = 0x1209;
const PRODUCT: u16 = 0x0001;
/// The time in which a host takes the answer to `restart`.
const ANSWER_TIME: Duration = Duration::from_secs(1);
/// The packet size of full speed.
const PACKET: u16 = 64;

/// Serves both ports; calls `restart` when the host requests it. Call it once.
pub async fn run<D: Driver<'static>, F: NorFlash>(driver: D, slots: Slots<F>, restart: fn() -> !) {
    run_console(driver, || port::console(slots), restart).await;
}

/// Same as [`run`], and receives updates, if the image has partitions for them.
#[cfg(feature = "update")]
pub async fn run_with_updates<D: Driver<'static>, F: NorFlash>(
    driver: D,
    slots: Slots<F>,
    updates: Option<Updates>,
    restart: fn() -> !,
) {
    run_console(driver, || port::console_with_updates(slots, updates), restart).await;
}

/// `make` makes the console here, because an async function has a second copy of each argument.
async fn run_console<D: Driver<'static>, F: NorFlash>(
    driver: D,
    make: impl FnOnce() -> Console<'static, F>,
    restart: fn() -> !,
) {
    static BUFFERS: ConstStaticCell<([u8; 256], [u8; 64], [u8; 64])> =
        ConstStaticCell::new(([0; 256], [0; 64], [0; 64]));
    static STATES: StaticCell<[State<'static>; 2]> = StaticCell::new();
    static PACKET_MEMORY: ConstStaticCell<[u8; PACKET as usize]> = ConstStaticCell::new([0; PACKET as usize]);

    let (descriptors, bos, control) = BUFFERS.take();
    let [console_state, log_state] = STATES.init([State::new(), State::new()]);
    let mut config = Config::new(VENDOR, PRODUCT);
    config.manufacturer = Some("bcap");
    config.product = Some("b-CAP gateway: console and log");
    let mut builder = Builder::new(driver, config, descriptors, bos, &mut [], control);
    let (sender, receiver) = CdcAcmClass::new(&mut builder, console_state, PACKET).split();
    let (log, _) = CdcAcmClass::new(&mut builder, log_state, PACKET).split();
    let mut sender = Packets::<_, { PACKET as usize }>::new(sender);
    let mut log = Packets::<_, { PACKET as usize }>::new(log);
    let mut receiver = receiver.into_buffered(PACKET_MEMORY.take());
    let (console, answer) = (port::cell(make), port::answer());

    let serve = async {
        loop {
            sender.sender.wait_connection().await;
            // an error means that the host is gone
            if port::serve(&console, answer, &mut receiver, &mut sender).await.is_ok() {
                // the endpoint accepts an empty packet once the host has taken the answer; `flush` does not wait for that
                let _ = with_timeout(ANSWER_TIME, sender.sender.write_packet(&[])).await;
                restart();
            }
        }
    };
    let send_log = async {
        loop {
            log.sender.wait_connection().await;
            let _ = port::send_log(&mut log).await;
        }
    };
    let mut device = builder.build();
    join4(device.run(), serve, send_log, port::judge(&console, port::TRIAL, restart)).await;
}
