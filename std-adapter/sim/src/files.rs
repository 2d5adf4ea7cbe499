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
//! A name that leaves the root, also by a symbolic link, is refused with `E_ACCESSDENIED`, one that is none with
//! `E_INVALIDARG`. What is not there is `E_CAO_OBJECT_NOTFOUND`, a target that is there already
//! `E_CAO_COLLECTION_REGISTERED`, contents larger than 16 MiB `E_TOO_MUCH_DATA`. Writing needs the communication
//! permission. A file that others have deleted meanwhile is not found.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::variant::{OleDate, Variant};

use crate::controller::Controller;
use crate::dispatch::{Answer, Answered, names};
use crate::objects::Item;
use crate::options::option;
use crate::value::Value;

/// The most bytes that are read into one value: what a frame can carry.
const LARGEST: u64 = 16 << 20;

/// Folders and names of a path at most.
const PARTS_MAX: usize = 32;

/// The bits of File_GetAttribute, as Windows numbers them.
const READ_ONLY: i32 = 1;
const FOLDER: i32 = 16;

/// The root folder, and a path below it.
struct Place {
    root: PathBuf,
    /// The parts of the name.
    parts: Vec<String>,
}

impl Place {
    /// Reads a name, seen from a folder below the root.
    fn new(root: &Path, base: &str, name: &str) -> Result<Self, HResult> {
        let mut parts = Vec::new();
        for part in [base, name].into_iter().flat_map(|name| name.split(['\\', '/'])) {
            match part.trim() {
                "" | "." => {}
                ".." => return Err(HResult::E_ACCESSDENIED),
                part if part.contains(|c: char| c.is_control() || "<>:\"|?*".contains(c)) => {
                    return Err(HResult::E_INVALIDARG);
                }
                // every part is looked at, each time
                _ if parts.len() == PARTS_MAX => return Err(HResult::E_INVALIDARG),
                part => parts.push(part.to_owned()),
            }
        }
        let place = Self { root: root.canonicalize().map_err(failed)?, parts };
        place.check_links()?;
        Ok(place)
    }

    /// Checks that no part of the path leads out of the root.
    fn check_links(&self) -> Result<(), HResult> {
        let mut path = self.root.clone();
        for part in &self.parts {
            path.push(part);
            match path.canonicalize() {
                Ok(real) if real.starts_with(&self.root) => {}
                Ok(_) => return Err(HResult::E_ACCESSDENIED),
                // a link to nowhere would be followed by whoever creates a file there
                Err(_) if path.is_symlink() => return Err(HResult::E_ACCESSDENIED),
                Err(_) => break,
            }
        }
        Ok(())
    }

    fn path(&self) -> PathBuf {
        self.root.join(self.parts.iter().collect::<PathBuf>())
    }

    /// Returns the name from the root.
    fn name(&self) -> String {
        self.parts.join("\\")
    }
}

impl Controller {
    pub(crate) fn file_names(&self, base: &str) -> Answered {
        let folder = self.place(base, "")?.path();
        let mut list = Vec::new();
        for entry in fs::read_dir(folder).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let end = if entry.path().is_dir() { "\\" } else { "" };
            list.push(format!("{}{end}", entry.file_name().to_string_lossy()));
        }
        list.sort();
        Ok(names(list))
    }

    /// Opens a file or folder; the option `@Create=1` makes one that is not there.
    pub(crate) fn open_file(&mut self, peer: PeerId, base: &str, name: &str, options: &str) -> Answered {
        let place = self.place(base, name)?;
        if place.parts.is_empty() {
            // the root is nobody's to move or delete
            return Err(HResult::E_INVALIDARG);
        }
        let path = place.path();
        if !path.exists() {
            if option(options, "@Create") != Some("1") {
                return Err(HResult::E_CAO_OBJECT_NOTFOUND);
            }
            self.may_write()?;
            let made = if is_folder_name(name) { fs::create_dir(path) } else { fs::write(path, []) };
            made.map_err(failed)?;
        }
        self.open(peer, Item::File, place.name())
    }

    pub(crate) fn file_call(&mut self, peer: PeerId, name: &str, request: &Request<'_>) -> Answered {
        let path = self.place(name, "")?.path();
        let text = |n: usize| request.text(n).to_string();
        let metadata = fs::metadata(&path).map_err(failed)?;
        let date = |time: io::Result<SystemTime>| date(time.or_else(|_| metadata.modified()));
        Ok(match request.function {
            FunctionId::FILE_GET_FILE => return self.open_file(peer, name, &text(1), &text(2)),
            FunctionId::FILE_GET_FILE_NAMES => return self.file_names(name),
            FunctionId::FILE_GET_VARIABLE_NAMES => names([]),
            FunctionId::FILE_GET_VALUE => read(&path)?.into(),
            FunctionId::FILE_PUT_VALUE => {
                self.may_write()?;
                write(&path, &request.value(1))?;
                Answer::Done
            }
            FunctionId::FILE_COPY => {
                fs::copy(&path, self.target(name, &text(1))?.path()).map_err(failed)?;
                Answer::Done
            }
            FunctionId::FILE_MOVE => {
                let target = self.target(name, &text(1))?;
                fs::rename(&path, target.path()).map_err(failed)?;
                self.objects.rename(peer, request.handle(), target.name())?;
                Answer::Done
            }
            FunctionId::FILE_DELETE => {
                self.may_write()?;
                let deleted = if metadata.is_dir() { fs::remove_dir(&path) } else { fs::remove_file(&path) };
                deleted.map_err(failed)?;
                Answer::Done
            }
            FunctionId::FILE_GET_DATE_CREATED => date(metadata.created())?.into(),
            FunctionId::FILE_GET_DATE_LAST_ACCESSED => date(metadata.accessed())?.into(),
            FunctionId::FILE_GET_DATE_LAST_MODIFIED => date(metadata.modified())?.into(),
            FunctionId::FILE_GET_PATH => {
                let folder = name.rsplit_once('\\').map_or("\\".to_owned(), |(folder, _)| format!("\\{folder}\\"));
                Value::Text(folder).into()
            }
            FunctionId::FILE_GET_ATTRIBUTE => {
                let bits = [(READ_ONLY, metadata.permissions().readonly()), (FOLDER, metadata.is_dir())];
                Value::I4(bits.iter().filter(|(_, on)| *on).map(|(bit, _)| bit).sum()).into()
            }
            FunctionId::FILE_GET_SIZE if metadata.is_dir() => Value::I4(0).into(),
            FunctionId::FILE_GET_SIZE => {
                Value::I4(i32::try_from(metadata.len()).map_err(|_| HResult::DISP_E_OVERFLOW)?).into()
            }
            FunctionId::FILE_GET_TYPE if metadata.is_dir() => Value::from("Folder").into(),
            FunctionId::FILE_GET_TYPE => {
                let extension = path.extension().unwrap_or_default().to_string_lossy();
                Value::Text(extension.into_owned()).into()
            }
            _ => return Err(HResult::E_NOTIMPL),
        })
    }

    /// Finds where a copy goes, which must not be there yet.
    fn target(&self, name: &str, target: &str) -> Result<Place, HResult> {
        self.may_write()?;
        let own = if is_folder_name(target) { name.rsplit('\\').next().unwrap_or(name) } else { "" };
        let place = self.place(target, own)?;
        if place.parts.is_empty() {
            return Err(HResult::E_INVALIDARG);
        }
        if place.path().exists() {
            return Err(HResult::E_CAO_COLLECTION_REGISTERED);
        }
        Ok(place)
    }

    fn place(&self, base: &str, name: &str) -> Result<Place, HResult> {
        Place::new(self.config().files.as_deref().ok_or(HResult::E_NOTIMPL)?, base, name)
    }
}

fn is_folder_name(name: &str) -> bool {
    name.trim_end().ends_with(['\\', '/'])
}

fn read(path: &Path) -> Result<Value, HResult> {
    let metadata = fs::metadata(path).map_err(failed)?;
    if metadata.is_dir() {
        return Err(HResult::E_INVALIDARG);
    }
    if metadata.len() > LARGEST {
        return Err(HResult::E_TOO_MUCH_DATA);
    }
    let bytes = fs::read(path).map_err(failed)?;
    Ok(String::from_utf8(bytes).map_or_else(|error| Value::Ui1s(error.into_bytes()), Value::Text))
}

fn write(path: &Path, value: &Variant<'_>) -> Result<(), HResult> {
    if path.is_dir() {
        return Err(HResult::E_INVALIDARG);
    }
    let bytes = match value.flatten() {
        Variant::Bstr(text) => text.to_string().into_bytes(),
        Variant::Array(array) => array.items::<u8>().ok_or(HResult::E_INVALIDARGTYPE)?.iter().collect(),
        _ => return Err(HResult::E_INVALIDARGTYPE),
    };
    fs::write(path, bytes).map_err(failed)
}

fn date(time: io::Result<SystemTime>) -> Result<Value, HResult> {
    let since = time.map_err(failed)?.duration_since(UNIX_EPOCH).map_err(|_| HResult::DISP_E_OVERFLOW)?;
    let millis = i64::try_from(since.as_millis()).map_err(|_| HResult::DISP_E_OVERFLOW)?;
    OleDate::from_unix_millis(millis).map(Value::Date).ok_or(HResult::DISP_E_OVERFLOW)
}

/// Returns the code for what the file system refuses.
#[expect(clippy::needless_pass_by_value, reason = "for map_err")]
fn failed(error: io::Error) -> HResult {
    match error.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => HResult::E_CAO_OBJECT_NOTFOUND,
        io::ErrorKind::AlreadyExists => HResult::E_CAO_COLLECTION_REGISTERED,
        io::ErrorKind::PermissionDenied | io::ErrorKind::DirectoryNotEmpty => HResult::E_ACCESSDENIED,
        io::ErrorKind::IsADirectory | io::ErrorKind::InvalidInput => HResult::E_INVALIDARG,
        io::ErrorKind::StorageFull | io::ErrorKind::FileTooLarge => HResult::E_OUTOFMEMORY,
        _ => HResult::E_FAIL,
    }
}
