//! `bcap dump`, `bcap diff` and `bcap restore`: backups of a controller in folders.
//!
//! `docs/backup.md` describes the format of a folder and the guarantees.

pub(crate) mod diff;
pub(crate) mod dump;
pub(crate) mod restore;
