//! The log of a gateway: its status line, refusals, and the connections of clients and of the robot.
//!
//! A line about a client is written at most once a second for each client and reason; the next line reports how many were left
//! out.

use core::cell::RefCell;
use core::net::{Ipv4Addr, SocketAddrV4};

use bcap_core::time::micros;
use bcap_embassy::clock::now;
use bcap_embassy::gateway::{Denial, Report};
use bcap_gateway::{Event, Gateway, Refusal, Tally};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;

use crate::limiter::Limiter;
use crate::parts::Parts;

/// Limits the lines about clients.
static LIMITER: Mutex<CriticalSectionRawMutex, RefCell<Limiter<16>>> = Mutex::new(RefCell::new(Limiter::new()));

/// Logs the state of the gateway and of the board.
pub fn status(gateway: &Gateway<'_>, parts: &Parts) {
    let counters = gateway.counters();
    let (used, size) = (parts.stack)();
    defmt::info!(
        "up {=u64} s, robot {=str} ({=u32}), served {}, failed {}, refused {=u32}, {}, stack {=usize} of {=usize}, \
         log dropped {=u32}",
        now().as_micros() / 1_000_000,
        if gateway.is_up() { "up" } else { "down" },
        counters.connected,
        Times(&counters.served),
        Times(&counters.failed),
        counters.refused,
        Frames(parts.frames),
        used,
        size,
        (parts.dropped)(),
    );
}

/// Logs how many lines were left out for each client and reason. Call it periodically.
pub fn left_out() {
    with_limiter(|limiter| {
        limiter
            .drain(|client, reason, count| defmt::info!("{}: {=u32} more of: {=str}", Address(client), count, reason))
    });
}

/// Formats the counters of the Ethernet controller.
struct Frames(fn(defmt::Formatter<'_>));

impl defmt::Format for Frames {
    fn format(&self, f: defmt::Formatter<'_>) {
        (self.0)(f);
    }
}

/// Formats a tally: the count, the median, the 99th percentile and the maximum, in microseconds.
struct Times<'a>(&'a Tally);

impl defmt::Format for Times<'_> {
    fn format(&self, f: defmt::Formatter<'_>) {
        let Self(tally) = self;
        defmt::write!(
            f,
            "{=u32} (p50 {=u64} us, p99 {=u64} us, longest {=u64} us)",
            tally.count(),
            micros(tally.percentile(50)),
            micros(tally.percentile(99)),
            micros(tally.max())
        );
    }
}

/// Logs refusals, failures, and the connections of clients and of the robot.
pub fn log(report: &Report<'_>) {
    #[cfg(feature = "health")]
    crate::messages::report(report);
    match *report {
        Report::Connected { client } => limited(client, "connected", |left_out| {
            defmt::info!("{}: connected{}", Client(client), left_out);
        }),
        Report::Disconnected { client, ended } => limited(client, "disconnected", |left_out| {
            defmt::info!("{}: disconnected: {}{}", Client(client), ended, left_out);
        }),
        Report::Denied { client, reason } => {
            let name = if reason == Denial::Full { "not served: full" } else { "not served: address" };
            limited(client, name, |left_out| {
                defmt::warn!("{}: not served: {}{}", Client(client), reason, left_out);
            })
        }
        Report::Answered { client, line, event: Event::Refused { refusal, .. } } => {
            limited(client, name(&refusal), |left_out| {
                defmt::warn!("{}: refused {=[u8]:a}: {}{}", Client(client), line, refusal, left_out);
            })
        }
        Report::Answered { client, line, event: Event::Failed { result, .. } } => {
            defmt::debug!("{}: failed {=[u8]:a}: {}", Client(client), line, result)
        }
        Report::Robot { event: Event::RobotDown { error, pause }, cause } => {
            let pause = u32::try_from(pause.as_millis()).unwrap_or(u32::MAX);
            defmt::warn!("robot down: {} {}, retry in {=u32} ms", error, cause, pause)
        }
        Report::Robot { .. } => defmt::info!("robot up"),
        _ => {}
    }
}

/// Logs that a host may not send updates.
#[cfg(all(feature = "update", feature = "port"))]
pub(crate) fn refused_host(host: Option<SocketAddrV4>) {
    limited(host, "may not send updates", |left_out| {
        defmt::warn!("{}: may not send updates{}", Client(host), left_out);
    });
}

/// Returns the name of a refusal's reason, for the limits of the log.
fn name(refusal: &Refusal) -> &'static str {
    match refusal {
        Refusal::Line(_) => "refused: invalid line",
        Refusal::Rate => "refused: rate",
        Refusal::ReadOnly => "refused: read-only",
        Refusal::Kind => "refused: kind",
        Refusal::Index => "refused: index",
        Refusal::Type => "refused: type",
        Refusal::Value => "refused: value",
        Refusal::NotFinite => "refused: not finite",
        Refusal::SlaveMode => "refused: slave mode",
        _ => "refused",
    }
}

/// Writes a line about a client, at most one a second for each client and reason.
fn limited(client: Option<SocketAddrV4>, reason: &'static str, write: impl FnOnce(LeftOut)) {
    let address = client.map(|client| *client.ip());
    if let Some(left_out) = with_limiter(|limiter| limiter.admit(address, reason, now())).flatten() {
        write(LeftOut(left_out));
    }
}

fn with_limiter<T>(work: impl FnOnce(&mut Limiter<16>) -> T) -> Option<T> {
    LIMITER.lock(|limiter| limiter.try_borrow_mut().ok().map(|mut limiter| work(&mut limiter)))
}

/// Formats the number of lines that the log leaves out.
struct LeftOut(u32);

impl defmt::Format for LeftOut {
    fn format(&self, f: defmt::Formatter<'_>) {
        if self.0 > 0 {
            defmt::write!(f, " ({=u32} more since the last line)", self.0);
        }
    }
}

/// Formats a client.
struct Client(Option<SocketAddrV4>);

impl defmt::Format for Client {
    fn format(&self, f: defmt::Formatter<'_>) {
        match self.0 {
            Some(endpoint) => defmt::write!(f, "{}", endpoint),
            None => defmt::write!(f, "a client"),
        }
    }
}

/// Formats the address of a client.
struct Address(Option<Ipv4Addr>);

impl defmt::Format for Address {
    fn format(&self, f: defmt::Formatter<'_>) {
        match self.0 {
            Some(address) => {
                let [a, b, c, d] = address.octets();
                defmt::write!(f, "{=u8}.{=u8}.{=u8}.{=u8}", a, b, c, d);
            }
            None => defmt::write!(f, "other clients"),
        }
    }
}
