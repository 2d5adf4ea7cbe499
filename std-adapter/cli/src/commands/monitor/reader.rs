//! The thread of `bcap monitor` that talks to the controller.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use bcap_capture::value::data;
use bcap_live::calls::needs_reconnect;
use bcap_live::model;
use bcap_live::reader::{self, Rounds, SLOW};
use bcap_live::write::check;

use super::state::{Request, ScreenUpdate};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::session::Session;

/// Reads from the controller until the user quits.
pub(crate) struct Reader {
    pub(crate) session: Session,
    pub(crate) interrupt: Interrupt,
    /// The variables.
    pub(crate) names: Vec<String>,
    pub(crate) interval: Duration,
    pub(crate) screen: ScreenLink,
}

/// The link to the thread of the screen.
pub(crate) struct ScreenLink {
    pub(crate) updates: Sender<ScreenUpdate>,
    pub(crate) requests: Receiver<Request>,
}

impl Reader {
    /// Reads until the other end of the requests is dropped. A lost connection is tried again.
    pub(crate) fn run(mut self) {
        loop {
            let Err(failure) = self.read_until_lost() else { return };
            let text = failure.to_string();
            self.session.close();
            loop {
                self.screen.tell(model::Update::Lost(text.clone()));
                match self.screen.wait(SLOW) {
                    None => return,
                    Some(Some(Request::Halt)) => self.screen.send(ScreenUpdate::Halted(Err(Failure::Connection {
                        message: "there is no connection".into(),
                        hint: "it is tried again every second".into(),
                    }))),
                    Some(Some(_)) => self.screen.refuse(),
                    Some(None) => {}
                }
                if self.session.controller().is_ok() && self.screen.answer_waiting(&mut self.session).is_ok() {
                    break;
                }
                self.session.close();
            }
        }
    }

    /// Reads until the user quits. Fails when the connection is lost.
    fn read_until_lost(&mut self) -> Result<(), Failure> {
        self.session.restart_budget();
        if !self.session.link().is_serial()
            && let Err(failure) = self.session.prepare_halt(&self.interrupt)
        {
            self.screen.send(ScreenUpdate::Done(Err(format!(
                "h has no connection yet, and opens one when it is pressed: {failure}"
            ))));
        }
        self.screen.tell(model::Update::Connected(self.names.clone()));
        let mut reader = reader::Reader::start(&mut self.session, &self.names)?;
        let mut next = Instant::now();
        loop {
            reader::round(&mut reader, &mut self.session, &mut self.screen)?;
            next = (next + self.interval).max(Instant::now());
            loop {
                match self.screen.wait(next.saturating_duration_since(Instant::now())) {
                    None => return Ok(()),
                    Some(None) => break,
                    Some(Some(request)) => self.screen.request(&mut self.session, request)?,
                }
            }
        }
    }
}

impl Rounds<Session> for ScreenLink {
    fn tell(&mut self, update: model::Update) {
        self.send(ScreenUpdate::Live(update));
    }

    /// Carries out the requests that the user has made in the meantime. Fails when the user has quit.
    fn poll(&mut self, session: &mut Session) -> Result<(), Failure> {
        let quit = || Failure::Interrupted("the user has quit".into());
        while let Some(request) = self.wait(Duration::ZERO).ok_or_else(quit)? {
            self.request(session, request)?;
        }
        Ok(())
    }
}

impl ScreenLink {
    fn send(&self, update: ScreenUpdate) {
        // without a receiver the command is ending, and the requests end too
        let _ = self.updates.send(update);
    }

    /// Refuses a request that needs a connection.
    fn refuse(&self) {
        self.send(ScreenUpdate::Done(Err("there is no connection".into())));
    }

    /// Answers the requests that the user made before there was a connection. Only a halt is carried out.
    fn answer_waiting(&self, session: &mut Session) -> Result<(), Failure> {
        while let Ok(request) = self.requests.try_recv() {
            match request {
                Request::Halt => self.request(session, Request::Halt)?,
                Request::Check(..) | Request::Write(_) => self.refuse(),
            }
        }
        Ok(())
    }

    /// Waits for a request; `None` at the end.
    fn wait(&self, time: Duration) -> Option<Option<Request>> {
        match self.requests.recv_timeout(time) {
            Ok(request) => Some(Some(request)),
            Err(RecvTimeoutError::Timeout) => Some(None),
            Err(RecvTimeoutError::Disconnected) => None,
        }
    }

    /// Carries out a request of the user.
    fn request(&self, session: &mut Session, request: Request) -> Result<(), Failure> {
        let update = match request {
            Request::Check(name, text) => match check(session, &name, &text) {
                Err(failure) if needs_reconnect(&failure) => return Err(failure),
                checked => ScreenUpdate::Checked(checked.map(Box::new).map_err(|failure| format!("{name}: {failure}"))),
            },
            Request::Write(write) => match write.perform_unless_changed(session) {
                Err(failure) if !failure.leaves_the_session_alive() => {
                    let what = format!("{}: it is unknown whether it was written: {failure}", write.path);
                    self.send(ScreenUpdate::Done(Err(what)));
                    return Err(failure);
                }
                Err(failure) => ScreenUpdate::Done(Err(format!("not written: {failure}"))),
                Ok(()) => {
                    let value = data::format(write.value.as_variant());
                    ScreenUpdate::Done(Ok(format!("{} = {value} is written", write.path)))
                }
            },
            Request::Halt => {
                let mut halted = session.halt();
                if halted.as_ref().is_err_and(|failure| failure.leaves_the_session_alive() && needs_reconnect(failure))
                {
                    halted = session.reconnect().and_then(|()| session.halt());
                }
                ScreenUpdate::Halted(halted)
            }
        };
        self.send(update);
        Ok(())
    }
}
