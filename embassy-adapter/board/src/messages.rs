//! Messages about refusals and changes of the state: the last ones are kept for the page, and each is sent to the collector of
//! syslog.

use core::cell::{Cell, RefCell};
use core::fmt::{self, Write};
use core::future::poll_fn;
use core::net::SocketAddrV4;
use core::task::Context;

use bcap_embassy::clock::now;
use bcap_embassy::gateway::Report;
use bcap_gateway::Event as GatewayEvent;
use embassy_net::udp::UdpSocket;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use heapless::String;

use crate::events::{Event, Events, TEXT};
use crate::find::Text;
use crate::limiter::Limiter;
use crate::parts::Parts;
use crate::sizes::MESSAGES;
use crate::sntp::Utc;
use crate::syslog::{Message, Severity};

/// The name of the image in messages and on the page.
pub(crate) const IMAGE: &str = "gateway";

/// Maximum length of a syslog message.
pub(crate) const MESSAGE: usize = TEXT + 124;

static EVENTS: Mutex<CriticalSectionRawMutex, RefCell<Events<MESSAGES>>> = Mutex::new(RefCell::new(Events::new()));
static ADDED: Signal<CriticalSectionRawMutex, ()> = Signal::new();
static LIMITER: Mutex<CriticalSectionRawMutex, RefCell<Limiter<8>>> = Mutex::new(RefCell::new(Limiter::new()));
/// The time at which the board started, in microseconds since 1970; 0 as long as it is unknown.
static STARTED: Mutex<CriticalSectionRawMutex, Cell<u64>> = Mutex::new(Cell::new(0));

/// Adds the message about the start.
pub(crate) fn start(parts: &Parts) {
    let severity = if parts.last_reset.is_fault() { Severity::Error } else { Severity::Notice };
    add(severity, "start", format_args!("last reset: {}", parts.last_reset));
}

/// Sets the clock: it is this time now.
pub(crate) fn set_clock(utc: Utc) {
    STARTED.lock(|started| started.set(utc.0.saturating_sub(now().as_micros())));
    defmt::info!("time {}", defmt::Display2Format(&utc));
}

/// Returns the time at a number of microseconds after the start; `None` as long as the clock is not set.
fn utc(at: u64) -> Option<Utc> {
    let started = STARTED.lock(Cell::get);
    (started > 0).then(|| Utc(started.saturating_add(at)))
}

/// A time of an event: of the calendar, or in seconds after the start.
pub(crate) struct Time(u64);

impl fmt::Display for Time {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match utc(self.0) {
            Some(utc) => utc.fmt(f),
            None => write!(f, "{} s", self.0 / 1_000_000),
        }
    }
}

/// Adds the message about a report of the gateway, if there is one: at most one a second for each client and reason.
pub(crate) fn report(report: &Report<'_>) {
    match *report {
        Report::Denied { client, reason } => {
            limited(client, "denied", format_args!("not served: {reason:?}"));
        }
        Report::Answered { client, line, event: GatewayEvent::Refused { refusal, .. } } => {
            limited(client, "refused", format_args!("{refusal}: {}", line.escape_ascii()));
        }
        Report::Robot { event: GatewayEvent::RobotDown { error, .. }, .. } => {
            add(Severity::Warning, "robot-down", format_args!("{error}"));
        }
        Report::Robot { event: GatewayEvent::RobotUp, .. } => {
            add(Severity::Notice, "robot-up", format_args!("connected"))
        }
        _ => {}
    }
}

/// Adds the message that a client has sent a wrong password.
#[cfg(feature = "port")]
pub(crate) fn wrong_password(client: Option<SocketAddrV4>) {
    limited(client, "password", format_args!("wrong password for the settings"));
}

/// Adds the message that a page has changed the settings.
#[cfg(feature = "port")]
pub(crate) fn saved() {
    add(Severity::Notice, "settings", format_args!("saved over the page; the board restarts"));
}

fn limited(client: Option<SocketAddrV4>, id: &'static str, text: fmt::Arguments<'_>) {
    let address = client.map(|client| *client.ip());
    let admitted = LIMITER.lock(|limiter| limiter.try_borrow_mut().ok()?.admit(address, id, now()));
    let Some(left_out) = admitted else { return };
    // the number is first, because the end of a long text is cut
    match (client, left_out) {
        (Some(client), 0) => add(Severity::Warning, id, format_args!("{client}: {text}")),
        (Some(client), count) => add(Severity::Warning, id, format_args!("{client}: {count} more before: {text}")),
        (None, 0) => add(Severity::Warning, id, text),
        (None, count) => add(Severity::Warning, id, format_args!("{count} more before: {text}")),
    }
}

/// Adds a message for each client and reason whose messages were left out, with their number. Call it periodically.
pub(crate) fn left_out() {
    LIMITER.lock(|limiter| {
        let Ok(mut limiter) = limiter.try_borrow_mut() else { return };
        limiter.drain(|client, id, count| match client {
            Some(client) => add(Severity::Warning, id, format_args!("{client}: {count} more")),
            None => add(Severity::Warning, id, format_args!("other clients: {count} more")),
        });
    });
}

fn add(severity: Severity, id: &'static str, text: fmt::Arguments<'_>) {
    let mut event = Event { at: now().as_micros(), severity: severity.code(), id: Some(id), text: String::new() };
    // a longer text is cut
    let _ = write!(Cut(&mut event.text), "{text}");
    with(|events| events.push(event));
    ADDED.signal(());
}

fn with<T: Default>(work: impl FnOnce(&mut Events<MESSAGES>) -> T) -> T {
    EVENTS.lock(|events| events.try_borrow_mut().map(|mut events| work(&mut events)).unwrap_or_default())
}

/// Waits for a message that was not sent.
pub(crate) async fn wait() {
    while !with(|events| events.has_unsent()) {
        ADDED.wait().await;
    }
}

/// Returns how many messages were not sent.
pub(crate) fn lost() -> u32 {
    with(|events| events.lost())
}

/// Passes the time, the kind and the text of each message, in reverse order.
pub(crate) fn show(show: &mut dyn FnMut(Time, &str, &str) -> fmt::Result) -> fmt::Result {
    EVENTS.lock(|events| {
        let Ok(events) = events.try_borrow() else { return Ok(()) };
        events.in_reverse_order().try_for_each(|event| show(Time(event.at), event.id.unwrap_or_default(), &event.text))
    })
}

/// Sends the oldest message to the collector, if there is one.
pub(crate) async fn send(socket: &UdpSocket<'_>, collector: SocketAddrV4, host: Option<&str>) {
    let Some(Event { at, severity, id, text }) = with(Events::take) else { return };
    let severity = Severity::of_code(severity);
    let id = id.unwrap_or_default();
    let message = Message { severity, time: utc(at), host, app: IMAGE, id, text: &text };
    let send = |context: &mut Context<'_>| {
        let mut buffer = [0; MESSAGE];
        let mut out = Text::new(&mut buffer);
        // there is room for the longest one
        let _ = write!(out, "{message}");
        let len = out.len;
        // not `send_to_with`: smoltcp 0.13.1 then finds no room in an empty buffer that was used before
        socket.poll_send_to(buffer.get(..len).unwrap_or_default(), collector, context)
    };
    if poll_fn(send).await.is_err() {
        lose();
    }
}

/// Counts a message that was not sent.
pub(crate) fn lose() {
    with(|events| events.lose());
}

/// Writes what fits.
struct Cut<'a>(&'a mut String<TEXT>);

impl Write for Cut<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        text.chars().try_for_each(|c| self.0.push(c).map_err(|_| fmt::Error))
    }
}
