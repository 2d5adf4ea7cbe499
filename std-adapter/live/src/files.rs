//! The files of a controller. A path has `/` between its parts here, and `\` on the wire.
//!
//! These functions do not ask whether a stream of Slave Mode runs. A caller asks with a
//! [`StreamCheck`](crate::stream::StreamCheck) before.

use bcap_capture::value::describe;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::variant::{OwnedVariant, Variant};
use bcap_std::ObjectPath;

use crate::calls::{Calls, Failure};
use crate::variables::all_strings;

/// The object that [`with_file`] opens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A file that exists.
    File,
    /// A file, which is made if it does not exist.
    NewFile,
    /// A folder that exists.
    Folder,
    /// A folder, which is made if it does not exist.
    NewFolder,
}

/// Lists a folder in the order of the names, each with whether it is a folder. The root is the empty path.
///
/// # Errors
///
/// The error of a call; [`Failure::unexpected`] for a reply without names.
pub fn list<C: Calls>(calls: &mut C, folder: &str) -> Result<Vec<(String, bool)>, C::Error> {
    let names = if folder.is_empty() {
        let controller = calls.object(&ObjectPath::controller())?;
        let arguments = [OwnedVariant::new(&controller)?, OwnedVariant::new("")?];
        calls.call("/", FunctionId::CONTROLLER_GET_FILE_NAMES, &arguments)?.1
    } else {
        with_file(calls, folder, Kind::Folder, |calls, file| {
            let arguments = [OwnedVariant::new(&file)?, OwnedVariant::new("")?];
            Ok(calls.call(&format!("/{folder}"), FunctionId::FILE_GET_FILE_NAMES, &arguments)?.1)
        })?
    };
    let variant = names.as_ref().map_or(Variant::Empty, OwnedVariant::as_variant);
    let names = all_strings(variant).ok_or_else(|| unexpected::<C::Error>(folder, names.as_ref()))?;
    let entry = |name: String| match name.strip_suffix(['\\', '/']) {
        Some(own) => (own.to_owned(), true),
        None => (name, false),
    };
    let mut entries: Vec<_> = names.into_iter().map(entry).collect();
    entries.sort();
    Ok(entries)
}

/// Reads a file: a BSTR as UTF-8, or the bytes of an array of UI1.
///
/// # Errors
///
/// The error of a call; [`Failure::unexpected`] for another value.
pub fn read<C: Calls>(calls: &mut C, path: &str) -> Result<Vec<u8>, C::Error> {
    with_file(calls, path, Kind::File, |calls, file| content(calls, path, file))
}

/// Reads a file as text.
///
/// # Errors
///
/// As [`read`]; [`Failure::unexpected`] for bytes that are not UTF-8.
pub fn text<C: Calls>(calls: &mut C, path: &str) -> Result<String, C::Error> {
    String::from_utf8(read(calls, path)?).map_err(|_| C::Error::unexpected(format!("/{path}: its bytes are not text")))
}

/// Reads the content of an open file, as [`read`] does.
///
/// # Errors
///
/// As [`read`].
pub fn content<C: Calls>(calls: &mut C, path: &str, file: i32) -> Result<Vec<u8>, C::Error> {
    let value = calls.call(&format!("/{path}"), FunctionId::FILE_GET_VALUE, &[OwnedVariant::new(&file)?])?.1;
    let bytes = match value.as_ref().map(OwnedVariant::as_variant) {
        None | Some(Variant::Empty | Variant::Null) => Some(Vec::new()),
        Some(Variant::Bstr(text)) => text.chars().collect::<Result<String, _>>().ok().map(String::into_bytes),
        Some(Variant::Array(array)) => array.items::<u8>().map(|bytes| bytes.iter().collect()),
        Some(_) => None,
    };
    bytes.ok_or_else(|| unexpected(path, value.as_ref()))
}

/// Opens a file or folder, and releases it afterwards. `body` gets its handle.
///
/// # Errors
///
/// The first error of a call or of `body`; [`Failure::unexpected`] for a reply without a handle.
pub fn with_file<C: Calls, T>(
    calls: &mut C,
    path: &str,
    kind: Kind,
    body: impl FnOnce(&mut C, i32) -> Result<T, C::Error>,
) -> Result<T, C::Error> {
    let mut name = path.replace('/', "\\");
    if matches!(kind, Kind::Folder | Kind::NewFolder) {
        name.push('\\');
    }
    let option = if matches!(kind, Kind::NewFile | Kind::NewFolder) { "@Create=1" } else { "" };
    let controller = calls.object(&ObjectPath::controller())?;
    let arguments = [OwnedVariant::new(&controller)?, OwnedVariant::new(name.as_str())?, OwnedVariant::new(option)?];
    let value = calls.call(&format!("/{path}"), FunctionId::CONTROLLER_GET_FILE, &arguments)?.1;
    let handle = match value.as_ref().map(OwnedVariant::as_variant) {
        Some(Variant::Ui4(handle)) => Some(handle.cast_signed()),
        other => other.and_then(|value| value.as_i32()),
    };
    let handle = handle.ok_or_else(|| unexpected::<C::Error>(path, value.as_ref()))?;
    let done = body(calls, handle);
    let released = calls.release(Object::File, handle);
    // an error of the work is more useful than an error of the release
    let done = done?;
    released.map(|()| done)
}

fn unexpected<F: Failure>(path: &str, value: Option<&OwnedVariant>) -> F {
    F::unexpected(format!("/{path}: the reply carries {}", describe(value)))
}
