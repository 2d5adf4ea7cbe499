//! The pages of a board: its state ([`health`](crate::health)), the rules for PLCs, the last messages, and the settings.
//!
//! The settings have a page only with a password, which only the console sets. A POST saves them as the console does, and
//! restarts the board. It is refused without the password, from a page of another site, and while PLCs are connected.

use core::fmt::{self, Write};
use core::pin::pin;
use core::time::Duration;

use bcap_embassy::clock::now;
use bcap_embassy::http::{Body, Content, Decision, HttpListener, Method, Request, Site, Status};
use bcap_embassy::net::Options;
use bcap_gateway::{Allow, Gateway};
use embassy_executor::{SpawnError, Spawner};
use embassy_net::{IpAddress, IpEndpoint, Stack};
use heapless::Vec;
use static_cell::{ConstStaticCell, StaticCell};

use crate::Settings;
#[cfg(feature = "update")]
use crate::health::Update;
use crate::health::{Health, Html, LONGEST};
use crate::messages::{self, IMAGE};
use crate::parts::{Board, PAGE_BACKLOG, PAGE_TASK, PLC_BUFFER, PLC_BUFFERS, Parts, ROBOT_BUFFER, ROBOT_BUFFERS};
#[cfg(feature = "port")]
use crate::settings_page::{self, SettingsAnswer};
use crate::sizes::PAGES;
use crate::watchdog::{Task, watched};

/// The memory of a page: the head of its response, and the longest page.
const PAGE: usize = 192 + LONGEST;

/// The maximum number of counters of a board that the page shows.
const COUNTERS: usize = 8;

/// The memory of a listener of the page: its buffers, and a page.
type PageMemory = ([u8; 256], [u8; 320], [u8; PAGE]);

/// Starts the pages, if the settings enable them.
pub(crate) fn start(
    spawner: Spawner,
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
    board: &'static Board,
    parts: Parts,
) -> Result<(), SpawnError> {
    static MEMORY: ConstStaticCell<[PageMemory; PAGES]> =
        ConstStaticCell::new([([0; 256], [0; 320], [0; PAGE]); PAGES]);
    // not arguments of the tasks, because a task has a second copy of each argument
    static PLACES: [StaticCell<HttpListener<'static>>; PAGES] = [const { StaticCell::new() }; PAGES];
    static SITE: StaticCell<Pages> = StaticCell::new();
    if let Some(port) = settings.health {
        let pages = SITE.init(Pages { stack, settings, board, parts });
        let options = Options { backlog: Some(&PAGE_BACKLOG), ..Options::default() };
        for ((number, place), (rx, tx, page)) in (PAGE_TASK..).zip(&PLACES).zip(MEMORY.take()) {
            let listener = place.init(HttpListener::new(stack, port, [rx, tx], page, options));
            spawner.spawn(serve(listener, pages, Task::new(number))?);
        }
    }
    Ok(())
}

/// Serves the clients that the rules admit.
#[embassy_executor::task(pool_size = PAGES)]
async fn serve(listener: &'static mut HttpListener<'static>, pages: &'static Pages, task: Task) -> ! {
    watched(task, pin!(listener.run_site(pages))).await
}

/// The pages of a board.
struct Pages {
    #[cfg_attr(not(feature = "port"), expect(dead_code, reason = "no page changes the settings"))]
    stack: Stack<'static>,
    #[cfg_attr(not(feature = "port"), expect(dead_code, reason = "no page changes the settings"))]
    settings: &'static Settings<'static>,
    board: &'static Board,
    parts: Parts,
}

/// A page, or a refusal.
enum Page {
    State,
    Json,
    Rules,
    Log,
    #[cfg(feature = "port")]
    Settings(SettingsAnswer),
    /// A method that has no use here.
    Method,
    None,
}

impl Site<'static> for Pages {
    type Page = Page;

    fn admits(&self, client: Option<IpEndpoint>) -> bool {
        let address = client.map(|IpEndpoint { addr: IpAddress::Ipv4(address), .. }| address);
        self.board.view(|gateway| gateway.config().rules.admits(address)).unwrap_or_default()
    }

    fn decide(&self, request: &Request<'_>) -> Decision<Page> {
        let page = match request.path {
            #[cfg(feature = "port")]
            "/settings" | "/settings.txt" => match settings_page::decide(self.stack, self.settings, request) {
                Decision::Answer(answer) => Page::Settings(answer),
                Decision::Receive => return Decision::Receive,
            },
            _ if request.method == Method::Post => Page::Method,
            "/" => Page::State,
            "/health.json" => Page::Json,
            "/rules" => Page::Rules,
            "/log" => Page::Log,
            _ => Page::None,
        };
        Decision::Answer(page)
    }

    #[cfg(feature = "port")]
    async fn take(&self, memory: &'static mut [u8], len: usize) -> (&'static mut [u8], Page) {
        let (memory, answer) = settings_page::save(memory, len, self.settings, self.board.sessions()).await;
        (memory, Page::Settings(answer))
    }

    #[cfg(not(feature = "port"))]
    async fn take(&self, memory: &'static mut [u8], _: usize) -> (&'static mut [u8], Page) {
        (memory, Page::Method)
    }

    fn write(&self, page: Page, out: &mut Body<'_>) -> Option<(Status, Content)> {
        let (written, content) = match page {
            Page::State | Page::Json => return write_state(self.board, &self.parts, &page, out),
            Page::Rules => (self.board.view(|gateway| write_rules(gateway, out))?, Content::Html),
            Page::Log => (write_log(out), Content::Html),
            #[cfg(feature = "port")]
            Page::Settings(answer) => return settings_page::write(answer, out),
            Page::Method => return Some((Status::MethodNotAllowed, Content::Text)),
            Page::None => return None,
        };
        written.ok().map(|()| (Status::Ok, content))
    }
}

/// Writes the state.
fn write_state(board: &Board, parts: &Parts, page: &Page, out: &mut dyn Write) -> Option<(Status, Content)> {
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
    let own = [
        #[cfg(feature = "port")]
        ("wrong passwords", settings_page::wrong_passwords()),
        ("log frames dropped", (parts.dropped)()),
        ("syslog messages lost", messages::lost()),
    ];
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
            version: parts.version,
            update,
            uptime: Duration::from_micros(now().as_micros()),
            last_reset: &parts.last_reset,
            robot_is_up: gateway.is_up(),
            sessions: (sessions, gateway.capacity()),
            counters: gateway.counters(),
            memory: &memory,
            board: &counters,
        };
        match page {
            Page::Json => health.write_json(out).ok().map(|()| (Status::Ok, Content::Json)),
            _ => health.write_page(out).ok().map(|()| (Status::Ok, Content::Html)),
        }
    };
    board.view(answer).flatten()
}

/// The ends of the pages with rows.
const TABLE_END: &str = "</table>";
const CLIENTS: &str = "<p>Clients:";
const ALL: &str = " all";
const CUT: &str = "<p>The page has no room for the others.";
const STATE: &str = "<p><a href=/>State</a>";

/// Writes the rules, as far as there is room.
fn write_rules(gateway: &Gateway<'_>, page: &mut Body<'_>) -> fmt::Result {
    const REST: usize = TABLE_END.len() + CLIENTS.len() + ALL.len() + CUT.len() + STATE.len();
    let rules = &gateway.config().rules;
    page.write_str("<!DOCTYPE html><html lang=en><meta charset=utf-8><title>rules</title><h1>Rules</h1><table>")?;
    let shown = [("GET", rules.get), ("PUT", rules.put)].into_iter().try_for_each(|(verb, rules)| {
        rules.iter().try_for_each(|rule| page.row(REST, |page| write_rule(verb, rule, page)))
    });
    page.write_str(TABLE_END)?;
    page.write_str(CLIENTS)?;
    if rules.clients.is_empty() {
        page.write_str(ALL)?;
    }
    let mut clients = rules.clients.iter();
    let shown = shown.and(clients.try_for_each(|network| page.row(REST, |page| write!(page, " {network}"))));
    if shown.is_err() {
        page.write_str(CUT)?;
    }
    page.write_str(STATE)
}

fn write_rule(verb: &str, rule: &Allow<'_>, page: &mut Body<'_>) -> fmt::Result {
    let Allow { kind, first, last, values, clients } = rule;
    write!(page, "<tr><td>{verb}<td>{kind}/{first}-{last}<td>")?;
    for bounds in *values {
        write!(page, "{bounds} ")?;
    }
    write!(page, "<td>{clients}")
}

/// Writes the last messages in reverse order, as far as there is room.
fn write_log(page: &mut Body<'_>) -> fmt::Result {
    const REST: usize = TABLE_END.len() + STATE.len();
    page.write_str(
        "<!DOCTYPE html><html lang=en><meta charset=utf-8><meta http-equiv=refresh content=5><title>log</title><h1>Log</h1><table>",
    )?;
    // an error means that there is no room for the older ones
    let _ = messages::show(&mut |time, id, text| {
        page.row(REST, |page| write!(page, "<tr><td>{time}<td>{id}<td>{}", Html(&text)))
    });
    page.write_str(TABLE_END)?;
    page.write_str(STATE)
}
