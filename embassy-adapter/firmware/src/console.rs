//! The second serial port, on which a host changes the settings and the image; [`bcap_board::console`] documents the protocol.

use core::cell::RefCell;
use core::future;

use bcap_board::port;
use cortex_m::peripheral::SCB;
use embassy_futures::join::join;
use embassy_time::Duration;

use crate::lines::Line;
use crate::{flash, uart};

/// How long an update may take to serve its first request. A test has less time.
const TRIAL: Duration = if cfg!(feature = "faults") { Duration::from_secs(20) } else { port::TRIAL };

/// Serves the console. Call it once.
pub async fn run() -> ! {
    let slots = match flash::slots() {
        Ok(slots) => slots,
        Err(error) => {
            defmt::error!("no console: {}", defmt::Display2Format(&error));
            future::pending().await
        }
    };
    #[cfg(feature = "update")]
    let console = port::console_with_updates(slots, Some(crate::update::updates()));
    #[cfg(not(feature = "update"))]
    let console = port::console(slots);
    let (console, answer) = (RefCell::new(console), port::answer());
    let line = Line::second();
    let serve = async {
        let Ok(_) = port::serve(&console, answer, &mut line.clone(), &mut line.clone()).await;
        restart();
    };
    join(serve, port::judge(&console, TRIAL, restart)).await.0
}

/// Restarts the board once the answer and the log have left.
fn restart() -> ! {
    defmt::info!("restart");
    Line::flush_second();
    uart::flush();
    SCB::sys_reset()
}
