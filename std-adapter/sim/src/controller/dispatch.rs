//! From a request to the part of the controller that executes it: all of RAC, and all functions of b-CAP.

use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{Effect, FunctionId, Object};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_core::variant::{OwnedVariant, Variant};

use super::variable_calls::{accepted_value, names_of};
use super::{Controller, controller_execute};
use crate::answer::{Answer, Answered};
use crate::arm;
use crate::codes::{ARM_OF_TASK, WRONG_ARGUMENT};
use crate::comm;
use crate::command_name::{command_of, executes};
use crate::config::Permission;
use crate::explain::is_of_argument;
use crate::files::{CRC, JobProgress, JobResult};
use crate::hand;
use crate::objects::{Extension, Item, OpenObject, Parent, VariableRef};
use crate::options::{check as check_options, has_option, option};
use crate::rules;
use crate::scenario::CallPlan;
use crate::table::Command;
use crate::tasks;
use crate::variables::{Family, wildcard_names};
use crate::waits::Wait;

impl Handler for Controller {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.advance(now);
        for effect in self.scenario.begin_call(peer, request, self.shared.now) {
            self.apply(effect);
        }
        self.serve(peer, request, CallPhase::Start, reply)
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.advance(now);
        self.serve(peer, request, CallPhase::Resume, reply)
    }

    /// The faults of the scenario concern calls of clients only. A lost link has not carried the client's Service_Stop, so
    /// nothing is released then; [`left`](Handler::left) releases everything in any case.
    fn release(&mut self, peer: PeerId, request: &Request<'_>, now: Instant) {
        self.advance(now);
        if !self.scenario.is_link_lost(self.shared.now) {
            let _ = self.execute(peer, request, CallPhase::Start, &mut ReplyValue::new(&mut []));
        }
    }

    /// A motion that a call waited for continues; only its end is not reported.
    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        self.advance(now);
        self.shared.waits.forget(peer);
        self.scenario.forget(peer);
        self.files.forget(peer);
        self.arm.abandon(peer);
    }

    /// Stores why the server has refused a request, for GetErrorDescription.
    fn refused(&mut self, _: PeerId, request: &Request<'_>, code: HResult, _: Instant) {
        self.refusals.record_signature(request, code, &self.shared.config.observer);
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        self.advance(now);
        self.shared.addresses.remove(&peer);
        self.scenario.forget(peer);
        self.forget(peer);
    }
}

/// Clients of RAC have no session and no objects: they read and write the same user variables.
impl rac::server::Handler for Controller {
    fn call(&mut self, peer: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.advance(now);
        reply.clear();
        if self.scenario.is_link_lost(self.shared.now) {
            // nor is the answer delivered
            return Outcome::Done(HResult::E_TIMEOUT);
        }
        let rac::Variable { kind, index } = request.variable();
        let result = match request.value() {
            None if self.shared.config.permission == Permission::None => Err(HResult::E_ACCESSDENIED),
            None => self.shared.variables.get(Family::Plain(kind), index).map(|value| set_reply(reply, &value)),
            Some(value) => self.put_user(peer, Family::Plain(kind), index, &value).map(|()| HResult::S_OK),
        };
        Outcome::Done(result.unwrap_or_else(|refused| refused))
    }

    fn left(&mut self, peer: PeerId, _: Instant) {
        self.shared.addresses.remove(&peer);
    }
}

/// Whether the server calls the handler for the first time for a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CallPhase {
    Start,
    Resume,
}

impl Controller {
    /// Executes a request, or continues one that waits, as the scenario says.
    fn serve(&mut self, peer: PeerId, request: &Request<'_>, phase: CallPhase, reply: &mut ReplyValue<'_>) -> Outcome {
        reply.clear();
        match self.scenario.call_plan(peer, self.shared.now) {
            CallPlan::Wait(at) => Outcome::Wait(at),
            CallPlan::Answer(code, value) => {
                let fits = value.is_none_or(|value| reply.set(&value).is_ok());
                Outcome::Done(if fits { code } else { HResult::E_TOO_MUCH_DATA })
            }
            step => {
                let outcome = match step {
                    CallPlan::Refuse(code) => {
                        self.refuse(code);
                        Outcome::Done(code)
                    }
                    _ => self.execute(peer, request, phase, reply),
                };
                self.scenario.end_call(peer, outcome, reply, self.shared.now)
            }
        }
    }

    /// Executes a request, or continues one that waits, whatever the scenario says.
    fn execute(
        &mut self,
        peer: PeerId,
        request: &Request<'_>,
        phase: CallPhase,
        reply: &mut ReplyValue<'_>,
    ) -> Outcome {
        match self.dispatch(peer, request, phase) {
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
                let code = code_of_motion(request, code);
                let accepted = self.accepted(peer, request);
                self.refusals.record(request, accepted, code, &self.shared.config.observer);
                self.refuse(code);
                Outcome::Done(code)
            }
        }
    }

    fn dispatch(&mut self, peer: PeerId, request: &Request<'_>, phase: CallPhase) -> Answered {
        let Some(signature) = request.function.signature() else { return Err(HResult::E_INVALIDARG) };
        match request.function {
            FunctionId::SERVICE_START => {
                check_options(&self.shared.config, request)?;
                self.sessions.insert(peer);
                return Ok(Answer::Done);
            }
            // even without a session: a server has released it as an object before it passes on the client's Service_Stop
            FunctionId::SERVICE_STOP => {
                self.forget(peer);
                return Ok(Answer::Done);
            }
            _ if !self.sessions.contains(&peer) => return Err(HResult::E_NOT_CONNECTED),
            FunctionId::CONTROLLER_CONNECT => return self.connect(peer, request),
            _ => {}
        }
        self.call_object(peer, request, phase, signature.object)
    }

    /// Executes a function of an object, or continues one that waits.
    fn call_object(&mut self, peer: PeerId, request: &Request<'_>, phase: CallPhase, object: Object) -> Answered {
        let handle = request.handle();
        self.objects.get(peer, handle, object)?;
        if phase == CallPhase::Start {
            self.check_permission(request, object)?;
            self.check_slave_mode(request)?;
        }
        let entry = self.objects.get_mut(peer, handle, object)?;
        if let Some(answered) = entry.common(request, &self.shared.variables) {
            return answered;
        }
        if request.function.releases().is_some() {
            self.objects.release(peer, handle, object)?;
            return Ok(Answer::Done);
        }
        if phase == CallPhase::Start {
            check_options(&self.shared.config, request)?;
        }
        let answer = match phase {
            CallPhase::Resume => self.continue_call(peer, request, object)?,
            CallPhase::Start => match self.start(peer, request, object)? {
                Answer::Until(wait) => self.wait_for(peer, request, wait)?,
                answer => answer,
            },
        };
        if let FunctionId::VARIABLE_GET_VALUE | FunctionId::VARIABLE_PUT_VALUE = request.function {
            self.objects.get_mut(peer, handle, object)?.stamp = self.shared.now;
        }
        Ok(if executes(request.function) { answer.of_command() } else { answer })
    }

    /// Starts a function of an object.
    fn start(&mut self, peer: PeerId, request: &Request<'_>, object: Object) -> Answered {
        let entry = self.objects.get(peer, request.handle(), object)?;
        match &entry.item {
            Item::Controller => self.call_controller(peer, request),
            Item::Robot => self.call_robot(peer, request),
            Item::Task(n) => {
                let n = *n;
                self.call_task(peer, n, request)
            }
            Item::Variable(target) => {
                let target = *target;
                self.call_variable(peer, target, request)
            }
            Item::Extension(extension) => {
                let extension = *extension;
                self.call_extension(peer, extension, request)
            }
            Item::Command(_) => self.call_command(peer, request),
            Item::Message(message) => message.call(&self.shared.config, request.function),
            Item::File if request.function == FunctionId::FILE_RUN => {
                let name = entry.name.clone();
                self.run_file(peer, &name)
            }
            Item::File if request.function == FunctionId::FILE_GET_VARIABLE && !is_crc(request) => {
                Err(HResult::E_CAO_OBJECT_NOTFOUND)
            }
            // files have no commands
            Item::File if request.function == FunctionId::FILE_EXECUTE => Err(HResult::E_INVALID_CMD_NAME),
            Item::File => {
                let progress = self.files.call(&self.shared.context(peer), &entry.name, request)?;
                self.file_progress(peer, request, progress)
            }
        }
    }

    /// Continues a call that waits.
    fn continue_call(&mut self, peer: PeerId, request: &Request<'_>, object: Object) -> Answered {
        match (object, request.function) {
            (Object::File, _) | (_, FunctionId::CONTROLLER_GET_FILE | FunctionId::CONTROLLER_GET_FILE_NAMES) => {
                let progress = self.files.resume(peer, self.shared.now)?;
                self.file_progress(peer, request, progress)
            }
            (Object::Command, _) => self.resume_command(peer, request.handle()),
            _ => match self.poll(peer)? {
                Answer::Done if object == Object::Robot => self.arm.resumed(&mut self.shared.context(peer), request),
                answer => Ok(answer),
            },
        }
    }

    /// Waits for an event, which may have occurred already.
    fn wait_for(&mut self, peer: PeerId, request: &Request<'_>, wait: Wait) -> Answered {
        self.shared.waits.begin(peer, wait);
        self.arm.advance(self.shared.now, &mut self.shared.waits);
        let object = request.function.signature().map_or(Object::Service, |signature| signature.object);
        self.continue_call(peer, request, object)
    }

    /// Returns the result of the event that a client waits for.
    pub(super) fn poll(&mut self, peer: PeerId) -> Answered {
        match self.shared.waits.get(peer) {
            Some(Wait::Over(result)) => {
                self.shared.waits.forget(peer);
                // its error was entered when the event occurred
                Ok(if result == HResult::S_OK { Answer::Done } else { Answer::Code(result) })
            }
            Some(wait) => Ok(Answer::Until(wait)),
            None => Err(HResult::E_ABORT),
        }
    }

    fn connect(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let has_server = option(&request.text(3).to_string(), "Server").is_some();
        self.shared.config.check_provider(&request.text(1).to_string(), has_server)?;
        check_options(&self.shared.config, request)?;
        let silent =
            option(&request.text(3).to_string(), "@EventDisable").is_some_and(|v| v.eq_ignore_ascii_case("true"));
        let wanted = request.text(0).to_string();
        if !has_option(&request.text(3).to_string(), "@IfNotMember") && self.objects.has_controller(&wanted) {
            return Err(HResult::E_CAO_COLLECTION_REGISTERED);
        }
        let name = self.objects.controller_name(&wanted);
        self.messages.connect(peer, !silent);
        self.open(peer, Item::Controller, name)
    }

    /// Opens an object and answers its handle.
    pub(super) fn open(&mut self, peer: PeerId, item: Item, name: String) -> Answered {
        let entry = OpenObject::new(peer, item, name, self.shared.now);
        Answer::of(self.objects.open(entry, self.shared.config.max_objects)?)
    }

    fn call_controller(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let name = || request.text(1).to_string();
        match request.function {
            FunctionId::CONTROLLER_EXECUTE => self.run(peer, &name(), &request.value(2)),
            FunctionId::CONTROLLER_GET_VARIABLE => self.open_variable(peer, Parent::Controller, &name()),
            FunctionId::CONTROLLER_GET_VARIABLE_NAMES => {
                Answer::names(names_of(Parent::Controller).into_iter().map(str::to_owned).chain(wildcard_names()))
            }
            FunctionId::CONTROLLER_GET_ROBOT => match option(&request.text(2).to_string(), "ID") {
                // there is one arm, and it may have any name
                None | Some("0") => self.open(peer, Item::Robot, name()),
                Some(_) => Err(HResult::E_CAO_OBJECT_NOTFOUND),
            },
            FunctionId::CONTROLLER_GET_ROBOT_NAMES => Answer::names([self.shared.config.arm_name.as_str()]),
            FunctionId::CONTROLLER_GET_TASK => {
                let n = self.tasks.position(name().trim()).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?;
                let name = self.tasks.get(n)?.name().to_owned();
                if !has_option(&request.text(2).to_string(), "@IfNotMember") && self.objects.has_task(peer, n) {
                    return Err(HResult::E_CAO_COLLECTION_REGISTERED);
                }
                self.open(peer, Item::Task(n), name)
            }
            FunctionId::CONTROLLER_GET_TASK_NAMES => Answer::names(self.tasks.iter().map(tasks::Task::name)),
            FunctionId::CONTROLLER_GET_FILE | FunctionId::CONTROLLER_GET_FILE_NAMES => {
                let progress = self.files.call(&self.shared.context(peer), "", request)?;
                self.file_progress(peer, request, progress)
            }
            FunctionId::CONTROLLER_GET_EXTENSION => {
                let is_named = |extension: &Extension| extension.name().eq_ignore_ascii_case(name().trim());
                let extension = Extension::ALL.into_iter().find(is_named).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?;
                self.open(peer, Item::Extension(extension), extension.name().to_owned())
            }
            FunctionId::CONTROLLER_GET_EXTENSION_NAMES => Answer::names(Extension::ALL.map(Extension::name)),
            FunctionId::CONTROLLER_GET_COMMAND => self.open_command(peer, &name()),
            FunctionId::CONTROLLER_GET_COMMAND_NAMES => {
                Answer::names(controller_execute::names(self.shared.config.model.functions))
            }
            FunctionId::CONTROLLER_GET_MESSAGE => self.open_message(peer),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    /// Executes a command of Controller_Execute.
    pub(super) fn run(&mut self, peer: PeerId, name: &str, param: &Variant<'_>) -> Answered {
        let run = Command::handler(controller_execute::COMMANDS, name, self.shared.config.model.functions)?;
        run(self, peer, param).map(Answer::of_command)
    }

    fn call_robot(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::ROBOT_GET_VARIABLE => self.open_variable(peer, Parent::Robot, &request.text(1).to_string()),
            FunctionId::ROBOT_GET_VARIABLE_NAMES => Answer::names(names_of(Parent::Robot)),
            FunctionId::ROBOT_HALT if self.is_arm_of_task() => Err(ARM_OF_TASK),
            _ => self.arm.call(&mut self.shared.context(peer), request),
        }
    }

    fn call_extension(&mut self, peer: PeerId, extension: Extension, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::EXTENSION_EXECUTE => {
                let (name, functions) = (request.text(1).to_string(), self.shared.config.model.functions);
                match extension {
                    Extension::Hand => {
                        let run = Command::handler(hand::COMMANDS, &name, functions)?;
                        run(self.arm.hand_mut(), &mut self.shared.context(peer), &request.value(2))
                    }
                    Extension::Comm => {
                        let run = Command::handler(comm::COMMANDS, &name, functions)?;
                        self.comm.execute(run, &request.value(2))
                    }
                    Extension::Pallet => Err(match name.trim().eq_ignore_ascii_case("CalcPos") {
                        true => HResult::E_NOTIMPL,
                        false => HResult::E_INVALID_CMD_NAME,
                    }),
                }
            }
            FunctionId::EXTENSION_GET_VARIABLE_NAMES => Answer::names::<String>([]),
            FunctionId::EXTENSION_GET_VARIABLE => Err(HResult::E_CAO_OBJECT_NOTFOUND),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    fn call_task(&mut self, peer: PeerId, n: usize, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::TASK_GET_VARIABLE => self.open_variable(peer, Parent::Task(n), &request.text(1).to_string()),
            FunctionId::TASK_GET_VARIABLE_NAMES => Answer::names(names_of(Parent::Task(n))),
            _ => {
                let answered = self.tasks.get_mut(n)?.call(&mut self.shared.context(peer), request);
                self.free_arm_of_tasks();
                answered
            }
        }
    }

    /// Starts the task of a file for one cycle, and answers its name.
    fn run_file(&mut self, peer: PeerId, path: &str) -> Answered {
        let whole = path.replace('\\', "/");
        let task = whole.rsplit_once('.').map_or(whole.as_str(), |(task, _)| task);
        let last = task.rsplit('/').next().unwrap_or(task);
        let place = self.tasks.position(task).or_else(|| self.tasks.position(last));
        let task = self.tasks.get_mut(place.ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?)?;
        task.start_for(&mut self.shared.context(peer), 1)?;
        Answer::of(task.name())
    }

    fn open_message(&mut self, peer: PeerId) -> Answered {
        let Some(message) = self.messages.oldest(peer) else { return Ok(Answer::Code(HResult::S_FALSE)) };
        let opened = self.open(peer, Item::Message(message), String::new())?;
        self.messages.fetched(peer);
        Ok(opened)
    }

    fn file_progress(&mut self, peer: PeerId, request: &Request<'_>, progress: JobProgress) -> Answered {
        Ok(match progress {
            JobProgress::Pending(at) => Answer::Poll(at),
            JobProgress::Done(JobResult::Nothing) => Answer::Done,
            JobProgress::Done(JobResult::Value(value)) => value.into(),
            JobProgress::Done(JobResult::Crc(crc)) => {
                return self.open(peer, Item::Variable(VariableRef::Crc(crc)), CRC.to_owned());
            }
            JobProgress::Done(JobResult::Open(name)) => return self.open(peer, Item::File, name),
            JobProgress::Done(JobResult::Moved(name)) => {
                self.objects.rename(peer, request.handle(), name)?;
                Answer::Done
            }
        })
    }

    /// Checks the communication permission. The code of a variable that must not be written is in [`Context::may_write`].
    ///
    /// [`Context::may_write`]: crate::context::Context::may_write
    fn check_permission(&self, request: &Request<'_>, object: Object) -> Result<(), HResult> {
        let function = request.function;
        let permission = self.shared.config.permission;
        if permission == Permission::ReadWrite || function == FunctionId::ROBOT_HALT {
            return Ok(());
        }
        let is_refused = match function.properties(command_of(request).as_deref(), None).effect {
            Effect::Session => false,
            _ if function.opens().is_some() => false,
            Effect::Reads => permission == Permission::None,
            // a variable and a file that is not run check it themselves, with the code of a variable
            _ => {
                (object != Object::File || function == FunctionId::FILE_RUN)
                    && function != FunctionId::VARIABLE_PUT_VALUE
            }
        };
        if is_refused { Err(HResult::E_ACCESSDENIED) } else { Ok(()) }
    }

    /// Checks that Slave Mode allows a call, from any client. The refusal of another call ends Slave Mode, as every error does.
    fn check_slave_mode(&self, request: &Request<'_>) -> Result<(), HResult> {
        let command = command_of(request);
        let properties = request.function.properties(command.as_deref(), None);
        match self.arm.robot().stream().is_none() || properties.in_slave_mode.is_allowed() {
            true => Ok(()),
            false => Err(HResult::E_SLVMODE_ON),
        }
    }

    /// Returns the arguments that a call accepts, where they depend on more than its function.
    fn accepted(&self, peer: PeerId, request: &Request<'_>) -> Option<&'static str> {
        if request.function != FunctionId::VARIABLE_PUT_VALUE {
            return accepts(request);
        }
        accepted_value(self.objects.get(peer, request.handle(), Object::Variable).ok()?)
    }
}

/// Returns the code of a refusal: the controller itself refuses the arguments of a motion, others are refused before it.
fn code_of_motion(request: &Request<'_>, code: HResult) -> HResult {
    let name = command_of(request).unwrap_or_else(|| request.function.to_string());
    if is_of_argument(code) && rules::MOTION.concerns(&name) { WRONG_ARGUMENT } else { code }
}

/// Returns what the command of a request accepts as its parameter.
fn accepts(request: &Request<'_>) -> Option<&'static str> {
    let name = command_of(request)?;
    match request.function {
        FunctionId::CONTROLLER_EXECUTE => Command::find(controller_execute::COMMANDS, &name)?.accepts,
        FunctionId::ROBOT_EXECUTE => Command::find(arm::robot_execute::COMMANDS, &name)?.accepts,
        // no command of a hand checks its parameter
        FunctionId::EXTENSION_EXECUTE => Command::find(comm::COMMANDS, &name)?.accepts,
        _ => None,
    }
}

/// Returns whether a request opens the variable of a file; an example of the guide omits the `@`.
fn is_crc(request: &Request<'_>) -> bool {
    let name = request.text(1).to_string();
    name.trim().eq_ignore_ascii_case(CRC) || name.trim().eq_ignore_ascii_case("CRC")
}

/// Encodes a value into `reply`.
fn set_reply(reply: &mut ReplyValue<'_>, value: &OwnedVariant) -> HResult {
    match reply.set(value) {
        Ok(()) => HResult::S_OK,
        Err(_) => HResult::E_TOO_MUCH_DATA,
    }
}
