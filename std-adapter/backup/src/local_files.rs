//! Files of this machine that are never visible half written.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use tempfile::Builder;

use crate::error::{Error, failed};

/// How the names of temporary files begin. A command that is killed leaves one.
pub(crate) const TEMPORARY: &str = ".bcap-";

/// Writes a file in one step, and creates its parent folders; refuses to replace a file unless `replace`. A replaced file keeps
/// its permissions and the links to it. A device or a FIFO is not replaced, but written.
pub fn write(path: &Path, bytes: &[u8], replace: bool) -> Result<(), Error> {
    match path.canonicalize() {
        Ok(path) if replace && path.is_file() => write_by(folder_of(&path), &path, bytes, replace),
        Ok(path) if replace => fs::write(&path, bytes).map_err(failed(&path)),
        _ => write_by(folder_of(path), path, bytes, replace),
    }
}

/// Writes a regular file as [`write()`] does, with the temporary file in another folder of the same file system.
pub fn write_by(temporary: &Path, path: &Path, bytes: &[u8], replace: bool) -> Result<(), Error> {
    for folder in [temporary, folder_of(path)] {
        fs::create_dir_all(folder).map_err(failed(folder))?;
    }
    let mut file = Builder::new().prefix(TEMPORARY).tempfile_in(temporary).map_err(failed(temporary))?;
    file.write_all(bytes).map_err(failed(path))?;
    let replaced = if replace { fs::metadata(path).ok() } else { None };
    set_permissions(file.as_file(), replaced.map(|file| file.permissions())).map_err(failed(path))?;
    // otherwise a power failure could leave an empty file under the new name
    file.as_file().sync_all().map_err(failed(path))?;
    let placed = if replace { file.persist(path) } else { file.persist_noclobber(path) };
    placed.map(drop).map_err(|error| failed(path)(error.error))
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Gives a file the permissions of the replaced file, or default permissions; temporary files are readable only by their owner.
#[cfg(unix)]
fn set_permissions(file: &fs::File, replaced: Option<fs::Permissions>) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    file.set_permissions(replaced.unwrap_or_else(|| fs::Permissions::from_mode(0o644)))
}

#[cfg(not(unix))]
fn set_permissions(_: &fs::File, _: Option<fs::Permissions>) -> io::Result<()> {
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

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _, symlink};

    use super::*;

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn a_replaced_file_keeps_its_links_and_its_permissions() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("folder").join("file"), folder.path().join("link"));
        write(&file, b"one", true).unwrap();
        assert_eq!(mode(&file), 0o644);
        fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
        symlink(&file, &link).unwrap();
        write(&link, b"two", true).unwrap();
        assert!(link.is_symlink());
        assert_eq!((fs::read(&file).unwrap().as_slice(), mode(&file)), (&b"two"[..], 0o600));
        write(&link, b"three", false).unwrap_err();
        assert_eq!(fs::read(&file).unwrap(), b"two");
    }

    #[test]
    fn a_device_is_written_and_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("link");
        symlink("/dev/null", &link).unwrap();
        write(&link, b"text", true).unwrap();
        assert!(link.is_symlink() && fs::metadata(&link).unwrap().file_type().is_char_device());
    }
}
