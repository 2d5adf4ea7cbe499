//! Files: what the controller's file objects read and write, below one folder of this machine.
//!
//! A name is a path from the root, `Folder\Name.pcs`, with `\` or `/` between its parts; a folder's may end with one.
//! Without a folder of its own ([`Config::files`](crate::Config::files)) the functions of files answer `E_NOTIMPL`.
//!
//! | function                                 | what it does                                                         |
//! |------------------------------------------|----------------------------------------------------------------------|
//! | Controller_GetFile, File_GetFile         | opens what there is; `@Create=1` makes it, a folder with a final `\` |
//! | ..._GetFileNames                         | BSTR array, in order; folders end with `\`                           |
//! | File_GetValue                            | BSTR; a UI1 array when the bytes are no UTF-8                        |
//! | File_PutValue                            | writes BSTR as UTF-8, or a UI1 array as it is                        |
//! | File_Copy, File_Move                     | to a path from the root; with a final `\` into that folder           |
//! | File_Delete                              | deletes a file, or a folder that is empty                            |
//! | File_GetDateCreated, -LastModified, ...  | DATE; what the file system does not tell is when it was modified     |
//! | File_GetPath                             | BSTR: the folder it is in, from the root, `\` at both ends           |
//! | File_GetSize                             | I4 in bytes; 0 for a folder                                          |
//! | File_GetAttribute                        | I4: 1 read-only, 16 folder                                           |
//! | File_GetType                             | BSTR: what follows the last dot of the name; `Folder`                |
//! | File_GetVariableNames                    | an empty array: files have no variables                              |
//! | File_Run, File_GetVariable, File_Execute | `E_NOTIMPL`                                                          |
//!
//! A name that leaves the root, also by a symbolic link, is refused with `E_ACCESSDENIED`, an invalid name with
//! `E_INVALIDARG`. A file that does not exist (any more) is `E_CAO_OBJECT_NOTFOUND`, a target that exists already
//! `E_CAO_COLLECTION_REGISTERED`, contents larger than 16 MiB `E_TOO_MUCH_DATA`. Writing needs the communication
//! permission. Only regular files and folders are listed; a FIFO, a device or a socket is refused with
//! `E_ACCESSDENIED`.
//!
//! # Where the work is done
//!
//! A file system may block: a network drive, a full disk. So the model hands each piece of file work to an
//! [`Executor`], and the call waits for its end. The default executor does the work at once, inside of the call; a
//! server should give one that has a thread of its own. Work that the executor drops is answered with `E_BUSY_PROC`.

mod work;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;

use crate::controller::Controller;
use crate::dispatch::{Answer, Answered};
use crate::objects::Item;
use crate::value::Value;
use work::{Task, Work, contents};

pub use crate::executor::{Executor, Job};

/// How often a call looks whether its file work has ended.
const LOOK: Duration = Duration::from_millis(2);

/// What a piece of file work has done.
#[derive(Debug)]
enum Done {
    Nothing,
    Value(Value),
    /// The file with this name from the root is to be opened.
    Open(String),
    /// The file has this name now.
    Moved(String),
}

/// Where the result of a piece of work appears.
type Slot = Arc<Mutex<Option<Result<Done, HResult>>>>;

/// The file work that clients wait for.
#[derive(Clone, Debug, Default)]
pub(crate) struct Files {
    pending: BTreeMap<PeerId, Slot>,
}

impl Files {
    /// Forgets what a client waits for; work that has begun goes on.
    pub(crate) fn forget(&mut self, peer: PeerId) {
        self.pending.remove(&peer);
    }
}

/// The obligation to put a result into a slot; dropped without one, it puts `E_BUSY_PROC`.
struct Promise(Option<Slot>);

impl Promise {
    fn keep(mut self, result: Result<Done, HResult>) {
        self.put(result);
    }

    fn put(&mut self, result: Result<Done, HResult>) {
        if let Some(slot) = self.0.take() {
            *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(result);
        }
    }
}

impl Drop for Promise {
    fn drop(&mut self) {
        self.put(Err(HResult::E_BUSY_PROC));
    }
}

impl Controller {
    /// Carries out a function of files: of the controller (`base` is empty) or of the file or folder `base`.
    pub(crate) fn file_call(&mut self, peer: PeerId, base: &str, request: &Request<'_>) -> Answered {
        if request.resumed {
            return self.resume_file(peer, request.handle());
        }
        let text = |n: usize| request.text(n).to_string();
        let task = match request.function {
            FunctionId::CONTROLLER_GET_FILE | FunctionId::FILE_GET_FILE => {
                Task::Open { name: text(1), options: text(2) }
            }
            FunctionId::CONTROLLER_GET_FILE_NAMES | FunctionId::FILE_GET_FILE_NAMES => Task::List,
            FunctionId::FILE_PUT_VALUE => Task::Write(contents(&request.value(1))),
            FunctionId::FILE_COPY => Task::Copy(text(1)),
            FunctionId::FILE_MOVE => Task::Move(text(1)),
            function => Task::Other(function),
        };
        let root = self.config().files.clone().ok_or(HResult::E_NOTIMPL)?;
        let work = Work { root, base: base.to_owned(), task, writable: self.may_write() };
        let slot = Slot::default();
        let promise = Promise(Some(Arc::clone(&slot)));
        self.files.pending.insert(peer, slot);
        self.config().file_work.run(Box::new(move || promise.keep(work.perform())));
        self.resume_file(peer, request.handle())
    }

    /// Answers a call whose file work has ended, or goes on waiting.
    fn resume_file(&mut self, peer: PeerId, handle: i32) -> Answered {
        let slot = self.files.pending.get(&peer).ok_or(HResult::E_ABORT)?;
        let Some(done) = slot.lock().unwrap_or_else(PoisonError::into_inner).take() else {
            return Ok(Answer::Wait(self.now.saturating_add(LOOK)));
        };
        self.files.forget(peer);
        Ok(match done? {
            Done::Nothing => Answer::Done,
            Done::Value(value) => value.into(),
            Done::Open(name) => return self.open(peer, Item::File, name),
            Done::Moved(name) => {
                self.objects.rename(peer, handle, name)?;
                Answer::Done
            }
        })
    }
}
