//! Files: the file objects read and write the files of one folder of this machine.
//!
//! A name is a path from the root, `Folder\Name.pcs`, with `\` or `/` between its parts; the name of a folder may end
//! with one. Without [`Config::files`](crate::Config::files) the functions of files answer `E_NOTIMPL`.
//!
//! | function                                 | effect                                                               |
//! |------------------------------------------|----------------------------------------------------------------------|
//! | Controller_GetFile, File_GetFile         | opens it; `@Create=1` makes it, or a folder with a final `\`; 2 only a new one |
//! | ..._GetFileNames                         | BSTR array, in order; folders end with `\`                           |
//! | File_GetValue                            | BSTR; a UI1 array if the bytes are not UTF-8                         |
//! | File_PutValue                            | writes BSTR as UTF-8, or a UI1 array as it is                        |
//! | File_Copy, File_Move                     | to a path from the root; with a final `\` into that folder           |
//! | File_Delete                              | deletes a file, or a folder that is empty                            |
//! | File_GetDateCreated, -LastModified, ...  | DATE; of the last modification, if the file system has no other      |
//! | File_GetPath                             | BSTR: the folder it is in, from the root, `\` at both ends           |
//! | File_GetSize                             | I4 in bytes; 0 for a folder                                          |
//! | File_GetAttribute                        | I4: 1 read-only, 16 folder                                           |
//! | File_GetType                             | BSTR: the extension of the name; `Folder`                            |
//! | File_GetVariableNames, File_GetVariable  | `@CRC`, I4: the CRC-32 of the contents when it was opened            |
//! | File_Execute                             | `E_INVALID_CMD_NAME`: files have no commands                         |
//! | File_Run                                 | starts the task of the file for one cycle, BSTR: its name            |
//!
//! A name that leaves the root, directly or by a symbolic link, is refused with `E_ACCESSDENIED`, an invalid name with
//! `E_INVALIDARG`. A file that does not exist is `E_CAO_OBJECT_NOTFOUND`, a target that exists already
//! `E_CAO_COLLECTION_REGISTERED`, contents larger than 16 MiB `E_TOO_MUCH_DATA`. Writing needs the communication
//! permission, to run a file what Task_Start needs. Only regular files and folders are listed; a FIFO, a device or a socket is refused with
//! `E_ACCESSDENIED`.
//!
//! A file belongs to the task that has its path, without the extension, as its name: `Fold\Serve.pcs` to the task
//! `Fold/Serve`, or to `Serve` if there is no such task. Another file is `E_CAO_OBJECT_NOTFOUND` to File_Run.
//!
//! # Blocking
//!
//! A file system may block: a network drive, a full disk. So the model hands a file job to an [`Executor`], and the call
//! waits for its end. The default executor does the job immediately, within the call; a server should provide an executor
//! with its own thread. If the executor drops the job, the call answers `E_BUSY_PROC`.

mod job;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::context::Context;
use job::{FileJob, FileOperation, contents};

pub(crate) use job::{CRC, JobResult};

pub use crate::executor::{Executor, Job};
pub use job::write_sources;

/// The interval at which a waiting call checks its file job.
const LOOK: Duration = Duration::from_millis(2);

/// The progress of a file job.
#[derive(Debug)]
pub(crate) enum JobProgress {
    /// Not finished: the call is polled again at this time.
    Pending(Instant),
    Done(JobResult),
}

/// Receives the result of a file job.
type Slot = Arc<Mutex<Option<Result<JobResult, HResult>>>>;

/// The file jobs that clients wait for.
#[derive(Clone, Debug, Default)]
pub(crate) struct Files {
    pending: BTreeMap<PeerId, Slot>,
}

impl Files {
    /// Drops the result that a client waits for. The job itself continues.
    pub(crate) fn forget(&mut self, peer: PeerId) {
        self.pending.remove(&peer);
    }
}

/// Puts a result into a slot; if it is dropped without a result, puts `E_BUSY_PROC`.
struct Promise(Option<Slot>);

impl Promise {
    fn keep(mut self, result: Result<JobResult, HResult>) {
        self.put(result);
    }

    fn put(&mut self, result: Result<JobResult, HResult>) {
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

impl Files {
    /// Starts a function of files: of the controller (`base` is empty) or of the file or folder `base`.
    pub(crate) fn call(
        &mut self,
        ctx: &Context<'_>,
        base: &str,
        request: &Request<'_>,
    ) -> Result<JobProgress, HResult> {
        let text = |n: usize| request.text(n).to_string();
        let operation = match request.function {
            FunctionId::CONTROLLER_GET_FILE | FunctionId::FILE_GET_FILE => {
                FileOperation::Open { name: text(1), options: text(2) }
            }
            FunctionId::CONTROLLER_GET_FILE_NAMES | FunctionId::FILE_GET_FILE_NAMES => FileOperation::List,
            FunctionId::FILE_PUT_VALUE => FileOperation::Write(contents(&request.value(1))),
            FunctionId::FILE_COPY => FileOperation::Copy(text(1)),
            FunctionId::FILE_MOVE => FileOperation::Move(text(1)),
            function => FileOperation::Other(function),
        };
        let root = ctx.config.files.clone().ok_or(HResult::E_NOTIMPL)?;
        let job = FileJob { root, base: base.to_owned(), operation, writable: ctx.may_write() };
        let slot = Slot::default();
        let promise = Promise(Some(Arc::clone(&slot)));
        self.pending.insert(ctx.peer, slot);
        ctx.config.file_executor.run(Box::new(move || promise.keep(job.perform())));
        self.resume(ctx.peer, ctx.now)
    }

    /// Takes the result of the job that a client waits for.
    pub(crate) fn resume(&mut self, peer: PeerId, now: Instant) -> Result<JobProgress, HResult> {
        let slot = self.pending.get(&peer).ok_or(HResult::E_ABORT)?;
        let Some(done) = slot.lock().unwrap_or_else(PoisonError::into_inner).take() else {
            return Ok(JobProgress::Pending(now.saturating_add(LOOK)));
        };
        self.forget(peer);
        done.map(JobProgress::Done)
    }
}
