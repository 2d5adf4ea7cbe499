//! The board's address on embassy-net: by DHCP, or the configured one.

#[cfg(feature = "port")]
use core::cell::Cell;
#[cfg(feature = "port")]
use core::future::poll_fn;
#[cfg(feature = "port")]
use core::task::Poll;

use embassy_net::{Config, ConfigV4, DhcpConfig, Ipv4Cidr, Stack, StaticConfigV4};
#[cfg(feature = "port")]
use embassy_sync::blocking_mutex::Mutex;
#[cfg(feature = "port")]
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
#[cfg(feature = "port")]
use embassy_sync::waitqueue::AtomicWaker;
use embassy_time::{Duration, Timer, with_timeout};

use crate::Settings;

/// How long to wait for DHCP, from the link on, before using the configured address.
const DHCP_TIME: Duration = Duration::from_secs(5);

/// The pause after which [`improve`] asks again.
pub const DHCP_AGAIN: Duration = Duration::from_secs(60);

/// The address that was found last, for the console.
#[cfg(feature = "port")]
static FOUND: Mutex<CriticalSectionRawMutex, Cell<Option<Ipv4Cidr>>> = Mutex::new(Cell::new(None));
#[cfg(feature = "port")]
static CONSOLE: AtomicWaker = AtomicWaker::new();

/// Waits until the board has another address than `known`. One console at a time can wait.
#[cfg(feature = "port")]
pub(crate) async fn changed(known: Option<Ipv4Cidr>) -> Ipv4Cidr {
    poll_fn(|context| {
        CONSOLE.register(context.waker());
        FOUND.lock(Cell::get).filter(|found| Some(*found) != known).map_or(Poll::Pending, Poll::Ready)
    })
    .await
}

/// Returns the configuration to create the network stack with.
#[must_use]
pub(crate) fn config(settings: &Settings<'_>) -> Config {
    match own(settings).filter(|_| !settings.dhcp) {
        Some(own) => Config::ipv4_static(own),
        None => Config::dhcpv4(dhcp(settings)),
    }
}

/// Waits for an address: from DHCP, or the configured one if no server answers within 5 s of a link.
///
/// Without a configured address it waits for DHCP for ever.
pub async fn find(stack: Stack<'_>, settings: &Settings<'_>) {
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
        #[cfg(feature = "port")]
        {
            FOUND.lock(|cell| cell.set(Some(found.address)));
            CONSOLE.wake();
        }
    }
}

/// Retries DHCP after each pause while the board uses the configured address and `is_useful` returns false.
///
/// A switch and a DHCP server may start later than the board.
pub async fn improve(stack: Stack<'_>, settings: &Settings<'_>, pause: Duration, is_useful: impl Fn() -> bool) -> ! {
    loop {
        Timer::after(pause).await;
        let has_own = stack.config_v4().is_some_and(|found| Some(&found) == own(settings).as_ref());
        if settings.dhcp && has_own && !is_useful() {
            stack.set_config_v4(ConfigV4::Dhcp(dhcp(settings)));
            find(stack, settings).await;
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
