//! The gateway as a service: its rules from a file, and its audit log.
//!
//! | module    | contents                                                                                   |
//! |-----------|--------------------------------------------------------------------------------------------|
//! | [`rules`] | the rules for clients and the map of Modbus: a TOML file, and additions of a command line    |
//! | [`audit`] | the log: one JSON object a line, limited for each IP address, in files of bounded size       |
//! | [`events`] | the thread that writes such a log, also for a fleet                                       |
//! | [`throttle`] | that limit, also for the events of a fleet                                                |
//!
//! The log cannot report its own failure in the log: a warning goes to the standard error.
//!
//! # Examples
//!
#![doc = include_str!("../README.md")]

pub mod audit;
pub mod events;
mod rotate;
pub mod rules;
pub mod throttle;
