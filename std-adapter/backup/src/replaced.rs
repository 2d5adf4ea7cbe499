//! The files of a controller that `bcap restore` replaces: `DIR/replaced/1700000000/Pro1.pcs`.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::error::Error;
use crate::local_files;

/// The files that one restore replaces.
pub struct Replaced {
    folder: PathBuf,
    /// The folder below the backup's folder.
    below: String,
}

impl Replaced {
    /// Chooses a folder that does not exist, so that the files of an earlier restore stay.
    pub fn new(folder: &Path) -> Self {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
        let mut time = now;
        while folder.join("replaced").join(time.to_string()).exists() {
            time += 1;
        }
        Self { folder: folder.to_owned(), below: format!("replaced/{time}") }
    }

    /// Saves a file, and returns its path below the folder of the backup.
    pub fn save(&self, path: &str, bytes: &[u8]) -> Result<String, Error> {
        let saved = format!("{}/{path}", self.below);
        local_files::write(&self.folder.join(&saved), bytes, false)?;
        Ok(saved)
    }
}
