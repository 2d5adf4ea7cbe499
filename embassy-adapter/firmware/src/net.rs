//! embassy-net on the board: the Ethernet controller, the network stack and its address.

use bcap_board::Settings;
use embassy_net::{Config, ConfigV4, DhcpConfig, Ipv4Cidr, Runner, Stack, StackResources, StaticConfigV4};
use embassy_time::{Duration, Instant, with_timeout};
use static_cell::{ConstStaticCell, StaticCell};

use crate::fault;
use crate::lan9118::{Frames, Lan9118};

/// How long to wait for DHCP before using the configured address.
const DHCP_TIME: Duration = Duration::from_secs(5);

/// The runner that moves frames; one task must run it.
pub type NetRunner = Runner<'static, &'static mut Lan9118<'static>>;

/// Starts the network; `mac` is the default MAC address for settings without one. Call it once.
///
/// Without an Ethernet controller the program ends. Not inlined, because the network stack is built on the call stack.
#[inline(never)]
pub fn start<const SOCKETS: usize>(
    settings: &Settings<'_>,
    mac: [u8; 6],
    resources: &'static mut StackResources<SOCKETS>,
) -> (Stack<'static>, NetRunner) {
    static FRAMES: ConstStaticCell<Frames> = ConstStaticCell::new(Frames::new());
    static DEVICE: StaticCell<Lan9118<'static>> = StaticCell::new();

    let device = match Lan9118::new(settings.mac.unwrap_or(mac), FRAMES.take()) {
        Ok(device) => DEVICE.init(device),
        Err(error) => {
            defmt::error!("no Ethernet controller: {}", error);
            fault::end()
        }
    };
    let config = match settings.dhcp {
        true => Config::dhcpv4(DhcpConfig::default()),
        false => Config::ipv4_static(own(settings)),
    };
    embassy_net::new(device, config, resources, Instant::now().as_ticks())
}

/// Waits for an address from DHCP; after a timeout uses the configured address.
pub async fn find_address(stack: Stack<'_>, settings: &Settings<'_>) {
    if with_timeout(DHCP_TIME, stack.wait_config_up()).await.is_err() {
        if settings.dhcp {
            defmt::warn!("no DHCP server answers, using the configured address");
            stack.set_config_v4(ConfigV4::Static(own(settings)));
        }
        stack.wait_config_up().await;
    }
    if let Some(found) = stack.config_v4() {
        defmt::info!("address {}", found.address);
    }
}

/// Returns the configured address.
fn own(settings: &Settings<'_>) -> StaticConfigV4 {
    let (address, prefix) = settings.address;
    StaticConfigV4 {
        address: Ipv4Cidr::new(address, prefix),
        gateway: Some(settings.gateway),
        dns_servers: Default::default(),
    }
}
