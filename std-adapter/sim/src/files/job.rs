//! A job in the file system, independent of the controller.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_core::variant::{OleDate, OwnedVariant, Variant};

use crate::options::option;
use crate::value::{ValueResult, owned};

/// The largest file that is read, written or copied, in bytes: the largest that a frame can carry.
const LARGEST: u64 = 16 << 20;

/// The largest number of names of a folder.
const NAMES_MAX: usize = 1 << 16;

/// The largest number of parts of a path.
const PARTS_MAX: usize = 32;

/// The variable of a file.
pub(crate) const CRC: &str = "@CRC";

/// The bits of File_GetAttribute, as Windows numbers them.
const READ_ONLY: i32 = 1;
const FOLDER: i32 = 16;

/// The result of a file job.
#[derive(Debug)]
pub(crate) enum JobResult {
    Nothing,
    Value(OwnedVariant),
    /// The call opens the variable `@CRC` with this value.
    Crc(i32),
    /// The call opens the file with this name from the root.
    Open(String),
    /// The file was moved, and has this name from the root.
    Moved(String),
}

/// A file job with its inputs.
pub(super) struct FileJob {
    /// The folder with the controller's files.
    pub(super) root: PathBuf,
    /// The name from the root of the file or folder of the call.
    pub(super) base: String,
    pub(super) operation: FileOperation,
    /// The communication permission.
    pub(super) writable: Result<(), HResult>,
}

/// A function of files with its arguments.
pub(super) enum FileOperation {
    Open {
        name: String,
        options: String,
    },
    List,
    Write(Result<Vec<u8>, HResult>),
    Copy(String),
    Move(String),
    /// A function without arguments.
    Other(FunctionId),
}

/// Returns the CRC-32 of ISO 3309 (reflected, polynomial 0x04C11DB7).
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| if crc & 1 == 0 { crc >> 1 } else { crc >> 1 ^ 0xedb8_8320 };
    !bytes.iter().fold(u32::MAX, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), step))
}

/// Returns the bytes to be written to a file.
pub(super) fn contents(value: &Variant<'_>) -> Result<Vec<u8>, HResult> {
    match value.flatten() {
        Variant::Bstr(text) => Ok(text.to_string().into_bytes()),
        Variant::Array(array) => Ok(array.items::<u8>().ok_or(HResult::E_INVALIDARGTYPE)?.iter().collect()),
        _ => Err(HResult::E_INVALIDARGTYPE),
    }
}

impl FileJob {
    pub(super) fn perform(self) -> Result<JobResult, HResult> {
        let place = self.place(&self.base, "")?;
        let path = place.path();
        match &self.operation {
            FileOperation::Open { name, options } => return self.open(name, options),
            FileOperation::List => return list(&path),
            _ => {}
        }
        let metadata = known(fs::metadata(&path).map_err(failed)?)?;
        match self.operation {
            FileOperation::Write(ref contents) => {
                self.writable?;
                write(&path, contents.as_ref().map_err(|refused| *refused)?)?;
                Ok(JobResult::Nothing)
            }
            FileOperation::Copy(ref target) => {
                copy(&path, &self.target(target)?.path())?;
                Ok(JobResult::Nothing)
            }
            FileOperation::Move(ref target) => {
                let target = self.target(target)?;
                fs::rename(&path, target.path()).map_err(failed)?;
                Ok(JobResult::Moved(target.name()))
            }
            FileOperation::Other(function) => self.other(function, &path, &metadata),
            FileOperation::Open { .. } | FileOperation::List => Ok(JobResult::Nothing),
        }
    }

    /// Opens a file or folder; the options `@Create=1` and `@Create=2` make one that does not exist, and with 2 it is an error if it
    /// exists.
    fn open(&self, name: &str, options: &str) -> Result<JobResult, HResult> {
        let place = self.place(&self.base, name)?;
        if place.parts.is_empty() {
            // no client may move or delete the root
            return Err(HResult::E_INVALIDARG);
        }
        let (path, mode) = (place.path(), option(options, "@Create"));
        match fs::metadata(&path) {
            Ok(metadata) => {
                known(metadata)?;
                if mode == Some("2") {
                    return Err(HResult::E_CAO_COLLECTION_REGISTERED);
                }
            }
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(failed(error)),
            Err(_) if !matches!(mode, Some("1" | "2")) => return Err(HResult::E_CAO_OBJECT_NOTFOUND),
            Err(_) => {
                self.writable?;
                let made = if is_folder_name(name) { fs::create_dir(path) } else { create(&path).map(drop) };
                made.map_err(failed)?;
            }
        }
        Ok(JobResult::Open(place.name()))
    }

    /// Carries out a function without arguments.
    fn other(&self, function: FunctionId, path: &Path, metadata: &Metadata) -> Result<JobResult, HResult> {
        let date = |time: io::Result<SystemTime>| date(time.or_else(|_| metadata.modified()));
        let value = match function {
            FunctionId::FILE_GET_VARIABLE_NAMES => owned([CRC]),
            FunctionId::FILE_GET_VARIABLE if metadata.len() > LARGEST => return Err(HResult::E_TOO_MUCH_DATA),
            FunctionId::FILE_GET_VARIABLE => {
                return Ok(JobResult::Crc(crc32(&fs::read(path).map_err(failed)?).cast_signed()));
            }
            FunctionId::FILE_GET_VALUE => read(path),
            FunctionId::FILE_DELETE => {
                self.writable?;
                let deleted = if metadata.is_dir() { fs::remove_dir(path) } else { fs::remove_file(path) };
                deleted.map_err(failed)?;
                return Ok(JobResult::Nothing);
            }
            FunctionId::FILE_GET_DATE_CREATED => date(metadata.created()),
            FunctionId::FILE_GET_DATE_LAST_ACCESSED => date(metadata.accessed()),
            FunctionId::FILE_GET_DATE_LAST_MODIFIED => date(metadata.modified()),
            FunctionId::FILE_GET_PATH => {
                owned(self.base.rsplit_once('\\').map_or("\\".to_owned(), |(folder, _)| format!("\\{folder}\\")))
            }
            FunctionId::FILE_GET_ATTRIBUTE => {
                let bits = [(READ_ONLY, metadata.permissions().readonly()), (FOLDER, metadata.is_dir())];
                owned(bits.iter().filter(|(_, on)| *on).map(|(bit, _)| bit).sum::<i32>())
            }
            FunctionId::FILE_GET_SIZE if metadata.is_dir() => owned(0),
            FunctionId::FILE_GET_SIZE => owned(i32::try_from(metadata.len()).map_err(|_| HResult::DISP_E_OVERFLOW)?),
            FunctionId::FILE_GET_TYPE if metadata.is_dir() => owned("Folder"),
            FunctionId::FILE_GET_TYPE => owned(&*path.extension().unwrap_or_default().to_string_lossy()),
            _ => Err(HResult::E_NOTIMPL),
        };
        value.map(JobResult::Value)
    }

    /// Finds the target of a copy or a move, which must not exist yet.
    fn target(&self, target: &str) -> Result<RootedPath, HResult> {
        self.writable?;
        let own = if is_folder_name(target) { self.base.rsplit('\\').next().unwrap_or(&self.base) } else { "" };
        let place = self.place(target, own)?;
        if place.parts.is_empty() {
            return Err(HResult::E_INVALIDARG);
        }
        if place.path().exists() {
            return Err(HResult::E_CAO_COLLECTION_REGISTERED);
        }
        Ok(place)
    }

    fn place(&self, base: &str, name: &str) -> Result<RootedPath, HResult> {
        RootedPath::new(&self.root, base, name)
    }
}

/// Writes a source file for each task into `folder`, `Pro1.pcs` for the task `Pro1`: a project on a controller has one.
///
/// It keeps files that exist, and skips tasks whose names are not a path below `folder`.
///
/// # Errors
///
/// An error of the file system.
pub fn write_sources<'t>(folder: &Path, tasks: impl IntoIterator<Item = &'t str>) -> io::Result<()> {
    for task in tasks {
        let Ok(source) = RootedPath::new(folder, "", &format!("{task}.pcs")) else { continue };
        let path = source.path();
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        match create(&path) {
            Ok(mut file) => write!(file, "'!TITLE \"{task}\"\r\nSub Main\r\nEnd Sub\r\n")?,
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// The root folder, and a path below it.
struct RootedPath {
    root: PathBuf,
    /// The parts of the name.
    parts: Vec<String>,
}

impl RootedPath {
    /// Reads a name relative to a folder below the root.
    fn new(root: &Path, base: &str, name: &str) -> Result<Self, HResult> {
        let mut parts = Vec::new();
        for part in [base, name].into_iter().flat_map(|name| name.split(['\\', '/'])) {
            match part.trim() {
                "" | "." => {}
                ".." => return Err(HResult::E_ACCESSDENIED),
                part if part.contains(|c: char| c.is_control() || "<>:\"|?*".contains(c)) => {
                    return Err(HResult::E_INVALIDARG);
                }
                // each part costs an access to the file system
                _ if parts.len() == PARTS_MAX => return Err(HResult::E_INVALIDARG),
                part => parts.push(part.to_owned()),
            }
        }
        let place = Self { root: root.canonicalize().map_err(failed)?, parts };
        place.check_links()?;
        Ok(place)
    }

    /// Checks that no symbolic link leads out of the root.
    fn check_links(&self) -> Result<(), HResult> {
        let mut path = self.root.clone();
        for part in &self.parts {
            path.push(part);
            match path.canonicalize() {
                Ok(real) if real.starts_with(&self.root) => {}
                Ok(_) => return Err(HResult::E_ACCESSDENIED),
                // creating a file here would follow a dangling link
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

fn is_folder_name(name: &str) -> bool {
    name.trim_end().ends_with(['\\', '/'])
}

/// Refuses everything but regular files and folders.
fn known(metadata: Metadata) -> Result<Metadata, HResult> {
    if metadata.is_file() || metadata.is_dir() { Ok(metadata) } else { Err(HResult::E_ACCESSDENIED) }
}

fn list(folder: &Path) -> Result<JobResult, HResult> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        // a dangling link, a FIFO, a device
        let Some(metadata) = fs::metadata(entry.path()).ok().and_then(|metadata| known(metadata).ok()) else {
            continue;
        };
        if names.len() == NAMES_MAX {
            return Err(HResult::E_TOO_MUCH_DATA);
        }
        let end = if metadata.is_dir() { "\\" } else { "" };
        names.push(format!("{}{end}", entry.file_name().to_string_lossy()));
    }
    names.sort();
    owned(names).map(JobResult::Value)
}

/// Opens a regular file. If a FIFO has replaced it in the meantime, does not wait for its other end.
fn open_regular(path: &Path, options: &mut OpenOptions) -> Result<File, HResult> {
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        use std::os::unix::fs::OpenOptionsExt;
        options.custom_flags((OFlags::NONBLOCK | OFlags::NOCTTY).bits().cast_signed());
    }
    let file = options.open(path).map_err(failed)?;
    match file.metadata().map_err(failed)? {
        metadata if metadata.is_file() => Ok(file),
        metadata if metadata.is_dir() => Err(HResult::E_INVALIDARG),
        _ => Err(HResult::E_ACCESSDENIED),
    }
}

/// Creates a file that does not exist; does not follow a link.
fn create(path: &Path) -> io::Result<File> {
    OpenOptions::new().write(true).create_new(true).open(path)
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, HResult> {
    let file = open_regular(path, OpenOptions::new().read(true))?;
    let mut bytes = Vec::new();
    // the file may grow during the read
    file.take(LARGEST + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > LARGEST { Err(HResult::E_TOO_MUCH_DATA) } else { Ok(bytes) }
}

fn read(path: &Path) -> ValueResult {
    String::from_utf8(read_bytes(path)?).map_or_else(|error| owned(error.into_bytes()), owned)
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), HResult> {
    if path.is_dir() {
        return Err(HResult::E_INVALIDARG);
    }
    let mut file = open_regular(path, OpenOptions::new().write(true))?;
    file.set_len(0).and_then(|()| file.write_all(bytes)).map_err(failed)
}

fn copy(path: &Path, target: &Path) -> Result<(), HResult> {
    let bytes = read_bytes(path)?;
    create(target).and_then(|mut file| file.write_all(&bytes)).map_err(failed)
}

fn date(time: io::Result<SystemTime>) -> ValueResult {
    let since = time.map_err(failed)?.duration_since(UNIX_EPOCH).map_err(|_| HResult::DISP_E_OVERFLOW)?;
    let millis = i64::try_from(since.as_millis()).map_err(|_| HResult::DISP_E_OVERFLOW)?;
    owned(OleDate::from_unix_millis(millis).ok_or(HResult::DISP_E_OVERFLOW)?)
}

/// Returns the code for an error of the file system.
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
