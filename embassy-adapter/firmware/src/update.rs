//! Updates of the image `gateway`: its partitions, its identity, and the work of the boot loader.
#![expect(unsafe_code, reason = "another program is started, at an address that the compiler does not know")]

use core::cell::RefCell;
use core::ops::Range;

use bcap_board::identity::Identity;
use bcap_board::signature::KEY;
use bcap_board::update::{Partitions, StateFlash, Updates, check_pending};
use cortex_m::peripheral::SCB;
use embassy_boot::{BootError, BootLoader, BootLoaderConfig, State};
use embassy_embedded_hal::flash::partition::BlockingPartition;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;

use crate::board::FLASH;
use crate::flash::layout::{ACTIVE, HISTORY, OTHER, SECTOR, SIGNATURE, STATE};
use crate::flash::start_of_loader;

const BOARD: &str = if cfg!(feature = "mps2-an385") { "mps2-an385" } else { "mps2-an386" };
static IDENTITY: Identity = Identity::new(BOARD, env!("CARGO_PKG_VERSION"));

/// Returns the partitions and the identity of the image.
#[must_use]
pub const fn updates() -> Updates {
    (PARTITIONS, &IDENTITY)
}

const PARTITIONS: Partitions =
    Partitions { active: ACTIVE, other: OTHER, state: STATE, history: HISTORY, signature: SIGNATURE };

/// Swaps an update in, and back if it was not confirmed.
///
/// # Errors
///
/// The flash has failed; the next start continues.
pub fn prepare() -> Result<State, BootError> {
    let mut flash = start_of_loader();
    if let Some(key) = KEY {
        // a refused image is cancelled; the flash of this board does not fail
        check_pending(&mut flash, &PARTITIONS, BOARD, &key).map_err(|_| BootError::BadMagic)?;
    }
    let flash = Mutex::<NoopRawMutex, _>::new(RefCell::new(flash));
    let part = |range: &Range<u32>| BlockingPartition::new(&flash, range.start, range.end - range.start);
    // the offsets of the state count from the start of the flash
    let state = StateFlash::new(part(&(0..OTHER.end)), STATE)?;
    let config = BootLoaderConfig { active: part(&ACTIVE), dfu: part(&OTHER), state };
    BootLoader::new(config).prepare_boot(&mut [0; SECTOR])
}

/// Starts the image in the active partition. Without a valid one, the board hangs or faults, and is reset.
pub fn start() -> ! {
    let image = u32::try_from(FLASH).unwrap_or_default() + ACTIVE.start;
    // SAFETY: the boot loader has enabled no interrupt, and its part of the program ends here; the active partition starts with
    // the vector table of an image. The guard of the stack stays active: `build.rs` gives both images the same memory for
    // stacks
    unsafe {
        (*SCB::PTR).vtor.write(image);
        cortex_m::asm::bootload(core::ptr::with_exposed_provenance(
            FLASH + usize::try_from(ACTIVE.start).unwrap_or_default(),
        ))
    }
}
