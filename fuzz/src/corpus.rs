//! The corpora: one tar archive of inputs for each target, `fuzz/corpus/TARGET.tar`.
//!
//! An archive depends only on the names and bytes of its inputs: entries are sorted by name, and owner, mode and time are
//! constants, so packing is reproducible. Archives are not compressed, so that git stores only the difference between two
//! versions. Their entries are named `TARGET/NAME`.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use tar::{Archive, Builder, EntryType, Header};

/// The inputs of a target by name.
pub type Inputs = BTreeMap<String, Vec<u8>>;

/// Returns the folder of the archives, where cargo-fuzz also expects the unpacked corpora.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

/// Returns the path of a target's archive.
pub fn archive_path(target: &str) -> PathBuf {
    folder().join(target).with_extension("tar")
}

/// Reads the archive of a target.
///
/// # Errors
///
/// When the archive does not exist or cannot be read.
pub fn read(target: &str) -> io::Result<Inputs> {
    let mut inputs = Inputs::new();
    for entry in Archive::new(File::open(archive_path(target))?).entries()? {
        let mut entry = entry?;
        let name = file_name(&entry.path()?)?;
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes)?;
        inputs.insert(name, bytes);
    }
    Ok(inputs)
}

/// Returns the archive of inputs.
///
/// # Errors
///
/// When a name is too long for an archive.
pub fn archive(target: &str, inputs: &Inputs) -> io::Result<Vec<u8>> {
    let mut builder = Builder::new(Vec::new());
    for (name, bytes) in inputs {
        let mut header = Header::new_ustar();
        header.set_entry_type(EntryType::Regular);
        header.set_mode(0o644);
        header.set_uid(0);
        header.set_gid(0);
        header.set_mtime(0);
        header.set_size(bytes.len() as u64);
        builder.append_data(&mut header, format!("{target}/{name}"), bytes.as_slice())?;
    }
    builder.into_inner()
}

/// Writes the inputs of a target's archive into `folder/TARGET`, and keeps other files there; returns their number.
///
/// # Errors
///
/// When the archive cannot be read, or a file cannot be written.
pub fn unpack(target: &str, folder: &Path) -> io::Result<usize> {
    let inputs = read(target)?;
    let folder = folder.join(target);
    fs::create_dir_all(&folder)?;
    for (name, bytes) in &inputs {
        fs::write(folder.join(name), bytes)?;
    }
    Ok(inputs.len())
}

/// Replaces the archive of a target by the files in `folder/TARGET`; returns their number.
///
/// # Errors
///
/// When a file cannot be read, or the archive cannot be written.
pub fn pack(target: &str, folder: &Path) -> io::Result<usize> {
    let mut inputs = Inputs::new();
    for entry in fs::read_dir(folder.join(target))? {
        let path = entry?.path();
        inputs.insert(file_name(&path)?, fs::read(&path)?);
    }
    fs::write(archive_path(target), archive(target, &inputs)?)?;
    Ok(inputs.len())
}

fn file_name(path: &Path) -> io::Result<String> {
    let name = path.file_name().and_then(|name| name.to_str()).map(String::from);
    name.ok_or_else(|| {
        io::Error::new(io::ErrorKind::InvalidData, format!("{} is not a valid name of an input", path.display()))
    })
}
