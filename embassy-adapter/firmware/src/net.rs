//! embassy-net on the board: the Ethernet controller and the network stack.

use bcap_board::{Settings, address, network};
use embassy_net::{Stack, StackResources};
use embassy_time::{Duration, Instant};
use static_cell::{ConstStaticCell, StaticCell};

use crate::fault;
use crate::lan9118::{Frames, Lan9118};

/// The pause before the board requests an address again. A test has less time.
pub const DHCP_AGAIN: Duration = if cfg!(feature = "faults") { Duration::from_secs(3) } else { address::DHCP_AGAIN };

/// The runner that moves frames; one task must run it.
pub type NetRunner = network::Runner<&'static mut Lan9118<'static>>;

/// Starts the network. Call it once.
///
/// Without an Ethernet controller the program ends.
pub fn start<const SOCKETS: usize>(
    settings: &'static Settings<'static>,
    resources: &'static mut StackResources<SOCKETS>,
) -> (Stack<'static>, NetRunner) {
    static FRAMES: ConstStaticCell<Frames> = ConstStaticCell::new(Frames::new());
    static DEVICE: StaticCell<Lan9118<'static>> = StaticCell::new();

    let device = match Lan9118::new(settings.mac, FRAMES.take()) {
        Ok(device) => DEVICE.init(device),
        Err(error) => {
            defmt::error!("no Ethernet controller: {}", error);
            fault::end()
        }
    };
    let mac = device.address();
    network::start(device, settings, resources, seed(mac))
}

/// Returns a seed for port numbers and the like. This board has no source of random numbers, so the seed is the MAC address
/// and the time, which differ between boards and a little between starts.
fn seed([a, b, c, d, e, f]: [u8; 6]) -> u64 {
    u64::from_le_bytes([a, b, c, d, e, f, 0, 0]).rotate_left(20) ^ Instant::now().as_ticks()
}
