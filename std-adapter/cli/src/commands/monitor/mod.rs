//! `bcap monitor`: a live screen of a controller.
//!
//! The main thread draws and reads keys, the [`reader`] talks to the controller, and a halt has a separate thread and
//! connection, so it waits for neither.

mod reader;
mod state;

use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bcap_capture::trace::Level;
use bcap_capture::{Role, duration};
use bcap_live::model;
use bcap_terminal::screen::{Terminal, require};
use clap::Args;
use reader::{Reader, ScreenLink};
use state::{ALL_KEYS, Action, HALTED, MonitorState, Request, ScreenUpdate, not_halted};

use crate::commands::robot::halt::halt_now;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::link::LinkArgs;
use crate::output::note;
use crate::session::Session;
use crate::session::variables::{expand, paths};
use bcap_capture::value::selection::Selection;

/// Shows variables, the robot, tasks, errors, messages and packets live in the terminal
///
/// A variable that changes is bold with a `*` for two seconds; numbers have a sparkline of their last values. The
/// packets are one call a line; a call whose reply is the same as before is omitted, until `a` shows all. It reads, and
/// never takes the arm. `w` writes a variable, and asks first; Enter shows a line that is cut (`…`). `h` halts the robot at
/// once, over a separate connection; a serial line carries one session, so there it waits for the call under way. `q` and
/// Ctrl-C quit, after a halt that is under way; if that fails, the exit code is 1. SIGTERM and SIGHUP end it with 130.
///
/// Without NAME it shows no variables. A lost connection is shown, and tried again every second. Below 70x18 the terminal shows
/// only the variables; NO_COLOR removes the colours, and a locale without UTF-8 the characters that are not ASCII. TERM=dumb
/// cannot move the cursor, so use `bcap watch` there. --timeout limits each call.
#[derive(Debug, Args)]
#[command(after_help = format!("\
Keys:
{ALL_KEYS}

Examples:
  bcap monitor
  bcap monitor I1-I8 IO128-IO135 P1
  bcap monitor --robot tcp:192.168.0.1 robot/@SPEED task:Pro1/@CYCLE_TIME --interval 500ms
  NO_COLOR=1 bcap monitor I1"))]
pub(crate) struct Monitor {
    /// The variables, as for `bcap get`
    #[arg(value_name = "NAME")]
    pub(crate) names: Vec<String>,

    /// The time from one reading to the next, in ms or with a unit (100ms, 2s)
    #[arg(long, value_name = "MS", default_value = "200", value_parser = duration::parse)]
    pub(crate) interval: Duration,

    /// Shows each function and object once instead of the variables: count, rate, time since, last reply; `o` switches
    #[arg(long)]
    pub(crate) packets: bool,
}

/// Maximum time between two drawings.
const FRAME: Duration = Duration::from_millis(50);

/// Runs `bcap monitor` until the user quits or a signal ends it.
pub(crate) fn monitor(args: &Monitor, session: &mut Session, json: bool) -> Result<(), Failure> {
    if json {
        return Err(Failure::Input("a live screen has no JSON; `bcap watch --json` prints values as JSON".into()));
    }
    let selections = Selection::parse_each(&args.names)?;
    let link = session.link().limited();
    if link.trace.is_some() {
        return Err(Failure::Input("the screen shows the packets; leave --trace out".into()));
    }
    require("`bcap watch` prints the values as lines").map_err(Failure::Input)?;
    let (packets, packet) = channel();
    let mut own = Session::new(&link);
    own.packets.watch(Level::Values, move |role, text| {
        // without a receiver the command is ending
        let _ = packets.send((role, text.to_owned()));
    });
    // of the command's session, not of the reader's: the end of the reader's connection must not close the connection that
    // halts
    let interrupt = session.handle_signals()?;
    // the screen must be closed
    interrupt.set_going_on();
    let (updates, update) = channel();
    let (requests, request) = channel();
    let mut reader = Reader {
        session: own,
        interrupt: interrupt.clone(),
        names: Vec::new(),
        interval: args.interval,
        screen: ScreenLink { updates: updates.clone(), requests: request },
    };
    // a wrong address or selection is an error; only a connection that was open before is tried again
    reader.session.controller()?;
    reader.names = expand(&mut reader.session, &selections)?;
    paths(&reader.names)?;
    let state = MonitorState::new(link.target()?.to_string(), args.packets);
    let mut screen = LiveScreen { state, interrupt, link, updates, update, packet, requests, halts: Vec::new() };
    let reading = thread::Builder::new().name("reader".into()).spawn(move || reader.run())?;
    let ended = screen.run(&reading);
    let LiveScreen { state, update, requests, halts, .. } = screen;
    // ends the reader, and with it its session
    drop(requests);
    let joined = halts.into_iter().map(JoinHandle::join).fold(Ok(()), Result::and);
    let read = reading.join();
    outcomes(&update, state.not_halted())?;
    // the panic has printed its message
    read.and(joined).map_err(|_| Failure::Input("a thread has ended by a panic".into()))?;
    ended
}

/// Prints the outcomes of halts and writes that the screen no longer showed. A failed halt is the result, even if the screen
/// still showed it.
fn outcomes(update: &Receiver<ScreenUpdate>, shown: Option<&str>) -> Result<(), Failure> {
    let mut failed = shown.map(str::to_owned);
    while let Ok(update) = update.try_recv() {
        match update {
            ScreenUpdate::Done(Ok(text) | Err(text)) => note(&text),
            ScreenUpdate::Halted(Ok(())) => {
                note(HALTED);
                failed = None;
            }
            ScreenUpdate::Halted(Err(failure)) => failed = Some(not_halted(&failure)),
            _ => {}
        }
    }
    failed.map_or(Ok(()), |message| Err(Failure::Unfit { message, code: None, hint: None }))
}

struct LiveScreen {
    state: MonitorState,
    interrupt: Interrupt,
    link: LinkArgs,
    updates: Sender<ScreenUpdate>,
    update: Receiver<ScreenUpdate>,
    packet: Receiver<(Role, String)>,
    requests: Sender<Request>,
    /// The threads that halt the robot now.
    halts: Vec<JoinHandle<()>>,
}

impl LiveScreen {
    /// Draws and handles keys until the user quits, a signal arrives, or the reader panics.
    fn run(&mut self, reading: &JoinHandle<()>) -> Result<(), Failure> {
        let mut terminal = Terminal::open()?;
        let start = Instant::now();
        while !self.interrupt.is_interrupted() && !reading.is_finished() {
            self.state.set_time(start.elapsed());
            // the outcomes of the others are drawn below
            self.halts.retain(|halt| !halt.is_finished());
            while let Ok((role, text)) = self.packet.try_recv() {
                self.state.apply(ScreenUpdate::Live(model::Update::Packet(role, text)));
            }
            while let Ok(update) = self.update.try_recv() {
                self.state.apply(update);
            }
            terminal.draw(&self.state.screen())?;
            for key in terminal.keys(FRAME)? {
                match self.state.key(key) {
                    None => {}
                    Some(Action::Quit) => return Ok(()),
                    Some(Action::Halt) => self.halt()?,
                    Some(Action::Request(request)) => self.request(request)?,
                }
            }
        }
        if self.interrupt.is_ended() { Err(Failure::Interrupted("ended by a signal".into())) } else { Ok(()) }
    }

    fn request(&self, request: Request) -> Result<(), Failure> {
        self.requests.send(request).map_err(|_| Failure::Input("the reading thread has ended by a panic".into()))
    }

    /// Halts the robot in a separate thread. A serial line carries one session, so the reader halts there.
    fn halt(&mut self) -> Result<(), Failure> {
        if self.link.is_serial() {
            return self.request(Request::Halt);
        }
        let (interrupt, link, updates) = (self.interrupt.clone(), self.link.clone(), self.updates.clone());
        self.halts.push(thread::Builder::new().name("halt".into()).spawn(move || {
            let idle = interrupt.halt();
            let halted = match idle {
                Ok(true) => Ok(()),
                // there is no idle session, or its handles are no longer valid on the controller
                Ok(false) | Err(_) => halt_now(&link).map(drop),
            };
            // without a receiver the command has ended
            let _ = updates.send(ScreenUpdate::Halted(halted));
            if idle.is_err() {
                interrupt.dismiss();
            }
        })?);
        Ok(())
    }
}
