//! Backups of controllers in folders: their content, differences, the plan of a restore, and its journal.
//!
//! | module          | contents                                                                  |
//! |-----------------|---------------------------------------------------------------------------|
//! | [`contents`]    | the variables and files of a controller, in memory                        |
//! | [`folder`]      | a backup in a folder, complete or being written                           |
//! | [`controller`]  | reads a controller                                                        |
//! | [`dump`]        | saves a controller in a folder                                            |
//! | [`restore`]     | plans and writes a backup                                                 |
//! | [`compare`]     | the differences of two backups                                            |
//! | [`plan`]        | the writes of a restore, if all of them can be made                       |
//! | [`journal`]     | the completed writes of a restore, which survive a crash of the process   |
//! | [`replaced`]    | the files of the controller that a restore replaces                       |
//! | [`local_files`] | files of this machine that are never visible half written                 |
//!
//! # Examples
//!
#![doc = include_str!("../README.md")]

pub mod compare;
pub mod contents;
pub mod controller;
pub mod dump;
mod error;
pub mod folder;
pub mod journal;
pub mod local_files;
pub mod plan;
pub mod replaced;
pub mod restore;

pub use self::error::Error;
