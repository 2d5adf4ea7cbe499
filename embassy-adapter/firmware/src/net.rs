//! embassy-net on the board: the Ethernet controller, the network stack and its address.

use bcap_board::Settings;
use embassy_net::{Config, ConfigV4, DhcpConfig, Ipv4Cidr, Runner, Stack, StackResources, StaticConfigV4};
use embassy_time::{Duration, Instant, Timer, with_timeout};
use static_cell::{ConstStaticCell, StaticCell};

use crate::fault;
use crate::lan9118::{Frames, Lan9118};

/// How long to wait for DHCP, from the link on, before using the configured address.
const DHCP_TIME: Duration = Duration::from_secs(5);
/// The pause before asking again. A test has less time.
const DHCP_AGAIN: Duration = Duration::from_secs(if cfg!(feature = "faults") { 3 } else { 60 });

/// The runner that moves frames; one task must run it.
pub type NetRunner = Runner<'static, &'static mut Lan9118<'static>>;

/// Starts the network. Call it once.
///
/// Without an Ethernet controller the program ends. Not inlined, because the network stack is built on the call stack.
#[inline(never)]
pub fn start<const SOCKETS: usize>(
    settings: &Settings<'_>,
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
    let config = match own(settings).filter(|_| !settings.dhcp) {
        Some(own) => Config::ipv4_static(own),
        None => Config::dhcpv4(dhcp(settings)),
    };
    let mac = device.address();
    embassy_net::new(device, config, resources, seed(mac))
}

/// Waits for an address: from DHCP, or the configured one if no server answers within 5 s of a link.
///
/// Without a configured address it waits for DHCP for ever.
pub async fn find_address(stack: Stack<'_>, settings: &Settings<'_>) {
    stack.wait_link_up().await;
    if with_timeout(DHCP_TIME, stack.wait_config_up()).await.is_err() {
        if let (true, Some(own)) = (settings.dhcp, own(settings)) {
            defmt::warn!("no DHCP server answers, using the configured address");
            stack.set_config_v4(ConfigV4::Static(own));
        }
        stack.wait_config_up().await;
    }
    if let Some(found) = stack.config_v4() {
        defmt::info!("address {}", found.address);
    }
}

/// Asks for an address by DHCP again while the board has only the configured one and does not reach what it needs.
///
/// A switch and a DHCP server may start later than the board. `is_useful` tells whether the address works.
pub async fn improve_address(stack: Stack<'_>, settings: &Settings<'_>, is_useful: impl Fn() -> bool) -> ! {
    loop {
        Timer::after(DHCP_AGAIN).await;
        let has_own = stack.config_v4().is_some_and(|found| Some(&found) == own(settings).as_ref());
        if settings.dhcp && has_own && !is_useful() {
            stack.set_config_v4(ConfigV4::Dhcp(dhcp(settings)));
            find_address(stack, settings).await;
        }
    }
}

/// Returns the configuration of DHCP, with the board's name.
fn dhcp(settings: &Settings<'_>) -> DhcpConfig {
    let mut config = DhcpConfig::default();
    // the settings accept only names that fit
    config.hostname = settings.hostname.and_then(|name| name.try_into().ok());
    config
}

/// Returns the configured address.
fn own(settings: &Settings<'_>) -> Option<StaticConfigV4> {
    let (address, prefix) = settings.address?;
    let address = Ipv4Cidr::new(address, prefix);
    Some(StaticConfigV4 { address, gateway: settings.gateway, dns_servers: Default::default() })
}

/// Returns a seed for port numbers and the like. This board has no source of random numbers, so the seed is the MAC address
/// and the time, which differ between boards and a little between starts.
fn seed([a, b, c, d, e, f]: [u8; 6]) -> u64 {
    u64::from_le_bytes([a, b, c, d, e, f, 0, 0]).rotate_left(20) ^ Instant::now().as_ticks()
}
