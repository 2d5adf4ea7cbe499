//! Opening an object by its path: the service and the controller if they are not open yet, then each object of the path.

use core::convert::identity;
use core::fmt;
use core::ops::Deref;

use super::action::Procedure;
use super::failure::{StepCause, StepError};
use super::provider::Provider;
use super::sequence::{NextStep, Sequence, StepCall, Steps, UNDO_MAX};
use crate::bcap::call::{
    Any, ControllerHandle, ExtensionHandle, FileHandle, Reply, ReplyError, RobotHandle, TaskHandle, handle_of,
};
use crate::bcap::{Frame, FunctionId, Object};
use crate::hresult::HResult;
use crate::time::Instant;

/// The maximum number of objects in a path: a sequence also contains the service and the controller.
pub const PATH_MAX: usize = UNDO_MAX - 2;
/// A name in a reply, of at most 64 bytes of UTF-8.
pub(super) type Name = heapless::String<64>;
/// The first robot: the name in the specification's samples. In the RC8 provider guide (5.2.3) any name means the first arm.
const DEFAULT_ROBOT: &str = "Arm0";
/// The expected reply to a request for names.
const NAMES: &str = "an array of names";

/// An open object that others are opened from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Owner {
    object: Object,
    handle: i32,
}

macro_rules! owners {
    ($($handle:ident $object:ident;)*) => {$(
        impl From<$handle> for Owner {
            fn from(handle: $handle) -> Self {
                Self { object: Object::$object, handle: handle.0 }
            }
        }
    )*};
}

owners! {
    ControllerHandle Controller;
    RobotHandle Robot;
    TaskHandle Task;
    FileHandle File;
    ExtensionHandle Extension;
}

/// One object of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PathStep<'a> {
    /// Its kind.
    pub object: Object,
    /// Its name; `None` is the controller's first robot.
    pub name: Option<&'a str>,
}

impl<'a> PathStep<'a> {
    /// A variable of this name.
    #[must_use]
    pub const fn variable(name: &'a str) -> Self {
        Self { object: Object::Variable, name: Some(name) }
    }
}

/// A path cannot be opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PathError {
    /// It has more than [`PATH_MAX`] objects.
    TooLong,
    /// Objects of the kind `owner` do not contain objects of the kind `object`.
    NoSuchObject {
        /// The kind of the owner.
        owner: Object,
        /// The kind of the object.
        object: Object,
    },
    /// Only robots can be opened without a name.
    NoName(Object),
}

impl fmt::Display for PathError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong => write!(f, "the path has more than {PATH_MAX} objects"),
            Self::NoSuchObject { owner, object } => {
                write!(f, "an object of the kind {} has no object of the kind {}", owner.name(), object.name())
            }
            Self::NoName(object) => write!(f, "an object of the kind {} needs a name", object.name()),
        }
    }
}

impl core::error::Error for PathError {}

/// The handles of a path, in the order in which they were opened: for [`release`](super::release). It is a slice.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Opened(heapless::Vec<(Object, i32), UNDO_MAX>);

impl Opened {
    /// Returns the handle of the last object, for which the path was opened.
    #[must_use]
    pub fn handle(&self) -> Option<i32> {
        self.0.last().map(|(_, handle)| *handle)
    }
}

impl Deref for Opened {
    type Target = [(Object, i32)];

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

/// Opens an object and the objects on the way to it. Returns their handles, the handle of the object last.
///
/// # Errors
///
/// A [`PathError`]: the path is too long, or the kinds of its objects do not follow each other.
pub fn open_path<'a, O: Into<Owner>>(
    owner: O,
    path: &[PathStep<'a>],
) -> Result<impl Procedure<Output = Opened, Error = StepError> + use<'a, O>, PathError> {
    Ok(Sequence::new(PathSteps::from(owner.into(), path)?, identity))
}

/// The steps: Service_Start and Controller_Connect, when a provider is given, and then the path.
#[derive(Debug)]
pub(super) struct PathSteps<'a> {
    provider: Option<Provider<'a>>,
    path: heapless::Vec<PathStep<'a>, PATH_MAX>,
    opened: Opened,
    /// The object that opens the next object of the path.
    owner: Owner,
    /// Number of open objects of the path.
    done: usize,
    /// Whether the controller refused [`DEFAULT_ROBOT`], so that the names are read.
    asks: bool,
    /// The name of the first robot, after the controller's reply.
    first: Option<Name>,
}

impl<'a> PathSteps<'a> {
    /// The steps from an open object on.
    pub(super) fn from(owner: Owner, path: &[PathStep<'a>]) -> Result<Self, PathError> {
        let mut from = owner.object;
        for step in path {
            if step.object.opened_from(from).is_none() {
                return Err(PathError::NoSuchObject { owner: from, object: step.object });
            }
            if step.name.is_none() && step.object != Object::Robot {
                return Err(PathError::NoName(step.object));
            }
            from = step.object;
        }
        let path = heapless::Vec::from_slice(path).map_err(|_| PathError::TooLong)?;
        Ok(Self { provider: None, path, opened: Opened::default(), owner, done: 0, asks: false, first: None })
    }

    /// The steps of a new session, up to the controller, or to one of its robots.
    pub(super) fn session(provider: Provider<'a>, robot: Option<PathStep<'a>>) -> Self {
        let owner = Owner { object: Object::Service, handle: 0 };
        let mut path = heapless::Vec::new();
        // one object always has room
        let _ = robot.map(|robot| path.push(robot));
        Self { provider: Some(provider), path, opened: Opened::default(), owner, done: 0, asks: false, first: None }
    }

    /// Returns the handle of the object that was opened last.
    pub(super) fn last_handle(&self) -> i32 {
        self.opened.last().map_or(0, |(_, handle)| *handle)
    }

    fn open_session(&self, provider: &Provider<'a>) -> Option<StepCall<'_>> {
        let Provider { service, name, provider, machine, option } = *provider;
        match self.opened.len() {
            0 => Some(StepCall::new(FunctionId::SERVICE_START).with(service)),
            1 => {
                Some(StepCall::new(FunctionId::CONTROLLER_CONNECT).with(name).with(provider).with(machine).with(option))
            }
            _ => None,
        }
    }

    /// Returns whether the next call reads the names of the robots.
    fn wants_first(&self) -> bool {
        self.asks && self.first.is_none() && self.is_unnamed()
    }

    /// Returns whether the next object is a robot without a name.
    fn is_unnamed(&self) -> bool {
        self.path.get(self.done).is_some_and(|step| step.name.is_none())
    }
}

impl Steps for PathSteps<'_> {
    type Output = Opened;
    const KEEPS_OBJECTS: bool = true;

    fn next(&self) -> NextStep<'_> {
        if let Some(call) = self.provider.as_ref().and_then(|provider| self.open_session(provider)) {
            return NextStep::Call(call);
        }
        let Some(step) = self.path.get(self.done) else { return NextStep::End };
        let owner = self.owner.handle;
        let name = match (step.name, &self.first) {
            (Some(name), _) => name,
            (None, Some(first)) => first.as_str(),
            // the list of names may end a stream of Slave Mode
            (None, None) if !self.asks => DEFAULT_ROBOT,
            (None, None) => {
                return NextStep::Call(StepCall::new(FunctionId::CONTROLLER_GET_ROBOT_NAMES).with(owner).with(""));
            }
        };
        match step.object.opened_from(self.owner.object) {
            // a real controller refuses a second handle of a task without the option
            Some(function @ FunctionId::CONTROLLER_GET_TASK) => {
                NextStep::Call(StepCall::new(function).with(owner).with(name).with("@IfNotMember"))
            }
            Some(function) => NextStep::Call(StepCall::new(function).with(owner).with(name).with("")),
            // `from` has checked the path
            None => NextStep::End,
        }
    }

    fn succeeded(&mut self, reply: &Frame<'_>, _now: Instant) -> Result<(), StepCause> {
        let in_session = self.provider.is_none() || self.opened.len() >= 2;
        if in_session && self.wants_first() {
            self.first = Some(first_name(reply)?);
            return Ok(());
        }
        let object = match (in_session, self.opened.len()) {
            (false, 0) => Object::Service,
            (false, _) => Object::Controller,
            (true, _) => self.path.get(self.done).map_or(Object::Service, |step| step.object),
        };
        let handle = match object {
            Object::Service => 0,
            _ => handle_of(reply.args).map_err(StepCause::Reply)?,
        };
        self.opened.0.push((object, handle)).map_err(|_| StepCause::TooLarge)?;
        self.owner = Owner { object, handle };
        self.done = if in_session { self.done.saturating_add(1) } else { 0 };
        Ok(())
    }

    fn recovered(&mut self, cause: &StepCause) -> bool {
        let in_session = self.provider.is_none() || self.opened.len() >= 2;
        let is_answer = |code: HResult| code != HResult::E_SLVMODE_ON && code != HResult::E_HANDLE;
        let is_refused = matches!(cause, StepCause::Refused(code) if is_answer(*code));
        let helps = in_session && is_refused && self.is_unnamed() && !self.asks;
        self.asks = self.asks || helps;
        helps
    }

    fn output(&mut self) -> Opened {
        self.opened.clone()
    }
}

/// Copies the first of a reply's names.
fn first_name(reply: &Frame<'_>) -> Result<Name, StepCause> {
    let found = Any::read(reply.args).map_err(StepCause::Reply)?.vartype();
    name_at(reply, 0)?.ok_or(StepCause::Reply(ReplyError { expected: NAMES, found: Some(found) }))
}

/// Copies one of a reply's names; `None` after the last name.
pub(super) fn name_at(reply: &Frame<'_>, place: usize) -> Result<Option<Name>, StepCause> {
    let value = Any::read(reply.args).map_err(StepCause::Reply)?;
    let wrong = StepCause::Reply(ReplyError { expected: NAMES, found: Some(value.vartype()) });
    let Some(name) = value.as_array().ok_or(wrong)?.iter().nth(place) else { return Ok(None) };
    let mut copy = Name::new();
    for unit in name.as_bstr().ok_or(wrong)?.chars() {
        copy.push(unit.unwrap_or(char::REPLACEMENT_CHARACTER)).map_err(|_| StepCause::TooLarge)?;
    }
    Ok(Some(copy))
}
