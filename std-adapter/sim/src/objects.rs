//! The objects that clients have opened, and the functions that all objects have.
//!
//! A handle is a positive I4 that belongs to the client that opened the object. A call with the handle of another client
//! or of a released object is refused with `E_HANDLE`. Handles count up from 2, as in the guide's frames, and start over
//! when no object is open. Two open objects never have the same handle.

use std::collections::{BTreeMap, BTreeSet, btree_map};

use bcap_core::bcap::server::Request;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::{OwnedVariant, Variant};

use crate::answer::{Answer, Answered};
use crate::comm;
use crate::command_objects::CommandObject;
use crate::hand;
use crate::messages::Message;
use crate::value::{ValueResult, keep, one_int, owned};
use crate::variables::{Family, Variables, is_wildcard};

/// Maximum length of an object's name, in bytes.
const NAME_MAX: usize = 1024;

const FIRST: i32 = 2;

/// The object that a system variable belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Parent {
    Controller,
    Robot,
    /// The task at this place of the list.
    Task(usize),
}

/// The variable of a handle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum VariableRef {
    /// A user variable.
    User(Family, u32),
    /// All user variables of a family; PutID chooses one, at first it is 0.
    Wildcard(Family, Option<u32>),
    /// A system variable, by its place in the table of its owner.
    System(Parent, usize),
    /// The checksum of a file, as it was when the variable was opened.
    Crc(i32),
    /// A definition of the robot; PutID chooses the number of a wildcard.
    Definition(DefinitionKind, Option<i32>),
}

/// The definitions that are variables of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DefinitionKind {
    Tool,
    Work,
    Area,
}

impl DefinitionKind {
    const ALL: [(Self, &'static str); 3] = [(Self::Tool, "TOOL"), (Self::Work, "WORK"), (Self::Area, "AREA")];

    /// Reads a name: `Tool1`, or `Tool*` for any number.
    pub(crate) fn parse(name: &str) -> Option<(Self, Option<i32>)> {
        let upper = name.trim().to_ascii_uppercase();
        let (kind, number) = Self::ALL.iter().find_map(|(kind, name)| Some((*kind, upper.strip_prefix(name)?)))?;
        if is_wildcard(number) {
            return Some((kind, None));
        }
        Some((kind, Some(number.parse().ok().filter(|_| number.bytes().all(|b| b.is_ascii_digit()))?)))
    }
}

/// An extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Extension {
    Hand,
    Comm,
    /// It has no command that is executed.
    Pallet,
}

impl Extension {
    pub(crate) const ALL: [Self; 3] = [Self::Hand, Self::Comm, Self::Pallet];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Hand => hand::NAME,
            Self::Comm => comm::NAME,
            Self::Pallet => "Pallet",
        }
    }

    const fn help(self) -> &'static str {
        match self {
            Self::Hand => "A virtual electric hand.",
            Self::Comm => "The lines of data communication.",
            Self::Pallet => "The calculation of positions on a pallet.",
        }
    }
}

/// The object of a handle.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Item {
    Controller,
    Robot,
    /// The task at this place of the list.
    Task(usize),
    Variable(VariableRef),
    /// A file or a folder; its name from the root is the entry's name.
    File,
    Extension(Extension),
    /// A command; its name is the entry's name.
    Command(CommandObject),
    Message(Message),
}

impl Item {
    const fn object(&self) -> Object {
        match self {
            Self::Controller => Object::Controller,
            Self::Robot => Object::Robot,
            Self::Task(_) => Object::Task,
            Self::Variable(_) => Object::Variable,
            Self::File => Object::File,
            Self::Extension(_) => Object::Extension,
            Self::Command(_) => Object::Command,
            Self::Message(_) => Object::Message,
        }
    }
}

/// An open object.
#[derive(Clone, Debug)]
pub(crate) struct OpenObject {
    pub(crate) peer: PeerId,
    pub(crate) item: Item,
    pub(crate) name: String,
    /// The value of PutTag.
    tag: OwnedVariant,
    /// The value of PutID; the index of a variable is in its [`VariableRef`].
    id: OwnedVariant,
    /// When a variable was opened, or last read or written through this handle.
    pub(crate) stamp: Instant,
}

impl OpenObject {
    pub(crate) const fn new(peer: PeerId, item: Item, name: String, now: Instant) -> Self {
        Self { peer, item, name, tag: OwnedVariant::EMPTY, id: OwnedVariant::EMPTY, stamp: now }
    }

    /// Executes a function that all objects have; `None` for another function.
    pub(crate) fn common(&mut self, request: &Request<'_>, variables: &Variables) -> Option<Answered> {
        Some(match CommonFunction::of(request.function)? {
            CommonFunction::GetName => Answer::of(&self.name),
            CommonFunction::GetHelp => Answer::of(self.help()),
            CommonFunction::GetAttribute => Answer::of(0),
            CommonFunction::GetTag => Ok(self.tag.clone().into()),
            CommonFunction::PutTag => keep(&request.value(1)).map(|tag| {
                self.tag = tag;
                Answer::Done
            }),
            CommonFunction::GetId => self.id().map(Answer::Value),
            CommonFunction::PutId => self.put_id(&request.value(1), variables).map(|()| Answer::Done),
        })
    }

    fn id(&self) -> ValueResult {
        match self.item {
            Item::Variable(VariableRef::User(_, n)) => owned(n.cast_signed()),
            Item::Variable(VariableRef::Wildcard(_, n)) => owned(n.unwrap_or(0).cast_signed()),
            Item::Variable(VariableRef::Definition(_, n)) => owned(n.unwrap_or(0)),
            _ => Ok(self.id.clone()),
        }
    }

    /// Chooses the variable of a wildcard; other objects keep the ID.
    fn put_id(&mut self, id: &Variant<'_>, variables: &Variables) -> Result<(), HResult> {
        match self.item {
            Item::Variable(VariableRef::Wildcard(family, _)) => {
                let index = u32::try_from(one_int(id)?).map_err(|_| HResult::DISP_E_BADINDEX)?;
                variables.check(family, index)?;
                self.item = Item::Variable(VariableRef::Wildcard(family, Some(index)));
            }
            Item::Variable(VariableRef::Definition(kind, _))
                if DefinitionKind::parse(&self.name) == Some((kind, None)) =>
            {
                self.item = Item::Variable(VariableRef::Definition(kind, Some(one_int(id)?)));
            }
            // the index is part of the name
            Item::Variable(VariableRef::User(..) | VariableRef::Definition(..)) => {
                return Err(HResult::E_CAO_NOT_WRITABLE);
            }
            _ => self.id = keep(id)?,
        }
        Ok(())
    }

    fn help(&self) -> String {
        match &self.item {
            Item::Controller => "A virtual robot controller.".to_owned(),
            Item::Robot => "A virtual arm of six axes.".to_owned(),
            Item::Task(_) => "A virtual task.".to_owned(),
            Item::Variable(VariableRef::System(..) | VariableRef::Definition(..) | VariableRef::Crc(_)) => {
                format!("The system variable {}.", self.name)
            }
            Item::Variable(_) => format!("The user variable {}.", self.name),
            Item::File => format!("The file {}.", self.name),
            Item::Extension(extension) => extension.help().to_owned(),
            Item::Command(_) => format!("The command {} of the controller.", self.name),
            Item::Message(message) => message.help().to_owned(),
        }
    }
}

/// A function that all kinds of objects have, except messages.
#[derive(Clone, Copy, Debug, PartialEq)]
enum CommonFunction {
    GetAttribute,
    GetHelp,
    GetName,
    GetTag,
    PutTag,
    GetId,
    PutId,
}

impl CommonFunction {
    /// In the order of their numbers, which are consecutive for each kind of object.
    const ALL: [Self; 7] =
        [Self::GetAttribute, Self::GetHelp, Self::GetName, Self::GetTag, Self::PutTag, Self::GetId, Self::PutId];

    const FIRST: [FunctionId; 7] = [
        FunctionId::CONTROLLER_GET_ATTRIBUTE,
        FunctionId::EXTENSION_GET_ATTRIBUTE,
        FunctionId::FILE_GET_ATTRIBUTE,
        FunctionId::ROBOT_GET_ATTRIBUTE,
        FunctionId::TASK_GET_ATTRIBUTE,
        FunctionId::VARIABLE_GET_ATTRIBUTE,
        FunctionId::COMMAND_GET_ATTRIBUTE,
    ];

    fn of(function: FunctionId) -> Option<Self> {
        let place = |first: &FunctionId| usize::try_from(function.0.checked_sub(first.0)?).ok();
        let found = Self::FIRST.iter().find_map(|first| Self::ALL.get(place(first)?).copied());
        // the attributes of a file come from the file system
        found.filter(|_| function != FunctionId::FILE_GET_ATTRIBUTE)
    }
}

/// All open objects.
///
/// Every operation takes logarithmic time in the number of open objects, so that the objects of one client do not slow
/// the calls of the others.
#[derive(Clone, Debug, Default)]
pub(crate) struct Objects {
    open: BTreeMap<i32, OpenObject>,
    /// The handles of each client; a client without handles has no entry.
    by_peer: BTreeMap<PeerId, BTreeSet<i32>>,
    /// Number of times that each object is open, for objects that should be open only once.
    single: BTreeMap<Single, usize>,
    last: i32,
}

/// An object that should be open only once.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Single {
    /// A controller, by its name in lower case, of all clients.
    Controller(String),
    /// A task of a client.
    Task(PeerId, usize),
}

impl Single {
    fn of(entry: &OpenObject) -> Option<Self> {
        match entry.item {
            Item::Controller => Some(Self::controller(&entry.name)),
            Item::Task(task) => Some(Self::Task(entry.peer, task)),
            _ => None,
        }
    }

    fn controller(name: &str) -> Self {
        Self::Controller(name.trim().to_lowercase())
    }
}

impl Objects {
    /// Opens an object and returns its handle.
    ///
    /// # Errors
    ///
    /// `E_OUTOFMEMORY` for a name that is too long, `E_MAX_OBJECT` if the client has `limit` objects already.
    pub(crate) fn open(&mut self, entry: OpenObject, limit: usize) -> Result<i32, HResult> {
        if entry.name.len() > NAME_MAX {
            return Err(HResult::E_OUTOFMEMORY);
        }
        if self.by_peer.get(&entry.peer).map_or(0, BTreeSet::len) >= limit {
            return Err(HResult::E_MAX_OBJECT);
        }
        let handle = self.free_handle();
        self.last = handle;
        self.by_peer.entry(entry.peer).or_default().insert(handle);
        if let Some(single) = Single::of(&entry) {
            *self.single.entry(single).or_default() += 1;
        }
        self.open.insert(handle, entry);
        Ok(handle)
    }

    /// Returns the name for a controller that a client connects to: a unique one in place of an empty name.
    pub(crate) fn controller_name(&self, wanted: &str) -> String {
        if !wanted.trim().is_empty() {
            return wanted.to_owned();
        }
        // one of them is free, because there are fewer objects
        (1_u32..).map(|n| format!("Controller{n}")).find(|name| !self.has_controller(name)).unwrap_or_default()
    }

    /// Returns whether any client has connected a controller with this name. An empty name is always free.
    pub(crate) fn has_controller(&self, name: &str) -> bool {
        self.single.contains_key(&Single::controller(name))
    }

    /// Returns whether a client has opened this task.
    pub(crate) fn has_task(&self, peer: PeerId, task: usize) -> bool {
        self.single.contains_key(&Single::Task(peer, task))
    }

    pub(crate) fn get(&self, peer: PeerId, handle: i32, object: Object) -> Result<&OpenObject, HResult> {
        let entry = self.open.get(&handle).filter(|e| e.peer == peer && e.item.object() == object);
        entry.ok_or(HResult::E_HANDLE)
    }

    pub(crate) fn get_mut(&mut self, peer: PeerId, handle: i32, object: Object) -> Result<&mut OpenObject, HResult> {
        let entry = self.open.get_mut(&handle).filter(|e| e.peer == peer && e.item.object() == object);
        entry.ok_or(HResult::E_HANDLE)
    }

    pub(crate) fn release(&mut self, peer: PeerId, handle: i32, object: Object) -> Result<(), HResult> {
        self.get(peer, handle, object)?;
        self.remove(handle);
        if let Some(handles) = self.by_peer.get_mut(&peer) {
            handles.remove(&handle);
            if handles.is_empty() {
                self.by_peer.remove(&peer);
            }
        }
        Ok(())
    }

    /// Renames a file that was moved.
    pub(crate) fn rename(&mut self, peer: PeerId, handle: i32, name: String) -> Result<(), HResult> {
        self.get_mut(peer, handle, Object::File)?.name = name;
        Ok(())
    }

    /// Releases all objects of a client.
    pub(crate) fn release_all(&mut self, peer: PeerId) {
        for handle in self.by_peer.remove(&peer).unwrap_or_default() {
            self.remove(handle);
        }
    }

    fn remove(&mut self, handle: i32) {
        let Some(single) = self.open.remove(&handle).as_ref().and_then(Single::of) else { return };
        if let btree_map::Entry::Occupied(mut count) = self.single.entry(single) {
            *count.get_mut() -= 1;
            if *count.get() == 0 {
                count.remove();
            }
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.open.len()
    }

    fn free_handle(&self) -> i32 {
        if self.open.is_empty() {
            return FIRST;
        }
        let mut handle = self.last;
        // ends, because far fewer than 2^31 objects can be open; constant on average, because each open object is skipped
        // once in 2^31 handles
        loop {
            handle = handle.checked_add(1).unwrap_or(FIRST);
            if !self.open.contains_key(&handle) {
                return handle;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_common_functions_of_all_objects_are_found() {
        for function in FunctionId::all() {
            let name = function.name().unwrap_or_default();
            let object = function.signature().map_or("", |signature| signature.object.name());
            let found = CommonFunction::of(function).map(|common| format!("{object}{common:?}").to_lowercase());
            let suffix = name.strip_prefix(object).unwrap_or_default();
            let is_common = ["GetAttribute", "GetHelp", "GetName", "GetTag", "PutTag", "GetID", "PutID"]
                .contains(&suffix)
                && function != FunctionId::FILE_GET_ATTRIBUTE;
            assert_eq!(found, is_common.then(|| name.to_lowercase()), "{name}");
        }
    }

    fn entry(peer: u32) -> OpenObject {
        OpenObject::new(PeerId(peer), Item::Robot, String::new(), Instant::ZERO)
    }

    #[test]
    fn open_objects_never_share_a_handle() {
        let mut objects = Objects::default();
        assert_eq!(objects.open(entry(1), 9), Ok(2));
        assert_eq!(objects.open(entry(1), 9), Ok(3));
        objects.release(PeerId(1), 2, Object::Robot).unwrap();
        assert_eq!(objects.open(entry(1), 9), Ok(4));
        objects.last = i32::MAX - 1;
        assert_eq!(objects.open(entry(1), 9), Ok(i32::MAX));
        assert_eq!(objects.open(entry(1), 9), Ok(2));
        assert_eq!(objects.open(entry(1), 9), Ok(5));
    }

    #[test]
    fn handles_belong_to_a_client_and_a_kind() {
        let mut objects = Objects::default();
        let handle = objects.open(entry(1), 1).unwrap();
        assert_eq!(objects.open(entry(1), 1), Err(HResult::E_MAX_OBJECT));
        assert!(objects.get(PeerId(1), handle, Object::Robot).is_ok());
        assert_eq!(objects.get(PeerId(2), handle, Object::Robot).err(), Some(HResult::E_HANDLE));
        assert_eq!(objects.get(PeerId(1), handle, Object::Task).err(), Some(HResult::E_HANDLE));
        assert_eq!(objects.release(PeerId(2), handle, Object::Robot), Err(HResult::E_HANDLE));
        objects.release_all(PeerId(1));
        assert_eq!(objects.len(), 0);
        assert_eq!(objects.open(entry(1), 1), Ok(FIRST));
    }

    /// The same in the simplest way: a list of client and handle.
    #[derive(Default)]
    struct ObjectList(Vec<(u32, i32)>);

    impl ObjectList {
        fn open(&mut self, objects: &mut Objects, peer: u32, limit: usize) {
            let count = self.0.iter().filter(|(owner, _)| *owner == peer).count();
            match objects.open(entry(peer), limit) {
                Ok(handle) => {
                    assert!(count < limit, "{count} of {limit}");
                    assert!(handle >= FIRST && self.0.iter().all(|(_, known)| *known != handle), "{handle}");
                    self.0.push((peer, handle));
                }
                Err(refused) => assert_eq!((refused, count), (HResult::E_MAX_OBJECT, limit)),
            }
        }

        fn release(&mut self, objects: &mut Objects, peer: u32, handle: i32) {
            let at = self.0.iter().position(|known| *known == (peer, handle));
            let expected = at.map(|_| ()).ok_or(HResult::E_HANDLE);
            self.0.retain(|known| *known != (peer, handle));
            assert_eq!(objects.release(PeerId(peer), handle, Object::Robot), expected, "{peer} {handle}");
        }

        fn release_all(&mut self, objects: &mut Objects, peer: u32) {
            self.0.retain(|(owner, _)| *owner != peer);
            objects.release_all(PeerId(peer));
        }

        /// Checks that the indices of `objects` have the same content, and no entry for clients without objects.
        fn check(&self, objects: &Objects) {
            let mut known: Vec<_> = objects.open.iter().map(|(handle, entry)| (entry.peer.0, *handle)).collect();
            let indexed = objects.by_peer.iter().flat_map(|(peer, handles)| handles.iter().map(|h| (peer.0, *h)));
            let mut expected = self.0.clone();
            expected.sort_unstable();
            known.sort_unstable();
            assert_eq!(known, expected);
            assert_eq!(indexed.collect::<Vec<_>>(), expected);
            assert!(objects.by_peer.values().all(|handles| !handles.is_empty()));
        }
    }

    #[test]
    fn any_sequence_of_calls_gives_what_a_list_gives() {
        const LIMIT: usize = 7;
        let mut random = fastrand::Rng::with_seed(11);
        for _ in 0..200 {
            let (mut objects, mut model) = (Objects::default(), ObjectList::default());
            // also handles near the end of their range
            objects.last = if random.bool() { i32::MAX - 9 } else { 0 };
            for _ in 0..100 {
                let peer = random.u32(0..4);
                match random.u32(0..20) {
                    0 => model.release_all(&mut objects, peer),
                    1..8 => {
                        let known = model.0.get(random.usize(0..=model.0.len())).map_or(5, |known| known.1);
                        model.release(&mut objects, peer, known);
                    }
                    _ => model.open(&mut objects, peer, LIMIT),
                }
                model.check(&objects);
            }
        }
    }
}
