//! The page of the board's state ([`health`](crate::health)), and messages of syslog about refusals and changes of the state.

use core::cell::{Cell, RefCell};
use core::fmt::{self, Write};
use core::future::poll_fn;
use core::net::SocketAddrV4;
use core::pin::pin;
use core::sync::atomic::{AtomicBool, Ordering};
use core::task::Context;
use core::time::Duration;

use bcap_embassy::clock::now;
use bcap_embassy::gateway::Report;
use bcap_embassy::http::{Content, HttpListener};
use bcap_embassy::net::Options;
use bcap_gateway::{Event, Gateway};
use embassy_executor::{SpawnError, Spawner};
use embassy_net::udp::UdpSocket;
use embassy_net::{IpAddress, IpEndpoint, Stack};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use heapless::{String, Vec};
use static_cell::ConstStaticCell;

use crate::Settings;
use crate::find::Text;
#[cfg(feature = "update")]
use crate::health::Update;
use crate::health::{Health, LONGEST};
use crate::limiter::Limiter;
use crate::parts::{Board, PAGE_BACKLOG, PAGE_TASK, PLC_BUFFER, PLC_BUFFERS, Parts, ROBOT_BUFFER, ROBOT_BUFFERS};
use crate::sizes::{MESSAGES, PAGES};
use crate::syslog::{Message, Severity};
use crate::watchdog::{Task, watched};

/// The name of the image in messages and on the page.
const IMAGE: &str = "gateway";

/// The memory of a page: the head of its response, and the longest page.
const PAGE: usize = 192 + LONGEST;

/// The most counters of a board that the page shows.
const COUNTERS: usize = 8;

/// The longest text of a message, and the longest message. Longer ones are cut.
const TEXT: usize = 192;
pub(crate) const MESSAGE: usize = TEXT + 96;

/// The memory of a listener of the page: its buffers, and a page.
type PageMemory = ([u8; 256], [u8; 512], [u8; PAGE]);

/// A message that waits.
struct Waiting {
    severity: Severity,
    id: &'static str,
    text: String<TEXT>,
}

static QUEUE: Channel<CriticalSectionRawMutex, Waiting, MESSAGES> = Channel::new();
static IS_ON: AtomicBool = AtomicBool::new(false);
// not an atomic integer, because some processors have no atomic addition
static LOST: Mutex<CriticalSectionRawMutex, Cell<u32>> = Mutex::new(Cell::new(0));
static LIMITER: Mutex<CriticalSectionRawMutex, RefCell<Limiter<16>>> = Mutex::new(RefCell::new(Limiter::new()));

/// Starts the page and the messages, if the settings ask for them.
pub(crate) fn start(
    spawner: Spawner,
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
    board: &'static Board,
    parts: Parts,
) -> Result<(), SpawnError> {
    static MEMORY: ConstStaticCell<[PageMemory; PAGES]> =
        ConstStaticCell::new([([0; 256], [0; 512], [0; PAGE]); PAGES]);
    if let Some(port) = settings.health {
        let options = Options { backlog: Some(&PAGE_BACKLOG), ..Options::default() };
        for (number, (rx, tx, page)) in (PAGE_TASK..).zip(MEMORY.take()) {
            let listener = HttpListener::new(stack, port, [rx, tx], page, options);
            spawner.spawn(serve(listener, board, parts, Task::new(number))?);
        }
    }
    if settings.syslog.is_some() {
        IS_ON.store(true, Ordering::Relaxed);
        let severity = if parts.last_reset.is_fault() { Severity::Error } else { Severity::Notice };
        queue(severity, "start", format_args!("last reset: {}", parts.last_reset));
    }
    Ok(())
}

/// Shows the board's state to the clients that the rules admit.
#[embassy_executor::task(pool_size = PAGES)]
async fn serve(mut listener: HttpListener<'static>, board: &'static Board, parts: Parts, task: Task) -> ! {
    let admits = |client: Option<IpEndpoint>| {
        let address = client.map(|IpEndpoint { addr: IpAddress::Ipv4(address), .. }| address);
        board.view(|gateway| gateway.config().rules.admits(address)).unwrap_or_default()
    };
    let answer = |path: &str, page: &mut dyn Write| answer(board, &parts, path, page);
    watched(task, pin!(listener.run(admits, answer))).await
}

/// Queues the message about a report of the gateway, if there is one: at most one a second for each client and reason.
pub(crate) fn report(report: &Report<'_>) {
    match *report {
        Report::Denied { client, reason } => {
            limited(client, "denied", format_args!("not served: {reason:?}"));
        }
        Report::Answered { client, line, event: Event::Refused { refusal, .. } } => {
            limited(client, "refused", format_args!("{refusal}: {}", line.escape_ascii()));
        }
        Report::Robot { event: Event::RobotDown { error, .. }, .. } => {
            queue(Severity::Warning, "robot-down", format_args!("{error}"));
        }
        Report::Robot { event: Event::RobotUp, .. } => queue(Severity::Notice, "robot-up", format_args!("connected")),
        _ => {}
    }
}

fn limited(client: Option<SocketAddrV4>, id: &'static str, text: fmt::Arguments<'_>) {
    let address = client.map(|client| *client.ip());
    let admitted = LIMITER.lock(|limiter| limiter.try_borrow_mut().ok()?.admit(address, id, now()));
    let Some(left_out) = admitted else { return };
    // the number comes first, because the end of a long text is cut
    match (client, left_out) {
        (Some(client), 0) => queue(Severity::Warning, id, format_args!("{client}: {text}")),
        (Some(client), count) => queue(Severity::Warning, id, format_args!("{client}: {count} more before: {text}")),
        (None, 0) => queue(Severity::Warning, id, text),
        (None, count) => queue(Severity::Warning, id, format_args!("{count} more before: {text}")),
    }
}

/// Queues a message for each client and reason whose messages were left out, with their number. Call it periodically.
pub(crate) fn left_out() {
    LIMITER.lock(|limiter| {
        let Ok(mut limiter) = limiter.try_borrow_mut() else { return };
        limiter.drain(|client, id, count| match client {
            Some(client) => queue(Severity::Warning, id, format_args!("{client}: {count} more")),
            None => queue(Severity::Warning, id, format_args!("other clients: {count} more")),
        });
    });
}

fn queue(severity: Severity, id: &'static str, text: fmt::Arguments<'_>) {
    if IS_ON.load(Ordering::Relaxed) {
        let mut waiting = Waiting { severity, id, text: String::new() };
        // a longer text is cut
        let _ = write!(Cut(&mut waiting.text), "{text}");
        if QUEUE.try_send(waiting).is_err() {
            lose();
        }
    }
}

/// Counts a message that is lost.
fn lose() {
    LOST.lock(|lost| lost.set(lost.get().saturating_add(1)));
}

/// Waits for a message.
pub(crate) async fn wait() {
    QUEUE.ready_to_receive().await;
}

/// Sends the oldest message to the collector, if there is one.
pub(crate) async fn send(socket: &UdpSocket<'_>, collector: SocketAddrV4, host: Option<&str>) {
    let Ok(Waiting { severity, id, text }) = QUEUE.try_receive() else { return };
    let message = Message { severity, host, app: IMAGE, id, text: &text };
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

/// Writes what fits.
struct Cut<'a>(&'a mut String<TEXT>);

impl Write for Cut<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        text.chars().try_for_each(|c| self.0.push(c).map_err(|_| fmt::Error))
    }
}

/// Writes the page of a path.
fn answer(board: &Board, parts: &Parts, path: &str, page: &mut dyn Write) -> Option<Content> {
    let sessions = board.sessions();
    let ((used, size), (log, log_size)) = ((parts.stack)(), (parts.log)());
    let ((plc_in, plc_out), (robot_in, robot_out)) = (PLC_BUFFERS.most(), ROBOT_BUFFERS.most());
    let memory = [
        ("stack", used, size),
        ("log", log, log_size),
        ("PLC receive buffer", plc_in, PLC_BUFFER),
        ("PLC send buffer", plc_out, PLC_BUFFER),
        ("robot receive buffer", robot_in, ROBOT_BUFFER),
        ("robot send buffer", robot_out, ROBOT_BUFFER),
    ];
    let mut counters = Vec::<(&str, u32), COUNTERS>::new();
    // the first ones, if a board has more
    (parts.counters)(&mut |name, count| {
        let _ = counters.push((name, count));
    });
    let own = [("log frames dropped", (parts.dropped)()), ("syslog messages lost", LOST.lock(Cell::get))];
    counters.extend(own.into_iter().take(counters.capacity().saturating_sub(counters.len())));
    #[cfg(feature = "update")]
    let status = crate::update::shown::status();
    #[cfg(feature = "update")]
    let update = status.as_ref().map(|status| {
        let (identity, (last, reason)) = (status.identity(), status.last_update());
        Update { board: identity.board(), version: identity.version(), phase: &status.phase, last, reason }
    });
    #[cfg(not(feature = "update"))]
    let update = None;
    let answer = |gateway: &Gateway<'_>| {
        let health = Health {
            image: IMAGE,
            version: env!("CARGO_PKG_VERSION"),
            update,
            uptime: Duration::from_micros(now().as_micros()),
            last_reset: &parts.last_reset,
            robot_is_up: gateway.is_up(),
            sessions: (sessions, gateway.capacity()),
            counters: gateway.counters(),
            memory: &memory,
            board: &counters,
        };
        match path {
            "/" => health.write_page(page).ok().map(|()| Content::Html),
            "/health.json" => health.write_json(page).ok().map(|()| Content::Json),
            _ => None,
        }
    };
    board.view(answer).flatten()
}
