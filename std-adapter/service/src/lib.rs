//! The gateway as a service: its rules from a file, and its audit log.
//!
//! | module    | contents                                                                                   |
//! |-----------|--------------------------------------------------------------------------------------------|
//! | [`rules`] | the rules for clients and the map of Modbus: a TOML file, and additions of a command line    |
//! | [`audit`] | the log: one JSON object a line, limited for each IP address, in files of bounded size       |
//! | [`events`] | the thread that writes such a log, for fleets too                                         |
//! | [`throttle`] | that limit, for the events of a fleet too                                                 |
//!
//! The log cannot report a failure of the log: a warning goes to the standard error.
//!
//! # Examples
//!
#![doc = include_str!("../README.md")]

pub mod audit;
pub mod events;
mod rotate;
pub mod rules;
pub mod throttle;
