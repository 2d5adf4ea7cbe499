//! From a request to what it does: all of RAC, and the functions of b-CAP of every object but the robot's own.

use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

use crate::config::{Permission, Profile};
use crate::controller::{Controller, Wait};
use crate::hand;
use crate::objects::{Contents, Entry, Item, Target};
use crate::options::option;
use crate::system::{self, Owner};
use crate::value::{Value, keep, one_int};
use crate::variables::{self, Family, parse_name, wildcard_names};

/// Bytes of an object's name at most.
const NAME_MAX: usize = 1024;

/// What a function answers when it is not refused.
#[derive(Debug, PartialEq)]
pub(crate) enum Answer {
    /// `S_OK` without a value.
    Done,
    /// `S_OK` with a value.
    Value(Value),
    /// Another success than `S_OK`.
    Code(HResult),
    /// A success, with a value.
    Coded(HResult, Value),
    /// Not yet.
    Wait(Instant),
}

pub(crate) type Answered = Result<Answer, HResult>;

impl From<Value> for Answer {
    fn from(value: Value) -> Self {
        Self::Value(value)
    }
}

impl Handler for Controller {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.advance(now);
        reply.clear();
        if !request.resumed {
            self.begin_fate(peer, request);
        }
        self.meet_fate(peer, request, reply)
    }

    /// A motion that was waited for goes on; only its end is not told any more.
    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        self.advance(now);
        self.waits.remove(&peer);
        self.fates.remove(&peer);
        self.files.forget(peer);
        self.abandon_slave_move(peer);
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        self.advance(now);
        self.forget(peer);
    }
}

impl Controller {
    /// Carries a request out, or goes on with it, whatever the scenario says.
    pub(crate) fn carry_out(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>) -> Outcome {
        match self.dispatch(peer, request) {
            Ok(Answer::Done) => Outcome::Done(HResult::S_OK),
            Ok(Answer::Value(value)) => Outcome::Done(Self::set_reply(reply, &value)),
            Ok(Answer::Coded(code, value)) => match Self::set_reply(reply, &value) {
                HResult::S_OK => Outcome::Done(code),
                failed => Outcome::Done(failed),
            },
            Ok(Answer::Code(code)) => Outcome::Done(code),
            Err(code) => {
                self.note_refusal(peer, request, code);
                Outcome::Done(code)
            }
            Ok(Answer::Wait(at)) => Outcome::Wait(at),
        }
    }
}

impl Controller {
    /// Keeps the reason of a refusal, for GetErrorDescription.
    fn note_refusal(&mut self, peer: PeerId, request: &Request<'_>, code: HResult) {
        let written = match request.function {
            FunctionId::VARIABLE_PUT_VALUE => self.objects.get(peer, request.handle(), Object::Variable).ok(),
            _ => None,
        };
        let accepted = written.and_then(|entry| match entry.item {
            Item::Variable(Target::User(family, _) | Target::Wildcard(family, Some(_))) => {
                Some(variables::accepted(family))
            }
            Item::Variable(Target::Wildcard(_, None)) => Some("a value after Variable_PutID has chosen one variable"),
            Item::Variable(Target::System(_, name)) => system::accepted(name),
            _ => None,
        });
        let observer = self.config().observer.clone();
        self.refusals.note(request, accepted, code, &observer);
    }
}

/// Clients of RAC have no session and no objects: they read and write the same user variables.
impl rac::server::Handler for Controller {
    fn call(&mut self, _: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.advance(now);
        reply.clear();
        if self.is_link_lost() {
            // nor is the answer delivered
            return Outcome::Done(HResult::E_TIMEOUT);
        }
        let rac::Variable { kind, index } = request.variable();
        let result = match request.value() {
            None => self.variables.get(Family::Plain(kind), index).map(|value| Self::set_reply(reply, &value)),
            Some(value) => self.put_user(Family::Plain(kind), index, &value).map(|()| HResult::S_OK),
        };
        Outcome::Done(result.unwrap_or_else(|refused| refused))
    }
}

impl Controller {
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
        let item = self.objects.get(peer, request.handle(), signature.object)?.item;
        if request.function.releases().is_some() {
            self.objects.release(peer, request.handle(), signature.object)?;
            return Ok(Answer::Done);
        }
        if let Some(answer) = self.common(peer, request, signature.object)? {
            return Ok(answer);
        }
        self.slave_mode_allows(peer, request)?;
        match item {
            Item::Controller => self.controller_call(peer, request),
            Item::Robot => self.robot_call(peer, request),
            Item::Task(n) => self.task_call(peer, n, request),
            Item::Variable(target) => self.variable_call(peer, target, request),
            Item::Extension => self.extension_call(peer, request),
            Item::Command => self.command_call(peer, request),
            Item::Message => self.message_call(peer, request),
            Item::File => {
                let name = self.objects.get(peer, request.handle(), Object::File)?.name.clone();
                self.file_call(peer, &name, request)
            }
        }
    }

    fn connect(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let provider = request.text(1);
        let config = self.config();
        let profiles = if config.any_provider { &[Profile::Rc8, Profile::Rc9][..] } else { &[config.profile] };
        if !profiles.iter().any(|profile| provider.eq_ignore_ascii_case(profile.provider())) {
            return Err(HResult::E_CAO_PROV_INVALID);
        }
        let silent =
            option(&request.text(3).to_string(), "@EventDisable").is_some_and(|v| v.eq_ignore_ascii_case("true"));
        self.messages.connect(peer, !silent);
        self.open(peer, Item::Controller, request.text(0).to_string())
    }

    /// Opens an object and answers with its handle.
    pub(crate) fn open(&mut self, peer: PeerId, item: Item, name: String) -> Answered {
        self.open_with(peer, item, name, Contents::Nothing)
    }

    /// Opens an object that keeps something of its own.
    pub(crate) fn open_with(&mut self, peer: PeerId, item: Item, name: String, contents: Contents) -> Answered {
        if name.len() > NAME_MAX {
            return Err(HResult::E_ARGSIZEOVER);
        }
        let entry = Entry { peer, item, name, contents, tag: None, id: None, stamp: self.now };
        let handle = self.objects.open(entry, self.config().max_objects)?;
        Ok(Value::I4(handle).into())
    }

    /// Answers what all objects have: name, help, attribute, tag and ID; `None` for another function.
    fn common(&mut self, peer: PeerId, request: &Request<'_>, object: Object) -> Result<Option<Answer>, HResult> {
        let handle = request.handle();
        let name = request.function.name().and_then(|name| name.strip_prefix(object.name())).unwrap_or_default();
        let entry = self.objects.get_mut(peer, handle, object)?;
        Ok(Some(match name {
            "GetName" => Value::from(entry.name.as_str()).into(),
            "GetHelp" => Value::Text(help(entry)).into(),
            // a file's are those of the file itself
            "GetAttribute" if object == Object::File => return Ok(None),
            "GetAttribute" => Value::I4(0).into(),
            "GetTag" => entry.tag.clone().map_or(Value::Empty, Value::Kept).into(),
            "PutTag" => {
                entry.tag = Some(keep(&request.value(1))?);
                Answer::Done
            }
            "GetID" => match entry.item {
                Item::Variable(Target::User(_, n) | Target::Wildcard(_, Some(n))) => Value::I4(n.cast_signed()).into(),
                _ => entry.id.clone().map_or(Value::Empty, Value::Kept).into(),
            },
            "PutID" => {
                self.put_id(peer, handle, object, &request.value(1))?;
                Answer::Done
            }
            _ => return Ok(None),
        }))
    }

    /// Chooses the variable of a wildcard; other objects just keep what they are given.
    fn put_id(&mut self, peer: PeerId, handle: i32, object: Object, id: &Variant<'_>) -> Result<(), HResult> {
        let entry = self.objects.get_mut(peer, handle, object)?;
        match entry.item {
            Item::Variable(Target::Wildcard(family, _)) => {
                let index = u32::try_from(one_int(id)?).map_err(|_| HResult::DISP_E_BADINDEX)?;
                self.variables.check(family, index)?;
                entry.item = Item::Variable(Target::Wildcard(family, Some(index)));
            }
            // the index is part of the name
            Item::Variable(Target::User(..)) => return Err(HResult::E_CAO_NOT_WRITABLE),
            _ => entry.id = Some(keep(id)?),
        }
        Ok(())
    }

    fn controller_call(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let name = || request.text(1).to_string();
        match request.function {
            FunctionId::CONTROLLER_EXECUTE if request.resumed => self.resume_execute(peer),
            FunctionId::CONTROLLER_GET_VARIABLE => self.open_variable(peer, Owner::Controller, &name()),
            FunctionId::CONTROLLER_GET_ROBOT => match option(&request.text(2).to_string(), "ID") {
                // there is one arm, whatever a client calls it
                None | Some("0") => self.open(peer, Item::Robot, name()),
                Some(_) => Err(HResult::E_CAO_OBJECT_NOTFOUND),
            },
            FunctionId::CONTROLLER_GET_TASK => {
                let wanted = name();
                let found = self.tasks.iter().position(|t| t.name().eq_ignore_ascii_case(wanted.trim()));
                let n = found.ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?;
                self.open(peer, Item::Task(n), self.tasks[n].name().to_owned())
            }
            FunctionId::CONTROLLER_GET_VARIABLE_NAMES => {
                Ok(names(system_names(Owner::Controller).chain(wildcard_names())))
            }
            FunctionId::CONTROLLER_GET_ROBOT_NAMES => Ok(names([self.config().arm_name.clone()])),
            FunctionId::CONTROLLER_GET_TASK_NAMES => Ok(names(self.tasks.iter().map(|t| t.name().to_owned()))),
            FunctionId::CONTROLLER_EXECUTE => self.controller_execute(peer, &name(), &request.value(2)),
            FunctionId::CONTROLLER_GET_FILE | FunctionId::CONTROLLER_GET_FILE_NAMES => {
                self.file_call(peer, "", request)
            }
            FunctionId::CONTROLLER_GET_EXTENSION => {
                let wanted = name();
                let found = wanted.trim().eq_ignore_ascii_case(hand::NAME);
                let name = if found { hand::NAME } else { return Err(HResult::E_CAO_OBJECT_NOTFOUND) };
                self.open(peer, Item::Extension, name.to_owned())
            }
            FunctionId::CONTROLLER_GET_EXTENSION_NAMES => Ok(names([hand::NAME.to_owned()])),
            FunctionId::CONTROLLER_GET_COMMAND => self.open_command(peer, &name()),
            FunctionId::CONTROLLER_GET_COMMAND_NAMES => Ok(names(self.command_names().map(str::to_owned))),
            FunctionId::CONTROLLER_GET_MESSAGE => self.open_message(peer),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    fn extension_call(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::EXTENSION_EXECUTE if request.resumed => self.resume_execute(peer),
            FunctionId::EXTENSION_EXECUTE => self.hand_execute(peer, &request.text(1).to_string()),
            FunctionId::EXTENSION_GET_VARIABLE_NAMES => Ok(names([])),
            FunctionId::EXTENSION_GET_VARIABLE => Err(HResult::E_CAO_OBJECT_NOTFOUND),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    fn task_call(&mut self, peer: PeerId, n: usize, request: &Request<'_>) -> Answered {
        match request.function {
            FunctionId::TASK_GET_VARIABLE => self.open_variable(peer, Owner::Task(n), &request.text(1).to_string()),
            FunctionId::TASK_GET_VARIABLE_NAMES => Ok(names(system_names(Owner::Task(n)))),
            FunctionId::TASK_EXECUTE => self.task_execute(n, &request.text(1).to_string()),
            FunctionId::TASK_START => self.task_start(peer, n, request.int(1)).map(|()| Answer::Done),
            FunctionId::TASK_STOP => self.task_stop(n, request.int(1)),
            FunctionId::TASK_GET_FILE_NAME => Ok(Value::Text(format!("{}.pcs", self.tasks[n].name())).into()),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    fn variable_call(&mut self, peer: PeerId, target: Target, request: &Request<'_>) -> Answered {
        let now = self.now;
        let answer = match request.function {
            FunctionId::VARIABLE_GET_VALUE => self.target_get(target)?.into(),
            FunctionId::VARIABLE_PUT_VALUE if request.resumed => self.resume(peer)?,
            FunctionId::VARIABLE_PUT_VALUE => self.target_put(peer, target, &request.value(1))?,
            FunctionId::VARIABLE_GET_DATE_TIME => {
                let stamp = self.objects.get(peer, request.handle(), Object::Variable)?.stamp;
                return Ok(Value::Date(self.date(stamp)?).into());
            }
            FunctionId::VARIABLE_GET_MICROSECOND => {
                let stamp = self.objects.get(peer, request.handle(), Object::Variable)?.stamp;
                return Ok(Value::I4(self.microsecond(stamp)).into());
            }
            _ => return Err(HResult::E_NOTIMPL),
        };
        self.objects.get_mut(peer, request.handle(), Object::Variable)?.stamp = now;
        Ok(answer)
    }

    /// Returns the microseconds of a time within its second of the wall clock.
    fn microsecond(&self, at: Instant) -> i32 {
        let origin = i128::from(self.config().wall_clock_origin_ms) * 1000;
        i32::try_from((origin + i128::from(at.as_micros())).rem_euclid(1_000_000)).unwrap_or(0)
    }

    /// Opens a variable of an object by its name.
    pub(crate) fn open_variable(&mut self, peer: PeerId, owner: Owner, name: &str) -> Answered {
        let target = match (system::find(owner, name), parse_name(name), owner) {
            (Some(known), _, _) => Target::System(owner, known),
            (None, Some((family, Some(index))), Owner::Controller) => {
                self.variables.check(family, index)?;
                Target::User(family, index)
            }
            (None, Some((family, None)), Owner::Controller) => Target::Wildcard(family, None),
            _ => return Err(HResult::E_CAO_OBJECT_NOTFOUND),
        };
        self.open(peer, Item::Variable(target), name.trim().to_owned())
    }

    fn target_get(&self, target: Target) -> Result<Value, HResult> {
        match target {
            Target::User(family, n) | Target::Wildcard(family, Some(n)) => self.variables.get(family, n),
            Target::Wildcard(_, None) => Err(HResult::DISP_E_BADINDEX),
            Target::System(owner, name) => self.system_get(owner, name),
        }
    }

    fn target_put(&mut self, peer: PeerId, target: Target, value: &Variant<'_>) -> Answered {
        match target {
            Target::User(family, n) | Target::Wildcard(family, Some(n)) => {
                self.put_user(family, n, value).map(|()| Answer::Done)
            }
            Target::Wildcard(_, None) => Err(HResult::DISP_E_BADINDEX),
            Target::System(owner, name) => {
                self.may_write()?;
                self.system_put(peer, owner, name, value)
            }
        }
    }

    fn put_user(&mut self, family: Family, index: u32, value: &Variant<'_>) -> Result<(), HResult> {
        self.may_write()?;
        self.variables.put(family, index, value)
    }

    /// Checks the communication permission.
    pub(crate) fn may_write(&self) -> Result<(), HResult> {
        match self.config().permission {
            Permission::ReadWrite => Ok(()),
            Permission::ReadOnly => Err(HResult::E_CAO_NOT_WRITABLE),
        }
    }

    /// Goes on with a command that has waited; its reply has an empty value.
    pub(crate) fn resume_execute(&mut self, peer: PeerId) -> Answered {
        self.resume(peer).map(with_value)
    }

    /// Waits, or goes on waiting, for what was entered for this client.
    pub(crate) fn resume(&mut self, peer: PeerId) -> Answered {
        match self.waits.get(&peer).copied() {
            Some(Wait::Over(result)) => {
                self.waits.remove(&peer);
                if result == HResult::S_OK { Ok(Answer::Done) } else { Err(result) }
            }
            Some(wait) => Ok(Answer::Wait(self.look_again(wait))),
            None => Err(HResult::E_ABORT),
        }
    }
}

/// Adds the empty value that commands answer and functions do not.
pub(crate) fn with_value(answer: Answer) -> Answer {
    match answer {
        Answer::Done => Value::Empty.into(),
        answer => answer,
    }
}

pub(crate) fn names(list: impl IntoIterator<Item = String>) -> Answer {
    Value::Texts(list.into_iter().collect()).into()
}

pub(crate) fn system_names(owner: Owner) -> impl Iterator<Item = String> {
    system::names(owner).iter().map(|(name, _)| (*name).to_owned())
}

fn help(entry: &Entry) -> String {
    match entry.item {
        Item::Controller => "A virtual robot controller.".to_owned(),
        Item::Robot => "A virtual arm of six axes.".to_owned(),
        Item::Task(_) => "A virtual task: a loop of fixed time.".to_owned(),
        Item::Variable(Target::System(..)) => format!("The system variable {}.", entry.name),
        Item::File => format!("The file {}.", entry.name),
        Item::Extension => "A virtual electric hand.".to_owned(),
        Item::Command => format!("The command {} of the controller.", entry.name),
        Item::Message => "An error of the controller.".to_owned(),
        Item::Variable(_) => format!("The user variable {}.", entry.name),
    }
}
