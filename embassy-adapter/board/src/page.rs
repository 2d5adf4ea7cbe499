//! The pages of a board: its state ([`health`](crate::health)), the rules for PLCs, the last messages.

use core::fmt::{self, Write};
use core::pin::pin;
use core::time::Duration;

use bcap_embassy::clock::now;
use bcap_embassy::http::{Content, HttpListener};
use bcap_embassy::net::Options;
use bcap_gateway::{Allow, Gateway};
use embassy_executor::{SpawnError, Spawner};
use embassy_net::{IpAddress, IpEndpoint, Stack};
use heapless::Vec;
use static_cell::ConstStaticCell;

use crate::Settings;
#[cfg(feature = "update")]
use crate::health::Update;
use crate::health::{Health, Html, LONGEST};
use crate::messages::{self, IMAGE};
use crate::parts::{Board, PAGE_BACKLOG, PAGE_TASK, PLC_BUFFER, PLC_BUFFERS, Parts, ROBOT_BUFFER, ROBOT_BUFFERS};
use crate::sizes::PAGES;
use crate::watchdog::{Task, watched};

/// The memory of a page: the head of its response, and the longest page.
const PAGE: usize = 192 + LONGEST;

/// The most counters of a board that the page shows.
const COUNTERS: usize = 8;

/// The memory of a listener of the page: its buffers, and a page.
type PageMemory = ([u8; 256], [u8; 320], [u8; PAGE]);

/// Starts the pages, if the settings ask for them.
pub(crate) fn start(
    spawner: Spawner,
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
    board: &'static Board,
    parts: Parts,
) -> Result<(), SpawnError> {
    static MEMORY: ConstStaticCell<[PageMemory; PAGES]> =
        ConstStaticCell::new([([0; 256], [0; 320], [0; PAGE]); PAGES]);
    if let Some(port) = settings.health {
        let options = Options { backlog: Some(&PAGE_BACKLOG), ..Options::default() };
        for (number, (rx, tx, page)) in (PAGE_TASK..).zip(MEMORY.take()) {
            let listener = HttpListener::new(stack, port, [rx, tx], page, options);
            spawner.spawn(serve(listener, board, parts, Task::new(number))?);
        }
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
    let own = [("log frames dropped", (parts.dropped)()), ("syslog messages lost", messages::lost())];
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
            "/rules" => write_rules(gateway, page).ok().map(|()| Content::Html),
            "/log" => write_log(page).ok().map(|()| Content::Html),
            _ => None,
        }
    };
    board.view(answer).flatten()
}

/// Writes the rules, as far as there is room.
fn write_rules(gateway: &Gateway<'_>, page: &mut dyn Write) -> fmt::Result {
    let rules = &gateway.config().rules;
    page.write_str("<!DOCTYPE html><html lang=en><meta charset=utf-8><title>rules</title><h1>Rules</h1><table>")?;
    for (verb, rules) in [("GET", rules.get), ("PUT", rules.put)] {
        for Allow { kind, first, last, values, clients } in rules {
            write!(page, "<tr><td>{verb}<td>{kind}/{first}-{last}<td>")?;
            for bounds in *values {
                write!(page, "{bounds} ")?;
            }
            write!(page, "<td>{clients}")?;
        }
    }
    page.write_str("</table><p>Clients:")?;
    for network in rules.clients {
        write!(page, " {network}")?;
    }
    page.write_str(if rules.clients.is_empty() { " all<p><a href=/>State</a>" } else { "<p><a href=/>State</a>" })
}

/// Writes the last messages, the newest first.
fn write_log(page: &mut dyn Write) -> fmt::Result {
    page.write_str(
        "<!DOCTYPE html><html lang=en><meta charset=utf-8><meta http-equiv=refresh content=5><title>log</title><h1>Log</h1><table>",
    )?;
    messages::show(&mut |time, id, text| write!(page, "<tr><td>{time}<td>{id}<td>{}", Html(&text)))?;
    page.write_str("</table><p><a href=/>State</a>")
}
