//! The files of a controller, to look at. A path has `/` between its parts here, and `\` on the wire.

use bcap_capture::value::describe;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::variant::{OwnedVariant, Variant};
use bcap_std::ObjectPath;

use crate::calls::{Calls, Failure};
use crate::stream::StreamCheck;
use crate::variables::all_strings;

/// Lists a folder: the names, each with whether it is a folder. The root is the empty path.
///
/// # Errors
///
/// The error of a call; [`Failure::skipped`] while a stream runs.
pub fn list<C: Calls>(calls: &mut C, folder: &str) -> Result<Vec<(String, bool)>, C::Error> {
    let mut names = if folder.is_empty() {
        StreamCheck::default().require(calls, FunctionId::CONTROLLER_GET_FILE_NAMES, None)?;
        let controller = calls.object(&ObjectPath::controller())?;
        let arguments = [OwnedVariant::new(&controller)?, OwnedVariant::new("")?];
        calls.call("/", FunctionId::CONTROLLER_GET_FILE_NAMES, &arguments)?.1
    } else {
        with_file(calls, &format!("{folder}/"), |calls, file| {
            let arguments = [OwnedVariant::new(&file)?, OwnedVariant::new("")?];
            Ok(calls.call(folder, FunctionId::FILE_GET_FILE_NAMES, &arguments)?.1)
        })?
    }
    .unwrap_or_default();
    let names = all_strings(std::mem::take(&mut names).as_variant())
        .ok_or_else(|| C::Error::unexpected(format!("/{folder}: the reply is not a list of names")))?;
    let entry = |name: String| match name.strip_suffix(['\\', '/']) {
        Some(own) => (own.to_owned(), true),
        None => (name, false),
    };
    let mut entries: Vec<_> = names.into_iter().map(entry).collect();
    entries.sort();
    Ok(entries)
}

/// Reads a file as text.
///
/// # Errors
///
/// [`Failure::unexpected`] for a file that is not text; as [`list`].
pub fn text<C: Calls>(calls: &mut C, path: &str) -> Result<String, C::Error> {
    let value = with_file(calls, path, |calls, file| {
        Ok(calls.call(path, FunctionId::FILE_GET_VALUE, &[OwnedVariant::new(&file)?])?.1)
    })?;
    let not_text =
        || C::Error::unexpected(format!("/{path}: the reply carries {}, not text", describe(value.as_ref())));
    match value.as_ref().map(OwnedVariant::as_variant) {
        None | Some(Variant::Empty | Variant::Null) => Ok(String::new()),
        Some(Variant::Bstr(text)) => Ok(text.to_string()),
        Some(Variant::Array(array)) => {
            let bytes: Option<Vec<u8>> = array.items::<u8>().map(|bytes| bytes.iter().collect());
            bytes.and_then(|bytes| String::from_utf8(bytes).ok()).ok_or_else(not_text)
        }
        Some(_) => Err(not_text()),
    }
}

/// Opens a file or a folder, whose path ends with `/`, and releases it afterwards.
fn with_file<C: Calls, T>(
    calls: &mut C,
    path: &str,
    body: impl FnOnce(&mut C, i32) -> Result<T, C::Error>,
) -> Result<T, C::Error> {
    StreamCheck::default().require(calls, FunctionId::CONTROLLER_GET_FILE, None)?;
    calls.restart_limit();
    let controller = calls.object(&ObjectPath::controller())?;
    let name = path.replace('/', "\\");
    let arguments = [OwnedVariant::new(&controller)?, OwnedVariant::new(name.as_str())?, OwnedVariant::new("")?];
    let (_, handle) = calls.call(path, FunctionId::CONTROLLER_GET_FILE, &arguments)?;
    let handle = match handle.as_ref().map(OwnedVariant::as_variant) {
        Some(Variant::Ui4(handle)) => Some(handle.cast_signed()),
        other => other.and_then(|value| value.as_i32()),
    };
    let handle = handle.ok_or_else(|| C::Error::unexpected(format!("/{path}: the reply carries no handle")))?;
    let done = body(calls, handle);
    let released = calls.release(Object::File, handle);
    // an error of the work is more useful than an error of the release
    let done = done?;
    released.map(|()| done)
}
