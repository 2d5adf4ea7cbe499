//! The objects behind the handles.
//!
//! A handle is a positive I4 that belongs to the client that got it; with another client's handle, or one that has been
//! released, a call is refused with `E_HANDLE`. Numbers count up from 2, as in the guide's frames, and start over when
//! nothing is open; none is given twice at the same time.

use std::collections::{BTreeMap, BTreeSet};

use bcap_core::bcap::Object;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::commands::Command;
use crate::messages::Message;
use crate::system::Owner;
use crate::variables::Family;

const FIRST: i32 = 2;

/// What a variable's handle stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Target {
    /// A user variable.
    User(Family, u32),
    /// All user variables of a family; PutID chooses one.
    Wildcard(Family, Option<u32>),
    /// A system variable, by its name.
    System(Owner, &'static str),
}

/// What a handle stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Item {
    Controller,
    Robot,
    /// The task's place in the list.
    Task(usize),
    Variable(Target),
    /// A file or a folder; its name from the root is the entry's name.
    File,
    /// The hand.
    Extension,
    /// A command, whose name is the entry's.
    Command,
    Message,
}

/// What an object keeps of its own.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Contents {
    Nothing,
    Command(Command),
    Message(Message),
}

impl Item {
    const fn object(self) -> Object {
        match self {
            Self::Controller => Object::Controller,
            Self::Robot => Object::Robot,
            Self::Task(_) => Object::Task,
            Self::Variable(_) => Object::Variable,
            Self::File => Object::File,
            Self::Extension => Object::Extension,
            Self::Command => Object::Command,
            Self::Message => Object::Message,
        }
    }
}

/// An open object.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub(crate) peer: PeerId,
    pub(crate) item: Item,
    pub(crate) name: String,
    pub(crate) contents: Contents,
    /// What PutTag has set, encoded.
    pub(crate) tag: Option<Vec<u8>>,
    /// What PutID has set, encoded; the index of a variable is in its [`Target`].
    pub(crate) id: Option<Vec<u8>>,
    /// When a variable was last read or written through this handle; before that, when it was opened.
    pub(crate) stamp: Instant,
}

/// All open objects.
///
/// Every operation takes logarithmic time in the number of open objects, so that one client's objects do not slow the
/// calls of the others.
#[derive(Clone, Debug, Default)]
pub(crate) struct Objects {
    open: BTreeMap<i32, Entry>,
    /// The handles of each client; a client without handles has no entry.
    by_peer: BTreeMap<PeerId, BTreeSet<i32>>,
    last: i32,
}

impl Objects {
    /// Opens an object and returns its handle.
    ///
    /// # Errors
    ///
    /// `E_MAX_OBJECT` when the client has `limit` objects already.
    pub(crate) fn open(&mut self, entry: Entry, limit: usize) -> Result<i32, HResult> {
        if self.by_peer.get(&entry.peer).map_or(0, BTreeSet::len) >= limit {
            return Err(HResult::E_MAX_OBJECT);
        }
        let handle = self.free_handle();
        self.last = handle;
        self.by_peer.entry(entry.peer).or_default().insert(handle);
        self.open.insert(handle, entry);
        Ok(handle)
    }

    pub(crate) fn get(&self, peer: PeerId, handle: i32, object: Object) -> Result<&Entry, HResult> {
        let entry = self.open.get(&handle).filter(|e| e.peer == peer && e.item.object() == object);
        entry.ok_or(HResult::E_HANDLE)
    }

    pub(crate) fn get_mut(&mut self, peer: PeerId, handle: i32, object: Object) -> Result<&mut Entry, HResult> {
        let entry = self.open.get_mut(&handle).filter(|e| e.peer == peer && e.item.object() == object);
        entry.ok_or(HResult::E_HANDLE)
    }

    pub(crate) fn release(&mut self, peer: PeerId, handle: i32, object: Object) -> Result<(), HResult> {
        self.get(peer, handle, object)?;
        self.open.remove(&handle);
        if let Some(handles) = self.by_peer.get_mut(&peer) {
            handles.remove(&handle);
            if handles.is_empty() {
                self.by_peer.remove(&peer);
            }
        }
        Ok(())
    }

    /// Gives a file that was moved its new name.
    pub(crate) fn rename(&mut self, peer: PeerId, handle: i32, name: String) -> Result<(), HResult> {
        self.get_mut(peer, handle, Object::File)?.name = name;
        Ok(())
    }

    /// Releases all objects of a client.
    pub(crate) fn release_all(&mut self, peer: PeerId) {
        for handle in self.by_peer.remove(&peer).unwrap_or_default() {
            self.open.remove(&handle);
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
        // ends, because far fewer than 2^31 can be open; constant on average, because an open object is passed over once
        // in a round of 2^31 handles
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

    fn entry(peer: u32) -> Entry {
        let name = String::new();
        Entry {
            peer: PeerId(peer),
            item: Item::Robot,
            name,
            contents: Contents::Nothing,
            tag: None,
            id: None,
            stamp: Instant::ZERO,
        }
    }

    #[test]
    fn handles_are_never_given_twice_at_the_same_time() {
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
    struct Model(Vec<(u32, i32)>);

    impl Model {
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

        /// Checks that the indices of `objects` hold the same, and nothing of clients without objects.
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
            let (mut objects, mut model) = (Objects::default(), Model::default());
            // handles near the end of their range, too
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
