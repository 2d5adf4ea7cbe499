//! From a request to the part of the controller that executes it: all of RAC, and all functions of b-CAP.

use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, Variant};

use super::{Controller, execute, system};
use crate::answer::{Answer, Answered};
use crate::arm;
use crate::commands;
use crate::config::Profile;
use crate::files::{Done, Progress};
use crate::function::{command_of, executes};
use crate::hand;
use crate::objects::{Entry, Item, Owner, Target};
use crate::options::option;
use crate::scenario::Step;
use crate::table::{Command, Property};
use crate::tasks;
use crate::value::{Value, kept};
use crate::variables::{self, Family, parse_name, wildcard_names};
use crate::waits::Wait;

impl Handler for Controller {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.advance(now);
        reply.clear();
        if !request.resumed {
            for effect in self.scenario.begin_call(peer, request, self.common.now) {
                self.apply(effect);
            }
        }
        match self.scenario.step(peer, self.common.now) {
            Step::Wait(at) => Outcome::Wait(at),
            Step::Answer(code, value) => {
                let fits = value.is_empty() || reply.set(&kept(&value)).is_ok();
                Outcome::Done(if fits { code } else { HResult::E_TOO_MUCH_DATA })
            }
            step => {
                // before the call, because Service_Stop drops its fault
                let time = self.scenario.answer_time(peer);
                let outcome = match step {
                    Step::Refuse(code) => Outcome::Done(self.common.errors.refuse(code, self.common.now)),
                    _ => self.execute(peer, request, reply),
                };
                self.scenario.end_call(peer, outcome, time, reply, self.common.now)
            }
        }
    }

    /// A motion that a call waited for continues; only its end is not reported.
    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        self.advance(now);
        self.common.waits.forget(peer);
        self.scenario.forget(peer);
        self.files.forget(peer);
        self.arm.abandon(peer);
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        self.advance(now);
        self.forget(peer);
    }
}

/// Clients of RAC have no session and no objects: they read and write the same user variables.
impl rac::server::Handler for Controller {
    fn call(&mut self, peer: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.advance(now);
        reply.clear();
        if self.scenario.is_link_lost(self.common.now) {
            // nor is the answer delivered
            return Outcome::Done(HResult::E_TIMEOUT);
        }
        let rac::Variable { kind, index } = request.variable();
        let result = match request.value() {
            None => self.common.variables.get(Family::Plain(kind), index).map(|value| set_reply(reply, &value)),
            Some(value) => self.put_user(peer, Family::Plain(kind), index, &value).map(|()| HResult::S_OK),
        };
        Outcome::Done(result.unwrap_or_else(|refused| refused))
    }
}

impl Controller {
    /// Executes a request, or continues one that waits, whatever the scenario says.
    fn execute(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>) -> Outcome {
        let answered = self.dispatch(peer, request);
        if let Some(code) = self.common.raised.take() {
            self.raise(code);
        }
        match answered {
            Ok(Answer::Done) => Outcome::Done(HResult::S_OK),
            Ok(Answer::Value(value)) => Outcome::Done(set_reply(reply, &value)),
            Ok(Answer::Code(code)) => Outcome::Done(code),
            Ok(Answer::Coded(code, value)) => match set_reply(reply, &value) {
                HResult::S_OK => Outcome::Done(code),
                failed => Outcome::Done(failed),
            },
            Ok(Answer::Until(wait)) => Outcome::Wait(self.poll_time(wait)),
            Ok(Answer::Poll(at)) => Outcome::Wait(at),
            Err(code) => {
                let accepted = self.accepted(peer, request);
                self.refusals.record(request, accepted, code, &self.common.config.observer);
                Outcome::Done(code)
            }
        }
    }

    fn dispatch(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let Some(signature) = request.function.signature() else { return Err(HResult::E_INVALIDARG) };
        match request.function {
            FunctionId::SERVICE_START => {
                self.sessions.insert(peer);
                return Ok(Answer::Done);
            }
            // also without a session: a server releases one as an object, before it passes the client's own call on
            FunctionId::SERVICE_STOP => {
                self.forget(peer);
                return Ok(Answer::Done);
            }
            _ if !self.sessions.contains(&peer) => return Err(HResult::E_NOT_CONNECTED),
            FunctionId::CONTROLLER_CONNECT => return self.connect(peer, request),
            _ => {}
        }
        self.call_object(peer, request, signature.object)
    }

    /// Executes a function of an object, or continues one that waits.
    fn call_object(&mut self, peer: PeerId, request: &Request<'_>, object: Object) -> Answered {
        let handle = request.handle();
        let entry = self.objects.get_mut(peer, handle, object)?;
        if let Some(answered) = entry.common(request, &self.common.variables) {
            return answered;
        }
        if request.function.releases().is_some() {
            self.objects.release(peer, handle, object)?;
            return Ok(Answer::Done);
        }
        self.check_slave_mode(peer, request)?;
        let answer = match request.resumed {
            true => self.resume(peer, request, object)?,
            false => match self.start(peer, request, object)? {
                Answer::Until(wait) => self.wait_for(peer, request, wait)?,
                answer => answer,
            },
        };
        if let FunctionId::VARIABLE_GET_VALUE | FunctionId::VARIABLE_PUT_VALUE = request.function {
            self.objects.get_mut(peer, handle, object)?.stamp = self.common.now;
        }
        Ok(if executes(request.function) { answer.of_command() } else { answer })
    }

    /// Starts a function of an object.
    fn start(&mut self, peer: PeerId, request: &Request<'_>, object: Object) -> Answered {
        let entry = self.objects.get(peer, request.handle(), object)?;
        match entry.item {
            Item::Controller => self.call_controller(peer, request),
            Item::Robot => self.call_robot(peer, request),
            Item::Task(n) => self.call_task(peer, n, request),
            Item::Variable(target) => self.call_variable(peer, target, request),
            Item::Extension => self.call_extension(peer, request),
            Item::Command(_) => self.call_command(peer, request),
            Item::Message(message) => message.call(&self.common.config, request.function),
            Item::File => {
                let progress = self.files.call(&self.common.context(peer), &entry.name, request)?;
                self.file_progress(peer, request, progress)
            }
        }
    }

    /// Continues a call that waits.
    fn resume(&mut self, peer: PeerId, request: &Request<'_>, object: Object) -> Answered {
        match (object, request.function) {
            (Object::File, _) | (_, FunctionId::CONTROLLER_GET_FILE | FunctionId::CONTROLLER_GET_FILE_NAMES) => {
                let progress = self.files.resume(peer, self.common.now)?;
                self.file_progress(peer, request, progress)
            }
            (Object::Command, _) => self.resume_command(peer, request.handle()),
            _ => match self.poll(peer)? {
                Answer::Done if object == Object::Robot => self.arm.resumed(&mut self.common.context(peer), request),
                answer => Ok(answer),
            },
        }
    }

    /// Waits for an event, which may have occurred already.
    fn wait_for(&mut self, peer: PeerId, request: &Request<'_>, wait: Wait) -> Answered {
        self.common.waits.begin(peer, wait);
        self.arm.advance(self.common.now, &mut self.common.waits);
        let object = request.function.signature().map_or(Object::Service, |signature| signature.object);
        self.resume(peer, request, object)
    }

    /// Returns the result of the event that a client waits for.
    fn poll(&mut self, peer: PeerId) -> Answered {
        match self.common.waits.get(peer) {
            Some(Wait::Over(result)) => {
                self.common.waits.forget(peer);
                if result == HResult::S_OK { Ok(Answer::Done) } else { Err(result) }
            }
            Some(wait) => Ok(Answer::Until(wait)),
            None => Err(HResult::E_ABORT),
        }
    }

    fn connect(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let provider = request.text(1);
        let config = &self.common.config;
        let profiles = if config.any_provider { &[Profile::Rc8, Profile::Rc9][..] } else { &[config.profile] };
        if !profiles.iter().any(|profile| provider.eq_ignore_ascii_case(profile.provider())) {
            return Err(HResult::E_CAO_PROV_INVALID);
        }
        let silent =
            option(&request.text(3).to_string(), "@EventDisable").is_some_and(|v| v.eq_ignore_ascii_case("true"));
        self.messages.connect(peer, !silent);
        self.open(peer, Item::Controller, request.text(0).to_string())
    }

    /// Opens an object and answers its handle.
    fn open(&mut self, peer: PeerId, item: Item, name: String) -> Answered {
        let entry = Entry::new(peer, item, name, self.common.now);
        Ok(Value::I4(self.objects.open(entry, self.common.config.max_objects)?).into())
    }

    fn call_controller(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let name = || request.text(1).to_string();
        match request.function {
            FunctionId::CONTROLLER_EXECUTE => self.run(peer, &name(), &request.value(2)),
            FunctionId::CONTROLLER_GET_VARIABLE => self.open_variable(peer, Owner::Controller, &name()),
            FunctionId::CONTROLLER_GET_VARIABLE_NAMES => Ok(Answer::names(
                variable_names(Owner::Controller).into_iter().map(str::to_owned).chain(wildcard_names()),
            )),
            FunctionId::CONTROLLER_GET_ROBOT => match option(&request.text(2).to_string(), "ID") {
                // there is one arm, and it may have any name
                None | Some("0") => self.open(peer, Item::Robot, name()),
                Some(_) => Err(HResult::E_CAO_OBJECT_NOTFOUND),
            },
            FunctionId::CONTROLLER_GET_ROBOT_NAMES => Ok(Answer::names([self.common.config.arm_name.as_str()])),
            FunctionId::CONTROLLER_GET_TASK => {
                let n = self.tasks.position(name().trim()).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?;
                let name = self.tasks.get(n)?.name().to_owned();
                self.open(peer, Item::Task(n), name)
            }
            FunctionId::CONTROLLER_GET_TASK_NAMES => Ok(Answer::names(self.tasks.iter().map(tasks::Task::name))),
            FunctionId::CONTROLLER_GET_FILE | FunctionId::CONTROLLER_GET_FILE_NAMES => {
                let progress = self.files.call(&self.common.context(peer), "", request)?;
                self.file_progress(peer, request, progress)
            }
            FunctionId::CONTROLLER_GET_EXTENSION => match name().trim().eq_ignore_ascii_case(hand::NAME) {
                true => self.open(peer, Item::Extension, hand::NAME.to_owned()),
                false => Err(HResult::E_CAO_OBJECT_NOTFOUND),
            },
            FunctionId::CONTROLLER_GET_EXTENSION_NAMES => Ok(Answer::names([hand::NAME])),
            FunctionId::CONTROLLER_GET_COMMAND => self.open_command(peer, &name()),
            FunctionId::CONTROLLER_GET_COMMAND_NAMES => Ok(Answer::names(execute::names(self.common.config.profile))),
            FunctionId::CONTROLLER_GET_MESSAGE => self.open_message(peer),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    /// Executes a command of Controller_Execute.
    fn run(&mut self, peer: PeerId, name: &str, param: &Variant<'_>) -> Answered {
        let run = Command::handler(execute::COMMANDS, name, self.common.config.profile)?;
        run(self, peer, param).map(Answer::of_command)
    }

    fn call_robot(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::ROBOT_GET_VARIABLE => self.open_variable(peer, Owner::Robot, &request.text(1).to_string()),
            FunctionId::ROBOT_GET_VARIABLE_NAMES => Ok(Answer::names(variable_names(Owner::Robot))),
            _ => self.arm.call(&mut self.common.context(peer), request),
        }
    }

    fn call_extension(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::EXTENSION_EXECUTE => {
                let name = request.text(1).to_string();
                let run = Command::handler(hand::COMMANDS, &name, self.common.config.profile)?;
                run(self.arm.hand_mut(), &mut self.common.context(peer))
            }
            FunctionId::EXTENSION_GET_VARIABLE_NAMES => Ok(Answer::names::<String>([])),
            FunctionId::EXTENSION_GET_VARIABLE => Err(HResult::E_CAO_OBJECT_NOTFOUND),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    fn call_task(&mut self, peer: PeerId, n: usize, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::TASK_GET_VARIABLE => self.open_variable(peer, Owner::Task(n), &request.text(1).to_string()),
            FunctionId::TASK_GET_VARIABLE_NAMES => Ok(Answer::names(variable_names(Owner::Task(n)))),
            _ => self.tasks.get_mut(n)?.call(&mut self.common.context(peer), request),
        }
    }

    fn open_message(&mut self, peer: PeerId) -> Answered {
        let Some(message) = self.messages.oldest(peer) else { return Ok(Answer::Code(HResult::S_FALSE)) };
        let opened = self.open(peer, Item::Message(message), String::new())?;
        self.messages.fetched(peer);
        Ok(opened)
    }

    fn file_progress(&mut self, peer: PeerId, request: &Request<'_>, progress: Progress) -> Answered {
        Ok(match progress {
            Progress::Pending(at) => Answer::Poll(at),
            Progress::Done(Done::Nothing) => Answer::Done,
            Progress::Done(Done::Value(value)) => value.into(),
            Progress::Done(Done::Open(name)) => return self.open(peer, Item::File, name),
            Progress::Done(Done::Moved(name)) => {
                self.objects.rename(peer, request.handle(), name)?;
                Answer::Done
            }
        })
    }

    /// Checks that the client in Slave Mode may call a function.
    fn check_slave_mode(&mut self, peer: PeerId, request: &Request<'_>) -> Result<(), HResult> {
        let streams = self.arm.robot().stream().is_some_and(|stream| stream.peer == peer);
        if !streams || request.resumed {
            return Ok(());
        }
        let allowed = match request.function {
            FunctionId::ROBOT_HALT => true,
            function if executes(function) => command(request).is_some_and(|(_, in_slave_mode)| in_slave_mode),
            function => function.opens().is_some(),
        };
        if allowed { Ok(()) } else { Err(self.common.errors.refuse(HResult::E_SLVMODE_ON, self.common.now)) }
    }

    /// Returns the arguments that a call accepts, where they depend on more than its function.
    fn accepted(&self, peer: PeerId, request: &Request<'_>) -> Option<&'static str> {
        if request.function != FunctionId::VARIABLE_PUT_VALUE {
            return command(request)?.0;
        }
        match self.objects.get(peer, request.handle(), Object::Variable).ok()?.item {
            Item::Variable(Target::User(family, _) | Target::Wildcard(family, Some(_))) => {
                Some(variables::accepted(family))
            }
            Item::Variable(Target::Wildcard(_, None)) => Some("a value after Variable_PutID has chosen one variable"),
            Item::Variable(Target::System(owner, n)) => match owner {
                Owner::Controller => system::VARIABLES.get(n)?.accepts,
                Owner::Robot => arm::variables::VARIABLES.get(n)?.accepts,
                Owner::Task(_) => tasks::VARIABLES.get(n)?.accepts,
            },
            _ => None,
        }
    }
}

/// Functions of command objects.
impl Controller {
    fn open_command(&mut self, peer: PeerId, name: &str) -> Answered {
        let profile = self.common.config.profile;
        let command = Command::find(execute::COMMANDS, name).filter(|command| command.exists(profile));
        let name = command.ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?.name;
        self.open(peer, Item::Command(commands::Command::default()), name.to_owned())
    }

    fn command_mut(&mut self, peer: PeerId, handle: i32) -> Result<&mut commands::Command, HResult> {
        match &mut self.objects.get_mut(peer, handle, Object::Command)?.item {
            Item::Command(command) => Ok(command),
            _ => Err(HResult::E_HANDLE),
        }
    }

    fn call_command(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let handle = request.handle();
        let running = self.command_mut(peer, handle)?.running();
        // it may have ended while no call waited for it
        if let Some(outcome) = running.and_then(|wait| self.arm.outcome(wait, self.common.now)) {
            self.command_mut(peer, handle)?.end(outcome);
        }
        match request.function {
            FunctionId::COMMAND_EXECUTE => self.execute_command(peer, handle, request.int(1)),
            FunctionId::COMMAND_CANCEL => self.cancel_command(peer, handle),
            _ => self.command_mut(peer, handle)?.call(request),
        }
    }

    fn execute_command(&mut self, peer: PeerId, handle: i32, mode: i32) -> Answered {
        if ![0, 1].contains(&mode) {
            return Err(HResult::E_INVALIDARG);
        }
        let name = self.objects.get(peer, handle, Object::Command)?.name.clone();
        let now = self.common.now;
        let parameters = self.command_mut(peer, handle)?.begin(now)?;
        let mut answered = self.run(peer, &name, &kept(&parameters));
        if let Ok(Answer::Until(wait)) = answered {
            self.common.waits.begin(peer, wait);
            self.arm.advance(now, &mut self.common.waits);
            answered = self.poll(peer).map(Answer::of_command);
        }
        let answer = self.record(peer, handle, answered)?;
        if mode == 0 {
            return Ok(answer);
        }
        if let Answer::Poll(_) = answer {
            self.common.waits.forget(peer);
        }
        Ok(Answer::Done)
    }

    /// Continues an execution, up to the timeout of its command.
    fn resume_command(&mut self, peer: PeerId, handle: i32) -> Answered {
        let now = self.common.now;
        let is_overdue = self.command_mut(peer, handle)?.is_overdue(now);
        if is_overdue && !matches!(self.common.waits.get(peer), Some(Wait::Over(_))) {
            // the command itself continues
            self.common.waits.forget(peer);
            return Err(HResult::E_TIMEOUT);
        }
        let answered = self.poll(peer).map(Answer::of_command);
        self.record(peer, handle, answered)
    }

    /// Records the progress of an execution, and returns its answer.
    fn record(&mut self, peer: PeerId, handle: i32, answered: Answered) -> Answered {
        let command = self.command_mut(peer, handle)?;
        command.record(&answered);
        let deadline = command.deadline();
        Ok(match answered? {
            Answer::Until(wait) => {
                let at = self.poll_time(wait);
                Answer::Poll(deadline.map_or(at, |deadline| deadline.min(at)))
            }
            answer => answer,
        })
    }

    fn cancel_command(&mut self, peer: PeerId, handle: i32) -> Answered {
        let Some(wait) = self.command_mut(peer, handle)?.running() else { return Ok(Answer::Code(HResult::S_FALSE)) };
        self.arm.cancel(wait, self.common.now, &mut self.common.waits);
        self.command_mut(peer, handle)?.end(Err(HResult::E_CANCEL));
        Ok(Answer::Done)
    }
}

/// Functions of variables.
impl Controller {
    /// Opens a variable of an object by its name.
    fn open_variable(&mut self, peer: PeerId, owner: Owner, name: &str) -> Answered {
        let target = match (find_variable(owner, name), parse_name(name), owner) {
            (Some(n), _, _) => Target::System(owner, n),
            (None, Some((family, Some(index))), Owner::Controller) => {
                self.common.variables.check(family, index)?;
                Target::User(family, index)
            }
            (None, Some((family, None)), Owner::Controller) => Target::Wildcard(family, None),
            _ => return Err(HResult::E_CAO_OBJECT_NOTFOUND),
        };
        self.open(peer, Item::Variable(target), name.trim().to_owned())
    }

    fn call_variable(&mut self, peer: PeerId, target: Target, request: &Request<'_>) -> Answered {
        let stamp = self.objects.get(peer, request.handle(), Object::Variable)?.stamp;
        let config = &self.common.config;
        match request.function {
            FunctionId::VARIABLE_GET_VALUE => self.get(peer, target).map(Answer::Value),
            FunctionId::VARIABLE_PUT_VALUE => self.put(peer, target, &request.value(1)),
            FunctionId::VARIABLE_GET_DATE_TIME => Ok(Value::Date(config.date(stamp)?).into()),
            FunctionId::VARIABLE_GET_MICROSECOND => Ok(Value::I4(config.microsecond(stamp)).into()),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    fn get(&mut self, peer: PeerId, target: Target) -> Result<Value, HResult> {
        match target {
            Target::User(family, n) | Target::Wildcard(family, Some(n)) => self.common.variables.get(family, n),
            Target::Wildcard(_, None) => Err(HResult::DISP_E_BADINDEX),
            Target::System(Owner::Controller, n) => property(system::VARIABLES, n)?.getter()?(self),
            Target::System(Owner::Robot, n) => {
                Ok(property(arm::variables::VARIABLES, n)?.getter()?(&self.arm, &self.common.context(peer)))
            }
            Target::System(Owner::Task(task), n) => Ok(property(tasks::VARIABLES, n)?.getter()?(self.tasks.get(task)?)),
        }
    }

    fn put(&mut self, peer: PeerId, target: Target, value: &Variant<'_>) -> Answered {
        let (owner, n) = match target {
            Target::User(family, n) | Target::Wildcard(family, Some(n)) => {
                return self.put_user(peer, family, n, value).map(|()| Answer::Done);
            }
            Target::Wildcard(_, None) => return Err(HResult::DISP_E_BADINDEX),
            Target::System(owner, n) => (owner, n),
        };
        let mut ctx = self.common.context(peer);
        ctx.may_write()?;
        match owner {
            Owner::Controller => property(system::VARIABLES, n)?.setter()?(self, peer, value),
            Owner::Robot => property(arm::variables::VARIABLES, n)?.setter()?(&mut self.arm, &mut ctx, value),
            Owner::Task(task) => property(tasks::VARIABLES, n)?.setter()?(self.tasks.get_mut(task)?, &mut ctx, value),
        }
    }

    fn put_user(&mut self, peer: PeerId, family: Family, n: u32, value: &Variant<'_>) -> Result<(), HResult> {
        let ctx = self.common.context(peer);
        ctx.may_write()?;
        ctx.variables.put(family, n, value)
    }
}

/// Returns what the tables say about the command of a request: its parameter, and whether Slave Mode allows it.
fn command(request: &Request<'_>) -> Option<(Option<&'static str>, bool)> {
    let name = command_of(request)?;
    match request.function {
        FunctionId::CONTROLLER_EXECUTE => {
            Command::find(execute::COMMANDS, &name).map(|command| (command.accepts, command.in_slave_mode))
        }
        FunctionId::ROBOT_EXECUTE => {
            Command::find(arm::commands::COMMANDS, &name).map(|command| (command.accepts, command.in_slave_mode))
        }
        _ => None,
    }
}

/// Returns the entry of a system variable in the table of its owner.
fn property<G, P>(table: &'static [Property<G, P>], n: usize) -> Result<&'static Property<G, P>, HResult> {
    table.get(n).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)
}

/// Finds a system variable in the table of its owner.
fn find_variable(owner: Owner, name: &str) -> Option<usize> {
    match owner {
        Owner::Controller => Property::position(system::VARIABLES, name),
        Owner::Robot => Property::position(arm::variables::VARIABLES, name),
        Owner::Task(_) => Property::position(tasks::VARIABLES, name),
    }
}

fn variable_names(owner: Owner) -> Vec<&'static str> {
    match owner {
        Owner::Controller => system::VARIABLES.iter().map(|property| property.name).collect(),
        Owner::Robot => arm::variables::VARIABLES.iter().map(|property| property.name).collect(),
        Owner::Task(_) => tasks::VARIABLES.iter().map(|property| property.name).collect(),
    }
}

/// Encodes a value into `reply`.
fn set_reply(reply: &mut ReplyValue<'_>, value: &Value) -> HResult {
    match reply.set(value as &dyn Encode) {
        Ok(()) => HResult::S_OK,
        Err(_) => HResult::E_TOO_MUCH_DATA,
    }
}
