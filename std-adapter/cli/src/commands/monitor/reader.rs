//! The thread of `bcap monitor` that talks to the controller.

use std::mem;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_std::ObjectPath;

use super::state::{Robot, Update, Write};
use crate::commands::robot::errors;
use crate::commands::robot::messages::next_message;
use crate::commands::robot::task::status_text;
use crate::failure::{Failure, hint_of};
use crate::interrupt::Interrupt;
use crate::session::Session;
use crate::session::slave_mode::StreamCheck;
use crate::session::variables::{list, paths, read, short_type, state_words};
use crate::values::{Value, integer};
use bcap_capture::value::data;

/// How often tasks, messages, the tool, the work and the speed are read, and how often a lost connection is tried again.
const SLOW: Duration = Duration::from_secs(1);

/// The tasks whose states are read.
const TASKS: usize = 64;

/// A request of the user.
#[derive(Debug)]
pub(crate) enum Request {
    Check(String, String),
    Write(Box<Write>),
    /// Halts the robot over this session, where there is no other.
    Halt,
}

/// Reads from the controller until the user quits.
pub(crate) struct Reader {
    pub(crate) session: Session,
    pub(crate) interrupt: Interrupt,
    /// The variables.
    pub(crate) names: Vec<String>,
    pub(crate) interval: Duration,
    pub(crate) updates: Sender<Update>,
    pub(crate) requests: Receiver<Request>,
}

/// The reads of a connection.
struct Plan {
    variables: Vec<ObjectPath>,
    /// `None` until their names are read.
    tasks: Option<Vec<String>>,
    kind: Option<String>,
    /// Whether the controller has messages.
    messages: bool,
    /// Whether the messages were skipped the last time.
    skipped_messages: bool,
    /// Whether the list of errors is read again: there was an error, or reading it was skipped.
    had_error: bool,
    stream: StreamCheck,
    slow: Instant,
    selection: Selection,
}

/// The selected tool and work coordinates, and the speed. They are read every second.
#[derive(Default)]
struct Selection {
    tool: Option<String>,
    work: Option<String>,
    speed: Option<String>,
}

impl Reader {
    /// Opens the first connection.
    pub(crate) fn connect(&mut self) -> Result<(), Failure> {
        self.session.restart_budget();
        self.session.connect()?;
        self.session.controller().map(drop)
    }

    /// Reads until the other end of the requests is dropped. A lost connection is tried again.
    pub(crate) fn run(mut self) {
        loop {
            let Err(failure) = self.read_until_lost() else { return };
            let text = failure.to_string();
            self.session.close();
            loop {
                self.tell(Update::Lost(text.clone()));
                match self.wait(SLOW) {
                    None => return,
                    Some(Some(Request::Halt)) => self.tell(Update::Halted(Err(Failure::Connection {
                        message: "there is no connection".into(),
                        hint: "it is tried again every second".into(),
                    }))),
                    Some(Some(_)) => self.tell(Update::Done(Err("there is no connection".into()))),
                    Some(None) => {}
                }
                if self.connect().is_ok() {
                    break;
                }
                self.session.close();
            }
        }
    }

    fn tell(&self, update: Update) {
        // without a receiver the command is ending, and the requests end too
        let _ = self.updates.send(update);
    }

    /// Waits for a request; `None` at the end.
    fn wait(&self, time: Duration) -> Option<Option<Request>> {
        match self.requests.recv_timeout(time) {
            Ok(request) => Some(Some(request)),
            Err(RecvTimeoutError::Timeout) => Some(None),
            Err(RecvTimeoutError::Disconnected) => None,
        }
    }

    /// Carries out the requests that the user made meanwhile. Called before each call of a round, so that a halt over a
    /// slow line does not wait for the end of the round.
    fn poll(&mut self) -> Result<(), Failure> {
        while let Ok(request) = self.requests.try_recv() {
            self.request(request)?;
        }
        Ok(())
    }

    /// Reads until the user quits. Fails when the connection is lost.
    fn read_until_lost(&mut self) -> Result<(), Failure> {
        let mut plan = self.plan()?;
        let mut next = Instant::now();
        loop {
            self.round(&mut plan)?;
            next = (next + self.interval).max(Instant::now());
            loop {
                match self.wait(next.saturating_duration_since(Instant::now())) {
                    None => return Ok(()),
                    Some(None) => break,
                    Some(Some(request)) => self.request(request)?,
                }
            }
        }
    }

    /// Prepares the halt, and determines what to read.
    fn plan(&mut self) -> Result<Plan, Failure> {
        self.session.restart_budget();
        if !self.session.link().is_serial()
            && let Err(failure) = self.session.prepare_halt(&self.interrupt)
        {
            self.tell(Update::Done(Err(format!(
                "h has no connection yet, and opens one when it is pressed: {failure}"
            ))));
        }
        let variables = paths(&self.names)?;
        self.tell(Update::Connected(self.names.clone()));
        let kind = self.text("@TYPE")?.map(|kind| short_type(&kind));
        Ok(Plan {
            variables,
            tasks: None,
            kind,
            messages: true,
            skipped_messages: false,
            stream: StreamCheck::default(),
            had_error: true,
            slow: Instant::now(),
            selection: Selection::default(),
        })
    }

    fn round(&mut self, plan: &mut Plan) -> Result<(), Failure> {
        for (n, path) in plan.variables.iter().enumerate() {
            self.poll()?;
            let value = match self.value(path) {
                Ok(value) => Ok(value),
                Err(failure) if is_lost(&failure) => return Err(failure),
                Err(Failure::Refused { code, .. }) => Err(code.to_string()),
                Err(failure) => Err(failure.to_string()),
            };
            self.tell(Update::Value(n, value));
        }
        let is_slow = Instant::now() >= plan.slow;
        if is_slow {
            plan.slow = Instant::now() + SLOW;
            plan.selection = Selection {
                tool: self.text("robot/@CURRENT_TOOL")?,
                work: self.text("robot/@CURRENT_WORK")?,
                speed: self.text("robot/@EXTSPEED")?,
            };
        }
        let Selection { tool, work, speed } = &plan.selection;
        let (tool, work, speed) = (tool.clone(), work.clone(), speed.clone());
        let joints = self.numbers("robot/@CURRENT_ANGLE")?;
        let position = self.numbers("robot/@CURRENT_POSITION")?;
        self.tell(Update::Robot(Robot { joints, position, tool, work, speed }));
        self.state(plan)?;
        if is_slow {
            self.tasks(plan)?;
            self.messages(plan)?;
        }
        Ok(())
    }

    /// Reads the words of the state: `RC8 auto ok motor moving`; and the errors, if there are any.
    fn state(&mut self, plan: &mut Plan) -> Result<(), Failure> {
        let (mode, code) = (self.text("@MODE")?, self.text("@ERROR_CODE")?);
        let has_error = code.as_ref().is_some_and(|code| code != "0");
        let mut words = state_words(plan.kind.clone(), mode, code.as_deref());
        for (name, word) in [("robot/@SERVO_ON", "motor"), ("robot/@BUSY_STATUS", "moving")] {
            if self.text(name)?.as_deref() == Some("true") {
                words.push(word.into());
            }
        }
        self.tell(Update::State(words, has_error));
        if has_error || plan.had_error {
            self.poll()?;
            let (errors, skipped) = match errors::present(&mut self.session, &mut plan.stream) {
                Err(Failure::Unfit { message, .. }) => (vec![(message.clone(), message)], true),
                present => {
                    let present = alive(present)?.unwrap_or_default();
                    (present.iter().map(|(code, text)| (short(*code, text), explained(*code, text))).collect(), false)
                }
            };
            self.tell(Update::Errors(errors));
            plan.had_error = has_error || skipped;
        }
        Ok(())
    }

    /// Reads the names of the tasks once, and their states.
    fn tasks(&mut self, plan: &mut Plan) -> Result<(), Failure> {
        let mut tasks = Vec::new();
        if plan.tasks.is_none() {
            let function = FunctionId::CONTROLLER_GET_TASK_NAMES;
            if let Some(why) = plan.stream.skip(&mut self.session, function, None)? {
                self.tell(Update::Tasks(vec![(why, String::new())]));
                return Ok(());
            }
            let names = alive(list(&mut self.session, &ObjectPath::controller(), function))?;
            let mut names = names.unwrap_or_default();
            names.truncate(TASKS);
            plan.tasks = Some(names);
        }
        for name in plan.tasks.iter().flatten() {
            self.poll()?;
            self.session.restart_budget();
            if plan.stream.skip(&mut self.session, FunctionId::TASK_EXECUTE, Some("GetStatus"))?.is_some() {
                tasks.push((name.clone(), "skipped: a stream of Slave Mode runs".into()));
                continue;
            }
            let status = alive(self.session.with(|controller| controller.task(name)?.status()))?;
            tasks.push((name.clone(), status.map_or_else(|| "unknown".into(), status_text)));
        }
        self.tell(Update::Tasks(tasks));
        Ok(())
    }

    fn messages(&mut self, plan: &mut Plan) -> Result<(), Failure> {
        while plan.messages {
            self.poll()?;
            self.session.restart_budget();
            let message = next_message(&mut self.session, &mut plan.stream);
            let was_skipped = mem::replace(&mut plan.skipped_messages, matches!(message, Err(Failure::Unfit { .. })));
            match message {
                Ok(Some(message)) => self.tell(Update::Message(message.short())),
                Ok(None) => return Ok(()),
                Err(Failure::Unfit { message, .. }) => {
                    if !was_skipped {
                        self.tell(Update::Message(message));
                    }
                    return Ok(());
                }
                Err(failure) if is_lost(&failure) => return Err(failure),
                Err(_) => plan.messages = false,
            }
        }
        Ok(())
    }

    /// Reads a variable; its object stays open.
    fn value(&mut self, path: &ObjectPath) -> Result<Value, Failure> {
        self.session.restart_budget();
        let variable = self.session.object(path)?;
        read(&mut self.session, path, variable)
    }

    /// Reads a variable as text; `None` if the controller does not have it.
    fn text(&mut self, name: &str) -> Result<Option<String>, Failure> {
        self.poll()?;
        let value = alive(self.value(&ObjectPath::variable(name)?))?;
        Ok(value.map(|value| data::format(value.as_variant())))
    }

    /// Reads an array of numbers; empty if the controller does not have it.
    fn numbers(&mut self, name: &str) -> Result<Vec<f64>, Failure> {
        self.poll()?;
        let value = alive(self.value(&ObjectPath::variable(name)?))?.unwrap_or_default();
        let array = value.as_variant().as_array();
        Ok(array.map(|array| array.iter().filter_map(|number| number.as_f64()).collect()).unwrap_or_default())
    }

    /// Carries out a request of the user.
    fn request(&mut self, request: Request) -> Result<(), Failure> {
        let update = match request {
            Request::Check(name, text) => match self.check(&name, &text) {
                Err(failure) if is_lost(&failure) => return Err(failure),
                checked => Update::Checked(checked.map(Box::new).map_err(|failure| format!("{name}: {failure}"))),
            },
            Request::Write(write) => match self.write(&write) {
                Err(failure) if !failure.leaves_the_session_alive() => {
                    self.tell(Update::Done(Err(format!(
                        "{}: it is unknown whether it was written: {failure}",
                        write.path
                    ))));
                    return Err(failure);
                }
                written => Update::Done(written.map_err(|failure| format!("not written: {failure}"))),
            },
            Request::Halt => {
                let mut halted = self.halt();
                if halted.as_ref().is_err_and(is_stale) {
                    self.session.close();
                    halted = self.connect().and_then(|()| self.halt());
                }
                Update::Halted(halted)
            }
        };
        self.tell(update);
        Ok(())
    }

    fn halt(&mut self) -> Result<(), Failure> {
        self.session.restart_budget();
        self.session.with(|controller| controller.robot()?.halt().map(drop))
    }

    /// Converts text to the type of the variable, and reads its present value.
    fn check(&mut self, name: &str, text: &str) -> Result<Write, Failure> {
        let path = ObjectPath::variable(name)?;
        let before = self.value(&path)?;
        let value = data::to_write(name, text, before.as_variant()).map_err(Failure::Input)?;
        Ok(Write { path, value, before })
    }

    fn write(&mut self, write: &Write) -> Result<String, Failure> {
        self.session.restart_budget();
        StreamCheck::default().require(&mut self.session, FunctionId::VARIABLE_PUT_VALUE, None)?;
        let variable = self.session.object(&write.path)?;
        let arguments = [integer(variable)?, write.value.clone()];
        self.session.call(&write.path.to_string(), FunctionId::VARIABLE_PUT_VALUE, &arguments)?;
        Ok(format!("{} = {} is written", write.path, data::format(write.value.as_variant())))
    }
}

/// Returns `None` if the controller refuses or answers with an unexpected value. Fails when the connection is lost.
fn alive<T>(result: Result<T, Failure>) -> Result<Option<T>, Failure> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(failure) if is_lost(&failure) => Err(failure),
        Err(_) => Ok(None),
    }
}

/// Returns whether the reader must connect again.
fn is_lost(failure: &Failure) -> bool {
    !failure.leaves_the_session_alive() || is_stale(failure)
}

/// Returns whether the controller no longer knows a handle of the session: it has started again, or has ended the session.
fn is_stale(failure: &Failure) -> bool {
    matches!(failure, Failure::Refused { code: HResult::E_HANDLE, .. })
}

/// Formats an error in one line.
fn short(code: HResult, text: &str) -> String {
    let own = errors::own(code, text);
    format!("{:#010X} {}", code.to_u32(), if own.is_empty() { code.meaning().unwrap_or_default() } else { own })
}

/// Formats an error with its meaning, its text, and what to do.
fn explained(code: HResult, text: &str) -> String {
    let hint = hint_of(code).map(|hint| format!(" Hint: {hint}")).unwrap_or_default();
    format!("{}{hint}", errors::described(code, text))
}
