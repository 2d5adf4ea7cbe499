//! The files of a controller. A path has `/` between its parts here, and `\` on the wire.
//!
//! These functions do not check whether a stream of Slave Mode runs. A caller checks with a
//! [`StreamCheck`](crate::stream::StreamCheck) before, or passes [`CheckedCalls`](crate::stream::CheckedCalls).

use bcap_capture::value::describe;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::variant::{OwnedVariant, Variant};
use bcap_std::ObjectPath;

use crate::calls::{Calls, Failure};
use crate::variables::all_strings;

/// The object that [`with_file`] opens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A file that exists.
    File,
    /// A file, which is created if it does not exist.
    NewFile,
    /// A folder that exists.
    Folder,
    /// A folder, which is created if it does not exist.
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
/// Same as [`read`], plus [`Failure::unexpected`] for bytes that are not UTF-8.
pub fn text<C: Calls>(calls: &mut C, path: &str) -> Result<String, C::Error> {
    String::from_utf8(read(calls, path)?).map_err(|_| C::Error::unexpected(format!("/{path}: its bytes are not text")))
}

/// Reads the content of an open file, as [`read`] does.
///
/// # Errors
///
/// Same as [`read`].
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

/// The maximum depth of folders that are read.
const DEPTH: usize = 32;

/// The maximum number of folders that are read, so that a controller cannot list new folders indefinitely.
const FOLDERS: usize = 10_000;

/// A file or folder.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Item {
    /// From the root, without a `/` at its beginning and end.
    pub path: String,
    /// Whether it is a folder.
    pub is_folder: bool,
    /// Whether its name could leave its folder on this machine. It is shown, and neither opened nor copied.
    pub is_unsafe: bool,
}

impl Item {
    /// Returns the path for people; an unsafe one is quoted and escaped.
    #[must_use]
    pub fn shown(&self) -> String {
        let path = format!("/{}{}", self.path, if self.is_folder { "/" } else { "" });
        if self.is_unsafe { format!("{path:?}") } else { path }
    }
}

/// Lists a folder in the order of its names; the root is the empty path.
///
/// # Errors
///
/// The error of a call.
pub fn items<C: Calls>(calls: &mut C, folder: &str) -> Result<Vec<Item>, C::Error> {
    let item = |(own, is_folder): (String, bool)| {
        let is_unsafe = is_unsafe(&own);
        Item { path: if folder.is_empty() { own } else { format!("{folder}/{own}") }, is_folder, is_unsafe }
    };
    let mut items: Vec<_> = list(calls, folder)?.into_iter().map(item).collect();
    items.sort();
    Ok(items)
}

/// Returns the path of a user without empty parts.
#[must_use]
pub fn normal(path: &str) -> String {
    path.split(['/', '\\']).filter(|part| !part.is_empty()).collect::<Vec<_>>().join("/")
}

/// Returns the last part of a path.
#[must_use]
pub fn last(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// Returns the items that a path with the wildcards `*` and `?` names, in the order of their names.
///
/// # Errors
///
/// The error of a call.
pub fn find<C: Calls>(calls: &mut C, pattern: &str) -> Result<Vec<Item>, C::Error> {
    let parts: Vec<&str> = pattern.split('/').filter(|part| !part.is_empty()).collect();
    let mut found = vec![Item { path: String::new(), is_folder: true, is_unsafe: false }];
    for (n, part) in parts.iter().enumerate() {
        let mut next = Vec::new();
        for folder in found.iter().filter(|item| item.is_folder && !item.is_unsafe) {
            match items(calls, &folder.path) {
                Err(refused) if refused.code().is_some() && !part.contains(['*', '?']) => {
                    // for example a list that does not fit a datagram
                    let path = normal(&format!("{}/{part}", folder.path));
                    if exists(calls, &path)? {
                        next.push(Item { path, is_folder: n + 1 < parts.len(), is_unsafe: false });
                    }
                }
                items => next.extend(items?.into_iter().filter(|item| matches(part, last(&item.path)))),
            }
        }
        found = next;
    }
    Ok(found)
}

/// Returns whether a name matches a pattern, where `*` is any text and `?` any character; case does not matter.
fn matches(pattern: &str, name: &str) -> bool {
    let lower = |text: &str| text.chars().flat_map(char::to_lowercase).collect::<Vec<_>>();
    let name = lower(name);
    // the lengths of the prefixes of the name that the pattern matches up to here
    let mut lengths = vec![0];
    for c in lower(pattern) {
        lengths = match c {
            '*' => lengths.first().map_or(0..0, |first| *first..name.len() + 1).collect(),
            c => {
                let fits = |length: &usize| name.get(*length).is_some_and(|own| c == '?' || c == *own);
                lengths.into_iter().filter(fits).map(|length| length + 1).collect()
            }
        };
    }
    lengths.last() == Some(&name.len())
}

/// Deletes a file, and checks whether it still exists.
///
/// # Errors
///
/// The error of a call; [`Failure::unfit`] if the file still exists.
pub fn delete<C: Calls>(calls: &mut C, path: &str) -> Result<(), C::Error> {
    with_file(calls, path, Kind::File, |calls, handle| {
        let arguments = [OwnedVariant::new(&handle)?, OwnedVariant::new("")?];
        calls.call(&format!("/{path}"), FunctionId::FILE_DELETE, &arguments).map(drop)
    })?;
    if exists(calls, path)? {
        let message = format!("/{path}: the controller still has the file");
        return Err(C::Error::unfit(message).with_hint("list the files with `bcap ls`"));
    }
    Ok(())
}

/// Returns the size of a file in bytes.
///
/// # Errors
///
/// The error of a call; [`Failure::unexpected`] for a reply without a number.
pub fn size<C: Calls>(calls: &mut C, path: &str) -> Result<i64, C::Error> {
    with_file(calls, path, Kind::File, |calls, handle| {
        let size = calls.call(&format!("/{path}"), FunctionId::FILE_GET_SIZE, &[OwnedVariant::new(&handle)?])?.1;
        size.as_ref().and_then(|size| size.as_variant().as_i64()).ok_or_else(|| unexpected(path, size.as_ref()))
    })
}

/// Lists all files of a folder and of the folders below it. A folder with an unsafe name is listed, not opened.
///
/// Before each folder, `watch` gets the number of listed folders and the number of known folders. `skip` gets the path of a
/// folder that cannot be listed, with the reason. An error of one of them ends the walk.
///
/// # Errors
///
/// The error of a call.
pub fn walk<C: Calls>(
    calls: &mut C,
    folder: &str,
    mut watch: impl FnMut(usize, usize) -> Result<(), C::Error>,
    mut skip: impl FnMut(String, C::Error) -> Result<(), C::Error>,
) -> Result<Vec<Item>, C::Error> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    let mut read = 0_usize;
    while let Some(folder) = folders.pop() {
        let before = read;
        read += 1;
        watch(before, read.saturating_add(folders.len()))?;
        if read > FOLDERS {
            // the names of the remaining folders are unknown
            skip(String::new(), too_many(&folder))?;
            break;
        }
        let is_too_deep = folder.split('/').count() > DEPTH;
        match if is_too_deep { Err(too_many(&folder)) } else { items(calls, &folder) } {
            Err(failure) => skip(folder, failure)?,
            Ok(items) => {
                for item in items {
                    if item.is_folder && !item.is_unsafe { folders.push(item.path) } else { files.push(item) }
                }
            }
        }
    }
    files.sort();
    Ok(files)
}

fn too_many<F: Failure>(folder: &str) -> F {
    let message = format!("/{folder}: there are more than {DEPTH} folders in one another, or {FOLDERS} in all");
    F::unexpected(message).with_hint("copy single folders with `bcap cp`")
}

/// Writes a file, which is created if it does not exist, and reads it back.
///
/// UTF-8 is sent as BSTR, other bytes as UI1 array.
///
/// # Errors
///
/// The error of a call; [`Failure::unfit`] if the controller returns another content.
pub fn write<C: Calls>(calls: &mut C, path: &str, bytes: &[u8]) -> Result<(), C::Error> {
    with_file(calls, path, Kind::NewFile, |calls, handle| {
        let value = std::str::from_utf8(bytes).map_or_else(|_| OwnedVariant::new(bytes), OwnedVariant::new)?;
        calls.call(&format!("/{path}"), FunctionId::FILE_PUT_VALUE, &[OwnedVariant::new(&handle)?, value])?;
        if content(calls, path, handle)? == bytes {
            return Ok(());
        }
        let message = format!("/{path}: the controller returns another content than was written");
        Err(C::Error::unfit(message).with_hint("the controller may convert text; compare the file with `bcap cp`"))
    })
}

/// Creates the parent folders of a file, if they do not exist.
///
/// # Errors
///
/// The error of a call.
pub fn make_folders<C: Calls>(calls: &mut C, path: &str) -> Result<(), C::Error> {
    for (end, _) in path.match_indices('/') {
        with_file(calls, &path[..end], Kind::NewFolder, |_, _| Ok(()))?;
    }
    Ok(())
}

/// Returns whether a file or folder exists.
///
/// # Errors
///
/// The error of a call.
pub fn exists<C: Calls>(calls: &mut C, path: &str) -> Result<bool, C::Error> {
    match with_file(calls, path, Kind::File, |_, _| Ok(())) {
        Err(refused) if refused.code() == Some(HResult::E_CAO_OBJECT_NOTFOUND) => Ok(false),
        opened => opened.map(|()| true),
    }
}

/// Returns whether the name of a file could leave its folder on this machine.
fn is_unsafe(name: &str) -> bool {
    name.is_empty() || name == "." || name == ".." || name.contains(|c: char| c.is_control() || "/\\:".contains(c))
}

/// The error for items that were not copied because of their names.
#[must_use]
pub fn unsafe_names<F: Failure>(items: &[Item]) -> F {
    let shown = items.iter().take(SHOWN).map(Item::shown).collect::<Vec<_>>().join(", ");
    let more = match items.len().saturating_sub(SHOWN) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    F::unexpected(format!("the controller lists files with unsafe names, which were not copied: {shown}{more}"))
        .with_hint("rename these files on the controller")
}

/// The maximum number of names that an error shows.
const SHOWN: usize = 5;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_in_their_folder() {
        for name in ["", ".", "..", "a/b", "a\\b", "C:", "a\nb"] {
            assert!(is_unsafe(name), "{name:?}");
        }
        assert!(!is_unsafe("Pro 1.pcs"));
    }

    #[test]
    fn wildcards_match() {
        for (pattern, name, expected) in [
            ("*", "", true),
            ("*.pcs", "Pro1.PCS", true),
            ("*.pcs", "Pro1.pcs.bak", false),
            ("P?o*1*", "Pro11", true),
            ("a*b*c", "aXbYbZc", true),
            ("a*b*c", "aXbYbZ", false),
            ("?", "", false),
            ("ab", "abc", false),
        ] {
            assert_eq!(matches(pattern, name), expected, "{pattern} {name}");
        }
    }

    #[test]
    fn paths_have_no_empty_parts() {
        assert_eq!(normal("/a//b\\c/"), "a/b/c");
    }
}
