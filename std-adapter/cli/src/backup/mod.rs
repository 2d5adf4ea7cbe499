//! `bcap dump`, `bcap diff` and `bcap restore`: backups of a controller in folders.
//!
//! `docs/backup.md` describes the format of a folder and the guarantees.

mod compare;
mod contents;
mod diff;
mod dump;
mod folder;
mod journal;
mod live;
mod plan;
mod replaced;
mod restore;

pub(crate) use diff::diff;
pub(crate) use dump::dump;
pub(crate) use restore::restore;
