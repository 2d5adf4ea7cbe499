//! The files of a controller. A path has `/` between its parts here, and `\` on the wire.

use bcap_capture::value::describe;
use bcap_core::bcap::FunctionId;
use bcap_core::variant::OwnedVariant as Value;
use bcap_live::calls::Failure as _;
pub(crate) use bcap_live::files::{Item, exists, items as list, make_folders, read, unsafe_names, walk, write};
use bcap_live::files::{Kind, with_file};

use crate::failure::Failure;
use crate::session::Session;

/// Returns the path of the user without empty parts.
pub(crate) fn normal(path: &str) -> String {
    path.split(['/', '\\']).filter(|part| !part.is_empty()).collect::<Vec<_>>().join("/")
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

/// Deletes a file, and asks whether it still exists.
pub(crate) fn delete(session: &mut Session, path: &str) -> Result<(), Failure> {
    with_file(session, path, Kind::File, |session, handle| {
        session.call(&format!("/{path}"), FunctionId::FILE_DELETE, &[Value::new(&handle)?, Value::new("")?]).map(drop)
    })?;
    if exists(session, path)? {
        return Err(Failure::unfit(
            format!("/{path}: the controller still has the file"),
            "list the files with `bcap ls`",
        ));
    }
    Ok(())
}

/// Returns the size of a file in bytes.
pub(crate) fn size(session: &mut Session, path: &str) -> Result<i64, Failure> {
    with_file(session, path, Kind::File, |session, handle| {
        let (_, size) = session.call(&format!("/{path}"), FunctionId::FILE_GET_SIZE, &[Value::new(&handle)?])?;
        size.as_ref()
            .and_then(|size| size.as_variant().as_i64())
            .ok_or_else(|| Failure::unexpected(format!("/{path}: the reply carries {}", describe(size.as_ref()))))
    })
}

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
    fn paths_have_no_empty_parts() {
        assert_eq!(normal("/a//b\\c/"), "a/b/c");
    }
}
