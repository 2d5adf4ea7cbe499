//! `bcap dump`, `bcap diff` and `bcap restore`: backups of a controller in folders.
//!
//! `docs/backup.md` describes the format of a folder and the guarantees.

mod compare;
mod contents;
mod controller;
pub(crate) mod diff;
pub(crate) mod dump;
mod folder;
mod journal;
mod plan;
mod replaced;
pub(crate) mod restore;
