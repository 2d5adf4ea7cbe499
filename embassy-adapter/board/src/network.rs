//! embassy-net over the driver of a board: it receives only valid leases and packets that can be answered, and a silent
//! Ethernet controller is detected.
//!
//! ```text
//!  driver ─► Checked: drops invalid leases of DHCP and packets that cannot be answered, counts as a sign of life ─► embassy-net
//! ```

use core::cell::Cell;
use core::task::Context;

use embassy_net::driver::{Capabilities, Driver, HardwareAddress, LinkState, RxToken, TxToken};
use embassy_net::{Stack, StackResources, StaticConfigV4};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Instant, Timer};

use crate::lease::{Lease, RefusedLease, check};
use crate::lldp;
use crate::neighbors::{FRAME, Neighbors, Route};
use crate::parts::Parts;
use crate::{Settings, address};

/// The time without a frame, while the link is up, after which the Ethernet controller counts as dead, if it has received
/// frames before: a network without any traffic must not cause a reset.
pub const SILENCE: Duration = Duration::from_secs(300);

/// The pause between two offers that the network stack gets. Otherwise the stack would send requests without a pause to a
/// server that refuses its own offers; after a dropped offer, the stack repeats its request after 2 s.
const OFFER_PAUSE: Duration = Duration::from_secs(1);

/// The pause between two lines of the log about refused leases.
const LOG_PAUSE: Duration = Duration::from_secs(1);

/// The pause between two frames of LLDP; one is sent when the network stack runs next.
const LLDP_PAUSE: Duration = Duration::from_secs(30);

/// The pause between two reads of the board's address.
const FOLLOW_PAUSE: Duration = Duration::from_millis(250);

/// The network stack of a board, which one task must run.
pub type Runner<D> = embassy_net::Runner<'static, Checked<D>>;

/// The last sign of life of the Ethernet controller.
#[derive(Clone, Copy)]
struct Life {
    has_received: bool,
    /// Since when no frame has been received over a link that is up.
    silent_since: Option<Instant>,
}

static LIFE: Mutex<CriticalSectionRawMutex, Cell<Life>> =
    Mutex::new(Cell::new(Life { has_received: false, silent_since: None }));

/// The state of [`random`].
static RANDOM: Mutex<CriticalSectionRawMutex, Cell<u64>> = Mutex::new(Cell::new(0));

/// Returns a number that a host cannot guess if the seed of the board is random: splitmix64, with the time in it.
#[cfg(feature = "health")]
pub(crate) fn random() -> u64 {
    let state = RANDOM.lock(|state| {
        state.set((state.get() ^ Instant::now().as_ticks()).wrapping_add(0x9e37_79b9_7f4a_7c15));
        state.get()
    });
    let mixed = (state ^ state >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ mixed >> 31
}

/// The board's place in its network, once it has an address.
static ROUTE: Mutex<CriticalSectionRawMutex, Cell<Option<Route>>> = Mutex::new(Cell::new(None));
/// The name of the board and the version of its image.
static DESCRIPTION: Mutex<CriticalSectionRawMutex, Cell<[&str; 2]>> = Mutex::new(Cell::new([""; 2]));

/// Creates the network stack of a board, with the address of the settings or of a DHCP server. Call it once.
///
/// Not inlined, because the network stack is built on the call stack.
#[inline(never)]
pub fn start<D: Driver, const SOCKETS: usize>(
    driver: D,
    settings: &'static Settings<'static>,
    resources: &'static mut StackResources<SOCKETS>,
    seed: u64,
) -> (Stack<'static>, Runner<D>) {
    let (next_offer, next_line) = (Instant::MIN, Instant::MIN);
    let filter = Filter { settings, next_offer, told: None, next_line, neighbors: Neighbors::default() };
    let driver = Checked { driver, filter, next_lldp: Instant::MIN };
    RANDOM.lock(|state| state.set(!seed));
    embassy_net::new(driver, address::config(settings), resources, seed)
}

/// Returns whether the controller has received no frame for this time while its link is up, and had received frames before.
#[must_use]
pub fn is_dead(silence: Duration) -> bool {
    let Life { has_received, silent_since } = LIFE.lock(Cell::get);
    has_received && silent_since.is_some_and(|since| since.elapsed() > silence)
}

/// Sets the [`description`].
pub(crate) fn describe(parts: &Parts) {
    DESCRIPTION.lock(|cell| cell.set([parts.name, parts.version]));
}

/// Returns the name of the board and the version of its image, for LLDP and `find`.
pub(crate) fn description() -> [&'static str; 2] {
    DESCRIPTION.lock(Cell::get)
}

/// Keeps the driver informed of the board's address and router. The driver cannot read them itself, because the stack is
/// borrowed when it calls the driver.
pub(crate) async fn follow(stack: Stack<'_>) -> ! {
    loop {
        let route = stack.config_v4().map(|StaticConfigV4 { address, gateway: router, .. }| {
            let own = (address.address(), address.prefix_len());
            Route { own, router }
        });
        ROUTE.lock(|cell| cell.set(route));
        Timer::after(FOLLOW_PAUSE).await;
    }
}

/// A driver whose frames are checked before the network stack gets them.
pub struct Checked<D> {
    driver: D,
    filter: Filter,
    next_lldp: Instant,
}

/// Filters the frames that the network stack gets.
struct Filter {
    settings: &'static Settings<'static>,
    next_offer: Instant,
    /// The refusal that was last logged.
    told: Option<RefusedLease>,
    /// The earliest time of the next line about a refusal.
    next_line: Instant,
    neighbors: Neighbors,
}

impl<D> core::fmt::Debug for Checked<D> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Checked").finish_non_exhaustive()
    }
}

impl<D: Driver> Driver for Checked<D> {
    type RxToken<'a>
        = CheckedFrame<'a, D::RxToken<'a>>
    where
        Self: 'a;
    type TxToken<'a>
        = D::TxToken<'a>
    where
        Self: 'a;

    fn receive(&mut self, cx: &mut Context<'_>) -> Option<(Self::RxToken<'_>, Self::TxToken<'_>)> {
        let HardwareAddress::Ethernet(mac) = self.driver.hardware_address() else { return None };
        let Self { driver, filter, next_lldp } = self;
        if let Some(Route { own, .. }) = ROUTE.lock(Cell::get) {
            let settings = filter.settings;
            if settings.find
                && Instant::now() >= *next_lldp
                && let Some(room) = driver.transmit(cx)
            {
                *next_lldp = Instant::now().saturating_add(LLDP_PAUSE);
                let [name, version] = description();
                let mut frame = [0; lldp::FRAME];
                let host = settings.hostname.unwrap_or_default();
                let len = lldp::write(mac, own.0, host, [name, " ", version], &mut frame);
                room.consume(len, |room| room.iter_mut().zip(frame).for_each(|(to, from)| *to = from));
            }
            if let Some(request) = filter.neighbors.request(own, mac)
                && let Some(room) = driver.transmit(cx)
            {
                room.consume(FRAME, |frame| frame.iter_mut().zip(request).for_each(|(to, from)| *to = from));
            }
            if let Some(reply) = filter.neighbors.reply(own, mac) {
                return driver.transmit(cx).map(|room| (CheckedFrame(Inner::Reply(reply)), room));
            }
        }
        let (frame, room) = driver.receive(cx)?;
        LIFE.lock(|life| life.set(Life { has_received: true, silent_since: Some(Instant::now()) }));
        Some((CheckedFrame(Inner::Received { frame, mac, filter }), room))
    }

    fn transmit(&mut self, cx: &mut Context<'_>) -> Option<Self::TxToken<'_>> {
        self.driver.transmit(cx)
    }

    fn link_state(&mut self, cx: &mut Context<'_>) -> LinkState {
        let state = self.driver.link_state(cx);
        LIFE.lock(|cell| {
            let life = cell.get();
            let silent_since = match state {
                LinkState::Up => life.silent_since.or_else(|| Some(Instant::now())),
                LinkState::Down => None,
            };
            cell.set(Life { silent_since, ..life });
        });
        state
    }

    fn capabilities(&self) -> Capabilities {
        self.driver.capabilities()
    }

    fn hardware_address(&self) -> HardwareAddress {
        self.driver.hardware_address()
    }
}

/// A received frame that is checked before the network stack gets it.
#[derive(Debug)]
pub struct CheckedFrame<'a, T>(Inner<'a, T>);

enum Inner<'a, T> {
    Received {
        frame: T,
        mac: [u8; 6],
        filter: &'a mut Filter,
    },
    /// An ARP reply of a known neighbor.
    Reply([u8; FRAME]),
}

impl<T> core::fmt::Debug for Inner<'_, T> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(if let Self::Reply(_) = self { "Reply" } else { "Received" })
    }
}

impl<T: RxToken> RxToken for CheckedFrame<'_, T> {
    fn consume<R, F>(self, take: F) -> R
    where
        F: FnOnce(&mut [u8]) -> R,
    {
        match self.0 {
            Inner::Received { frame, mac, filter } => frame.consume(|frame| match filter.may_pass(frame, mac) {
                true => take(frame),
                // the network stack skips an empty frame
                false => take(&mut []),
            }),
            Inner::Reply(mut reply) => take(&mut reply),
        }
    }
}

impl Filter {
    /// Returns whether the network stack may have a frame; logs a refused lease, unless it repeats the last refusal, at most
    /// one a second.
    fn may_pass(&mut self, frame: &mut [u8], mac: [u8; 6]) -> bool {
        // wraps, as the neighbors expect
        let now = Instant::now().as_millis() as u32;
        if !ROUTE.lock(Cell::get).is_none_or(|route| self.neighbors.may_pass(frame, route, mac, now)) {
            return false;
        }
        match check(frame, mac, |own| self.settings.accepts(own)) {
            Ok(Some(Lease { is_offer: true })) => {
                let now = Instant::now();
                let is_early = now < self.next_offer;
                if !is_early {
                    self.next_offer = now.saturating_add(OFFER_PAUSE);
                }
                !is_early
            }
            Ok(_) => true,
            Err(refused) => {
                let now = Instant::now();
                if self.told != Some(refused) && now >= self.next_line {
                    (self.told, self.next_line) = (Some(refused), now.saturating_add(LOG_PAUSE));
                    let RefusedLease { server, address, reason } = refused;
                    defmt::warn!("DHCP: refused {} from {}: {=str}", address, server, reason.text());
                }
                false
            }
        }
    }
}
