//! The names of files and folders that a page may use. They cannot leave their folder.

use std::path::{Path, PathBuf};

/// Returns the path of a file or a folder.
pub(crate) fn path_in(folder: &Path, name: &str) -> Result<PathBuf, String> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.is_empty() || name.len() > 64 || name.starts_with('.') || !name.chars().all(is_plain) {
        return Err(format!(
            "{name:?}: a name has letters, digits, `-`, `_` and `.`, at most 64, and begins with no `.`"
        ));
    }
    Ok(folder.join(name))
}

/// Returns the sorted names in a folder; an empty list if the folder does not exist.
pub(crate) fn names_in(folder: &Path) -> Result<Vec<String>, String> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(|error| format!("{}: {error}", folder.display()))?,
    };
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut names: Vec<_> = names.filter(|name| path_in(folder, name).is_ok()).collect();
    names.sort();
    Ok(names)
}
