//! The files of a controller. A path has `/` between its parts here, and `\` on the wire.

use bcap_capture::value::describe;
use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_live::calls::Failure as _;
pub(crate) use bcap_live::files::read;
use bcap_live::files::{self, Kind, content, with_file};

use crate::failure::Failure;
use crate::session::Session;
use crate::values::{Value, integer, text};

/// The deepest folder that is read.
const DEPTH: usize = 32;

/// The most folders that are read, so that a controller cannot list new ones for ever.
const FOLDERS: usize = 10_000;

/// A file or folder.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Item {
    /// From the root, without a `/` at its beginning and end.
    pub(crate) path: String,
    pub(crate) is_folder: bool,
    /// Whether its name could leave its folder on this machine. It is shown, and neither opened nor copied.
    pub(crate) is_unsafe: bool,
}

impl Item {
    /// Returns the path for people; an unsafe one is quoted and escaped.
    pub(crate) fn shown(&self) -> String {
        let path = format!("/{}{}", self.path, if self.is_folder { "/" } else { "" });
        if self.is_unsafe { format!("{path:?}") } else { path }
    }
}

/// Returns the path of the user without empty parts.
pub(crate) fn normal(path: &str) -> String {
    path.split(['/', '\\']).filter(|part| !part.is_empty()).collect::<Vec<_>>().join("/")
}

/// Lists a folder in the order of its names; the root is the empty path.
pub(crate) fn list(session: &mut Session, folder: &str) -> Result<Vec<Item>, Failure> {
    let item = |(own, is_folder): (String, bool)| {
        let is_unsafe = is_unsafe(&own);
        Item { path: if folder.is_empty() { own } else { format!("{folder}/{own}") }, is_folder, is_unsafe }
    };
    let mut items: Vec<_> = files::list(session, folder)?.into_iter().map(item).collect();
    items.sort();
    Ok(items)
}

/// Lists all files of a folder and of the folders below it, without the folders whose names are safe.
///
/// `skip` gets the path of a folder that cannot be listed, with the reason; an error ends the walk.
pub(crate) fn walk(
    session: &mut Session,
    folder: &str,
    mut skip: impl FnMut(String, Failure) -> Result<(), Failure>,
) -> Result<Vec<Item>, Failure> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    let mut read = 0;
    while let Some(folder) = folders.pop() {
        read += 1;
        if read > FOLDERS {
            // the folders that are left are not known by name
            skip(String::new(), too_many(&folder))?;
            break;
        }
        let is_too_deep = folder.split('/').count() > DEPTH;
        match if is_too_deep { Err(too_many(&folder)) } else { list(session, &folder) } {
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

fn too_many(folder: &str) -> Failure {
    let message = format!("/{folder}: there are more than {DEPTH} folders in one another, or {FOLDERS} in all");
    Failure::Unexpected { message, hint: "copy single folders with `bcap cp`".into() }
}

/// Returns the items that a path with the wildcards `*` and `?` names, in the order of their names.
pub(crate) fn find(session: &mut Session, pattern: &str) -> Result<Vec<Item>, Failure> {
    let parts: Vec<&str> = pattern.split('/').filter(|part| !part.is_empty()).collect();
    let mut found = vec![Item { path: String::new(), is_folder: true, is_unsafe: false }];
    for (n, part) in parts.iter().enumerate() {
        let mut next = Vec::new();
        for folder in found.iter().filter(|item| item.is_folder && !item.is_unsafe) {
            match list(session, &folder.path) {
                Err(Failure::Refused { .. }) if !part.contains(['*', '?']) => {
                    // for example a list that does not fit a datagram
                    let path = normal(&format!("{}/{part}", folder.path));
                    if exists(session, &path)? {
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

/// Writes a file, which is made if it does not exist, and reads it back.
///
/// UTF-8 is sent as BSTR, other bytes as UI1 array.
pub(crate) fn write(session: &mut Session, path: &str, bytes: &[u8]) -> Result<(), Failure> {
    with_file(session, path, Kind::NewFile, |session, handle| {
        let value = std::str::from_utf8(bytes).map_or_else(|_| Value::new(bytes), Value::new)?;
        session.call(&format!("/{path}"), FunctionId::FILE_PUT_VALUE, &[integer(handle)?, value])?;
        if content(session, path, handle)? == bytes {
            return Ok(());
        }
        Err(Failure::unfit(
            format!("/{path}: the controller returns another content than was written"),
            "the controller may convert text; compare the file with `bcap cp`",
        ))
    })
}

/// Deletes a file, and asks whether it still exists.
pub(crate) fn delete(session: &mut Session, path: &str) -> Result<(), Failure> {
    with_file(session, path, Kind::File, |session, handle| {
        session.call(&format!("/{path}"), FunctionId::FILE_DELETE, &[integer(handle)?, text("")?]).map(drop)
    })?;
    if exists(session, path)? {
        return Err(Failure::unfit(
            format!("/{path}: the controller still has the file"),
            "list the files with `bcap ls`",
        ));
    }
    Ok(())
}

/// Makes the folders above a file, if they do not exist.
pub(crate) fn make_folders(session: &mut Session, path: &str) -> Result<(), Failure> {
    for (end, _) in path.match_indices('/') {
        with_file(session, &path[..end], Kind::NewFolder, |_, _| Ok(()))?;
    }
    Ok(())
}

/// Returns whether a file or folder exists.
pub(crate) fn exists(session: &mut Session, path: &str) -> Result<bool, Failure> {
    match with_file(session, path, Kind::File, |_, _| Ok(())) {
        Err(Failure::Refused { code: HResult::E_CAO_OBJECT_NOTFOUND, .. }) => Ok(false),
        opened => opened.map(|()| true),
    }
}

/// Returns the size of a file in bytes.
pub(crate) fn size(session: &mut Session, path: &str) -> Result<i64, Failure> {
    with_file(session, path, Kind::File, |session, handle| {
        let (_, size) = session.call(&format!("/{path}"), FunctionId::FILE_GET_SIZE, &[integer(handle)?])?;
        size.as_ref()
            .and_then(|size| size.as_variant().as_i64())
            .ok_or_else(|| Failure::unexpected(format!("/{path}: the reply carries {}", describe(size.as_ref()))))
    })
}

/// Tells whether the name of a file could leave its folder on this machine.
fn is_unsafe(name: &str) -> bool {
    name.is_empty() || name == "." || name == ".." || name.contains(|c: char| c.is_control() || "/\\:".contains(c))
}

/// The error for items that were not copied because of their names.
pub(crate) fn unsafe_names(items: &[Item]) -> Failure {
    let shown = items.iter().take(SHOWN).map(Item::shown).collect::<Vec<_>>().join(", ");
    let more = match items.len().saturating_sub(SHOWN) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    Failure::Unexpected {
        message: format!("the controller lists files with unsafe names, which were not copied: {shown}{more}"),
        hint: "rename these files on the controller".into(),
    }
}

/// The most names that an error shows.
const SHOWN: usize = 5;

/// Returns the last part of a path.
pub(crate) fn last(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// Returns whether a name matches a pattern, where `*` is any text and `?` any character; case does not matter.
fn matches(pattern: &str, name: &str) -> bool {
    let lower = |text: &str| text.chars().flat_map(char::to_lowercase).collect::<Vec<_>>();
    let name = lower(name);
    // the lengths of the beginnings of the name that the pattern up to here matches
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

#[cfg(test)]
mod tests {
    use super::*;

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
    fn paths_have_no_empty_parts_and_names_stay_in_their_folder() {
        assert_eq!(normal("/a//b\\c/"), "a/b/c");
        for name in ["", ".", "..", "a/b", "a\\b", "C:", "a\nb"] {
            assert!(is_unsafe(name), "{name:?}");
        }
        assert!(!is_unsafe("Pro 1.pcs"));
    }
}
