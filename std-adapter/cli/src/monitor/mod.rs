//! `bcap monitor`: a live screen of a controller.
//!
//! The main thread draws and reads keys, the [`reader`] talks to the controller, and a halt has a thread and a
//! connection of its own, so it waits for neither.

mod reader;
mod state;

use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::args;
use crate::error::Failure;
use crate::frame::Role;
use crate::halt::halt_now;
use crate::interrupt::Interrupt;
use crate::screen::{Terminal, require};
use crate::selection::{Selection, expand};
use crate::session::Session;
use crate::variables::paths;
use reader::{Reader, Request};
use state::{Action, State, Update};

/// The longest time from one drawing to the next.
const FRAME: Duration = Duration::from_millis(50);

/// Runs `bcap monitor` until the user quits or a signal ends it.
pub(crate) fn monitor(args: &args::Monitor, session: &mut Session, json: bool) -> Result<(), Failure> {
    if json {
        return Err(Failure::Input("a live screen has no JSON; `bcap watch --json` prints values as JSON".into()));
    }
    let selections = Selection::parse_each(&args.names)?;
    let link = session.link().limited();
    if link.trace.is_some() {
        return Err(Failure::Input("the screen shows the packets; leave --trace out".into()));
    }
    require("`bcap watch` prints the values as lines")?;
    let (packets, packet) = channel();
    let mut own = Session::new(&link);
    own.packets.watch(packets);
    // not in the session: the end of its connection must not close the one that halts
    let interrupt = Interrupt::install(|_| {})?;
    let (updates, update) = channel();
    let (requests, request) = channel();
    let mut reader = Reader {
        session: own,
        interrupt: interrupt.clone(),
        names: Vec::new(),
        interval: args.interval,
        updates: updates.clone(),
        requests: request,
    };
    // a wrong address or selection is an error; only a connection that was open before is tried again
    reader.connect()?;
    reader.names = expand(&mut reader.session, &selections)?;
    paths(&reader.names)?;
    let (address, halting) = (link.target()?.to_string(), interrupt.clone());
    let mut screen = Monitor { state: State::new(address), interrupt, link, updates, update, packet, requests };
    let reading = thread::Builder::new().name("reader".into()).spawn(move || reader.run())?;
    let ended = screen.run(&reading);
    // ends the reader, and with it its session
    drop(screen);
    let read = reading.join();
    halting.dismiss();
    match read {
        Ok(()) => ended,
        // the panic has printed its message
        Err(_) => Err(Failure::Input("the reading thread has ended by a panic".into())),
    }
}

struct Monitor {
    state: State,
    interrupt: Interrupt,
    link: args::LinkArgs,
    updates: Sender<Update>,
    update: Receiver<Update>,
    packet: Receiver<(Role, String)>,
    requests: Sender<Request>,
}

impl Monitor {
    /// Draws and handles keys until the user quits, a signal arrives, or the reader panics.
    fn run(&mut self, reading: &JoinHandle<()>) -> Result<(), Failure> {
        let mut terminal = Terminal::open()?;
        let start = Instant::now();
        while !self.interrupt.is_interrupted() && !reading.is_finished() {
            self.state.set_time(start.elapsed());
            while let Ok((role, text)) = self.packet.try_recv() {
                self.state.apply(Update::Packet(role, text));
            }
            while let Ok(update) = self.update.try_recv() {
                self.state.apply(update);
            }
            terminal.draw(&self.state.screen())?;
            for key in terminal.keys(FRAME)? {
                let request = match self.state.key(key) {
                    None => continue,
                    Some(Action::Quit) => return Ok(()),
                    Some(Action::Halt) => {
                        self.halt();
                        continue;
                    }
                    Some(Action::Check(name, text)) => Request::Check(name, text),
                    Some(Action::Write(write)) => Request::Write(write),
                };
                self.request(request)?;
            }
        }
        Ok(())
    }

    fn request(&self, request: Request) -> Result<(), Failure> {
        self.requests.send(request).map_err(|_| Failure::Input("the reading thread has ended by a panic".into()))
    }

    /// Halts the robot in a thread of its own. A serial line carries one session, so the reader halts there.
    fn halt(&self) {
        if self.link.is_serial() {
            // a reader that has ended is reported when the screen ends
            let _ = self.request(Request::Halt);
            return;
        }
        let (interrupt, link, updates) = (self.interrupt.clone(), self.link.clone(), self.updates.clone());
        thread::spawn(move || {
            let halted = match interrupt.halt() {
                Ok(true) => Ok(()),
                Ok(false) => halt_now(&link).map(drop),
                // connects again
                Err(_) => interrupt.halt().map(drop),
            };
            let outcome = halted.map(|()| "the robot rests".into());
            // without a receiver the screen has ended
            let _ = updates.send(Update::Done(
                outcome.map_err(|failure| format!("NOT HALTED, use the emergency stop: {failure}")),
            ));
        });
    }
}
