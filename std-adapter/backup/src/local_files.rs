//! Files of this machine that are never visible half written.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use tempfile::Builder;

use crate::error::{Error, failed};

/// How the names of temporary files begin. A command that is killed leaves one.
pub(crate) const TEMPORARY: &str = ".bcap-";

/// Writes a file in one step, with the folders above it; refuses to replace a file unless `replace`.
pub fn write(path: &Path, bytes: &[u8], replace: bool) -> Result<(), Error> {
    write_by(folder_of(path), path, bytes, replace)
}

/// As [`write()`], with the temporary file in another folder of the same file system.
pub fn write_by(temporary: &Path, path: &Path, bytes: &[u8], replace: bool) -> Result<(), Error> {
    for folder in [temporary, folder_of(path)] {
        fs::create_dir_all(folder).map_err(failed(folder))?;
    }
    let mut file = Builder::new().prefix(TEMPORARY).tempfile_in(temporary).map_err(failed(temporary))?;
    file.write_all(bytes).map_err(failed(path))?;
    set_permissions(file.as_file()).map_err(failed(path))?;
    // otherwise a power failure could leave an empty file under the new name
    file.as_file().sync_all().map_err(failed(path))?;
    let placed = if replace { file.persist(path) } else { file.persist_noclobber(path) };
    placed.map(drop).map_err(|error| failed(path)(error.error))
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Gives a file ordinary permissions; temporary files are readable only by their owner.
#[cfg(unix)]
fn set_permissions(file: &fs::File) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    file.set_permissions(fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn set_permissions(_: &fs::File) -> io::Result<()> {
    Ok(())
}

/// Lists the regular files of a folder of this machine and of the folders below it.
pub fn all_below(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).map_err(failed(&folder))? {
            let entry = entry.map_err(failed(&folder))?;
            let kind = entry.file_type().map_err(failed(&folder))?;
            if kind.is_dir() {
                folders.push(entry.path());
            } else if kind.is_file() {
                files.push(entry.path());
            }
        }
    }
    files.sort();
    Ok(files)
}
