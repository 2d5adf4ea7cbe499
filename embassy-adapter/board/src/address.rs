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

/// The pause before a DHCP request without an answer is repeated. With the 10 s of smoltcp, one lost frame would cost the
/// address.
const DHCP_RETRY: core::time::Duration = core::time::Duration::from_secs(2);

/// The pause between two polls of the network stack.
const LOOK: Duration = Duration::from_millis(250);

/// The pause after which [`keep`] requests an address again.
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
/// Without a configured address it waits for DHCP indefinitely.
pub async fn find(stack: Stack<'_>, settings: &Settings<'_>) {
    loop {
        until(|| stack.is_link_up()).await;
        if with_timeout(DHCP_TIME, until(|| stack.is_config_up())).await.is_ok() {
            break;
        }
        // DHCP did not get its full time if the link went down during the wait
        if stack.is_link_up()
            && settings.dhcp
            && let Some(own) = own(settings)
        {
            defmt::warn!("no DHCP server answers, using the configured address");
            stack.set_config_v4(ConfigV4::Static(own));
        }
    }
    if let Some(found) = stack.config_v4() {
        defmt::info!("address {}", found.address);
    }
    #[cfg(feature = "port")]
    publish(stack);
}

/// Passes the address to the console if it has changed.
#[cfg(feature = "port")]
fn publish(stack: Stack<'_>) {
    let found = stack.config_v4().map(|config| config.address);
    if found.is_some() && FOUND.lock(|cell| cell.replace(found)) != found {
        CONSOLE.wake();
    }
}

/// Finds an address again when it is lost: the link was down, or the lease has ended and no server extends it.
///
/// After each pause it tries DHCP again while the board uses the configured address and `is_useful` returns false. A switch and
/// a DHCP server may start later than the board.
pub async fn keep(stack: Stack<'_>, settings: &Settings<'_>, pause: Duration, is_useful: impl Fn() -> bool) -> ! {
    let is_lost = || {
        // one lease can replace another between two polls
        #[cfg(feature = "port")]
        publish(stack);
        !stack.is_config_up()
    };
    loop {
        if with_timeout(pause, until(is_lost)).await.is_err() {
            let has_own = stack.config_v4().is_some_and(|found| Some(&found) == own(settings).as_ref());
            if !settings.dhcp || !has_own || is_useful() {
                continue;
            }
            stack.set_config_v4(ConfigV4::Dhcp(dhcp(settings)));
        }
        find(stack, settings).await;
    }
}

/// Waits for a state of the network stack. It polls every [`LOOK`], because embassy-net wakes only one task: two tasks that
/// wait for its state would wake each other endlessly.
async fn until(is_reached: impl Fn() -> bool) {
    while !is_reached() {
        Timer::after(LOOK).await;
    }
}

/// Returns the configuration of DHCP, with the board's name.
fn dhcp(settings: &Settings<'_>) -> DhcpConfig {
    let mut config = DhcpConfig::default();
    let retry = &mut config.retry_config;
    (retry.discover_timeout, retry.initial_request_timeout) = (DHCP_RETRY.into(), DHCP_RETRY.into());
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
