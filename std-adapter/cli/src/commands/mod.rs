//! The commands, one folder for each group; the arguments of a command are next to it.

pub(crate) mod backup;
pub(crate) mod board;
pub(crate) mod calls;
pub(crate) mod doctor;
pub(crate) mod explain;
pub(crate) mod files;
pub(crate) mod gateway;
pub(crate) mod judge;
#[cfg(feature = "screens")]
pub(crate) mod monitor;
pub(crate) mod packets;
pub(crate) mod profile;
pub(crate) mod report;
pub(crate) mod robot;
mod robot_ports;
#[cfg(feature = "screens")]
mod screen;
pub(crate) mod sim;
pub(crate) mod slave;
pub(crate) mod variables;
#[cfg(feature = "web")]
pub(crate) mod web;
